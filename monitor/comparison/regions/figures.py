"""The figures of one change region: area, volume, extreme, mean, each with a sigma that knows of correlation.

A vertex stands for a prism: its area, across the way to its foot, times its change. Volume and mean are those of both
surfaces' view: seen from the reference a curved gain looks too small, from the compared surface too large, and the mean
of the two is the volume between them to second order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from monitor.comparison.detection.tested import Detected
from monitor.comparison.distances.side import Side, cosine_to_foot
from monitor.comparison.noise.correlation import Correlation, kept_variance
from monitor.comparison.noise.guesses import sigma_of_guess
from monitor.comparison.noise.scan_errors import ScanErrors, stated_over
from monitor.comparison.regions.beyond import SIGNS, Beyond
from monitor.comparison.regions.borders import chosen_by_noise, sigma_of_area, spread_margin
from monitor.registration.motion.sampling import motion_rows
from projects.model import Z95, Bools, Floats, Ints, NotAssessed, Registration

Pair = tuple[Side, Side]
N_AROUND = 7  # vertices, the place itself among them, that tell how large the largest change is
LEAST_AROUND, SHARE_AROUND = 3, 0.25  # of a region's vertices: of a chip seven are most, and their median its mean
UNIFORM = 0.25  # a layer: the change varies by less than this share of its mean beyond noise
MOST_UNKNOWN = 0.2  # of a region's area: with more of its margin not assessable, its volume is not known
MOST_CHOSEN = 0.9  # of a mean, that noise may have added
CHOICE = "choice_m"  # column of what was taken off a mean; see `RegionView.chosen`
WHOLE = ("lost", "added")  # without any perpendicular: gone or come as a whole
GAINS = ("added", "coated")
WIDE = 20.0  # a layer: as wide as this many times its thickness
THICKEST = 5e-3  # m, of a layer: paint, dirt, crusts and fine plaster are thinner; tiles, boards and slabs are thicker


def is_volume_known(sides: Pair, regions: tuple[Ints, Ints], beyond: Beyond, width: float, n_regions: int) -> Bools:
    """Return for each region (n_regions,) whether most of what lies beside it was seen in both epochs.

    Beside is within `width` [m] along the surface. Where a vertex that is not assessed lies neither over nor under the
    other surface, nor at an end of either that was seen, what happened there was not seen, and may go on. On neither
    side may that be more than `MOST_UNKNOWN` of the region's area, the larger one of both sides: a fracture is smaller
    than what broke off it. Nor may it lie over hollows that no surface follows to their ground.
    """
    area, unknown = np.zeros(n_regions), np.zeros(n_regions)
    for side, region, change, is_end in zip(sides, regions, beyond.change, beyond.is_end, strict=True):
        around = spread_margin(side, region, width)
        is_seen_end = is_end & ~np.isin(side.reasons, (NotAssessed.NOT_SEEN, NotAssessed.MET_NOTHING))
        is_unknown = ~side.is_assessed & np.isnan(change) & ~is_seen_end & (region == 0)
        beside = np.bincount(around, np.where(is_unknown, side.areas, 0.0), minlength=n_regions + 1)[1:]
        area = np.maximum(area, np.bincount(region, side.areas, minlength=n_regions + 1)[1:])
        unknown = np.maximum(unknown, beside)
    return np.asarray((unknown <= MOST_UNKNOWN * area) & ~lie_over_hollows(sides, beyond, regions, n_regions))


def lie_over_hollows(sides: Pair, beyond: Beyond, regions: tuple[Ints, Ints], n_regions: int) -> Bools:
    """Return which regions (n_regions,) lie over hollows that no surface follows: on either side over more than
    `MOST_UNKNOWN` of what of them lies there. How deep points lie in them is known: they are as deep at least."""
    out = np.zeros(n_regions, dtype=np.bool_)
    for side, region, depth in zip(sides, regions, beyond.unfollowed, strict=True):
        area, hollow = (
            np.bincount(region, weights, minlength=n_regions + 1)[1:]
            for weights in (side.areas, np.where(depth > 0.0, side.areas, 0.0))
        )
        out |= hollow > MOST_UNKNOWN * area
    return out


def depths_of_points(regions: tuple[Ints, Ints], beyond: Beyond, n_regions: int) -> Floats:
    """Return how deep [m] the deepest point lies under each region (n_regions,) that no surface follows; 0: none."""
    out = np.zeros(n_regions + 1)
    for region, depth in zip(regions, beyond.unfollowed, strict=True):
        np.maximum.at(out, region, depth)
    return out[1:]


def view_sides(number: int, sides: Pair, found: Detected, regions: tuple[Ints, Ints], grown: tuple[Ints, Ints],
               margins: list[Ints], beyond: Beyond, registration: Registration) -> list[RegionView]:  # fmt: skip
    """Return one region as each of the sides that have a part in it sees it.

    `regions` are its assessed vertices; `grown` also those that lie outside or inside of the other surface without a
    perpendicular: they count in area, extreme and place; `margins` with their margin.
    """
    masks = [((r == number) & s.is_assessed, g == number, m == number)
             for r, g, m, s in zip(regions, grown, margins, sides, strict=True)]  # fmt: skip
    return [view_region(sides[k], found, k, masks[k], beyond, registration)
            for k in range(2) if (regions[k] == number).any()]  # fmt: skip


def describe_region(number: int, views: list[RegionView]) -> list[Any]:
    """Return the row of one region in the order of `REGION_COLUMNS`, and what was taken off its mean (`CHOICE`)."""
    volume, sigma_volume = combine([v.volume for v in views], [v.sigma_volume for v in views])
    extreme, sigma_extreme = extreme_of(views)
    area, sigma_area = area_of(views, float(np.sign(extreme)))
    raw, sigma_raw = mean_of(views, float(np.sign(extreme)))
    mean, sigma_mean = mean_of([v.freed for v in views], float(np.sign(extreme)))
    centroid = np.mean([v.centroid for v in views], axis=0)
    unevenness = [v.unevenness for v in views if np.isfinite(v.unevenness)]
    kind = name_kind(raw, sigma_raw, float(np.mean(unevenness)), area) if unevenness else WHOLE[extreme > 0.0]
    return [number, kind, area, sigma_area, volume, sigma_volume, extreme, sigma_extreme, mean, sigma_mean, *centroid,
            raw - mean]  # fmt: skip


def extreme_of(views: list[RegionView]) -> tuple[float, float]:
    """Return the largest change [m] of a region and its sigma: of the side that knows more of it, and of a piece that
    is gone, or came, as a whole that of its own surface: ways from the ground beside it lead aslant to its edges."""
    most = max((v.extreme for v in views), key=least_size)
    own = piece_of(views, float(np.sign(most[0])))
    return most if own is None or np.isnan(own.extreme[0]) else own.extreme


def area_of(views: list[RegionView], sign: float) -> tuple[float, float]:
    """Return the area [m2] of a region and its sigma: what both sides say.

    Of a piece that is gone, or came, as a whole it is that of its own surface, before a loss and after a gain (`sign`):
    the fracture under it is another surface, and as a rule a smaller one.
    """
    own = piece_of(views, sign)
    if own is not None:
        return own.area, own.sigma_area
    return combine([v.area for v in views], [v.sigma_area for v in views])


def mean_of(views: list[RegionView], sign: float) -> tuple[float, float]:
    """Return the mean change [m] of a region and its sigma: what both sides say, and of a piece that is gone, or came,
    as a whole what its own surface says. Only vertices at its foot have a perpendicular, and they changed least."""
    own = piece_of(views, sign)
    return combine([v.mean for v in views], [v.sigma_mean for v in views]) if own is None else own.gap


def piece_of(views: list[RegionView], sign: float) -> RegionView | None:
    """Return the view of the own surface of a piece that is gone (`sign` -1) or came as a whole, None of another."""
    own = [v for v in views if v.sign == sign]
    return own[0] if own and max(v.unmatched_share for v in views) > MOST_UNKNOWN else None


def stands_out(views: list[RegionView], scans: ScanErrors, is_guessed: bool = True) -> float:
    """Return how many sigmas of a normal distribution the mean of a region lies off zero, on the side where it is
    fewer; with what the surfaces guess there, or without.

    How far the two sides disagree says how well the mean is known, not whether there is a change. NaN where no side
    has a perpendicular; below 0 where the sides see opposite changes.
    """
    sigmas = np.array([v.sigma_mean if is_guessed else v.sigma_measured for v in views])
    z = np.array([scans.as_normal(v.mean / s, s, v.stated) for v, s in zip(views, sigmas, strict=True)
                  if np.isfinite(s)])  # fmt: skip
    return float((np.sign(z.sum()) * z).min()) if len(z) else np.nan


def combine(values: list[float], sigmas: list[float]) -> tuple[float, float]:
    """Return the mean of what both sides say, and its sigma: theirs (the same errors) and half their disagreement.

    A side that says nothing is NaN and left out.
    """
    known = np.isfinite(values)
    if not known.any():
        return np.nan, np.nan
    value, sigma = np.array(values)[known], np.array(sigmas)[known]
    return float(np.mean(value)), float(np.hypot(np.mean(sigma), 0.5 * np.ptp(value)))


def name_kind(mean: float, sigma_mean: float, spread: float, area: float) -> str:
    """Return lost, added, cleaned (thin, uniform, wide loss), coated (such a gain), or unclear within its sigma.

    A flat piece that moved along its normal by as little, all of it, is called what a layer is: its surfaces are alike.
    """
    if abs(mean) < Z95 * sigma_mean:
        return "unclear"
    is_thin = abs(mean) <= min(THICKEST, np.sqrt(area) / WIDE)
    is_layer = is_thin and spread < UNIFORM * abs(mean)
    return ("cleaned" if is_layer else "lost") if mean < 0 else ("coated" if is_layer else "added")


def settle_kind(kind: str, volume: float, sigma_volume: float) -> str:
    """Return the kind as the volume settles it, where it is not within its sigma: lost or added where it was unclear,
    unclear where it says the opposite of the mean."""
    if not abs(volume) >= Z95 * sigma_volume:
        return kind
    if kind == "unclear":
        return WHOLE[volume > 0.0]
    return kind if (kind in GAINS) == (volume > 0.0) else "unclear"


@dataclass(frozen=True)
class RegionView:
    """A region as one side sees it; metres, m2, m3; `unevenness` [m] is how the change varies beyond noise.

    `sign` is that of the changes whose material this side shows: -1 before, +1 after. `unmatched_share` of the area
    has no perpendicular; `gap` is the mean with what the nearest points say there, and its sigma. `sigma_measured` [m]
    is the mean's sigma without what the surfaces guess there (`guesses`), `stated` [m] what its scans are stated to
    disagree by. `chosen` [m] is what noise alone adds to the mean, and its sigma (`borders.chosen_by_noise`).
    """

    sign: float
    unmatched_share: float
    area: float
    sigma_area: float
    volume: float
    sigma_volume: float
    mean: float
    sigma_mean: float
    sigma_measured: float
    stated: float
    extreme: tuple[float, float]
    gap: tuple[float, float]
    centroid: Floats
    unevenness: float
    chosen: tuple[float, float]

    @property
    def freed(self) -> RegionView:
        """The same with a mean that is free of what noise alone adds to it."""
        added, sigma = self.chosen
        return replace(self, mean=self.mean - added, sigma_mean=float(np.hypot(self.sigma_mean, sigma)))


def view_region(side: Side, found: Detected, which: int, masks: tuple[Bools, Bools, Bools],
                beyond: Beyond, registration: Registration) -> RegionView:  # fmt: skip
    """Return the figures of a region on one side; `masks` are its assessed vertices, these with what lies
    beyond, and these with their margin.

    The volume here is the sum of prisms over the assessed vertices and their margin. The area is that without the
    fringe of the surface, where it goes on beyond its samples.
    """
    here, correlation = found.sides[which], found.noise.correlation
    vertices, whole = np.flatnonzero(masks[0]), np.flatnonzero(masks[1])
    margin = np.flatnonzero(masks[2] & side.is_assessed)
    weight, change = side.areas[vertices], side.distances[vertices]
    spread2 = noise2 = np.nan
    mean = float(np.average(np.nan_to_num(beyond.change[which][whole]), weights=side.areas[whole]))
    if len(vertices):  # otherwise without any perpendicular: what the nearest points say
        mean = float(np.average(change, weights=weight))
        noise2 = float(np.average(found.noise.variance_of(side, vertices), weights=weight))
        spread2 = float(np.average((change - mean) ** 2, weights=weight))
    area = measured_area(side, whole)
    return RegionView(
        sign=SIGNS[which],
        unmatched_share=1.0 - float(weight.sum()) / area,
        area=area,
        sigma_area=sigma_of_area(side, np.sign(mean) * here.smooth, here.smooth_lod95, (whole, masks[2]), correlation),
        volume=np.nan
        if not len(margin)
        else float((side.areas[margin] * cosine_to_foot(side, margin)) @ side.distances[margin]),
        sigma_volume=float(side.areas[margin].sum()) * sigma_of_mean(side, found, margin, registration),
        mean=mean,
        sigma_mean=sigma_of_mean(side, found, vertices, registration),
        sigma_measured=sigma_of_noise(side, found, vertices, registration),
        stated=stated_over(side, vertices),
        extreme=find_extreme(
            side, found, which, (vertices, whole), np.where(beyond.is_end[which], np.nan, beyond.change[which])
        ),
        gap=find_gap(side, found, (vertices, whole), beyond.change[which]),
        centroid=np.average(side.surface.vertices[whole], axis=0, weights=side.areas[whole]),
        unevenness=float(np.sqrt(np.fmax(spread2 - noise2, 0.0))) if len(vertices) else np.nan,
        chosen=_chosen(mean, *chosen_by_noise(side, here, np.sign(mean), (vertices, masks[2]), correlation))
        if len(vertices)
        else (0.0, 0.0),
    )


def _chosen(mean: float, size: float, sigma: float) -> tuple[float, float]:
    """Return what noise adds to a mean [m], so much in `size`, and its sigma: never all of the mean, whose sign is
    known by the test that found the region."""
    most = MOST_CHOSEN * abs(mean)
    return float(np.sign(mean)) * min(size, most), float(np.hypot(sigma, max(size - most, 0.0)))


def measured_area(side: Side, vertices: Ints) -> float:
    """Return the area [m2] at some vertices less that beyond the samples; all of it where it is nothing but fringe."""
    return float(side.measured_areas[vertices].sum()) or float(side.areas[vertices].sum())


def sigma_of_mean(side: Side, found: Detected, vertices: Ints, registration: Registration) -> float:
    """Return one sigma [m] of the area-weighted mean change over some vertices, with what the surfaces guess there."""
    if not len(vertices):
        return np.nan
    areas, guess2 = side.areas[vertices], found.noise.parts_of(side, vertices)[1]
    guess = sigma_of_guess(side.surface.vertices[vertices], areas, guess2, found.test.size) / float(areas.sum())
    return float(np.hypot(sigma_of_noise(side, found, vertices, registration), guess))


def sigma_of_noise(side: Side, found: Detected, vertices: Ints, registration: Registration) -> float:
    """Return one sigma [m] of the area-weighted mean change over some vertices: correlated noise, that of scans and of
    the motion.

    Beside a free edge errors are taken to agree over all of the vertices: a limb is seen steeply along all of its
    length, and there its surface stands off by as much as several of the sigmas that single vertices have.
    """
    if not len(vertices):
        return np.nan
    weight = side.areas[vertices] / side.areas[vertices].sum()
    scale = max(e.width for e in found.test.errors)
    own2 = found.noise.parts_of(side, vertices)[0] * scale**2
    rim = found.noise.is_at_rim(side, vertices)
    stretch2 = found.noise.stretch.square_over(weight[~rim], own2[~rim] / scale**2)
    noise2 = _sum_of_agreeing(weight[rim], own2[rim]) + _variance_of_sum(side, vertices[~rim], weight[~rim], own2[~rim],
                                                                         found.noise.correlation, stretch2)  # fmt: skip
    row = weight @ motion_rows(side.surface.vertices[vertices], side.normals[vertices], registration.centre)
    shared = float(found.test.scans.sigma_of(np.array(stated_over(side, vertices))))
    limb = float(weight @ side.limb_of(vertices))
    common2 = max(float(row @ registration.covariance @ row), 0.0) + shared**2 + limb**2
    return float(np.sqrt(noise2 + common2))


def _sum_of_agreeing(weight: Floats, own2: Floats) -> float:
    """Return the variance [m2] of the weighted sum of errors that agree, `own2` (n,) [m2] that of each."""
    return float(weight @ np.sqrt(own2)) ** 2


def _variance_of_sum(side: Side, vertices: Ints, weight: Floats, own2: Floats, correlation: Correlation,
                     stretch2: float) -> float:  # fmt: skip
    """Return the variance [m2] of the weighted sum of errors that agree as `correlation` says, stretched, over the
    vertices' patch, `own2` (n,) [m2] that of each."""
    if not len(vertices):
        return 0.0
    kept = kept_variance(np.array([side.areas[vertices].sum()]), np.array([len(vertices)]), correlation,
                         stretch2)  # fmt: skip
    return float(weight @ own2) * float(weight.sum()) * float(kept[0])


