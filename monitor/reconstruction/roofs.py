"""Edges and folds between two sides: where a roof of two planes holds farther than any smooth patch.

In: vertices brought onto smooth fits, the samples. Out: `Roofs`: the vertices beside an edge with both planes there. A
smooth fit that reaches over an edge rounds it, and one that does not is narrow and noisy. On the ladder of radii two
planes are fitted to the points around such a vertex. A roof is taken where it leaves no more than noise, neither side
bows, and a smooth patch with more unknowns leaves more by evidence: of the vertex, or of all around it together.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit
from scipy.spatial import cKDTree

from monitor.reconstruction.departures import mean_of_pool
from monitor.reconstruction.faces import least_cosines
from monitor.reconstruction.gathering import ROOM, Sites, block_edge, block_sites, find_near, near_room, rows_room
from monitor.reconstruction.mesh import any_corner
from monitor.reconstruction.moments import Level
from monitor.reconstruction.projection import Projection, Samples
from monitor.reconstruction.roof_evidence import (
    ACTIVE,
    BOW,
    CHANCE,
    CHI2,
    CREST,
    GAIN,
    HIDDEN,
    N_VALUES,
    OTHER,
    OVER,
    ROUNDED,
    SEEN,
    SUPPORT,
    TURN,
    UNIT,
    look_for_roof,
)
from monitor.reconstruction.two_planes import window_room
from monitor.threads import run_tasks
from projects.model import Bools, Floats, Ints

TURN_NEAR = np.radians(5.0)  # between corners of a face: an edge may be near that fits of
ROUNDING = 1.5  # cells in radius have rounded; wider ones leave less of its turn to each face
N_RINGS = 2  # of faces around such a face, whose vertices may gain by a roof
COS_LEAST = float(np.cos(np.radians(12.0)))  # between both planes of a roof
COS_CLEAR = float(np.cos(np.radians(25.0)))  # of those whose evidence counts together
ALONE = 10.0  # what a smooth patch leaves more, in variances of a point (twice the log of a likelihood), of one vertex
TOGETHER, AGAINST = 1.0, -4.0  # the same in the mean of all around, and of the vertex itself no less than
ENDED = -2.0  # mean of all around, below which no wider roof will be better
N_POOLED = 100  # vertices around: an edge is long, and neighbours see the same points
LEAST_ALIKE = 0.2  # of these, at least, have a clear edge in the middle of their window
LOOK, VERTICES_PER_LOOK, N_LOOKS = 2, 5, 4  # rung; how many vertices share a look; looks around a vertex that count
SMOOTHER = -1.0  # at a look, below which a smooth patch speaks against an edge
CLIPPED_GAIN = 12.0  # of one vertex in that mean
CENTRAL = 0.5  # of the radius: farther from the edge a window sees little of it
ROUND, WIDTH = 2.0, 0.5  # sigmas, and of the narrowest fit's radius: how wide the edge is looked at
AGREES = 2.5  # sigmas, within which a smooth fit is of the same side
ADOPTED, ASTRAY = 1.5, 0.4  # cells: how near another vertex's roof serves, and how far off it a smooth fit is of none
BESIDE_ROUND = 1.5  # cells: nearer to a round edge the smooth fit stays
BOWED, DOUBT = 3.2, 2.3  # sigmas of a side's bow, the larger of two: no wider one is tried, not taken
BEYOND_NOISE, NOISE_MARGIN = 3.0, 1.1  # sigmas of chance beyond noise, itself known to a tenth, that a roof may leave
LEAST_SEEN = 0.6  # of the turn of both planes, between the mean normals of their points; noise and rims show none
WIDEST = 6.0  # times the narrowest fit: wider windows know the planes no better than the edge needs


class Roofs(NamedTuple):
    """Vertices `which` (k,) beside an edge: unit normals (k, 3) of the plane under each and of the other one, and the
    nearest point of the edge (k, 3) [m]; whether it is seen to be round, and how far (m) it may be so unseen."""

    which: Ints
    own: Floats
    other: Floats
    crest: Floats
    is_round: Bools
    hidden: Floats


def no_roofs() -> Roofs:
    """Return none."""
    none = np.empty((0, 3))
    return Roofs(np.empty(0, np.int64), none, none, none, np.empty(0, bool), np.empty(0))


def find_roofs(
    raw: Floats, projection: Projection, faces: Ints, samples: Samples, noise: Floats, cell: float, max_shift: float
) -> tuple[Roofs, Floats]:
    """Return the roofs of the vertices beside edges, and the row (k, `N_VALUES`) of each.

    Parameters
    ----------
    raw : (n, 3) m, the vertices before, and `max_shift` (m) how far they may go.
    projection : of the smooth fits, which tells where edges may be.
    noise : (n,) m, one sigma of a point there.
    cell : m, of the surface.

    Notes
    -----
    Next to an edge that is seen to be round the smooth fits stay.
    """
    turn = TURN_NEAR * min(ROUNDING * cell / samples.radii[0], 1.0)
    near = np.flatnonzero(near_edges(projection.normals, faces, turn) & np.isfinite(noise))
    which: Ints = near[at_clear_turns(raw[near], projection.normals[near], samples, noise[near])]
    best = climb_roofs(raw[which], projection.normals[which], samples, noise[which])
    good = can_serve(best, cell, max_shift)
    good[good] = has_company(which[good], faces, len(raw))
    which, best = share_roofs(raw, projection, near, which[good], best[good].astype(float), cell)
    good = can_serve(best, cell, max_shift)
    which, best = which[good], best[good]
    roofs = Roofs(which, best[:, ACTIVE], best[:, OTHER], raw[which] + best[:, CREST], best[:, ROUNDED] >= ROUND,
                  noise[which] * best[:, HIDDEN])  # fmt: skip
    return roofs, best


def can_serve(rows: Floats, cell: float, max_shift: float) -> Bools:
    """Return which roofs (k,) there are, within `max_shift` (m) of their vertex and not beside a round edge."""
    is_sharp = (rows[:, ROUNDED] < ROUND) | (from_crest(rows) > BESIDE_ROUND * cell)
    found: Bools = np.isfinite(rows[:, UNIT]) & (np.abs(rows[:, OVER]) <= max_shift) & is_sharp
    return found


def share_roofs(
    raw: Floats, projection: Projection, near: Ints, which: Ints, rows: Floats, cell: float
) -> tuple[Ints, Floats]:
    """Return the roofs (k,) with those of vertices `near` (m,) an edge that have none, and lie far off the next one's.

    Their smooth fits took in both sides, or there are none; they would hold back all around.
    """
    lone = np.setdiff1d(near, which)
    if not len(which) or not len(lone):
        return which, rows
    away, nearest = cKDTree(raw[which]).query(raw[lone], workers=2)
    lone, nearest = lone[away < ADOPTED * cell], nearest[away < ADOPTED * cell]
    taken, crest = rows[nearest].copy(), raw[which[nearest]] + rows[nearest][:, CREST]
    beyond = taken[:, CREST] + taken[:, OVER, None] * taken[:, ACTIVE]  # from its place on the roof to the edge
    kind = np.sign(np.einsum("ij,ij->i", beyond, taken[:, OTHER]))  # 1 for a ridge, below whose other plane it lies
    over, over_other = (np.einsum("ij,ij->i", raw[lone] - crest, taken[:, normal]) for normal in (ACTIVE, OTHER))
    swapped = kind * over_other > kind * over
    own = taken[:, ACTIVE].copy()
    taken[swapped, ACTIVE], taken[swapped, OTHER] = taken[swapped, OTHER], own[swapped]
    taken[:, OVER] = np.where(swapped, over_other, over)
    along = np.cross(taken[:, ACTIVE], taken[:, OTHER])
    along /= np.linalg.norm(along, axis=1)[:, None]
    taken[:, CREST] = crest - raw[lone]
    taken[:, CREST] -= np.einsum("ij,ij->i", taken[:, CREST], along)[:, None] * along
    place = raw[lone] - taken[:, OVER, None] * taken[:, ACTIVE]
    astray = np.linalg.norm(projection.vertices[lone] - place, axis=1) > ASTRAY * cell
    astray |= ~projection.is_fitted[lone]
    both = np.concatenate([which, lone[astray]])
    order = np.argsort(both, kind="stable")
    return both[order], np.concatenate([rows, taken[astray]])[order]


def bring_onto(projection: Projection, raw: Floats, roofs: Roofs, rows: Floats, noise: Floats) -> Projection:
    """Return the projection with the vertices of roofs (k,) on the plane under them.

    `raw` (k, 3) are these before, `rows` what is known of their roofs, `noise` (k,) m one sigma of a point there. Where
    the smooth fit is better known and agrees with the roof, a side that is known farther, it stays.
    """
    place = raw - rows[:, OVER, None] * rows[:, ACTIVE]
    sigma, smooth = noise * rows[:, UNIT] * np.sqrt(np.maximum(rows[:, CHI2], 1.0)), projection.sigma[roofs.which]
    off = np.linalg.norm(projection.vertices[roofs.which] - place, axis=1)  # sideways too: that one leant over the edge
    taken = ~((smooth <= sigma) & (off < AGREES * np.hypot(smooth, sigma)))
    which, moved = roofs.which[taken], projection.take(np.arange(len(projection.vertices)))
    moved.vertices[which], moved.normals[which], moved.sigma[which] = place[taken], roofs.own[taken], sigma[taken]
    moved.scatter[which], moved.n_support[which] = noise[taken], rows[taken, SUPPORT]
    moved.unit[which], moved.is_fitted[which] = rows[taken, UNIT], True
    return moved


def near_edges(normals: Floats, faces: Ints, turn: float) -> Bools:
    """Return which vertices (n,) have faces around whose corners' normals `turn` (rad), or lie near such faces."""
    out = np.zeros(len(normals), bool)
    near = least_cosines(normals, faces) < np.cos(turn)
    for _ in range(N_RINGS + 1):
        out[faces[near]] = True
        near = any_corner(out, faces)
    return out


