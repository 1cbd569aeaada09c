"""The volume of a followed region in every epoch: of the bodies that it found there, and of what lies beside them.

In: a followed region, the comparisons of all epochs with the reference, and the prisms over its footprint. Out: volumes
with their sigmas. Where a change is deep for its width, prisms fall short of the body, by a share that grows with the
depth: perpendiculars lead aslant to steep flanks, and half of a fold has none. So what an epoch found is its own
body, whose flanks lie in a margin around it; prisms tell of the rest of the footprint, as much larger as the body is
than they where the change is of about that size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor.comparison.detection.patches import REACHES
from monitor.comparison.distances.side import Side
from monitor.comparison.regions.borders import EDGES, FLANKS, border_shift, perimeter_of, spread_margin
from monitor.comparison.series.epoch_change import EpochChange
from projects.model import Z95, Bools, Floats, Ints

MOST_BESIDE = 0.1  # of a footprint's area: with more of it outside of its bodies these tell no ratio of all of it
MOST_UNSEEN = 0.05  # of a footprint's area: with more of it unknown outside of its bodies, their sum is not of all
SURE = 10.0  # sigmas of a body that tells a ratio: to a tenth


@dataclass(frozen=True)
class Prisms:
    """Prisms over a footprint in each epoch [m3] (k, 2) with their sigmas, what of them is noise by choice, `chosen`
    (k,) [m3], what of them was not seen, and is as unsure, `missed` (k,) [m3], and the `levels` (k,) [m], one sigma of
    a vertex there in the mean."""

    values: Floats
    chosen: Floats
    missed: Floats
    levels: Floats


@dataclass(frozen=True)
class Held:
    """What an epoch found in a footprint: volume and sigma [m3] of its `body`, and beside it an area of `beside` [m2],
    whose prisms add up to `prisms` [m3], `unseen` [m2] of it not assessed."""

    body: tuple[float, float]
    beside: float
    prisms: float
    unseen: float


@dataclass(frozen=True)
class Bodies:
    """What an epoch found: the region (n,) that each vertex lies in, `places`, and that in whose body it counts,
    `margins`, 0 for none; by their numbers the sum of what they changed by, `sizes` (r + 1,) [m3], and volumes with
    their sigmas (r + 1, 2) [m3]."""

    places: Ints
    margins: Ints
    sizes: Floats
    volumes: Floats


def measure_volumes(changes: Sequence[EpochChange], found: Sequence[Bodies], areas: Floats, at: Ints,
                    prisms: Prisms) -> Floats:  # fmt: skip
    """Return the volume of what changed over a footprint, the vertices `at`, and its sigma (k, 2) [m3] in each epoch.

    Prisms beside what an epoch `found`, and all of them where it found nothing, or nothing whose volume is known, are
    taken as much larger as the body is than the prisms in the epoch nearest in size that found all of the region; half
    of what that changes is unsure. A body that is known is told even where most of the footprint has no perpendicular.
    """
    area = float(areas[at].sum())
    held = [hold_bodies(c, f, areas, at) for c, f in zip(changes, found, strict=True)]
    bodies = np.array([h.body for h in held])
    beside, unseen = (np.array([getattr(h, name) for h in held]) for name in ("beside", "unseen"))
    is_own = np.isfinite(bodies[:, 0]) & (unseen <= MOST_UNSEEN * area)
    is_whole = is_own & (beside <= MOST_BESIDE * area)
    ratios = ratios_of(prisms.values[:, 0], bodies, is_whole)
    beside = np.where(is_own, beside, area)
    rest = np.where(is_own, [h.prisms for h in held] - prisms.chosen * beside / area, prisms.values[:, 0])
    body = np.where(is_own[:, None], bodies, 0.0)
    sigma = np.where(beside > 0.0, sigmas_beside(prisms, bodies, is_whole, area) * np.sqrt(beside / area), 0.0)
    sigma = np.hypot(ratios * sigma, 0.5 * (ratios - 1.0) * rest)
    return np.column_stack([body[:, 0] + ratios * rest, np.hypot(body[:, 1], sigma)])


def hold_bodies(change: EpochChange, found: Bodies, areas: Floats, at: Ints) -> Held:
    """Return what an epoch found in a footprint: each of its regions by the share of its change that lies there."""
    distances, number = change.side.distances[at], found.places[at]
    inside = np.bincount(number, areas[at] * np.abs(np.nan_to_num(distances)), minlength=len(found.sizes))
    inside[0] = 0.0
    there = np.unique(number[number > 0])
    share = inside[there] / found.sizes[there]
    share = np.where(share > 1.0 - MOST_BESIDE, 1.0, share)  # what lies there but for some of its border
    body = (float(share @ found.volumes[there, 0]), float(np.linalg.norm(share * found.volumes[there, 1])))
    is_beside = ~np.isin(found.margins[at], there)
    is_known, weight = np.isfinite(distances), np.where(is_beside, areas[at], 0.0)
    return Held(
        body if len(there) else (np.nan, np.nan), float(weight.sum()), float(weight @ np.nan_to_num(distances)),
        float(weight[~is_known].sum()),
    )  # fmt: skip


def ratios_of(prisms: Floats, bodies: Floats, is_whole: Bools) -> Floats:
    """Return how much larger (k,) than its prisms the body of a region is in each epoch, as it is in that of the epochs
    nearest in size whose body is of all of it, `is_whole` (k,), and known to a tenth; else in the one with the largest
    prisms; 1 without any."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio, sure = bodies[:, 0] / prisms, np.abs(bodies[:, 0]) >= SURE * bodies[:, 1]
    tells = np.flatnonzero(is_whole & (ratio > 0.0) & sure)
    if not len(tells):
        tells = np.flatnonzero(np.isfinite(ratio) & (ratio > 0.0))
        tells = tells[np.argsort(-np.abs(prisms[tells]))][:1]
    if not len(tells):
        return np.ones(len(prisms))
    apart = np.abs(np.abs(np.nan_to_num(prisms))[:, None] - np.abs(prisms[tells]))
    return np.asarray(ratio[tells[np.argmin(apart, axis=1)]])


