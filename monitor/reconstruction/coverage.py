"""Which points got no surface, and why: too sparse for the epoch's cell size, or two sheets too near each other.

In: a surface, the cloud it was made of. Out: counts for the record. What is left open is no error, but must be said.
"""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.reconstruction.gathering import (
    NORMAL_X,
    NORMAL_Y,
    NORMAL_Z,
    PLACE_X,
    PLACE_Y,
    PLACE_Z,
    ROOM,
    Sites,
    block_sites,
    find_near,
    near_room,
    rows_room,
)
from monitor.reconstruction.moments import BUCKETS_PER_RADIUS, Level, level_of_points, sort_by_cell
from monitor.reconstruction.nearness import has_near
from monitor.threads import run_tasks
from projects.model import Bools, Floats, Ints, PointCloud, Surface

COS_SAME_SHEET, COS_OPPOSITE = 0.0, -0.7


def count_uncovered(
    surface: Surface, cloud: PointCloud, farthest: float, sorted_points: Level | None = None
) -> dict[str, int]:
    """Count points without a vertex of their sheet within `farthest` (m), and points where two sheets are unresolved.

    A vertex is of a point's sheet where its normal is within 90 degrees of the point's. The second count is of points
    whose vertex lies beside a place left open between two near sheets, or that have none and an opposite sheet near.
    What else has no surface lies where points are too sparse, or in pieces too small to be kept. `sorted_points` is the
    cloud as a level, where there is one.
    """
    assert cloud.normals is not None
    assert surface.normals is not None
    bucket = BUCKETS_PER_RADIUS * farthest
    vertices = level_of_points(surface.vertices, surface.normals, bucket)
    points = sorted_points or level_of_points(cloud.points, cloud.normals, bucket)
    lost = ~has_near(vertices, points.places, points.normals, farthest, COS_SAME_SHEET)
    without, opposite = points.places.compress(lost, axis=0), -points.normals.compress(lost, axis=0)
    at_opposite = int(np.count_nonzero(has_near(points, without, opposite, farthest, -COS_OPPOSITE)))
    if surface.is_unresolved is not None:
        at_opposite += count_at(surface.is_unresolved, surface, points, farthest)
    return {"points_without_surface": int(np.count_nonzero(lost)), "points_at_unresolved_sheets": at_opposite}


def count_at(marked: Bools, surface: Surface, points: Level, farthest: float) -> int:
    """Count the points whose nearest vertex of their sheet is one of those marked (n,)."""
    assert surface.normals is not None
    if not marked.any():
        return 0
    bucket = BUCKETS_PER_RADIUS * farthest
    there = level_of_points(surface.vertices[marked], surface.normals[marked], bucket)
    may = has_near(there, points.places, points.normals, farthest, COS_SAME_SHEET)
    places, ways = points.places.compress(may, axis=0), points.normals.compress(may, axis=0)
    vertices = level_of_points(surface.vertices, surface.normals, bucket)
    nearest = nearest_looking(vertices, places, ways, farthest, COS_SAME_SHEET)
    order = sort_by_cell(surface.vertices, vertices.bucket)[0]
    return int(np.count_nonzero(marked[order[nearest]]))


def nearest_looking(level: Level, places: Floats, ways: Floats, farthest: float, least_cosine: float) -> Ints:
    """Return for each place (n, 3) the row of the level next to it within `farthest` (m) that looks its way, or -1.

    `least_cosine` is between the direction of the row and that of the place in `ways` (n, 3).
    """
    out = np.full(len(places), -1, np.int64)
    if len(places):
        sites = block_sites(places, ways, np.arange(len(places)), BUCKETS_PER_RADIUS * farthest)
        run_tasks(_look, len(sites.starts) - 1, sites, level, farthest, least_cosine, out)
    return out


@jit(nopython=True, cache=True, nogil=True)
def _look(first: int, last: int, sites: Sites, level: Level, farthest: float, least_cosine: float, out: Ints) -> None:
    """Look for the nearest rows of the level around the blocks `first` to `last`, for `run_tasks`."""
    rows, near = rows_room(farthest, farthest, level.bucket), near_room(ROOM)
    for block in range(first, last):
        n_near, near = find_near(level, sites, block, farthest, rows, near)
        for k in range(sites.starts[block], sites.starts[block + 1]):
            i = sites.which[k]
            q = nearest_of(near.values, n_near, sites.vertices[i], sites.normals[i], farthest, least_cosine)
            if q >= 0:
                out[i] = near.groups[q]


@jit(nopython=True, cache=True)
def nearest_of(values: Floats, n: int, place: Floats, way: Floats, farthest: float, least_cosine: float) -> int:
    """The nearest of what is near a block within `farthest` of one place and looking its way, -1 for none."""
    best, least2 = -1, farthest * farthest
    for q in range(n):
        dx, dy, dz = values[PLACE_X, q] - place[0], values[PLACE_Y, q] - place[1], values[PLACE_Z, q] - place[2]
        distance2 = dx * dx + dy * dy + dz * dz
        cosine = values[NORMAL_X, q] * way[0] + values[NORMAL_Y, q] * way[1] + values[NORMAL_Z, q] * way[2]
        if distance2 < least2 and cosine > least_cosine:
            best, least2 = q, distance2
    return best
