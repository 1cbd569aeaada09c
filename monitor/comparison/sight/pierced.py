"""Whether a station's beams went through a part of a surface, or only past it on both sides.

In: points of the surface that everything measured about their direction lies behind, and where the beams went. Out: a
mask of points. A rod or a rail thinner than the steps of a scan may stand between its beams, and all of them go on to
what is behind, though it is there.
"""

from __future__ import annotations

import math

import numpy as np
from numba import jit

from monitor.comparison.distances.mesh_tree import MeshTree
from monitor.comparison.distances.search import DEPTH, is_way_crossed
from monitor.comparison.sight.directions import MIDDLE, SUB_CELLS, Bits, face_angles
from monitor.threads import run_tasks
from monitor.tuples import along
from projects.model import Bools, Floats

MIDMOST = (4, 1, 3, 5, 7, 0, 2, 6, 8)  # of nine cells about a point, row by row: the nearest first


def find_pierced(origin: Floats, cell: float, tree: MeshTree, points: Floats, margins: Floats, bits: Bits) -> Bools:
    """Return which points (n, 3) have a beam of the station at `origin` beside them that went through the surface.

    It went through where it, and ways half a step on all sides of it, cross the surface no more than `margins` (n,) [m]
    before or behind the point: between the beams beside a thin part and these ways there is none of it. Beside is
    within two steps, a cell.

    Parameters
    ----------
    cell : rad, edge of a cell of directions, two steps of the scan.
    tree : of the surface, in the frame of the station.
    bits : (9, n) where beams went in the cells about each point (`part_bits`), 0 where none did.
    """
    face, *angles = face_angles(points - origin)
    at = np.column_stack([face, *angles])
    out = np.zeros(len(points), dtype=np.bool_)
    reach = np.linalg.norm(points - origin, axis=1)
    run_tasks(_write_pierced, len(points), tree, tuple((origin - tree.shift).tolist()), cell, at, reach, margins,
              np.ascontiguousarray(bits.T), out)  # fmt: skip
    return out


@jit(nopython=True, cache=True, nogil=True)
def _write_pierced(first, last, tree, station, cell, at, reach, margins, bits, out):  # type: ignore[no-untyped-def]
    stack = np.empty(DEPTH, dtype=np.int64)
    for i in range(first, last):
        out[i] = _is_pierced(tree, station, cell, at[i], (reach[i] - margins[i], reach[i] + margins[i]), bits[i], stack)


@jit(nopython=True, cache=True, nogil=True)
def _is_pierced(tree, station, cell, at, between, bits, stack):  # type: ignore[no-untyped-def]
    """Whether a beam beside a point, whose face and angles are `at`, went through the surface `between` two ranges."""
    row, column = math.floor(at[1] / cell), math.floor(at[2] / cell)
    for w in MIDMOST:
        for part in range(SUB_CELLS * SUB_CELLS):
            if not (bits[w] >> np.uint64(part)) & np.uint64(1):
                continue
            a = (row + w // 3 - 1 + (part // SUB_CELLS + 0.5) / SUB_CELLS) * cell
            b = (column + w % 3 - 1 + (part % SUB_CELLS + 0.5) / SUB_CELLS) * cell
            is_beside = abs(a - at[1]) <= cell and abs(b - at[2]) <= cell
            if is_beside and _goes_through(tree, station, int(at[0]), (a, b), 0.25 * cell, between, stack):
                return True
    return False


@jit(nopython=True, cache=True, nogil=True)
def _goes_through(tree, station, face, angles, half_step, between, stack):  # type: ignore[no-untyped-def]
    """Whether a beam and the ways `half_step` [rad] on its four sides cross the surface `between` two ranges [m]."""
    for a, b in ((0.0, 0.0), (-half_step, 0.0), (half_step, 0.0), (0.0, -half_step), (0.0, half_step)):
        way = _way_of(face, angles[0] + a, angles[1] + b)
        start = along(station, between[0], way)
        if not is_way_crossed(tree, start, along(station, between[1], way), stack):
            return False
    return True


@jit(nopython=True, cache=True, nogil=True)
def _way_of(face, a, b):  # type: ignore[no-untyped-def]
    """Return the unit vector of a direction: the inverse of `face_angles`."""
    u, v, sign = math.tan(a - MIDDLE), math.tan(b - MIDDLE), 2.0 * (face % 2) - 1.0
    scale = 1.0 / math.sqrt(1.0 + u * u + v * v)
    if face // 2 == 0:
        return sign * scale, u * scale, v * scale
    if face // 2 == 1:
        return v * scale, sign * scale, u * scale
    return u * scale, v * scale, sign * scale
