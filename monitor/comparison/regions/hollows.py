"""Hollows narrower than a surface follows, as cracks: told by the points of one epoch that lie in under the other's
surface.

In: both sides, what lies beyond their perpendiculars, and the points of both epochs. Out: the same, where hollows
opened, or were filled, as looked through. A surface needs some five points across a hollow to follow it; with fewer it
bridges the mouth, or ends there, and the perpendicular tells nothing. The points do: an epoch that measured the surface
at a place has them on it, and where the other epoch has hardly any but many far behind, what lay there is gone.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from monitor.comparison.detection.tested import Detected
from monitor.comparison.distances.around import largest_around, sum_around
from monitor.comparison.distances.connected import connect_like
from monitor.comparison.distances.side import EXTRAPOLATED, Side
from monitor.comparison.regions.beyond import SIGNS, Beyond
from monitor.comparison.regions.borne_out import spread_rings
from monitor.comparison.regions.chips import HANDFUL, is_strewn_once, levels_off
from monitor.comparison.regions.evidence import ABSENT
from monitor.comparison.regions.under import BESIDE, Cubes, Under, nearest_along, place_under
from projects.model import Bools, Floats, Ints, NotAssessed

SUNK, DEEP = 1.5, 3.0  # spacings behind a surface: no point of it; and farther than its own bends leave any
LEVELS = 3.0  # median levels of detection that a point must lie behind, too; what is asked differs by as many
FEWEST_SUNK = 2  # points around a vertex
FEWEST_DEEP, SHARE_DEEP = 8, 0.1  # points of a hollow that lie deep; and of those sunk
FEWEST_ON, MOST_SUNK = 3, 0.1  # points on its surface around a vertex; share of those sunk, in the epoch that has it
AS_DENSE = 0.5  # of what its points should be there by how many the other epoch has, or lie beside: else a bridge, too
HALF = 0.5  # of the depth of the points below a mouth: a surface nearer to it bridges it
AWAY = -0.3  # cosine between two surfaces: what lies on one that looks the other way was not measured through this one
ON = 2.0  # spacings of the vertices from a surface, within which points lie on it
RIM = 2  # edges around a hollow, within which it is looked for where the points on the surface end
AROUND = 10  # edges around vertices over deep points, within which a hollow may lie


class Hollows(NamedTuple):
    """Of a side's vertices (n,) which lie over a hollow; how deep [m] the deepest point under each and its neighbours
    lies; where points lie sunk, in hollows or narrower, whom no surface of the other epoch follows; and which lie
    beside a hollow, next to points on the surface."""

    is_open: Bools
    depth: Floats
    is_unfollowed: Bools
    is_rim: Bools


def enter_hollows(sides: tuple[Side, Side], beyond: Beyond, found: Detected, points: tuple[Floats | None, ...],
                  least: float) -> tuple[tuple[Side, Side], Beyond, Detected]:  # fmt: skip
    """Return sides, what lies beyond them and what was found, with what was looked into as looked through.

    The surface that bridges the mouth in the other epoch is none: its vertices are not assessed.

    Parameters
    ----------
    points : those (m, 3) m of both epochs, in the coordinates of the sides, None where an epoch has none.
    least : m, a change that counts.
    """
    before, after = points
    if before is None or after is None:
        return sides, beyond, found
    for k, both in enumerate(((before, after), (after, before))):
        hollows = find_hollows(sides, k, both, least)
        if hollows is not None:
            sides, beyond, found = _as_looked_through(sides, beyond, found, k, hollows)
    return sides, beyond, found


def may_hide_hollows(side: Side, found: Detected, k: int) -> Bools:
    """Return where (n,) a side, k of both, would show a hollow of the other epoch: not at its own ends, without a
    counterpart, far off, or with many points off one of both surfaces only."""
    is_absent = np.isin(side.reasons, ABSENT) & ~(side.to_rim < EXTRAPOLATED * side.spacing)
    return is_absent & ~side.is_fringe | (levels_off(side, found.sides[k]) > LEVELS) | is_strewn_once(side)


def find_hollows(sides: tuple[Side, Side], k: int, points: tuple[Floats, Floats], least: float) -> Hollows | None:
    """Return where the other epoch's points (m, 3) lie in under side k, on which its own (l, 3) lie; None if nowhere.

    Around a vertex, it and its neighbours, at least as many of the other epoch's points are sunk as lie on it, and
    hardly any of its own; hollows hang together, hold `FEWEST_DEEP` points that lie deep, and a handful of vertices,
    over which its own epoch has as many points as the other one has, by what both have in all, or as beside them.
    """
    own, theirs_all = sides[k], points[1]
    sunk_by = max(SUNK * own.spacing, LEVELS * least)
    by = sunk_by, max(DEEP * own.spacing, 2.0 * sunk_by)
    placed = _place_near_hollows(sides, k, points, by)
    if placed is None:
        return None
    mine, theirs = placed
    is_own = _is_measured(own, mine, sunk_by)
    part = connect_like(np.where(_fill_gaps(own, _is_sunk(own, theirs, sunk_by) & is_own), 0, -1), [own.neighbours])
    is_open = np.append(_are_hollows(own, part, mine, theirs, by), False)[part]
    depth, is_unfollowed = _measure(sides, k, theirs_all, theirs, sunk_by)
    depth = np.where(is_open, np.maximum(depth, sunk_by), depth)  # so deep they lie, all of them
    is_open, is_rim = _end_at_points(own, is_open, theirs_all, theirs, sunk_by)
    return Hollows(is_open & ~_reaches(own, depth), depth, is_unfollowed & is_own, is_rim)


def _place_near_hollows(sides: tuple[Side, Side], k: int, points: tuple[Floats, Floats],
                        by: tuple[float, float]) -> tuple[Under, Under] | None:  # fmt: skip
    """Return where points of both epochs, side k's own first, lie near vertices over deep points of the other, and
    which lie deep anywhere; None with too few of these. Most points lie on the surface, far from any hollow."""
    own, theirs_all = sides[k], points[1]
    tree, cubes = cKDTree(own.surface.vertices, balanced_tree=False), Cubes.about(own, by[1])
    cube = cubes.of(theirs_all)
    far = _place_in_front(sides, k, tree, theirs_all, np.flatnonzero(cube < 0), by[0])
    is_deep = far.height < -by[1]
    if np.count_nonzero(is_deep) < FEWEST_DEEP:
        return None
    over = np.zeros(len(own.areas), dtype=np.bool_)
    over[far.vertex[is_deep]] = True
    over = spread_rings(own.neighbours, over, AROUND)
    near = np.append(cubes.around(own.surface.vertices[over]), True)  # the last entry is cube -1, of what lies far off
    theirs = _place_in_front(sides, k, tree, theirs_all, np.flatnonzero(near[cube]), by[0])
    return place_under(own, tree, points[0], np.flatnonzero(near[cubes.of(points[0])])), theirs


def _end_at_points(side: Side, is_open: Bools, points: Floats, theirs: Under, sunk_by: float) -> tuple[Bools, Bools]:
    """Return which vertices (n,) lie over hollows, those at the border only where a sunk point is nearer than one on
    the surface, and which beside one have a point on it next to them and none sunk. Counts do not tell the border: a
    beam that comes aslant meets the walls of a hollow more often than its mouth."""
    near = spread_rings(side.neighbours, is_open, RIM)
    at = np.flatnonzero(np.isfinite(theirs.height) & near[theirs.vertex])
    under = Under(theirs.vertex[at], theirs.height[at])
    which, is_sunk = np.flatnonzero(near), under.height < -sunk_by
    on, sunk = (nearest_along(side, which, points[at[i]], Under(under.vertex[i], under.height[i]))
                for i in (~is_sunk, is_sunk))  # fmt: skip
    is_beside, is_rim = np.zeros((2, len(is_open)), dtype=np.bool_)
    is_beside[which] = on <= sunk
    is_rim[which] = (on <= sunk) & (on < BESIDE * side.spacing)
    return is_open & ~is_beside, is_rim


def _reaches(side: Side, depth: Floats) -> Bools:
    """Return the vertices (n,) from which the other surface is as far as points lie deep (n,) [m], or half as far:
    it is no bridge over a mouth."""
    return np.asarray(side.is_assessed & (np.abs(np.nan_to_num(side.distances)) > HALF * depth))


def _count_around(side: Side, under: Under, which: Bools) -> Ints:
    """Return how many of the points `which` (m,) lie next to each vertex (n,) and its neighbours."""
    return sum_around(side.neighbours, np.bincount(under.vertex[which], minlength=len(side.areas)))


def _is_measured(side: Side, mine: Under, sunk_by: float) -> Bools:
    """Return the vertices (n,) around which the side's own points lie on it, and hardly any behind."""
    on, sunk = (_count_around(side, mine, which) for which in (mine.height >= -sunk_by, mine.height < -sunk_by))
    return np.asarray((on >= FEWEST_ON) & (sunk <= MOST_SUNK * on) & ~side.is_fringe)


