"""Where the perpendicular says nothing: on which side of the other surface a vertex lies, and which region it is of.

Where a piece broke off, most of what is gone has no counterpart that looks the same way. Its surface before, and the
fracture, are found by the side of the other surface on which they lie, and grow together with the region at their foot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from monitor.comparison.distances.ahead import are_hidden
from monitor.comparison.distances.offsets import Offsets
from monitor.comparison.distances.portions import search_offsets
from monitor.comparison.distances.rim import distance_to_rim
from monitor.comparison.distances.scratch import keep_on_disk
from monitor.comparison.distances.shell import Shell
from monitor.comparison.distances.side import EXTRAPOLATED, Side
from monitor.comparison.distances.spreading import spread_along
from projects.model import Bools, Floats, Ints, NotAssessed

SIGNS = (-1.0, 1.0)  # of (reference, compared): outside of the other surface is lost there, gained here
PIECE = 5.0  # search limits: a piece that broke off may be deeper than any change along the perpendicular
ROUNDS = 2  # of growing: a piece whose front and back do not hang together is reached through the fracture


@dataclass(frozen=True)
class Beyond:
    """Both sides' vertices where the perpendicular says nothing.

    `change` (n,) [m] is to the nearest point in any direction, positive = gained, NaN where the side is not known or
    the vertex is assessed; `gaps` (n,) [m] its size, known or not; `nearest` (n,) the vertex of the other surface
    nearest to it, -1 without; `is_free` (n,) whether it lies on a free edge; `limit` [m] of the search; `is_through`
    (n,) whether a scan of the other epoch looked through it, which makes it gone or new: nowhere, if none is known;
    `is_end` (n,) whether it is the end of a surface that lies no farther off than ends do by chance, `ends_by` [m];
    `unfollowed` (n,) [m] how deep points of the other epoch lie in under it whom no surface of theirs follows, 0: none.
    """

    change: tuple[Floats, Floats]
    gaps: tuple[Floats, Floats]
    nearest: tuple[Ints, Ints]
    is_free: tuple[Bools, Bools]
    limit: float
    is_through: tuple[Bools, Bools]
    is_end: tuple[Bools, Bools]
    ends_by: tuple[float, float]
    unfollowed: tuple[Floats, Floats]


def look_beyond(sides: tuple[Side, Side], shells: tuple[Shell, Shell], limit: float) -> Beyond:
    """Tell for all vertices that are not assessed on which side of the other surface they lie.

    `limit` [m] is the search limit of the perpendiculars; a piece may be `PIECE` times as deep. Nothing is told where
    the points are of no one surface, nor that something lies under the other surface where that has ended: the far side
    of a body of which the other epoch saw the near one is not buried.
    """
    limit = PIECE * limit
    change, gaps, nearest, ends = [], [], [], []
    for k, side in enumerate(sides):
        which = np.flatnonzero(~side.is_assessed & (side.reasons != NotAssessed.NO_ONE_SURFACE))
        found = search_offsets(shells[1 - k], side.surface.vertices[which])
        here = np.full(len(side.areas), np.nan)
        is_told = found.is_known & (np.abs(found.distances) <= limit)
        buried = found.is_past_end & (found.distances < 0.0)
        here[which] = np.where(is_told & ~buried, SIGNS[k] * found.distances, np.nan)
        by_chance = found.is_known & (np.abs(found.distances) <= unsure_of_ends(side))
        ends.append(np.zeros(len(side.areas), dtype=np.bool_))
        ends[k][which] = by_chance & (is_at_end(side, shells[k], which, found) | buried)
        change.append(keep_on_disk(here))
        gap = np.full(len(side.areas), np.nan)
        gap[which] = np.abs(found.distances)
        gaps.append(keep_on_disk(gap))
        nearest.append(keep_on_disk(_nearest_vertices(side, which, found)))
    none = (np.zeros(len(change[0]), dtype=np.bool_), np.zeros(len(change[1]), dtype=np.bool_))
    is_free = (shells[0].is_border, shells[1].is_border)
    return Beyond((change[0], change[1]), (gaps[0], gaps[1]), (nearest[0], nearest[1]), is_free, limit, none,
                  (ends[0], ends[1]), (unsure_of_ends(sides[0]), unsure_of_ends(sides[1])),
                  (np.zeros(len(change[0])), np.zeros(len(change[1]))))  # fmt: skip


def is_at_end(side: Side, shell: Shell, which: Ints, found: Offsets) -> Bools:
    """Return which of some vertices (m,) of a side lie where their own surface goes on beyond its samples, at a free
    edge, or `found` under the other one where that does.

    At a limb, where beams graze it, such an end stands off the object by many times the level of detection: along it a
    change found beside it would run all around. Before a surface that ends a vertex is exposed for all that: what broke
    off hangs together with its foot across the end of the fracture.
    """
    own = distance_to_rim(shell.rim, side.surface.vertices[which]) < EXTRAPOLATED * side.spacing
    return own | ((side.reasons[which] == NotAssessed.FREE_EDGE) & (found.distances < 0.0))


def unsure_of_ends(side: Side) -> float:
    """Return the distance [m] up to which surfaces end off each other by chance: an end is not known better than the
    spacing of its vertices, on either side."""
    return 2.0 * EXTRAPOLATED * side.spacing


def _nearest_vertices(side: Side, which: Ints, found: Offsets) -> Ints:
    """Return the vertex of the other surface nearest to each vertex in `which`, -1 for the others."""
    out = np.full(len(side.areas), -1, dtype=np.int32)
    has = found.faces >= 0
    corners = side.other.faces[found.faces[has]]
    gap = np.linalg.norm(side.other.vertices[corners] - side.surface.vertices[which[has]][:, None], axis=2)
    out[which[has]] = corners[np.arange(len(corners)), gap.argmin(axis=1)]
    return out


def grow_regions(sides: tuple[Side, Side], beyond: Beyond, regions: tuple[Ints, Ints], signs: Floats,
                 least: float) -> tuple[Ints, Ints]:  # fmt: skip
    """Return the regions (n,) of both sides with what lies beyond the perpendicular.

    `signs` (r + 1,) of each region; `least` [m] of a change that counts. On the exposed side (before a loss, after a
    gain) a region spreads along the surface over vertices outside of the other surface, at most as deep as a piece may
    be. On the buried side it takes the vertices whose nearest point is of it, and what hangs together with them inside
    of the other surface: of the wall of a hole the nearest point lies on the rim as often as within it. What its own
    surface hides from there, as the wall behind a figure that gained, is not buried by the change.
    """
    grown = [r.copy() for r in regions]
    outside = [np.nan_to_num(c) * sign > least for c, sign in zip(beyond.change, SIGNS, strict=True)]
    inside = [np.nan_to_num(c) * sign < -least for c, sign in zip(beyond.change, SIGNS, strict=True)]
    for _ in range(ROUNDS):
        for k, side in enumerate(sides):
            _take_nearest(grown, beyond, k, outside[k], signs == SIGNS[k])
            _take_connected(grown, side, k, outside[k], signs == SIGNS[k], beyond)
        for k, side in enumerate(sides):
            _take_buried(grown, side, k, inside[k], signs == -SIGNS[k], beyond)
            _take_connected(grown, side, k, inside[k], signs == -SIGNS[k], beyond)
    return grown[0], grown[1]


def _take_nearest(grown: list[Ints], beyond: Beyond, k: int, allowed: Bools, fitting: Bools) -> None:
    """Give allowed vertices of side k that have no region that of the nearest vertex of the other side, if it fits."""
    taken, label = _nearest_regions(grown, beyond, k, allowed, fitting)
    grown[k][taken] = label


def _take_buried(grown: list[Ints], side: Side, k: int, allowed: Bools, fitting: Bools, beyond: Beyond) -> None:
    """Do the same on the buried side k, but for what this side's own surface hides from that vertex."""
    taken, label = _nearest_regions(grown, beyond, k, allowed, fitting)
    for number in np.unique(label):
        which = taken[label == number]
        is_hidden = are_hidden(side, which, side.other.vertices[beyond.nearest[k][which]])
        grown[k][which[~is_hidden]] = number


