"""The body between two surfaces where a region changed: its volume and how sure; open, overhanging, not 2.5-D.

Where a piece broke off, most of what is gone has no counterpart that looks the same way. Its surface before, and the
fracture, are found by the side of the other surface on which they lie; both patches and a closing surface enclose what
is gone (divergence theorem).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import jit
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from monitor.comparison.detection.tested import Detected
from monitor.comparison.distances.ahead import are_hidden
from monitor.comparison.distances.offsets import Offsets
from monitor.comparison.distances.portions import search_offsets
from monitor.comparison.distances.quantile import median
from monitor.comparison.distances.rim import distance_to_rim
from monitor.comparison.distances.scratch import keep_on_disk
from monitor.comparison.distances.shell import Shell
from monitor.comparison.distances.side import EXTRAPOLATED, Side
from monitor.comparison.distances.spreading import spread_along
from monitor.comparison.noise.correlation import kept_variance
from monitor.comparison.noise.guesses import sigma_of_guess
from monitor.comparison.noise.model import Noise
from monitor.comparison.noise.scan_errors import stated_over
from monitor.comparison.regions.closing import Closing, border_edges, close_gap, cone_volume
from monitor.registration.motion.sampling import motion_rows
from projects.model import Bools, Floats, Ints, NotAssessed, Registration
from projects.triangles import area_vectors, face_areas

SIGNS = (-1.0, 1.0)  # of (reference, compared): outside of the other surface is lost there, gained here
PIECE = 5.0  # search limits: a piece that broke off may be deeper than any change along the perpendicular
ROUNDS = 2  # of growing: a piece whose front and back do not hang together is reached through the fracture
ONE_SIDED = 1.0  # of half the area of both patches: a gap as large, across one direction, is a side nobody saw
BULGE = 0.25  # of a gap's width: one sigma of how far the surface that was not seen may lie off the closing one


@dataclass(frozen=True)
class Beyond:
    """Both sides' vertices where the perpendicular says nothing.

    `change` (n,) [m] is to the nearest point in any direction, positive = gained, NaN where the side is not known or
    the vertex is assessed; `gaps` (n,) [m] its size, known or not; `nearest` (n,) the vertex of the other surface
    nearest to it, -1 without; `is_free` (n,) whether it lies on a free edge; `limit` [m] of the search; `is_through`
    (n,) whether a scan of the other epoch looked through it, which makes it gone or new: nowhere, if none is known;
    `is_end` (n,) whether it is the end of a surface that lies no farther off than ends do by chance, `ends_by` [m].
    """

    change: tuple[Floats, Floats]
    gaps: tuple[Floats, Floats]
    nearest: tuple[Ints, Ints]
    is_free: tuple[Bools, Bools]
    limit: float
    is_through: tuple[Bools, Bools]
    is_end: tuple[Bools, Bools]
    ends_by: tuple[float, float]


@dataclass(frozen=True)
class Body:
    """Volume [m3] between the surfaces, positive = gained, and its sigma; NaN where they do not enclose it."""

    volume: float
    sigma: float


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
                  (ends[0], ends[1]), (unsure_of_ends(sides[0]), unsure_of_ends(sides[1])))  # fmt: skip


def is_at_end(side: Side, shell: Shell, which: Ints, found: Offsets) -> Bools:
    """Return which of some vertices (m,) of a side lie where their own surface goes on beyond its samples, at a free
    edge, or `found` under the other one where that does.

    At a limb, where beams graze it, such an end stands off the object by many times the level of detection: along it a
    change found beside it would run all around. Before a surface that ends a vertex is exposed for all that: what broke
    off hangs together with its foot across the end of the fracture.
    """
    own = distance_to_rim(shell.rim, side.surface.vertices[which]) < EXTRAPOLATED * spacing_of(side)
    return own | ((side.reasons[which] == NotAssessed.FREE_EDGE) & (found.distances < 0.0))


def unsure_of_ends(side: Side) -> float:
    """Return the distance [m] up to which surfaces end off each other by chance: an end is not known better than the
    spacing of its vertices, on either side."""
    return 2.0 * EXTRAPOLATED * spacing_of(side)


def spacing_of(side: Side) -> float:
    """Return the spacing [m] of the vertices of a side."""
    return float(np.sqrt(median(side.areas)))


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


def spread_over_assessed(side: Side, region: Ints, widths: Floats) -> Ints:
    """Return the regions with their margin along the surface, where it is assessed; `widths` [m] by their numbers."""
    inside = np.flatnonzero(region > 0)
    if not len(inside):
        return region.copy()
    source = spread_along(side, inside, side.is_assessed | (region > 0), widths[region[inside]])
    return np.where(source >= 0, region[np.maximum(source, 0)], 0).astype(region.dtype)


def over_each_other(sides: tuple[Side, Side], margins: tuple[Ints, Ints]) -> tuple[Ints, Ints]:
    """Return the regions of both sides (n,) with what stands over the other side's.

    Where one side's patch ends before the other's though both have surface there, a closing film from border to border
    would pass for a body.
    """
    out = []
    for k, side in enumerate(sides):
        own = margins[k].copy()
        at = np.flatnonzero(side.is_assessed & (own == 0) & (side.foot_vertices >= 0))
        own[at] = margins[1 - k][side.foot_vertices[at]]
        out.append(own)
    return out[0], out[1]


def measure_body(number: int, sides: tuple[Side, Side], margins: tuple[Ints, Ints], found: Detected,
                 registration: Registration, beyond: Beyond) -> Body | None:  # fmt: skip
    """Return the body that the patches of a region (`margins`: with their margin) enclose; None where none can be."""
    masks = [m == number for m in margins]
    faces = [s.surface.faces[_lie_within(np.asarray(s.surface.faces), m)] for s, m in zip(sides, masks, strict=True)]
    n_first = len(sides[0].areas)
    patches = np.vstack([faces[0][:, ::-1], faces[1] + n_first])
    used, patches = np.unique(patches, return_inverse=True)
    patches = patches.reshape(-1, 3)
    if len(used) < 4:
        return None
    points = _pick([s.surface.vertices for s in sides], used)
    local = points - points.mean(axis=0)
    border = border_edges(patches)
    closing = close_gap(local, border)
    if closing is None:
        return None
    is_matched, is_free = _pick([s.is_assessed for s in sides], used), _pick(beyond.is_free, used)
    if is_one_sided(closing, is_matched, local[patches]):
        return Body(float("nan"), float("nan"))
    volume = cone_volume(local[patches]) + cone_volume(closing.triangles, closing.weights)
    noise = sigma_of_patches(sides, masks, found, registration)
    ends = np.where(is_free, EXTRAPOLATED * max(spacing_of(s) for s in sides), 0.0)
    return Body(volume, float(np.hypot(noise, sigma_of_gap(closing, is_matched, ends, border))))


def is_one_sided(closing: Closing, is_matched: Bools, patches: Floats) -> bool:
    """Return whether what closes the patches (m, 3, 3) [m] stands for a side that nobody saw, as the ground below a
    chest: one patch with a film over its mouth encloses no body.

    Areas of a closed surface as vectors add up to nothing: those of the gaps are as large as what the patches lack on
    one side. The sides of a panel, a slit, both mouths of a hole lie across all directions, and add up to little.
    """
    crosses = ~is_matched[closing.corners].all(axis=1)
    lacking = closing.weights[crosses] @ (0.5 * area_vectors(closing.triangles[crosses]))
    seen = face_areas(patches).sum()
    return bool(np.linalg.norm(lacking) > ONE_SIDED * 0.5 * seen)


@jit(nopython=True, cache=True, nogil=True)
def _lie_within(faces, mask):  # type: ignore[no-untyped-def]
    """Return which faces (m, 3) have all corners in a mask (n,) of the vertices."""
    out = np.empty(len(faces), dtype=np.bool_)
    for f in range(len(faces)):
        out[f] = mask[faces[f, 0]] and mask[faces[f, 1]] and mask[faces[f, 2]]
    return out


def _pick(both: Sequence[Any], which: Ints) -> Any:
    """Return the values of the vertices `which`, rising, numbered over both sides, of the `both` sides' arrays."""
    n_first = len(both[0])
    split = int(np.searchsorted(which, n_first))
    return np.concatenate([both[0][which[:split]], both[1][which[split:] - n_first]])


