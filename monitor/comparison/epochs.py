"""The comparison of two epochs, from two surfaces to regions: the table of contents of detection.

Registration (docs/method.md, step 11), distances both ways and level of detection (12), states and regions (13).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from monitor.boxes import box_of
from monitor.comparison.comparable import require_common, require_comparable, settle_motion
from monitor.comparison.detection.detect import detect
from monitor.comparison.detection.needed import by_width, patches_needed
from monitor.comparison.detection.tested import Detected, Detection
from monitor.comparison.distances.lone_feet import drop_lone
from monitor.comparison.distances.perpendicular import search_limit
from monitor.comparison.distances.scratch import keep_on_disk
from monitor.comparison.distances.shell import Shell, make_shell
from monitor.comparison.distances.side import Side, drop_contradicted, larger_of, map_sides, measure_side, move_surface
from monitor.comparison.regions.beside_layer import (
    lay_back,
    level_beside,
    name_beside,
    peel,
    peel_points,
    thickness_of,
)
from monitor.comparison.regions.borne_out import Points, drop_guessed, keep_borne_out
from monitor.comparison.regions.chips import drop_unexplained
from monitor.comparison.regions.enclosure import Beyond, look_beyond
from monitor.comparison.regions.evidence import Sights, look_through
from monitor.comparison.regions.finding import Regions, area_looked_through, find_regions, least_area, least_beyond
from monitor.comparison.regions.plain_change import changed_plainly
from monitor.comparison.regions.shapes import describe_shapes
from monitor.comparison.regions.stood_there import drop_where_it_stood
from monitor.comparison.regions.told_from import add_told_from, coarse_figures, tell_smallest
from monitor.comparison.sight.views import look_from
from monitor.comparison.summary import areas_met_nothing, summarize
from monitor.declare import check_settings, given_or_default, setting
from projects.model import (
    Assessment,
    Bools,
    ComparedSurface,
    Comparison,
    Floats,
    Ints,
    NotAssessed,
    Registration,
    Surface,
)
from projects.transforms import apply


@dataclass(frozen=True, kw_only=True)
class CompareSettings:
    """Comparison of two surfaces in one frame."""

    search_limit: float | None = setting(
        None,
        unit="m",
        low=1e-6,
        meaning="largest change looked for; auto: a twentieth of the smaller surface's diagonal",
    )
    max_normal_angle: float = setting(
        math.radians(60.0),
        unit="rad",
        low=0.01,
        high=math.radians(89.0),
        meaning="faces whose normal differs more from the vertex's do not look the same way",
    )
    false_discovery_rate: float = setting(
        0.05, unit="", low=1e-9, high=0.5, meaning="expected share of false ones among the patches called changed"
    )
    largest_lod95: float | None = setting(
        None,
        unit="m",
        low=1e-6,
        meaning="a vertex with a larger level of detection is not assessable; auto: the search limit",
    )
    max_stray_share: float = setting(
        0.5, unit="", low=0.0, high=1.0,
        meaning="not assessable where, in both epochs' mean, more of what was measured there lies off the surface",
    )  # fmt: skip
    seed: int = setting(0, unit="", low=0, meaning="seed of the sample of vertices that shows how errors correlate")

    def __post_init__(self) -> None:
        check_settings(self)


def compare(reference: Surface, compared: Surface, registration: Registration | None = None,
            settings: CompareSettings | None = None, mode: str = "relative", tolerance: float | None = None,
            sights: Sights | None = None, *, frames: Floats | None = None,
            points: Points | None = None, stable_is_given: bool = False,
            apart: tuple[Bools, Bools] | None = None) -> Comparison:  # fmt: skip
    """Compare two epochs of an object and say what has changed, how much and how sure.

    Parameters
    ----------
    reference, compared : the earlier and the later surface, m, each with `sigma` where it is known.
    registration : of the compared surface onto the reference; estimated where left out.
    settings : see `CompareSettings`; the default needs no thought.
    mode : "relative" removes the motion between the epochs, "absolute" leaves it in the differences (its uncertainty
        counts in both).
    frames : (6, 6) rad and m, how far the frames of both epochs may differ, as their control holds them, about the
        registration's centre. The motion, which is told against them, has it besides its own uncertainty; in absolute
        mode it is what the differences hold. Left out: unknown; no motion is called significant then, and the
        uncertainty of the motion stands for that of the differences.
    tolerance : m, a client's own limit, reported beside the level of detection.
    sights : what the stations of the reference and of the compared epoch saw, each in its own epoch's coordinates. With
        them a missing surface is a loss only where a scan of the compared epoch looked through it, and not seen
        elsewhere, nor is one that a scan met, or that something hid, though another surface lies behind it; left out,
        only what has a counterpart is changed. They also tell how steeply each place was seen, which its level of
        detection knows where the stations of both epochs are known.
    points : returns the points (n, 3) m that the reference and the compared surface were made of, each in its own
        epoch's coordinates, None for a finished mesh; asked once, where anything seems to have changed. With them a
        region is one only where what was measured shows it, in both epochs, and not what a surface makes up between its
        points.
    stable_is_given : someone knows where nothing changed, and the stable areas of the registration lie there. They
        alone tell the level of detection then, and all the rest may have changed, as where an object was cleaned all
        over but its base.
    apart : of the vertices of the reference (n,) and of the compared surface (m,) those that belong to no region with
        the rest, as what was worn beside a part that moved (`changed_beside`); left out, what hangs together is one.

    Returns
    -------
    Comparison
        In the reference epoch's coordinates; positive distances = material gained, on both surfaces. A vertex is
        changed only where the change of its patch is significant with false discoveries held over both surfaces.

    Raises
    ------
    ParameterError
        Where the mode is neither, the tolerance no length, what should be a surface or registration is none, or `apart`
        is not of the vertices.
    ComparisonError
        Where a surface is not sound, the epochs do not overlap, or are one and the same.
    RegistrationError
        Where the registration did not converge.
    """
    settings = given_or_default(settings, CompareSettings)
    require_comparable(reference, compared, registration, mode, tolerance, apart)
    limit = settings.search_limit or search_limit(reference, compared, 0.05)
    registration = settle_motion(reference, compared, registration, limit)
    left = registration if mode == "absolute" else None
    registration, held = hold_frames(registration, frames, mode)
    T = registration.T_target_source if mode == "relative" else None
    limits, layer = (limit, settings.max_normal_angle), thickness_of(registration)
    judged = peel(compared, layer) if layer else compared
    shells = make_shells(reference, judged, limits, T)
    sides = measure_sides(shells, held, left)
    sides = leave_out(sides, settings.largest_lod95 or limit, settings.max_stray_share)
    require_common(sides, limit)
    if sights is not None:
        back = np.linalg.inv(registration.T_target_source) if mode == "relative" else np.eye(4)
        sides = look_from(sides, sights, back)
    beyond = look_beyond(sides, shells, limit)
    del shells  # of small surfaces they hold their trees, the larger part of all memory
    own = None if points is None else once(lambda: in_one_frame(judged_points(points(), compared, layer), T))
    knows = stable_is_given or registration.stable_is_rest
    plain = None if own is None or knows else changed_plainly(sides, own, limits)
    found = detect(sides, held, settings.false_discovery_rate, settings.seed, left, stable_is_given,
                   registration.stable_is_rest, plain)  # fmt: skip
    if sights is not None:
        sides, beyond = look_through(sides, beyond, sights, back, least_beyond(sides, found) + abs(layer))
    regions = find_regions(sides, found, beyond, held, settings.false_discovery_rate, points is not None,
                           apart)  # fmt: skip
    needs = patches_needed(sides, found)
    smallest = tell_smallest(sides, found, needs, settings.false_discovery_rate, points is not None)
    told_by_width = by_width(needs, found.test.size).tolist()
    del needs
    regions, sides = drop_guessed(regions, sides)
    if sights is not None and len(regions.table):
        regions, sides = drop_where_it_stood(regions, sides, sights, back)
    regions, sides = hold_to_points(regions, sides, found, beyond, own, limits, smallest)
    told = finish_sides(sides, found, regions, beyond)
    table, shapes = regions.table, describe_shapes(regions.table, sides, regions.whole)
    statistics: dict[str, Any] = {"search_limit_m": limit, "region_shapes": shapes, "told_by_width_m": told_by_width}
    if layer:
        table, statistics["lod95_beside_layer_median_m"] = name_beside(table, layer), level_beside(told[1])
        measured = measure_sides(make_shells(reference, compared, limits, T), held, left)
        told, sides = lay_back(told, measured, layer)
        smallest = smallest[0] + np.float32(abs(layer)), smallest[1] + np.float32(abs(layer))
    told = add_told_from(told, smallest)
    figures = summarize(told[1], sides, found, registration, tolerance, held=held.covariance,
                        knows_frames=frames is not None)  # fmt: skip
    figures |= coarse_figures(told[1], sides[1].areas, tolerance)
    figures["met_nothing_area_m2"] = areas_met_nothing(told, sides, sights, found.test.size)
    return Comparison(told[1], told[0], table, registration, mode, {**figures, **statistics})


def hold_frames(registration: Registration, frames: Floats | None, mode: str) -> tuple[Registration, Registration]:
    """Return the registration as it is stated, and as the differences hold it; `frames` (6, 6) where control holds both
    epochs. What is left in the differences is as sure as the frames, what is taken off as sure as the shapes tell."""
    if frames is None:
        return registration, registration
    stated = dataclasses.replace(registration, covariance=registration.covariance + frames)
    return stated, dataclasses.replace(registration, covariance=frames) if mode == "absolute" else registration


def make_shells(reference: Surface, compared: Surface, limits: tuple[float, float],
                T_reference_compared: Floats | None = None) -> tuple[Shell, Shell]:  # fmt: skip
    """Return both surfaces made ready, in coordinates about the middle of the reference; the compared one moved, where
    a motion is given. `limits` are the search limit [m] and the largest angle [rad] between normals."""
    low, high = box_of(reference.vertices)
    shift = 0.5 * (low + high)

    def make(k: int) -> Shell:
        """Return surface k (0: the reference) made ready."""
        if k == 0:
            return make_shell(reference, shift, limits)
        T = T_reference_compared
        return make_shell(compared if T is None else move_surface(compared, T), shift, limits)

    return map_sides(make, max(len(reference.vertices), len(compared.vertices)))


def measure_sides(shells: tuple[Shell, Shell], registration: Registration, left: Registration | None = None,
                  ) -> tuple[Side, Side]:  # fmt: skip
    """Return the sides (reference, compared), measured against each other, with what the registration held stable;
    `left` is the motion that stays in the distances."""
    sides = (measure_side(shells[0], shells[1], -1.0, registration, left),
             measure_side(shells[1], shells[0], 1.0, registration, left))  # fmt: skip
    on_reference, on_compared = map_sides(lambda k: drop_lone(drop_contradicted(sides[k], sides[1 - k])),
                                          larger_of(sides))  # fmt: skip
    if registration.is_stable is None or len(registration.is_stable) != len(on_compared.areas):
        return on_reference, on_compared
    seen = on_reference.is_assessed & registration.is_stable[on_reference.foot_vertices]
    return (dataclasses.replace(on_reference, is_stable=seen),
            dataclasses.replace(on_compared, is_stable=registration.is_stable))  # fmt: skip


def leave_out(sides: tuple[Side, Side], largest: float, most_stray: float) -> tuple[Side, Side]:
    """Return the sides without the vertices of which nothing sure can be said; see the functions below."""
    shares = [side.surface.stray_share for side in sides]
    return map_sides(
        lambda k: drop_scattered(drop_uncertain(sides[k], largest), shares[k], shares[1 - k], most_stray),
        larger_of(sides),
    )


def drop_uncertain(side: Side, largest: float) -> Side:
    """Return the side without the vertices whose level of detection exceeds `largest` [m] before any floor."""
    sigma = np.hypot(side.sigma_surfaces, side.sigma_common)
    too_uncertain = side.is_assessed & ~(1.96 * sigma <= largest)
    return side.without(too_uncertain, NotAssessed.TOO_UNCERTAIN)


def drop_scattered(side: Side, own: Floats | None, other: Floats | None, most: float) -> Side:
    """Return the side without the vertices where the points of both epochs lie on no one surface.

    `own` (n,) and `other` are the shares of what was measured around the vertices of either surface that lie off it,
    `most` is the largest that is assessed, in the mean of both: what is clear in one epoch and rough in the other has
    changed. Where an epoch does not know its shares nothing is left out.
    """
    if own is None or other is None:
        return side
    scattered = side.is_assessed & (own + other[side.foot_vertices] > 2.0 * most)
    return side.without(scattered, NotAssessed.NO_ONE_SURFACE)


def hold_to_points(regions: Regions, sides: tuple[Side, Side], found: Detected, beyond: Beyond, points: Points | None,
                   limits: tuple[float, float],
                   smallest: tuple[Floats, Floats]) -> tuple[Regions, tuple[Side, Side]]:  # fmt: skip
    """Return the regions that the `points` of both epochs bear out, all but chips where these are not known, and the
    sides without what no region explains; `points` returns them in the reference's coordinates, `limits` are those of
    the search, `smallest` is from how large a change (n,) [m] on each place tells one."""
    if points is None:
        regions = regions.without_chips()
    elif len(regions.table):
        gone = area_looked_through(sides, beyond, regions.seen, len(regions.table) + 1)[1:] >= least_area(sides, found)
        regions, sides = keep_borne_out(regions, sides, points(), limits, gone)
    return regions, drop_unexplained(sides, found, regions.whole, smallest)


def judged_points(points: tuple[Floats | None, Floats | None], compared: Surface, layer: float,
                  ) -> tuple[Floats | None, Floats | None]:  # fmt: skip
    """Return the points (n, 3) [m] of both epochs as their surfaces are judged: the compared one's without a `layer`
    [m] all over."""
    return points if not layer else (points[0], peel_points(points[1], compared, layer))


def once(points: Points) -> Points:
    """Return what returns the same points, asked for at most once and kept on disk."""
    return functools.cache(lambda: keep_each(points()))


def keep_each(points: tuple[Floats | None, Floats | None]) -> tuple[Floats | None, Floats | None]:
    """Return the points of both epochs, where known, kept on disk."""
    before, after = (None if own is None else keep_on_disk(own) for own in points)
    return before, after


def in_one_frame(points: tuple[Floats | None, Floats | None], T_reference_compared: Floats | None,
                 ) -> tuple[Floats | None, Floats | None]:  # fmt: skip
    """Return the points (n, 3) [m] of both epochs, where known, in the reference's coordinates; None: no motion."""
    before, after = points
    return before, after if after is None or T_reference_compared is None else apply(T_reference_compared, after)