def _nearest_regions(grown: list[Ints], beyond: Beyond, k: int, allowed: Bools, fitting: Bools) -> tuple[Ints, Ints]:
    """Return which allowed vertices of side k that have no region are nearest to one that fits, and which that is."""
    near = beyond.nearest[k]
    label = np.where(near >= 0, grown[1 - k][near], 0)
    taken = np.flatnonzero(allowed & (grown[k] == 0) & (label > 0) & fitting[label])
    return taken, label[taken]


def _take_connected(grown: list[Ints], side: Side, k: int, allowed: Bools, fitting: Bools, beyond: Beyond) -> None:
    """Spread the fitting regions of side k over allowed vertices: at most as far along the surface as a piece may be
    deep, and over its ends no farther than ends lie off by chance. Along an end, which stands off a body by many times
    the level of detection where beams graze its limb, a region would run all around."""
    is_end = beyond.is_end[k]
    for which, limit in ((allowed & ~is_end, beyond.limit), (allowed & is_end, beyond.ends_by[k])):
        is_seed = (grown[k] > 0) & fitting[grown[k]] & ~is_end
        seeds = np.flatnonzero(is_seed)
        if len(seeds):
            source = spread_along(side, seeds, which | is_seed, limit)
            spread = np.flatnonzero((source >= 0) & (grown[k] == 0))
            grown[k][spread] = grown[k][source[spread]]


def join_grown(sides: tuple[Side, Side], grown: tuple[Ints, Ints], signs: Floats) -> Ints:
    """Return the number (r + 1,) of each region once those that grew together are one; entry 0 is of no region.

    Grown together are regions of one sign that share an edge from a vertex without a perpendicular: both mouths of a
    hole, or patches of a piece that broke off, of which the perpendicular tells a part here and a part there. Each by
    itself would be closed by a surface through the middle of what is gone.
    """
    joins = np.vstack([_touching(side, region, signs) for side, region in zip(sides, grown, strict=True)])
    n = len(signs)
    graph = coo_matrix((np.ones(len(joins)), joins.T), shape=(n, n))
    _, part = connected_components(graph, directed=False)
    _, first, number = np.unique(part, return_index=True, return_inverse=True)
    return np.asarray(np.argsort(np.argsort(first)).astype(np.int32)[number])


def _touching(side: Side, region: Ints, signs: Floats) -> Ints:
    """Return the pairs (e, 2) of regions of one sign that share an edge from a vertex that is not assessed."""
    ends = _edges_from(side, np.flatnonzero((region > 0) & ~side.is_assessed))
    pairs = region[ends].astype(np.int64)
    return pairs[(pairs[:, 1] > 0) & (signs[pairs[:, 0]] == signs[pairs[:, 1]])]


def _edges_from(side: Side, vertices: Ints) -> Ints:
    """Return the ends (e, 2) of the edges from some vertices: these, and their neighbours."""
    starts = side.neighbours.starts[vertices]
    degrees = side.neighbours.starts[vertices + 1] - starts
    first = np.repeat(starts - np.cumsum(degrees) + degrees, degrees)
    return np.column_stack([np.repeat(vertices, degrees), side.neighbours.vertices[first + np.arange(len(first))]])