def find_extreme(side: Side, found: Detected, which: int, parts: tuple[Ints, Ints], change_beyond: Floats,
                 ) -> tuple[float, float]:  # fmt: skip
    """Return the largest change [m] and its sigma: the median of seven vertices about the place where it is largest, or
    of a quarter of the region's, at least three, where these are fewer.

    The place is where the mean change less 1.96 of the sigma there is largest: the largest of many is else the noisiest
    of them. No single vertex decides; the sigma holds how seven there scatter, since the place itself is known to a
    vertex only. `parts` are the assessed vertices of the region and all of it: those without a perpendicular count
    where they are more than `MOST_UNKNOWN` of the region, a piece that is gone; there it is the distance to the nearest
    point of the other surface, as sure as the assessed ones are in the median. Beside a worn patch they are folds and
    rims, and no measure of its depth.
    """
    vertices, whole = parts
    if side.areas[vertices].sum() >= (1.0 - MOST_UNKNOWN) * side.areas[whole].sum():
        whole = vertices
    whole = whole[side.is_assessed[whole] | np.isfinite(change_beyond[whole])]
    if not len(whole):
        return np.nan, np.nan
    has_foot = side.is_assessed[whole]
    value = np.where(has_foot, side.distances[whole], change_beyond[whole])
    mean = np.where(has_foot, found.sides[which].mean[whole], change_beyond[whole])
    known = vertices if len(vertices) else np.flatnonzero(side.is_assessed)
    own = np.full(len(whole), np.median(sigma_of_vertices(side, found, known)) if len(known) else np.nan)
    own[has_foot] = sigma_of_vertices(side, found, whole[has_foot])
    points = side.surface.vertices[whole]
    _, around = cKDTree(points).query(points, k=[*range(1, min(N_AROUND, len(points)) + 1)])
    sigma = np.hypot(np.median(own[around], axis=1), np.std(value[around], axis=1))
    peak = int(np.argmax(np.abs(mean) - Z95 * np.nan_to_num(sigma)))
    nearest = around[peak, : max(LEAST_AROUND, int(SHARE_AROUND * len(points)))]
    return float(np.median(value[nearest])), float(sigma[peak])


