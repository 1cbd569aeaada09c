"""Faces of a mesh that cut or touch each other elsewhere than in a shared edge or vertex.

In: vertices (n, 3), faces (m, 3). Out: pairs of faces. Candidates come from a tree of boxes over the faces in Morton
order; most share a vertex around which no two faces meet (`fans.py`), a plane that separates two faces settles nearly
all others, exact predicates the rest.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit

from monitor.morton import face_order
from monitor.reconstruction.beside import mark_beside
from monitor.reconstruction.fans import find_fans
from monitor.reconstruction.predicates import exact_room, side_of_line, side_of_plane
from monitor.threads import run_tasks
from monitor.tuples import cross, dot, sub
from projects.model import Bools, Floats, Ints

FACES_PER_LEAF = 4
DEPTH = 96  # of the stack: two entries a level
MANY = 8  # suspects among so many faces or fewer are worth a look around all vertices
CLEARLY = 1e-12  # of the largest product: heights above a plane beyond it are no rounding errors


def find_intersections(vertices: Floats, faces: Ints, suspects: Bools | None = None) -> Ints:
    """Return the pairs of faces (k, 2) that meet elsewhere than in an edge or vertex they share, sorted.

    Faces that touch count as meeting; so do two that share an edge and lie on one another, and doubled faces. Of
    `suspects` (m,), where given, each pair holds one at least. The answer is exact for the coordinates given, and the
    same for any number of threads.
    """
    if len(faces) < 2:
        return np.empty((0, 2), np.int64)
    vertices, faces = np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(faces, dtype=np.int64)
    if suspects is None:
        suspects = np.ones(len(faces), np.bool_)
    elif MANY * np.count_nonzero(suspects) < len(faces):
        near = np.flatnonzero(mark_beside(vertices, faces, np.asarray(suspects, np.bool_)))
        return near[_find_pairs(vertices, faces[near], suspects[near], np.zeros(len(vertices), np.bool_))]
    return _find_pairs(vertices, faces, np.asarray(suspects, np.bool_), find_fans(vertices, faces))


def _find_pairs(vertices: Floats, faces: Ints, suspects: Bools, is_fan: Bools) -> Ints:
    """Return the pairs of faces (k, 2) that meet, sorted; of vertices that are fans no two faces are looked at."""
    if len(faces) < 2:
        return np.empty((0, 2), np.int64)
    order = face_order(vertices, faces)
    mesh, is_suspect = _tree_of(vertices, faces.take(order, axis=0), is_fan), suspects[order]
    leaves = np.flatnonzero(np.logical_or.reduceat(is_suspect, np.arange(0, len(faces), FACES_PER_LEAF)))
    counts, every = np.zeros(len(leaves), np.int64), bool(is_suspect.all())
    nowhere = np.zeros(len(leaves), np.int64), np.empty((0, 2), np.int64)
    run_tasks(_search, len(leaves), mesh, is_suspect, every, leaves, nowhere[0], counts, nowhere[1])
    hit = np.flatnonzero(counts)
    starts = np.append(0, np.cumsum(counts[hit]))
    pairs = np.empty((starts[-1], 2), np.int64)
    if len(hit):
        run_tasks(_search, len(hit), mesh, is_suspect, every, leaves[hit], starts[:-1], counts, pairs)
    named = np.sort(order[pairs].astype(np.int64), axis=1)
    return named[np.lexsort((named[:, 1], named[:, 0]))]


class Tree(NamedTuple):
    """A mesh with faces in order along a curve, and a complete tree of boxes over groups of them.

    Of the 2 n - 1 boxes 2 i + 1 and 2 i + 2 follow i; the last n are the leaves.
    """

    vertices: Floats  # (k, 3)
    faces: Ints  # (m, 3)
    is_fan: Bools  # (k,) vertices around which no two faces meet, see `find_fans`
    face_boxes: Floats  # (m, 6)
    boxes: Floats  # (2 n - 1, 6)
    n_leaves: int


def _tree_of(vertices: Floats, faces: Ints, is_fan: Bools) -> Tree:
    """Return the tree over faces in their order; a leaf beyond the last face is a box that none meets."""
    n_leaves = 1 << max(int(np.ceil(np.log2(len(faces) / FACES_PER_LEAF))), 0)
    face_boxes = np.empty((len(faces), 6))
    run_tasks(_box_faces, len(faces), vertices, faces, face_boxes)
    return Tree(vertices, faces, is_fan, face_boxes, _boxes_over(face_boxes, n_leaves), n_leaves)


@jit(nopython=True, cache=True, nogil=True)
def _box_faces(first: int, last: int, vertices: Floats, faces: Ints, boxes: Floats) -> None:
    """Write the lowest and highest coordinates of the faces `first` to `last`, for `run_tasks`."""
    for f in range(first, last):
        for axis in range(3):
            x, y, z = vertices[faces[f, 0], axis], vertices[faces[f, 1], axis], vertices[faces[f, 2], axis]
            boxes[f, axis], boxes[f, 3 + axis] = min(x, y, z), max(x, y, z)


@jit(nopython=True, cache=True)
def _boxes_over(face_boxes: Floats, n_leaves: int) -> Floats:
    """Boxes (2 n - 1, 6) of all nodes of a tree with n leaves."""
    boxes = np.empty((2 * n_leaves - 1, 6))
    boxes[:, :3], boxes[:, 3:] = np.inf, -np.inf
    for f in range(len(face_boxes)):
        _widen(boxes[n_leaves - 1 + f // FACES_PER_LEAF], face_boxes[f])
    for node in range(2 * n_leaves - 2, 0, -1):
        _widen(boxes[(node - 1) // 2], boxes[node])
    return boxes


@jit(nopython=True, cache=True)
def _widen(box: Floats, other: Floats) -> None:
    """Let a box hold another too."""
    for axis in range(3):
        box[axis], box[3 + axis] = min(box[axis], other[axis]), max(box[3 + axis], other[3 + axis])


@jit(nopython=True, cache=True)
def _corner(vertices: Any, faces: Any, f: int, k: int) -> Any:
    """Corner k of face f as a tuple."""
    v = faces[f, k]
    return (vertices[v, 0], vertices[v, 1], vertices[v, 2])


@jit(nopython=True, cache=True)
def _separates(direction: Any, one: Any, other: Any, n_shared: int, size: float) -> bool:
    """Whether all corners but the first `n_shared` lie clearly on different sides of a plane across `direction`.

    The plane goes through the shared corners, which come first, or between the two triangles where none is shared.
    """
    margin = CLEARLY * size * np.sqrt(dot(direction, direction))
    low1, high1, low2, high2 = np.inf, -np.inf, np.inf, -np.inf
    for k in range(n_shared, 3):
        h1, h2 = dot(direction, sub(one[k], one[0])), dot(direction, sub(other[k], one[0]))
        low1, high1, low2, high2 = min(low1, h1), max(high1, h1), min(low2, h2), max(high2, h2)
    if n_shared:
        return (low1 > margin and high2 < -margin) or (low2 > margin and high1 < -margin)
    return low1 > high2 + margin or low2 > high1 + margin


@jit(nopython=True, cache=True)
def _way_apart(one: Any, other: Any, n_shared: int) -> Any:
    """Direction from the middle of one triangle to that of the other, across the edge if they share one."""
    x, y, z = 0.0, 0.0, 0.0
    for k in range(3):
        x, y, z = x + (other[k][0] - one[k][0]), y + (other[k][1] - one[k][1]), z + (other[k][2] - one[k][2])
    if n_shared == 2:
        edge = sub(one[1], one[0])
        length2 = dot(edge, edge)
        along = dot((x, y, z), edge) / length2 if length2 > 0.0 else 0.0
        return (x - along * edge[0], y - along * edge[1], z - along * edge[2])
    return (x, y, z)


@jit(nopython=True, cache=True)
def clearly_apart(one: Any, other: Any, n_shared: int) -> bool:
    """Whether a plane is found that separates two triangles but for the corners they share; False leaves it open.

    First the one across the way from one to the other is tried, which neighbours on a smooth surface do not cross.
    """
    size = 0.0
    for k in range(3):
        for axis in range(3):
            size = max(size, abs(one[k][axis] - one[0][axis]), abs(other[k][axis] - one[0][axis]))
    if _separates(_way_apart(one, other, n_shared), one, other, n_shared, size):
        return True
    normal1 = cross(sub(one[1], one[0]), sub(one[2], one[0]))
    normal2 = cross(sub(other[1], other[0]), sub(other[2], other[0]))
    if n_shared == 0:
        for normal in (normal1, normal2):
            if _separates(normal, one, other, n_shared, size):
                return True
    for k in range(3):
        last = 1 if n_shared == 2 else 3  # only the planes through the shared edge can separate then
        if k >= last:
            break
        edge1, edge2 = sub(one[(k + 1) % 3], one[k]), sub(other[(k + 1) % 3], other[k])
        if _separates(cross(normal1, edge1), one, other, n_shared, size):
            return True
        if _separates(cross(normal2, edge2), one, other, n_shared, size):
            return True
    return False


@jit(nopython=True, cache=True)
def _flat_axes(a: Any, b: Any, c: Any) -> Any:
    """The two axes of the plane on which the triangle is largest."""
    normal = cross(sub(b, a), sub(c, a))
    x, y, z = abs(normal[0]), abs(normal[1]), abs(normal[2])
    if x >= y and x >= z:
        return 1, 2
    return (2, 0) if y >= z else (0, 1)


@jit(nopython=True, cache=True)
def _segments_meet(p: Any, q: Any, a: Any, b: Any, u: int, v: int, parts: Any) -> bool:
    """Whether two segments of one plane have a point in common."""
    s1, s2 = side_of_line(p, q, a, u, v, parts), side_of_line(p, q, b, u, v, parts)
    s3, s4 = side_of_line(a, b, p, u, v, parts), side_of_line(a, b, q, u, v, parts)
    if s1 == 0 and s2 == 0:
        for axis in (u, v):
            if max(p[axis], q[axis]) < min(a[axis], b[axis]) or max(a[axis], b[axis]) < min(p[axis], q[axis]):
                return False
        return True
    return s1 * s2 <= 0 and s3 * s4 <= 0


@jit(nopython=True, cache=True)
def segment_meets_triangle(p: Any, q: Any, a: Any, b: Any, c: Any, parts: Any) -> bool:
    """Whether a segment and a triangle, both with their borders, have a point in common; exact."""
    start, end = side_of_plane(a, b, c, p, parts), side_of_plane(a, b, c, q, parts)
    if start * end > 0:
        return False
    if start == 0 and end == 0:
        u, v = _flat_axes(a, b, c)
        s1, s2 = side_of_line(a, b, p, u, v, parts), side_of_line(b, c, p, u, v, parts)
        s3 = side_of_line(c, a, p, u, v, parts)
        if (s1 >= 0 and s2 >= 0 and s3 >= 0) or (s1 <= 0 and s2 <= 0 and s3 <= 0):
            return True
        return (
            _segments_meet(p, q, a, b, u, v, parts)
            or _segments_meet(p, q, b, c, u, v, parts)
            or _segments_meet(p, q, c, a, u, v, parts)
        )
    s1, s2 = side_of_plane(p, q, a, b, parts), side_of_plane(p, q, b, c, parts)
    if s1 * s2 < 0:
        return False
    s3 = side_of_plane(p, q, c, a, parts)
    return (s1 >= 0 and s2 >= 0 and s3 >= 0) or (s1 <= 0 and s2 <= 0 and s3 <= 0)


@jit(nopython=True, cache=True)
def _lie_on_one_another(one: Any, other: Any, parts: Any) -> bool:
    """Whether two triangles that share their first two corners lie in one plane on the same side of that edge."""
    if side_of_plane(one[0], one[1], one[2], other[2], parts) != 0:
        return False
    u, v = _flat_axes(one[0], one[1], one[2])
    here = side_of_line(one[0], one[1], one[2], u, v, parts)
    return here * side_of_line(one[0], one[1], other[2], u, v, parts) >= 0


@jit(nopython=True, cache=True)
def triangles_meet(one: Any, other: Any, n_shared: int, parts: Any) -> bool:
    """Whether two triangles meet elsewhere than in the `n_shared` corners, which come first in both; exact."""
    if n_shared == 3:
        return True
    if clearly_apart(one, other, n_shared):
        return False
    if n_shared == 2:
        return _lie_on_one_another(one, other, parts)
    if n_shared == 1:
        return segment_meets_triangle(one[1], one[2], other[0], other[1], other[2], parts) or segment_meets_triangle(
            other[1], other[2], one[0], one[1], one[2], parts
        )
    for k in range(3):
        m = (k + 1) % 3
        if segment_meets_triangle(one[k], one[m], other[0], other[1], other[2], parts):
            return True
        if segment_meets_triangle(other[k], other[m], one[0], one[1], one[2], parts):
            return True
    return False


@jit(nopython=True, cache=True)
def faces_meet(vertices: Any, faces: Any, f: int, g: int, parts: Any) -> bool:
    """Whether two faces meet elsewhere than in what they share."""
    n_shared, in_f, in_g = np.int64(0), 0, 0  # bits: corners that are shared
    first_f, first_g, second_f, second_g = 0, 0, 0, 0
    for i in range(3):
        for j in range(3):
            if faces[f, i] == faces[g, j]:
                if n_shared == 0:
                    first_f, first_g = i, j
                else:
                    second_f, second_g = i, j
                in_f |= 1 << i
                in_g |= 1 << j
                n_shared += 1
    if n_shared >= 3:
        return True
    if n_shared < 2:
        second_f, second_g = (first_f + 1) % 3, (first_g + 1) % 3
    third_f, third_g = 3 - first_f - second_f, 3 - first_g - second_g
    one = (_corner(vertices, faces, f, first_f), _corner(vertices, faces, f, second_f),
           _corner(vertices, faces, f, third_f))  # fmt: skip
    other = (_corner(vertices, faces, g, first_g), _corner(vertices, faces, g, second_g),
             _corner(vertices, faces, g, third_g))  # fmt: skip
    return triangles_meet(one, other, n_shared, parts)


@jit(nopython=True, cache=True)
def _boxes_meet(boxes: Any, i: int, others: Any, j: int) -> bool:
    """Return whether box i (least and greatest coordinates) and box j of the others touch."""
    x = (boxes[i, 0] <= others[j, 3]) & (boxes[i, 3] >= others[j, 0])  # all six at once: no branch to guess
    y = (boxes[i, 1] <= others[j, 4]) & (boxes[i, 4] >= others[j, 1])
    z = (boxes[i, 2] <= others[j, 5]) & (boxes[i, 5] >= others[j, 2])
    return x & y & z


@jit(nopython=True, cache=True)
def _share_a_fan(mesh: Any, f: int, g: int) -> bool:
    """Whether two faces share a vertex of which it is known that no two faces around it meet elsewhere."""
    shared = False
    for i in range(3):
        v = mesh.faces[f, i]
        shared |= mesh.is_fan[v] & ((v == mesh.faces[g, 0]) | (v == mesh.faces[g, 1]) | (v == mesh.faces[g, 2]))
    return shared


@jit(nopython=True, cache=True)
def _push_beside(mesh: Any, leaf: int, later_only: bool, stack: Any) -> int:
    """Push a leaf and all subtrees beside its way up that its box meets, or only the later ones; how many these are."""
    stack[0], top, node = leaf, 1, leaf
    while node > 0:
        is_first = node % 2 == 1
        stack[top] = node + 1 if is_first else node - 1
        top += (is_first or not later_only) and _boxes_meet(mesh.boxes, stack[top], mesh.boxes, leaf)
        node = (node - 1) // 2
    return top


@jit(nopython=True, cache=True)
def _meetings(
    mesh: Any, is_suspect: Any, later_only: bool, leaf: int, stack: Any, parts: Any, first: int, pairs: Any
) -> int:
    """Pairs of a suspect face of a leaf and one it meets, of two suspects once: their number.

    Where all are suspects those of later leaves are enough (`later_only`).
    They are written to `pairs` from row `first` on, as far as it goes.
    """
    own, n = mesh.n_leaves - 1 + leaf, 0
    begin, end = leaf * FACES_PER_LEAF, min((leaf + 1) * FACES_PER_LEAF, len(mesh.faces))
    top = _push_beside(mesh, own, later_only, stack)
    while top > 0:
        top -= 1
        node = stack[top]
        if node < mesh.n_leaves - 1:
            for child in (2 * node + 1, 2 * node + 2):
                stack[top] = child
                top += _boxes_meet(mesh.boxes, child, mesh.boxes, own)
            continue
        there = (node - (mesh.n_leaves - 1)) * FACES_PER_LEAF
        for f in range(begin, end):
            if not is_suspect[f] or not _boxes_meet(mesh.face_boxes, f, mesh.boxes, node):
                continue
            for g in range(there, min(there + FACES_PER_LEAF, len(mesh.faces))):
                if g == f or (g < f and is_suspect[g]) or not _boxes_meet(mesh.face_boxes, f, mesh.face_boxes, g):
                    continue
                if _share_a_fan(mesh, f, g):
                    continue
                if faces_meet(mesh.vertices, mesh.faces, f, g, parts):
                    if first + n < len(pairs):
                        pairs[first + n, 0], pairs[first + n, 1] = f, g
                    n += 1
    return n


@jit(nopython=True, cache=True, nogil=True)
def _search(
    first: int, last: int, mesh: Any, is_suspect: Any, later_only: bool, leaves: Any, starts: Any, counts: Any,
    pairs: Any,
) -> None:  # fmt: skip
    """Count the pairs of `leaves[first:last]`, and write them to `pairs` from `starts` on as far as it goes."""
    stack, parts = np.empty(DEPTH, np.int64), exact_room()
    for k in range(first, last):
        counts[k] = _meetings(mesh, is_suspect, later_only, leaves[k], stack, parts, starts[k], pairs)
