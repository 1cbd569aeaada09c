"""Which faces may lie beside a few of them: all that touch the same cells of a grid.

In: vertices (n, 3), faces (m, 3), and which of them are asked about. Out: a mask of these and of all whose boxes may
meet theirs. Cells have numbers that a few may share, so that some faces are among them without need.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

from monitor.threads import run_tasks
from projects.model import Bools, Floats, Ints

TABLE = np.int64(1 << 20)  # numbers of cells
MOST_CELLS = 64  # that a face touches; a larger one is taken to lie beside


def mark_beside(vertices: Floats, faces: Ints, asked: Bools) -> Bools:
    """Return which faces (m,) are asked about or may have a box that meets that of one that is."""
    corners = vertices[faces[asked]]
    low, high = corners.min(axis=1), corners.max(axis=1)
    edge = float((high - low).max(initial=0.0)) or 1.0
    table, out = np.zeros(TABLE, np.bool_), asked.copy()
    _mark_cells(low, high, edge, table)
    run_tasks(_look_up, len(faces), vertices, faces, edge, table, out)
    return out


@jit(nopython=True, cache=True)
def cells_along(low: float, high: float, edge: float) -> Any:
    """First and last cell along an axis that the range [low, high] touches."""
    return np.int64(np.floor(low / edge)), np.int64(np.floor(high / edge))


@jit(nopython=True, cache=True)
def number_of(x: int, y: int, z: int) -> Any:
    """Number of a cell in the table."""
    return (x * np.int64(73856093) ^ y * np.int64(19349663) ^ z * np.int64(83492791)) & (TABLE - 1)


@jit(nopython=True, cache=True, nogil=True)
def _mark_cells(low: Floats, high: Floats, edge: float, table: Any) -> None:
    """Mark the cells that boxes (k, 3) touch."""
    for f in range(len(low)):
        x0, x1 = cells_along(low[f, 0], high[f, 0], edge)
        y0, y1 = cells_along(low[f, 1], high[f, 1], edge)
        z0, z1 = cells_along(low[f, 2], high[f, 2], edge)
        for x in range(x0, x1 + 1):
            for y in range(y0, y1 + 1):
                for z in range(z0, z1 + 1):
                    table[number_of(x, y, z)] = True


@jit(nopython=True, cache=True, nogil=True)
def _look_up(first: int, last: int, vertices: Floats, faces: Ints, edge: float, table: Any, out: Any) -> None:
    """Mark those of the faces `first` to `last` that touch a marked cell, for `run_tasks`."""
    low, high = np.empty(3), np.empty(3)
    for f in range(first, last):
        for a in range(3):
            p, q, r = vertices[faces[f, 0], a], vertices[faces[f, 1], a], vertices[faces[f, 2], a]
            low[a], high[a] = min(p, q, r), max(p, q, r)
        x0, x1 = cells_along(low[0], high[0], edge)
        y0, y1 = cells_along(low[1], high[1], edge)
        z0, z1 = cells_along(low[2], high[2], edge)
        if float(x1 - x0 + 1) * float(y1 - y0 + 1) * float(z1 - z0 + 1) > MOST_CELLS:
            out[f] = True
            continue
        for x in range(x0, x1 + 1):
            for y in range(y0, y1 + 1):
                for z in range(z0, z1 + 1):
                    out[f] |= table[number_of(x, y, z)]
