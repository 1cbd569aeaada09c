"""How far around a vertex points may be used: as wide as the surface allows, no wider than its noise asks.

In: vertices and normals of a raw surface, the samples. Out: `Reach` for every vertex. On a ladder of radii a curved
patch is fitted at probes spread over the surface; a radius is refused where its height at the middle departs from
that of the last one taken by more than noise explains (Lepski 1991). The evidence of neighbouring probes is
pooled: a single test does not see a bias of one standard error, and all of a sphere would keep it. The same evidence
says where a plane will do, and what misfit remains, which becomes part of the vertex's sigma.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit
from scipy.spatial import cKDTree

from monitor.reconstruction.gathering import (
    OVER_THE_RIM,
    ROOM,
    Sites,
    block_edge,
    block_sites,
    edge_of_groups,
    find_near,
    gate_height,
    gather_inner_first,
    keep_own_side,
    mean_normal,
    near_room,
    patch_room,
    rows_room,
    tangent_frame,
)
from monitor.reconstruction.moments import Level
from monitor.reconstruction.projection import BIAS_POWER, LADDER_RATIO, MOST_EXTRAPOLATED, Reach, Samples
from monitor.reconstruction.quadric import (
    BEND,
    COUNT,
    CURVED,
    EFFECTIVE,
    HEIGHT,
    PLANE,
    SIGMA,
    UNIT_ERROR,
    fit_patch,
    substitute,
    sum_up,
)
from monitor.threads import run_tasks
from projects.model import Bools, Floats, Ints

NARROWEST_SIGMAS = 6.0  # of noise: in a narrower fit the noise passes for curvature
VERTICES_PER_PROBE = 12
FOURTH_LEFT2 = 0.25  # of the squared bias with its fourth order taken off, on waves
FOURTH_COST = 0.3  # of the variance, that taking it off adds
N_HERE = 4  # probes next to each other that tell how large a bias is where it is seen
N_STATED = 4  # points nearest to a probe whose stated noise counts there
FEWEST_AROUND = 12  # probes, that tell how the curvature changes,
NARROWEST_POOL = 0.0025  # determinant over squared trace of their places: of a strip twenty times as long as wide
N_POOLED = 32  # probes, so that several fits that do not overlap are among them
DOUBT, REFUSAL, BENT = 1.25, 4.0, 2.0  # sigmas of a pooled mean square departure above that of noise alone
ONE_SIDED = 1.5  # sigmas of the mean departure of pooled probes, which curvature gives one sign
OWN_REFUSAL = 16.0  # the same for one probe: four sigma
CLIPPED, MEAN_CLIPPED = (
    4.0,
    0.92,
)  # of a squared departure, so that an edge nearby does not decide; mean of min(chi2, 4)
MOST_BENT = 0.84  # sum of both slopes at the rim: 0.42 of a sphere's radius, beyond which sixth order counts
(
    CURVATURE,
    CURVED_UNIT,
    SCATTER,
    STEP,
    STEP_UNIT2,
    FLAT_UNIT,
    FLAT_STEP,
    FLAT_STEP_UNIT2,
    SECOND2,
    SECOND_UNIT2,
    N_ROW,
) = range(11)


class Ladder(NamedTuple):
    """Radii tried (m, ascending) and the standard error (m) below which no wider one is tried."""

    radii: Floats
    wanted: float


class Stated(NamedTuple):
    """What the points state of their own noise: one sigma (m) for each point of the tree."""

    points: cKDTree
    sigma: Floats

    def at(self, places: Floats) -> Floats:
        """Return the root mean square of what the nearest points state at places (n, 3); NaN where one states none."""
        _, index = self.points.query(places, k=[*range(1, min(N_STATED, self.points.n) + 1)], workers=2)
        return np.sqrt(np.mean(self.sigma[index] ** 2, axis=1))


class Probes(NamedTuple):
    """Places on the surface where radii are tried; `pool` (n, k) names those around each, `area` (m2) is each one's."""

    vertices: Floats
    normals: Floats
    pool: Ints
    area: float
    stated: Floats  # (n,) m, one sigma of the points there as stated; NaN where nothing is
    cuts: Floats | None = None  # (n, 2, 10) beyond which points are of another side


