"""Which points got no surface, and why: too sparse for the epoch's cell size, or two sheets too near each other.

In: a surface, the cloud it was made of. Out: counts and the share of the area for the record. What is left open is no
error, but must be said.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from monitor.across import frames_across
from monitor.reconstruction.cell_size import Sampling
from monitor.reconstruction.distances import is_covered
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

LINK = 3.0  # times as far as a point's sheet may be: points without a surface that near each other hang together
COS_SAME_SHEET, COS_OPPOSITE = 0.0, -0.7
N_PROBES, N_PLACES = 10_000, 16  # points that tell the share of the area, and places looked at around each
FEWEST_AROUND, MOST_AROUND = 12, 48  # neighbours that tell the spacing at a point
BALL_SIGMAS = 4.0  # of noise: a narrower ball is filled by it, and its points do not lie side by side
FARTHEST_PLACE = 1.5  # spacings; of an area sampled at random 0.1 % lies farther from the nearest point
FLATTEST_BALL = 0.3  # rms height of points in a ball over its radius; 0.45 where they fill it, 0 on a plane


class Uncovered(NamedTuple):
    """How many points got no surface, by reason, and the places (n, 3) [m] of these."""

    counts: dict[str, int]
    places: Floats


def find_uncovered(
    surface: Surface, cloud: PointCloud, farthest: float, sorted_points: Level | None = None
) -> Uncovered:
    """Find points without a vertex of their sheet within `farthest` (m); count those where two sheets are unresolved.

    A vertex is of a point's sheet where its normal is within 90 degrees of the point's. The second count is of points
    whose vertex lies beside a place left open between two near sheets, or that have none and an opposite sheet near.
    What else has no surface lies where points are too sparse, or in pieces too small to be kept. `sorted_points` is the
    cloud as a level, where there is one.
    """
    assert cloud.normals is not None
    bucket = BUCKETS_PER_RADIUS * farthest
    vertices = _measured_vertices(surface, bucket)
    points = sorted_points or level_of_points(cloud.points, cloud.normals, bucket)
    lost = ~has_near(vertices, points.places, points.normals, farthest, COS_SAME_SHEET)
    without, opposite = points.places.compress(lost, axis=0), -points.normals.compress(lost, axis=0)
    at_opposite = int(np.count_nonzero(has_near(points, without, opposite, farthest, -COS_OPPOSITE)))
    if surface.is_unresolved is not None:
        at_opposite += count_at(surface.is_unresolved, surface, points, farthest)
    counts = {"points_without_surface": int(np.count_nonzero(lost)), "points_at_unresolved_sheets": at_opposite}
    return Uncovered(counts, without)


def largest_piece(places: Floats, farthest: float) -> dict[str, Any]:
    """Return the largest piece of what hangs together of places (n, 3) [m] without a surface: its points, its two
    largest extents and its middle [m]; empty where there are none.

    A thing that stands by itself can be lost as a whole, and be a small share of the area.
    """
    if not len(places):
        return {}
    pairs = cKDTree(places).query_pairs(LINK * farthest, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), dtype=np.bool_), pairs.T), shape=(len(places), len(places)))
    _, label = connected_components(links, directed=False)
    piece = places[label == np.bincount(label).argmax()]
    middle = piece.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov(piece - middle, rowvar=False) if len(piece) > 1 else np.eye(3))
    extents = np.ptp((piece - middle) @ axes[:, ::-1], axis=0)
    return {"bare_piece_points": len(piece), "bare_piece_size_m": extents[:2].tolist(),
            "bare_piece_place_m": middle.tolist()}  # fmt: skip


def share_uncovered(surface: Surface, cloud: PointCloud, tree: cKDTree, sampling: Sampling, farthest: float) -> float:
    """Return the share of the area sampled that has no measured face of its sheet within `farthest` (m).

    A point stands for what lies nearer to it than to any other: where points lie wider apart than elsewhere, few of
    them stand for much area. Places in a disc around each tell, those to which it is the nearest point, weighted by the
    square of the local spacing, by which the disc grows. Of many points an even selection is asked.
    """
    filled = np.pi * (BALL_SIGMAS * sampling.noise / sampling.spacing) ** 2
    k = min(int(np.clip(filled, FEWEST_AROUND, MOST_AROUND)), len(cloud) - 1)
    which = np.unique(np.linspace(0, len(cloud) - 1, min(len(cloud), N_PROBES)).astype(np.int64))
    spacing = local_spacing(cloud, tree, which, k)
    assert cloud.normals is not None
    ways = cloud.normals[which]
    places = (cloud.points[which][:, None] + discs_across(ways, FARTHEST_PLACE * spacing)).reshape(-1, 3)
    owner = np.repeat(np.arange(len(which)), N_PLACES)
    own = np.flatnonzero(tree.query(places, workers=2)[1] == which[owner])
    covered = is_covered(surface, places[own], ways[owner[own]], farthest)
    return 1.0 - float(np.average(covered, weights=spacing[owner[own]] ** 2))


def discs_across(ways: Floats, radii: Floats) -> Floats:
    """Return places (n, 16, 3) m spread evenly over discs of `radii` (n,) m about the origin, across unit `ways`."""
    i = np.arange(N_PLACES) + 0.5
    away, turn = np.sqrt(i / N_PLACES), np.pi * (1.0 + 5.0**0.5) * i  # a sunflower
    side, across = (way * radii[:, None] for way in frames_across(ways))
    out: Floats = (away * np.cos(turn))[:, None] * side[:, None] + (away * np.sin(turn))[:, None] * across[:, None]
    return out


def local_spacing(cloud: PointCloud, tree: cKDTree, which: Ints, k: int) -> Floats:
    """Return the spacing (n,) m at the points `which`: the edge of the square that each has to itself on its sheet.

    From the disc of its k nearest points. Where these lie about it like a ball the point stands off any surface, and
    has the median spacing.
    """
    assert cloud.normals is not None
    distance, index = tree.query(cloud.points[which], k=k + 1, workers=2)
    ways, reach = cloud.normals[which], distance[:, -1]
    n_alike = (np.einsum("ijk,ik->ij", cloud.normals[index], ways) > 0.0).sum(axis=1)
    spacing = reach * np.sqrt(np.pi / np.maximum(n_alike - 1.0, 1.0))
    heights = np.einsum("ijk,ik->ij", cloud.points[index] - cloud.points[which][:, None], ways)
    is_ball = np.sqrt(np.mean(heights**2, axis=1)) > FLATTEST_BALL * reach
    out: Floats = np.where(is_ball, np.minimum(spacing, np.median(spacing)), spacing)
    return out


def _measured_vertices(surface: Surface, bucket: float) -> Level:
    """Return the vertices that faces rest on which were measured, sorted for searches as wide as `bucket` (m)."""
    assert surface.normals is not None
    if surface.face_invented is None:
        return level_of_points(surface.vertices, surface.normals, bucket)
    which = np.unique(surface.faces[~surface.face_invented])
    return level_of_points(surface.vertices[which], surface.normals[which], bucket)


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
