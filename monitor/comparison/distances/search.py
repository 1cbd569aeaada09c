"""The descents through a surface's tree: the nearest point of its faces, and whether a way crosses one.

All that asks for a nearest point asks here. A search begins in the leaf of a face that is likely near and climbs: the
bound is tight at once and most of the tree is passed by. Of faces equally near the first in the tree's order is taken,
so where a search begins changes nothing.
"""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.comparison.distances.mesh_tree import FACES_PER_LEAF, leaf_of_node, node_of_leaf
from monitor.comparison.distances.stars import corner_of, face_across, vertex_of
from monitor.comparison.distances.triangles import (
    CORNER_A,
    EDGE_AB,
    FACE,
    box_distance2,
    closest_on_triangle,
    cone_looks,
    crosses_triangle,
)
from monitor.tuples import along, cross, dot, less, sub

DEPTH = 96  # of the stack: two entries a level are enough for any tree that fits a computer's memory
ANY, LOOKING, STANDING = range(3)  # which faces count: all, those that look p's way, of these those that p stands over


@jit(nopython=True, cache=True)
def nearest_point(tree, p, looks, limits, seed, kind, stack, bounds):  # type: ignore[no-untyped-def]
    """Return the nearest point to p on the faces of a kind within limits[0]; `seed` is a face to begin with, or -1.

    `looks` is the unit normal that faces are held against, limits[1] the least cosine. Out comes (squared distance,
    face, weight b, weight c, feature, squared distance from which p's way there may be barred by a face that looks
    elsewhere); face -1 where there is none.
    """
    nodes, vertices, faces, shift = tree.nodes, tree.vertices, tree.faces, tree.shift
    best = (limits[0] * limits[0], -1, 0.0, 0.0, FACE, 0.0 if kind == STANDING else np.inf)
    n_inner, n_faces = tree.n_leaves - 1, len(faces)
    top = _lay_out_climb(tree.deepest, tree.n_leaves, seed, stack, bounds)
    while top > 0:
        top -= 1
        node, bound = stack[top], bounds[top]
        if bound < 0.0:
            bound = box_distance2(p, nodes, node)
            if bound <= best[0] and not _may_hold(nodes, p, looks, node, kind):
                best = barred(best, bound)
                continue
        if bound > best[0]:
            continue
        if node >= n_inner:
            first = leaf_of_node(tree.deepest, tree.n_leaves, node) * FACES_PER_LEAF
            last = min(first + FACES_PER_LEAF, n_faces)
            if kind != STANDING:
                best = try_faces(vertices, faces, shift, p, looks, limits[1], kind, first, last, bound, best)
                continue
            for f in range(first, last):
                found = try_faces(vertices, faces, shift, p, looks, limits[1], kind, f, f + 1, bound, best)
                best = found if found[1] == best[1] or stands_over(tree, p, found) else best
            continue
        near, far = 2 * node + 1, 2 * node + 2
        near2, far2 = box_distance2(p, nodes, near), box_distance2(p, nodes, far)
        if far2 < near2:
            near, far, near2, far2 = far, near, far2, near2
        for child, child2 in ((far, far2), (near, near2)):
            if child2 <= best[0]:
                if _may_hold(nodes, p, looks, child, kind):
                    stack[top], bounds[top] = child, child2
                    top += 1
                else:
                    best = barred(best, child2)
    return best


