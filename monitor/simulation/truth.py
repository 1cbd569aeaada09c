"""The exact surface of a solid given as a field: closest point, signed distance, normal and curvature.

A mesh finds the neighbourhood of a point, the field the exact foot in it. For solids whose mesh itself is what is
scanned and known see `mesh_truth`.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from monitor.simulation.scenes import Truth
from monitor.simulation.solid import Field, evaluate, gradient, principal_curvatures, project
from projects.model import Floats, Surface
from projects.open3d_library import load_open3d


def close_in(field: Field, points: Floats, start: Floats, *, n_steps: int = 6) -> Floats:
    """Return the points of the field's zero nearest to `points` (n, 3), from starts on it that are nearly so.

    Falls onto the surface, then slides along the tangent plane and falls back; a step that leads further away is not
    taken.
    """
    best = project(field, start, n_steps=2)
    landed = (np.abs(evaluate(field, best)) < 1e-6) & (np.linalg.norm(best - start, axis=1) < 0.003)
    best[~landed] = start[~landed]
    gap2 = ((points - best) ** 2).sum(axis=1)
    for _ in range(n_steps):
        step = np.array([1e-5, 0.0, 0.0])
        g = np.column_stack(
            [evaluate(field, best + np.roll(step, a)) - evaluate(field, best - np.roll(step, a)) for a in range(3)]
        )
        n = g / np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 1e-12)
        off = points - best
        tried = project(field, best + 0.7 * (off - (off * n).sum(axis=1, keepdims=True) * n), n_steps=2)
        tried_gap2 = ((points - tried) ** 2).sum(axis=1)
        on_surface = np.abs(evaluate(field, tried)) < 1e-5
        better = on_surface & (tried_gap2 < gap2)
        best[better], gap2[better] = tried[better], tried_gap2[better]
    return best


def truth_of(field: Field, mesh: Surface) -> Truth:
    """Return the truth of a field's surface; the mesh finds the neighbourhood, the field the exact point."""

    @functools.cache
    def tree() -> Any:
        """Return the mesh as a scene in which nearest points are looked for."""
        o3d = load_open3d()
        scene = o3d.t.geometry.RaycastingScene(nthreads=2)
        scene.add_triangles(
            o3d.core.Tensor(mesh.vertices.astype(np.float32)), o3d.core.Tensor(mesh.faces.astype(np.uint32))
        )
        return scene

    def closest(points: Floats) -> Floats:
        """Return the nearest points (n, 3) [m]: those of the mesh, brought onto the field."""
        o3d = load_open3d()
        found = tree().compute_closest_points(o3d.core.Tensor(points.astype(np.float32)), nthreads=2)
        return close_in(field, points, found["points"].numpy().astype(float))

    def signed(points: Floats) -> Floats:
        """Return the distances (n,) [m], positive outside."""
        side = np.where(evaluate(field, points) < 0.0, -1.0, 1.0)
        return side * np.linalg.norm(points - closest(points), axis=1)

    def normal(points: Floats) -> Floats:
        """Return the outward unit normals (n, 3) at the nearest points."""
        g = gradient(field, closest(points))
        return g / np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 1e-12)

    def curvature(points: Floats) -> Floats:
        """Return the principal curvatures (n, 2) [1/m] at the nearest points."""
        return principal_curvatures(field, closest(points))

    return Truth(closest, signed, normal, curvature)