def _is_sunk(side: Side, theirs: Under, sunk_by: float) -> Bools:
    """Return the vertices (n,) around which at least as many of the other epoch's points are sunk as lie on them."""
    on, sunk = (_count_around(side, theirs, which) for which in (theirs.height >= -sunk_by, theirs.height < -sunk_by))
    return np.asarray((sunk >= FEWEST_SUNK) & (sunk >= on))


def _are_hollows(side: Side, part: Ints, mine: Under, theirs: Under, by: tuple[float, float]) -> Bools:
    """Return which parts (p,) of a side, -1 in `part` (n,) for none, are hollows by what lies in them."""
    n_parts = int(part.max(initial=-1)) + 1

    def count(under: Under, which: Bools) -> Ints:
        """Return how many of the points `which` (m,) lie under each part (p,)."""
        at = part[under.vertex[which]]
        return np.bincount(at[at >= 0], minlength=n_parts)

    n_sunk, n_deep = (count(theirs, theirs.height < -depth) for depth in by)
    n_theirs, n_mine = count(theirs, np.isfinite(theirs.height)), count(mine, mine.height >= -by[0])
    area = np.bincount(part[part >= 0], side.areas[part >= 0], minlength=n_parts)
    is_measured = n_mine >= AS_DENSE * n_theirs * len(mine.vertex) / len(theirs.vertex)
    is_measured |= n_mine >= AS_DENSE * area * _density_beside(side, part >= 0, mine, by[0])
    is_deep = (n_deep >= FEWEST_DEEP) & (n_deep >= SHARE_DEEP * n_sunk)
    return np.asarray(is_deep & is_measured & (area >= HANDFUL * side.spacing**2))


