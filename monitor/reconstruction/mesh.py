"""Clean meshes: faces dropped without leaving crumbs, slivers, bow ties or doubled edges.

In and out: vertices (n, 3), faces (m, 3). Functions that drop faces return a mask over faces; `compact` then drops
the vertices that no face names.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from projects.model import Bools, Floats, Ints


def face_areas_and_normals(vertices: Floats, faces: Ints) -> tuple[Floats, Floats]:
    """Return areas (m,) m2 and unit normals (m, 3), zero for a degenerate face."""
    corner = vertices[faces]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(cross, axis=1)
    return 0.5 * length, cross / np.where(length > 0.0, length, 1.0)[:, None]


def vertex_normals(vertices: Floats, faces: Ints) -> Floats:
    """Return angle-weighted unit normals (n, 3) (Baerentzen & Aanaes 2005); zero where a vertex has no face."""
    _, normals = face_areas_and_normals(vertices, faces)
    out = np.zeros_like(vertices, dtype=float)
    for k in range(3):
        a, b, c = (vertices[faces[:, (k + j) % 3]] for j in range(3))
        e, f = b - a, c - a
        angle = np.arctan2(np.linalg.norm(np.cross(e, f), axis=1), np.einsum("ij,ij->i", e, f))
        for q in range(3):
            out[:, q] += np.bincount(faces[:, k], angle * normals[:, q], len(vertices))
    length = np.linalg.norm(out, axis=1)
    return out / np.where(length > 0.0, length, 1.0)[:, None]


def edge_table(faces: Ints) -> tuple[Ints, Ints, Ints]:
    """Return the unique undirected edges (e, 2), the edge of each half-edge (3 m,), and how many faces each has (e,).

    Half-edge 3 f + k runs from corner k of face f to corner k + 1.
    """
    start, end = faces.astype(np.int64).ravel(), np.roll(faces, -1, axis=1).astype(np.int64).ravel()
    n = int(faces.max(initial=0)) + 1
    key = np.minimum(start, end) * n + np.maximum(start, end)
    found, edge_of, n_faces = np.unique(key, return_inverse=True, return_counts=True)
    return np.column_stack(np.divmod(found, n)), edge_of.ravel(), n_faces


def boundary_vertices(faces: Ints, n_vertices: int) -> Bools:
    """Return which vertices (n,) lie on an edge that has one face only."""
    edges, _, n_faces = edge_table(faces)
    out = np.zeros(n_vertices, bool)
    out[edges[n_faces == 1]] = True
    return out


def is_degenerate(vertices: Floats, faces: Ints, shortest: float) -> Bools:
    """Return which faces (m,) name a vertex twice or have a height below `shortest` (m)."""
    area, _ = face_areas_and_normals(vertices, faces)
    corner = vertices[faces]
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    out: Bools = np.asarray(2.0 * area <= shortest * np.maximum(longest, shortest))
    return out


def crumbs(vertices: Floats, faces: Ints, smallest_area: float) -> Bools:
    """Return which faces (m,) belong to a component of less than `smallest_area` (m2)."""
    label = connected_components(_face_links(faces), directed=False)[1]
    area = np.bincount(label, face_areas_and_normals(vertices, faces)[0])
    out: Bools = np.asarray(area[label] < smallest_area)
    return out


def bow_ties(faces: Ints) -> Bools:
    """Return which faces (m,) to drop so that the faces around each vertex are one fan and no edge has three faces.

    Of several fans that meet in one vertex only, the largest stays. Dropping may make new ones: call until none is.
    """
    _, edge_of, n_faces = edge_table(faces)
    bad_edge = n_faces[edge_of] > 2
    drop = bad_edge.reshape(-1, 3).any(axis=1)
    fan = connected_components(_corner_links(faces), directed=False)[1]
    size = np.bincount(fan)[fan]
    vertex = faces.ravel()
    order = np.lexsort((fan, -size, vertex))
    first = np.r_[True, vertex[order][1:] != vertex[order][:-1]]
    keeper = fan[order][first][np.cumsum(first) - 1]
    lost = np.zeros(len(vertex), bool)
    lost[order] = fan[order] != keeper
    out: Bools = np.asarray(drop | lost.reshape(-1, 3).any(axis=1))
    return out


def compact(n_vertices: int, faces: Ints) -> tuple[Ints, Ints]:
    """Return the vertices in use (k,) and the faces renumbered to them."""
    used = np.zeros(n_vertices, bool)
    used[faces] = True
    return np.flatnonzero(used), (np.cumsum(used) - 1)[faces]


def _face_links(faces: Ints) -> coo_matrix:
    """Return the graph of faces that share an edge."""
    _, edge_of, _ = edge_table(faces)
    face = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(edge_of, kind="stable")
    together = edge_of[order][1:] == edge_of[order][:-1]
    a, b = face[order][1:][together], face[order][:-1][together]
    return coo_matrix((np.ones(len(a)), (a, b)), shape=(len(faces), len(faces)))


def _corner_links(faces: Ints) -> coo_matrix:
    """Return the graph of face corners at one vertex whose faces share an edge there."""
    _, edge_of, _ = edge_table(faces)
    n = 3 * len(faces)
    half = np.arange(n)
    end = half - half % 3 + (half + 1) % 3
    order = np.argsort(edge_of, kind="stable")
    together = edge_of[order][1:] == edge_of[order][:-1]
    one, other = order[1:][together], order[:-1][together]
    vertex = faces.ravel()
    same_way = vertex[one] == vertex[other]
    a = np.r_[one, end[one]]
    b = np.r_[np.where(same_way, other, end[other]), np.where(same_way, end[other], other)]
    return coo_matrix((np.ones(len(a)), (a, b)), shape=(n, n))


def weld(vertices: Floats, faces: Ints, shortest: float) -> Ints:
    """Return faces with the ends of every edge below `shortest` (m) made one vertex, without those that vanish."""
    edges, _, _ = edge_table(faces)
    short = edges[np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1) < shortest]
    n = len(vertices)
    label = connected_components(coo_matrix((np.ones(len(short)), short.T), shape=(n, n)), directed=False)[1]
    first = np.full(label.max(initial=-1) + 1, n)
    np.minimum.at(first, label, np.arange(n))
    welded = first[label][faces]
    distinct = (welded != np.roll(welded, 1, axis=1)).all(axis=1)
    return welded[distinct]
