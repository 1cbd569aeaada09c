"""Which units lie around each unit, and from which size of patch on they belong to its patch.

Patches of growing size around a unit hold one another, so one list of neighbours serves all sizes. "a is near b" holds
both ways: the patches that a unit belongs to are those around the units of its own patch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import jit
from scipy.sparse import csr_matrix

from monitor.comparison.distances.scratch import keep_on_disk
from monitor.threads import map_threads, run_tasks
from projects.model import Floats, Ints

N_PIECES = 16  # of the cubes, for threads
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
    near = _sort_units(centres, normals, radii)
    n_cells = len(near.keys)
    bounds = [n_cells * k // N_PIECES for k in range(N_PIECES + 1)]
    pieces = map_threads(lambda k: _list_near(near, bounds[k], bounds[k + 1]), range(N_PIECES))
    counts, units, sizes = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    del pieces
    starts, rising, sizes = _turn_around(near.units, counts, units, sizes)
    return Reaches(starts, keep_on_disk(rising), keep_on_disk(sizes))


def _sort_units(centres: Floats, normals: Floats, radii: list[float]) -> _Sorted:
    """Return the units sorted by cells as wide as the largest radius, so that neighbours lie in few runs."""
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
    if a == b:
        return 0
    x, y = near.centres[a, 0] - near.centres[b, 0], near.centres[a, 1] - near.centres[b, 1]
    z = near.centres[a, 2] - near.centres[b, 2]
    distance2, n_sizes = x * x + y * y + z * z, len(near.radii2)
    if n_sizes == 1 or distance2 > near.radii2[-1]:
        return 255
    cosine = near.normals[a, 0] * near.normals[b, 0] + near.normals[a, 1] * near.normals[b, 1]
    cosine += near.normals[a, 2] * near.normals[b, 2]
    if cosine < COSINE * near.lengths[a] * near.lengths[b]:
        return 255
    size = 1
    while distance2 > near.radii2[size]:
        size += 1
    return size


@jit(nopython=True, cache=True)
def _rows_around(near, cell, rows):  # type: ignore[no-untyped-def]
    """Write the first place and the one after the last of each row of three cubes around a cube."""
    for k in range(len(near.steps)):
        middle = near.keys[cell] + near.steps[k]
        rows[k, 0] = near.starts[np.searchsorted(near.keys, middle - 1)]
        rows[k, 1] = near.starts[np.searchsorted(near.keys, middle + 2)]


@jit(nopython=True, cache=True, nogil=True)
def _list_near(near, first, last):  # type: ignore[no-untyped-def]
    """Return how many units lie around each unit of some cubes, by place; these, in the order of the cubes, and their
    sizes."""
    rows, room = np.empty((9, 2), dtype=np.int64), 0
    for cell in range(first, last):
        _rows_around(near, cell, rows)
        room += (near.starts[cell + 1] - near.starts[cell]) * (rows[:, 1] - rows[:, 0]).sum()
    counts, at = np.zeros(near.starts[last] - near.starts[first], dtype=np.int32), 0
    units, sizes = np.empty(room, dtype=np.int32), np.empty(room, dtype=np.uint8)
    for cell in range(first, last):
        _rows_around(near, cell, rows)
        for a in range(near.starts[cell], near.starts[cell + 1]):
            before = at
            for k in range(9):
                for b in range(rows[k, 0], rows[k, 1]):
                    size = _first_size(near, a, b)
                    if size < 255:
                        units[at], sizes[at] = near.units[b], size
                        at += 1
            counts[a - near.starts[first]] = at - before
    return counts, units[:at].copy(), sizes[:at].copy()


@jit(nopython=True, cache=True, nogil=True)
def _turn_around(unit_at, counts, units, sizes):  # type: ignore[no-untyped-def]
    """Return starts, and the lists of all places rising: each unit in turn is written to those around it."""
    n = len(unit_at)
    starts, first, place_of = np.zeros(n + 1, dtype=np.int64), np.zeros(n + 1, dtype=np.int64), np.empty(n, np.int64)
    for place in range(n):
        place_of[unit_at[place]] = place
        first[place + 1] = first[place] + counts[place]
    for u in range(n):
        starts[u + 1] = starts[u] + counts[place_of[u]]
    rising, their_sizes, filled = np.empty_like(units), np.empty_like(sizes), starts[:-1].copy()
    for u in range(n):
        for k in range(first[place_of[u]], first[place_of[u] + 1]):
            at = filled[units[k]]
            rising[at], their_sizes[at] = u, sizes[k]
            filled[units[k]] += 1
    return starts, rising, their_sizes


def sum_over(reaches: Reaches, n_sizes: int, values: Floats, which: slice) -> Floats:
    """Return the sums (k, s, c) of the units' values (u, c) over the patches of every size around those in `which`."""
    sums = np.zeros((which.stop - which.start, n_sizes, values.shape[1]))
    run_tasks(_sum_over, len(sums), reaches, which.start, values, sums)
    return sums


@jit(nopython=True, cache=True, nogil=True)
def _sum_over(begin, end, reaches, first, values, sums):  # type: ignore[no-untyped-def]
    """Write the sums of the patches from `begin` to `end`: what each size adds to those before, then all together."""
    starts, units, sizes, n_values = reaches.starts, reaches.units, reaches.sizes, values.shape[1]
    for p in range(begin, end):
        for k in range(starts[first + p], starts[first + p + 1]):
            u, size = units[k], sizes[k]
            for c in range(n_values):
                sums[p, size, c] += values[u, c]
        for size in range(1, sums.shape[1]):
            for c in range(n_values):
                sums[p, size, c] += sums[p, size - 1, c]


def least_of_patches(reaches: Reaches, means: Floats, p_values: Floats) -> tuple[Floats, Floats]:
    """Return for each unit the least p value of the patches that it belongs to, of those above and of those below zero.

    `means` and `p_values` (p, s) are of the patches of each size around each unit; 1 where there is none.
    """
    n, n_sizes = means.shape
    above, below, from_size = np.ones(n), np.ones(n), np.ones((n, n_sizes + 1, 2))
    run_tasks(_take_least_of_larger, n, means, p_values, from_size)
    run_tasks(_take_least_of_patches, n, reaches, from_size, above, below)
    return above, below


@jit(nopython=True, cache=True, nogil=True)
def _take_least_of_larger(first, last, means, p_values, from_size):  # type: ignore[no-untyped-def]
    """Write the least of each size and all larger ones, of those above zero and of those below."""
    n_sizes = means.shape[1]
    for p in range(first, last):
        for size in range(n_sizes - 1, -1, -1):
            for k in range(2):
                counts = means[p, size] < 0.0 if k else means[p, size] > 0.0
                least = from_size[p, size + 1, k]
                from_size[p, size, k] = min(least, p_values[p, size]) if counts else least


@jit(nopython=True, cache=True, nogil=True)
def _take_least_of_patches(first, last, reaches, from_size, above, below):  # type: ignore[no-untyped-def]
    """Write the least of the patches around each unit that it belongs to."""
    for u in range(first, last):
        for k in range(reaches.starts[u], reaches.starts[u + 1]):
            p, size = reaches.units[k], reaches.sizes[k]
            above[u], below[u] = min(above[u], from_size[p, size, 0]), min(below[u], from_size[p, size, 1])