def sigma_of_gap(closing: Closing, is_matched: Bools, ends: Floats, border: Ints) -> float:
    """Return one sigma [m3] of what the closing surface may miss where it crosses a gap.

    A gap may bulge by a quarter of its width: so much does a surface with a right-angled edge in it, on average; and a
    surface `ends` (n,) [m] short of what it was measured on. The width at a triangle is its height over the part of the
    `border` (e, 2) in it. Where the border lies in surface that both epochs have (`is_matched` (n,)), the closing
    surface is a strip within it and misses nothing. Gaps are taken to err together.
    """
    crosses = ~is_matched[closing.corners].all(axis=1)
    corners, triangles = closing.corners[crosses], closing.triangles[crosses]
    length = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
    n = len(is_matched) + 1
    sides = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2), axis=2)
    is_border = np.isin(sides[..., 0] * n + sides[..., 1], np.sort(border, axis=1) @ np.array([n, 1]))
    base = np.where(is_border.any(axis=1), (length * is_border).sum(axis=1), length.min(axis=1))
    area = _areas(closing)[crosses]
    bulge = BULGE * 2.0 * area / np.maximum(base, 1e-300)
    return float(area @ np.hypot(bulge, ends[corners].max(axis=1, initial=0.0)))


def _areas(closing: Closing) -> Floats:
    """Return the area (k,) [m2] of each closing triangle, as often as it counts."""
    return np.asarray(face_areas(closing.triangles) * closing.weights)


