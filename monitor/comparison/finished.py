"""The sides of a comparison as its result holds them: distance, level, state, region and reason of each vertex."""

from __future__ import annotations

import numpy as np

from monitor.comparison.detection.tested import Detected, Detection
from monitor.comparison.distances.scratch import keep_on_disk
from monitor.comparison.distances.side import Side, larger_of, map_sides
from monitor.comparison.regions.beyond import Beyond
from monitor.comparison.regions.finding import Regions
from projects.model import Assessment, ComparedSurface, Floats, Ints, NotAssessed


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
