"""Change over more than two epochs: regions that keep their identity, and the trend of each of them and each vertex.

In: the comparisons of several epochs with one reference epoch, and their dates. Out: a `Series` on the reference
surface. Each epoch's regions are found by themselves; what overlaps on the reference surface and has one sign is the
same region. A region is then measured over its whole footprint in every epoch, also where it was too small to be
found: a trend of what was found alone would start too high.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from monitor.comparison.level_of_detection import Z95
from monitor.comparison.stars import make_mesh, vertex_areas
from monitor.comparison.trend import Course, fit_course, fit_polynomial, predict
from projects.errors import ComparisonError
from projects.model import (
    FORECAST_COLUMNS,
    HISTORY_COLUMNS,
    SERIES_COLUMNS,
    Bools,
    ComparedSurface,
    Comparison,
    Floats,
    Ints,
    Series,
)

SAME = 0.2  # of the smaller area: two regions that share more are one
LEAST_SEEN = 0.5  # of a footprint's area that must be assessable for an epoch to count
DAYS_PER_YEAR = 365.25
AHEAD, N_FORECAST = 0.25, 21  # of the time so far; steps of the forecast


@dataclass(frozen=True)
class EpochChange:
    """One epoch against the reference: its name, date, and comparison."""

    epoch_id: str
    date: datetime.date
    comparison: Comparison

    @property
    def side(self) -> ComparedSurface:
        """The change on the reference surface."""
        return self.comparison.on_reference


@dataclass
class Followed:
    """A region while it is followed: where it was last seen and over all epochs, its sign, and what became of it."""

    identity: int
    sign: float
    latest: Bools
    footprint: Bools
    numbers: dict[int, int] = field(default_factory=dict)  # epoch -> region
    events: dict[int, str] = field(default_factory=dict)
    parent: int = 0
    merged_into: int = 0


def follow(changes: Sequence[EpochChange], reference_id: str, reference_date: datetime.date, *,
           seed: int = 0) -> Series:  # fmt: skip
    """Return what goes on over several epochs, on the surface of their common reference epoch.

    Parameters
    ----------
    changes : two or more, each compared with the same reference surface; in any order.
    reference_id, reference_date : the earliest epoch.

    Returns
    -------
    Series
        Rates in m/year, positive where material is gained; NaN where a vertex or region cannot be assessed.

    Raises
    ------
    ComparisonError
        For fewer than two epochs, equal dates, or comparisons that do not share their reference surface.
    """
    changes = sorted(changes, key=lambda c: c.date)
    require_series(changes, reference_date)
    years = np.array([(c.date - reference_date).days for c in changes]) / DAYS_PER_YEAR
    distances = np.stack([c.side.distances for c in changes])
    sigmas = np.stack([c.side.lod95 for c in changes]) / Z95
    sigma_reference = reference_share(changes[0].side, sigmas)
    line = fit_polynomial(years, distances, sigmas, sigma_reference, degree=1)
    curve = fit_polynomial(years, distances, sigmas, sigma_reference, degree=2)
    surface = changes[0].side.surface
    areas = vertex_areas(make_mesh(surface.vertices, surface.faces))
    followed = follow_regions([c.side for c in changes], [sign_of_regions(c.comparison) for c in changes], areas)
    share = (sigma_reference / np.fmin.reduce(sigmas)) ** 2
    measured = [measure_footprint(f, changes, areas, share) for f in followed]
    courses = [m.course(years, seed) for m in measured]
    identity = np.zeros(len(areas), dtype=np.int32)
    for f in sorted(followed, key=lambda f: -areas[f.footprint].sum()):
        identity[f.footprint & (identity == 0)] = f.identity
    return Series(
        reference_id, reference_date.isoformat(), tuple(c.epoch_id for c in changes),
        tuple(c.date.isoformat() for c in changes), years, line.parameters[:, 1], np.sqrt(line.covariance[:, 1, 1]),
        2.0 * curve.parameters[:, 2], 2.0 * np.sqrt(curve.covariance[:, 2, 2]), identity,
        _table([series_row(f, m, c, changes) for f, m, c in zip(followed, measured, courses, strict=True)],
               SERIES_COLUMNS),
        _table([row for f, m in zip(followed, measured, strict=True) for row in history_rows(f, m, changes, years)],
               HISTORY_COLUMNS),
        _table([row for f, m, c in zip(followed, measured, courses, strict=True)
                for row in forecast_rows(f, m, c, years)], FORECAST_COLUMNS),
    )  # fmt: skip


def require_series(changes: Sequence[EpochChange], reference_date: datetime.date) -> None:
    """Raise `ComparisonError` where the comparisons do not make a series."""
    if len(changes) < 2:
        raise ComparisonError(f"{len(changes)} comparison with the reference epoch; a series needs two or more")
    dates = [reference_date, *(c.date for c in changes)]
    if len(set(dates)) < len(dates) or min(dates) != reference_date:
        raise ComparisonError(
            f"dates {', '.join(d.isoformat() for d in dates)}: a series needs a different one for each epoch, "
            "the reference's first"
        )
    first = changes[0].side.surface
    for c in changes[1:]:
        if not np.array_equal(c.side.surface.vertices, first.vertices):
            raise ComparisonError(
                f"{c.epoch_id} was compared with another surface of the reference epoch; run monitor compare again"
            )


def reference_share(side: ComparedSurface, sigmas: Floats) -> Floats:
    """Return the part (n,) [m] of the differences' sigma that the reference surface brings into all of them.

    Its own sigma where it states one, at most nine tenths of the smallest variance; half of that variance elsewhere.
    """
    smallest2 = np.fmin.reduce(sigmas**2)
    own = side.surface.sigma
    if own is None:
        return np.sqrt(0.5 * smallest2)
    shared = 0.0 if side.surface.sigma_shared is None else np.nan_to_num(side.surface.sigma_shared)
    return np.sqrt(np.where(np.isfinite(own), np.minimum(own**2 + shared**2, 0.9 * smallest2), 0.5 * smallest2))


def sign_of_regions(comparison: Comparison) -> Floats:
    """Return the sign of each region's change, by its number; entry 0 is of no region."""
    means = comparison.regions["mean_m"].to_numpy(dtype=float)
    return np.append(0.0, np.sign(means))