class Climbed(NamedTuple):
    """Where the climb came to at each probe (n,), and what is known there of the curved patch last taken."""

    reach: Reach
    is_ended: Bools  # by evidence of a bias
    error2: Floats  # m2, of noise
    misfit2: Floats  # m2, of the bias, all of it
    noise2: Floats  # m2, of one point


def make_ladder(cell: float, noise: float, narrowest: float, widest: float, noise_share: float) -> Ladder:
    """Return radii from `narrowest` cells (or six sigmas) to `widest` cells, and the standard error wanted.

    Wanted is `noise_share` of the noise, but no less than a hundredth of a cell, which no mesh of that cell shows.
    """
    low = max(narrowest * cell, NARROWEST_SIGMAS * noise)
    n = 1 + max(0, int(np.floor(np.log(max(widest * cell, low) / low) / np.log(LADDER_RATIO) + 1e-9)))
    return Ladder(low * LADDER_RATIO ** np.arange(n), max(noise_share * noise, 0.01 * cell))


def measure_noise(places: Floats, normals: Floats, samples: Samples) -> float:
    """Return the median scatter (m) of the points about curved patches of the first radius; NaN without any."""
    rows = probe(places, normals, np.arange(len(places)), samples, 0, np.ones(len(places)))
    known = rows[np.isfinite(rows[:, SCATTER]), SCATTER]
    return float(np.median(known)) if len(known) else float("nan")


def choose_reach(
    vertices: Floats, normals: Floats, samples: Samples, ladder: Ladder, stated: Stated | None = None,
    cuts: Floats | None = None,
) -> Reach:  # fmt: skip
    """Return how to fit around each vertex (n,), decided at probes and taken over from the nearest one.

    `stated` is what the points state of their own noise: what scatters beyond it is relief. Points beyond `cuts`
    (n, 2, 10) are left out, where given.
    """
    probes, nearest = spread_probes(vertices, normals, stated, cuts)
    return climb(probes, samples, ladder).reach.take(nearest)


def spread_probes(
    vertices: Floats, normals: Floats, stated: Stated | None, cuts: Floats | None = None
) -> tuple[Probes, Ints]:
    """Return probes among the vertices (n, 3), and for each vertex (n,) the nearest one."""
    probes = np.arange(0, len(vertices), VERTICES_PER_PROBE)
    tree = cKDTree(vertices[probes])
    distance, pool = tree.query(vertices[probes], k=[*range(1, min(N_POOLED, len(probes)) + 1)], workers=2)
    area = np.pi * float(np.median(distance[:, -1])) ** 2 / pool.shape[1]
    own = stated.at(vertices[probes]) if stated else np.full(len(probes), np.nan)
    held = Probes(vertices[probes], normals[probes], pool, area, own, None if cuts is None else cuts[probes])
    return held, tree.query(vertices, workers=2)[1]