def has_company(which: Ints, faces: Ints, n_vertices: int) -> Bools:
    """Return which of the vertices (k,) share a face with two others of them: an edge is long, chance stands alone."""
    is_one, out = np.zeros((2, n_vertices), bool)
    is_one[which] = True
    out[faces[is_one[faces].all(axis=1)]] = True
    found: Bools = out[which]
    return found


def climb_roofs(vertices: Floats, normals: Floats, samples: Samples, noise: Floats) -> Floats:
    """Return the row (k, `N_VALUES`) of the widest roof that holds at each vertex (k, 3); NaN where none does.

    The climb ends where a roof leaves more than noise, a side bows, or smooth patches are clearly better all around;
    and where windows wider than a look show none all around, nor enough that look like one: that look was noise.
    """
    best = np.full((len(vertices), N_VALUES), np.nan, np.float32)
    climbing = np.arange(len(vertices))
    if not len(climbing):
        return best
    pool = cKDTree(vertices).query(vertices, k=[*range(1, min(N_POOLED, len(vertices)) + 1)], workers=2)[1]
    for rung, radius in enumerate(samples.radii[samples.radii <= WIDEST * samples.radii[0]]):
        rows = fit_at(vertices, normals, climbing, samples, rung, noise)
        gains = central_gains(rows, radius)
        together, share = mean_of_pool(gains, pool), mean_of_pool(np.isfinite(gains).astype(float), pool)
        with np.errstate(invalid="ignore"):
            bad = (rows[:, CHI2] > NOISE_MARGIN + BEYOND_NOISE * rows[:, CHANCE]) | (rows[:, BOW] > BOWED)
            alone = (rows[:, GAIN] > ALONE) & (rows[:, TURN] < COS_LEAST)
            in_common = (
                (rows[:, GAIN] > AGAINST) & (together > TOGETHER) & (share > LEAST_ALIKE) & (rows[:, TURN] < COS_CLEAR)
            )
            takes = ~bad & (rows[:, BOW] < DOUBT) & (alone | in_common) & is_seen(rows)
            goes_on = ~bad[climbing] & ~(together[climbing] < ENDED)
        best[takes] = rows[takes]
        if rung > LOOK:
            taken = mean_of_pool(np.isfinite(best[:, UNIT]).astype(float), pool)
            goes_on &= ((taken > 0.0) | (share > LEAST_ALIKE))[climbing]
        climbing = climbing[goes_on]
        if not len(climbing):
            break
    return best


