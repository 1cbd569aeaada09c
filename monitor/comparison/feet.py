"""The kernel of the distances: for each point the nearest face that looks its way and over which it stands.

A point stands over a face's interior where its foot lies inside; over an edge or a vertex where every face around
has its nearest point there (so the foot is a perpendicular of the whole surface, `papers/002`: closest in normal
direction). Points are taken along a Morton curve in fixed chunks, each search begun with the face found last: the
result is the same for any number of threads.
"""

from __future__ import annotations

import numpy as np
from numba import jit, prange

from monitor.comparison.triangles import (
    CORNER_A,
    EDGE_AB,
    FACE,
    along,
    box_distance2,
    closest_on_triangle,
    cone_looks,
    cross,
    crosses_triangle,
    dot,
    sub,
)

CHUNK = 512
DEPTH = 96  # of the stack: two entries a level are enough for any tree that fits a computer's memory
NO_FOOT, FOOT, ON_BORDER, BEHIND_SHEET, NOTHING_NEAR = range(5)


@jit(nopython=True, parallel=True, cache=True)
def find_feet(tree, points, normals, order, limits):  # type: ignore[no-untyped-def]
    """Return face, weights of its corners b and c, signed distance and outcome for each point.

    `tree` is a `MeshTree`, points and normals (n, 3) are in its local coordinates, `order` is the order of work,
    limits = (largest distance, cosine of the largest angle between normals).
    """
    n = len(points)
    face, weights = np.full(n, -1, dtype=np.int32), np.zeros((n, 2))
    distance, outcome = np.full(n, np.nan), np.zeros(n, dtype=np.uint8)
    for chunk in prange((n + CHUNK - 1) // CHUNK):
        stack, bounds = np.empty(DEPTH, dtype=np.int64), np.empty(DEPTH)
        last = -1
        for k in range(chunk * CHUNK, min((chunk + 1) * CHUNK, n)):
            i = order[k]
            p = (points[i, 0], points[i, 1], points[i, 2])
            looks = (normals[i, 0], normals[i, 1], normals[i, 2])
            found = _nearest_foot(tree, p, looks, limits, last, False, stack, bounds)
            if found[1] >= 0 and not _stands_over(tree, p, found):  # rare: then only faces that p stands over
                found = _nearest_foot(tree, p, looks, limits, -1, True, stack, bounds)
            if found[1] < 0:
                outcome[i] = NO_FOOT if _is_near(tree, p, limits[0], stack) else NOTHING_NEAR
                continue
            face[i], weights[i, 0], weights[i, 1] = found[1], found[2], found[3]
            last = found[1]
            foot = _point_of(tree, found[1], found[2], found[3])
            distance[i] = np.copysign(np.sqrt(found[0]), dot(sub(p, foot), _pseudo_normal(tree, found[1], found[4])))
            if _is_free(tree, found[1], found[4]):
                outcome[i] = ON_BORDER
            elif found[5] < found[0] and _is_hidden(tree, p, foot, stack):
                outcome[i] = BEHIND_SHEET
            else:
                outcome[i] = FOOT
    return face, weights, distance, outcome


@jit(nopython=True, cache=True)
def _nearest_foot(tree, p, looks, limits, seed, strict, stack, bounds):  # type: ignore[no-untyped-def]
    """Return the nearest point on a face that looks p's way; `strict`: only on faces that p stands over.

    As (squared distance, face, weight b, weight c, feature, squared distance from which on p's way may be barred by
    a face that looks elsewhere); face -1 where there is none.
    """
    best = (limits[0] * limits[0], -1, 0.0, 0.0, FACE, 0.0 if strict else np.inf)
    if seed >= 0:
        best = _try_face(tree, p, looks, limits[1], seed, 0.0, strict, best)
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
                best = _try_face(tree, p, looks, limits[1], f, bounds[top], strict, best)
            continue
        near, far = 2 * node + 1, 2 * node + 2
        near2, far2 = box_distance2(p, tree.nodes, near), box_distance2(p, tree.nodes, far)
        if far2 < near2:
            near, far, near2, far2 = far, near, far2, near2
        for child, child2 in ((far, far2), (near, near2)):
            if child2 <= best[0]:
                if cone_looks(looks, tree.nodes, child):
                    stack[top], bounds[top] = child, child2
                    top += 1
                else:
                    best = _barred(best, child2)
    return best


@jit(nopython=True, cache=True, inline="always")
def _barred(best, bound2):  # type: ignore[no-untyped-def]
    """Return `best`, with a face that looks elsewhere at this squared distance or more."""
    return (best[0], best[1], best[2], best[3], best[4], min(best[5], bound2))


@jit(nopython=True, cache=True, inline="always")
def _corner(tree, f, k):  # type: ignore[no-untyped-def]
    """Return corner k of face f."""
    v = tree.faces[f, k]
    return (tree.vertices[v, 0], tree.vertices[v, 1], tree.vertices[v, 2])


@jit(nopython=True, cache=True)
def _point_of(tree, f, weight_b, weight_c):  # type: ignore[no-untyped-def]
    """Return the point of face f with these weights."""
    a, b, c = _corner(tree, f, 0), _corner(tree, f, 1), _corner(tree, f, 2)
    return along(along(a, weight_b, sub(b, a)), weight_c, sub(c, a))


@jit(nopython=True, cache=True)
def _try_face(tree, p, looks, cos_angle, f, bound2, strict, best):  # type: ignore[no-untyped-def]
    """Return `best`, or the nearest point of face f where it is nearer and the face looks the same way."""
    a, b, c = _corner(tree, f, 0), _corner(tree, f, 1), _corner(tree, f, 2)
    ab, ac = sub(b, a), sub(c, a)
    area = cross(ab, ac)
    same = dot(area, looks)
    if same <= 0.0 or same * same < cos_angle * cos_angle * dot(area, area):
        return _barred(best, bound2)
    weight_b, weight_c, feature = closest_on_triangle(p, a, b, c)
    away = sub(p, along(along(a, weight_b, ab), weight_c, ac))
    distance2 = dot(away, away)
    if distance2 >= best[0] and (best[1] >= 0 or distance2 > best[0]):
        return best
    candidate = (distance2, f, weight_b, weight_c, feature, best[5])
    return best if strict and not _stands_over(tree, p, candidate) else candidate


@jit(nopython=True, cache=True)
def _stands_over(tree, p, candidate):  # type: ignore[no-untyped-def]
    """Whether every face around the candidate's edge or vertex has its nearest point there too."""
    f, feature = candidate[1], candidate[4]
    if feature >= CORNER_A:
        return _stands_over_vertex(tree, p, tree.faces[f, feature - CORNER_A])
    if feature >= EDGE_AB:
        away = sub(p, _point_of(tree, f, candidate[2], candidate[3]))
        return _stands_over_edge(tree, away, f, feature - EDGE_AB)
    return True


@jit(nopython=True, cache=True)
def _stands_over_edge(tree, away, f, edge):  # type: ignore[no-untyped-def]
    """Whether the face across the edge has its nearest point on the edge too; `away` points from the foot to p."""
    other = tree.neighbours[f, edge]
    if other < 0:
        return True  # a free edge: a foot, but one that tells nothing
    start, end = tree.faces[f, edge], tree.faces[f, (edge + 1) % 3]
    for k in range(3):
        v = tree.faces[other, k]
        if v not in (start, end):
            along_edge = sub(_corner(tree, f, (edge + 1) % 3), _corner(tree, f, edge))
            inward = sub(_corner(tree, other, k), _corner(tree, f, edge))
            length2 = dot(along_edge, along_edge)
            if length2 > 0.0:
                inward = along(inward, -dot(inward, along_edge) / length2, along_edge)
            return dot(away, inward) <= 1e-9 * np.sqrt(dot(away, away) * dot(inward, inward))
    return True


@jit(nopython=True, cache=True)
def _stands_over_vertex(tree, p, v):  # type: ignore[no-untyped-def]
    """Whether every face around vertex v has its nearest point there."""
    at = (tree.vertices[v, 0], tree.vertices[v, 1], tree.vertices[v, 2])
    away = sub(p, at)
    size2 = dot(away, away)
    for k in range(tree.star_starts[v], tree.star_starts[v + 1]):
        for corner in range(3):
            side = sub(_corner(tree, tree.star_faces[k], corner), at)
            if dot(away, side) > 1e-9 * np.sqrt(size2 * dot(side, side)):
                return False
    return True


@jit(nopython=True, cache=True)
def _face_normal(tree, f):  # type: ignore[no-untyped-def]
    """Return the unit normal of face f; zeros where it has no area."""
    a = _corner(tree, f, 0)
    n = cross(sub(_corner(tree, f, 1), a), sub(_corner(tree, f, 2), a))
    length = np.sqrt(dot(n, n))
    scale = 1.0 / length if length > 0.0 else 0.0
    return (n[0] * scale, n[1] * scale, n[2] * scale)


@jit(nopython=True, cache=True)
def _pseudo_normal(tree, f, feature):  # type: ignore[no-untyped-def]
    """Return the normal that gives the sign at the foot's feature (Baerentzen and Aanaes 2005)."""
    if feature >= CORNER_A:
        v = tree.faces[f, feature - CORNER_A]
        return (tree.vertex_normals[v, 0], tree.vertex_normals[v, 1], tree.vertex_normals[v, 2])
    normal = _face_normal(tree, f)
    if feature >= EDGE_AB and tree.neighbours[f, feature - EDGE_AB] >= 0:
        return along(normal, 1.0, _face_normal(tree, tree.neighbours[f, feature - EDGE_AB]))
    return normal


@jit(nopython=True, cache=True)
def _is_free(tree, f, feature):  # type: ignore[no-untyped-def]
    """Whether the foot lies on a free edge of the surface."""
    if feature >= CORNER_A:
        return tree.is_border[tree.faces[f, feature - CORNER_A]]
    return feature >= EDGE_AB and tree.neighbours[f, feature - EDGE_AB] < 0


@jit(nopython=True, cache=True)
def _is_hidden(tree, p, foot, stack):  # type: ignore[no-untyped-def]
    """Whether the way from p to its foot crosses the surface before it gets there."""
    direction = sub(foot, p)
    n_inner, n_faces = tree.n_leaves - 1, len(tree.faces)
    stack[0], top = 0, 1
    while top > 0:
        top -= 1
        node = stack[top]
        if not _meets_box(p, direction, tree.nodes, node):
            continue
        if node < n_inner:
            stack[top], stack[top + 1] = 2 * node + 1, 2 * node + 2
            top += 2
            continue
        leaf = node - n_inner
        for f in range(leaf * n_faces // tree.n_leaves, (leaf + 1) * n_faces // tree.n_leaves):
            t = crosses_triangle(p, direction, _corner(tree, f, 0), _corner(tree, f, 1), _corner(tree, f, 2))
            if 1e-6 < t < 1.0 - 1e-6:
                return True
    return False


@jit(nopython=True, cache=True)
def _is_near(tree, p, limit, stack):  # type: ignore[no-untyped-def]
    """Whether any face, wherever it looks, comes within `limit` of p."""
    n_inner, n_faces = tree.n_leaves - 1, len(tree.faces)
    stack[0], top = 0, 1
    while top > 0:
        top -= 1
        node = stack[top]
        if box_distance2(p, tree.nodes, node) > limit * limit:
            continue
        if node < n_inner:
            stack[top], stack[top + 1] = 2 * node + 1, 2 * node + 2
            top += 2
            continue
        leaf = node - n_inner
        for f in range(leaf * n_faces // tree.n_leaves, (leaf + 1) * n_faces // tree.n_leaves):
            weight_b, weight_c, _ = closest_on_triangle(
                p, _corner(tree, f, 0), _corner(tree, f, 1), _corner(tree, f, 2)
            )
            away = sub(p, _point_of(tree, f, weight_b, weight_c))
            if dot(away, away) <= limit * limit:
                return True
    return False


@jit(nopython=True, cache=True)
def _meets_box(p, direction, nodes, i):  # type: ignore[no-untyped-def]
    """Whether the segment p to p + direction touches the box of node i."""
    enter, leave = 0.0, 1.0
    for k in range(3):
        if direction[k] == 0.0:
            if p[k] < nodes[i, k] or p[k] > nodes[i, 3 + k]:
                return False
        else:
            t0, t1 = (nodes[i, k] - p[k]) / direction[k], (nodes[i, 3 + k] - p[k]) / direction[k]
            enter, leave = max(enter, min(t0, t1)), min(leave, max(t0, t1))
    return enter <= leave