def climb(probes: Probes, samples: Samples, ladder: Ladder) -> Climbed:
    """Go up the ladder at every probe until a radius is refused or the wanted standard error is reached.

    A radius that is only doubtful is passed over; two doubtful ones in succession end the climb, since a bias grows
    with the radius and chance does not. What departs at a radius says how large the bias is there and, by the power
    with which it grows, how large at the last radius taken: both are part of the misfit. Where taking off its fourth
    order gains more than the noise that it adds, it is taken off (`fit_fourth`), there only: a bias that like epochs
    share falls out of their difference, noise does not. A plane is taken only where it holds about as far as the curved
    patch does, and beyond the narrowest radius: a narrow one trades noise for a bias that has one sign all over a
    curved surface.
    """
    n, pool = len(probes.vertices), probes.pool
    second2, third2 = np.full((2, n), np.nan)
    curved, flat = np.zeros(n, np.int64), np.zeros(n, np.int64)
    risk, flat_risk = np.full(n, np.inf), np.full(n, np.inf)
    misfit2, flat_misfit2, own_error2 = np.zeros(n), np.zeros(n), np.full(n, np.inf)
    is_fourth, is_ended = np.zeros(n, bool), np.zeros(n, bool)
    climbing, doubted, noise2 = np.ones(n, bool), np.zeros(n, bool), np.full(n, np.nan)
    for k, radius in enumerate(ladder.radii):
        inner = np.where(np.isfinite(risk), ladder.radii[curved] / radius, 1.0 / LADDER_RATIO)
        rows = probe(probes.vertices, probes.normals, np.flatnonzero(climbing), samples, k, inner, probes.cuts)
        noise2 = np.where(np.isnan(noise2), noise_variance(rows[:, SCATTER], probes.stated, pool), noise2)
        error2, flat_error2 = (noise2 * mean_of_pool(rows[:, j] ** 2, pool) for j in (CURVED_UNIT, FLAT_UNIT))
        n_apart = count_apart(pool.shape[1], probes.area, radius)
        step = compare_steps(rows[:, STEP], rows[:, STEP_UNIT2] * noise2, pool, n_apart)
        flat_step = compare_steps(rows[:, FLAT_STEP], rows[:, FLAT_STEP_UNIT2] * noise2, pool, n_apart)
        has_fit = np.isfinite(risk)
        is_steep = np.abs(mean_of_pool(rows[:, CURVATURE], pool)) > MOST_BENT
        is_doubtful = (is_steep | step.is_doubtful | is_bent(step, radius, probes.area)) & has_fit
        bends = (step.is_refused | (is_doubtful & doubted)) & has_fit & np.isfinite(error2)
        per2 = 1.0 / np.maximum(1.0 - inner**BIAS_POWER, 0.5) ** 2
        bias2 = per2 * step.excess2
        ends, shrinks = climbing & bends, per2 * inner ** (2 * BIAS_POWER)
        below2 = np.where(ends, shrinks * np.where(is_steep, step.excess2, np.fmax(step.excess2, step.here2)), 0.0)
        is_fourth |= ends & ~is_steep & ((1.0 - FOURTH_LEFT2) * shrinks * step.here2 > FOURTH_COST * own_error2)
        is_ended |= ends
        misfit2, risk = np.maximum(misfit2, below2), risk + np.maximum(below2 - misfit2, 0.0)
        climbing &= ~has_fit | (np.isfinite(error2) & ~bends)
        doubted = is_doubtful
        taken = climbing & ~doubted & np.isfinite(error2)
        curved, misfit2 = np.where(taken, k, curved), np.where(taken, bias2, misfit2)
        risk, own_error2 = np.where(taken, error2 + bias2, risk), np.where(taken, error2, own_error2)
        second2 = renewed(second2, taken, second_derivatives2(rows, noise2, pool))
        third2 = renewed(third2, taken, third_derivatives2(rows, noise2, radius, probes, n_apart))
        this_risk = flat_error2 + flat_step.excess2 + flat_step.doubt2
        bows = flat_step.is_refused | flat_step.is_doubtful | flat_step.is_one_sided
        better = taken & ~bows & (this_risk < flat_risk)
        flat, flat_misfit2 = np.where(better, k, flat), np.where(better, flat_step.excess2, flat_misfit2)
        flat_risk = np.where(better, this_risk, flat_risk)
        climbing &= ~(np.where(flat_risk < risk, flat_error2, error2) <= ladder.wanted**2)
        if not climbing.any():
            break
    whole2 = misfit2
    risk += FOURTH_COST * np.where(is_fourth, own_error2, 0.0) - np.where(
        is_fourth, (1.0 - FOURTH_LEFT2) * misfit2, 0.0
    )
    misfit2 = np.where(is_fourth, FOURTH_LEFT2 * misfit2, misfit2)
    is_flat = (flat_risk < risk) & (flat + 1 >= curved) & (flat > 0)
    misfit = np.sqrt(np.where(is_flat, flat_misfit2, misfit2))
    third2 = np.where(np.isfinite(third2), third2, second2 / ladder.radii[curved] ** 2)
    whole, second, third = np.sqrt(whole2), np.sqrt(second2), np.sqrt(third2)
    reach = Reach(curved, flat, is_flat, is_fourth, misfit, np.sqrt(noise2), whole, second, third)
    return Climbed(reach, is_ended, own_error2, whole2, noise2)


