"""The bumpy body with parts that moved, a knob and a cap."""

from __future__ import annotations

import numpy as np
from bumpy_body import unit

from projects.model import Floats, PointCloud
from projects.transforms import apply, perturb, rotate

N = 24_000
WAYS = {  # direction of the part's middle, half angle, rotation [rad] and shift [m]
    "knob": (unit(np.array([[1.0, 0.2, 0.3]]))[0], 0.55, np.array([0.01, -0.02, 0.015]), np.array([1e-3, 2e-3, -1e-3])),
    "cap": (unit(np.array([[-0.4, -1.0, 0.5]]))[0], 0.6, np.array([-0.015, 0.0, 0.01]), np.array([-2e-3, 0.0, 2e-3])),
}


def shift_part(cloud: PointCloud, name: str) -> tuple[PointCloud, np.ndarray, Floats]:
    """Return the cloud with one part moved, which points that are, and the part's motion (4, 4)."""
    towards, half, w, t = WAYS[name]
    part = unit(cloud.points) @ towards > np.cos(half)
    T = perturb(np.eye(4), cloud.points[part].mean(axis=0), np.concatenate([w, t]))
    points, normals = cloud.points.copy(), cloud.normals.copy()
    points[part], normals[part] = apply(T, points[part]), rotate(T, normals[part])
    return PointCloud(points, normals), part, T
