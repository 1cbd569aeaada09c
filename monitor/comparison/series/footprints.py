"""A followed region over its whole footprint in every epoch: mean change and volume, also where it was not found.

In: a followed region and the comparisons of all epochs with the reference. Out: a `Footprint`. A trend of what was
found alone would start too high, and one of what was seen alone bend where an epoch saw another part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from monitor.comparison.distances.side import Side
from monitor.comparison.series.epoch_change import EpochChange
from monitor.comparison.series.identity import Followed
from monitor.comparison.series.trend import Course, fit_course, fit_rate
from monitor.comparison.series.volumes import Bodies, Prisms, measure_volumes
from projects.model import Z95, ComparedSurface, Floats, Ints

GOES_ON = ("steady", "accelerating")  # courses that a rate describes
LEAST_SEEN = 0.5  # of a footprint's area that must be assessable for an epoch to count


@dataclass(frozen=True)
class Footprint:
    """A followed region in every epoch: its area [m2], centre [m], mean changes and their sigmas (k,) [m], the
    reference's part of those, and volumes with their sigmas (k, 2) and the reference's part of these [m3]."""

    area: float
    centre: Floats
    means: Floats
    sigmas: Floats
    sigma_reference: float
    volumes: Floats
    sigma_volume_reference: float

    def course(self, years: Floats, seed: int) -> Course:
        """Return how it goes on; "not assessable" where no epoch is known.

        By its volume, which goes on as its depth does: perpendiculars fall the shorter of that the deeper a change is,
        and a steady one would seem to slow down. How fast the mean itself goes on is told of the means; what bends is
        told in metres by what volume a metre of the mean is where it is largest.
        """
        if not np.isfinite(self.volumes).all(axis=1).any():
            return Course("not assessable", *(float("nan"),) * 7, (float("nan"), float("nan")), float("nan"))
        values, sigmas = self.volumes.T / self.per_metre
        course = fit_course(years, values, sigmas, self.sigma_volume_reference / self.per_metre, seed=seed)
        rate, sigma_rate = fit_rate(years, self.means, self.sigmas, self.sigma_reference)
        return replace(course, rate=rate, sigma_rate=sigma_rate) if np.isfinite(rate) else course

    @property
    def per_metre(self) -> float:
        """The volume [m3] that a metre of the mean is where it is largest; the area where that is not known."""
        volumes = np.where(self.means != 0.0, self.volumes[:, 0], np.nan) / np.where(self.means, self.means, np.nan)
        known = np.flatnonzero(np.isfinite(volumes))
        most = float(volumes[known[np.argmax(np.abs(self.means[known]))]]) if len(known) else 0.0
        return most if most > 0.0 else self.area

    def volume_rate(self, course: Course, years: Floats) -> tuple[float, float]:
        """Return the rate of the volume and its sigma [m3/year] of what goes on at a rate; NaN of any other course."""
        if course.model not in GOES_ON:
            return float("nan"), float("nan")
        return fit_rate(years, self.volumes[:, 0], self.volumes[:, 1], self.sigma_volume_reference)


def measure_footprint(followed: Followed, changes: Sequence[EpochChange], found: Sequence[Bodies], surface: Side,
                      share: Floats, years: Floats) -> Footprint:  # fmt: skip
    """Measure a followed region over its whole footprint in every epoch, `years` (k,) after the reference, less where
    the reference's `surface` goes on beyond its samples; `found` are the bodies of each epoch, `share` (n,) of the
    variance of a difference the reference's. From where it merged into another on, that one tells of it: NaN."""
    areas, measured = surface.areas, followed.footprint & ~surface.is_fringe
    at = np.flatnonzero(measured if measured.any() else followed.footprint)
    means = np.array([mean_over(c.side, areas, at) for c in changes])
    missed = missed_by_unseen(np.stack([c.side.distances[at] for c in changes]), areas[at])
    area, bodies = float(areas[at].sum()), bodies_of(followed, found)
    part = float(np.nanmean(share[at])) if np.isfinite(share[at]).any() else 0.5
    chosen = added_by_noise(followed, changes, areas, part, years)
    means, sigmas = means + missed - chosen / area, np.hypot(sigmas_over(followed, changes, at), missed)
    came = np.array([followed.numbers.get(k, 0) in c.came for k, c in enumerate(changes)])
    if came.any():  # how high it stands is told by its body: the ground under it has no perpendicular
        means[came], sigmas[came] = bodies[came].T / area
    means[followed.merged_at or len(means) :] = np.nan
    sigmas = np.where(np.isfinite(means), sigmas, np.nan)
    centre = np.average(changes[0].side.surface.vertices[at], axis=0, weights=areas[at])
    volumes: Floats = area * np.column_stack([means, sigmas])
    if followed.numbers and not followed.is_grown:
        levels = np.array([_mean_level(c.side, at) for c in changes])
        volumes = measure_volumes(changes, found, areas, at, Prisms(volumes, chosen, area * missed, levels))
        volumes[followed.merged_at or len(means) :] = np.nan
    own, own_volume = (float(np.sqrt(part)) * _least(s) for s in (sigmas, volumes[:, 1]))
    return Footprint(area, centre, means, sigmas, own, volumes, own_volume)