def renewed(values: Floats, which: Bools, new: Floats) -> Floats:
    """Return the values (n,) with the new ones of `which` (n,), where these are known."""
    return np.where(which & np.isfinite(new), new, values)


def second_derivatives2(rows: Floats, noise2: Floats, pool: Ints) -> Floats:
    """Return the sum of squares (n,) [1/m2] of the second derivatives around, less what noise makes of them; NaN where
    nothing is known."""
    return np.maximum(mean_of_pool(rows[:, SECOND2] - rows[:, SECOND_UNIT2] * noise2, pool), 0.0)


def third_derivatives2(rows: Floats, noise2: Floats, radius: float, probes: Probes, n_apart: float) -> Floats:
    """Return the sum of squares (n,) [1/m4] of the third derivatives: of how the sum of the curvatures changes around.

    Less what noise makes of it, of `n_apart` fits; NaN where too few probes know. Neither spheres nor cylinders have
    any; of all surfaces it is right in the mean, since the gradient of a Laplacian may miss a part (a monkey saddle).
    """
    change2, unit2 = change_around(rows[:, CURVATURE] / radius, probes.vertices, probes.normals, probes.pool)
    return np.maximum(change2 - unit2 / n_apart * mean_of_pool(rows[:, SECOND_UNIT2] * noise2, probes.pool), 0.0)


@jit(nopython=True, cache=True, nogil=True)
def change_around(values: Floats, places: Floats, normals: Floats, pool: Ints) -> Any:
    """Squared gradient (n,) along the surface of `values` over each place's pool, and what independent errors of one
    unit make of it, times their number [1/m2]; NaN where too few are known, or they lie on a line.

    Places whose normals look the other way are of another sheet.
    """
    change2, unit2 = np.full(len(values), np.nan), np.full(len(values), np.nan)
    for i in range(len(values)):
        (tx, ty, tz), (bx, by, bz) = tangent_frame(normals[i])
        n = su = sv = sh = suu = suv = svv = suh = svh = 0.0
        for j in pool[i]:
            h = values[j]
            cosine = normals[j, 0] * normals[i, 0] + normals[j, 1] * normals[i, 1] + normals[j, 2] * normals[i, 2]
            if np.isfinite(h) and cosine > 0.0:
                x, y, z = places[j, 0] - places[i, 0], places[j, 1] - places[i, 1], places[j, 2] - places[i, 2]
                u, v = x * tx + y * ty + z * tz, x * bx + y * by + z * bz
                n, su, sv, sh = n + 1.0, su + u, sv + v, sh + h
                suu, suv, svv, suh, svh = suu + u * u, suv + u * v, svv + v * v, suh + u * h, svh + v * h
        if n < FEWEST_AROUND:
            continue
        suu, suv, svv = (suu - su * su / n) / n, (suv - su * sv / n) / n, (svv - sv * sv / n) / n
        suh, svh = (suh - su * sh / n) / n, (svh - sv * sh / n) / n
        det, both = suu * svv - suv * suv, suu + svv
        if det > NARROWEST_POOL * both * both:
            gu, gv = (svv * suh - suv * svh) / det, (suu * svh - suv * suh) / det
            change2[i], unit2[i] = gu * gu + gv * gv, both / det
    return change2, unit2


def noise_variance(scatter: Floats, stated: Floats, pool: Ints) -> Floats:
    """Return the variance (n,) [m2] of the points by which fits are judged, pooled over the probes around.

    It is that of the scatter (n,) about the narrowest fits, but no more than what the points state, by as much as all
    of the surface shows them to understate: relief finer than these fits scatters about them too, and what serves as
    its noise would let any wider fit pass.
    """
    pooled2 = mean_of_pool(scatter**2, pool)
    ratio = scatter / stated
    known = np.isfinite(ratio)
    if not known.any():
        return pooled2
    scale = max(float(np.median(ratio[known])), 1.0)
    return np.fmin(pooled2, scale**2 * mean_of_pool(stated**2, pool))


def count_apart(n: int, area: float, radius: float) -> float:
    """Return how many independent fits `n` probes of `area` (m2) each amount to; those that overlap tell the same."""
    return min(float(n), max(n * area / (0.5 * np.pi * radius**2), 1.0))


