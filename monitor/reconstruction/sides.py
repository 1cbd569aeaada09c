"""Beside edges, smooth fits to the points of a vertex's own side.

In: vertices on smooth fits, the edges that roofs of two planes have told (`Roofs`), the samples. Out: the same with the
vertices fitted again whose fits reach over an edge. A smooth fit that takes in points beyond one is bent by them, far
less than its scatter tells: their share is small, and they all lie on one side.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from monitor.reconstruction.gathering import AWAY, NO_CUT, NO_CUTS, OVER_THE_RIM
from monitor.reconstruction.projection import Projection, Reach, Samples, project_vertices, sum_up_samples
from monitor.reconstruction.reach import Ladder, Stated, choose_reach
from monitor.reconstruction.roofs import ALONE, Roofs
from monitor.reconstruction.two_planes import carried_over
from projects.model import Bools, Floats, Ints

N_ALIKE = 8  # roofs next to each other that say whether there is an edge, and whether it is a ridge or a fold
N_SEEN = 32  # points of edges near a vertex, one a cell, among which a second edge is looked for
COS_OTHER = 0.5  # between the directions away from two edges that both cut: they are 60 degrees apart at least
N_AT_ONCE = 100_000  # vertices
PASSES = 2.0  # cells: an edge whose nearest known point lies farther along it ends before it is abreast
COS_SHEET = 0.5  # of a vertex's normal with that of its side: else it belongs to another sheet
APART = 2.5  # sigmas, beyond which a smooth fit and one to a vertex's own side contradict each other
TURNED = 1  # rung of the ladder, within whose radius of an edge the normals of points turn with it
LEAST_LEFT = 0.14  # of the square of what a patch is bent by on a roof's edge: what it leaves in the mean square


class Raw(NamedTuple):
    """Vertices (n, 3) m of the raw surface, their unit normals (n, 3), and which are on smooth fits now."""

    vertices: Floats
    normals: Floats
    is_smooth: Bools


class Edges(NamedTuple):
    """Points (k, 3) m of edges, the unit normals (k, 3) of both sides there, and whether they are ridges (k,)."""

    crest: Floats
    own: Floats
    other: Floats
    is_ridge: Bools


class Beside(NamedTuple):
    """Vertices `which` (k,) whose fits reach over an edge, the unit normals (k, 3) of their sides, and the cuts
    (k, 2, 10) along one or two edges (`keep_own_side`)."""

    which: Ints
    normals: Floats
    cuts: Floats


def fit_own_sides(
    raw: Raw, projection: Projection, reach: Reach, roofs: Roofs, gains: Floats,
    measured: tuple[Samples, Ladder, Stated | None], noise: Floats, cell: float, max_shift: float,
) -> Projection:  # fmt: skip
    """Return the projection with the vertices beside edges on fits to the points of their own side.

    Parameters
    ----------
    raw : the vertices before, and `max_shift` (m) how far they may go.
    reach : as the fits were made, which tells which of them reach over an edge.
    gains : (k,) by how much a smooth patch leaves more than each roof, in variances of a point. Where roofs next to
        each other do not gain `ALONE` in the mean they may be relief.
    noise : (n,) m, one sigma of a point there.
    cell : m, of the surface.

    Notes
    -----
    How far fits may reach is decided anew, by these points alone: what lies beyond the edge may have ended a climb.
    What was decided before stands on more evidence, and is taken where the vertex is better known so. Where points
    allow no fit, or those around contradict it, the vertex stays as it is.
    """
    samples, ladder, stated = measured
    edges = clear_edges(raw, roofs, gains, cell)
    beside = find_beside(raw, farthest_used(reach, ladder), edges, noise, cell)
    if not len(beside.which):
        return projection
    samples = turn_to_sides(samples, edges)
    vertices, normals = raw.vertices[beside.which], raw.normals[beside.which]
    is_near = np.isin(beside.which, roofs.which)
    normals[is_near] = beside.normals[is_near]
    anew = choose_reach(vertices, normals, samples, ladder, stated, beside.cuts)
    before, after = (
        project_vertices(vertices, normals, samples, r, max_shift, beside.cuts)
        for r in (reach.take(beside.which), anew)
    )
    fitted = better_known(before, after)
    taken = fitted.is_fitted & ~is_contradicted(fitted, projection.take(beside.which), noise[beside.which])
    out = projection.take(np.arange(len(projection.vertices)))
    for old, new in zip(out, fitted, strict=True):
        old[beside.which[taken]] = new[taken]
    return out


def is_contradicted(own: Projection, smooth: Projection, noise: Floats) -> Bools:
    """Return which fits to the own side of vertices (n,) the smooth ones there contradict: far from each other, where
    the points do not scatter about the smooth one as they would if it were bent by so much. There is no edge then, or
    the fit ends far from its points. `noise` (n,) [m] is one sigma of a point."""
    apart2 = ((own.vertices - smooth.vertices) ** 2).sum(axis=1)
    by_chance2 = APART**2 * (own.sigma**2 + smooth.sigma**2)
    unsure2 = noise**2 * np.sqrt(2.0 / np.maximum(smooth.n_support, 1))
    left2 = np.maximum(smooth.scatter**2 - noise**2, 0.0) + unsure2
    contradicted: Bools = smooth.is_fitted & (apart2 > by_chance2) & (LEAST_LEFT * apart2 > left2)
    return contradicted


def better_known(one: Projection, other: Projection) -> Projection:
    """Return of two projections of the same vertices each the one whose sigma is less."""
    takes_one = one.is_fitted & ~(other.sigma < one.sigma)
    return Projection(
        *(np.where(takes_one.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in zip(one, other, strict=True))
    )


def farthest_used(reach: Reach, ladder: Ladder) -> Floats:
    """Return how far (n,) [m] the points may lie that the fit first tried at each vertex is made to."""
    last = len(ladder.radii) - 1
    rung = np.where(reach.is_flat, reach.flat, reach.curved + reach.is_fourth)
    return OVER_THE_RIM * ladder.radii[np.minimum(rung, last)]


def turn_to_sides(samples: Samples, edges: Edges) -> Samples:
    """Return the samples with the points beside edges looking as their sides do, and grouped so.

    The normals of points turn over an edge, as far as their neighbourhoods reach, and columns along them lean: where
    the edge cuts them they hold points by their errors.
    """
    finest, radius = samples.levels[0], float(samples.radii[min(TURNED, len(samples.radii) - 1)])
    distance, nearest = cKDTree(edges.crest).query(finest.places, distance_upper_bound=radius, workers=2)
    which = np.flatnonzero(np.isfinite(distance))
    crest, own, other, is_ridge = (values[nearest[which]] for values in edges)
    over, over_other = (np.einsum("ij,ij->i", finest.places[which] - crest, side) for side in (own, other))
    sides = np.where((is_ridge == (over_other > over))[:, None], other, own)
    of_sheet = np.einsum("ij,ij->i", sides, finest.normals[which]) > COS_SHEET
    normals = finest.normals.copy()
    normals[which[of_sheet]] = sides[of_sheet]
    return sum_up_samples(finest._replace(normals=normals), samples.radii, samples.noise)


def find_beside(raw: Raw, farthest: Floats, edges: Edges, noise: Floats, cell: float) -> Beside:
    """Return the vertices on smooth fits with an edge nearer than `farthest` (n,) [m], abreast of a known point of it.

    Of those between two edges, as on a step or by a corner, both cut.
    """
    none = Beside(np.empty(0, np.int64), np.empty((0, 3)), NO_CUTS)
    if not len(edges.crest):
        return none
    tree = cKDTree(edges.crest)
    distance, _ = tree.query(raw.vertices, distance_upper_bound=float(farthest.max()), workers=2)
    near = np.flatnonzero((distance < farthest) & raw.is_smooth)
    parts = [
        cut_windows(raw, near[k : k + N_AT_ONCE], farthest, (tree, edges), noise, cell)
        for k in range(0, len(near), N_AT_ONCE)
    ]
    return Beside(*(np.concatenate(values) for values in zip(none, *parts, strict=True)))


def cut_windows(
    raw: Raw, which: Ints, farthest: Floats, known: tuple[cKDTree, Edges], noise: Floats, cell: float
) -> Beside:
    """Return those of the vertices `which` (k,) whose windows one or two edges cut, the nearest first."""
    (tree, edges), bound = known, float(farthest[which].max())
    k = [*range(1, min(N_SEEN, tree.n) + 1)]
    near = tree.query(raw.vertices[which], k=k, distance_upper_bound=bound, workers=2)
    cuts, normals = np.full((len(which), 2, 10), NO_CUT), np.zeros((len(which), 3))
    n_found = np.zeros(len(which), np.int64)
    for distance, edge in zip(*(values.T for values in near), strict=True):
        rows = np.flatnonzero((n_found < 2) & (distance < farthest[which]))
        place, up, sigma = (values[which[rows]] for values in (raw.vertices, raw.normals, noise))
        passes, own, cut = cut_at(place, up, edges, edge[rows], sigma, cell)
        is_second = n_found[rows] == 1
        passes &= ~is_second | (np.einsum("ij,ij->i", cut[:, AWAY], cuts[rows, 0, AWAY]) < COS_OTHER)
        rows, own, cut = rows[passes], own[passes], cut[passes]
        cuts[rows, n_found[rows]] = cut
        normals[rows[~is_second[passes]]] = own[~is_second[passes]]
        n_found[rows] += 1
    found = n_found > 0
    return Beside(which[found], normals[found], cuts[found])


def clear_edges(raw: Raw, roofs: Roofs, gains: Floats, cell: float) -> Edges:
    """Return the edges of roofs that are not round, and gain enough with those next to them to be no relief.

    One point a cell, and a direction: several roofs see the same piece of an edge.
    """
    sharp = np.flatnonzero(~roofs.is_round)
    sharp = sharp[mean_around(gains[sharp], roofs.crest[sharp]) >= ALONE]
    crest, own, other = roofs.crest[sharp], roofs.own[sharp], roofs.other[sharp]
    outside = np.einsum("ij,ij->i", raw.vertices[roofs.which[sharp]] - crest, own - other)  # of a fold less than none
    is_ridge = mean_around(outside, crest) >= 0.0
    piece = np.column_stack([np.floor(crest / cell), own + other > 0.0]).astype(np.int64)
    one = np.sort(np.unique(piece, axis=0, return_index=True)[1])
    return Edges(crest[one], own[one], other[one], is_ridge[one])


def cut_at(
    places: Floats, outward: Floats, edges: Edges, which: Ints, noise: Floats, cell: float
) -> tuple[Bools, Floats, Floats]:
    """Return how each of the edges `which` (k,) cuts the window of a place (k, 3): whether it does, the unit normal of
    the place's side (k, 3), and the cut (k, 10)."""
    crest, own, other = edges.crest[which], edges.own[which], edges.other[which]
    over, across = places - crest, np.where(edges.is_ridge[which], 1.0, -1.0)[:, None] * (own - other)
    is_other = np.einsum("ij,ij->i", across, over) < 0.0
    across[is_other] *= -1.0
    normals = np.where(is_other[:, None], other, own)
    away = across - np.einsum("ij,ij->i", across, normals)[:, None] * normals
    across, away, along = (v / np.linalg.norm(v, axis=1)[:, None] for v in (across, away, np.cross(own, other)))
    cosine = np.einsum("ij,ij->i", own, other)
    carried = carried_over(cosine, noise)
    is_abreast = np.abs(np.einsum("ij,ij->i", along, over)) < PASSES * cell
    is_abreast &= np.einsum("ij,ij->i", outward, normals) > COS_SHEET
    return is_abreast, normals, np.column_stack([crest, away, across, carried])


def mean_around(values: Floats, places: Floats) -> Floats:
    """Return the mean of values (k,) over the nearest places (k, 3) to each."""
    if not len(values):
        return values
    nearest = cKDTree(places).query(places, k=[*range(1, min(N_ALIKE, len(places)) + 1)])[1]
    mean: Floats = values[nearest].mean(axis=1)
    return mean
