"""Points that no surface has: grazing incidence, mixed pixels, rims (Nothegger and Dorninger, section 2.1).

In: points with normals and where the scanner stood, rows and columns where the scan is a grid; out: masks of points.
A mixed pixel's range lies between those of two surfaces that the beam touched (papers: HDS 6000 relief, section 1.2.2).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from monitor.blocks import blocks
from monitor.declare import check_settings, setting
from monitor.filtering.nearest import PointIndex, build_index, canonical_order, find_nearest, find_nearest_sorted
from projects.model import Bools, Floats, Ints

BETWEEN_SIGMAS = 3.0
JUMP_SIGMAS = BETWEEN_SIGMAS * math.sqrt(2.0)  # of the difference of two ranges
N_ASIDE = 16  # neighbours seen from the scanner, among which a gap is looked for
N_BESIDE = 8  # of these, to which a range may jump: the pixels around one
N_INNER = 5  # neighbours that are no rims: an ornament four pixels wide has four
RIM_GAP = math.radians(165.0)  # of sixteen neighbours at random, one in six hundred points has such a gap by chance
BLOCK = 32_768  # points at a time; a multiple of the index's leaf


@dataclass(frozen=True, kw_only=True)
class SilhouetteSettings:
    """Silhouettes and specks. Angles in radians."""

    max_incidence: float = setting(
        math.radians(80.0),
        unit="rad",
        meaning="largest angle between beam and normal: the spot is 6 times as long as wide",
        low=0.5,
        high=1.57,
    )
    isolation: float = setting(
        4.0,
        unit="1",
        meaning="a speck's neighbours are this many times farther than the scan's spacing there",
        low=1.5,
        high=100.0,
    )
    drop_rims: bool = setting(
        True,
        unit="",
        meaning="whether points whose spot may reach over the rim of their surface onto another are dropped",
    )
    drop_border: bool = setting(
        False,
        unit="",
        meaning="whether drop_rims takes the border of what the scan holds too, where a spot may reach over nothing",
    )
    drop_limbs: bool = setting(
        False,
        unit="",
        meaning="whether the steep border of a scan is dropped, with what hangs past limbs where part of a spot misses",
    )
    drop_seen_through: bool = setting(
        True,
        unit="",
        meaning="whether points are dropped that the beams of another scan of the epoch passed through",
    )

    def __post_init__(self) -> None:
        check_settings(self)


def find_grazing(points: Floats, origin: Floats, normals: Floats, max_incidence: float) -> Bools:
    """Return the points (n,) whose incidence angle, between beam and normal (n, 3), exceeds `max_incidence` [rad]."""
    grazing = np.empty(len(points), dtype=bool)
    for block in blocks(len(points), BLOCK):
        beams = points[block] - origin
        across = np.abs((beams * normals[block]).sum(axis=1))
        grazing[block] = across < math.cos(max_incidence) * np.linalg.norm(beams, axis=1)
    return grazing


def find_mixed(points: Floats, origin: Floats, rows: Ints, columns: Ints, noise: Floats, max_incidence: float) -> Bools:
    """Return the points (n,) of a grid scan whose range lies between those of the two sides of a jump.

    Along the row or the column the neighbour on one side is nearer and that on the other side farther, both by more
    than a surface at `max_incidence` [rad] and the noise explain.

    Parameters
    ----------
    points, origin : (n, 3) and (3,) m, of the scan and its scanner.
    rows, columns : (n,) place in the grid; -1 where a point has none.
    noise : (n,) m, one sigma of a range.
    """
    mixed = np.zeros(len(points), dtype=bool)
    for line, place in ((rows, columns), (columns, rows)):
        order = np.lexsort((place, line))
        jump = _jumps_along(order, line, place, (points, origin, noise), max_incidence)
        mixed[order[1:-1]] |= (jump[:-1] != 0) & (jump[:-1] == jump[1:])
    return mixed


def _jumps_along(
    order: Ints, line: Ints, place: Ints, scan: tuple[Floats, Floats, Floats], max_incidence: float
) -> NDArray[np.int8]:
    """Return for each point but the first, line by line in `order`, whether its range jumps up, down (1, -1) or not."""
    points, origin, noise = scan
    n_jumps = len(order) - 1
    steps, jump = np.full(n_jumps, np.nan, dtype=np.float32), np.zeros(n_jumps, dtype=np.int8)
    for block in blocks(n_jumps, BLOCK):  # the step of the grid first
        some = order[block.start : block.stop + 1]
        directions = points[some] - origin
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        adjacent = (np.diff(line[some]) == 0) & (np.diff(place[some]) == 1) & (line[some][1:] >= 0)
        apart = np.linalg.norm(np.diff(directions, axis=0), axis=1)
        steps[block] = np.where(adjacent, apart, np.nan)
    if np.isnan(steps).all():
        return jump
    step = float(np.median(steps[~np.isnan(steps)]))
    for block in blocks(n_jumps, BLOCK):
        some = order[block.start : block.stop + 1]
        ranges = np.linalg.norm(points[some] - origin, axis=1)
        rise = np.diff(ranges)
        limit = ranges[1:] * step * math.tan(max_incidence) + JUMP_SIGMAS * noise[some[1:]]
        jump[block] = np.where(~np.isnan(steps[block]) & (np.abs(rise) > limit), np.sign(rise), 0.0)
    return jump


def find_rims(
    points: Floats,
    origin: Floats,
    noise: Floats,
    max_incidence: float,
    known: Bools | None = None,
    border: bool = False,
) -> Bools:
    """Return the points (n,) whose spot may reach over the rim of their surface, in front of another.

    Seen from the scanner, one of the `N_BESIDE` neighbours has another range by more than a surface at `max_incidence`
    [rad] and the noise explain. Such a point is pulled towards what lies behind, or stands beside the surface. Only
    points with `N_INNER` neighbours of the same surface that are no rims are named: what consists of rims, an ornament
    seen by few points, is kept.

    Parameters
    ----------
    points, origin : (n, 3) and (3,) m, in any order, grid or not, and the scanner.
    noise : (n,) m, one sigma of a range.
    known : (n,) points of surfaces; the others, which are no rims and make nothing one, are passed over. None: all.
    border : whether points half of whose surroundings is empty are rims too.
    """
    field = look_out(points, origin, noise, known, math.tan(max_incidence))
    rims = _beside_jumps(field)
    if border:
        rims |= _beside_nothing(field)
    named = np.zeros(len(points), dtype=bool)
    named[field.order] = has_inner(field, rims)
    return named


@dataclass(frozen=True)
class Field:
    """What the scanner sees: directions in their own canonical order, which point each belongs to, ranges [m], the
    noise [m] of all points, the steepest slope."""

    index: PointIndex
    order: Ints
    ranges: Floats
    noise: Floats
    slope: float

    def blocks(self, which: Ints, k: int) -> Iterator[tuple[Ints, Ints]]:
        """Yield runs of the directions `which` with their k nearest."""
        for block in blocks(len(which), BLOCK):
            yield which[block], find_nearest_sorted(self.index, which[block], min(k, len(self.order)))


def look_out(points: Floats, origin: Floats, noise: Floats, known: Bools | None, slope: float) -> Field:
    """Return the field of the points `known` (None: all); in float32, for a scan may have tens of millions."""
    which = np.arange(len(points)) if known is None else np.flatnonzero(known)
    which = which.astype(np.int32 if len(points) < 2**31 else np.int64)
    directions, ranges = np.empty((len(which), 3), dtype=np.float32), np.empty(len(which), dtype=np.float32)
    for block in blocks(len(which), BLOCK):
        beams = points[which[block]] - origin
        ranges[block] = np.linalg.norm(beams, axis=1)
        directions[block] = beams / ranges[block, None]
    order: Ints = canonical_order(directions).astype(which.dtype)
    which = which[order]
    ranges = ranges[order]
    directions = directions[order]  # one after the other: what is unsorted goes at once
    del order
    return Field(build_index(directions), which, ranges, noise, slope)


def _beside_jumps(field: Field) -> Bools:
    """Return the directions (n,) one of whose nearest has another range than any surface explains."""
    n, k = len(field.order), min(N_BESIDE + 1, len(field.order))
    beside = np.empty(n, dtype=bool)
    for block in blocks(n, BLOCK):
        last = min(block.stop, n)
        near = find_nearest(field.index, block.start, last, np.full(last - block.start, k))
        _mark_jumps(field.index.points, field.ranges, field.noise, field.order, near, block.start, field.slope, beside)
    return beside


@njit(cache=True, parallel=True, error_model="numpy")
def _mark_jumps(
    directions: Any, ranges: Any, noise: Any, order: Any, near: Any, first: int, slope: float, beside: Any
) -> None:
    """Write for a block of directions from `first` on whether one of the neighbours (m, k) lies beyond a jump."""
    for row in prange(near.shape[0]):
        i = first + row
        beside[i] = False
        for j in near[row]:
            aside2 = 0.0
            for axis in range(3):
                aside2 += (directions[j, axis] - directions[i, axis]) ** 2
            limit = min(ranges[i], ranges[j]) * math.sqrt(aside2) * slope + JUMP_SIGMAS * noise[order[i]]
            if abs(ranges[j] - ranges[i]) > limit:
                beside[i] = True


def _beside_nothing(field: Field) -> Bools:
    """Return the directions (n,) half of whose surroundings is empty."""
    wide = [
        widest_gap(field.index.points[which], field.index.points[near] - field.index.points[which][:, None]) > RIM_GAP
        for which, near in field.blocks(np.arange(len(field.order)), N_ASIDE + 1)
    ]
    return np.concatenate(wide) if wide else np.zeros(0, dtype=bool)


def has_inner(field: Field, rims: Bools) -> Bools:
    """Return the rims (n,) that have `N_INNER` neighbours of the same surface which are none."""
    named = np.zeros(len(rims), dtype=bool)
    for which, near in field.blocks(np.flatnonzero(rims), N_ASIDE + 1):
        ranges = field.ranges[which][:, None]
        aside = np.linalg.norm(field.index.points[near] - field.index.points[which][:, None], axis=2)
        limit = np.minimum(field.ranges[near], ranges) * aside * field.slope
        is_same = np.abs(field.ranges[near] - ranges) <= limit + JUMP_SIGMAS * field.noise[field.order[which]][:, None]
        named[which] = (is_same & ~rims[near]).sum(axis=1) >= N_INNER
    return named


def widest_gap(directions: Floats, aside: Floats) -> Floats:
    """Return the widest angle (n,) [rad] about each direction (n, 3) in which none of its neighbours (n, k, 3) lies."""
    across = np.cross(directions, np.where(np.abs(directions[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    upward = np.cross(directions, across)
    angles = np.arctan2(np.einsum("nkj,nj->nk", aside, upward), np.einsum("nkj,nj->nk", aside, across))
    at_itself = (aside == 0.0).all(axis=2)
    angles = np.sort(np.where(at_itself, angles.max(axis=1, keepdims=True), angles), axis=1)
    return np.maximum(np.diff(angles, axis=1).max(axis=1, initial=0.0), 2.0 * math.pi - angles[:, -1] + angles[:, 0])