def _place_in_front(sides: tuple[Side, Side], k: int, tree: cKDTree, points: Floats, which: Ints,
                    sunk_by: float) -> Under:  # fmt: skip
    """Return where those points `which` (l,) of the other epoch's (m, 3) lie under side k, without those sunk that lie
    on a surface of their epoch that looks the other way: the back of what side k is the front of."""
    under, other = place_under(sides[k], tree, points, which), sides[1 - k]
    at = np.flatnonzero(under.height < -sunk_by)
    if not len(at):
        return under
    distance, nearest = cKDTree(other.surface.vertices).query(points[at], workers=2)
    cosine = np.einsum("ij,ij->i", other.normals[nearest], sides[k].normals[under.vertex[at]])
    under.height[at[(distance < ON * other.spacing) & (cosine < AWAY)]] = np.nan
    return under


def _density_beside(side: Side, is_open: Bools, mine: Under, sunk_by: float) -> float:
    """Return how many of the side's own points lie on it per m2 beside vertices (n,)."""
    beside = spread_rings(side.neighbours, is_open, RIM) & ~is_open
    n_on = np.count_nonzero(beside[mine.vertex[mine.height >= -sunk_by]])
    return float(n_on / max(side.areas[beside].sum(), np.finfo(np.float64).tiny))


