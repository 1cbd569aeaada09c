"""Clean meshes: faces dropped without leaving crumbs, slivers, bow ties or doubled edges.

In and out: vertices (n, 3), faces (m, 3). Functions that drop faces return a mask over faces; `compact` then drops
the vertices that no face names.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from monitor.reconstruction.edges import corners_of_several, corners_together, faces_together, number_edges
from monitor.reconstruction.faces import find_short_edges, mark_flat, measure_faces, sum_normals_by_angle
from projects.model import Bools, Floats, Ints


def face_areas_and_normals(vertices: Floats, faces: Ints) -> tuple[Floats, Floats]:
    """Return areas (m,) m2 and unit normals (m, 3), zero for a degenerate face."""
    areas, normals = measure_faces(np.ascontiguousarray(vertices, float), np.ascontiguousarray(faces))
    return areas, normals


def normals_by_angle(vertices: Floats, faces: Ints) -> Floats:
    """Return angle-weighted unit normals (n, 3) (Baerentzen & Aanaes 2005); zero where a vertex has no face."""
    vertices, faces = np.ascontiguousarray(vertices, float), np.ascontiguousarray(faces)
    out: Floats = sum_normals_by_angle(vertices, faces, *measure_faces(vertices, faces))
    return out


def edge_table(faces: Ints) -> tuple[Ints, Ints, Ints]:
    """Return the unique undirected edges (e, 2), the edge of each half-edge (3 m,), and how many faces each has (e,).

    Half-edge 3 f + k runs from corner k of face f to corner k + 1.
    """
    edges, edge_of, n_faces = number_edges(np.ascontiguousarray(faces), int(faces.max(initial=-1)) + 1)
    return edges, edge_of, n_faces


def short_edges(vertices: Floats, faces: Ints, shortest: float) -> Ints:
    """Return the edges (k, 2) below `shortest` (m), as often as faces have them."""
    ends: Ints = find_short_edges(np.ascontiguousarray(vertices, float), np.ascontiguousarray(faces), float(shortest))
    return ends


def is_degenerate(vertices: Floats, faces: Ints, shortest: float) -> Bools:
    """Return which faces (m,) name a vertex twice or have a height below `shortest` (m)."""
    out: Bools = mark_flat(np.ascontiguousarray(vertices, float), np.ascontiguousarray(faces), float(shortest))
    return out


def piece_areas(vertices: Floats, faces: Ints) -> Floats:
    """Return of each face (m,) the area (m2) of the component that it belongs to; faces hang together by edges."""
    _, edge_of, n_faces = edge_table(faces)
    label = faces_together(edge_of, len(n_faces))
    out: Floats = np.bincount(label, face_areas_and_normals(vertices, faces)[0])[label]
    return out


def untie(faces: Ints) -> Ints:
    """Return the faces without `bow_ties`, and without those that this makes: around vertices of what was dropped."""
    drop = bow_ties(faces)
    while drop.any():
        lost = np.zeros(int(faces.max()) + 1, bool)
        lost[faces[drop]] = True
        faces = faces.compress(~drop, axis=0)
        around = np.flatnonzero(any_corner(lost, faces))
        drop = np.zeros(len(faces), bool)
        drop[around] = bow_ties(faces[around], lost)
    return faces


def keep_faces(faces: Ints, keep: Bools) -> Ints:
    """Return the faces that are to be kept, of (m, 3); all of them without a copy."""
    return faces if keep.all() else faces.compress(keep, axis=0)


def any_corner(is_so: Bools, faces: Ints) -> Bools:
    """Return which faces (m,) have a corner that is so, of vertices (n,)."""
    a, b, c = (is_so.take(corner) for corner in faces.T)
    out: Bools = a | b | c
    return out


def bow_ties(faces: Ints, at: Bools | None = None) -> Bools:
    """Return which faces (m,) to drop so that the faces around each vertex are one fan and no edge has three faces.

    Of several fans that meet in one vertex only, the largest stays. Dropping may make new ones: see `untie`. Of
    vertices, only those `at` (n,) which all faces are given are looked at; None for all.
    """
    faces = np.ascontiguousarray(faces)
    _, edge_of, n_faces = edge_table(faces)
    lost = (n_faces > 2).take(edge_of)
    fan, vertex = corners_together(faces, edge_of, len(n_faces)), faces.ravel()
    several = corners_of_several(fan, vertex, int(vertex.max(initial=-1)) + 1)
    several = several if at is None else several[at[vertex[several]]]
    if len(several):
        n_corners = np.bincount(fan[several], minlength=len(fan))
        order = several[np.lexsort((fan[several], -n_corners[fan[several]], vertex[several]))]
        first = np.r_[True, vertex[order][1:] != vertex[order][:-1]]
        keeper = fan[order][first][np.cumsum(first) - 1]
        lost[order[fan[order] != keeper]] = True
    out: Bools = lost[0::3] | lost[1::3] | lost[2::3]
    return out


def compact(n_vertices: int, faces: Ints) -> tuple[Ints, Ints]:
    """Return the vertices in use (k,) and the faces renumbered to them."""
    used = np.zeros(n_vertices, bool)
    used[faces] = True
    return np.flatnonzero(used), (np.cumsum(used) - 1).take(faces)


def weld(vertices: Floats, faces: Ints, shortest: float) -> Ints:
    """Return faces with the ends of every edge below `shortest` (m) made one vertex, without those that vanish."""
    short = short_edges(vertices, faces, shortest)
    n = len(vertices)
    if len(short):
        label = connected_components(coo_matrix((np.ones(len(short)), short.T), shape=(n, n)), directed=False)[1]
        first = np.full(label.max(initial=-1) + 1, n)
        np.minimum.at(first, label, np.arange(n))
        faces = first[label][faces]
    a, b, c = faces.T
    return keep_faces(faces, (a != b) & (b != c) & (c != a))
