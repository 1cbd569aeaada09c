"""The exact surface of solids: closest point, distance, normal and curvature of one field, or of many parts together.

A mesh finds the neighbourhood of a point, the field the exact foot in it. Parts that were given as exact triangles
(polyhedra) need no field for that.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from monitor.simulation.scenes import Truth
from monitor.simulation.solid import Field, evaluate, gradient, principal_curvatures, project
from projects.model import Floats, Ints, Surface
from projects.open3d_library import load_open3d


@dataclass(frozen=True)
class SolidPart:
    """A part of a solid in the scene's coordinates: its mesh, its field, and whether the mesh is the exact surface."""

    mesh: Surface
    field: Field
    exact_mesh: bool = False


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
    return truth_of_parts([SolidPart(mesh, field)], field)


def truth_of_parts(parts: Sequence[SolidPart], field: Field) -> Truth:
    """Return the truth of parts that stand together.

    Parameters
    ----------
    parts : with their meshes and fields, in the scene's coordinates. Faces that lie inside of another part are left
        out. Where parts meet inside the solid, a point within it may be given a joint of theirs as its surface.
    field : of all parts together, negative inside; tells the sign.
    """

    @functools.cache
    def tree() -> Any:
        o3d = load_open3d()
        scene = o3d.t.geometry.RaycastingScene(nthreads=2)
        for k, part in enumerate(parts):
            faces = part.mesh.faces if len(parts) == 1 else _open_faces(parts, k)
            scene.add_triangles(
                o3d.core.Tensor(part.mesh.vertices.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32))
            )
        return scene

    def find(points: Floats) -> tuple[Floats, Ints]:
        o3d = load_open3d()
        found = tree().compute_closest_points(o3d.core.Tensor(points.astype(np.float32)), nthreads=2)
        which, feet = found["geometry_ids"].numpy().astype(np.int64), found["points"].numpy().astype(float)
        for k in np.unique(which):
            mine = which == k
            if parts[k].exact_mesh:
                normals = found["primitive_normals"].numpy()[mine].astype(float)
                feet[mine] = _fall_onto_faces(feet[mine], normals, parts[k].field)
            else:
                feet[mine] = close_in(parts[k].field, points[mine], feet[mine])
        return feet, which

    def signed(points: Floats) -> Floats:
        side = np.where(evaluate(field, points) < 0.0, -1.0, 1.0)
        return side * np.linalg.norm(points - find(points)[0], axis=1)

    def normal(points: Floats) -> Floats:
        feet, which = find(points)
        g = np.empty_like(feet)
        for k in np.unique(which):
            g[which == k] = gradient(parts[k].field, feet[which == k])
        return g / np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 1e-12)

    def curvature(points: Floats) -> Floats:
        feet, which = find(points)
        bent = np.empty((len(feet), 2))
        for k in np.unique(which):
            bent[which == k] = principal_curvatures(parts[k].field, feet[which == k])
        return bent

    return Truth(lambda points: find(points)[0], signed, normal, curvature)


def _fall_onto_faces(feet: Floats, normals: Floats, field: Field) -> Floats:
    """Return feet rounded to float32 moved along their faces' normals onto the exact planes of a distance field."""
    offset = evaluate(field, feet + 1e-4 * normals) - 1e-4
    return feet - np.where(np.abs(offset) < 1e-5, offset, 0.0)[:, None] * normals


def _open_faces(parts: Sequence[SolidPart], k: int) -> Ints:
    """Return the faces of part k that are not wholly inside of another part."""
    mesh = parts[k].mesh
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    buried = np.zeros(len(mesh.vertices), dtype=bool)
    for j, other in enumerate(parts):
        box = other.mesh.vertices.min(axis=0), other.mesh.vertices.max(axis=0)
        if j == k or (box[0] > high).any() or (box[1] < low).any():
            continue
        reached = np.flatnonzero(((mesh.vertices >= box[0]) & (mesh.vertices <= box[1])).all(axis=1))
        buried[reached] |= evaluate(other.field, mesh.vertices[reached]) < -1e-5
    return mesh.faces[~buried[mesh.faces].all(axis=1)]
