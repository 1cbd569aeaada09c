"""Which units lie around each unit, and from which size of patch on they belong to its patch.

Patches of growing size around a unit hold one another, so one list of neighbours serves all sizes. "a is near b" holds
both ways: the patches that a unit belongs to are those around the units of its own patch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import jit, prange
from scipy.sparse import csr_matrix

from monitor.comparison.scratch import keep_on_disk
from projects.model import Floats, Ints

COSINE = 0.5  # units that look more than 60 degrees apart do not belong together


class Reaches(NamedTuple):  # a named tuple, since kernels take it whole
    """The units around unit u, rising, itself among them: `units[starts[u]:starts[u + 1]]`, and the first size of
    patch, `sizes`, that each belongs to."""

    starts: Ints
    units: Ints
    sizes: Ints


class _Sorted(NamedTuple):
    """Units sorted by cubes as wide as the largest patch: `units` [place], cube c from starts[c] on, with its rising
    `keys`; `centres` (u, 3) [m], `normals` (u, 3) and their `lengths` by place; squared `radii2` [m2]; `steps` of the
    key to the middle of each row of three cubes around."""

    units: Ints
    starts: Ints
    keys: Ints
    centres: Floats
    normals: Floats
    lengths: Floats
    radii2: Floats
    steps: Ints


def gather_reaches(centres: Floats, normals: Floats, radii: list[float]) -> Reaches:
    """Return the units around each unit within the last of `radii` [m], rising, that look the same way.

    `centres` (u, 3) [m]; `normals` (u, 3) of any length. The first radius is 0: the unit alone.
    """
    sorted_units = _sort_units(centres, normals, radii)
    counts = np.zeros(len(centres) + 1, dtype=np.int64)
    _count_near(sorted_units, counts)
    starts = np.cumsum(counts)
    rising, sizes = _turn_around(starts, *_list_near(sorted_units, starts))
    return Reaches(starts, keep_on_disk(rising), keep_on_disk(sizes))


def _sort_units(centres: Floats, normals: Floats, radii: list[float]) -> _Sorted:
    low = centres.min(axis=0, initial=np.inf)
    cells = (
        np.floor((centres - low) / radii[-1]).astype(np.int64) + 1 if radii[-1] > 0.0 else np.ones_like(centres, int)
    )
    n_cells = cells.max(axis=0, initial=0) + 2
    key = (cells[:, 0] * n_cells[1] + cells[:, 1]) * n_cells[2] + cells[:, 2]
    order = np.argsort(key, kind="stable")
    keys, starts = np.unique(key[order], return_index=True)
    steps = np.array([(i * n_cells[1] + j) * n_cells[2] for i in (-1, 0, 1) for j in (-1, 0, 1)])
    lengths = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    return _Sorted(order.astype(np.int32), np.append(starts, len(order)), keys, centres[order], normals[order],
                   lengths[order], np.array(radii) ** 2, steps)  # fmt: skip


def members_of(reaches: Reaches, size: int, patches: Ints) -> csr_matrix:
    """Return which units (columns) belong to the patches of one size around the units `patches` (rows), sparse 0/1."""
    lengths = np.diff(reaches.starts)[patches]
    row = np.repeat(np.arange(len(patches)), lengths)
    at = reaches.starts[patches][row] + np.arange(len(row)) - (np.cumsum(lengths) - lengths)[row]
    kept = reaches.sizes[at] <= size
    shape = (len(patches), len(reaches.starts) - 1)
    return csr_matrix((np.ones(int(kept.sum())), (row[kept], reaches.units[at[kept]])), shape=shape)


@jit(nopython=True, cache=True)
def _first_size(near, a, b):  # type: ignore[no-untyped-def]
    """Return the first size of patch around the unit at place a that the one at b belongs to; 255 where to none."""
    x, y = near.centres[a, 0] - near.centres[b, 0], near.centres[a, 1] - near.centres[b, 1]
    z = near.centres[a, 2] - near.centres[b, 2]
    distance2 = x * x + y * y + z * z
    size, n_sizes = 1, len(near.radii2)
    while size < n_sizes and distance2 > near.radii2[size]:
        size += 1
    if a == b or size >= n_sizes:
        return 0 if a == b else 255
    cosine = near.normals[a, 0] * near.normals[b, 0] + near.normals[a, 1] * near.normals[b, 1]
    cosine += near.normals[a, 2] * near.normals[b, 2]
    return size if cosine >= COSINE * near.lengths[a] * near.lengths[b] else 255


@jit(nopython=True, cache=True)
def _rows_around(near, cell, rows):  # type: ignore[no-untyped-def]
    """Write the first place and the one after the last of each row of three cubes around a cube."""
    for k in range(len(near.steps)):
        middle = near.keys[cell] + near.steps[k]
        rows[k, 0] = near.starts[np.searchsorted(near.keys, middle - 1)]
        rows[k, 1] = near.starts[np.searchsorted(near.keys, middle + 2)]


@jit(nopython=True, cache=True)
def _count_near(near, counts):  # type: ignore[no-untyped-def]
    """Write how many units lie around unit u into counts[u + 1]."""
    for cell in range(len(near.keys)):
        rows = np.empty((9, 2), dtype=np.int64)
        _rows_around(near, cell, rows)
        for a in range(near.starts[cell], near.starts[cell + 1]):
            n = 0
            for k in range(9):
                for b in range(rows[k, 0], rows[k, 1]):
                    n += _first_size(near, a, b) < 255
            counts[near.units[a] + 1] = n


@jit(nopython=True, cache=True)
def _list_near(near, starts):  # type: ignore[no-untyped-def]
    """Return the units around each unit, in the order of the cubes, and their sizes."""
    units, sizes = np.empty(starts[-1], dtype=np.int32), np.empty(starts[-1], dtype=np.uint8)
    for cell in range(len(near.keys)):
        rows = np.empty((9, 2), dtype=np.int64)
        _rows_around(near, cell, rows)
        for a in range(near.starts[cell], near.starts[cell + 1]):
            at = starts[near.units[a]]
            for k in range(9):
                for b in range(rows[k, 0], rows[k, 1]):
                    size = _first_size(near, a, b)
                    if size < 255:
                        units[at], sizes[at] = near.units[b], size
                        at += 1
    return units, sizes


@jit(nopython=True, cache=True)
def _turn_around(starts, units, sizes):  # type: ignore[no-untyped-def]
    """Return the same lists rising: each unit in turn is written to those around it."""
    rising, their_sizes, filled = np.empty_like(units), np.empty_like(sizes), starts[:-1].copy()
    for u in range(len(starts) - 1):
        for k in range(starts[u], starts[u + 1]):
            at = filled[units[k]]
            rising[at], their_sizes[at] = u, sizes[k]
            filled[units[k]] += 1
    return rising, their_sizes


@jit(nopython=True, cache=True)
def sum_areas(reaches, size, areas, n_vertices):  # type: ignore[no-untyped-def]
    """Return area (p,) [m2] and number of vertices (p,) of the patches of one size around each unit."""
    whole, counts = np.zeros(len(areas)), np.zeros(len(areas), dtype=np.int64)
    for p in range(len(areas)):
        for k in range(reaches.starts[p], reaches.starts[p + 1]):
            if reaches.sizes[k] <= size:
                whole[p] += areas[reaches.units[k]]
                counts[p] += n_vertices[reaches.units[k]]
    return whole, counts


@jit(nopython=True, parallel=True, cache=True)
def average_over(reaches, size, areas, whole, values):  # type: ignore[no-untyped-def]
    """Return the area-weighted mean (p, c) of the units' values (u, c) over the patches of one size around each unit,
    whose areas are `whole` (p,)."""
    means = np.zeros((len(whole), values.shape[1]))
    for p in prange(len(whole)):
        per_area = 1.0 / whole[p]
        for k in range(reaches.starts[p], reaches.starts[p + 1]):
            if reaches.sizes[k] <= size:
                weight = areas[reaches.units[k]] * per_area
                for c in range(values.shape[1]):
                    means[p, c] += weight * values[reaches.units[k], c]
    return means


@jit(nopython=True, parallel=True, cache=True)
def least_of_patches(reaches, means, p_values):  # type: ignore[no-untyped-def]
    """Return for each unit the least p value of the patches that it belongs to, of those above and of those below zero.

    `means` and `p_values` (p, s) are of the patches of each size around each unit; 1 where there is none.
    """
    n = len(means)
    above, below = np.ones(n), np.ones(n)
    for u in prange(n):
        for k in range(reaches.starts[u], reaches.starts[u + 1]):
            patch = reaches.units[k]
            for size in range(reaches.sizes[k], means.shape[1]):
                if means[patch, size] > 0.0:
                    above[u] = min(above[u], p_values[patch, size])
                elif means[patch, size] < 0.0:
                    below[u] = min(below[u], p_values[patch, size])
    return above, below
