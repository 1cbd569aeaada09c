"""Change over more than two epochs: regions that keep their identity, and the trend of each of them and each vertex.

In: the comparisons of several epochs with one reference epoch, and their dates. Out: a `Series` on the reference
surface. Regions are found epoch by epoch and, where no single epoch shows them, by the rates of all (`rate_regions`),
followed (`identity`), and measured over their whole footprint in every epoch (`footprints`); how each goes on is a
`Course` (`trend`).
"""

from __future__ import annotations

import datetime
import math
import numbers
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from monitor.comparison.regions.told_from import COARSE, coarse_beyond, share_of_coarse
from monitor.comparison.series.epoch_change import EpochChange
from monitor.comparison.series.footprints import GOES_ON, Footprint, measure_footprint
from monitor.comparison.series.identity import Followed, follow_rates, follow_regions, sign_of_regions
from monitor.comparison.series.rate_regions import RateRegions, find_rate_regions
from monitor.comparison.series.rate_side import Fits, make_rate_side
from monitor.comparison.series.trend import Course, fit_polynomial, predict
from monitor.comparison.series.volumes import find_bodies
from projects.errors import ComparisonError, ParameterError
from projects.model import (
    FORECAST_COLUMNS,
    HISTORY_COLUMNS,
    SERIES_COLUMNS,
    Z95,
    Assessment,
    Comparison,
    Floats,
    Series,
    Surface,
    require_noun,
)

LEAST_PART, MOST_PART = 0.1, 0.9  # of the variance of a difference, that the reference surface brings into it
MOST_LEVEL = 0.5  # as of a comparison's false discovery rate
LEVEL = 0.05  # expected share of false ones among the patches whose rate is called significant
DAYS_PER_YEAR = 365.25
AHEAD, N_FORECAST = 0.25, 21  # of the time so far; steps of the forecast


def follow(changes: Sequence[EpochChange], reference_id: str, reference_date: datetime.date, *,
           level: float = LEVEL, seed: int = 0) -> Series:  # fmt: skip
    """Return what goes on over several epochs, on the surface of their common reference epoch.

    Parameters
    ----------
    changes : two or more, each compared with the same reference surface; in any order.
    reference_id, reference_date : the earliest epoch; a date, without the time of day.
    level : expected share of false ones among the patches whose rate is called significant, as of a comparison; above 0
        and up to a half.

    Returns
    -------
    Series
        Rates in m/year, positive where material is gained; NaN where a vertex or region cannot be assessed.

    Raises
    ------
    ParameterError
        Where `changes` are no `EpochChange`, dates no dates, or the level or the seed is none.
    ComparisonError
        For fewer than two epochs, ids that are there twice, equal dates, or comparisons that do not share their
        reference surface or their mode.
    """
    require_kinds(changes, reference_date, level, seed)
    changes = sorted(changes, key=lambda c: c.date)
    require_series(changes, reference_id, reference_date)
    years = np.array([(c.date - reference_date).days for c in changes]) / DAYS_PER_YEAR
    distances = np.stack([c.side.distances for c in changes])
    sigmas = np.stack([c.side.lod95 for c in changes]) / Z95
    sigma_reference = reference_share([c.comparison for c in changes], sigmas)
    line = fit_polynomial(years, distances, sigmas, sigma_reference, degree=1)
    curve = fit_polynomial(years, distances, sigmas, sigma_reference, degree=2)
    rates = make_rate_side(changes, Fits(line, curve, years, distances, sigmas, sigma_reference))
    going = find_rate_regions(rates, level, seed)
    areas = rates.side.areas
    numbers, signs = [c.places for c in changes], [sign_of_regions(c.comparison) for c in changes]
    followed = follow_rates(follow_regions(numbers, signs, areas), going, areas, len(changes) - 1)
    share = (sigma_reference / np.fmin.reduce(sigmas)) ** 2
    found = [find_bodies(c, rates.side) for c in changes]
    measured = [measure_footprint(f, changes, found, rates.side, share, years) for f in followed]
    courses = [m.course(years, seed) for m in measured]
    identity = np.zeros(len(areas), dtype=np.int32)
    for f in sorted(followed, key=lambda f: -areas[f.footprint].sum()):
        identity[f.footprint & (identity == 0)] = f.identity
    return Series(
        reference_id, reference_date.isoformat(), tuple(c.epoch_id for c in changes),
        tuple(c.date.isoformat() for c in changes), years, line.parameters[:, 1], np.sqrt(line.covariance[:, 1, 1]),
        2.0 * curve.parameters[:, 2], 2.0 * np.sqrt(curve.covariance[:, 2, 2]), identity,
        _table([series_row(f, m, c, changes, years) for f, m, c in zip(followed, measured, courses, strict=True)],
               SERIES_COLUMNS),
        _table([row for f, m in zip(followed, measured, strict=True) for row in history_rows(f, m, changes, years)],
               HISTORY_COLUMNS),
        _table([row for f, m, c in zip(followed, measured, courses, strict=True)
                for row in forecast_rows(f, m, c, years)], FORECAST_COLUMNS),
        **how_small(going, areas, float(years[-1])),
    )  # fmt: skip


