"""The order of places along a Morton curve: what lies beside each other in space comes after each other in memory."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

from projects.model import Floats, Ints

BITS = 11  # an axis: 2048 cells along the longest side
Cells = tuple[Floats, float]  # of a grid: low corner (3,) [m], cells per metre
DIGIT = 11  # bits sorted by at once; three times make a code


def point_order(points: Floats) -> Ints:
    """Return the order (n,) of points (n, 3) along the curve through their box; those of one cell keep their order."""
    low, scale = cells_of(points)
    return np.asarray(_sort_codes(_point_codes(points, low, scale)))


def face_order(vertices: Floats, faces: Ints, shift: Floats, cells: Cells | None = None) -> Ints:
    """Return the order (m,) of faces (m, 3) along the curve, by their centres in coordinates less `shift` (3,).

    `cells` are those of the box of the vertices where left out; faces that are part of a surface keep the order that
    they have among all with those of its box.
    """
    low, scale = cells_of(vertices, shift) if cells is None else cells
    return np.asarray(_sort_codes(_face_codes(vertices, faces, shift, low, scale)))


def cells_of(points: Floats, shift: Floats | float = 0.0) -> Cells:
    """Return the low corner of the box (3,) of points (n, 3) less `shift`, and cells per metre."""
    if not len(points):
        return np.zeros(3), 0.0
    low, high = points.min(axis=0) - shift, points.max(axis=0) - shift
    return low, (2**BITS - 1) / max(float((high - low).max()), 1e-300)


@jit(nopython=True, cache=True)
def _spread(cell):  # type: ignore[no-untyped-def]
    """Return the bits of a cell number with two zeros between neighbours (Morton 1966)."""
    cell = np.uint64(cell)
    cell = (cell | (cell << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
    cell = (cell | (cell << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
    cell = (cell | (cell << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    cell = (cell | (cell << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (cell | (cell << np.uint64(2))) & np.uint64(0x1249249249249249)


@jit(nopython=True, cache=True)
def _point_codes(points, low, scale):  # type: ignore[no-untyped-def]
    codes = np.empty(len(points), dtype=np.uint64)
    for i in range(len(points)):
        x, y, z = points[i, 0] - low[0], points[i, 1] - low[1], points[i, 2] - low[2]
        codes[i] = _spread(x * scale) | _spread(y * scale) << np.uint64(1) | _spread(z * scale) << np.uint64(2)
    return codes


@jit(nopython=True, cache=True)
def _middle(a, b, c, shift):  # type: ignore[no-untyped-def]
    return ((a - shift) + (b - shift) + (c - shift)) / 3.0


@jit(nopython=True, cache=True)
def _face_codes(vertices, faces, shift, low, scale):  # type: ignore[no-untyped-def]
    codes = np.empty(len(faces), dtype=np.uint64)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        x = _middle(vertices[a, 0], vertices[b, 0], vertices[c, 0], shift[0]) - low[0]
        y = _middle(vertices[a, 1], vertices[b, 1], vertices[c, 1], shift[1]) - low[1]
        z = _middle(vertices[a, 2], vertices[b, 2], vertices[c, 2], shift[2]) - low[2]
        codes[f] = _spread(max(x, 0.0) * scale) | _spread(max(y, 0.0) * scale) << np.uint64(1) | _spread(
            max(z, 0.0) * scale) << np.uint64(2)  # fmt: skip
    return codes


@jit(nopython=True, cache=True)
def _sort_codes(codes: Any) -> Any:
    """Return the stable order of the codes, digit by digit from the lowest."""
    n, mask = len(codes), np.uint64((1 << DIGIT) - 1)
    order, following = np.arange(n).astype(np.int32), np.empty(n, dtype=np.int32)
    starts = np.empty((1 << DIGIT) + 1, dtype=np.int64)
    for digit in range(3 * BITS // DIGIT):
        shift = np.uint64(digit * DIGIT)
        starts[:] = 0
        for i in range(n):
            starts[np.int64(codes[i] >> shift & mask) + 1] += 1
        for b in range(1 << DIGIT):
            starts[b + 1] += starts[b]
        for i in range(n):
            at = np.int64(codes[order[i]] >> shift & mask)
            following[starts[at]] = order[i]
            starts[at] += 1
        order, following = following, order
    return order
