"""Vertices and edges of the mesh along the edges of the surface, where its two sides meet.

In: a mesh whose vertices lie on either side of an edge, with the `Roofs` that are known there. Out: the same with the
vertices near the line where both planes meet moved onto it, and faces that pass over it split there, so that no face
cuts an edge off or fills a fold.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from monitor.reconstruction.intersections import find_intersections
from monitor.reconstruction.mesh import edge_table, face_areas_and_normals, is_degenerate
from monitor.reconstruction.projection import Projection
from monitor.reconstruction.roofs import Roofs
from projects.model import Bools, Floats, Ints

SNAP = 0.35  # of a cell: vertices nearer to the edge are moved onto it
APART = 0.5  # of a cell: both ends of a split edge agree on where the surface's edge is
FROM_END = 0.1  # of an edge: no vertex is put nearer to its ends
COS_SIDES = float(np.cos(np.radians(10.0)))  # between the normals of two ends that lie on different sides
COS_ALIKE = float(np.cos(np.radians(30.0)))  # of an end's normal with that of its side
LEAST_COSINE = 0.3  # of a new face with the normal of the nearest side that it may belong to
SLIVER = 0.02  # of a cell: no new face is as flat


class Crested(NamedTuple):
    """A projection and faces with vertices along edges, `is_crest` (n,) which these are."""

    projection: Projection
    faces: Ints
    is_crest: Bools


def snap(projection: Projection, faces: Ints, roofs: Roofs, cell: float) -> Projection:
    """Return the projection with the vertices nearest to an edge on it, of no face all three.

    How they look is left to `split_along`.
    """
    off = np.full(len(projection.vertices), np.inf)
    off[roofs.which] = np.linalg.norm(roofs.crest - projection.vertices[roofs.which], axis=1)
    off[roofs.which[roofs.is_round]] = np.inf
    is_near = two_of_each(faces, off, SNAP * cell)
    near = is_near[roofs.which]
    which = roofs.which[near]
    vertices, sigma = projection.vertices.copy(), projection.sigma.copy()
    vertices[which] = roofs.crest[near]
    _, half = between(roofs.own[near], roofs.other[near])
    sigma[which] = np.hypot(sigma[which] / (np.sqrt(2.0) * half), roofs.hidden[near])  # both planes alike
    return projection._replace(vertices=vertices, sigma=sigma)


def two_of_each(faces: Ints, off: Floats, farthest: float) -> Bools:
    """Return which vertices (n,) are `off` (n,) by less than `farthest`, of a face with three the farthest left out."""
    is_near: Bools = off < farthest
    full = faces[is_near[faces].all(axis=1)]
    while len(full):
        is_near[full[np.arange(len(full)), off[full].argmax(axis=1)]] = False
        full = full[is_near[full].all(axis=1)]
    return is_near


def between(one: Floats, other: Floats) -> tuple[Floats, Floats]:
    """Return the unit mean (k, 3) of two unit normals (k, 3), and its cosine (k,) with either."""
    mean = one + other
    length = np.linalg.norm(mean, axis=1)
    return mean / length[:, None], 0.5 * length


def split_along(projection: Projection, faces: Ints, roofs: Roofs, cell: float) -> Crested:
    """Return the mesh with a vertex on each edge of faces that passes over an edge of the surface.

    A split that would turn a face over or push it through another is not made. Vertices on the edge look between both
    sides; one held back on its way there is of one side still, and looks as it did.
    """
    is_crest = np.zeros(len(projection.vertices), bool)
    if not len(roofs.which):
        return Crested(projection, faces, is_crest)
    on = (projection.vertices[roofs.which] == roofs.crest).all(axis=1)
    is_crest[roofs.which] = on
    normals = projection.normals.copy()
    normals[is_crest], _ = between(roofs.own[on], roofs.other[on])
    projection = projection._replace(normals=normals)
    edges, edge_of, _ = edge_table(faces)
    splits = propose(projection, edges, roofs, is_crest, cell)
    while True:
        made = split_faces(projection, faces, is_crest, edges, edge_of, splits)
        bad = spoiled(made, len(projection.vertices), SLIVER * cell)
        if not bad.any():
            return made
        splits = splits.take(~bad)


class Splits(NamedTuple):
    """Edges of the mesh to be split (k,), and the vertex on each: place, normal (k, 3), sigma (k,)."""

    edge: Ints
    place: Floats
    normal: Floats
    sigma: Floats

    def take(self, which: Bools) -> Splits:
        """Return the splits selected."""
        return Splits(self.edge[which], self.place[which], self.normal[which], self.sigma[which])


def propose(projection: Projection, edges: Ints, roofs: Roofs, is_crest: Bools, cell: float) -> Splits:
    """Return where edges of the mesh pass over edges of the surface."""
    row = np.full(len(projection.vertices), -1)
    row[roofs.which] = np.where(roofs.is_round, -1, np.arange(len(roofs.which)))
    i, j = edges.T
    turned = np.einsum("ij,ij->i", projection.normals[i], projection.normals[j])
    which = np.flatnonzero(((row[i] >= 0) | (row[j] >= 0)) & ~is_crest[i] & ~is_crest[j] & (turned < COS_SIDES))
    i, j = i[which], j[which]
    start, end = projection.vertices[i], projection.vertices[j]
    one, other = (crest_between(projection, roofs, row, *ends, cell) for ends in ((i, j), (j, i)))
    one, other = np.where(np.isnan(one), other, one), np.where(np.isnan(other), one, other)
    place, way = 0.5 * (one + other), end - start
    share = np.einsum("ij,ij->i", place - start, way) / np.einsum("ij,ij->i", way, way)
    good = (np.linalg.norm(one - other, axis=1) < APART * cell) & (share > FROM_END) & (share < 1.0 - FROM_END)
    good &= np.linalg.norm(place - 0.5 * (start + end), axis=1) < np.linalg.norm(way, axis=1)
    i, j = i[good], j[good]
    normal, half = between(projection.normals[i], projection.normals[j])
    hidden = roofs.hidden[np.where(row[i] >= 0, row[i], row[j])]
    sigma = np.hypot(np.hypot(projection.sigma[i], projection.sigma[j]) / (2.0 * half), hidden)
    return Splits(which[good], place[good], normal, sigma)


def crest_between(projection: Projection, roofs: Roofs, row: Ints, i: Ints, j: Ints, cell: float) -> Floats:
    """Return where the edges of the roofs of the vertices i pass between them and j (k, 3).

    NaN where i has none, or j is not of its other side: by place and normal.
    """
    out = np.full((len(i), 3), np.nan)
    known = np.flatnonzero(row[i] >= 0)
    rows, i, j = row[i][known], i[known], j[known]
    off, alike, unlike = (
        np.einsum("ij,ij->i", a, b)
        for a, b in (
            (projection.vertices[j] - roofs.crest[rows], roofs.other[rows]),
            (projection.normals[j], roofs.other[rows]),
            (projection.normals[j], roofs.own[rows]),
        )
    )
    good = (np.abs(off) < APART * cell) & (alike > unlike) & (alike > COS_ALIKE)
    middle = 0.5 * (projection.vertices[i] + projection.vertices[j])
    out[known[good]] = nearest_on(roofs, rows[good], middle[good])
    return out


def nearest_on(roofs: Roofs, rows: Ints, places: Floats) -> Floats:
    """Return the points (k, 3) of the edges of the roofs `rows` nearest to `places` (k, 3)."""
    along = np.cross(roofs.own[rows], roofs.other[rows])
    along /= np.linalg.norm(along, axis=1)[:, None]
    ahead = np.einsum("ij,ij->i", places - roofs.crest[rows], along)
    nearest: Floats = roofs.crest[rows] + ahead[:, None] * along
    return nearest


def split_faces(
    projection: Projection, faces: Ints, is_crest: Bools, edges: Ints, edge_of: Ints, splits: Splits
) -> Crested:
    """Return the mesh with the edges split: new vertices behind the others, new faces behind those left."""
    n, k = len(projection.vertices), len(splits.edge)
    vertex = np.full(len(edges), -1)
    vertex[splits.edge] = n + np.arange(k)
    middle = vertex[edge_of].reshape(-1, 3)
    ends = edges[splits.edge]
    with_new = Projection(
        vertices=np.r_[projection.vertices, splits.place],
        normals=np.r_[projection.normals, splits.normal],
        sigma=np.r_[projection.sigma, splits.sigma],
        scatter=np.r_[projection.scatter, projection.scatter[ends].mean(axis=1)],
        n_support=np.r_[projection.n_support, projection.n_support[ends].min(axis=1)],
        is_fitted=np.r_[projection.is_fitted, np.ones(k, bool)],
        unit=np.r_[projection.unit, projection.unit[ends].mean(axis=1)],
    )
    n_split = np.count_nonzero(middle >= 0, axis=1)
    new = [faces[n_split == 0], *(part(with_new.vertices, faces, middle, n_split, m) for m in (1, 2, 3))]
    return Crested(with_new, np.concatenate(new), np.r_[is_crest, np.ones(k, bool)])


def part(vertices: Floats, faces: Ints, middle: Ints, n_split: Ints, m: int) -> Ints:
    """Return the parts of the faces with m split edges, whose new vertices are `middle` (f, 3), -1 for none."""
    which = np.flatnonzero(n_split == m)
    face, mid = faces[which], middle[which]
    first = np.argmax(mid >= 0, axis=1) if m == 1 else np.argmin(mid, axis=1) + 1  # of three any will do
    turn = (first[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(face, turn, axis=1).T
    ab, bc, ca = np.take_along_axis(mid, turn, axis=1).T
    if m == 1:
        triples = [(a, ab, c), (ab, b, c)]
    elif m == 2:
        ways = vertices[a] - vertices[bc], vertices[ab] - vertices[c]
        crosses = np.linalg.norm(ways[0], axis=1) < np.linalg.norm(ways[1], axis=1)
        triples = [(ab, b, bc), (a, ab, np.where(crosses, bc, c)), (np.where(crosses, a, ab), bc, c)]
    else:
        triples = [(a, ab, ca), (ab, b, bc), (bc, c, ca), (ab, bc, ca)]
    return np.concatenate([np.column_stack(triple) for triple in triples])


def spoiled(made: Crested, n_old: int, shortest: float) -> Bools:
    """Return which splits (k,) belong to a face that is turned over, is as flat as `shortest` (m) or meets another.

    New vertices are those from the `n_old`th on.
    """
    faces, vertices = made.faces, made.projection.vertices
    new = faces.max(axis=1) >= n_old
    _, normals = face_areas_and_normals(vertices, faces[new])
    nearest_side = np.einsum("ij,ikj->ik", normals, made.projection.normals[faces[new]]).max(axis=1)
    bad = np.zeros(len(faces), bool)
    bad[new] = (nearest_side < LEAST_COSINE) | is_degenerate(vertices, faces[new], shortest)
    bad[find_intersections(vertices, faces, new).ravel()] = True
    hit = np.zeros(len(vertices), bool)
    hit[faces[bad]] = True
    out: Bools = hit[n_old:]
    return out
