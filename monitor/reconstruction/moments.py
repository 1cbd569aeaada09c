"""Points summed up in cells, coarser for wider fits, so that a fit costs the same at every radius.

In: points and unit normals. Out: a `Level` for each radius: groups of points of one cell that look the same way, each
with its count, mean place, mean normal and the spread of its points; where cells would hold hardly more than one
point, the points themselves. Means and spreads are exact, so that a patch of second degree fitted to groups is
unbiased as one fitted to their points. Groups are sorted into buckets, for kernels to find all within a radius. No
sum depends on threads: points are added in the order of their cells, and within a cell in that of the input.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit

from projects.model import Floats, Ints

COS_ONE_WAY = 0.5  # points of a cell whose normals are within 60 degrees are one group: thin sheets stay apart
CELLS_PER_RADIUS = 5.0  # kernel and fourth order change little within a cell: below 1 % of a standard error
POINTS_PER_GROUP = 2.0  # fewer, and the points themselves are as quick
BUCKETS_PER_RADIUS = 2.0


class Level(NamedTuple):
    """Groups of points sorted by bucket; bucket `keys[j]` holds the rows `starts[j]:starts[j + 1]`."""

    counts: Floats  # (m,)
    places: Floats  # (m, 3) mean point
    normals: Floats  # (m, 3) unit mean normal
    spreads: Floats  # (m, 6) covariance of the points xx xy xz yy yz zz; (0, 6) where the groups are single points
    keys: Ints  # (k,) ascending
    starts: Ints  # (k + 1,)
    low: Floats  # (3,) corner of bucket 0 0 0
    shape: Ints  # (3,)
    bucket: float  # m


def level_of_points(points: Floats, normals: Floats, radius: float) -> Level:
    """Return the finest level, each point its own group, for fits within `radius` (m)."""
    groups = np.ones(len(points)), points, normals, np.empty((0, 6))
    return sort_groups(*groups, radius / BUCKETS_PER_RADIUS)


def build_levels(points: Floats, normals: Floats, radii: Floats) -> list[Level]:
    """Return a level for each of `radii` (m, ascending), each made from a finer one."""
    levels = [level_of_points(points, normals, float(radii[0]))]
    is_grouped = [False]
    for k in range(1, len(radii)):
        finer = levels[max(k - 2, 0)]
        groups = group(finer, float(radii[k]) / CELLS_PER_RADIUS)
        is_grouped.append(is_grouped[-1] or len(points) > POINTS_PER_GROUP * len(groups[0]))
        if not is_grouped[-1]:
            groups = finer.counts, finer.places, finer.normals, finer.spreads
        levels.append(sort_groups(*groups, float(radii[k]) / BUCKETS_PER_RADIUS))
    return levels


def sort_groups(counts: Floats, places: Floats, normals: Floats, spreads: Floats, bucket: float) -> Level:
    """Return the groups sorted into buckets of edge `bucket` (m)."""
    order, keys, starts, low, shape = sort_by_cell(places, bucket)
    if len(spreads):
        spreads = spreads[order]
    return Level(counts[order], places[order], normals[order], spreads, keys, starts, low, shape, float(bucket))


def sort_by_cell(places: Floats, cell: float) -> tuple[Ints, Ints, Ints, Floats, Ints]:
    """Return order, keys, starts, corner and shape of cubes of edge `cell` (m) over places (n, 3)."""
    low = places.min(axis=0) - cell
    key, shape = cell_keys(places, low, float(cell))
    order = np.argsort(key, kind="stable")
    key = key[order]
    first = np.flatnonzero(np.r_[True, key[1:] != key[:-1]])
    return order, key[first], np.append(first, len(places)).astype(np.int64), low, shape


@jit(nopython=True, cache=True)
def cell_keys(places: Floats, low: Floats, cell: float) -> Any:
    """Key of the cube of each place, cubes of one row along z being successive; and the number of cubes an axis."""
    shape = np.zeros(3, np.int64)
    for i in range(places.shape[0]):
        for a in range(3):
            shape[a] = max(shape[a], int((places[i, a] - low[a]) / cell) + 2)
    key = np.empty(places.shape[0], np.int64)
    for i in range(places.shape[0]):
        x, y, z = (places[i, 0] - low[0]) / cell, (places[i, 1] - low[1]) / cell, (places[i, 2] - low[2]) / cell
        key[i] = (int(x) * shape[1] + int(y)) * shape[2] + int(z)
    return key, shape


def group(finer: Level, cell: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return counts, places, normals and spreads of the groups of `finer` merged in cubes of edge `cell` (m)."""
    order, _, starts, _, _ = sort_by_cell(finer.places, cell)
    counts, places, normals, spreads = merge_cells(
        finer.counts, finer.places, finer.normals, finer.spreads, order, starts
    )
    return counts, places, normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None], spreads


