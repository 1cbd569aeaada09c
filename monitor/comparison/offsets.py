"""On which side of another surface a point lies, whichever way that surface looks there.

The perpendicular distance (`feet`) asks for a face that looks the same way; where a piece broke off there is none, but
whether a point now lies outside or inside of what is left can still be told from the nearest point of all.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit, prange

from monitor.comparison.feet import CHUNK, DEPTH, _is_free, _point_of, _pseudo_normal
from monitor.comparison.mesh_tree import MeshTree, morton_codes
from monitor.comparison.triangles import FACE, box_distance2, closest_on_triangle, dot, sub
from projects.model import Bools, Floats, Ints

STEEPEST = 0.5  # cosine: beyond a free edge a point within 60 degrees of the surface's normal still has a side


class Offsets(NamedTuple):
    """`distances` (n,) [m] to the nearest point in any direction, positive outside, NaN beyond the limit; `is_known`
    (n,) whether its side is (not beside a free edge); `faces` (n,) of the other surface, -1 beyond the limit."""

    distances: Floats
    is_known: Bools
    faces: Ints


def signed_offsets(points: Floats, tree: MeshTree, limit: float) -> Offsets:
    """Return the distance of points (n, 3) to the nearest point of a surface within `limit` [m], and their side of it.

    Positive outside. Where the nearest point lies on a free edge, the surface is continued along its own plane: the
    side is known where the point stands more over it than beside it.

    References
    ----------
    Baerentzen and Aanaes (2005), Signed distance computation using the angle weighted pseudonormal.
    """
    local = np.ascontiguousarray(points - tree.shift)
    order = np.argsort(morton_codes(local), kind="stable") if len(local) else np.zeros(0, dtype=np.int64)
    distances, slope, face = _find_nearest(tree, local, order, limit)
    faces = np.where(face >= 0, tree.order[face], -1)
    return Offsets(distances, np.isfinite(distances) & (slope >= STEEPEST), faces)


@jit(nopython=True, parallel=True, cache=True)
def _find_nearest(tree: Any, points: Any, order: Any, limit: float) -> Any:
    """Return signed distance, slope (cosine to the surface's normal at a free edge, else 1) and face of each point."""
    n = len(points)
    distances, slope, face = np.full(n, np.nan), np.zeros(n), np.full(n, -1, dtype=np.int32)
    for chunk in prange((n + CHUNK - 1) // CHUNK):
        stack, bounds = np.empty(DEPTH, dtype=np.int64), np.empty(DEPTH)
        for k in range(chunk * CHUNK, min((chunk + 1) * CHUNK, n)):
            i = order[k]
            p = (points[i, 0], points[i, 1], points[i, 2])
            best = _nearest(tree, p, limit * limit, stack, bounds)
            if best[1] < 0:
                continue
            away = sub(p, _point_of(tree, best[1], best[2], best[3]))
            normal = _pseudo_normal(tree, best[1], best[4])
            height, size = dot(away, normal), np.sqrt(best[0])
            face[i], distances[i] = best[1], np.copysign(size, height)
            slope[i] = 1.0
            if _is_free(tree, best[1], best[4]) and size > 0.0:
                slope[i] = abs(height) / (size * np.sqrt(dot(normal, normal)))
    return distances, slope, face


@jit(nopython=True, cache=True)
def _nearest(tree: Any, p: Any, limit2: float, stack: Any, bounds: Any) -> Any:
    """Return (squared distance, face, weight b, weight c, feature) of the nearest point; face -1 beyond the limit."""
    best = (limit2, -1, 0.0, 0.0, FACE)
    n_inner, n_faces = tree.n_leaves - 1, len(tree.faces)
    stack[0], bounds[0], top = 0, 0.0, 1
    while top > 0:
        top -= 1
        node = stack[top]
        if bounds[top] > best[0]:
            continue
        if node >= n_inner:
            leaf = node - n_inner
            for f in range(leaf * n_faces // tree.n_leaves, (leaf + 1) * n_faces // tree.n_leaves):
                a, b, c = tree.faces[f, 0], tree.faces[f, 1], tree.faces[f, 2]
                weight_b, weight_c, feature = closest_on_triangle(
                    p, (tree.vertices[a, 0], tree.vertices[a, 1], tree.vertices[a, 2]),
                    (tree.vertices[b, 0], tree.vertices[b, 1], tree.vertices[b, 2]),
                    (tree.vertices[c, 0], tree.vertices[c, 1], tree.vertices[c, 2]),
                )  # fmt: skip
                away = sub(p, _point_of(tree, f, weight_b, weight_c))
                distance2 = dot(away, away)
                if distance2 < best[0] or (best[1] < 0 and distance2 <= best[0]):
                    best = (distance2, f, weight_b, weight_c, feature)
            continue
        near, far = 2 * node + 1, 2 * node + 2
        near2, far2 = box_distance2(p, tree.nodes, near), box_distance2(p, tree.nodes, far)
        if far2 < near2:
            near, far, near2, far2 = far, near, far2, near2
        for child, child2 in ((far, far2), (near, near2)):
            if child2 <= best[0]:
                stack[top], bounds[top] = child, child2
                top += 1
    return best
