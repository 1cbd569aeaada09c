"""Regions that the ways of sight speak against: where a scan met what is told to be gone, or never looked.

In: regions found on two surfaces, and what the stations of both epochs saw. Out: the regions without those. Where an
epoch has no surface of a part that stands in front of another (its points were dropped, or something hid it), the
surface behind it, seen from the sides, passes for what is left of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from monitor.comparison.distances.side import Side
from monitor.comparison.regions.beyond import SIGNS
from monitor.comparison.regions.borne_out import name_anew
from monitor.comparison.regions.evidence import Sights
from monitor.comparison.regions.finding import Regions
from monitor.comparison.sight.stations import StationSight, goes_on
from projects.model import Bools, Floats, NotAssessed
from projects.transforms import apply

MOST_AGAINST = 0.5  # of a region's exposed area


def drop_where_it_stood(regions: Regions, sides: tuple[Side, Side], sights: Sights, T_compared_reference: Floats,
                        ) -> tuple[Regions, tuple[Side, Side]]:  # fmt: skip
    """Return the regions that the sights of the other epoch do not speak against, and the sides without the others.

    They speak against a region where, over more than `MOST_AGAINST` of its exposed area (before a loss, after a gain),
    every way of sight through it ends at something as near or nearer. What they cannot tell, as a change less deep than
    a window of directions is wide, or where they measured nothing, counts for the region.
    """
    n, poses = len(regions.table), (T_compared_reference, np.eye(4))
    whole, against = np.zeros(n + 1), np.zeros(n + 1)
    for k, side in enumerate(sides):
        at = np.flatnonzero((regions.seen[k] > 0) & side.is_assessed)
        at = at[SIGNS[k] * side.distances[at] > 0.0]
        points, number = apply(poses[k], side.surface.vertices[at]), regions.seen[k][at]
        ends = is_against(sights[1 - k], points, np.abs(side.distances[at]))
        whole += np.bincount(number, side.areas[at], minlength=n + 1)
        against += np.bincount(number[ends], side.areas[at][ends], minlength=n + 1)
    is_dropped = against > MOST_AGAINST * whole
    if not is_dropped.any():
        return regions, sides
    a, b = (s.without(s.is_assessed & is_dropped[r], NotAssessed.NOT_SEEN)
            for s, r in zip(sides, regions.seen, strict=True))  # fmt: skip
    regions = regions.keep(np.flatnonzero(~is_dropped[1:]))
    return replace(regions, table=name_anew(regions.table, (a, b), regions.seen)), (a, b)


def is_against(sights: Sequence[StationSight], points: Floats, depths: Floats) -> Bools:
    """Return at which points (n, 3), in the frame of the stations, behind which the surface is told to lie by `depths`
    (n,) [m], a station met something as near or nearer, and none looked on."""
    ends, goes = np.zeros(len(points), dtype=np.bool_), np.zeros(len(points), dtype=np.bool_)
    for sight in sights:
        is_told, on = goes_on(sight, points, depths)
        ends |= is_told & ~on
        goes |= is_told & on
    return ends & ~goes