def is_bent(step: Departure, radius: float, area: float) -> bool:
    """Whether probes together depart more than noise explains: a bias too small for any one neighbourhood.

    Neighbourhoods that doubt the radius by themselves are left out: their relief says nothing of the rest.
    """
    known = step.own2[np.isfinite(step.own2) & ~step.is_doubtful]
    if not len(known):
        return False
    limit = 1.0 + BENT * np.sqrt(2.0 / count_apart(len(known), area, radius))
    return bool(np.minimum(known, CLIPPED).mean() / MEAN_CLIPPED > limit)


class Departure(NamedTuple):
    """How two fits depart from each other at each probe: beyond noise or perhaps so; by how much (m2), how sure."""

    own2: Floats  # squared, in units of its variance
    is_refused: Bools
    is_doubtful: Bools
    is_one_sided: Bools
    excess2: Floats
    here2: Floats  # m2, by how much at the probe and those next to it, edges and all
    doubt2: Floats


@jit(nopython=True, cache=True, nogil=True)
def mean_of_pool(values: Floats, pool: Ints, n_next: int = 1 << 30) -> Floats:
    """Mean over each probe's neighbours, of which the next `n_next` count; NaN where none has a value.

    Numbers below none in the pool stand for no neighbour.
    """
    out = np.empty(len(pool))
    for i in range(len(pool)):
        total, count = 0.0, 0
        for k in range(min(pool.shape[1], n_next)):
            value = values[pool[i, k]]
            if pool[i, k] >= 0 and np.isfinite(value):
                total += value
                count += 1
        out[i] = total / count if count > 0 else np.nan
    return out


def compare_steps(step: Floats, variance: Floats, pool: Ints, n_apart: float | Floats) -> Departure:
    """Judge departures (n,) against the variance (n,) that noise gives them, pooled over the probes around."""
    chance = np.sqrt(2.0 / n_apart)
    with np.errstate(invalid="ignore", divide="ignore"):
        own = step**2 / variance
        pooled = mean_of_pool(np.minimum(own, CLIPPED), pool) / MEAN_CLIPPED
        is_refused = (pooled > 1.0 + REFUSAL * chance) | (own > OWN_REFUSAL)
        one_sided = np.abs(mean_of_pool(np.clip(step / np.sqrt(variance), -2.0, 2.0), pool)) > ONE_SIDED / np.sqrt(
            n_apart
        )
        is_doubtful = pooled > 1.0 + DOUBT * chance
    expected = mean_of_pool(variance, pool)
    excess2 = np.nan_to_num(np.maximum(pooled - 1.0, 0.0) * expected)
    here2 = np.nan_to_num(np.maximum(mean_of_pool(step**2 - variance, pool, N_HERE), 0.0))
    return Departure(own, is_refused, is_doubtful, one_sided, excess2, here2, expected * chance)


@jit(nopython=True, cache=True)
def is_supported(fit: Floats) -> bool:
    """Whether points lie all around, so that the patch does not extrapolate."""
    supported: bool = fit[UNIT_ERROR] * np.sqrt(fit[EFFECTIVE]) <= MOST_EXTRAPOLATED
    return supported


@jit(nopython=True, cache=True)
def probe_one(
    level: Any, near: Any, n_near: int, vertex: Floats, normal: Floats, along: Floats, sizes: Any, room: Any,
    row: Floats,
) -> None:  # fmt: skip
    """Compare three fits at one probe: curved within the radius, curved within the last taken, plane."""
    held, other, fit_other, own = room
    patch, work, influence, fit = held.patch, held.work, held.influence, held.fit
    radius, gate, inner = sizes
    if not mean_normal(near, n_near, vertex, normal, along, radius, 1.0, gate, own):
        return
    shape = (radius, 1.0, gate, inner)
    n_inner, n = gather_inner_first(level, near, n_near, vertex, own, along, shape, patch, held.picked)
    if not fit_patch(patch, n, radius, 1.0, 1.0, CURVED, work, fit, influence):
        return
    if not is_supported(fit):
        return
    row[CURVATURE], row[CURVED_UNIT], row[SCATTER] = fit[BEND], fit[UNIT_ERROR], fit[SIGMA]
    write_second(patch, n, radius, work, row)
    if (
        inner < 1.0
        and fit_patch(patch, n_inner, radius, inner, 1.0, CURVED, work, fit_other, other)
        and is_supported(fit_other)
    ):
        other[n_inner:n] = 0.0
        row[STEP] = fit[HEIGHT] - fit_other[HEIGHT]
        row[STEP_UNIT2] = apart2(patch, n, influence, other)
    if fit_patch(patch, n, radius, 1.0, 1.0, PLANE, work, fit_other, other):
        row[FLAT_UNIT] = fit_other[UNIT_ERROR]
        row[FLAT_STEP] = fit[HEIGHT] - fit_other[HEIGHT]
        row[FLAT_STEP_UNIT2] = apart2(patch, n, influence, other)


