"""The volume between two surface patches whose borders do not quite meet: closed by the smallest surface.

In: two patches of triangles (before, after). Out: the volume that they and a closing surface enclose. Not 2.5-D: they
may overhang, fold, have holes. The closing surface is the 2-chain of least area in the Delaunay complex of the border's
points whose border is that of the patches: a strip where both borders run side by side, a seam over a slit, a cap over
a hole. Dey, Hirani and Krishnamoorthy (2011), Optimal homologous cycles, total unimodularity, and linear programming.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_matrix, csr_matrix, hstack
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import Delaunay, QhullError

from projects.model import Floats, Ints
from projects.triangles import face_areas

MOST_BORDER = 4000  # points of a border that a closing surface is sought for


@dataclass(frozen=True)
class Closing:
    """Triangles (k, 3, 3) [m] that close the gap, how much of each counts (k,), and their corners (k, 3) among the
    border's points."""

    triangles: Floats
    weights: Floats
    corners: Ints


def cone_volume(triangles: Floats, weights: Floats | float = 1.0) -> float:
    """Return the signed volume [m3] of the cones from the origin over triangles (k, 3, 3), outwards positive."""
    cross = np.cross(triangles[:, 1], triangles[:, 2])
    return float(np.sum(weights * np.einsum("ij,ij->i", triangles[:, 0], cross)) / 6.0)


def border_edges(faces: Ints) -> Ints:
    """Return the directed edges (e, 2) of triangles (m, 3) that no other of them runs the other way."""
    edges = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    n = int(edges.max(initial=0)) + 1
    net = coo_matrix((np.ones(len(edges)), edges.T), shape=(n, n)).tocsr()
    left = (net - net.T).tocoo()
    kept = left.data > 0.5
    times = left.data[kept].round().astype(np.int64)
    return np.repeat(np.column_stack([left.row[kept], left.col[kept]]), times, axis=0)


def close_gap(points: Floats, edges: Ints) -> Closing | None:
    """Return the closing surface of least area of a directed border, or None where none can be found.

    `points` (n, 3) [m]; `edges` (e, 2) closed loops of patches. The border of the result runs the other way.
    """
    used, edges = np.unique(edges, return_inverse=True)
    edges = edges.reshape(-1, 2)
    if not len(edges):
        return Closing(np.zeros((0, 3, 3)), np.zeros(0), np.zeros((0, 3), dtype=np.int64))
    if len(used) > MOST_BORDER or len(used) < 4:
        return None if len(used) > 3 else _closing(points[used], np.array([[0, 2, 1]]), np.ones(1), used)
    where = points[used] - points[used].mean(axis=0)
    try:
        simplices = Delaunay(where, qhull_options="QJ Qbb").simplices
    except QhullError:
        return None
    triangles = np.unique(np.sort(np.vstack([simplices[:, k] for k in ([0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3])]),
                                  axis=1), axis=0)  # fmt: skip
    sides = np.unique(np.vstack([triangles[:, [0, 1]], triangles[:, [0, 2]], triangles[:, [1, 2]]]), axis=0)
    fans, edges = _detour(where, edges, sides)
    weights = _least_area(where, triangles, sides, edges)
    if weights is None:
        return None
    kept = np.abs(weights) > 1e-6
    corners = np.vstack([triangles[kept], fans])
    return _closing(points[used], corners, np.concatenate([weights[kept], np.ones(len(fans))]), used)


def _closing(points: Floats, corners: Ints, weights: Floats, used: Ints) -> Closing:
    """Return the closing surface with each triangle turned so that its weight is positive."""
    turned = np.where((weights < 0.0)[:, None], corners[:, [0, 2, 1]], corners)
    return Closing(points[turned], np.abs(weights), used[turned])


def _detour(points: Floats, edges: Ints, sides: Ints) -> tuple[Ints, Ints]:
    """Return fans (k, 3) and the border (e, 2) that is left: each edge that is no Delaunay edge is led along some."""
    n = len(points)
    length = np.linalg.norm(points[sides[:, 0]] - points[sides[:, 1]], axis=1)
    graph = coo_matrix((np.maximum(length, 1e-12), sides.T), shape=(n, n)).tocsr()
    is_side = np.isin(np.sort(edges, axis=1) @ np.array([n, 1]), sides @ np.array([n, 1]))
    fans, left = [np.zeros((0, 3), dtype=np.int64)], [edges[is_side]]
    missing = edges[~is_side]
    if len(missing):
        starts, row = np.unique(missing[:, 0], return_inverse=True)
        _, before = dijkstra(graph, directed=False, indices=starts, return_predecessors=True)
        for (a, b), k in zip(missing, row, strict=True):
            path = [int(b)]
            while path[-1] != a:
                path.append(int(before[k, path[-1]]))
            way = np.array(path[::-1])
            left.append(np.column_stack([way[:-1], way[1:]]))
            fans.append(np.column_stack([np.full(len(way) - 2, a), way[1:-1], way[2:]]))  # its border: way - edge
    return np.vstack(fans), np.vstack(left)


def _least_area(points: Floats, triangles: Ints, sides: Ints, edges: Ints) -> Floats | None:
    """Return how often each triangle (t, 3) counts in the chain of least area whose border is minus `edges`."""
    n = len(points)
    keys = sides @ np.array([n, 1])
    rows = [np.searchsorted(keys, triangles[:, pair] @ np.array([n, 1])) for pair in ([0, 1], [1, 2], [0, 2])]
    t = np.arange(len(triangles))
    border = coo_matrix((np.repeat([1.0, 1.0, -1.0], len(t)), (np.concatenate(rows), np.tile(t, 3))),
                        shape=(len(sides), len(t))).tocsr()  # fmt: skip
    wanted = np.zeros(len(sides))
    rising = np.where(edges[:, 0] < edges[:, 1], 1.0, -1.0)
    np.add.at(wanted, np.searchsorted(keys, np.sort(edges, axis=1) @ np.array([n, 1])), -rising)
    area = face_areas(points[triangles])
    both: csr_matrix = hstack([border, -border]).tocsr()
    scale = max(float(area.mean()), 1e-300)
    found = linprog(np.tile(area / scale, 2) + 1e-9, A_eq=both, b_eq=wanted, bounds=(0.0, None), method="highs")
    return found.x[: len(t)] - found.x[len(t) :] if found.success else None