def _fill_gaps(side: Side, is_open: Bools) -> Bools:
    """Return the vertices (n,) with what lies between them, no farther than an edge from either side."""
    grown = spread_rings(side.neighbours, is_open, 1)
    return np.asarray(grown & ~spread_rings(side.neighbours, ~grown, 1))


def _measure(sides: tuple[Side, Side], k: int, points: Floats, theirs: Under,
             sunk_by: float) -> tuple[Floats, Bools]:  # fmt: skip
    """Return how deep (n,) [m] the deepest sunk point under each vertex and its neighbours lies that another next to it
    bears out, 0 without any, and where no surface of the other epoch follows most: it ends, or stays halfway behind."""
    own, other = sides[k], sides[1 - k]
    at = np.flatnonzero(theirs.height < -sunk_by)
    at = at[np.argsort(-theirs.height[at], kind="stable")]
    deepest = np.full(len(own.areas), -1)
    deepest[theirs.vertex[at]] = at  # the last one written is the deepest
    over = np.flatnonzero(deepest >= 0)
    depth, n_off, n_all = np.zeros((3, len(own.areas)))
    depth[over] = -theirs.height[deepest[over]]
    n_all[over] = 1.0
    distance, _ = cKDTree(other.surface.vertices).query(points[deepest[over]], workers=2)
    n_off[over] = distance > np.clip(HALF * depth[over], other.spacing, ON * other.spacing)
    is_off = 2.0 * sum_around(own.neighbours, n_off) > sum_around(own.neighbours, n_all)
    depth = np.minimum(depth, largest_around(own.neighbours, depth))  # a stray is as deep as what lies beside it
    return np.maximum(depth, largest_around(own.neighbours, depth)), is_off


def _as_looked_through(sides: tuple[Side, Side], beyond: Beyond, found: Detected, k: int,
                       hollows: Hollows) -> tuple[tuple[Side, Side], Beyond, Detected]:  # fmt: skip
    """Return sides, what lies beyond them and what was found, with the hollows of side k as looked through."""
    own, other = sides[k], sides[1 - k]
    is_open, film = hollows.is_open, np.zeros(len(other.areas), dtype=np.bool_)
    has_foot = np.flatnonzero(other.is_assessed & (other.foot_vertices >= 0))
    feet = other.foot_vertices[has_foot]
    film[has_foot] = is_open[feet] & (np.abs(other.distances[has_foot]) <= HALF * hollows.depth[feet])
    new = own.without(own.is_assessed & is_open, NotAssessed.NO_FACE), other.without(film, NotAssessed.NO_ONE_SURFACE)

    unfollowed = np.where(hollows.is_unfollowed, hollows.depth, 0.0)
    change, gaps, through = (
        _with_own(both, k, np.where(hollows.is_rim, none, np.where(is_open, made, both[k])))
        for both, made, none in ((beyond.change, SIGNS[k] * hollows.depth, np.nan), (beyond.gaps, hollows.depth, 0.0),
                                 (beyond.is_through, is_open, False))
    )  # fmt: skip
    beyond = replace(beyond, change=change, gaps=gaps, is_through=through,
                     unfollowed=_with_own(beyond.unfollowed, k, unfollowed))  # fmt: skip
    told = list(found.sides)
    told[1 - k] = replace(told[1 - k], is_changed=told[1 - k].is_changed & ~film)
    return (new if k == 0 else new[::-1]), beyond, replace(found, sides=(told[0], told[1]))


def _with_own(both: tuple[Any, Any], k: int, own: Any) -> tuple[Any, Any]:
    """Return what both sides have, with another of side k."""
    return (own, both[1]) if k == 0 else (both[0], own)
