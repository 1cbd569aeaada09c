"""The tiles' meshes joined into one: vertices on one lattice edge are one vertex, whichever tile made it.

In: each tile's vertices, their lattice edges and triangles, in files. Out: one mesh, whose order follows the tiles and
not the order in which they were worked on.
"""

from __future__ import annotations

import numpy as np

from monitor.reconstruction.band import Tiles
from monitor.reconstruction.spool import Spool
from projects.model import Bools, Floats, Ints


def stitch(pieces: Spool, tiles: Tiles, counts: Ints) -> tuple[Floats, Ints]:
    """Return vertices (n, 3) and faces (m, 3) of all tiles; `counts` (t, 2) is how many of both each has.

    A vertex on a tile's border keeps the place and the number that the first tile gave it.
    """
    keeper, number = _number_border(pieces, tiles)
    vertices = np.empty((int(counts[:, 0].sum()), 3))
    faces = np.empty((int(counts[:, 1].sum()), 3), np.int32)
    n_vertices = n_faces = n_border = 0
    names = np.full(len(keeper), -1, np.int64)  # of each border edge, once its first tile has come
    for j in range(len(tiles.corners)):
        places, edges, triangles = pieces.get(j, 3)
        on_border = is_on_border(edges, tiles.corners[j], tiles.edge)
        border = number[n_border : n_border + np.count_nonzero(on_border)]
        n_border += len(border)
        name = np.full(len(places), -1, np.int64)
        name[on_border] = names[border]
        is_new = name < 0
        name[is_new] = n_vertices + np.arange(np.count_nonzero(is_new))
        names[border] = name[on_border]
        vertices[n_vertices : n_vertices + np.count_nonzero(is_new)] = places[is_new]
        faces[n_faces : n_faces + len(triangles)] = name[triangles]
        n_vertices += int(np.count_nonzero(is_new))
        n_faces += len(triangles)
    return vertices[:n_vertices], faces


def _number_border(pieces: Spool, tiles: Tiles) -> tuple[Ints, Ints]:
    """Return the distinct lattice edges on borders, and for each tile's border vertices in turn which one it is."""
    found = [np.empty((0, 4), np.int64)]
    for j in range(len(tiles.corners)):
        edges = pieces.get(j, 2)[1]
        found.append(edges[is_on_border(edges, tiles.corners[j], tiles.edge)])
    edges = np.concatenate(found)
    size = edges.max(axis=0, initial=0) + 1
    low = edges.min(axis=0, initial=0)
    span = size - low
    key = (((edges[:, 0] - low[0]) * span[1] + edges[:, 1] - low[1]) * span[2] + edges[:, 2] - low[2]) * 3 + edges[:, 3]
    distinct, number = np.unique(key, return_inverse=True)
    return distinct, number.ravel()


def is_on_border(edges: Ints, corner: Ints, tile: int) -> Bools:
    """Return which lattice edges (k, 4), node and axis, lie in a face of the tile, where other tiles have them too."""
    at_face = (edges[:, :3] == corner) | (edges[:, :3] == corner + tile)
    at_face[np.arange(len(edges)), edges[:, 3]] = False  # an edge that runs across the face has only its end there
    out: Bools = at_face.any(axis=1)
    return out