def how_small(going: RateRegions, areas: Floats, years: float) -> dict[str, Any]:
    """Return what a `Series` over so many years says of its rates: their assessment, and how small ones are told at the
    vertices of so large `areas` (n,) [m2], and in all."""
    is_assessed = going.assessment != Assessment.NOT_ASSESSABLE
    told_from = going.told_from / years
    beyond = coarse_beyond(told_from[is_assessed])
    is_coarse = (going.assessment == Assessment.UNCHANGED) & (told_from > beyond)
    share, coarsest = share_of_coarse(told_from, is_coarse, is_assessed, areas)
    figures = {
        "told_from_median_m_per_year": beyond / COARSE,
        "coarse_from_m_per_year": beyond, "coarse_area_share": share, "coarse_told_from_m_per_year": coarsest,
    }  # fmt: skip
    return {"rate_assessment": going.assessment, "rate_told_from": told_from.astype(np.float32), "statistics": figures}


def require_kinds(changes: Sequence[EpochChange], reference_date: datetime.date, level: float, seed: int) -> None:
    """Raise `ParameterError` where something given to `follow` is none of what it stands for."""
    for k, change in enumerate(changes):
        require_noun(change, f"change {k + 1} of a series", EpochChange)
    for date in (reference_date, *(c.date for c in changes)):
        if type(date) is not datetime.date:
            raise ParameterError(f"date {date!r}: a datetime.date is needed, without the time of day")
    is_number = isinstance(level, numbers.Real) and not isinstance(level, bool)
    if not is_number or not 0.0 < level <= MOST_LEVEL:
        raise ParameterError(f"level {level!r}: a share above 0 and up to {MOST_LEVEL} is needed")
    if not isinstance(seed, numbers.Integral) or seed < 0:
        raise ParameterError(f"seed {seed!r}: a whole number of at least 0 is needed")


def require_series(changes: Sequence[EpochChange], reference_id: str, reference_date: datetime.date) -> None:
    """Raise `ComparisonError` where the comparisons do not make a series."""
    if len(changes) < 2:
        raise ComparisonError(f"{len(changes)} comparison with the reference epoch; a series needs two or more")
    dates = [reference_date, *(c.date for c in changes)]
    if len(set(dates)) < len(dates) or min(dates) != reference_date:
        raise ComparisonError(
            f"dates {', '.join(d.isoformat() for d in dates)}: a series needs a different one for each epoch, "
            "the reference's first"
        )
    ids = [reference_id, *(c.epoch_id for c in changes)]
    if len(set(ids)) < len(ids):
        raise ComparisonError(f"epochs {', '.join(ids)}: a series needs a different id for each, the reference's first")
    modes = [c.comparison.mode for c in changes]
    if len(set(modes)) > 1:
        told = ", ".join(f"{c.epoch_id} {mode}" for c, mode in zip(changes, modes, strict=True))
        raise ComparisonError(
            f"modes {told}: a series needs one for all, since only absolute differences hold a motion of the whole; "
            "compare them all in relative, or all in absolute mode"
        )
    first = changes[0].side.surface
    for c in changes[1:]:
        if not np.array_equal(c.side.surface.vertices, first.vertices):
            raise ComparisonError(
                f"{c.epoch_id} was compared with another surface of the reference epoch; run monitor compare again"
            )