def sigmas_beside(prisms: Prisms, bodies: Floats, is_whole: Bools, area: float) -> Floats:
    """Return one sigma (k,) [m3] of the prisms over a whole footprint: theirs, or as much of a vertex's as the bodies
    of all of it (`is_whole` (k,)) keep in any epoch, where that is less. Both sides of a deep change disagree about its
    mean, and not about its volume."""
    kept = np.where(is_whole, bodies[:, 1] / (area * prisms.levels), np.nan)
    if not np.isfinite(kept).any():
        return prisms.values[:, 1]
    return np.fmin(prisms.values[:, 1], np.hypot(np.nanmax(kept) * area * prisms.levels, prisms.missed))


def find_bodies(change: EpochChange, surface: Side) -> Bodies:
    """Return what an epoch found on the reference's `surface`."""
    places, table = change.places, change.comparison.regions
    n, volumes = len(table) + 1, np.full((len(table) + 1, 2), np.nan)
    volumes[table["region"].to_numpy(dtype=int)] = table[["volume_m3", "sigma_volume_m3"]]
    sizes = np.bincount(places, surface.areas * np.abs(np.nan_to_num(change.side.distances)), minlength=n)
    return Bodies(places, margins_of(change, places, surface), np.maximum(sizes, 1e-300), volumes)


def margins_of(change: EpochChange, places: Ints, surface: Side) -> Ints:
    """Return the region (n,) of an epoch in whose body, with its margin, each vertex counts; 0 for none.

    As far as their flanks reach (`regions.borders.margin_widths`), by the differences as they are told.
    """
    side, least = change.side, EDGES * float(np.sqrt(np.median(surface.areas)))
    by_width = change.comparison.statistics.get("told_by_width_m") or [[0.0]]
    most = max(float(by_width[0][0]) / (2.0 * (REACHES[0] + np.sqrt(2.0))), least)
    whole = side.region  # with what lies beyond the perpendiculars
    wide, widths = spread_margin(surface, whole, most), np.full(int(whole.max(initial=0)) + 1, least)
    for r in np.setdiff1d(places, [0]):
        at = np.flatnonzero(places == r)
        size = np.sign(np.nansum(side.distances[at])) * np.nan_to_num(side.distances)
        flank = Z95 * border_shift(surface, size, side.lod95, (at, wide == r)) / perimeter_of(surface, at)
        widths[r] = np.clip(FLANKS * flank, least, most)
    return spread_margin(surface, whole, widths)