def is_seen(rows: Floats) -> Bools:
    """Return where (k,) the normals of the points turn as both planes do.

    Noise about the rim of one sheet, or about a bend, fills the ends of two planes as well.
    """
    seen, turn = (np.arccos(np.clip(rows[:, j], -1.0, 1.0)) for j in (SEEN, TURN))
    turns: Bools = seen > LEAST_SEEN * turn
    return turns


def at_clear_turns(vertices: Floats, normals: Floats, samples: Samples, noise: Floats) -> Ints:
    """Return the vertices near places where two planes in a narrow window turn clearly: few where all is smooth.

    Looked for at one vertex of a few: an edge passes by several of them.
    """
    probes = np.arange(0, len(vertices), VERTICES_PER_LOOK)
    if not len(probes):
        return probes
    rows = fit_at(vertices, normals, probes, samples, min(LOOK, len(samples.radii) - 1), noise)[probes]
    with np.errstate(invalid="ignore"):
        is_clear = (rows[:, TURN] < COS_CLEAR) & (rows[:, GAIN] > SMOOTHER) & (rows[:, BOW] < BOWED)
    nearest = cKDTree(vertices[probes]).query(vertices, k=[*range(1, min(N_LOOKS, len(probes)) + 1)], workers=2)[1]
    return np.flatnonzero(is_clear[nearest].any(axis=1))


