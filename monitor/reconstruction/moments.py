"""Points summed up in cells, coarser for wider fits, so that a fit costs the same at every radius.

In: points and unit normals. Out: a `Level` for each radius: groups of points of one cell that look the same way, each
with its count, mean place, mean normal and the spread of its points; where cells would hold hardly more than one
point, the points themselves. Means and spreads are exact, so that a patch of second degree fitted to groups is
unbiased as one fitted to their points.

A cell is a column along that of 49 directions which its points look along most: no border cuts it but a gap that
neither noise nor bend explains. A column that leans holds points by their errors where a surface ends or is cut: those
that noise carried there. Cubes cut the noise of a surface that lies on their border into an upper and a lower
group, and of these the smaller one, far from the mean with all its points, passes for outliers.

Groups are sorted into buckets, for kernels to find all within a radius. No sum depends on threads: points are added in
the order of their cells, and within a cell upwards.
"""

from __future__ import annotations

from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numba import jit

from monitor.across import frames_across
from monitor.boxes import box_of
from monitor.ordering import stable_order
from monitor.threads import map_threads
from projects.model import Floats, Ints


def frames_of_columns() -> Floats:
    """Return right-handed frames (49, 3, 3) along the ways from a cube's middle to five by five places on each of its
    faces, one way each.

    No direction is farther than 18 degrees from the nearest of them, 8 in the mean.
    """
    places = product((-2.0, -1.0, 0.0, 1.0, 2.0), repeat=3)
    ways = [d for d in places if d > (0.0, 0.0, 0.0) and max(map(abs, d)) == 2.0]
    along = np.array(ways) / np.linalg.norm(ways, axis=1)[:, None]
    return np.stack([*frames_across(along), along], axis=1)


COS_ONE_WAY = 0.5  # points of a cell whose normals are within 60 degrees are one group: thin sheets stay apart
CELLS_PER_RADIUS = 5.0  # kernel and fourth order change little within a cell: below 1 % of a standard error
GAP_SIGMAS, GAP_CELLS = 3.0, 0.1  # along a column, in noise and for bend: points farther apart are two groups
FRAMES = frames_of_columns()  # (49, 3, 3): two rows across and one along the column
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
    """Return the finest level, each point its own group, for fits within `radius` (m) or about that."""
    groups = np.ones(len(points)), points, normals, np.empty((0, 6))
    return sort_groups(*groups, radius / BUCKETS_PER_RADIUS)


def build_levels(finest: Level, radii: Floats, noise: float) -> list[Level]:
    """Return a level for each of `radii` (m, ascending) from one of single points; `noise` (m) is one sigma.

    Where columns hold hardly more than one point the level is the finest one. Of the others each is made from the last
    but one, so that there are two rows of them, which two threads make.
    """
    cells = radii / CELLS_PER_RADIUS
    ways = nearest_ways(finest.normals, FRAMES)
    n_single = 1
    while n_single < len(radii) and is_sparse(finest, ways, float(cells[n_single])):
        n_single += 1
    levels = [finest] * len(radii)

    def fill(first: int) -> None:
        """Fill every other level from `first` on, each grouped from the one two below."""
        for k in range(first, len(radii), 2):
            finer = levels[max(k - 2, 0)]
            along = ways if finer is finest else nearest_ways(finer.normals, FRAMES)
            groups = group(finer, along, float(cells[k]), noise)
            levels[k] = sort_groups(*groups, float(radii[k]) / BUCKETS_PER_RADIUS)

    map_threads(fill, (n_single, n_single + 1))
    return levels


def is_sparse(level: Level, ways: Ints, cell: float) -> bool:
    """Whether columns of edge `cell` (m) over single points hold too few each to be quicker."""
    columns = column_keys(level.places, level.normals, ways, cell, FRAMES)[0]
    columns.sort()
    n_columns = 1 + np.count_nonzero(columns[1:] != columns[:-1])
    return bool(len(columns) <= POINTS_PER_GROUP * n_columns)


def sort_groups(counts: Floats, places: Floats, normals: Floats, spreads: Floats, bucket: float) -> Level:
    """Return the groups sorted into buckets of edge `bucket` (m); of single points each counts for one."""
    order, keys, starts, low, shape = sort_by_cell(places, bucket)
    if len(spreads):
        spreads, counts = spreads.take(order, axis=0), counts.take(order)
    places, normals = map_threads(lambda values: values.take(order, axis=0), (places, normals))
    return Level(counts, places, normals, spreads, keys, starts, low, shape, float(bucket))