@jit(nopython=True, cache=True)
def write_second(patch: Floats, n: int, radius: float, work: Any, row: Floats) -> None:
    """Write the sum of squares (1/m2) of the second derivatives of the patch fitted last, and of the sum of both
    curvatures the variance (1/m4) in that of a point, which is about that of the former too."""
    c, a, g, _, squares, _, weights, influence = work
    row[SECOND2] = (4.0 * c[3] * c[3] + 2.0 * c[4] * c[4] + 4.0 * c[5] * c[5]) / radius**2
    g[:] = 0.0
    g[3] = g[5] = 2.0
    substitute(a, g, 6)
    _, _, _, variance = sum_up(patch, n, g, squares, weights, influence)
    row[SECOND_UNIT2] = variance / radius**4


@jit(nopython=True, cache=True)
def probe_room(n: int) -> Any:
    """Room for two fits to one patch of up to n groups, and for its normal."""
    return patch_room(n), np.empty(n), np.empty(7), np.empty(3)


@jit(nopython=True, cache=True)
def apart2(patch: Floats, n: int, influence: Floats, other: Floats) -> float:
    """Variance of the difference of two fits to one patch, in units of that of a point."""
    total = 0.0
    for i in range(n):
        total += patch[COUNT, i] * (influence[i] - other[i]) ** 2
    return total


def probe(
    places: Floats, normals: Floats, which: Ints, samples: Samples, rung: int, inner: Floats,
    cuts: Floats | None = None,
) -> Floats:  # fmt: skip
    """Return what fits at one rung tell at the places `which`, (n, `N_ROW`); NaN elsewhere.

    `inner` (n,) is the share of the radius within which the fit to compare with is made; 1 for none.
    """
    rows = np.full((len(places), N_ROW), np.nan)
    radius = samples.radii[rung]
    if len(which):
        sites, gate = block_sites(places, normals, which, radius, cuts=cuts), gate_height(radius, samples.noise)
        run_tasks(_probe, len(sites.starts) - 1, sites, samples.levels[rung], radius, gate, inner, rows)
    return rows


@jit(nopython=True, cache=True, nogil=True)
def _probe(
    first: int, last: int, sites: Sites, level: Level, radius: float, gate: float, inner: Floats, rows: Floats
) -> None:
    """Probe at the vertices of the blocks `first` to `last`, for `run_tasks`."""
    reach = np.hypot(OVER_THE_RIM * radius, gate)
    spans, near = rows_room(reach, block_edge(radius), level.bucket), near_room(ROOM)
    room, mixed, own = probe_room(ROOM), edge_of_groups(level, radius), near_room(ROOM)
    for block in range(first, last):
        n_near, near = find_near(level, sites, block, reach, spans, near)
        if n_near > len(room[1]):
            room = probe_room(2 * n_near)
        if len(near.groups) > len(own.groups):
            own = near_room(len(near.groups))
        for k in range(sites.starts[block], sites.starts[block + 1]):
            i = sites.which[k]
            sizes = (radius, gate, inner[i])
            vertex, normal, along = sites.vertices[i], sites.normals[i], sites.alongs[k]
            if len(sites.cuts) == 0:
                probe_one(level, near, n_near, vertex, normal, along, sizes, room, rows[i])
            else:
                n_own = keep_own_side(near, n_near, sites.cuts[k], mixed, own)
                probe_one(level, own, n_own, vertex, normal, along, sizes, room, rows[i])