def fit_at(vertices: Floats, normals: Floats, which: Ints, samples: Samples, rung: int, noise: Floats) -> Floats:
    """Return the rows (k, `N_VALUES`) of two planes within the radius of a rung, at the vertices `which`; else NaN.

    Of single points: groups at an edge may hold both sides, and which points they hold depends on their errors.
    """
    rows, radius = np.full((len(vertices), N_VALUES), np.nan, np.float32), float(samples.radii[rung])
    sites, level = block_sites(vertices, normals, which, radius), samples.levels[0]
    run_tasks(_fit_all, len(sites.starts) - 1, sites, level, (radius, WIDTH * samples.radii[0]), noise, rows)
    return rows


def central_gains(rows: Floats, radius: float) -> Floats:
    """Return what a smooth patch leaves more (k,) where the edge is clear and in the middle of the window; else NaN."""
    with np.errstate(invalid="ignore"):
        counts = (from_crest(rows) < CENTRAL * radius) & (rows[:, BOW] < BOWED) & (rows[:, TURN] < COS_CLEAR)
    return np.where(counts, np.clip(rows[:, GAIN], -CLIPPED_GAIN, CLIPPED_GAIN), np.nan)


def from_crest(rows: Floats) -> Floats:
    """Return how far (k,) [m] the vertices on their roofs are from the edge."""
    away: Floats = np.linalg.norm(rows[:, CREST] + rows[:, OVER, None] * rows[:, ACTIVE], axis=1)
    return away


@jit(nopython=True, cache=True, nogil=True, error_model="numpy")
def _fit_all(first: int, last: int, sites: Sites, level: Level, sizes: Any, noise: Floats, rows: Floats) -> None:
    """Fit two planes at the vertices of the blocks `first` to `last`, for `run_tasks`."""
    radius, _ = sizes
    spans, near = rows_room(radius, block_edge(radius), level.bucket), near_room(ROOM)
    window = window_room(ROOM)
    for block in range(first, last):
        n_near, near = find_near(level, sites, block, radius, spans, near)
        if n_near > len(window.counts):
            window = window_room(2 * n_near)
        for k in range(sites.starts[block], sites.starts[block + 1]):
            i = sites.which[k]
            vertex, normal = sites.vertices[i], sites.normals[i]
            look_for_roof(near.values, n_near, vertex, normal, sizes, noise[i], window, rows[i])
