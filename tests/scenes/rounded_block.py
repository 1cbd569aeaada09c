"""A block with rounded edges, whole, cut off, or open below."""

from __future__ import annotations

import numpy as np
import trimesh

from monitor.simulation.solid import contour
from projects.model import Surface

NOISE = 2e-5  # m


def block(rng: np.random.Generator, cut: np.ndarray | None, is_open: bool, noise: float = NOISE) -> Surface:
    """Return a block of 0.12 x 0.1 x 0.08 m with rounded edges, beyond a plane cut off, its base perhaps open.

    All are contoured on one grid: the chords over the edges are the same.
    """
    half = np.array([0.06, 0.05, 0.04])[:, None]

    def field(p: np.ndarray) -> np.ndarray:
        q = np.abs(p) - half + 0.006
        body = np.linalg.norm(np.maximum(q, 0.0), axis=0) + np.minimum(q.max(axis=0), 0.0) - 0.006
        return body if cut is None else np.maximum(body, cut[:3] @ p - cut[3])

    vertices, faces = contour(field, np.array([[-0.07, -0.06, -0.05], [0.07, 0.06, 0.05]]), cell=0.002)
    normals = trimesh.Trimesh(vertices, faces, process=False).vertex_normals
    vertices = vertices + normals * rng.normal(0, noise, (len(vertices), 1))
    return Surface(vertices, faces[(vertices[faces][:, :, 2] > -0.03).all(axis=1)] if is_open else faces)