def reference_share(comparisons: Sequence[Comparison], sigmas: Floats) -> Floats:
    """Return the part (n,) [m] of the differences' `sigmas` (k, n) that the reference surface brings into all of them.

    As much of the smallest variance as `reference_part` says. What a surface states itself is no measure of it: stable
    areas show more or less than is stated, and the differences' sigmas are what they show.
    """
    parts = np.array([reference_part(c) for c in comparisons])
    return np.asarray(np.sqrt(np.fmin.reduce(parts[:, None] * sigmas**2)))


def reference_part(comparison: Comparison) -> float:
    """Return which part of a difference's variance is the reference's, as both surfaces state theirs; else half."""
    own, other = (_stated_variance(side.surface) for side in (comparison.on_reference, comparison.on_compared))
    if not own + other > 0.0:
        return 0.5
    return min(max(own / (own + other), LEAST_PART), MOST_PART)


def _stated_variance(surface: Surface) -> float:
    """Return the median variance [m2] of what a surface states: noise and its scans' disagreement; NaN if nothing."""
    stated = (surface.sigma, surface.sigma_shared)
    noise, shared = (float(np.median(v[np.isfinite(v)] ** 2)) if v is not None and np.isfinite(v).any() else math.nan
                     for v in stated)  # fmt: skip
    return noise if math.isnan(shared) else noise + shared


def series_row(followed: Followed, measured: Footprint, course: Course, changes: Sequence[EpochChange],
               years: Floats) -> list[object]:  # fmt: skip
    """Return the row of a followed region in the order of `SERIES_COLUMNS`."""
    seen = [changes[k].epoch_id for k in sorted(followed.numbers)] or [""]
    return [followed.identity, seen[0], seen[-1], followed.parent, followed.merged_into,
            measured.area, course.model, course.rate, course.sigma_rate, course.p_rate, course.acceleration,
            course.sigma_acceleration, course.p_acceleration, course.p_onset, *course.onset, course.p_fit,
            *(float(x) for x in measured.centre), followed.found_by, *measured.volume_rate(course, years)]  # fmt: skip


def history_rows(followed: Followed, measured: Footprint, changes: Sequence[EpochChange],
                 years: Floats) -> list[list[object]]:  # fmt: skip
    """Return the rows of a followed region, one an epoch, in the order of `HISTORY_COLUMNS`."""
    return [
        [followed.identity, c.epoch_id, float(years[k]), followed.numbers.get(k, 0), followed.events.get(k, ""),
         float(measured.means[k]), float(measured.sigmas[k]), *(float(v) for v in measured.volumes[k]),
         *area_in(c.comparison, followed.numbers.get(k, 0))]
        for k, c in enumerate(changes)
    ]  # fmt: skip


def area_in(comparison: Comparison, number: int) -> tuple[float, float]:
    """Return the area of a comparison's region and its sigma [m2]; NaN where it has no such region."""
    rows = comparison.regions
    found = rows.loc[rows["region"] == number, ["area_m2", "sigma_area_m2"]].to_numpy(dtype=float)
    return (float(found[0, 0]), float(found[0, 1])) if len(found) else (math.nan, math.nan)


def forecast_rows(followed: Followed, measured: Footprint, course: Course, years: Floats) -> list[list[object]]:
    """Return what epochs up to a quarter of the time beyond the last should show (`FORECAST_COLUMNS`).

    Nothing of what slows down: the parabola of an acceleration turns back sooner or later, and what comes to rest does
    not; nor of what merged into another.
    """
    slows_down = course.model == "accelerating" and course.acceleration * course.rate < 0.0
    degree = 2 if course.model == "accelerating" else 1
    is_open = np.count_nonzero(np.isfinite(measured.means)) < degree
    if course.model not in GOES_ON or slows_down or followed.merged_into or is_open:
        return []
    at = np.linspace(0.0, (1.0 + AHEAD) * years[-1], N_FORECAST)
    means, sigmas = predict(years, measured.means, measured.sigmas, measured.sigma_reference, at, degree)
    return [[followed.identity, float(t), float(m), float(s)] for t, m, s in zip(at, means, sigmas, strict=True)]


def _table(rows: list[list[object]], columns: tuple[str, ...]) -> pd.DataFrame:
    """Return rows as a table, with its columns where there are no rows."""
    return pd.DataFrame(rows, columns=list(columns))