def finish_sides(sides: tuple[Side, Side], found: Detected, regions: Regions, beyond: Beyond,
                 ) -> tuple[ComparedSurface, ComparedSurface]:  # fmt: skip
    """Return both sides (reference, compared) as the result holds them."""
    return map_sides(
        lambda k: finish_side(sides[k], found.sides[k], (regions.seen[k], regions.whole[k]), beyond.change[k]),
        larger_of(sides),
    )


def finish_side(side: Side, found: Detection, regions: tuple[Ints, Ints], change_beyond: Floats) -> ComparedSurface:
    """Return one side as the result holds it; `regions` are the vertices of regions that are changed, and all of them.

    `change_beyond` (n,) [m] stands in for the distance where a region's vertex was looked through.
    """
    region, whole = regions
    is_through = (region > 0) & ~side.is_assessed
    state = np.full(len(region), Assessment.NOT_ASSESSABLE, dtype=np.uint8)
    state[side.is_assessed] = Assessment.UNCHANGED
    state[region > 0] = Assessment.CHANGED
    lod95 = np.where(side.is_assessed, found.lod95, np.nan)
    lod95[is_through] = np.median(found.lod95[side.is_assessed]) if side.is_assessed.any() else np.nan
    lod95, distances = keep_on_disk(lod95), keep_on_disk(np.where(is_through, change_beyond, side.distances))
    reasons = np.where(is_through, NotAssessed.LOOKED_THROUGH, side.reasons).astype(np.uint8)
    return ComparedSurface(side.surface, distances, lod95, state, whole.astype(np.int32), reasons)
