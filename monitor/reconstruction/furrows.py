"""Where fits are stretched: along furrows, ribs, edges and folds, whose shape is alike along and changes across.

In: vertices and normals of a raw surface, the samples. Out: `Reach` with `Furrows`. Where evidence of a bias ended the
climb of discs, the curvatures of the probes around tell whether there is a direction in common in which the surface
hardly bends. There ellipses, twice and four times as long as the disc last taken, are tried against it by the same
evidence (Lepski 1991). What they gain in noise is spent in part on a narrower fit across, as far as the bias known from
the climb asks. Where nothing lies in one direction the discs stay.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit
from scipy.spatial import cKDTree

from monitor.across import frames_across
from monitor.reconstruction.departures import N_HERE, compare_steps, mean_of_pool
from monitor.reconstruction.gathering import (
    OVER_THE_RIM,
    ROOM,
    Sites,
    block_edge,
    block_sites,
    find_near,
    frame_along,
    gate_height,
    gather_patch,
    mean_normal,
    near_room,
    rows_room,
)
from monitor.reconstruction.moments import Level
from monitor.reconstruction.probing import apart2, is_supported, probe_room
from monitor.reconstruction.projection import BIAS_POWER, LADDER_RATIO, Furrows, Reach, Samples
from monitor.reconstruction.quadric import CURVED, HEIGHT, UNIT_ERROR, fit_patch
from monitor.reconstruction.reach import N_POOLED, Climbed, Ladder, Probes, Stated, climb, spread_probes
from monitor.threads import run_tasks
from projects.model import Floats, Ints

STRETCHES = (2.0, 4.0)
LEAST_NOISE = 0.125  # of a point's: where discs leave less, too few wide windows lie apart to tell a bias from it
MOST_ALONG = 0.25  # squared curvature along, in that across
N_IN_COMMON = 16  # probes that have the direction in common
N_APART, MOST_POOLED = 8.0, 128  # fits that do not overlap, and probes, whose evidence is pooled
GAIN = 0.8  # of the variance: less must remain, what the evidence leaves in doubt included
DOUBT_SHARE = 0.5  # of what chance may hide of a bias, counted as if it were one
BIAS_SHARE = 0.2  # of the standard error: a larger bias asks for a narrower fit across
SPENT = 0.55  # of the disc's variance, the most that the narrower fit may have
NARROWEST_RUNG = -2  # of the ladder of discs, which it begins below
UNIT, STEP, STEP_UNIT2 = range(6, 9)


def choose_fits(
    vertices: Floats, normals: Floats, samples: Samples, ladder: Ladder, stated: Stated | None = None
) -> Reach:
    """Return how to fit around each vertex (n,), within discs or along furrows, as decided at the nearest probe.

    `stated` is what the points state of their own noise: what scatters beyond it is relief.
    """
    probes, nearest = spread_probes(vertices, normals, stated)
    climbed = climb(probes, samples, ladder)
    reach, furrows = climbed.reach.take(nearest), find_furrows(probes, climbed, samples)
    which = np.flatnonzero(furrows.stretch[nearest] > 1.0)
    if not len(which):
        return reach
    own, alongs = nearest[which], np.zeros_like(vertices)
    alongs[which] = furrows.alongs[own]
    here = Furrows(which, furrows.rung[own], furrows.stretch[own], furrows.misfit[own], alongs)
    return reach._replace(furrows=here)


def find_furrows(probes: Probes, climbed: Climbed, samples: Samples) -> Furrows:
    """Return for every probe how far its fit is stretched (1: not at all), in which direction and how narrow across.

    The misfit is what remains of the disc's bias, which grows with a power of the width, and what the ellipses were
    seen to depart by from shorter ones.
    """
    n, curved = len(probes.vertices), climbed.reach.curved
    ended = climbed.is_ended & ~climbed.reach.is_flat & (climbed.error2 > LEAST_NOISE**2 * climbed.noise2)
    which = np.flatnonzero(ended & np.isfinite(climbed.error2))
    rows = probe_along(probes, which, samples, curved, 1.0, np.zeros((n, 3)))
    alongs, share = common_direction(rows[:, :UNIT], probes)
    which = which[share[which] < MOST_ALONG]
    stretch, along2, error2, risk = np.ones(n), np.zeros(n), climbed.error2.copy(), climbed.error2.copy()
    for longer in STRETCHES:
        if not len(which):
            break
        rows, noise2 = probe_along(probes, which, samples, curved, longer, alongs)[which], climbed.noise2[which]
        pool, n_apart = pool_alike(probes, which, np.sqrt(longer) * samples.radii[curved[which]])
        step = compare_steps(rows[:, STEP], rows[:, STEP_UNIT2] * noise2, pool, n_apart)
        variance = noise2 * mean_of_pool(rows[:, UNIT] ** 2, pool, N_HERE)
        this = variance + step.excess2 + DOUBT_SHARE * step.doubt2
        taken = np.isfinite(rows[:, STEP]) & ~step.is_refused & ~step.is_doubtful & (this < GAIN * risk[which])
        which = which[taken]
        stretch[which], risk[which] = longer, this[taken]
        along2[which], error2[which] = step.excess2[taken], variance[taken]
    narrower = np.where(stretch > 1.0, narrow_by(climbed, error2, curved - lowest_rung(samples)), 0)
    left2 = climbed.misfit2 * LADDER_RATIO ** (-2.0 * BIAS_POWER * narrower)
    return Furrows(np.arange(n), curved - narrower, stretch * LADDER_RATIO**narrower, np.sqrt(left2 + along2), alongs)


def narrow_by(climbed: Climbed, error2: Floats, most: Ints) -> Ints:
    """Return by how many steps (n,) of the ladder, at most `most`, fits of variance `error2` are made narrower across.

    As long as their bias is more than a small share of their noise, and this stays well below that of the disc.
    """
    steps = np.zeros(len(error2), np.int64)
    for k in range(int(most.max(initial=0))):
        bias2 = climbed.misfit2 * LADDER_RATIO ** (-2.0 * BIAS_POWER * k)
        is_biased = bias2 > BIAS_SHARE**2 * error2 * LADDER_RATIO**k
        is_quiet = error2 * LADDER_RATIO ** (k + 1) < SPENT * climbed.error2
        steps += (steps == k) & (k < most) & is_biased & is_quiet
    return steps


def lowest_rung(samples: Samples) -> int:
    """Return the narrowest rung: below the first of the ladder no finer cells are summed up, only points will do."""
    return 0 if len(samples.levels[0].spreads) else NARROWEST_RUNG


def pool_alike(probes: Probes, which: Ints, radius: Floats) -> tuple[Ints, Floats]:
    """Return which of the probes `which` (k,) are pooled around each, counted among them, and how many fits these are.

    They come from an area that holds `N_APART` fits of its `radius` (k,) that do not overlap, as far as they are so
    many; numbers below none stand for no probe.
    """
    fit_area = 0.5 * np.pi * radius**2
    n_asked = np.clip(N_APART * fit_area / probes.area, N_POOLED, MOST_POOLED)
    places = probes.vertices[which]
    distance, pool = cKDTree(places).query(places, k=[*range(1, min(MOST_POOLED, len(which)) + 1)], workers=2)
    pool = np.where(np.pi * distance**2 > (n_asked * probes.area)[:, None], -1, pool)
    n_pooled = np.count_nonzero(pool >= 0, axis=1)
    return pool, np.clip(n_pooled * probes.area / fit_area, 1.0, n_pooled)


def common_direction(bends2: Floats, probes: Probes) -> tuple[Floats, Floats]:
    """Return the direction (n, 3) in which the surface around a probe bends least, and what share (n,) of most.

    `bends2` (n, 6) are the squares of the curvature tensors, xx xy xz yy yz zz: their mean over the probes around is
    what holds of folds too, whose sides look different ways. Infinite where nothing is known.
    """
    mean = np.column_stack([mean_of_pool(one.copy(), probes.pool, N_IN_COMMON) for one in bends2.T])
    tensor = mean[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    first, second = frames_across(probes.normals)
    a, b, c = (np.einsum("ni,nij,nj->n", x, tensor, y) for x, y in ((first, first), (first, second), (second, second)))
    turn = 0.5 * np.arctan2(2.0 * b, a - c)  # of the direction that bends most
    most = 0.5 * (a + c) + np.hypot(0.5 * (a - c), b)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (a + c - most) / most
    along = np.cos(turn)[:, None] * second - np.sin(turn)[:, None] * first
    return along, np.where(np.isfinite(share), share, np.inf)


def probe_along(probes: Probes, which: Ints, samples: Samples, rungs: Ints, stretch: float, alongs: Floats) -> Floats:
    """Return what curved fits tell at the probes `which`, each within the radius of its rung across, (n, 9).

    Their squared curvature tensor, and how the height departs from that of a fit half as long; NaN elsewhere.
    """
    rows = np.full((len(probes.vertices), 9), np.nan)
    for rung in np.unique(rungs[which]):
        at_rung, radius = which[rungs[which] == rung], float(samples.radii[rung])
        sites = block_sites(probes.vertices, probes.normals, at_rung, radius, alongs)
        sizes = (radius, stretch, gate_height(radius, samples.noise))
        run_tasks(_probe_along, len(sites.starts) - 1, sites, samples.levels[rung], sizes, rows)
    return rows


@jit(nopython=True, cache=True, nogil=True)
def _probe_along(first: int, last: int, sites: Sites, level: Level, sizes: Any, rows: Floats) -> None:
    """Probe at the vertices of the blocks `first` to `last`, for `run_tasks`; sizes are radius, stretch, gate."""
    radius, stretch, gate = sizes
    reach = np.hypot(OVER_THE_RIM * stretch * radius, gate)
    spans, near = rows_room(reach, block_edge(radius), level.bucket), near_room(ROOM)
    room = probe_room(ROOM)
    for block in range(first, last):
        n_near, near = find_near(level, sites, block, reach, spans, near)
        if n_near > len(room[1]):
            room = probe_room(2 * n_near)
        for k in range(sites.starts[block], sites.starts[block + 1]):
            i = sites.which[k]
            vertex, normal, along = sites.vertices[i], sites.normals[i], sites.alongs[k]
            probe_one_along(level, near, n_near, vertex, normal, along, sizes, room, rows[i])


@jit(nopython=True, cache=True)
def probe_one_along(
    level: Any, near: Any, n_near: int, vertex: Floats, normal: Floats, along: Floats, sizes: Any, room: Any,
    row: Floats,
) -> None:  # fmt: skip
    """Fit a window at one probe and, where it is stretched, one half as long in it."""
    held, other, fit_other, own = room
    patch, work, influence, fit = held.patch, held.work, held.influence, held.fit
    radius, stretch, gate = sizes
    if not mean_normal(near, n_near, vertex, normal, along, radius, stretch, gate, own):
        return
    n, _ = gather_patch(level, near, n_near, vertex, own, along, radius, stretch, gate, patch, held.picked)
    if not fit_patch(patch, n, radius, 1.0, stretch, CURVED, work, fit, influence) or not is_supported(fit):
        return
    row[UNIT] = fit[UNIT_ERROR]
    if stretch == 1.0:
        square_bend(work[0], own, along, radius, row)
    elif fit_patch(patch, n, radius, 1.0, 0.5 * stretch, CURVED, work, fit_other, other) and is_supported(fit_other):
        row[STEP] = fit[HEIGHT] - fit_other[HEIGHT]
        row[STEP_UNIT2] = apart2(patch, n, influence, other)


@jit(nopython=True, cache=True)
def square_bend(c: Floats, normal: Floats, along: Floats, radius: float, row: Floats) -> None:
    """Write the square (1/m2) of the curvature tensor of the patch `c` in space to `row`: xx xy xz yy yz zz."""
    t, b = frame_along(normal, along)
    uu, uv, vv = 2.0 * c[3] / radius, c[4] / radius, 2.0 * c[5] / radius
    uu, uv, vv = uu * uu + uv * uv, uv * (uu + vv), uv * uv + vv * vv
    q = 0
    for i in range(3):
        for j in range(i, 3):
            row[q] = uu * t[i] * t[j] + uv * (t[i] * b[j] + t[j] * b[i]) + vv * b[i] * b[j]
            q += 1