def mean_over(side: ComparedSurface, areas: Floats, at: Ints) -> float:
    """Return the area-weighted mean change [m] over vertices; NaN where less than half of them can be assessed."""
    known = np.isfinite(side.distances[at])
    if areas[at][known].sum() < LEAST_SEEN * areas[at].sum():
        return float("nan")
    return float(np.average(side.distances[at][known], weights=areas[at][known]))


def missed_by_unseen(distances: Floats, areas: Floats) -> Floats:
    """Return by how much (k,) [m] the mean over the seen part of a footprint likely falls short of that over all of it.

    `distances` (k, v) [m] are NaN where an epoch could not be assessed, `areas` (v,) [m2]. It is by how much the part
    that one epoch saw falls short of the whole in that of the others where it does most, and no surer than it is large:
    nobody saw the rest. 0 where all was seen, or in one epoch alone; NaN where no other epoch saw any of that part.
    """
    known = np.isfinite(distances)
    counted = known @ areas >= LEAST_SEEN * areas.sum()
    weights = np.where(known, areas, 0.0)
    changes = np.where(known, weights * distances, 0.0)
    with np.errstate(invalid="ignore"):
        whole = changes.sum(axis=1) / weights.sum(axis=1)
        seen = changes @ known.T / (weights @ known.T)  # of an epoch (row) where another (column) saw something
    short = whole[:, None] - seen
    short[~counted] = np.nan
    np.fill_diagonal(short, np.nan)
    size = np.abs(short)
    most = np.argmax(np.where(np.isnan(size), -1.0, size), axis=0)
    out = short[most, np.arange(len(short))]
    out[known.all(axis=1) | (np.count_nonzero(counted) < 2)] = 0.0
    return np.asarray(out)


def added_by_noise(followed: Followed, changes: Sequence[EpochChange], areas: Floats, part: float,
                   years: Floats) -> Floats:  # fmt: skip
    """Return what noise alone adds to the change over a footprint in each epoch (k,) [m3], by that its vertices were
    chosen where it showed (`regions.borders.chosen_by_noise`).

    The reference brings `part` of the variance of each difference into all of them, whichever epoch chose: as much as
    of the one that chose most. The rest is an epoch's own, and there only where it chose itself. A region that its
    rates found was chosen by all, each by its share of the time.
    """
    if followed.found_by == "trend" or followed.is_grown:
        return followed.chosen * years / years[-1]
    own = np.zeros(len(changes))
    for k, number in followed.numbers.items():
        own[k] = changes[k].choices[number] * areas[changes[k].places == number].sum()
    most = own[int(np.argmax(np.abs(own)))]
    return part * most + (1.0 - part) * own


def sigmas_over(followed: Followed, changes: Sequence[EpochChange], at: Ints) -> Floats:
    """Return one sigma [m] of the mean change in each epoch.

    Where the region was found, it is that of the region. Elsewhere it is the level of detection there times what the
    mean over this region kept of it in the other epochs, the largest; where no epoch found it, what its rates say.
    """
    levels = np.array([_mean_level(c.side, at) for c in changes])
    sigmas = np.full(len(changes), np.nan)
    for k, number in followed.numbers.items():
        table = changes[k].comparison.regions
        sigmas[k] = float(table.loc[table["region"] == number, "sigma_mean_m"].iloc[0])
    kept = np.nanmax(sigmas / levels) if np.isfinite(sigmas / levels).any() else followed.kept
    return np.where(np.isfinite(sigmas), sigmas, kept * levels)


def bodies_of(followed: Followed, found: Sequence[Bodies]) -> Floats:
    """Return volume and sigma (k, 2) [m3] of the body between both surfaces in each epoch that found the region; NaN
    where it found a part of it."""
    bodies = np.full((len(found), 2), np.nan)
    if not followed.is_grown:
        for k, number in followed.numbers.items():
            bodies[k] = found[k].volumes[number]
    return bodies


def _mean_level(side: ComparedSurface, at: Ints) -> float:
    """Return the mean sigma [m] of the vertices `at` that their levels of detection tell; NaN without any."""
    levels = side.lod95[at]
    return float(np.nanmean(levels)) / Z95 if np.isfinite(levels).any() else float("nan")


def _least(sigmas: Floats) -> float:
    """Return the least of the sigmas that are known; NaN without any."""
    known = sigmas[np.isfinite(sigmas)]
    return float(known.min()) if len(known) else float("nan")
