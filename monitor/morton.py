"""The order of places along a Morton curve: what lies beside each other in space comes after each other in memory."""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.boxes import box_of
from monitor.ordering import stable_order
from monitor.threads import run_tasks
from projects.model import Floats, Ints

BITS = 11  # an axis: 2048 cells along the longest side
ORIGIN = np.zeros(3)
Cells = tuple[Floats, float]  # of a grid: low corner (3,) [m], cells per metre


def point_order(points: Floats) -> Ints:
    """Return the order (n,) of points (n, 3) along the curve through their box; those of one cell keep their order."""
    low, scale = cells_of(points)
    codes = np.empty(len(points), dtype=np.uint64)
    run_tasks(_point_codes, len(points), points, low, scale, codes)
    return stable_order(codes.view(np.int64)).astype(np.int32)


def face_order(vertices: Floats, faces: Ints, shift: Floats = ORIGIN, cells: Cells | None = None) -> Ints:
    """Return the order (m,) of faces (m, 3) along the curve, by their centres in coordinates less `shift` (3,).

    `cells` are those of the box of the vertices where left out; faces that are part of a surface keep the order that
    they have among all with those of its box.
    """
    low, scale = cells_of(vertices, shift) if cells is None else cells
    codes = np.empty(len(faces), dtype=np.uint64)
    run_tasks(_face_codes, len(faces), vertices, faces, shift, low, scale, codes)
    return stable_order(codes.view(np.int64)).astype(np.int32)


def cells_of(points: Floats, shift: Floats | float = 0.0) -> Cells:
    """Return the low corner of the box (3,) of points (n, 3) less `shift`, and cells per metre."""
    if not len(points):
        return np.zeros(3), 0.0
    low, high = box_of(points)
    low, high = low - shift, high - shift
    return low, (2**BITS - 1) / max(float((high - low).max()), 1e-300)


@jit(nopython=True, cache=True, forceinline=True)
def _spread(cell):  # type: ignore[no-untyped-def]
    """Return the bits of a cell number with two zeros between neighbours (Morton 1966)."""
    cell = np.uint64(cell)
    cell = (cell | (cell << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
    cell = (cell | (cell << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
    cell = (cell | (cell << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    cell = (cell | (cell << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (cell | (cell << np.uint64(2))) & np.uint64(0x1249249249249249)


@jit(nopython=True, cache=True, nogil=True)
def _point_codes(first, last, points, low, scale, codes):  # type: ignore[no-untyped-def]
    """Write the Morton codes of the points `first` to `last`, in cells of 1 / `scale` [m] from `low` on."""
    for i in range(first, last):
        x, y, z = points[i, 0] - low[0], points[i, 1] - low[1], points[i, 2] - low[2]
        codes[i] = _spread(x * scale) | _spread(y * scale) << np.uint64(1) | _spread(z * scale) << np.uint64(2)


@jit(nopython=True, cache=True, forceinline=True)
def _middle(a, b, c, shift):  # type: ignore[no-untyped-def]
    """Return the mean of three coordinates, taken about `shift` first."""
    return ((a - shift) + (b - shift) + (c - shift)) / 3.0


@jit(nopython=True, cache=True, nogil=True)
def _face_codes(first, last, vertices, faces, shift, low, scale, codes):  # type: ignore[no-untyped-def]
    """Write the Morton codes of the middles of the faces `first` to `last`, as `_point_codes` does."""
    for f in range(first, last):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        x = _middle(vertices[a, 0], vertices[b, 0], vertices[c, 0], shift[0]) - low[0]
        y = _middle(vertices[a, 1], vertices[b, 1], vertices[c, 1], shift[1]) - low[1]
        z = _middle(vertices[a, 2], vertices[b, 2], vertices[c, 2], shift[2]) - low[2]
        codes[f] = _spread(max(x, 0.0) * scale) | _spread(max(y, 0.0) * scale) << np.uint64(1) | _spread(
            max(z, 0.0) * scale) << np.uint64(2)  # fmt: skip
