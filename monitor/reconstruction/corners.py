"""Corners where three edges of the surface meet: vertices around them on the three planes, one on their point.

In: vertices with the `Roofs` of the edges that run into a corner. Out: the same with the vertices around it on its
planes, the edges between these, and the vertex nearest to where all three meet moved there. A window of two planes near
a corner sees the third one, so that each edge by itself ends a window before it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from monitor.reconstruction.mesh import any_corner, face_areas_and_normals
from monitor.reconstruction.projection import Projection, Samples
from monitor.reconstruction.roofs import WIDEST, Roofs
from monitor.reconstruction.three_planes import (
    Around,
    Corner,
    edges_of,
    fit_corner,
    have_a_point,
    is_of_sheet,
    plane_under,
)
from projects.model import Floats, Ints

FAR = 8.0  # cells: edges are followed as far to a corner
COS_ONE_LINE = float(np.cos(np.radians(20.0)))  # edges that run farther apart meet
COS_SHARED = float(np.cos(np.radians(15.0)))  # planes of two edges that are one
MEET = 0.7  # of a cell: how near two edges pass each other at a corner
FEWEST_VOTES, ALIKE = 3, 1.0  # pairs of edges that say where it is, within so many cells
ROUNDED = 2.5  # standard errors: edges that are rounded by as much have no corner
SHARE = 0.6  # of the window: vertices nearer to the corner are brought onto its planes

APART = 0.35  # of a cell: of edges, none but one vertex is moved nearer to the corner
TIP = 4  # cells: how far that one may come from
LEAST_COSINE = 0.3  # of its faces, then, with the normal of one of their corners
LEAST_TURN = 0.05  # and with that of the face before


class Guesses(NamedTuple):
    """Places (k, 3) m where edges meet, and the unit normals (k, 3, 3) of the three sides."""

    places: Floats
    normals: Floats


def find_corners(
    raw: Floats, projection: Projection, faces: Ints, roofs: Roofs, samples: Samples, noise: Floats, cell: float,
    max_shift: float,
) -> tuple[Projection, Roofs]:  # fmt: skip
    """Return the projection with the vertices around corners on their planes, and the roofs with these.

    Parameters
    ----------
    raw : (n, 3) m, the vertices before, and `max_shift` (m) how far they may go.
    noise : (n,) m, one sigma of a point there.
    cell : m, of the surface.
    """
    guesses = meeting_edges(roofs, cell)
    if not len(guesses.places):
        return projection, roofs
    tree = cKDTree(raw)
    corners = fit_all(guesses, samples, noise[tree.query(guesses.places)[1]], cell)
    if not corners:
        return projection, roofs
    middle = cKDTree(np.array([corner.place for corner in corners]))
    for k, corner in enumerate(corners):
        which = np.sort(np.asarray(tree.query_ball_point(corner.place, SHARE * corner.radius), np.int64))
        which = which[(middle.query(raw[which])[1] == k) & is_of_sheet(projection.normals[which], corner.normals)]
        projection, roofs = bring_onto(raw, projection, roofs, which, corner, cell, max_shift)
    return move_tips(raw, projection, faces, roofs, corners, cell)


def meeting_edges(roofs: Roofs, cell: float) -> Guesses:
    """Return where edges that have a plane in common run into each other, told by enough of them alike."""
    rows = np.flatnonzero(~roofs.is_round)
    _, first = np.unique(np.floor(roofs.crest[rows] / cell).astype(np.int64), axis=0, return_index=True)
    rows = rows[np.sort(first)]  # one of those that see the same piece of an edge
    crest, planes = roofs.crest[rows], np.stack([roofs.own[rows], roofs.other[rows]], axis=1)
    along = np.cross(planes[:, 0], planes[:, 1])
    along /= np.linalg.norm(along, axis=1)[:, None]
    i, j = cKDTree(crest).query_pairs(FAR * cell, output_type="ndarray").T
    cosine = np.einsum("ij,ij->i", along[i], along[j])
    turned = np.abs(cosine) < COS_ONE_LINE
    i, j, cosine = i[turned], j[turned], cosine[turned]
    on_i, on_j = (np.einsum("ij,ij->i", crest[j] - crest[i], along[k]) for k in (i, j))
    ahead, back = (on_i - cosine * on_j) / (1.0 - cosine**2), (cosine * on_i - on_j) / (1.0 - cosine**2)
    one, other = crest[i] + ahead[:, None] * along[i], crest[j] + back[:, None] * along[j]
    alike = np.einsum("iaj,ibj->iab", planes[i], planes[j]).reshape(-1, 4)
    of_i, of_j = np.divmod(alike.argmax(axis=1), 2)
    normals = np.stack([planes[i, of_i] + planes[j, of_j], planes[i, 1 - of_i], planes[j, 1 - of_j]], axis=1)
    normals /= np.linalg.norm(normals, axis=2)[:, :, None]
    good = (np.linalg.norm(one - other, axis=1) < MEET * cell) & (np.maximum(abs(ahead), abs(back)) < FAR * cell)
    good &= (alike.max(axis=1, initial=-1.0) > COS_SHARED) & have_a_point(normals)
    return agreeing(Guesses(0.5 * (one + other)[good], normals[good]), ALIKE * cell)


def agreeing(guesses: Guesses, near: float) -> Guesses:
    """Return of places within `near` (m) of each other the median, where enough are, with the normals nearest to it."""
    n = len(guesses.places)
    i, j = cKDTree(guesses.places).query_pairs(near, output_type="ndarray").T
    group = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)[1]
    places: list[Floats] = [np.empty((0, 3))]
    normals: list[Floats] = [np.empty((0, 3, 3))]
    for which in (np.flatnonzero(group == g) for g in range(group.max(initial=-1) + 1)):
        if len(which) >= FEWEST_VOTES:
            middle = np.median(guesses.places[which], axis=0)
            nearest = which[np.linalg.norm(guesses.places[which] - middle, axis=1).argmin()]
            places.append(middle[None])
            normals.append(guesses.normals[nearest][None])
    return Guesses(np.concatenate(places), np.concatenate(normals))


def fit_all(guesses: Guesses, samples: Samples, noise: Floats, cell: float) -> list[Corner]:
    """Return the corners that hold, each once, by the noise (k,) m at the guesses."""
    tree = cKDTree(samples.levels[0].places)
    corners: list[Corner] = []
    for place, normals, sigma in zip(*guesses, noise, strict=True):
        corner = widest_fit(place, normals, float(sigma), tree, samples, cell)
        if corner is not None and all(np.linalg.norm(corner.place - c.place) > cell for c in corners):
            corners.append(corner)
    return corners


def widest_fit(
    place: Floats, normals: Floats, noise: float, tree: cKDTree, samples: Samples, cell: float
) -> Corner | None:
    """Return the corner of the widest window in a row that holds; None where one shows that its edges are rounded."""
    points, corner = samples.levels[0], None
    for radius in samples.radii[samples.radii <= WIDEST * samples.radii[0]]:
        near = np.asarray(tree.query_ball_point(place, radius), np.int64)
        near = near[is_of_sheet(points.normals[near], normals)]
        weights = 1.0 - np.sum((points.places[near] - place) ** 2, axis=1) / radius**2
        wider = fit_corner(place, normals, Around(points.places[near], weights, noise), radius, cell)
        if wider is None and corner is not None:
            return corner
        if wider is not None and wider.rounding > ROUNDED:
            return None
        corner = wider
    return corner


def bring_onto(
    raw: Floats, projection: Projection, roofs: Roofs, which: Ints, corner: Corner, cell: float, max_shift: float
) -> tuple[Projection, Roofs]:
    """Return projection and roofs with the vertices `which` (k,) on the planes of a corner."""
    heights = (raw[which] - corner.place) @ corner.normals.T
    under = plane_under(heights, corner.shape)
    over = np.take_along_axis(heights, under[:, None], axis=1)[:, 0]
    place = raw[which] - over[:, None] * corner.normals[under]
    sigma = sigma_on(corner, place, under)
    taken = np.abs(over) <= max_shift
    which, under, place, sigma = which[taken], under[taken], place[taken], sigma[taken]
    moved = projection.take(np.arange(len(projection.vertices)))
    moved.vertices[which], moved.normals[which], moved.sigma[which] = place, corner.normals[under], sigma
    moved.n_support[which], moved.is_fitted[which] = corner.support[under], True
    scatter = moved.scatter[which]
    moved.unit[which] = np.divide(sigma, scatter, out=np.full(len(which), np.nan), where=scatter > 0.0)
    return moved, with_edges(roofs, which, place, under, corner, cell)


def sigma_on(corner: Corner, places: Floats, under: Ints) -> Floats:
    """Return the standard error (k,) m of the planes `under` (k,) places (k, 3) on them."""
    across = np.einsum("ij,ikj->ik", places - corner.place, corner.frames[under])
    rows = np.column_stack([np.ones(len(places)), across])
    return np.sqrt(np.einsum("ij,ijk,ik->i", rows, corner.errors[under], rows))


def with_edges(roofs: Roofs, which: Ints, places: Floats, under: Ints, corner: Corner, cell: float) -> Roofs:
    """Return the roofs with those of the vertices `which` (k,) on the planes `under` them, and the nearest edge."""
    crest, other = np.full(places.shape, np.inf), np.zeros(places.shape)
    for (a, b), way in edges_of(corner).items():
        ahead = np.maximum((places - corner.place) @ way, APART * cell)
        foot = corner.place + ahead[:, None] * way
        nearer = (under == a) & (np.linalg.norm(places - foot, axis=1) < np.linalg.norm(places - crest, axis=1))
        crest[nearer], other[nearer] = foot[nearer], corner.normals[b]
    kept = ~np.isin(roofs.which, which)
    hidden = np.median(roofs.hidden[np.linalg.norm(roofs.crest - corner.place, axis=1) < FAR * cell])
    new = Roofs(which, corner.normals[under], other, crest, np.zeros(len(which), bool), np.full(len(which), hidden))
    order = np.argsort(np.concatenate([roofs.which[kept], which]), kind="stable")
    return Roofs._make(np.concatenate([old[kept], add])[order] for old, add in zip(roofs, new, strict=True))


def move_tips(
    raw: Floats, projection: Projection, faces: Ints, roofs: Roofs, corners: list[Corner], cell: float
) -> tuple[Projection, Roofs]:  # fmt: skip
    """Return projection and roofs with one vertex on each corner: the nearest one whose faces do not turn over so.

    It looks as the mean of the three planes does.
    """
    places = projection.vertices[roofs.which]
    tree = cKDTree(places)
    near = [np.asarray(tree.query_ball_point(corner.place, TIP * cell), np.int64) for corner in corners]
    is_near = np.zeros(len(projection.vertices), bool)
    is_near[roofs.which[np.concatenate(near)]] = True
    stars = faces[any_corner(is_near, faces)]
    moved, crest, other = projection.take(np.arange(len(projection.vertices))), roofs.crest.copy(), roofs.other.copy()
    for corner, rows in zip(corners, near, strict=True):
        for row in rows[np.argsort(np.linalg.norm(places[rows] - corner.place, axis=1), kind="stable")]:
            vertex = roofs.which[row]
            if stays_whole(raw, moved, stars[(stars == vertex).any(axis=1)], vertex, corner.place):
                up = corner.normals.sum(axis=0) / np.linalg.norm(corner.normals.sum(axis=0))
                crest[row], other[row] = corner.place, mirrored(roofs.own[row], up)
                moved.vertices[vertex] = corner.place
                moved.sigma[vertex] = np.sqrt(2.0) * (roofs.own[row] @ up) * sigma_of_point(corner, up)  # see `snap`
                break
    return moved, roofs._replace(crest=crest, other=other)


def stays_whole(raw: Floats, projection: Projection, star: Ints, vertex: int, place: Floats) -> bool:
    """Whether the faces (m, 3) around a vertex look as one of their corners does, moved to a place (3,).

    None may turn over against the `raw` mesh either.
    """
    ends = projection.vertices[star]
    ends[star == vertex] = place
    normals = face_areas_and_normals(ends.reshape(-1, 3), np.arange(star.size).reshape(-1, 3))[1]
    alike = np.einsum("ij,ikj->ik", normals, projection.normals[star]).max(axis=1)
    before = face_areas_and_normals(raw, star)[1]
    turned = np.einsum("ij,ij->i", before, normals)
    return bool(len(star) and (alike > LEAST_COSINE).all() and (turned > LEAST_TURN).all())


def mirrored(normal: Floats, up: Floats) -> Floats:
    """Return a unit normal (3,) on the other side of `up` (3,), which is the mean of both."""
    out: Floats = 2.0 * (normal @ up) * up - normal
    return out


def sigma_of_point(corner: Corner, up: Floats) -> float:
    """Return the standard error (m) along `up` (3,) of where the three planes meet."""
    shares = np.linalg.solve(corner.normals.T, up)
    return float(np.sqrt(np.sum(shares**2 * corner.errors[:, 0, 0])))
