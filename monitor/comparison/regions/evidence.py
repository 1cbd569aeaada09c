"""Seen or not seen: where one epoch has no surface, what its scanners saw there decides what that means.

In: both sides and what the stations of both epochs saw. Out: the sides with NOT_SEEN where nobody looked, and which
vertices were looked through: what stood there is gone (seen from the reference), or is new (from the compared epoch).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from monitor.comparison.distances.side import Side
from monitor.comparison.distances.spreading import spread_along
from monitor.comparison.regions.beyond import SIGNS, Beyond, unsure_of_ends
from monitor.comparison.sight.stations import Sighted, StationSight, look_at, window_width
from projects.model import Bools, Floats, Ints, NotAssessed, Surface
from projects.transforms import apply

Sights = tuple[Sequence[StationSight], Sequence[StationSight]]
ABSENT = (NotAssessed.NO_FACE, NotAssessed.FREE_EDGE, NotAssessed.SHEET_BETWEEN, NotAssessed.BEYOND_SEARCH)


def knows_beams(sights: Sights | None, k: int) -> bool:
    """Return whether any station of epoch k (0: the reference) knows where its beams went that met nothing."""
    return sights is not None and any(sight.grid is not None for sight in sights[k])


def look_through(sides: tuple[Side, Side], beyond: Beyond, sights: Sights, T_compared_reference: Floats, least: float,
                 ) -> tuple[tuple[Side, Side], Beyond]:  # fmt: skip
    """Return the sides and what lies beyond the perpendicular, as far as the other epoch's scanners bear it out.

    Looked through is a vertex without a counterpart, farther than `least` [m] from all of the other surface, beside
    which a beam of a station went through the surface that it is of, to something farther all around. Where no station
    measured in its direction, or something hid it, or beams may have passed beside it, it is NOT_SEEN, and no surface
    tells that it is exposed; so where a scan's grid mostly holds nothing in its direction, which is MET_NOTHING.
    """
    new_sides, change, through = [], [], []
    for k, side in enumerate(sides):
        if not sights[1 - k]:
            new_sides.append(side)
            change.append(beyond.change[k])
            through.append(beyond.is_through[k])
            continue
        which = np.flatnonzero(np.isin(side.reasons, ABSENT))
        seen = np.full(len(side.areas), -1, dtype=np.int64)
        T_sights_side = np.eye(4) if k else T_compared_reference
        points, around = part_around(side, which, T_sights_side, sights[1 - k])
        seen[which] = look_at(sights[1 - k], points, least, around)
        apart, not_seen = is_apart(side, beyond.gaps[k], least), np.isin(seen, (Sighted.NOT_SEEN, Sighted.MET_NOTHING))
        is_through = (seen == Sighted.LOOKED_THROUGH) & apart
        new_sides.append(name_not_seen(side, not_seen, (seen == Sighted.MET_NOTHING) & apart))
        change.append(bear_out(beyond, k, is_through, not_seen))
        through.append(is_through)
    borne_out = dataclasses.replace(beyond, change=(change[0], change[1]), is_through=(through[0], through[1]))
    return (new_sides[0], new_sides[1]), borne_out


def part_around(side: Side, which: Ints, T_sights_side: Floats, sights: Sequence[StationSight],
                ) -> tuple[Floats, Surface | None]:  # fmt: skip
    """Return some vertices (m, 3) of a side and the surface around them, None without any face, in the frame of the
    sights: as far as the beams beside them are asked whether they went through it."""
    points = apply(T_sights_side, side.surface.vertices[which])
    reach = max((window_width(sight, points).max(initial=0.0) for sight in sights), default=0.0)
    is_around = spread_along(side, which, np.ones(len(side.areas), dtype=np.bool_), reach) >= 0
    used, corners = np.unique(side.surface.faces[is_around[side.surface.faces].any(axis=1)], return_inverse=True)
    if not len(used):
        return points, None
    return points, Surface(apply(T_sights_side, side.surface.vertices[used]), corners.reshape(-1, 3))


def is_apart(side: Side, gaps: Floats, least: float) -> Bools:
    """Return the vertices (n,) whose way to the other surface is longer than surfaces end off each other by chance."""
    return np.nan_to_num(gaps) > least + unsure_of_ends(side)


def bear_out(beyond: Beyond, k: int, is_through: Bools, not_seen: Bools) -> Floats:
    """Return the change (n,) [m] of side k: exposed is what was looked through, and nothing that nobody saw."""
    change = beyond.change[k].copy()
    change[not_seen & (change * SIGNS[k] > 0.0)] = np.nan
    change[is_through] = SIGNS[k] * beyond.gaps[k][is_through]
    return change


def name_not_seen(side: Side, not_seen: Bools, met_nothing: Bools) -> Side:
    """Return the side with the reason NOT_SEEN where no station measured in that direction, or something hid it, but
    MET_NOTHING where beams of a grid went and mostly nothing came back."""
    reasons = np.where(not_seen, NotAssessed.NOT_SEEN, side.reasons)
    reasons[met_nothing] = NotAssessed.MET_NOTHING
    return dataclasses.replace(side, reasons=reasons.astype(side.reasons.dtype))
