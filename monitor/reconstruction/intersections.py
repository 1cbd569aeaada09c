"""Faces of a mesh that cut or touch each other elsewhere than in a shared edge or vertex.

In: vertices (n, 3), faces (m, 3). Out: pairs of faces. Candidates come from a tree of boxes over the faces in Morton
order; a plane that separates two faces settles nearly all of them, exact predicates the rest.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit, prange

from monitor.reconstruction.predicates import exact_room, side_of_line, side_of_plane
from projects.model import Bools, Floats, Ints

FACES_PER_LEAF = 4
DEPTH = 96  # of the stack: two entries a level
CHUNK = 1024  # faces a thread takes at a time
CLEARLY = 1e-12  # of the largest product: heights above a plane beyond it are no rounding errors


def find_intersections(vertices: Floats, faces: Ints, suspects: Bools | None = None) -> Ints:
    """Return the pairs of faces (k, 2) that meet elsewhere than in an edge or vertex they share, sorted.

    Faces that touch count as meeting; so do two that share an edge and lie on one another, and doubled faces. Of
    `suspects` (m,), where given, each pair holds one at least. The answer is exact for the coordinates given, and the
    same for any number of threads.
    """
    if len(faces) < 2:
        return np.empty((0, 2), np.int64)
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    order = np.argsort(_along_curve(vertices[faces].mean(axis=1)), kind="stable")
    ordered = np.ascontiguousarray(faces[order], dtype=np.int64)
    boxes, n_leaves = _box_tree(vertices, ordered)
    is_suspect = np.ones(len(faces), np.bool_) if suspects is None else np.asarray(suspects, np.bool_)[order]
    counts = np.zeros(len(faces), np.int64)
    _count(vertices, ordered, boxes, n_leaves, is_suspect, counts)
    hit = np.flatnonzero(counts)
    starts = np.append(0, np.cumsum(counts[hit]))
    pairs = np.empty((starts[-1], 2), np.int64)
    _collect(vertices, ordered, boxes, n_leaves, is_suspect, hit, starts, pairs)
    named = np.sort(order[pairs], axis=1)
    return named[np.lexsort((named[:, 1], named[:, 0]))]


def _along_curve(places: Floats) -> Ints:
    """Return the position of each place (n, 3) on a Morton curve, 10 bits an axis."""
    low = places.min(axis=0)
    extent = max(float((places.max(axis=0) - low).max()), 1e-300)
    cells = ((places - low) * (1023.0 / extent)).astype(np.int64)
    code = np.zeros(len(places), np.int64)
    for axis in range(3):
        spread = cells[:, axis]
        for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
            spread = (spread | (spread << shift)) & mask
        code |= spread << axis
    return code


def _box_tree(vertices: Floats, faces: Ints) -> tuple[Floats, int]:
    """Return boxes (2 n - 1, 6) of a complete tree over faces in order and its n leaves; 2 i + 1, 2 i + 2 follow i."""
    n_leaves = 1 << max(int(np.ceil(np.log2(len(faces) / FACES_PER_LEAF))), 0)
    boxes = np.empty((2 * n_leaves - 1, 6))
    bounds = np.arange(n_leaves + 1) * len(faces) // n_leaves
    corner = vertices[faces]
    boxes[n_leaves - 1 :, :3] = np.minimum.reduceat(corner.min(axis=1), bounds[:-1])
    boxes[n_leaves - 1 :, 3:] = np.maximum.reduceat(corner.max(axis=1), bounds[:-1])
    first = n_leaves - 1
    while first > 0:
        children, first = boxes[first : 2 * first + 1], first // 2
        boxes[first : first + len(children) // 2, :3] = np.minimum(children[::2, :3], children[1::2, :3])
        boxes[first : first + len(children) // 2, 3:] = np.maximum(children[::2, 3:], children[1::2, 3:])
    return boxes, n_leaves


@jit(nopython=True, cache=True)
def _corner(vertices: Any, faces: Any, f: int, k: int) -> Any:
    """Corner k of face f as a tuple."""
    v = faces[f, k]
    return (vertices[v, 0], vertices[v, 1], vertices[v, 2])


@jit(nopython=True, cache=True)
def _minus(a: Any, b: Any) -> Any:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@jit(nopython=True, cache=True)
def _dot(a: Any, b: Any) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit(nopython=True, cache=True)
def _cross(a: Any, b: Any) -> Any:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@jit(nopython=True, cache=True)
def _separates(direction: Any, one: Any, other: Any, n_shared: int, size: float) -> bool:
    """Whether all corners but the first `n_shared` lie clearly on different sides of a plane across `direction`.

    The plane goes through the shared corners, which come first, or between the two triangles where none is shared.
    """
    margin = CLEARLY * size * np.sqrt(_dot(direction, direction))
    low1, high1, low2, high2 = np.inf, -np.inf, np.inf, -np.inf
    for k in range(n_shared, 3):
        h1, h2 = _dot(direction, _minus(one[k], one[0])), _dot(direction, _minus(other[k], one[0]))
        low1, high1, low2, high2 = min(low1, h1), max(high1, h1), min(low2, h2), max(high2, h2)
    if n_shared:
        return (low1 > margin and high2 < -margin) or (low2 > margin and high1 < -margin)
    return low1 > high2 + margin or low2 > high1 + margin


@jit(nopython=True, cache=True)
def clearly_apart(one: Any, other: Any, n_shared: int) -> bool:
    """Whether a plane is found that separates two triangles but for the corners they share; False leaves it open."""
    size = 0.0
    for k in range(3):
        for axis in range(3):
            size = max(size, abs(one[k][axis] - one[0][axis]), abs(other[k][axis] - one[0][axis]))
    normal1 = _cross(_minus(one[1], one[0]), _minus(one[2], one[0]))
    normal2 = _cross(_minus(other[1], other[0]), _minus(other[2], other[0]))
    if n_shared == 0 and (_separates(normal1, one, other, 0, size) or _separates(normal2, one, other, 0, size)):
        return True
    for k in range(3):
        last = 1 if n_shared == 2 else 3  # only the planes through the shared edge can separate then
        if k >= last:
            break
        edge1, edge2 = _minus(one[(k + 1) % 3], one[k]), _minus(other[(k + 1) % 3], other[k])
        if _separates(_cross(normal1, edge1), one, other, n_shared, size):
            return True
        if _separates(_cross(normal2, edge2), one, other, n_shared, size):
            return True
    return False


@jit(nopython=True, cache=True)
def _flat_axes(a: Any, b: Any, c: Any) -> Any:
    """The two axes of the plane on which the triangle is largest."""
    normal = _cross(_minus(b, a), _minus(c, a))
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
    n_shared, in_f, in_g = 0, 0, 0  # bits: corners that are shared
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
def _boxes_meet(boxes: Any, node: int, low: Any, high: Any) -> bool:
    x = boxes[node, 0] <= high[0] and boxes[node, 3] >= low[0]
    y = boxes[node, 1] <= high[1] and boxes[node, 4] >= low[1]
    z = boxes[node, 2] <= high[2] and boxes[node, 5] >= low[2]
    return x and y and z


@jit(nopython=True, cache=True)
def _partners(
    vertices: Any, faces: Any, boxes: Any, n_leaves: int, is_suspect: Any, f: int, stack: Any, parts: Any, out: Any
) -> int:
    """Faces that meet face f, of suspects the later ones only: their number; written to `out` as far as it goes."""
    a, b, c = _corner(vertices, faces, f, 0), _corner(vertices, faces, f, 1), _corner(vertices, faces, f, 2)
    low = (min(a[0], b[0], c[0]), min(a[1], b[1], c[1]), min(a[2], b[2], c[2]))
    high = (max(a[0], b[0], c[0]), max(a[1], b[1], c[1]), max(a[2], b[2], c[2]))
    n, top = 0, 1
    stack[0] = 0
    while top > 0:
        top -= 1
        node = stack[top]
        if not _boxes_meet(boxes, node, low, high):
            continue
        if node < n_leaves - 1:
            stack[top], stack[top + 1] = 2 * node + 1, 2 * node + 2
            top += 2
            continue
        leaf = node - (n_leaves - 1)
        for g in range(leaf * len(faces) // n_leaves, (leaf + 1) * len(faces) // n_leaves):
            if g == f or (g < f and is_suspect[g]):
                continue
            if _box_of_face_meets(vertices, faces, g, low, high) and faces_meet(vertices, faces, f, g, parts):
                if n < len(out):
                    out[n] = g
                n += 1
    return n


@jit(nopython=True, cache=True)
def _box_of_face_meets(vertices: Any, faces: Any, g: int, low: Any, high: Any) -> bool:
    for axis in range(3):
        x, y, z = vertices[faces[g, 0], axis], vertices[faces[g, 1], axis], vertices[faces[g, 2], axis]
        if min(x, y, z) > high[axis] or max(x, y, z) < low[axis]:
            return False
    return True


@jit(nopython=True, cache=True, parallel=True)
def _count(vertices: Any, faces: Any, boxes: Any, n_leaves: int, is_suspect: Any, counts: Any) -> None:
    for chunk in prange((len(faces) + CHUNK - 1) // CHUNK):
        stack, parts, nowhere = np.empty(DEPTH, np.int64), exact_room(), np.empty(0, np.int64)
        for f in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(faces))):
            if is_suspect[f]:
                counts[f] = _partners(vertices, faces, boxes, n_leaves, is_suspect, f, stack, parts, nowhere)


@jit(nopython=True, cache=True)
def _collect(
    vertices: Any, faces: Any, boxes: Any, n_leaves: int, is_suspect: Any, hit: Any, starts: Any, pairs: Any
) -> None:
    stack, parts = np.empty(DEPTH, np.int64), exact_room()
    for k in range(len(hit)):
        pairs[starts[k] : starts[k + 1], 0] = hit[k]
        room = pairs[starts[k] : starts[k + 1], 1]
        _partners(vertices, faces, boxes, n_leaves, is_suspect, hit[k], stack, parts, room)
