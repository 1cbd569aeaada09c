"""Clouds carried anywhere at all, and poses disturbed by a little."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from projects.model import Floats, PointCloud
from projects.transforms import apply, rotate

ANGLE, WAY = np.radians(5.0), 0.010  # rad and m, of a disturbance


def anywhere(rng: np.random.Generator, reach: float = 5.0) -> Floats:
    """Return a motion (4, 4) by any turn and up to `reach` [m] along each axis."""
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    T[:3, 3] = rng.uniform(-reach, reach, 3)
    return T


def moved(cloud: PointCloud, T: Floats) -> PointCloud:
    """Return the cloud moved by T, with its station."""
    origins = None if cloud.origins is None else apply(T, np.atleast_2d(cloud.origins))[0]
    return PointCloud(apply(T, cloud.points), normals=rotate(T, cloud.normals), origins=origins)


def in_place(cloud: PointCloud, T: np.ndarray) -> PointCloud:
    """Return the cloud moved by T, without its station."""
    return PointCloud(apply(T, cloud.points), normals=rotate(T, cloud.normals))


def disturb(pose: np.ndarray, centre: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the pose turned by 5 degrees about the scan's middle and shifted by 10 mm, in random directions."""
    axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(ANGLE * axis).as_matrix()
    T[:3, 3] = centre - T[:3, :3] @ centre + WAY * way
    return T @ pose