def sigma_of_patches(sides: tuple[Side, Side], masks: list[Bools], found: Detected, registration: Registration,
                     ) -> float:  # fmt: skip
    """Return one sigma [m3] of the volume from the noise of both patches, what their scans share, and the motion.

    Where a vertex is assessed its variance is of the change, so both patches bear the same error, and half of it each
    is taken; elsewhere a patch bears its own, half of the median change's.
    """
    scale = max(e.width for e in found.test.errors)
    both, guess, alone, shared = 0.0, 0.0, 0.0, 0.0
    for side, mask in zip(sides, masks, strict=True):
        matched, own = np.flatnonzero(mask & side.is_assessed), np.flatnonzero(mask & ~side.is_assessed)
        typical = _typical_variance(side, found.noise) * scale**2 if len(own) else 0.0
        noise2, guess2 = found.noise.parts_of(side, matched)
        both += 0.5 * _sum_sigma(side.areas[matched], noise2 * scale**2, found)
        guess += 0.5 * sigma_of_guess(side.surface.vertices[matched], side.areas[matched], guess2, found.test.size)
        alone += _sum_sigma(side.areas[own], np.full(len(own), 0.5 * typical), found) ** 2
        stated = np.array(stated_over(side, np.flatnonzero(mask)))
        shared += 0.5 * float(side.areas[mask].sum() * found.test.scans.sigma_of(stated))
    mask, side = masks[1], sides[1]
    row = side.areas[mask] @ motion_rows(side.surface.vertices[mask], side.normals[mask], registration.centre)
    motion2 = max(float(row @ registration.covariance @ row), 0.0)
    return float(np.sqrt(both**2 + guess**2 + alone + shared**2 + motion2))


def _typical_variance(side: Side, noise: Noise) -> float:
    """Return the median variance [m2] of the assessed vertices, 0 where there are none."""
    assessed = np.flatnonzero(side.is_assessed)
    return median(np.add(*noise.parts_of(side, assessed))) if len(assessed) else 0.0


def _sum_sigma(areas: Floats, variance: Floats, found: Detected) -> float:
    """Return one sigma [m3] of the sum of area times error over some vertices of one patch."""
    if not len(areas):
        return 0.0
    total = float(areas.sum())
    scale2 = max(e.width for e in found.test.errors) ** 2
    stretch2 = found.noise.stretch.square_over(areas, variance / scale2)
    kept = kept_variance(np.array([total]), np.array([len(areas)]), found.noise.correlation, stretch2)
    return total * float(np.sqrt(np.average(variance, weights=areas) * kept[0]))
