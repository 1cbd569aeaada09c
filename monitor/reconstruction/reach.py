"""How far around a vertex points may be used: as wide as the surface allows, no wider than its noise asks.

In: vertices and normals of a raw surface, the samples. Out: `Reach` for every vertex. On a ladder of radii a curved
patch is fitted at probes spread over the surface; a radius is refused where its height at the middle departs from
that of the last one taken by more than noise explains (Lepski 1991). The evidence of neighbouring probes is
pooled: a single test does not see a bias of one standard error, and all of a sphere would keep it. The same evidence
says where a plane will do, and what misfit remains, which becomes part of the vertex's sigma.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from monitor.reconstruction.departures import (
    change_around,
    compare_steps,
    count_apart,
    is_bent,
    mean_of_pool,
)
from monitor.reconstruction.probing import (
    CURVATURE,
    CURVED_UNIT,
    FLAT_STEP,
    FLAT_STEP_UNIT2,
    FLAT_UNIT,
    SCATTER,
    SECOND2,
    SECOND_UNIT2,
    STEP,
    STEP_UNIT2,
    probe,
)
from monitor.reconstruction.projection import BIAS_POWER, LADDER_RATIO, Reach, Samples
from projects.model import Bools, Floats, Ints

NARROWEST_SIGMAS = 6.0  # of noise: in a narrower window the noise passes for an edge, in one of four for curvature
VERTICES_PER_PROBE = 12
FOURTH_LEFT2 = 0.25  # of the squared bias with its fourth order taken off, on waves
FOURTH_COST = 0.3  # of the variance, that taking it off adds
N_STATED = 4  # points nearest to a probe whose stated noise counts there
N_POOLED = 32  # probes, so that several fits that do not overlap are among them
FOURTH_UNIT = 640.0  # of a wave: fourth derivative times radius to the fourth over the bias amid a curved patch
MOST_BENT = 0.84  # sum of both slopes at the rim: 0.42 of a sphere's radius, beyond which sixth order counts


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
    """Return radii from `narrowest` cells (or four sigmas) to `widest` cells, and the standard error wanted.

    Wanted is `noise_share` of the noise, but no less than a hundredth of a cell, which no mesh of that cell shows. A
    radius below six sigmas is there for bodies that are as round; windows on edges are no narrower (`for_edges`).
    """
    least = narrowest * cell
    low = max(least, NARROWEST_SIGMAS * noise)
    n = 1 + max(0, int(np.floor(np.log(max(widest * cell, low) / low) / np.log(LADDER_RATIO) + 1e-9)))
    first = -1 if low >= LADDER_RATIO * least else 0
    return Ladder(low * LADDER_RATIO ** np.arange(first, n), max(noise_share * noise, 0.01 * cell))


def for_edges(samples: Samples) -> Samples:
    """Return the samples with the radii of windows on edges: no narrower than six sigmas of noise; the first level is
    that of single points."""
    first = int(np.searchsorted(samples.radii, 0.999 * NARROWEST_SIGMAS * samples.noise))
    return Samples([samples.levels[0], *samples.levels[first + 1 :]], samples.radii[first:], samples.noise)


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
    second2, third2, most_third2 = np.full((3, n), np.nan)
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
        seen_third2, most = third_derivatives2(rows, noise2, radius, probes, n_apart)
        third2, most_third2 = renewed(third2, taken, seen_third2), renewed(most_third2, taken, most)
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
    by_others2 = np.sqrt(second2 * whole2) * FOURTH_UNIT / ladder.radii[curved] ** BIAS_POWER
    third2 = np.fmax(third2, np.fmin(by_others2, most_third2))
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


def third_derivatives2(
    rows: Floats, noise2: Floats, radius: float, probes: Probes, n_apart: float
) -> tuple[Floats, Floats]:
    """Return the sum of squares (n,) [1/m4] of the third derivatives: of how the sum of the curvatures changes around.

    Less what noise makes of it, of `n_apart` fits; NaN where too few probes know. Neither spheres nor cylinders have
    any; of all surfaces it is right in the mean, since the gradient of a Laplacian may miss a part (a monkey saddle).
    Also with that left on: no more there may be.
    """
    change2, unit2 = change_around(rows[:, CURVATURE] / radius, probes.vertices, probes.normals, probes.pool)
    by_noise2 = unit2 / n_apart * mean_of_pool(rows[:, SECOND_UNIT2] * noise2, probes.pool)
    return np.maximum(change2 - by_noise2, 0.0), change2


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