def find_gap(side: Side, found: Detected, parts: tuple[Ints, Ints], change_beyond: Floats) -> tuple[float, float]:
    """Return the mean change [m] over a region and its sigma, with what has no perpendicular: there it is the distance
    to the nearest point of the other surface, as sure as an assessed vertex is in the median. NaN where that is not
    known for half of the region's area."""
    vertices, whole = parts
    change = np.where(side.is_assessed[whole], side.distances[whole], change_beyond[whole])
    weight = np.where(np.isfinite(change), side.areas[whole], 0.0)
    if weight.sum() < 0.5 * side.areas[whole].sum():
        return np.nan, np.nan
    known = vertices if len(vertices) else np.flatnonzero(side.is_assessed)
    sigma = float(np.median(sigma_of_vertices(side, found, known))) if len(known) else np.nan
    return float(weight @ np.nan_to_num(change) / weight.sum()), sigma


def least_size(extreme: tuple[float, float]) -> float:
    """Return how large a change and its sigma are at least, at 95 %; minus infinity where nothing is known."""
    return float(np.nan_to_num(abs(extreme[0]) - Z95 * extreme[1], nan=-np.inf))


def sigma_of_vertices(side: Side, found: Detected, vertices: Ints) -> Floats:
    """Return one sigma (k,) [m] of the change of some vertices; of single places what scans disagree by is as stated:
    most show a part of it, and the place is not most."""
    common = np.hypot(np.hypot(side.sigma_shared[vertices], side.limb_of(vertices)), side.sigma_motion[vertices])
    return np.sqrt(np.add(*found.noise.parts_of(side, vertices)) + common**2)
