"""The field of one tile: a function whose gradient is the mean normal and whose zero lies on the points.

In: points in cell units of a tile, their normals, the band. Out: the field at the band's nodes, in cells: about the
signed distance, positive outside. It minimises

    sum over edges (chi_j - chi_i - N_e)^2 + sum over occupied cells w chi(mean point)^2

by conjugate gradients (`conjugate_gradients.py`). Edges that leave the band carry nothing: natural (Neumann) conditions
on both faces of the band. `001` sets chi = 0 on the outer face, and then every loss of normals shifts the surface; here
the zero level is tied to the points everywhere and no global constant is left to choose.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

from projects.model import Floats, Ints

BAND = 3  # cells from an occupied cell to the end of the band
BLUR_PASSES = 4  # binomial (1 2 1) / 4 along each axis: sigma 1.4 cells
SCREENING_LENGTH = 4.0  # cells over which the points hold the field, at most
SHORTEST_SCREENING = 1.0  # cells: what the points say within one is their mean
LARGEST_TURN2 = 0.75  # rad2, of normals that fill a hemisphere, whose mean is half as long as one of them


def screening_length(cell: float, spacing: float, noise: float, turn: float) -> float:
    """Return over how many cells the points hold the field, 1 to 4.

    Parameters
    ----------
    cell, spacing, noise : m; the last two of the points.
    turn : rad, how much the normals that the field's gradient is the mean of differ from each other.

    Notes
    -----
    The mean point of a cell errs by p = noise / cell / sqrt(points in it) of a cell, the gradient on an edge by about
    g = turn / sqrt(2) where relief is finer than the mean. Least squares weigh the equations of both with 1 / p^2 and
    1 / g^2, and a sheet held by w in one layer of a band of 2 BAND + 1 follows its points over sqrt((2 BAND + 1) / w).
    """
    length = screening_by_turn(cell, spacing, noise) / max(turn, 1e-6)
    return float(np.clip(length, SHORTEST_SCREENING, SCREENING_LENGTH))


def screening_by_turn(cell: float, spacing: float, noise: float) -> float:
    """Return the screening length times the turn that asks for it, in cells and rad: that of a place where normals
    differ by t is this over t (`screening_length`)."""
    held = noise / cell / np.sqrt(max((cell / spacing) ** 2, 1.0))
    return float(np.sqrt(2.0 * (2.0 * BAND + 1.0)) * held)


@jit(nopython=True, cache=True, nogil=True)
def corner_weights(x: float, y: float, z: float, weights: Any) -> None:
    """Trilinear weights (8,) of the corners of a cell, corner q at (q & 1, (q >> 1) & 1, q >> 2)."""
    for q in range(8):
        wx = x if q & 1 else 1.0 - x
        wy = y if (q >> 1) & 1 else 1.0 - y
        wz = z if q >> 2 else 1.0 - z
        weights[q] = wx * wy * wz


@jit(nopython=True, cache=True, nogil=True)
def splat_normals(points: Floats, normals: Floats, index: Any, n_nodes: int) -> Any:
    """Weighted sums at the nodes (n, 8): normal, weight, and normal . point (all in cell units), and room.

    The room makes one vector of a node, which `blur` takes at once.
    """
    sums = np.zeros((n_nodes, 8), np.float32)
    weights = np.empty(8)
    for i in range(points.shape[0]):
        a, b, c = int(points[i, 0]), int(points[i, 1]), int(points[i, 2])
        corner_weights(points[i, 0] - a, points[i, 1] - b, points[i, 2] - c, weights)
        along = normals[i, 0] * points[i, 0] + normals[i, 1] * points[i, 1] + normals[i, 2] * points[i, 2]
        for q in range(8):
            j, w = index[a + (q & 1), b + ((q >> 1) & 1), c + (q >> 2)], weights[q]
            sums[j, 0] += w * normals[i, 0]
            sums[j, 1] += w * normals[i, 1]
            sums[j, 2] += w * normals[i, 2]
            sums[j, 3] += w
            sums[j, 4] += w * along
    return sums


@jit(nopython=True, cache=True, nogil=True)
def blur(sums: Any, links: Any, n_passes: int) -> Any:
    """Binomial filter along the axes, within the band."""
    other = np.empty_like(sums)
    for _ in range(n_passes):
        for axis in range(3):
            filter_along(sums, links[0, axis], links[1, axis], other)
            sums, other = other, sums
    return sums


@jit(nopython=True, cache=True, nogil=True)
def filter_along(sums: Any, above: Any, below: Any, out: Any) -> None:
    """Half of each node and a quarter of its neighbours along an axis, as far as it has any: a loop for each case."""
    n, half, fourth = sums.shape[0], np.float32(0.5), np.float32(0.25)
    for i in range(n):
        up, down = above[i], below[i]
        if up < n and down < n:
            for q in range(8):
                out[i, q] = (half * sums[i, q] + fourth * sums[up, q]) + fourth * sums[down, q]
        elif up < n:
            for q in range(8):
                out[i, q] = half * sums[i, q] + fourth * sums[up, q]
        elif down < n:
            for q in range(8):
                out[i, q] = half * sums[i, q] + fourth * sums[down, q]
        else:
            for q in range(8):
                out[i, q] = half * sums[i, q]


@jit(nopython=True, cache=True, nogil=True)
def field_and_start(sums: Any, nodes: Ints) -> Any:
    """Mean normal (n, 3) at the nodes and the mean signed distance (n,) to the points' planes, a good first field."""
    n = sums.shape[0]
    mean, start = np.zeros((n, 3), np.float32), np.zeros(n, np.float32)
    for i in range(n):
        w = sums[i, 3]
        if w > 1e-12:
            along = sums[i, 0] * nodes[i, 0] + sums[i, 1] * nodes[i, 1] + sums[i, 2] * nodes[i, 2]
            start[i] = (along - sums[i, 4]) / w
            mean[i, 0], mean[i, 1], mean[i, 2] = sums[i, 0] / w, sums[i, 1] / w, sums[i, 2] / w
    return mean, start


