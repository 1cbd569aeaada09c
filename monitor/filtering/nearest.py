"""The k nearest points of every point, and the points in a ball: a hierarchy of boxes over points in canonical order.

In: points (n, 3) [m] in the order of `canonical_order`, so that a leaf is a run of the array; out: indices. Memory is
that of the boxes; neighbours are made block by block and never for all points at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, prange

from monitor.filtering.covariance import smallest
from projects.model import Floats, Ints

MORTON_BITS = 21
BLOCK = 1 << 18  # points at a time
CROWDED = 512  # points of one cell of the curve: more have a curve of their own
LEAF = 8  # points of a leaf, whose neighbours are gathered together
NEARBY = 1.5  # times the distance to the first one's k-th neighbour, within which points of a leaf are taken together


def canonical_order(points: Floats) -> Ints:
    """Return the order (n,) along a space-filling curve: the same for any order of the points in the file.

    Neighbours in space become neighbours in memory; points of one cell of the curve are ordered by x, y, z. A single
    point far away makes the cells as wide as objects: points of a crowded cell follow a curve of its own.
    """
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    least = points.min(axis=0)
    extent = float((points.max(axis=0) - least).max())
    if not extent > 2**MORTON_BITS * float(np.finfo(points.dtype).tiny):  # all at one place
        return np.lexsort(points.T[::-1])
    scale = (2**MORTON_BITS - 1) / extent
    code = np.zeros(len(points), dtype=np.uint64)
    for first in range(0, len(points), BLOCK):  # so that only the code is as long as the points
        block = slice(first, first + BLOCK)
        for axis in range(3):
            cell = ((points[block, axis] - least[axis]) * scale).astype(np.uint64)
            code[block] |= _spread_bits(cell) << np.uint64(2 - axis)
    order = np.argsort(code, kind="stable")
    equal = _repeated(code, order)
    if len(equal):
        tied = np.unique(np.concatenate([equal, equal + 1]))
        some = order[tied]
        order[tied] = some[_order_in_cells(points[some], code[some])]
    return order


def _order_in_cells(points: Floats, code: Ints) -> Ints:
    """Return the order (n,) of points that share cells: by cell, there by x, y, z or, if crowded, a curve."""
    order: Ints = np.lexsort((points[:, 2], points[:, 1], points[:, 0], code))
    starts = np.flatnonzero(np.diff(code[order])) + 1
    bounds = np.concatenate([[0], starts, [len(order)]])
    for k in np.flatnonzero(np.diff(bounds) > CROWDED):
        cell = slice(bounds[k], bounds[k + 1])
        order[cell] = order[cell][canonical_order(points[order[cell]])]
    return order


def _repeated(code: Ints, order: Ints) -> Ints:
    """Return the places in `order` whose code is that of the next, block by block."""
    found = [
        first + np.flatnonzero(np.diff(code[order[first : first + BLOCK + 1]]) == 0)
        for first in range(0, len(order) - 1, BLOCK)
    ]
    return np.concatenate(found) if found else np.zeros(0, dtype=np.int64)


def _spread_bits(cell: Ints) -> Ints:
    """Return the 21 bits of each cell number with two zeros between neighbours (Morton 1966)."""
    steps = ((32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3))
    for shift, mask in (*steps, (2, 0x1249249249249249)):
        cell = (cell | cell << np.uint64(shift)) & np.uint64(mask)
    return cell


@dataclass(frozen=True)
class PointIndex:
    """Points (n, 3) [m] in canonical order and the boxes `low` to `high` (2 l, 3) over runs of them, l of which are
    leaves; node 1 is the root, 2i and 2i + 1 are the children of i.

    Boxes are in float32, rounded outward; in float64 where coordinates are so large that rounding would widen them.
    """

    points: Floats
    low: Floats
    high: Floats

    @property
    def n_leaves(self) -> int:
        """Number of leaves, a power of two; the last ones may be empty."""
        return len(self.low) // 2


def _outward(corners: Floats, towards: float, kind: type[np.floating[Any]]) -> Floats:
    """Return corners in float32 or float64, the next number towards minus or plus infinity."""
    return np.nextafter(corners.astype(kind), kind(towards))


def _kind_of_boxes(least: Floats, most: Floats) -> type[np.floating[Any]]:
    """Return float32 for leaves (m, 3) [m] on a surface where its steps are a tenth of a leaf or less, else float64.

    A leaf of a thousand points to the metre is 2 mm wide; 5000 km from the origin float32 goes in steps of half a
    metre, and every box would hold the whole object.
    """
    if not len(least):
        return np.float32
    low, high = least.min(axis=0), most.max(axis=0)
    leaf = float((high - low).max()) / math.sqrt(len(least))
    step = float(np.spacing(np.float32(max(abs(low).max(), abs(high).max()))))
    return np.float32 if step <= 0.1 * leaf else np.float64


def build_index(points: Floats) -> PointIndex:
    """Return the index of points (n, 3) [m] that are in canonical order."""
    n_leaves = 1 << max(0, math.ceil(math.log2(max(1, math.ceil(len(points) / LEAF)))))
    starts = np.arange(0, len(points), LEAF)
    least, most = np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts)
    kind = _kind_of_boxes(least, most)
    low, high = (np.full((2 * n_leaves, 3), far, dtype=kind) for far in (np.inf, -np.inf))
    low[n_leaves : n_leaves + len(starts)] = _outward(least, -np.inf, kind)
    high[n_leaves : n_leaves + len(starts)] = _outward(most, np.inf, kind)
    level = n_leaves
    while level > 1:
        children = slice(level, 2 * level)
        low[level // 2 : level] = low[children].reshape(-1, 2, 3).min(axis=1)
        high[level // 2 : level] = high[children].reshape(-1, 2, 3).max(axis=1)
        level //= 2
    return PointIndex(np.ascontiguousarray(points), low, high)


def find_nearest(index: PointIndex, first: int, last: int, k: Ints) -> Ints:
    """Return indices (last - first, k.max()) of the `k` (last - first,) nearest points of each point, itself included.

    Not in order of distance; places beyond the k of a point hold -1. `first` must be a multiple of `LEAF`.
    """
    return find_nearest_of_every(index, 1, index, first, last, k)


def find_nearest_of_every(index: PointIndex, stride: int, some: PointIndex, first: int, last: int, k: Ints) -> Ints:
    """Return what `find_nearest` does, of each point's neighbours among every `stride`-th point and the point itself.

    `some` is the index of the points [::stride], which along the curve lie evenly; the indices are those of all points.
    """
    n = np.minimum(k, len(some.points))
    is_among = np.arange(first, last) % stride == 0
    near = _nearest(index.points, stride, some.points, some.low, some.high, first, last, n - ~is_among, int(k.max()))
    if stride == 1:
        return near
    near = np.where(near < 0, -1, near * stride)
    rows = np.flatnonzero(~is_among)
    near[rows, n[rows] - 1] = first + rows
    return near


def find_nearest_sorted(
    index: PointIndex, which: Ints, k: int, stride: int = 1, some: PointIndex | None = None
) -> Ints:
    """Return indices (len(which), k) of the k nearest points of the points `which`, nearest first.

    With a stride, each point itself and its nearest among the others of every `stride`-th point, of which `some` is the
    index.
    """
    which = np.asarray(which, dtype=np.int64)
    some = index if some is None else some
    near = stride * _nearest_of_points(index.points, stride, some.points, some.low, some.high, which, k)
    near.sort(axis=1)
    d2 = ((index.points[near] - index.points[which][:, None]) ** 2).sum(axis=2)
    near = np.take_along_axis(near, np.argsort(d2, axis=1, kind="stable"), axis=1)
    is_among = (which % stride == 0)[:, None]
    itself = which[:, None].astype(near.dtype)  # of one type with what is asked about all points: one kernel for both
    return np.where(is_among, near, np.concatenate([itself, near[:, :-1]], axis=1))


@njit(cache=True, error_model="numpy")
def gather_ball(points: Any, low: Any, high: Any, centre: Any, radius2: float, stack: Any, found: Any) -> int:
    """Write the indices of the points within the ball into `found` and return their number, however many fit."""
    n_leaves = low.shape[0] // 2
    stack[0], top, n_found = 1, 1, 0
    while top > 0:
        top -= 1
        node = stack[top]
        gap2 = 0.0
        for axis in range(3):
            gap = max(low[node, axis] - centre[axis], centre[axis] - high[node, axis], 0.0)
            gap2 += gap * gap
        if not gap2 <= radius2:
            continue
        if node < n_leaves:
            stack[top], stack[top + 1] = 2 * node + 1, 2 * node
            top += 2
            continue
        start = (node - n_leaves) * LEAF
        for i in range(start, min(start + LEAF, points.shape[0])):
            dx, dy, dz = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
            if dx * dx + dy * dy + dz * dz <= radius2:
                if n_found < found.shape[0]:
                    found[n_found] = i
                n_found += 1
    return n_found


@njit(cache=True, error_model="numpy")
def _gather_all(points: Any, low: Any, high: Any, centre: Any, radius2: float, stack: Any, found: Any) -> Any:
    """Return (indices, their number) of all points within the ball, in a larger array where `found` is too short."""
    n_found = gather_ball(points, low, high, centre, radius2, stack, found)
    if n_found > found.shape[0]:
        found = np.empty(2 * n_found, dtype=np.int32)
        n_found = gather_ball(points, low, high, centre, radius2, stack, found)
    return found, n_found


@njit(cache=True, error_model="numpy")
def _squared_distances(points: Any, found: Any, n: int, centre: Any, d2: Any) -> None:
    """Write the squared distances of the first n points of `found` to `centre` into `d2`."""
    for j in range(n):
        i = found[j]
        dx, dy, dz = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
        d2[j] = dx * dx + dy * dy + dz * dz


@njit(cache=True, error_model="numpy")
def _reach(points: Any, first: int, last: int, k: int, centre: Any) -> float:
    """Return a radius about `centre` that holds k points for certain: the k-th distance within the run of the array."""
    start, stop = max(0, first - k), min(points.shape[0], last + k)
    d2, work = np.empty(stop - start), np.empty(stop - start)
    for i in range(start, stop):
        dx, dy, dz = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
        d2[i - start] = dx * dx + dy * dy + dz * dz
    return math.sqrt(smallest(d2, stop - start, k, work))


@njit(cache=True, error_model="numpy")
def end_of_run(points: Any, first: int, last: int, k: int, stride: int, some: Any) -> int:
    """Return where, from `first` on, the points of a leaf stop lying together: farther off than the first's own k.

    The curve jumps, at worst from one end of the cloud to the other; what is shared across such a jump would be sought
    in a ball as wide.
    """
    reach = NEARBY * _reach(some, first // stride, (last + stride - 1) // stride, k, points[first])
    for i in range(first + 1, last):
        away2 = 0.0
        for axis in range(3):
            away2 += (points[i, axis] - points[first, axis]) ** 2
        if away2 > reach * reach:
            return i
    return last


@njit(cache=True, error_model="numpy")
def _nearest_of_run(
    points: Any, stride: int, some: Any, low: Any, high: Any, first: int, last: int, k: Any, found: Any, out: Any
) -> Any:
    """Write the neighbours, among `some`, of the points first to last (of one leaf): gathered once and shared."""
    stack = np.empty(128, dtype=np.int64)
    centre = np.zeros(3)
    for i in range(first, last):
        for axis in range(3):
            centre[axis] += points[i, axis] / (last - first)
    half = 0.0
    for i in range(first, last):
        dx, dy, dz = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
        half = max(half, math.sqrt(dx * dx + dy * dy + dz * dz))
    k_max = k.max()
    loose = _reach(some, first // stride, (last + stride - 1) // stride, k_max, centre) * (1.0 + 1e-12)
    found, n = _gather_all(some, low, high, centre, loose * loose, stack, found)
    d2, work = np.empty(n), np.empty(n)
    _squared_distances(some, found, n, centre, d2)
    reach = (math.sqrt(smallest(d2, n, k_max, work)) + 2.0 * half) * (1.0 + 1e-12)
    found, n = _gather_all(some, low, high, centre, reach * reach, stack, found)
    d2, work = np.empty(n), np.empty(n)
    for i in range(first, last):
        _squared_distances(some, found, n, points[i], d2)
        _write_nearest(found, d2, n, k[i - first], work, out[i - first])
    return found


@njit(cache=True, error_model="numpy")
def _write_nearest(found: Any, d2: Any, n: int, k: int, work: Any, out: Any) -> None:
    """Write the k nearest of the n found; of points at the same distance the first in the array win."""
    limit, n_out, n_tied = smallest(d2, n, k, work), 0, 0
    for j in range(n):
        if d2[j] < limit:
            out[n_out] = found[j]
            n_out += 1
    n_tied = k - n_out
    for j in range(n):
        if n_tied > 0 and d2[j] == limit:
            out[n_out] = found[j]
            n_out, n_tied = n_out + 1, n_tied - 1
    for j in range(n_out, out.shape[0]):
        out[j] = -1


@njit(cache=True, parallel=True, error_model="numpy")
def _nearest(
    points: Any, stride: int, some: Any, low: Any, high: Any, first: int, last: int, k: Any, width: int
) -> Any:
    """Run `_nearest_of_run` over the leaves of a block."""
    out = np.empty((last - first, width), dtype=np.int32)
    leaves_per_chunk = 32
    step = LEAF * leaves_per_chunk
    for chunk in prange((last - first + step - 1) // step):
        found = np.empty(4096, dtype=np.int32)
        start = first + chunk * step
        for leaf in range(start, min(last, start + step), LEAF):
            begin, stop = leaf, min(last, leaf + LEAF)
            while begin < stop:
                end = end_of_run(points, begin, stop, k[begin - first], stride, some)
                run = slice(begin - first, end - first)
                found = _nearest_of_run(points, stride, some, low, high, begin, end, k[run], found, out[run])
                begin = end
    return out


@njit(cache=True, error_model="numpy")
def _nearest_of_points(points: Any, stride: int, some: Any, low: Any, high: Any, which: Any, k: int) -> Any:
    """Run `_nearest_of_run` for single points."""
    out, sizes = np.empty((len(which), k), dtype=np.int32), np.full(1, k, dtype=np.int64)
    found = np.empty(4096, dtype=np.int32)
    for row, i in enumerate(which):
        found = _nearest_of_run(points, stride, some, low, high, i, i + 1, sizes, found, out[row : row + 1])
    return out
