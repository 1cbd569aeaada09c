"""Spheres and boards that surveyors put up, and the scanner that looks at them."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from monitor.simulation import INSTRUMENTS, Body, sphere_scene

# the cyclic error is one of the whole target, which its own points cannot show
SCANNER = dataclasses.replace(INSTRUMENTS["faro-photon120"], cyclic_amplitudes=(0.0,) * 4)


def placed(position: np.ndarray, azimuth: float = 0.0) -> np.ndarray:
    """Return the pose (4, 4) at a position, turned about the vertical."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_euler("z", azimuth).as_matrix(), position
    return T


def sphere(position: np.ndarray, radius: float = 0.0725) -> Body:
    """Return a sphere with its centre there."""
    return sphere_scene(radius=radius, n_rings=150).bodies[0].moved(placed(position))


def board(position: np.ndarray, *, width: float = 0.15, n_fields: int = 2, azimuth: float = np.pi + 0.3) -> Body:
    """Return a plate of black and white fields that faces along `azimuth`."""
    ticks = np.linspace(-width / 2, width / 2, n_fields + 1)
    vertices = np.array([[0.0, y, z] for y in ticks for z in ticks])
    faces, reflectance = [], []
    for a in range(n_fields):
        for b in range(n_fields):
            i, k = (n_fields + 1) * a + b, n_fields + 1
            faces += [[i, i + k, i + k + 1], [i, i + k + 1, i + 1]]
            reflectance += [0.9 if (a + b) % 2 else 0.05] * 2
    body = Body("board", vertices, np.array(faces, dtype=np.int32), np.array(reflectance))
    return body.moved(placed(position, azimuth))