@jit(nopython=True, cache=True, nogil=True)
def divergence(mean: Any, links: Any) -> Any:
    """Right-hand side (n,): the mean normals along the edges of each node."""
    out = np.zeros(mean.shape[0], np.float32)
    for i in range(mean.shape[0]):
        for axis in range(3):
            j = links[0, axis, i]
            if j < mean.shape[0]:
                along = np.float32(0.5) * (mean[i, axis] + mean[j, axis])
                out[j] += along
                out[i] -= along
    return out


@jit(nopython=True, cache=True, nogil=True)
def screening_cells(points: Floats, shape: Any, full_cell: float) -> Any:
    """Cells that hold points: lowest node (k, 3), mean point within the cell (k, 3), and how full it is (0 to 1).

    `full_cell` is the number of points that fill a cell at the epoch's spacing; a cell that the surface only touches
    holds fewer and weighs less.
    """
    cell_of = np.full(shape, -1, np.int32)
    cells = np.empty((points.shape[0], 3), np.int32)
    sums = np.zeros((points.shape[0], 4))
    n = 0
    for i in range(points.shape[0]):
        a, b, c = int(points[i, 0]), int(points[i, 1]), int(points[i, 2])
        k = cell_of[a, b, c]
        if k < 0:
            k = n
            cell_of[a, b, c] = k
            cells[k, 0], cells[k, 1], cells[k, 2] = a, b, c
            n += 1
        sums[k, 0] += points[i, 0] - a
        sums[k, 1] += points[i, 1] - b
        sums[k, 2] += points[i, 2] - c
        sums[k, 3] += 1.0
    places, full = np.empty((n, 3)), np.empty(n, np.float32)
    for k in range(n):
        for a in range(3):
            places[k, a] = sums[k, a] / sums[k, 3]
        full[k] = min(sums[k, 3] / full_cell, 1.0)
    return cells[:n].copy(), places, full


@jit(nopython=True, cache=True, nogil=True)
def screening_weights(cells: Any, full: Any, mean: Any, index: Any, longest: float, by_turn: float) -> Any:
    """How strongly the points of each cell (k,) hold the field: so that it follows them over the length that the turn
    of the normals about the cell asks for, `longest` cells at most.

    The turn of the whole epoch is that of its largest parts: over the length that a wall allows, a pipe before it of
    three cells' radius shrinks to half and no point supports it any more. `by_turn` as of `screening_by_turn`; the
    length of the mean normals (n, 3) at the nodes, one where all look alike, tells the turn. Where it is less than the
    half that a whole hemisphere leaves, two sheets are in the mean, whose turn it does not tell.
    """
    out = np.empty(len(cells), np.float32)
    for k in range(len(cells)):
        turn2 = 0.0
        for q in range(8):
            j = index[cells[k, 0] + (q & 1), cells[k, 1] + ((q >> 1) & 1), cells[k, 2] + (q >> 2)]
            turn2 += 1.0 - mean[j, 0] ** 2 - mean[j, 1] ** 2 - mean[j, 2] ** 2
        turn = np.sqrt(max(turn2 / 8.0, 0.0))
        is_one_sheet = turn2 / 8.0 < LARGEST_TURN2
        length = max(by_turn / turn, SHORTEST_SCREENING) if is_one_sheet and longest * turn > by_turn else longest
        out[k] = full[k] * (2 * BAND + 1) / length**2
    return out


@jit(nopython=True, cache=True, nogil=True)
def screening_rows(cells: Any, places: Floats, index: Any) -> Any:
    """One row a cell that holds points: its 8 nodes, and the weights of the mean point."""
    n = cells.shape[0]
    corners, weights = np.empty((n, 8), np.int32), np.empty((n, 8), np.float32)
    for k in range(n):
        corner_weights(places[k, 0], places[k, 1], places[k, 2], weights[k])
        for q in range(8):
            corners[k, q] = index[cells[k, 0] + (q & 1), cells[k, 1] + ((q >> 1) & 1), cells[k, 2] + (q >> 2)]
    return corners, weights
