"""A closed body 0.3 m wide off which a layer was taken, with errors that agree along it."""

from __future__ import annotations

import numpy as np
import trimesh
from bumpy_body import correlated_noise

from projects.model import Surface

SHARED = 1.5e-4  # m, stated of what the scans of each epoch disagree by
NOISE, REACH = 8e-5, 0.03  # m


def make_body(rng: np.random.Generator, turn: float, layer: float, above: float) -> Surface:
    """Return a closed body 0.3 m wide with errors that agree over 3 cm, `layer` (m) less where a direction's height is
    `above` that."""
    mesh = trimesh.creation.icosphere(subdivisions=5)
    d = mesh.vertices @ trimesh.transformations.rotation_matrix(turn, [0.3, 0.5, 0.8])[:3, :3].T
    shape = np.random.default_rng(5)
    waves, phases = 4.0 * shape.normal(size=(12, 3)), shape.uniform(0, 6.28, 12)
    radius = 0.13 * np.linalg.norm(d * [1.0, 0.8, 1.2], axis=1) + 0.004 * np.cos(d @ waves.T + phases).sum(1)
    points = d * radius[:, None]
    normals = trimesh.Trimesh(points, mesh.faces, process=False).vertex_normals
    lift = correlated_noise(points, rng, NOISE, REACH) + rng.normal(0, NOISE, len(d)) - layer * (d[:, 2] > above)
    n = len(points)
    return Surface(points + normals * lift[:, None], mesh.faces.astype(np.int32), sigma=np.full(n, 1.5 * NOISE),
                   sigma_shared=np.full(n, SHARED))  # fmt: skip


def area_above(body: Surface, above: float) -> float:
    """Return the share of the area of the faces whose directions are higher than that."""
    mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
    middle = mesh.triangles_center
    return float(mesh.area_faces[middle[:, 2] > above * np.linalg.norm(middle, axis=1)].sum() / mesh.area)