@jit(nopython=True, cache=True)
def merge_cells(counts: Floats, places: Floats, normals: Floats, spreads: Floats, order: Ints, starts: Ints) -> Any:
    """Merge, cell by cell, each group into the first of its cell that looks its way."""
    n = len(order)
    out_counts, out_places = np.zeros(n), np.zeros((n, 3))
    out_normals, out_spreads = np.zeros((n, 3)), np.zeros((n, 6))
    has_spread = len(spreads) > 0
    m = 0
    for cell in range(len(starts) - 1):
        begin = m
        for q in range(starts[cell], starts[cell + 1]):
            p = order[q]
            g = begin
            while g < m and not looks_alike(out_normals[g], normals[p]):
                g += 1
            m = max(m, g + 1)
            before, weight = out_counts[g], counts[p]
            total = before + weight
            dx, dy, dz = (places[p, 0] - out_places[g, 0], places[p, 1] - out_places[g, 1],
                          places[p, 2] - out_places[g, 2])  # fmt: skip
            share = weight / total
            keep = 1.0 - share
            cross = share * keep
            for a in range(6):
                out_spreads[g, a] *= keep
                if has_spread:
                    out_spreads[g, a] += share * spreads[p, a]
            out_spreads[g, 0] += cross * dx * dx
            out_spreads[g, 1] += cross * dx * dy
            out_spreads[g, 2] += cross * dx * dz
            out_spreads[g, 3] += cross * dy * dy
            out_spreads[g, 4] += cross * dy * dz
            out_spreads[g, 5] += cross * dz * dz
            out_places[g, 0] += share * dx
            out_places[g, 1] += share * dy
            out_places[g, 2] += share * dz
            for a in range(3):
                out_normals[g, a] += weight * normals[p, a]
            out_counts[g] = total
    return out_counts[:m].copy(), out_places[:m].copy(), out_normals[:m].copy(), out_spreads[:m].copy()


@jit(nopython=True, cache=True)
def looks_alike(total: Floats, normal: Floats) -> bool:
    """Whether a unit normal is within 60 degrees of a sum of normals."""
    along = total[0] * normal[0] + total[1] * normal[1] + total[2] * normal[2]
    length2 = total[0] * total[0] + total[1] * total[1] + total[2] * total[2]
    return along > 0.0 and along * along > COS_ONE_WAY * COS_ONE_WAY * length2


@jit(nopython=True, cache=True)
def first_from(keys: Ints, least: int) -> int:
    """Place in ascending keys of the first that is no less; np.searchsorted, which compiles ten times as long."""
    low, high = 0, len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < least:
            low = middle + 1
        else:
            high = middle
    return low


@jit(nopython=True, cache=True)
def find_rows(level: Any, low: Any, high: Any, rows: Ints) -> int:
    """Ranges of groups in the buckets that the box [low, high] touches, into `rows`; returns how many ranges."""
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for a in range(3):
        first[a] = max(int(np.floor((low[a] - level.low[a]) / level.bucket)), 0)
        last[a] = min(int(np.floor((high[a] - level.low[a]) / level.bucket)), level.shape[a] - 1)
    n, m = 0, len(level.keys)
    if last[2] < first[2]:
        return 0
    for i in range(first[0], last[0] + 1):
        for j in range(first[1], last[1] + 1):
            base = (i * level.shape[1] + j) * level.shape[2]
            begin = first_from(level.keys, base + first[2])
            end = begin
            while end < m and level.keys[end] <= base + last[2]:
                end += 1
            if end > begin:
                rows[n, 0], rows[n, 1] = level.starts[begin], level.starts[end]
                n += 1
    return n
