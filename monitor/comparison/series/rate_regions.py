"""Where the rates of a series are significant, and what hangs together there: as a comparison finds change.

In: the rates as a side. Out: a number for each vertex. Noise and correlation are learned from what goes on nowhere,
patches of every size are tested with false discoveries held over all of them (`detection`), and what hangs
together must hold as a whole (`regions`): the chance that a series of unchanged epochs shows any region is at most the
level. So a rate that no single epoch shows is found where many epochs and many vertices together show it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from monitor.comparison.detection.detect import (
    LearnErrors,
    detect,
    errors_of_calm,
    judge_units,
    lay_out,
    learn_errors,
)
from monitor.comparison.detection.marking import level_at, mark_changed
from monitor.comparison.detection.needed import patches_needed
from monitor.comparison.detection.patches import Patches, lay_out_again
from monitor.comparison.detection.rest import away_from_both, can_teach
from monitor.comparison.detection.skirts import trim_skirts
from monitor.comparison.detection.tested import Detected
from monitor.comparison.distances.connected import connect_like
from monitor.comparison.distances.side import Side
from monitor.comparison.noise.correlation import Correlation, estimate_correlation
from monitor.comparison.noise.patch_errors import PatchErrors
from monitor.comparison.noise.scan_errors import stated_over
from monitor.comparison.regions.borders import chosen_by_noise, spread_margin
from monitor.comparison.regions.figures import CHOICE, sigma_of_mean, sigma_of_noise
from monitor.comparison.regions.finding import (
    Regions,
    assessed_area,
    bear_out_parts,
    hold_patches,
    known_of,
    least_area,
    significant,
)
from monitor.comparison.regions.told_from import tell_smallest
from monitor.comparison.series.rate_side import RateSide
from projects.model import Assessment, Bools, Floats, Ints


@dataclass(frozen=True)
class RateRegions:
    """Regions 1 to r of significant rates: the `region` (n,) of each vertex, 0 for none; the `assessment` (n,) of each
    vertex's rate, CHANGED where it is significant; and of each region (r,) the mean change over the series at its rate,
    `means` [m], what of it noise alone adds, by which its vertices were chosen, `chosen` [m], and which share of a
    vertex's sigma that mean keeps, `kept`. Of each vertex (n,), NaN where not
    assessed, from how large a change over the series on one is told, `told_from` [m] (`told_from.tell_smallest`)."""

    region: Ints
    assessment: NDArray[np.uint8]
    means: Floats
    chosen: Floats
    kept: Floats
    told_from: Floats


def find_rate_regions(rates: RateSide, level: float, seed: int) -> RateRegions:
    """Return the regions of significant rates, largest first, with false discoveries of at most `level`."""
    side = rates.side
    state = np.where(side.is_assessed, Assessment.UNCHANGED, Assessment.NOT_ASSESSABLE).astype(np.uint8)
    if not side.is_assessed.any():
        nothing, unknown = np.zeros(len(state), dtype=np.int32), np.full(len(state), np.nan)
        return RateRegions(nothing, state, np.zeros(0), np.zeros(0), np.zeros(0), unknown)
    sides = (side, side)  # nobody told the rates on another surface: this one stands for both
    found = detect_rates(rates, level, seed)
    region = trim_skirts(side, hold_together(side, found, level), found.sides[0].smooth)
    table = measure_rates(rates, region, found)
    order = np.argsort(-table["area_m2"].to_numpy(dtype=float), kind="stable")
    ordered = Regions(table, (region, region), (region, region)).keep(order)
    measured, stated = (ordered.table[c].to_numpy(dtype=float) for c in ("z_measured", "z_stated"))
    none_gone = np.zeros(len(stated), dtype=np.bool_)
    shown = significant(ordered.table, assessed_area(sides), measured, none_gone, level)
    is_known = known_of(ordered.table, sides, ordered.seen, stated, found.noise.usual, none_gone, level)
    state[np.append(False, shown & ~is_known)[ordered.seen[0]]] = Assessment.NOT_ASSESSABLE
    held = ordered.keep(np.flatnonzero(shown & is_known))
    state[held.seen[0] > 0] = Assessment.CHANGED
    means, chosen, sigmas, alone = (held.table[c].to_numpy(dtype=float)
                                    for c in ("mean_m", CHOICE, "sigma_mean_m", "sigma_vertex_m"))  # fmt: skip
    told_from = tell_smallest(sides, found, patches_needed(sides, found), level, are_points_asked=False)[0]
    told_from = np.where(state == Assessment.NOT_ASSESSABLE, np.nan, told_from)
    return RateRegions(held.seen[0].astype(np.int32), state, means, chosen, sigmas / alone, told_from)


def detect_rates(rates: RateSide, level: float, seed: int) -> Detected:
    """Decide which vertices' rates are significant.

    Noise and correlation are learned from the accelerations, in which a trend does not show, be it as wide as it may,
    and the correlation from what else departs from a line, too: a surface holds few witnesses of how far errors agree.
    What goes on nowhere must scatter as they say; where its patches scatter more, these say it.
    """
    sides, still = (rates.side, rates.side), (rates.still, rates.still)
    by_itself = detect(still, rates.motion, level, seed)
    calm = by_itself.calm
    noise = replace(by_itself.noise, correlation=pool_correlations(rates, by_itself, seed))
    layout = lay_out(still, noise, rates.motion, by_itself.layout)
    alone = judge_units(layout, still, calm, noise, level, partial(learn_errors, errors_of_calm(rates.side)))
    layout = lay_out_again(layout, sides, rates.motion)
    test = judge_units(layout, sides, calm, noise, level, lambda _: alone.errors, alone.scans)
    rest = away_from_both(sides, test)
    if can_teach(rest, sides, test):
        test = judge_units(layout, sides, rest, noise, level,
                           partial(as_wide_as, alone.errors, errors_of_calm(rates.side)), alone.scans)  # fmt: skip
    lod95 = level_at(rates.side, noise)
    none_deep = np.zeros(len(lod95), dtype=np.bool_)  # rates have one side, and no other bears out what is deep
    found = mark_changed(rates.side, rates.still, test, 0, lod95, none_deep, noise, calm[0])
    return Detected((found, found), noise, test, layout, calm)


def pool_correlations(rates: RateSide, learned: Detected, seed: int) -> Correlation:
    """Return how errors agree, the mean of what was `learned` from the accelerations and of all further departures."""
    rng, side, calm = np.random.default_rng(seed), rates.side, learned.calm[0]
    own = learned.noise.correlation
    more = [estimate_correlation(side.surface.vertices, np.where(calm, z, np.nan), side.areas, rng)
            for z in rates.further if np.isfinite(z[calm]).mean() > 0.5]  # fmt: skip
    sills = np.mean([own.sills, *(c.sills for c in more if np.array_equal(c.ranges, own.ranges))], axis=0)
    return Correlation(sills, own.ranges)


def as_wide_as(
    errors: tuple[PatchErrors, ...], learn: LearnErrors, both: tuple[Patches, Patches]
) -> tuple[PatchErrors, ...]:
    """Return how patches of each size scatter: as `errors` say, or as the calm ones do where these reach farther."""
    return tuple(one.or_wider(other) for one, other in zip(errors, learn_errors(learn, both), strict=True))


def hold_together(side: Side, found: Detected, level: float) -> Ints:
    """Return the number (n,) of the part that each vertex belongs to, 0 for none: parts that are wide enough to be a
    witness, hold as a whole, and do not lie along free edges, since no other surface bears them out."""
    kinds = np.sign(np.nan_to_num(found.sides[0].smooth)).astype(np.int8) + np.int8(1)
    part = connect_like(np.where(found.sides[0].is_changed, kinds, np.int8(-1)), [side.neighbours])
    n_parts = int(part.max(initial=-1)) + 1
    area = np.bincount(part[part >= 0], side.areas[part >= 0], minlength=n_parts)
    test = replace(found.test, n_tested=found.test.n_tested // 2)  # the one side was counted twice
    kept: Bools = hold_patches((side,), test, (part,), n_parts, level)
    kept &= bear_out_parts((side,), found.noise, (part,), n_parts) & (area >= least_area((side,), found))
    number = np.zeros(n_parts + 1, dtype=np.int32)
    number[np.flatnonzero(kept)] = np.arange(1, np.count_nonzero(kept) + 1)
    return np.asarray(number[part])  # part -1 is the last entry: 0


def measure_rates(rates: RateSide, region: Ints, found: Detected) -> pd.DataFrame:
    """Return of each region of the vertices (n,) its area, its mean change over the series with its sigma, how many
    sigmas of a normal distribution it lies off zero, with what the surfaces guess and without, the mean of what is
    stated of its vertices, and what noise alone adds to the mean."""
    side, rows, margin = rates.side, [], spread_margin(rates.side, region, found.test.size)
    stated = np.hypot(side.sigma_surfaces, side.sigma_common)
    for k in range(1, int(region.max(initial=0)) + 1):
        at = np.flatnonzero(region == k)
        mean, alone = (float(np.average(v[at], weights=side.areas[at])) for v in (side.distances, stated))
        sigmas = [of(side, found, at, rates.motion) for of in (sigma_of_mean, sigma_of_noise)]
        z = [found.test.scans.as_normal(float(np.divide(abs(mean), s)), s, stated_over(side, at)) for s in sigmas]
        sign = float(np.sign(mean))
        added, _ = chosen_by_noise(side, found.sides[0], sign, (at, margin == k), found.noise.correlation)
        rows.append([k, float(side.areas[at].sum()), mean, sigmas[0], *z, alone, sign * added])
    return pd.DataFrame(rows, columns=["region", "area_m2", "mean_m", "sigma_mean_m", "z_stated", "z_measured",
                                       "sigma_vertex_m", CHOICE])  # fmt: skip