def follow_regions(sides: Sequence[ComparedSurface], signs: Sequence[Floats], areas: Floats) -> list[Followed]:
    """Give the regions of successive epochs their identities.

    A region goes on as the one that it shares most area with. Where one becomes two, the larger share keeps the
    identity and the other gets a new one with its `parent`; where two become one, the smaller share ends as
    `merged_into`. A region that is not found in an epoch sleeps, and may go on later.
    """
    followed: list[Followed] = []
    for k, (side, sign) in enumerate(zip(sides, signs, strict=True)):
        own = side.changed_region
        regions = {r: own == r for r in range(1, len(sign)) if (own == r).any()}
        links = sorted(_overlaps(followed, regions, sign, areas), key=lambda link: -link[0])
        taken: dict[int, Followed] = {}
        gone_on: set[int] = set()
        for _, f, r in links:
            if r not in taken and f.identity not in gone_on:
                taken[r] = f
                gone_on.add(f.identity)
        for _, f, r in links:
            if f.identity not in gone_on and not f.merged_into:
                f.merged_into, f.events[k] = taken[r].identity, f"merged into {taken[r].identity}"
        for r, mask in regions.items():
            if r not in taken:
                origin = next((f for _, f, other in links if other == r), None)
                event = f"split from {origin.identity}" if origin else "appeared"
                taken[r] = Followed(len(followed) + 1, float(sign[r]), mask, mask.copy(),
                                    parent=origin.identity if origin else 0, events={k: event})  # fmt: skip
                followed.append(taken[r])
            _go_on(taken[r], k, r, mask)
    return followed


def _overlaps(followed: list[Followed], regions: dict[int, Bools], sign: Floats,
              areas: Floats) -> list[tuple[float, Followed, int]]:  # fmt: skip
    """Return (shared area, followed region, region) of each pair of one sign that shares enough."""
    links = []
    for f in followed:
        for r, mask in regions.items():
            shared = float(areas[f.latest & mask].sum())
            least = min(float(areas[f.latest].sum()), float(areas[mask].sum()))
            if not f.merged_into and f.sign == sign[r] and shared > SAME * least:
                links.append((shared, f, r))
    return links


def _go_on(followed: Followed, epoch: int, region: int, mask: Bools) -> None:
    followed.latest = mask
    followed.footprint |= mask
    followed.numbers[epoch] = region


@dataclass(frozen=True)
class Footprint:
    """A followed region in every epoch: its area [m2], centre [m], mean changes and their sigmas (k,) [m], the
    reference's part of those, and volumes with their sigmas (k, 2) [m3]."""

    area: float
    centre: Floats
    means: Floats
    sigmas: Floats
    sigma_reference: float
    volumes: Floats

    def course(self, years: Floats, seed: int) -> Course:
        """Return how it goes on; "not assessable" where no epoch is known."""
        if not (np.isfinite(self.means) & np.isfinite(self.sigmas)).any():
            return Course("not assessable", *(float("nan"),) * 7, (float("nan"), float("nan")), float("nan"))
        return fit_course(years, self.means, self.sigmas, self.sigma_reference, seed=seed)


def measure_footprint(followed: Followed, changes: Sequence[EpochChange], areas: Floats, share: Floats) -> Footprint:
    """Measure a followed region over its whole footprint in every epoch."""
    at = np.flatnonzero(followed.footprint)
    means = np.array([mean_over(c.side, areas, at) for c in changes])
    sigmas = sigmas_over(followed, changes, at)
    part = float(np.nanmean(share[at])) if np.isfinite(share[at]).any() else 0.5
    known = sigmas[np.isfinite(means) & np.isfinite(sigmas)]
    centre = np.average(changes[0].side.surface.vertices[at], axis=0, weights=areas[at])
    own = float(np.sqrt(part) * known.min()) if len(known) else float("nan")
    area = float(areas[at].sum())
    volumes = volumes_over(followed, changes, area * np.column_stack([means, sigmas]))
    return Footprint(area, centre, means, sigmas, own, volumes)


