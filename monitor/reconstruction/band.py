"""The sampled band: cells near points, cut into cubic tiles with a halo, so that memory is bounded by the tile.

In: points in cell units on one lattice of an epoch. Out: `Tiles` (which points a tile and its halo hold) and, within a
tile, the cells within a few cells of a point and the nodes at their corners. Every tile sees the same band: a node
belongs to it or not whichever tile asks. After Nothegger, `001` section 3 (domain restricted to the sampled areas).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit

from monitor.boxes import box_of
from monitor.ordering import stable_order
from projects.model import Floats, Ints

OCCUPIED, IN_BAND = 1, 2


class Tiles(NamedTuple):
    """Points in cell units, sorted by tile; tile j holds `points[starts[j]:starts[j + 1]]` and lies at `corners[j]`."""

    points: Floats  # (n, 3) lattice coordinates, cells
    order: Ints  # (n,) input index of each
    corners: Ints  # (t, 3) lattice coordinates of each tile's lowest node
    starts: Ints  # (t + 1,)
    edge: int  # cells along a tile's edge

    def neighbours(self, tile: int, margin: int) -> list[int]:
        """Return the tiles within `margin` cells of `tile`, itself included, in ascending order."""
        apart = np.abs(self.corners - self.corners[tile]).max(axis=1)
        return [int(j) for j in np.flatnonzero(apart < self.edge + margin)]

    def points_within(self, tile: int, margin: int) -> Ints:
        """Return the rows of `points` in the tile and `margin` cells around it."""
        low, high = self.corners[tile] - margin, self.corners[tile] + self.edge + margin
        rows = []
        for j in self.neighbours(tile, margin):
            first, last = self.starts[j], self.starts[j + 1]
            rows.append(first + np.flatnonzero(in_box(self.points[first:last], low, high)))
        return np.concatenate(rows)


def cut_tiles(points: Floats, edge: int, reach: int) -> Tiles:
    """Cut lattice points (n, 3) into cubic tiles of `edge` cells, by where they lie and nothing else.

    A tile without points is one too where a point lies within `reach` cells of it: the band goes on into it.
    """
    low, high = (np.floor(place / edge).astype(np.int64) for place in box_of(points))
    low, shape = low - 1, high - low + 3
    key, faces = cubes_of(points, edge, reach, low, shape)
    order = stable_order(key)
    firsts = np.append(0, 1 + np.flatnonzero(np.diff(key.take(order))))
    near = np.bitwise_or.reduceat(np.left_shift(1, faces.take(order), dtype=np.uint64), firsts)
    row, faces = np.nonzero(near[:, None] >> np.arange(64, dtype=np.uint64) & np.uint64(1))
    keys = _touched_cubes(key[order[firsts]][row], faces, np.array([shape[1] * shape[2], shape[2], 1]))
    starts = np.append(np.searchsorted(key, keys, sorter=order), len(points)).astype(np.int64)
    corners = np.stack(np.unravel_index(keys, tuple(shape)), axis=1) + low
    return Tiles(points.take(order, axis=0), order, corners * edge, starts, edge)


@jit(nopython=True, cache=True, nogil=True)
def cubes_of(points: Floats, edge: int, reach: int, low: Ints, shape: Ints) -> Any:
    """Number (n,) of the cube that each point lies in, and near which of its faces (bits: -x -y -z +x +y +z)."""
    keys, faces = np.empty(len(points), np.int64), np.zeros(len(points), np.uint8)
    for i in range(len(points)):
        key = np.int64(0)
        for a in range(3):
            cube = np.floor(points[i, a] / edge)
            within = points[i, a] - cube * edge
            faces[i] |= (within < reach) << a | (within >= edge - reach) << (a + 3)
            key = key * shape[a] + np.int64(cube) - low[a]
        keys[i] = key
    return keys, faces


def _touched_cubes(keys: Ints, faces: Ints, weight: Ints) -> Ints:
    """Return the numbers (t,) of the cubes `keys` and of those across the `faces` (bits: -x -y -z +x +y +z)."""
    touched = [keys]
    for step in np.ndindex(3, 3, 3):
        crossed = sum(1 << (axis + 3 * (side == 2)) for axis, side in enumerate(step) if side != 1)
        touched.append(keys[faces & crossed == crossed] + (np.array(step) - 1) @ weight)
    return np.unique(np.concatenate(touched))


@jit(nopython=True, cache=True, nogil=True)
def ball_rows(radius: float) -> Ints:
    """Rows along z of lattice offsets within `radius` cells, (k, 3): offsets along x and y, and how far along z."""
    r = int(np.floor(radius))
    out = np.empty(((2 * r + 1) ** 2, 3), np.int64)
    n = 0
    for a in range(-r, r + 1):
        for b in range(-r, r + 1):
            left2 = radius * radius + 1e-9 - a * a - b * b
            if left2 >= 0.0:
                out[n, 0], out[n, 1], out[n, 2] = a, b, int(np.sqrt(left2))
                n += 1
    return out[:n]


@jit(nopython=True, cache=True, nogil=True)
def mark_cells(points: Floats, shape: Any, radius: float) -> Any:
    """Dense marks (uint8): OCCUPIED where a point lies, IN_BAND within `radius` cells of such a cell.

    The last layer along each axis is none of the band: it has no upper corners.
    """
    marks = np.zeros(shape, np.uint8)
    rows = ball_rows(radius)
    for i in range(points.shape[0]):
        a, b, c = int(points[i, 0]), int(points[i, 1]), int(points[i, 2])
        if marks[a, b, c] & OCCUPIED:
            continue
        marks[a, b, c] |= OCCUPIED
        for q in range(rows.shape[0]):
            x, y = a + rows[q, 0], b + rows[q, 1]
            if 0 <= x < shape[0] - 1 and 0 <= y < shape[1] - 1:
                for z in range(max(c - rows[q, 2], 0), min(c + rows[q, 2] + 1, shape[2] - 1)):
                    marks[x, y, z] |= IN_BAND
    return marks


@jit(nopython=True, cache=True, nogil=True)
def number_nodes(marks: Any) -> Any:
    """Number the corners of the band's cells in lattice order: dense index (-1 outside) and coordinates (n, 3)."""
    index = np.full(marks.shape, -1, np.int32)
    n = 0
    for a in range(marks.shape[0] - 1):
        for b in range(marks.shape[1] - 1):
            for c in range(marks.shape[2] - 1):
                if marks[a, b, c] & IN_BAND:
                    for q in range(8):
                        x, y, z = a + (q & 1), b + ((q >> 1) & 1), c + (q >> 2)
                        if index[x, y, z] == -1:
                            index[x, y, z] = -2
                            n += 1
    nodes = np.empty((n, 3), np.int32)
    n = 0
    for a in range(marks.shape[0]):
        for b in range(marks.shape[1]):
            for c in range(marks.shape[2]):
                if index[a, b, c] == -2:
                    index[a, b, c] = n
                    nodes[n, 0], nodes[n, 1], nodes[n, 2] = a, b, c
                    n += 1
    return index, nodes


