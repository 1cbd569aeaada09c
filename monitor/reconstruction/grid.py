"""Points bucketed into cubic cells, so that a kernel finds all points within a radius without a tree.

In: points (n, 3) m. Out: `PointGrid`, plain arrays that numba kernels take. The order inside a cell is the order of
the input, so what is summed over neighbours does not depend on threads.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit

from projects.model import Floats, Ints


class PointGrid(NamedTuple):
    """Points sorted by cell; `order[k]` is the input index of `points[k]`, `starts[j]:starts[j + 1]` cell `keys[j]`."""

    points: Floats  # (n, 3)
    order: Ints  # (n,)
    keys: Ints  # (m,) ascending
    starts: Ints  # (m + 1,)
    low: Floats  # (3,) corner of cell 0 0 0
    shape: Ints  # (3,) number of cells
    cell: float  # m


def build_grid(points: Floats, cell: float) -> PointGrid:
    """Bucket `points` (n, 3) into cubes of edge `cell` (m)."""
    low = points.min(axis=0) - cell
    index = np.floor((points - low) / cell).astype(np.int64)
    shape = index.max(axis=0) + 2
    key = (index[:, 0] * shape[1] + index[:, 1]) * shape[2] + index[:, 2]
    order = np.argsort(key, kind="stable")
    keys, first = np.unique(key[order], return_index=True)
    starts = np.append(first, len(points)).astype(np.int64)
    return PointGrid(np.ascontiguousarray(points[order]), order, keys, starts, low, shape, float(cell))


@jit(nopython=True, cache=True)
def cell_span(value: float, radius: float, low: float, cell: float, n_cells: int) -> Any:
    """First and last cell along one axis that [value - radius, value + radius] touches; empty where last < first."""
    first = int(np.floor((value - radius - low) / cell))
    last = int(np.floor((value + radius - low) / cell))
    return max(first, 0), min(last, n_cells - 1)


@jit(nopython=True, cache=True)
def row_points(grid: Any, i: int, j: int, k0: int, k1: int) -> Any:
    """Range of sorted points in cells (i, j, k0..k1); such a row is contiguous in the sorted order."""
    base = (i * grid.shape[1] + j) * grid.shape[2]
    first = np.searchsorted(grid.keys, base + k0)
    last = np.searchsorted(grid.keys, base + k1 + 1)
    return grid.starts[first], grid.starts[last]


@jit(nopython=True, cache=True)
def count_candidates(grid: Any, x: float, y: float, z: float, radius: float) -> int:
    """Number of points in the cells that a ball touches: an upper bound of those inside it."""
    i0, i1 = cell_span(x, radius, grid.low[0], grid.cell, grid.shape[0])
    j0, j1 = cell_span(y, radius, grid.low[1], grid.cell, grid.shape[1])
    k0, k1 = cell_span(z, radius, grid.low[2], grid.cell, grid.shape[2])
    n = 0
    if k1 >= k0:
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                first, last = row_points(grid, i, j, k0, k1)
                n += last - first
    return n
