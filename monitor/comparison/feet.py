"""The kernel of the distances: for each point the nearest face that looks its way and over which it stands.

A point stands over a face's interior where its foot lies inside; over an edge or a vertex where every face around
has its nearest point there (so the foot is a perpendicular of the whole surface, `papers/002`: closest in normal
direction). Points are taken along a Morton curve in fixed chunks, each search begun at the face found last.
"""

from __future__ import annotations

import numpy as np
from numba import jit, prange

from monitor.comparison.search import (
    ANY,
    DEPTH,
    LOOKING,
    STANDING,
    is_way_crossed,
    nearest_point,
    point_of,
    stands_over,
)
from monitor.comparison.stars import face_across, face_normal
from monitor.comparison.triangles import CORNER_A, EDGE_AB, along, dot, sub

CHUNK = 512
NO_FOOT, FOOT, ON_BORDER, BEHIND_SHEET, NOTHING_NEAR = range(5)


@jit(nopython=True, parallel=True, cache=True)
def find_feet(tree, points, normals, order, limits):  # type: ignore[no-untyped-def]
    """Return face, weights of its corners, signed distance and outcome for each point.

    `tree` is a `MeshTree`; points (n, 3) are in global coordinates, `normals` (n, 3) theirs, `order` is the order of
    work, limits = (largest distance, cosine of the largest angle between normals). Faces are numbered as
    in the surface.
    """
    n = len(points)
    face, weights = np.full(n, -1, dtype=np.int32), np.zeros((n, 3))
    distance, outcome = np.full(n, np.nan), np.zeros(n, dtype=np.uint8)
    for chunk in prange((n + CHUNK - 1) // CHUNK):
        stack, bounds = np.empty(DEPTH, dtype=np.int64), np.empty(DEPTH)
        last = -1
        for k in range(chunk * CHUNK, min((chunk + 1) * CHUNK, n)):
            i = order[k]
            p = local_point(tree, points, i)
            looks = (normals[i, 0], normals[i, 1], normals[i, 2])
            found = nearest_point(tree, p, looks, limits, last, LOOKING, stack, bounds)
            if found[1] >= 0 and not stands_over(tree, p, found):  # rare: then only faces that p stands over
                found = nearest_point(tree, p, looks, limits, found[1], STANDING, stack, bounds)
            if found[1] < 0:
                is_near = nearest_point(tree, p, looks, limits, last, ANY, stack, bounds)[1] >= 0
                outcome[i] = NO_FOOT if is_near else NOTHING_NEAR
                weights[i, 0] = 1.0
                continue
            last = found[1]
            face[i] = tree.order[last]
            weights[i, 0], weights[i, 1], weights[i, 2] = 1.0 - (found[2] + found[3]), found[2], found[3]
            foot = point_of(tree, last, found[2], found[3])
            distance[i] = np.copysign(np.sqrt(found[0]), dot(sub(p, foot), normal_at(tree, last, found[4])))
            if is_on_border(tree, last, found[4]):
                outcome[i] = ON_BORDER
            elif found[5] < found[0] and is_way_crossed(tree, p, foot, stack):
                outcome[i] = BEHIND_SHEET
            else:
                outcome[i] = FOOT
    return face, weights, distance, outcome


@jit(nopython=True, cache=True)
def local_point(tree, points, i):  # type: ignore[no-untyped-def]
    """Return point i in the tree's coordinates."""
    return (points[i, 0] - tree.shift[0], points[i, 1] - tree.shift[1], points[i, 2] - tree.shift[2])


@jit(nopython=True, cache=True)
def normal_at(tree, f, feature):  # type: ignore[no-untyped-def]
    """Return the normal that gives the sign at a feature of face f (Baerentzen and Aanaes 2005)."""
    if feature >= CORNER_A:
        v = tree.faces[f, feature - CORNER_A]
        return (tree.vertex_normals[v, 0], tree.vertex_normals[v, 1], tree.vertex_normals[v, 2])
    normal = face_normal(tree, f)
    if feature >= EDGE_AB:
        other = face_across(tree, f, feature - EDGE_AB)
        if other >= 0:
            return along(normal, 1.0, face_normal(tree, other))
    return normal


@jit(nopython=True, cache=True)
def is_on_border(tree, f, feature):  # type: ignore[no-untyped-def]
    """Whether a feature of face f is on a free edge of the surface."""
    if feature >= CORNER_A:
        return tree.is_border[tree.faces[f, feature - CORNER_A]]
    return feature >= EDGE_AB and face_across(tree, f, feature - EDGE_AB) < 0