@jit(nopython=True, cache=True, nogil=True)
def index_nodes(nodes: Ints, shape: Ints) -> Any:
    """Dense index of nodes (n, 3) numbered in their order, -1 elsewhere."""
    index = np.full((shape[0], shape[1], shape[2]), -1, np.int32)
    for i in range(nodes.shape[0]):
        index[nodes[i, 0], nodes[i, 1], nodes[i, 2]] = i
    return index


@jit(nopython=True, cache=True, nogil=True)
def take_values(number: Ints, values: Any, edge: int, shift: Ints, index: Any, out: Any) -> None:
    """Write to `out` (n,) the values of a tile's nodes, `number` within its cube of `edge`, that `index` has too."""
    for k in range(number.shape[0]):
        rest = number[k] // edge
        a, b, c = rest // edge + shift[0], rest % edge + shift[1], number[k] % edge + shift[2]
        if 0 <= a < index.shape[0] and 0 <= b < index.shape[1] and 0 <= c < index.shape[2] and index[a, b, c] >= 0:
            out[index[a, b, c]] = values[k]


@jit(nopython=True, cache=True, nogil=True)
def link_nodes(nodes: Ints, index: Any) -> Any:
    """Neighbours (2, 3, n) of each of n nodes, +x +y +z and -x -y -z; n where the band ends.

    Unsigned, as indices that are never counted from the end are followed twice as fast.
    """
    n = nodes.shape[0]
    links = np.full((2, 3, n), n, np.uint32)
    for i in range(n):
        a, b, c = nodes[i, 0], nodes[i, 1], nodes[i, 2]
        x = index[a + 1, b, c] if a + 1 < index.shape[0] else -1
        y = index[a, b + 1, c] if b + 1 < index.shape[1] else -1
        z = index[a, b, c + 1] if c + 1 < index.shape[2] else -1
        if x >= 0:
            links[0, 0, i], links[1, 0, x] = x, i
        if y >= 0:
            links[0, 1, i], links[1, 1, y] = y, i
        if z >= 0:
            links[0, 2, i], links[1, 2, z] = z, i
    return links


@jit(nopython=True, cache=True, nogil=True)
def in_box(places: Any, low: Any, high: Any) -> Any:
    """Which places (n, 3) lie in [low, high)."""
    out = np.empty(places.shape[0], np.bool_)
    for i in range(places.shape[0]):
        out[i] = (
            low[0] <= places[i, 0] < high[0] and low[1] <= places[i, 1] < high[1] and low[2] <= places[i, 2] < high[2]
        )
    return out
