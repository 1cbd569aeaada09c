"""The comparison of two epochs, from two surfaces to regions: the table of contents of detection.

Registration (docs/method.md, step 11), distances both ways and level of detection (12), states and regions (13).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from monitor.comparison.between import Between, stand_between
from monitor.comparison.comparable import (
    require_common,
    require_comparable,
    require_given_areas,
    settle_motion,
)
from monitor.comparison.detection.detect import detect
from monitor.comparison.detection.needed import by_width, patches_needed
from monitor.comparison.detection.tested import Detected
from monitor.comparison.distances.both_ways import leave_out, make_shells, measure_sides
from monitor.comparison.distances.perpendicular import search_limit
from monitor.comparison.distances.side import Side
from monitor.comparison.finished import finish_sides
from monitor.comparison.regions.beside_layer import lay_back, level_beside, name_beside
from monitor.comparison.regions.beyond import Beyond, look_beyond
from monitor.comparison.regions.borne_out import Points, drop_guessed, keep_borne_out
from monitor.comparison.regions.chips import drop_unexplained
from monitor.comparison.regions.evidence import Sights, look_through
from monitor.comparison.regions.figures import lie_over_hollows
from monitor.comparison.regions.finding import (
    Regions,
    area_looked_through,
    find_regions,
    least_area,
    least_beyond,
)
from monitor.comparison.regions.hollows import enter_hollows, may_hide_hollows
from monitor.comparison.regions.plain_change import changed_plainly
from monitor.comparison.regions.shapes import describe_shapes
from monitor.comparison.regions.stood_there import drop_where_it_stood
from monitor.comparison.regions.told_from import add_told_from, coarse_figures, tell_smallest
from monitor.comparison.sight.views import look_from
from monitor.comparison.summary import area_figures, summarize
from monitor.copied_faces import without_copied_faces
from monitor.declare import check_settings, given_or_default, setting
from monitor.threads import with_one_blas_thread
from projects.model import REGION_COLUMNS, Bools, ComparedSurface, Comparison, Floats, Registration, Surface


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


class Question(NamedTuple):
    """What is asked of two epochs: the motion between them, the search limit [m] and the largest angle [rad] between
    normals, the rate of false discoveries, and what speaks besides the surfaces (see `compare`)."""

    between: Between
    limits: tuple[float, float]
    rate: float
    sights: Sights | None
    points: Points | None
    apart: tuple[Bools, Bools] | None


class Told(NamedTuple):
    """What is told of two sides: regions, what lies beyond the perpendiculars, from how large a mean change (n,) [m] on
    each place of both one is told, and the same by the width [m] of a change."""

    sides: tuple[Side, Side]
    beyond: Beyond
    regions: Regions
    smallest: tuple[Floats, Floats]
    by_width: list[list[float]]


@with_one_blas_thread
def compare(reference: Surface, compared: Surface, registration: Registration | None = None,
            settings: CompareSettings | None = None, mode: str = "relative", tolerance: float | None = None,
            sights: Sights | None = None, *, frames: Floats | None = None,
            points: Points | None = None, stable_is_given: bool = False,
            apart: tuple[Bools, Bools] | None = None) -> Comparison:  # fmt: skip
    """Compare two epochs of an object and say what has changed, how much and how sure.

    Parameters
    ----------
    reference, compared : the earlier and the later surface, m, each with `sigma` where it is known. A face that is
        there twice counts once.
    registration : of the compared surface onto the reference; estimated where left out. What it holds stable counts
        where that is told of the compared surface's vertices, and not of the points of a cloud.
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
        Where the mode is neither, the tolerance no length, `frames` no covariance, what should be a surface or
        registration is none, or `apart` or the stable areas given are not of the vertices.
    ComparisonError
        Where a surface is not sound, the epochs do not overlap, or are one and the same.
    RegistrationError
        Where the registration did not converge.
    """
    settings = given_or_default(settings, CompareSettings)
    require_comparable(reference, compared, registration, mode, tolerance, apart, frames)
    if stable_is_given:
        require_given_areas(registration, len(compared.vertices))
    reference, compared = without_copied_faces(reference), without_copied_faces(compared)
    limits = (settings.search_limit or search_limit(reference, compared, 0.05), settings.max_normal_angle)
    between = stand_between(settle_motion(reference, compared, registration, limits[0]), frames, mode)
    own = None if points is None else between.judged_points(points, compared)
    asked = Question(between, limits, settings.false_discovery_rate, sights, own, apart)
    sides, beyond = measure(reference, compared, asked, settings)
    rest = between.stated.stable_is_rest
    plain = None if own is None or stable_is_given or rest else changed_plainly(sides, own, limits)
    found = detect(sides, between.held, asked.rate, settings.seed, between.left, stable_is_given, rest, plain)
    told = tell_regions(sides, beyond, found, asked)
    del sides, beyond  # of large surfaces they hold much memory, and `told` has them as they are now
    on_both = finish_sides(told.sides, found, told.regions, told.beyond)
    statistics: dict[str, Any] = {
        "search_limit_m": limits[0],
        "region_shapes": shapes_of(told),
        "told_by_width_m": told.by_width,
    }
    if between.layer:
        statistics["lod95_beside_layer_median_m"] = level_beside(on_both[1])
        on_both, told = put_layer_back(on_both, told, reference, compared, asked)
    on_both = add_told_from(on_both, told.smallest)
    figures = figures_of(on_both, told, found, asked, tolerance, frames is not None)
    table = told.regions.table[list(REGION_COLUMNS)]
    return Comparison(on_both[1], on_both[0], table, between.stated, mode, {**figures, **statistics})


def figures_of(on_both: tuple[ComparedSurface, ComparedSurface], told: Told, found: Detected, asked: Question,
               tolerance: float | None, knows_frames: bool) -> dict[str, Any]:  # fmt: skip
    """Return the figures of a comparison as a whole, beside those of its regions; lengths in metres."""
    stated, held = asked.between.stated, asked.between.held.covariance
    figures = summarize(on_both, told.sides, found, stated, tolerance, held=held, knows_frames=knows_frames)
    figures |= coarse_figures(on_both[1], told.sides[1].areas, tolerance)
    return figures | area_figures(on_both, told.sides, asked.sights, found.test.size)


def shapes_of(told: Told) -> list[dict[str, Any]]:
    """Return the shape of each region that is told."""
    table, whole = told.regions.table, told.regions.whole
    are_hollows = lie_over_hollows(told.sides, told.beyond, whole, len(table))
    return describe_shapes(table, told.sides, whole, are_hollows)


def measure(reference: Surface, compared: Surface, asked: Question,
            settings: CompareSettings) -> tuple[tuple[Side, Side], Beyond]:  # fmt: skip
    """Return both sides, measured against each other as they are judged, and what lies beyond the perpendiculars."""
    between, (limit, _) = asked.between, asked.limits
    shells = make_shells(reference, between.judged(compared), asked.limits, between.T_reference_compared)
    sides = measure_sides(shells, between.held, between.left)
    sides = leave_out(sides, settings.largest_lod95 or limit, settings.max_stray_share)
    require_common(sides, limit)
    if asked.sights is not None:
        sides = look_from(sides, asked.sights, between.T_compared_reference)
    return sides, look_beyond(sides, shells, limit)


def tell_regions(sides: tuple[Side, Side], beyond: Beyond, found: Detected, asked: Question) -> Told:
    """Return the regions of two sides, as far as what stations saw and what was measured bears them out."""
    between, sights = asked.between, asked.sights
    if sights is not None:
        least = least_beyond(sides, found) + abs(between.layer)
        sides, beyond = look_through(sides, beyond, sights, between.T_compared_reference, least)
    if asked.points is not None and any(may_hide_hollows(s, found, k).any() for k, s in enumerate(sides)):
        sides, beyond, found = enter_hollows(sides, beyond, found, asked.points(), least_beyond(sides, found))
    are_asked = asked.points is not None
    regions = find_regions(sides, found, beyond, between.held, asked.rate, are_asked, asked.apart)
    needs = patches_needed(sides, found)
    smallest = tell_smallest(sides, found, needs, asked.rate, are_asked)
    widths = by_width(needs, found.test.size).tolist()
    del needs  # of large surfaces they hold much memory
    regions, sides = drop_guessed(regions, sides)
    if sights is not None and len(regions.table):
        regions, sides = drop_where_it_stood(regions, sides, sights, between.T_compared_reference)
    regions, sides = hold_to_points(regions, sides, found, beyond, asked)
    return Told(drop_unexplained(sides, found, regions.whole, smallest), beyond, regions, smallest, widths)


def hold_to_points(regions: Regions, sides: tuple[Side, Side], found: Detected, beyond: Beyond,
                   asked: Question) -> tuple[Regions, tuple[Side, Side]]:  # fmt: skip
    """Return the regions that the points of both epochs bear out, all but chips where these are not known, and the
    sides without the others."""
    if asked.points is None:
        return regions.without_chips(), sides
    if not len(regions.table):
        return regions, sides
    gone = area_looked_through(sides, beyond, regions.seen, len(regions.table) + 1)[1:] >= least_area(sides, found)
    return keep_borne_out(regions, sides, asked.points(), asked.limits, gone)


def put_layer_back(on_both: tuple[ComparedSurface, ComparedSurface], told: Told, reference: Surface, compared: Surface,
                   asked: Question) -> tuple[tuple[ComparedSurface, ComparedSurface], Told]:  # fmt: skip
    """Return what was told beside a layer all over with the distances, levels and sides as they are with it."""
    between = asked.between
    shells = make_shells(reference, compared, asked.limits, between.T_reference_compared)
    on_both, sides = lay_back(on_both, measure_sides(shells, between.held, between.left), between.layer)
    regions = replace(told.regions, table=name_beside(told.regions.table, between.layer))
    more = np.float32(abs(between.layer))
    smallest = told.smallest[0] + more, told.smallest[1] + more
    return on_both, told._replace(sides=sides, regions=regions, smallest=smallest)
