"""Closed meshes made two-manifold: sheets of a surface that touch in an edge or a vertex get vertices of their own.

A contour with one vertex a cell joins sheets that pass through one cell; the surface stays, who shares what changes.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from projects.model import Bools, Floats, Ints


def split_touching_sheets(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return a closed mesh with each edge in exactly two faces and the faces about each vertex in one fan.

    Parameters
    ----------
    vertices : (n, 3) m; faces : (m, 3), counter-clockwise from outside, each edge passed as often one way as the other.

    Returns
    -------
    vertices (k, 3), k >= n, with the same places, and faces (m, 3) in the same order. Where several sheets meet in an
    edge, those that bound the same wedge of material go together; where these are one sheet about both of its ends,
    the edge gets a middle for each of them, and its faces are halved (the other halves come last).
    """
    corner = np.arange(faces.size).reshape(faces.shape)
    at_start, at_end = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    order, first, count, forward = _group_half_edges(faces, len(vertices))
    back, ahead = order[first[count == 2]], order[first[count == 2] + 1]
    pairs = [np.stack([back, ahead])]
    for i, n in zip(first[count > 2], count[count > 2], strict=True):
        pairs.append(_pair_wedges(vertices, faces, order[i : i + n], forward))
    back, ahead = np.concatenate(pairs, axis=1)
    # A half edge backward ends where the one forward begins.
    links = np.concatenate(
        [np.stack([at_end[back], at_start[ahead]]), np.stack([at_start[back], at_end[ahead]])], axis=1
    )
    graph = coo_matrix((np.ones(links.shape[1], dtype=np.int8), (links[0], links[1])), shape=(faces.size, faces.size))
    n_sheets, sheet = connected_components(graph, directed=False)
    if n_sheets == len(vertices) and (count == 2).all():
        return vertices, faces
    place = np.empty(n_sheets, dtype=np.int64)
    place[sheet] = faces.ravel()
    return _halve_doubled_edges(vertices[place], sheet.reshape(faces.shape).astype(faces.dtype))


def _group_half_edges(faces: Ints, n_vertices: int) -> tuple[Ints, Ints, Ints, Bools]:
    """Return half edges sorted by edge, those backward first; where each edge begins, how many it has; if forward."""
    start, end = faces.ravel().astype(np.int64), np.roll(faces, -1, axis=1).ravel().astype(np.int64)
    forward = start < end
    key = np.minimum(start, end) * n_vertices + np.maximum(start, end)
    order = np.lexsort((forward, key))
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    return order, first, np.diff(first, append=len(order)), forward


def _halve_doubled_edges(vertices: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """Return the mesh with each edge of more than two faces halved, by a middle of its own for each pair of faces."""
    while True:
        order, first, count, forward = _group_half_edges(faces, len(vertices))
        if (count <= 2).all():
            return vertices, faces
        taken: set[int] = set()
        middles: list[Floats] = []
        faces, halves = faces.copy(), []
        for i, n in zip(first[count > 2], count[count > 2], strict=True):
            edges = order[i : i + n]
            if not taken.isdisjoint(edges // 3):
                continue  # a face is halved once a pass
            taken.update(edges // 3)
            for pair in _pair_wedges(vertices, faces, edges, forward).T:
                middle = len(vertices) + len(middles)
                for face, k in zip(pair // 3, pair % 3, strict=True):
                    a, b, c = (int(faces[face, (k + j) % 3]) for j in range(3))
                    faces[face], place = (a, middle, c), 0.5 * (vertices[a] + vertices[b])
                    halves.append((middle, b, c))
                middles.append(place)
        vertices = np.concatenate([vertices, middles])
        faces = np.concatenate([faces, np.array(halves, dtype=faces.dtype)])


def _pair_wedges(vertices: Floats, faces: Ints, edges: Ints, forward: Bools) -> Ints:
    """Return (2, n/2) half edges, backward and forward, of the faces about one edge that bound a wedge of material."""
    face, k = edges // 3, edges % 3
    a, b, c = (faces[face, (k + j) % 3] for j in range(3))
    low, high = np.minimum(a[0], b[0]), np.maximum(a[0], b[0])
    axis = vertices[high] - vertices[low]
    axis = axis / max(float(np.linalg.norm(axis)), 1e-300)
    side = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
    off = vertices[c] - vertices[low]
    turn = np.arctan2(off @ np.cross(axis, side), off @ side)
    pairs, free = [], list(edges[~forward[edges]])
    for i in np.flatnonzero(forward[edges]):  # the material lies clockwise of a face that passes the edge forward
        gaps = [(turn[i] - turn[np.flatnonzero(edges == e)[0]]) % (2.0 * np.pi) for e in free]
        pairs.append((free.pop(int(np.argmin(gaps))), edges[i]))
    return np.array(pairs, dtype=np.int64).T