@jit(nopython=True, cache=True)
def _lay_out_climb(deepest, n_leaves, seed, stack, bounds):  # type: ignore[no-untyped-def]
    """Fill the stack with the leaf of face `seed` on top and the nodes beside its way to the root; return its height.

    Bounds are -1: not known yet. Without a seed the root stands alone.
    """
    if seed < 0:
        stack[0], bounds[0] = 0, -1.0
        return 1
    node = node_of_leaf(deepest, n_leaves, seed // FACES_PER_LEAF)
    height, above = 1, node
    while above > 0:
        above = (above - 1) // 2
        height += 1
    stack[height - 1] = node
    for k in range(height - 1):
        bounds[k + 1] = -1.0
        stack[height - 2 - k] = node + 1 if node % 2 else node - 1
        node = (node - 1) // 2
    bounds[0] = -1.0
    return height


@jit(nopython=True, cache=True, forceinline=True)
def _may_hold(nodes, p, looks, node, kind):  # type: ignore[no-untyped-def]
    """Whether a face below a node may count."""
    if kind == ANY:
        return True
    return cone_looks(looks, nodes, node) and (kind == LOOKING or _may_stand(nodes, node, p))


@jit(nopython=True, cache=True, forceinline=True)
def _may_stand(nodes, i, p):  # type: ignore[no-untyped-def]
    """Whether p may stand over a face, edge or vertex of node i: the way to it lies in the cone of the normals there.

    Over a vertex whose faces all look within an angle (below a right one) of an axis, the surface is a graph over the
    plane across the axis, and the way to what is nearest lies within that angle of the axis, on either side.
    """
    around = np.float64(nodes[i, 10])
    if around >= 0.5 * np.pi:
        return True
    size2, distance2, height = 0.0, 0.0, 0.0
    for k in range(3):
        half = 0.5 * (np.float64(nodes[i, 3 + k]) - np.float64(nodes[i, k]))
        away = p[k] - np.float64(nodes[i, k]) - half
        size2 += half * half
        distance2 += away * away
        height += away * np.float64(nodes[i, 6 + k])
    if distance2 <= size2:
        return True
    tilt = np.arccos(min(abs(height) / np.sqrt(distance2), 1.0))
    return tilt <= around + np.arcsin(np.sqrt(size2 / distance2)) + 1e-5


@jit(nopython=True, cache=True, forceinline=True)
def barred(best, bound2):  # type: ignore[no-untyped-def]
    """Return `best`, with a face that looks elsewhere at this squared distance or more."""
    return (best[0], best[1], best[2], best[3], best[4], min(best[5], bound2))


@jit(nopython=True, cache=True, forceinline=True)
def foot_on_face(vertices, faces, shift, f, weight_b, weight_c):  # type: ignore[no-untyped-def]
    """Return the point of face f with these weights, and the face's normal, as long as twice its area."""
    a, b = less(vertices, faces[f, 0], shift), less(vertices, faces[f, 1], shift)
    ab, ac = sub(b, a), sub(less(vertices, faces[f, 2], shift), a)
    return along(along(a, weight_b, ab), weight_c, ac), cross(ab, ac)


@jit(nopython=True, cache=True, forceinline=True)
def try_faces(vertices, faces, shift, p, looks, cos_angle, kind, first, last, bound2, best):  # type: ignore[no-untyped-def]
    """Return `best`, or the nearest point of the faces from `first` to `last` where it is nearer and its face counts.

    Ten arguments, and no tree: what is put into its caller with a tuple of arrays counts references to each of them.
    """
    for f in range(first, last):
        a, b = less(vertices, faces[f, 0], shift), less(vertices, faces[f, 1], shift)
        c = less(vertices, faces[f, 2], shift)
        if _box_distance2_of_face(p, a, b, c) <= best[0] * (1.0 + 1e-9):  # else it cannot be nearer, nor bar the way
            best = try_face(a, b, c, p, looks, cos_angle, kind, f, bound2, best)
    return best


@jit(nopython=True, cache=True, forceinline=True)
def try_face(a, b, c, p, looks, cos_angle, kind, f, bound2, best):  # type: ignore[no-untyped-def]
    """Return `best`, or the nearest point of face f with these corners where it is nearer and the face counts."""
    best2, face, best_b, best_c, best_feature, barred2 = best
    ab, ac = sub(b, a), sub(c, a)
    if kind != ANY:
        area = cross(ab, ac)
        same, area2 = dot(area, looks), dot(area, area)
        if same <= 0.0 or same * same < cos_angle * cos_angle * area2:
            return best2, face, best_b, best_c, best_feature, min(barred2, bound2)
        ap = sub(p, a)
        height = dot(area, ap)
        if height * height > area2 * (1.0001 * best2 + 1e-9 * dot(ap, ap)):  # its plane is farther, roundings or not
            return best
    weight_b, weight_c, feature = closest_on_triangle(p, a, b, c)
    away = sub(p, along(along(a, weight_b, ab), weight_c, ac))
    distance2 = dot(away, away)
    if distance2 < best2 or (distance2 == best2 and not 0 <= face <= f):
        return distance2, f, weight_b, weight_c, feature, barred2
    return best2, face, best_b, best_c, best_feature, barred2


@jit(nopython=True, cache=True, forceinline=True)
def _box_distance2_of_face(p, a, b, c):  # type: ignore[no-untyped-def]
    """Return the squared distance of p to the box around three corners; 0 inside."""
    x = max(max(min(min(a[0], b[0]), c[0]) - p[0], p[0] - max(max(a[0], b[0]), c[0])), 0.0)
    y = max(max(min(min(a[1], b[1]), c[1]) - p[1], p[1] - max(max(a[1], b[1]), c[1])), 0.0)
    z = max(max(min(min(a[2], b[2]), c[2]) - p[2], p[2] - max(max(a[2], b[2]), c[2])), 0.0)
    return x * x + y * y + z * z


@jit(nopython=True, cache=True)
def stands_over(tree, p, candidate):  # type: ignore[no-untyped-def]
    """Whether every face around the candidate's edge or vertex has its nearest point there too."""
    f, feature = candidate[1], candidate[4]
    if feature >= CORNER_A:
        return _stands_over_vertex(tree, p, tree.faces[f, feature - CORNER_A])
    if feature >= EDGE_AB:
        foot, _ = foot_on_face(tree.vertices, tree.faces, tree.shift, f, candidate[2], candidate[3])
        away = sub(p, foot)
        return _stands_over_edge(tree, away, f, feature - EDGE_AB)
    return True


@jit(nopython=True, cache=True)
def _stands_over_edge(tree, away, f, edge):  # type: ignore[no-untyped-def]
    """Whether the face across the edge has its nearest point on the edge too; `away` points from the foot to p."""
    other = face_across(tree, f, edge)
    if other < 0:
        return True  # a free edge: a foot, but one that tells nothing
    start, end = tree.faces[f, edge], tree.faces[f, (edge + 1) % 3]
    for k in range(3):
        v = tree.faces[other, k]
        if v not in (start, end):
            along_edge = sub(corner_of(tree, f, (edge + 1) % 3), corner_of(tree, f, edge))
            inward = sub(corner_of(tree, other, k), corner_of(tree, f, edge))
            length2 = dot(along_edge, along_edge)
            if length2 > 0.0:
                inward = along(inward, -dot(inward, along_edge) / length2, along_edge)
            return dot(away, inward) <= 1e-9 * np.sqrt(dot(away, away) * dot(inward, inward))
    return True


@jit(nopython=True, cache=True)
def _stands_over_vertex(tree, p, v):  # type: ignore[no-untyped-def]
    """Whether every face around vertex v has its nearest point there."""
    at = vertex_of(tree, v)
    away = sub(p, at)
    size2 = dot(away, away)
    for k in range(tree.star_starts[v], tree.star_starts[v + 1]):
        for corner in range(3):
            side = sub(corner_of(tree, tree.star_faces[k], corner), at)
            if dot(away, side) > 1e-9 * np.sqrt(size2 * dot(side, side)):
                return False
    return True


@jit(nopython=True, cache=True)
def is_way_crossed(tree, p, foot, stack):  # type: ignore[no-untyped-def]
    """Whether the way from p to its foot crosses the surface before it gets there."""
    return first_crossing(tree, p, sub(foot, p), (1e-6, 1.0 - 1e-6), stack) >= 0


@jit(nopython=True, cache=True)
def first_crossing(tree, p, direction, between, stack):  # type: ignore[no-untyped-def]
    """Return the face, in the tree's order, that the way from p to p + direction crosses first, -1 for none, from the
    first of the shares `between` of it to before the second."""
    n_inner, n_faces = tree.n_leaves - 1, len(tree.faces)
    face, nearest = -1, between[1]
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
        first = leaf_of_node(tree.deepest, tree.n_leaves, node) * FACES_PER_LEAF
        for f in range(first, min(first + FACES_PER_LEAF, n_faces)):
            t = crosses_triangle(p, direction, corner_of(tree, f, 0), corner_of(tree, f, 1), corner_of(tree, f, 2))
            if between[0] <= t < nearest:
                face, nearest = f, t
    return face


@jit(nopython=True, cache=True)
def _meets_box(p, direction, nodes, i):  # type: ignore[no-untyped-def]
    """Whether the segment p to p + direction touches the box of node i."""
    for k in range(3):
        if min(p[k], p[k] + direction[k]) > nodes[i, 3 + k] or max(p[k], p[k] + direction[k]) < nodes[i, k]:
            return False
    enter, leave = 0.0, 1.0
    for k in range(3):
        if direction[k] != 0.0:
            t0, t1 = (nodes[i, k] - p[k]) / direction[k], (nodes[i, 3 + k] - p[k]) / direction[k]
            enter, leave = max(enter, min(t0, t1)), min(leave, max(t0, t1))
    return enter <= leave
