"""Relief that repeats, as the marks of tools, flutes and ripples do: kept by waves where fits would flatten it.

In: vertices on their smooth fits and the points. Out: the same, where a patch with waves over a wide window predicts
the points better than these fits do, on that patch. A fit follows what is wider than itself, and narrow fits are noisy;
what repeats is known from all of a window at once. Windows overlap, each judged by itself and by whether its waves go
on beyond it, and their patches are blended. What goes on and is too short for the faces is part of sigma. Where nothing
goes on not one bit changes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit

from monitor.reconstruction.gathering import ROOM, Sites, gate_height, near_room, rows_room
from monitor.reconstruction.going_on import find_going_on
from monitor.reconstruction.moments import BUCKETS_PER_RADIUS, Level, level_of_points, sort_by_cell
from monitor.reconstruction.periodogram import COSINES, HIGHEST, SINES
from monitor.reconstruction.projection import Projection, Samples
from monitor.reconstruction.wave_windows import (
    ACROSS,
    ALIKE,
    ASIDE,
    FACTOR,
    FREQUENCIES,
    LOST,
    N_FOUND,
    N_ROW,
    SHAPE,
    SHORT,
    SIZE,
    STRONGEST,
    SURELY,
    UPWARD,
    VARIANCE,
    Fits,
    fit_windows,
    laid_room,
    lay_vertices,
    weight_of,
)
from monitor.reconstruction.waves import MOST_WAVES, N_UNKNOWN, add_turns, error2_at, shape_at, window_room
from monitor.threads import run_tasks
from projects.model import Bools, Floats, Ints

RADIUS = 16.0  # of a window, in spacings: some 800 points, several of the waves that narrow fits flatten
APART = 0.8  # of the radius, from one window to the next
CELLS_A_WAVE = 3.0  # fewer, and what faces cut off of waves hides more of a change than it tells of the relief
SHORTER = 1.06  # of the frequencies that ask for smaller cells: they are known to some hundredths
FEWEST_FINER = 0.1  # of the windows, for smaller cells all over
# What a fit takes of the noise of a point next to it, over its squared standard error in sigmas of a point: 1.25 in its
# middle by its weights, more since its radius is chosen on the same noise, less beside it; 1.0 to 1.6 on relief.
TAKES = 1.3
BLOCK = 2048  # windows whose fits are held at once
WEIGHT, ALL, MOVE, MOVED2, ERROR2, TURNED, LEFT2, POINTS, FLAT2 = (
    0, 1, slice(2, 5), 5, 6, slice(7, 10), 10, 11, 12
)  # fmt: skip
N_SUMS = 13


class Kept(NamedTuple):
    """Vertices with what repeats of the relief, and which (n,) of them lie on waves, by more than a half.

    `cell` (m) is that of faces which would show waves too short for these, NaN where there are hardly any.
    """

    projection: Projection
    is_waved: Bools
    cell: float


def keep_tool_marks(projection: Projection, held: Bools, samples: Samples, spacing: float, cell: float) -> Kept:
    """Return the projection with its vertices on waves where these are known better than smooth fits.

    Parameters
    ----------
    projection : vertices on smooth fits, all of them fitted.
    held : (n,) those on edges and corners, which stay unless the waves agree with them.
    samples : the points; of the first level each is its own group.
    spacing, cell : m, between points and between vertices.
    """
    if not len(held):
        return Kept(projection, held, float("nan"))
    radius, finest = RADIUS * spacing, samples.levels[0]
    sites = lay_windows(projection, radius)
    order = sort_by_cell(projection.vertices, radius / BUCKETS_PER_RADIUS)[0]
    surface = level_of_points(projection.vertices, projection.normals, radius)
    fits = known_of(projection.take(order), held[order], radius)
    sizes, highest = (radius, gate_height(radius, samples.noise)), min(radius / (CELLS_A_WAVE * cell), HIGHEST)
    some, rows = [], []
    for first in range(0, len(sites.which), BLOCK):
        block = windows_from(sites, first)
        found = np.zeros((len(block.which), N_ROW))
        run_tasks(fit_windows, len(found), block, finest, surface, fits, (*sizes, highest), COSINES, SINES, found)
        with_waves = np.flatnonzero((found[:, N_FOUND] > 0.0) | found[:, SHORT].any(axis=1))
        some.append(first + with_waves)
        rows.append(found[with_waves])
    windows, taken = keep_going_on(sites, np.concatenate(some), np.concatenate(rows), finest, surface, sizes)
    smaller = cell_for(np.linalg.norm(taken[:, SHORT], axis=1), len(sites.which), radius)
    if not len(windows):
        return Kept(projection, np.zeros(len(held), np.bool_), smaller)
    sums = np.zeros((len(held), N_SUMS))
    _blend(take_windows(sites, windows), surface, order, sizes, taken, sums)
    _count_windows(sites, surface, order, sizes, sums)
    return Kept(*bring_onto_waves(projection, held, sums), smaller)


def keep_going_on(
    sites: Sites, windows: Ints, rows: Floats, finest: Level, surface: Level, sizes: Any
) -> tuple[Ints, Floats]:
    """Return those of the windows (k,), with their rows, whose strongest waves go on beyond them, or those too short.

    Waves that do not are taken out of the rows, and so is what they lost of waves too short where these do not.
    """
    rows = rows.copy()
    for part in (STRONGEST, SHORT):
        on = np.flatnonzero(rows[:, part].any(axis=1))
        goes_on = find_going_on(sites, windows[on], rows[on, part], finest, surface, sizes)
        rows[on[~goes_on], part] = 0.0
    rows[~rows[:, STRONGEST].any(axis=1), N_FOUND] = 0.0
    rows[~rows[:, SHORT].any(axis=1), LOST] = 0.0
    left = (rows[:, N_FOUND] > 0.0) | (rows[:, LOST] > 0.0)
    return windows[left], rows[left]


def known_of(projection: Projection, held: Bools, radius: float) -> Fits:
    """Return what is known of smooth fits, with lengths in radii (m) of windows."""
    takes = np.fmin(TAKES * projection.unit**2, 1.0)
    return Fits(takes, (projection.scatter / radius) ** 2, np.where(held, projection.sigma, 0.0) / radius)


def cell_for(frequencies: Floats, n_windows: int, radius: float) -> float:
    """Return the edge of a cell (m) that shows the waves of windows which are too short; NaN where these are few.

    `frequencies` (k,) are in waves a radius (m), 0 where there is none.
    """
    short = frequencies[frequencies > 0.0]
    if not len(short) or len(short) < FEWEST_FINER * n_windows:
        return float("nan")
    return float(radius / (CELLS_A_WAVE * SHORTER * np.quantile(short, 0.9)))


def lay_windows(projection: Projection, radius: float) -> Sites:
    """Return the middles of windows: of each cube of the lattice that has vertices that nearest to their mean."""
    order, _, starts, _, _ = sort_by_cell(projection.vertices, APART * radius)
    middles = _nearest_to_means(projection.vertices, order, starts)
    alongs = np.zeros((len(middles), 3))
    return Sites(
        projection.vertices, projection.normals, middles, np.arange(len(middles) + 1), alongs, np.empty((0, 2, 10))
    )


def windows_from(sites: Sites, first: int) -> Sites:
    """Return at most `BLOCK` windows from the `first` on."""
    return take_windows(sites, np.arange(first, min(first + BLOCK, len(sites.which))))


def take_windows(sites: Sites, windows: Ints) -> Sites:
    """Return some of the windows."""
    return sites._replace(which=sites.which[windows], starts=np.arange(len(windows) + 1), alongs=sites.alongs[windows])


def bring_onto_waves(projection: Projection, held: Bools, sums: Floats) -> tuple[Projection, Bools]:
    """Return the projection blended with the patches of windows, by the share of all windows around that found waves.

    And which vertices (n,) lie on waves by more than a half.

    What windows differ by where they overlap is part of sigma, as is what they leave that varies over several points,
    and waves too short for the faces.
    """
    on = np.flatnonzero((sums[:, WEIGHT] > 0.0) | (sums[:, FLAT2] > 0.0))
    weight, every = np.maximum(sums[on, WEIGHT], 1e-300), np.maximum(sums[on, ALL], 1e-300)
    share, mean = np.minimum(sums[on, WEIGHT] / every, 1.0), sums[on, MOVE] / weight[:, None]
    mean2 = (mean**2).sum(axis=1)
    differ2 = np.maximum(sums[on, MOVED2] / weight - mean2, 0.0)
    old2, new2 = projection.sigma[on] ** 2, sums[on, ERROR2] / weight + differ2
    agrees = ~held[on] | (mean2 < SURELY**2 * (old2 + new2))  # an edge that waves contradict is one
    on, share, weight, every, mean, mean2, old2, new2 = (
        values[agrees] for values in (on, share, weight, every, mean, mean2, old2, new2)
    )
    vertices, normals, sigma = projection.vertices.copy(), projection.normals.copy(), projection.sigma.copy()
    scatter, n_support = projection.scatter.copy(), projection.n_support.copy()
    vertices[on] += share[:, None] * mean
    turned = share[:, None] * sums[on, TURNED] / weight[:, None] + (1.0 - share[:, None]) * normals[on]
    normals[on] = turned / np.linalg.norm(turned, axis=1)[:, None]
    spread2 = share * (1.0 - share) * mean2
    sigma[on] = np.sqrt(share * new2 + (1.0 - share) * old2 + spread2 + sums[on, FLAT2] / every)
    scatter[on] = np.sqrt(share * sums[on, LEFT2] / weight + (1.0 - share) * scatter[on] ** 2)
    n_support[on] = np.round(share * sums[on, POINTS] / weight + (1.0 - share) * n_support[on])
    is_waved = np.zeros(len(held), np.bool_)
    is_waved[on] = share > 0.5
    ridden = projection._replace(vertices=vertices, normals=normals, sigma=sigma, scatter=scatter, n_support=n_support)
    return ridden, is_waved


@jit(nopython=True, cache=True)
def _nearest_to_means(vertices: Floats, order: Ints, starts: Ints) -> Ints:
    """Of each range of `order` the vertex nearest to the mean of all of it."""
    out = np.empty(len(starts) - 1, np.int64)
    for k in range(len(out)):
        x, y, z, n = 0.0, 0.0, 0.0, starts[k + 1] - starts[k]
        for q in range(starts[k], starts[k + 1]):
            x, y, z = x + vertices[order[q], 0], y + vertices[order[q], 1], z + vertices[order[q], 2]
        least = np.inf
        for q in range(starts[k], starts[k + 1]):
            p = vertices[order[q]]
            away = (p[0] - x / n) ** 2 + (p[1] - y / n) ** 2 + (p[2] - z / n) ** 2
            if away < least:
                least, out[k] = away, order[q]
    return out


@jit(nopython=True, cache=True)
def _blend(sites: Sites, surface: Level, order: Ints, sizes: Any, rows: Floats, sums: Floats) -> None:
    """Add up, for each vertex, what the windows around say of it; one after another, so that sums have one order."""
    radius, gate = sizes
    room, near = rows_room(np.hypot(radius, gate), radius, surface.bucket), near_room(ROOM)
    laid, w = laid_room(ROOM), window_room(1)
    for window in range(len(rows)):
        row = rows[window]
        n, near, laid = lay_vertices(sites, window, surface, sizes, room, near, laid)
        w.frequencies[:] = row[FREQUENCIES].copy().reshape(MOST_WAVES, 2)
        w.factor[:] = row[FACTOR].copy().reshape(N_UNKNOWN, N_UNKNOWN)
        for k in range(n):
            own, weight = sums[order[near.groups[laid.picked[k]]]], weight_of(laid, k)
            if row[N_FOUND] == 0.0:
                own[FLAT2] += weight * radius * radius * row[LOST]
            else:
                _add_waves(w, row, laid.u[k], laid.v[k], laid.z[k], weight, radius, own)


@jit(nopython=True, cache=True)
def _add_waves(w: Any, row: Floats, u: float, v: float, z: float, weight: float, radius: float, own: Floats) -> None:
    """Add what a window's waves say of a vertex at (u, v, z) to its own sums."""
    n_waves, variance = int(row[N_FOUND]), row[VARIANCE]
    height, slope_u, slope_v = shape_at(u, v, w.frequencies, n_waves, row[SHAPE], w.row)
    move, upright2 = radius * (height - z), 1.0 / (1.0 + slope_u**2 + slope_v**2)
    add_turns(u, v, n_waves, row[SHAPE], w.row)
    error2 = error2_at(w, n_waves, variance) * upright2 + row[ALIKE]
    own[WEIGHT] += weight
    for a in range(3):
        own[MOVE.start + a] += weight * move * row[UPWARD.start + a]
        turned = row[UPWARD.start + a] - slope_u * row[ACROSS.start + a] - slope_v * row[ASIDE.start + a]
        own[TURNED.start + a] += weight * turned * np.sqrt(upright2)
    own[MOVED2] += weight * move * move
    own[ERROR2] += weight * radius * radius * error2
    own[LEFT2] += weight * radius * radius * variance
    own[POINTS] += weight * row[SIZE]


@jit(nopython=True, cache=True)
def _count_windows(sites: Sites, surface: Level, order: Ints, sizes: Any, sums: Floats) -> None:
    """Add up the weights of all windows around each vertex, of those that found nothing too."""
    radius, gate = sizes
    room, near, laid = rows_room(np.hypot(radius, gate), radius, surface.bucket), near_room(ROOM), laid_room(ROOM)
    for window in range(len(sites.which)):
        n, near, laid = lay_vertices(sites, window, surface, sizes, room, near, laid)
        for k in range(n):
            sums[order[near.groups[laid.picked[k]]], ALL] += weight_of(laid, k)