def series_row(followed: Followed, measured: Footprint, course: Course, changes: Sequence[EpochChange]) -> list[object]:
    """Return the row of a followed region in the order of `SERIES_COLUMNS`."""
    first, last = min(followed.numbers), max(followed.numbers)
    return [followed.identity, changes[first].epoch_id, changes[last].epoch_id, followed.parent, followed.merged_into,
            measured.area, course.model, course.rate, course.sigma_rate, course.p_rate, course.acceleration,
            course.sigma_acceleration, course.p_acceleration, course.p_onset, *course.onset, course.p_fit,
            *(float(x) for x in measured.centre)]  # fmt: skip


def history_rows(followed: Followed, measured: Footprint, changes: Sequence[EpochChange],
                 years: Floats) -> list[list[object]]:  # fmt: skip
    """Return the rows of a followed region, one an epoch, in the order of `HISTORY_COLUMNS`."""
    return [
        [followed.identity, c.epoch_id, float(years[k]), followed.numbers.get(k, 0), followed.events.get(k, ""),
         float(measured.means[k]), float(measured.sigmas[k]), *(float(v) for v in measured.volumes[k])]
        for k, c in enumerate(changes)
    ]  # fmt: skip


def forecast_rows(followed: Followed, measured: Footprint, course: Course, years: Floats) -> list[list[object]]:
    """Return what epochs up to a quarter of the time beyond the last should show (`FORECAST_COLUMNS`)."""
    if course.model not in ("steady", "accelerating"):
        return []
    at = np.linspace(0.0, (1.0 + AHEAD) * years[-1], N_FORECAST)
    degree = 2 if course.model == "accelerating" else 1
    means, sigmas = predict(years, measured.means, measured.sigmas, measured.sigma_reference, at, degree)
    return [[followed.identity, float(t), float(m), float(s)] for t, m, s in zip(at, means, sigmas, strict=True)]


def _table(rows: list[list[object]], columns: tuple[str, ...]) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=list(columns))


def mean_over(side: ComparedSurface, areas: Floats, at: Ints) -> float:
    """Return the area-weighted mean change [m] over vertices; NaN where less than half of them can be assessed."""
    known = np.isfinite(side.distances[at])
    if areas[at][known].sum() < LEAST_SEEN * areas[at].sum():
        return float("nan")
    return float(np.average(side.distances[at][known], weights=areas[at][known]))


def sigmas_over(followed: Followed, changes: Sequence[EpochChange], at: Ints) -> Floats:
    """Return one sigma [m] of the mean change in each epoch.

    Where the region was found, it is that of the region. Elsewhere it is the level of detection there times what the
    mean over this region kept of it in the other epochs, the largest.
    """
    levels = np.array([_mean_level(c.side, at) for c in changes])
    sigmas = np.full(len(changes), np.nan)
    for k, number in followed.numbers.items():
        table = changes[k].comparison.regions
        sigmas[k] = float(table.loc[table["region"] == number, "sigma_mean_m"].iloc[0])
    kept = np.nanmax(sigmas / levels) if np.isfinite(sigmas / levels).any() else 1.0
    return np.where(np.isfinite(sigmas), sigmas, kept * levels)


def volumes_over(followed: Followed, changes: Sequence[EpochChange], prisms: Floats) -> Floats:
    """Return the volume of a region and its sigma (k, 2) [m3] in each epoch.

    `prisms` (k, 2) are mean change and sigma times the area of the whole footprint. They leave out flanks below the
    level of detection and what has no perpendicular; the body between both surfaces, as told of a region that was
    found, holds them. Where the prisms are largest and the body is known it is taken, and prisms elsewhere are taken as
    much larger as it is there. Bodies of other epochs would be of what was found of the region by then.
    """
    bodies = np.full(prisms.shape, np.nan)
    for k, number in followed.numbers.items():
        table = changes[k].comparison.regions
        bodies[k] = table.loc[table["region"] == number, ["volume_m3", "sigma_volume_m3"]].iloc[0]
    of_body = np.where(bodies[:, 0] * prisms[:, 0] > 0.0, np.abs(prisms[:, 0]), np.nan)
    if not np.isfinite(of_body).any():
        return prisms
    most = int(np.nanargmax(of_body))
    volumes = bodies[most, 0] / prisms[most, 0] * prisms
    volumes[most] = bodies[most]
    return volumes


def _mean_level(side: ComparedSurface, at: Ints) -> float:
    levels = side.lod95[at]
    return float(np.nanmean(levels)) / Z95 if np.isfinite(levels).any() else float("nan")
