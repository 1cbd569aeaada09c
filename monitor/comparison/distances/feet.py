"""The kernel of the distances: for each point the nearest face that looks its way and over which it stands.

A point stands over a face's interior where its foot lies inside; over an edge or a vertex where every face around
has its nearest point there (so the foot is a perpendicular of the whole surface, `papers/002`: closest in normal
direction). Points are taken along a Morton curve in fixed chunks, in runs that are looked for together (`packets`).
"""

from __future__ import annotations

import numpy as np
from numba import jit, prange

from monitor.comparison.distances.packets import FEW, MOST_FACES, MOST_POINTS, gather_faces, nearest_among, pick_faces
from monitor.comparison.distances.search import (
    ANY,
    DEPTH,
    LOOKING,
    STANDING,
    foot_on_face,
    is_way_crossed,
    nearest_point,
    stands_over,
)
from monitor.comparison.distances.stars import face_across, face_normal
from monitor.comparison.distances.triangles import CORNER_A, EDGE_AB, FACE
from monitor.tuples import along, dot, less, sub

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
        numbers, meets = np.empty(MOST_FACES, dtype=np.int64), np.empty(MOST_FACES + 8, dtype=np.uint8)
        boxes, near, bounds2 = np.empty((6, MOST_FACES)), np.empty((6, MOST_FACES)), np.empty(MOST_FACES)
        chosen, middles = np.empty(MOST_FACES, dtype=np.int64), np.empty(MOST_FACES, dtype=np.float32)
        words = meets.view(np.uint64)
        keys, n_near, widest2, last, margin, longest = middles.view(np.int32), 0, 0.0, -1, -1.0, MOST_POINTS
        first, end = chunk * CHUNK, min((chunk + 1) * CHUNK, n)
        ahead = first
        while first < end:
            if first == ahead:  # a run of points; the first by itself, which shows how wide the margin must be
                ahead, n_near, widest2 = first + 1, 0, 0.0
                if margin >= 0.0:
                    ahead = min(first + longest, end)
                    low, high = _box_of(tree.shift, points, order, first, ahead, margin)
                    n_near = gather_faces(tree, low, high, numbers, boxes, stack)
                    if n_near < 0 and ahead - first > 1:
                        longest, ahead = (ahead - first) // 2, first
                        continue
            upto = min(first + FEW, ahead)
            low, high = _box_of(tree.shift, points, order, first, upto, margin)
            few = pick_faces(boxes, n_near, low, high, meets, chosen, near)
            for k in range(first, upto):
                i = order[k]
                p = less(points, i, tree.shift)
                looks = (normals[i, 0], normals[i, 1], normals[i, 2])
                found = nearest_among(
                    tree, p, looks, limits, few, chosen, near, numbers, bounds2, middles, keys, meets, words
                )
                if found[1] < 0 or found[0] > margin * margin:
                    seed = found[1] if found[1] >= 0 else last
                    found = nearest_point(tree, p, looks, limits, seed, LOOKING, stack, bounds)
                if found[1] >= 0 and found[4] != FACE and not stands_over(tree, p, found):  # rare: then only faces that
                    found = nearest_point(tree, p, looks, limits, found[1], STANDING, stack, bounds)  # p stands over
                if found[1] < 0:
                    is_near = nearest_point(tree, p, looks, limits, last, ANY, stack, bounds)[1] >= 0
                    outcome[i] = NO_FOOT if is_near else NOTHING_NEAR
                    weights[i, 0] = 1.0
                    continue
                last, widest2 = found[1], max(widest2, found[0])
                face[i] = tree.order[last]
                weights[i, 0], weights[i, 1], weights[i, 2] = 1.0 - (found[2] + found[3]), found[2], found[3]
                distance[i], outcome[i] = _look_at_foot(tree, p, found, stack)
            first = upto
            if first == ahead:
                margin, longest = 1.5 * np.sqrt(widest2), min(2 * longest, MOST_POINTS)
    return face, weights, distance, outcome


@jit(nopython=True, cache=True, forceinline=True)
def _look_at_foot(tree, p, found, stack):  # type: ignore[no-untyped-def]
    """Return the signed distance to the foot that was found, and the outcome."""
    f, feature = found[1], found[4]
    foot, normal = foot_on_face(tree.vertices, tree.faces, tree.shift, f, found[2], found[3])
    if feature != FACE:
        normal = normal_at(tree, f, feature)
    distance = np.copysign(np.sqrt(found[0]), dot(sub(p, foot), normal))
    if feature != FACE and is_on_border(tree, f, feature):
        return distance, ON_BORDER
    return distance, BEHIND_SHEET if found[5] < found[0] and is_way_crossed(tree, p, foot, stack) else FOOT


@jit(nopython=True, cache=True, forceinline=True)
def _box_of(shift, points, order, first, upto, margin):  # type: ignore[no-untyped-def]
    """Return low and high corner of the box of a run of points, in the tree's coordinates, wider by a margin."""
    low = high = less(points, order[first], shift)
    for k in range(first + 1, upto):
        p = less(points, order[k], shift)
        low = (min(low[0], p[0]), min(low[1], p[1]), min(low[2], p[2]))
        high = (max(high[0], p[0]), max(high[1], p[1]), max(high[2], p[2]))
    return (low[0] - margin, low[1] - margin, low[2] - margin), (high[0] + margin, high[1] + margin, high[2] + margin)


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
