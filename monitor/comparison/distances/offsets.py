"""On which side of another surface a point lies, whichever way that surface looks there.

The perpendicular distance (`feet`) asks for a face that looks the same way; where a piece broke off there is none, but
whether a point now lies outside or inside of what is left can still be told from the nearest point of all.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit, prange

from monitor.comparison.distances.feet import CHUNK, is_on_border, normal_at
from monitor.comparison.distances.mesh_tree import MeshTree
from monitor.comparison.distances.search import ANY, DEPTH, foot_on_face, nearest_point
from monitor.morton import point_order
from monitor.tuples import dot, less, sub
from projects.model import Bools, Floats, Ints

STEEPEST = 0.5  # cosine: beyond a free edge a point within 60 degrees of the surface's normal still has a side


class Offsets(NamedTuple):
    """`distances` (n,) [m] to the nearest point in any direction, positive outside, NaN beyond the limit; `is_known`
    (n,) whether its side is (not beside a free edge), `is_past_end` (n,) whether the nearest point lies on one;
    `faces` (n,) of the other surface, -1 beyond the limit."""

    distances: Floats
    is_known: Bools
    is_past_end: Bools
    faces: Ints


def signed_offsets(points: Floats, tree: MeshTree, limit: float) -> Offsets:
    """Return the distance of points (n, 3) to the nearest point of a surface within `limit` [m], and their side of it.

    Positive outside. Where the nearest point lies on a free edge, the surface is continued along its own plane: the
    side is known where the point stands more over it than beside it.

    References
    ----------
    Baerentzen and Aanaes (2005), Signed distance computation using the angle weighted pseudonormal.
    """
    distances, slope, faces = _find_nearest(tree, points, point_order(points), limit)
    return Offsets(distances, np.isfinite(distances) & (slope >= STEEPEST), (faces >= 0) & (slope < 1.0), faces)


@jit(nopython=True, parallel=True, cache=True)
def _find_nearest(tree: Any, points: Any, order: Any, limit: float) -> Any:
    """Return signed distance, slope (cosine to the surface's normal at a free edge, else 1) and face of each point."""
    n = len(points)
    distances, slope, face = np.full(n, np.nan), np.zeros(n), np.full(n, -1, dtype=np.int32)
    for chunk in prange((n + CHUNK - 1) // CHUNK):
        stack, bounds = np.empty(DEPTH, dtype=np.int64), np.empty(DEPTH)
        last = -1
        for k in range(chunk * CHUNK, min((chunk + 1) * CHUNK, n)):
            i = order[k]
            p = less(points, i, tree.shift)
            best = nearest_point(tree, p, p, (limit, 0.0), last, ANY, stack, bounds)
            if best[1] < 0:
                continue
            last = best[1]
            foot, _ = foot_on_face(tree.vertices, tree.faces, tree.shift, last, best[2], best[3])
            away = sub(p, foot)
            normal = normal_at(tree, last, best[4])
            height, size = dot(away, normal), np.sqrt(best[0])
            face[i], distances[i] = tree.order[last], np.copysign(size, height)
            slope[i] = 1.0
            if is_on_border(tree, last, best[4]) and size > 0.0:
                length = np.sqrt(dot(normal, normal))  # none where faces lie back to back, or have no area
                slope[i] = abs(height) / (size * length) if length > 0.0 else 0.0
    return distances, slope, face
