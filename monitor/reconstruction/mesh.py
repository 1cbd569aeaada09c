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
    (a, b, c) = (vertices[faces[:, k]] for k in range(3))
    (ex, ey, ez), (fx, fy, fz) = (b - a).T, (c - a).T
    cross = np.column_stack([ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx])
    length = _lengths(cross)
    return 0.5 * length, cross / np.where(length > 0.0, length, 1.0)[:, None]


def _lengths(vectors: Floats) -> Floats:
    """Return the lengths (n,) of vectors (n, 3)."""
    x, y, z = vectors.T
    out: Floats = np.sqrt(x * x + y * y + z * z)
    return out


def vertex_normals(vertices: Floats, faces: Ints) -> Floats:
    """Return angle-weighted unit normals (n, 3) (Baerentzen & Aanaes 2005); zero where a vertex has no face."""
    areas, normals = face_areas_and_normals(vertices, faces)
    corners = [vertices[faces[:, k]] for k in range(3)]
    out = np.zeros_like(vertices, dtype=float)
    for k in range(3):
        e, f = corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]
        angle = np.arctan2(2.0 * areas, np.einsum("ij,ij->i", e, f))
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
    order = np.argsort(key, kind="stable")  # unlike np.unique's, quick on faces that lie in some order
    key = key[order]
    is_new = np.r_[True, key[1:] != key[:-1]][: len(key)]
    edge_of = np.empty(len(key), np.int64)
    edge_of[order] = np.cumsum(is_new) - 1
    return np.column_stack(np.divmod(key[is_new], n)), edge_of, np.bincount(edge_of)


def boundary_vertices(faces: Ints, n_vertices: int) -> Bools:
    """Return which vertices (n,) lie on an edge that has one face only."""
    edges, _, n_faces = edge_table(faces)
    out = np.zeros(n_vertices, bool)
    out[edges[n_faces == 1]] = True
    return out


def short_edges(vertices: Floats, faces: Ints, shortest: float) -> Ints:
    """Return the edges (k, 2) below `shortest` (m), as often as faces have them."""
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    out: Ints = ends[_lengths(vertices[ends[:, 0]] - vertices[ends[:, 1]]) < shortest]
    return out


def is_degenerate(vertices: Floats, faces: Ints, shortest: float) -> Bools:
    """Return which faces (m,) name a vertex twice or have a height below `shortest` (m)."""
    area, _ = face_areas_and_normals(vertices, faces)
    corners = [vertices[faces[:, k]] for k in range(3)]
    longest = np.max([_lengths(corners[k] - corners[k - 1]) for k in range(3)], axis=0, initial=0.0)
    out: Bools = np.asarray(2.0 * area <= shortest * np.maximum(longest, shortest))
    return out


def crumbs(vertices: Floats, faces: Ints, smallest_area: float) -> Bools:
    """Return which faces (m,) belong to a component of less than `smallest_area` (m2); faces hang together by edges."""
    one, other = _paired_halves(edge_table(faces)[1])
    links = coo_matrix((np.ones(len(one)), (one // 3, other // 3)), shape=(len(faces), len(faces)))
    label = connected_components(links, directed=False)[1]
    area = np.bincount(label, face_areas_and_normals(vertices, faces)[0])
    out: Bools = np.asarray(area[label] < smallest_area)
    return out


def bow_ties(faces: Ints) -> Bools:
    """Return which faces (m,) to drop so that the faces around each vertex are one fan and no edge has three faces.

    Of several fans that meet in one vertex only, the largest stays. Dropping may make new ones: call until none is.
    """
    _, edge_of, n_faces = edge_table(faces)
    lost = n_faces[edge_of] > 2
    fan = connected_components(_corner_links(faces, edge_of), directed=False)[1]
    vertex, corners = faces.ravel(), np.bincount(fan)
    vertex_of = np.empty(len(corners), np.int64)
    vertex_of[fan] = vertex
    several = np.flatnonzero((np.bincount(vertex_of, minlength=1) > 1)[vertex])
    order = several[np.lexsort((fan[several], -corners[fan[several]], vertex[several]))]
    first = np.r_[True, vertex[order][1:] != vertex[order][:-1]]
    if len(order):
        keeper = fan[order][first][np.cumsum(first) - 1]
        lost[order[fan[order] != keeper]] = True
    out: Bools = np.asarray(lost.reshape(-1, 3).any(axis=1))
    return out


def compact(n_vertices: int, faces: Ints) -> tuple[Ints, Ints]:
    """Return the vertices in use (k,) and the faces renumbered to them."""
    used = np.zeros(n_vertices, bool)
    used[faces] = True
    return np.flatnonzero(used), (np.cumsum(used) - 1)[faces]


def _paired_halves(edge_of: Ints) -> tuple[Ints, Ints]:
    """Return pairs of half-edges of one edge: of each edge the second with the first, the third with the second."""
    order = np.argsort(edge_of, kind="stable")
    together = edge_of[order][1:] == edge_of[order][:-1]
    return order[1:][together], order[:-1][together]


def _corner_links(faces: Ints, edge_of: Ints) -> coo_matrix:
    """Return the graph of face corners at one vertex whose faces share an edge there."""
    one, other = _paired_halves(edge_of)
    half = np.arange(3 * len(faces))
    end = half - half % 3 + (half + 1) % 3
    vertex = faces.ravel()
    same_way = vertex[one] == vertex[other]
    a = np.r_[one, end[one]]
    b = np.r_[np.where(same_way, other, end[other]), np.where(same_way, end[other], other)]
    return coo_matrix((np.ones(len(a)), (a, b)), shape=(len(half), len(half)))


def weld(vertices: Floats, faces: Ints, shortest: float) -> Ints:
    """Return faces with the ends of every edge below `shortest` (m) made one vertex, without those that vanish."""
    short = short_edges(vertices, faces, shortest)
    n = len(vertices)
    label = connected_components(coo_matrix((np.ones(len(short)), short.T), shape=(n, n)), directed=False)[1]
    first = np.full(label.max(initial=-1) + 1, n)
    np.minimum.at(first, label, np.arange(n))
    welded = first[label][faces] if len(short) else faces
    distinct = (welded != np.roll(welded, 1, axis=1)).all(axis=1)
    return welded[distinct]
