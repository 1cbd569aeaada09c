"""Whether anything of a level lies near places on the same side of a sheet.

In: a `Level`, places (n, 3) m. Out: a mask. Places that follow each other lie near each other: what was near the last
one is asked first, then what lies in the same bucket, then all that may be near.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

from monitor.reconstruction.gathering import rows_room
from monitor.reconstruction.moments import BUCKETS_PER_RADIUS, Level, find_rows, level_of_points
from monitor.threads import run_tasks
from projects.model import Bools, Floats, Ints

ANY_WAY = -np.inf  # whatever the ways are, of no length or of many metres
MOST_BUCKETS = 8.0  # of the level that the search reaches over; beyond, points are sorted into wider ones


def has_near(level: Level, places: Floats, ways: Floats, farthest: float, least_cosine: float = ANY_WAY) -> Bools:
    """Return which places (n, 3) have a row of the level nearer than `farthest` (m) that looks their way.

    `least_cosine` is between the direction of the row and that of the place in `ways` (n, 3).
    """
    if farthest > MOST_BUCKETS * level.bucket:  # cells far larger than the points lie apart
        level = level_of_points(level.places, level.normals, BUCKETS_PER_RADIUS * farthest)
    out = np.zeros(len(places), np.bool_)
    run_tasks(_mark_near, len(places), level, places, ways, float(farthest), float(least_cosine), out)
    return out


@jit(nopython=True, cache=True, nogil=True)
def _mark_near(
    first: int, last: int, level: Level, places: Floats, ways: Floats, farthest: float, least_cosine: float, out: Any
) -> None:
    """Mark the places `first` to `last` that have a row near, for `run_tasks`."""
    rows, row = rows_room(farthest, farthest, level.bucket), -1
    for i in range(first, last):
        if row < 0 or not is_near(level, row, places[i], ways[i], farthest, least_cosine):
            row = any_near(level, places[i], ways[i], 0.0, farthest, least_cosine, rows)
            if row < 0:
                row = any_near(level, places[i], ways[i], farthest, farthest, least_cosine, rows)
        out[i] = row >= 0


@jit(nopython=True, cache=True)
def is_near(level: Any, row: int, place: Floats, way: Floats, farthest: float, least_cosine: float) -> bool:
    """Whether a row of the level is nearer than `farthest` and looks a place's way."""
    distance2, cosine = 0.0, 0.0
    for a in range(3):
        d = level.places[row, a] - place[a]
        distance2 += d * d
        cosine += level.normals[row, a] * way[a]
    near: bool = (distance2 < farthest * farthest) & (cosine > least_cosine)
    return near


@jit(nopython=True, cache=True)
def any_near(
    level: Any, place: Floats, way: Floats, beside: float, farthest: float, least_cosine: float, rows: Ints
) -> int:
    """A row near a place in the buckets that the box `beside` it touches, -1 for none."""
    for k in range(find_rows(level, place - beside, place + beside, rows)):
        for row in range(rows[k, 0], rows[k, 1]):
            if is_near(level, row, place, way, farthest, least_cosine):
                return row
    return -1
