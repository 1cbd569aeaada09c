"""What a level of detection promises where it was not learned: one half of a surface teaches it, the other counts.

A comparison scales what is stated to what its own calm vertices show, so that of these one in twenty lies beyond the
level nearly by construction. Here each half's level comes from the other half.
"""

from __future__ import annotations

import math

import numpy as np

from monitor.comparison import CompareSettings
from monitor.comparison.detection.detect import CORE_SHARE
from monitor.comparison.detection.marking import level_at
from monitor.comparison.distances.both_ways import leave_out, make_shells, measure_sides
from monitor.comparison.distances.side import Side
from monitor.comparison.noise.model import Masks, Noise, learn_noise
from monitor.comparison.regions.beside_layer import peel, thickness_of
from monitor.comparison.regions.evidence import Sights
from monitor.comparison.sight.views import look_from
from projects.model import Assessment, Bools, Comparison, Floats, Ints, NotAssessed

MAX_NORMAL_ANGLE = math.radians(60.0)  # as `CompareSettings` has it


def beyond_held_out(comparison: Comparison, direction: Floats, sights: Sights) -> Bools:
    """Return which vertices (n,) of the compared surface of an unchanged pair lie beyond the level of the other half.

    The halves are those before and behind the plane across `direction` (3,) through the middle of the assessed
    vertices. False where nothing is assessed. `sights` are what the stations saw.
    """
    back = np.linalg.inv(comparison.registration.T_target_source)
    sides = look_from(measure_again(comparison), sights, back)
    beyond = np.zeros(len(sides[1].distances), dtype=np.bool_)
    along = [side.surface.vertices @ direction for side in sides]
    middle = float(np.median(along[1][sides[1].is_assessed]))
    for before in (True, False):
        taught, counted = half_of(sides, along, middle, before), half_of(sides, along, middle, not before)[1]
        level = level_at(sides[1], learn_half(sides, taught))
        beyond |= counted & (np.abs(sides[1].distances) > level)
    return beyond


def measure_again(comparison: Comparison) -> tuple[Side, Side]:
    """Return the sides (reference, compared) as they were before anything was learned from them: beside a layer all
    over, where the registration tells one."""
    reference, moved = comparison.on_reference.surface, comparison.on_compared.surface
    layer = thickness_of(comparison.registration)
    moved = peel(moved, layer) if layer else moved
    limit, registration = float(comparison.statistics["search_limit_m"]), comparison.registration
    sides = measure_sides(make_shells(reference, moved, (limit, MAX_NORMAL_ANGLE)), registration)
    kept = leave_out(sides, limit, CompareSettings().max_stray_share)
    told = comparison.on_reference, comparison.on_compared
    first, second = (without_judged(s, t.reasons) for s, t in zip(kept, told, strict=True))
    for side, t in zip((first, second), told, strict=True):
        if not np.array_equal(side.is_assessed, t.assessment != Assessment.NOT_ASSESSABLE):
            raise AssertionError("measured again, other vertices are assessed than in the comparison")
    return first, second


def without_judged(side: Side, reasons: Ints) -> Side:
    """Return the side without what was set aside once regions had been looked for, by its `reasons` (n,): what points
    or stations did not bear out."""
    for reason in (NotAssessed.UNEXPLAINED, NotAssessed.TOO_UNCERTAIN, NotAssessed.NOT_SEEN):
        side = side.without(side.is_assessed & (reasons == reason), reason)
    return side


def half_of(sides: tuple[Side, Side], along: list[Floats], middle: float, before: bool) -> Masks:
    """Return the assessed vertices of both sides before, or behind, the middle."""
    masks = tuple(s.is_assessed & ((a < middle) == before) for s, a in zip(sides, along, strict=True))
    return masks[0], masks[1]


def learn_half(sides: tuple[Side, Side], calm: Masks) -> Noise:
    """Return the noise learned from one half, in the two passes of the comparison."""
    rng = np.random.default_rng(0)
    first = learn_noise(sides, calm, CORE_SHARE, rng)
    return learn_noise(sides, calm, 0.95, rng, first.correlation)