def sort_by_cell(places: Floats, cell: float) -> tuple[Ints, Ints, Ints, Floats, Ints]:
    """Return order, keys, starts, corner and shape of cubes of edge `cell` (m) over places (n, 3)."""
    low = box_of(places)[0] - cell
    key, shape = cell_keys(places, low, float(cell))
    order = stable_order(key)
    key = key.take(order)
    first = np.flatnonzero(np.r_[True, key[1:] != key[:-1]])
    return order, key[first], np.append(first, len(places)).astype(np.int64), low, shape


@jit(nopython=True, cache=True, nogil=True)
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


def group(finer: Level, ways: Ints, cell: float, noise: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return counts, places, normals and spreads of the groups of `finer` merged in columns of edge `cell` (m).

    `ways` are the `nearest_ways` of its normals.
    """
    columns, heights = column_keys(finer.places, finer.normals, ways, cell, FRAMES)
    order = stable_order(columns)
    columns = columns.take(order)
    starts = np.append(np.flatnonzero(np.r_[True, columns[1:] != columns[:-1]]), len(columns)).astype(np.int64)
    gap = GAP_SIGMAS * noise + GAP_CELLS * cell
    counts, places, normals, spreads = merge_columns(finer, heights, order, starts, gap)
    return counts, places, normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None], spreads


@jit(nopython=True, cache=True, nogil=True)
def nearest_ways(normals: Floats, frames: Floats) -> Any:
    """Number (n,) of the frame whose column is nearest to each normal, either way along it."""
    ways = np.empty(len(normals), np.uint8)
    for p in range(len(normals)):
        nx, ny, nz, most = normals[p, 0], normals[p, 1], normals[p, 2], 0.0
        ways[p] = 0
        for d in range(len(frames)):
            along = abs(nx * frames[d, 2, 0] + ny * frames[d, 2, 1] + nz * frames[d, 2, 2])
            if along > most:
                most, ways[p] = along, d
    return ways


@jit(nopython=True, cache=True, nogil=True)
def column_keys(places: Floats, normals: Floats, ways: Ints, cell: float, frames: Floats) -> Any:
    """Key (n,) of the column of each place, along the frame that `ways` says, and its height over the column's foot.

    The height is that at which the plane through the place meets the middle of the column, so that places of one
    surface are at one height however it slopes.
    """
    keys, heights = np.empty(len(places), np.int64), np.empty(len(places))
    farthest2 = 0.0
    for p in range(len(places)):
        farthest2 = max(farthest2, places[p, 0] ** 2 + places[p, 1] ** 2 + places[p, 2] ** 2)
    low = -np.sqrt(farthest2) - cell
    widest = np.int64(-2.0 * low / cell) + 2
    for p in range(len(places)):
        x, y, z = places[p, 0], places[p, 1], places[p, 2]
        nx, ny, nz = normals[p, 0], normals[p, 1], normals[p, 2]
        f = frames[ways[p]]
        along = nx * f[2, 0] + ny * f[2, 1] + nz * f[2, 2]
        height = x * f[2, 0] + y * f[2, 1] + z * f[2, 2]
        key = 2 * np.int64(ways[p]) + np.int64(along > 0.0)
        for a in range(2):
            across = (x * f[a, 0] + y * f[a, 1] + z * f[a, 2] - low) / cell
            slope = (nx * f[a, 0] + ny * f[a, 1] + nz * f[a, 2]) / along
            key = key * widest + np.int64(across)
            height += slope * cell * (across - np.floor(across) - 0.5)
        keys[p], heights[p] = key, height
    return keys, heights


@jit(nopython=True, cache=True)
def sort_upwards(order: Ints, first: int, last: int, heights: Floats) -> None:
    """Bring `order[first:last]`, a few, in ascending order of height; those of one height stay in theirs."""
    for q in range(first + 1, last):
        p, to = order[q], q
        while to > first and heights[order[to - 1]] > heights[p]:
            order[to] = order[to - 1]
            to -= 1
        order[to] = p


@jit(nopython=True, cache=True)
def enlarged(values: Floats, n: int) -> Floats:
    """Rows with room for n of them, zero where there was none."""
    out = np.zeros((n, values.shape[1]))
    out[: len(values)] = values
    return out


@jit(nopython=True, cache=True, nogil=True)
def merge_columns(finer: Any, heights: Floats, order: Ints, starts: Ints, gap: float) -> Any:
    """Merge, column by column and upwards, each group into the first that looks its way and ends within `gap` (m).

    Columns are the ranges `starts` of `order`, which is brought in order of height.
    """
    room = len(starts) + len(starts) // 8
    counts, places, normals, spreads = (
        np.zeros((room, 1)),
        np.zeros((room, 3)),
        np.zeros((room, 3)),
        np.zeros((room, 6)),
    )
    tops, m = np.zeros((room, 1)), 0
    for column in range(len(starts) - 1):
        begin, first, last = m, starts[column], starts[column + 1]
        sort_upwards(order, first, last, heights)
        if m + last - first > room:
            room = 2 * (m + last - first)
            counts, places, normals = enlarged(counts, room), enlarged(places, room), enlarged(normals, room)
            spreads, tops = enlarged(spreads, room), enlarged(tops, room)
        for q in range(first, last):
            p = order[q]
            g = begin
            while g < m and not (heights[p] - tops[g, 0] <= gap and looks_alike(normals[g], finer.normals[p])):
                g += 1
            m = max(m, g + 1)
            tops[g, 0] = heights[p]
            add_group(finer, p, counts[:, 0], places, normals, spreads, g)
    return counts[:m, 0].copy(), places[:m], normals[:m], spreads[:m]


@jit(nopython=True, cache=True)
def add_group(finer: Any, p: int, counts: Floats, places: Floats, normals: Floats, spreads: Floats, g: int) -> None:
    """Add group p of `finer` to group g, whose count, mean place, sum of normals and spread are given."""
    weight, before = finer.counts[p], counts[g]
    share = weight / (before + weight)
    keep = 1.0 - share
    cross = share * keep
    dx, dy, dz = (finer.places[p, 0] - places[g, 0], finer.places[p, 1] - places[g, 1],
                  finer.places[p, 2] - places[g, 2])  # fmt: skip
    for a in range(6):
        spreads[g, a] *= keep
        if len(finer.spreads) > 0:
            spreads[g, a] += share * finer.spreads[p, a]
    spreads[g, 0] += cross * dx * dx
    spreads[g, 1] += cross * dx * dy
    spreads[g, 2] += cross * dx * dz
    spreads[g, 3] += cross * dy * dy
    spreads[g, 4] += cross * dy * dz
    spreads[g, 5] += cross * dz * dz
    places[g, 0] += share * dx
    places[g, 1] += share * dy
    places[g, 2] += share * dz
    for a in range(3):
        normals[g, a] += weight * finer.normals[p, a]
    counts[g] = before + weight


@jit(nopython=True, cache=True)
def looks_alike(total: Floats, normal: Floats) -> bool:
    """Whether a unit normal is within 60 degrees of a sum of normals."""
    along = total[0] * normal[0] + total[1] * normal[1] + total[2] * normal[2]
    length2 = total[0] * total[0] + total[1] * total[1] + total[2] * total[2]
    return along > 0.0 and along * along > COS_ONE_WAY * COS_ONE_WAY * length2


@jit(nopython=True, cache=True)
def first_from(keys: Ints, least: int, low: int) -> int:
    """Place in ascending keys, from `low` on, of the first that is no less: by steps twice as long each, then halves.

    What is looked for in successive rows lies near by. np.searchsorted compiles ten times as long.
    """
    step, high = 1, low
    while high < len(keys) and keys[high] < least:
        low = high + 1
        high += step
        step *= 2
    high = min(high, len(keys))
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < least:
            low = middle + 1
        else:
            high = middle
    return low


@jit(nopython=True, cache=True)
def buckets_along(low: float, high: float, origin: float, bucket: float, n: int) -> Any:
    """First and last of n buckets along an axis from `origin` on that the range [low, high] touches."""
    return max(int(np.floor((low - origin) / bucket)), 0), min(int(np.floor((high - origin) / bucket)), n - 1)


@jit(nopython=True, cache=True)
def find_rows(level: Any, low: Any, high: Any, rows: Ints) -> int:
    """Ranges of groups in the buckets that the box [low, high] touches, into `rows`; returns how many ranges."""
    x0, x1 = buckets_along(low[0], high[0], level.low[0], level.bucket, level.shape[0])
    y0, y1 = buckets_along(low[1], high[1], level.low[1], level.bucket, level.shape[1])
    z0, z1 = buckets_along(low[2], high[2], level.low[2], level.bucket, level.shape[2])
    n, m, begin = 0, len(level.keys), 0
    if z1 < z0:
        return 0
    for i in range(x0, x1 + 1):
        for j in range(y0, y1 + 1):
            base = (i * level.shape[1] + j) * level.shape[2]
            begin = first_from(level.keys, base + z0, begin)
            end = begin
            while end < m and level.keys[end] <= base + z1:
                end += 1
            if end > begin:
                rows[n, 0], rows[n, 1] = level.starts[begin], level.starts[end]
                n += 1
            begin = end
    return n
