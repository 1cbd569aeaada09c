"""A mean of the change around each vertex, along the surface: what a patch says where one vertex says too little."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from monitor.comparison.side import Side
from projects.model import Floats, Ints

MOST_STEPS = 400


def smooth_distances(side: Side, radius: float) -> Floats:
    """Return the area-weighted mean of the distances around each vertex (n,) [m]; NaN where not assessable.

    The weights fall off like a Gaussian whose disc of equal weight has `radius` [m]: steps of the mean over a vertex
    and its neighbours, as many as take a random walker that far. Not assessable vertices take and give nothing.
    """
    n = len(side.areas)
    weight = np.where(side.is_assessed, side.areas, 0.0)
    edges = side.edges
    walk = _walk_matrix(edges, n)
    length2 = np.sum((side.surface.vertices[edges[:, 0]] - side.surface.vertices[edges[:, 1]]) ** 2, axis=1)
    stride2 = 6.0 / 7.0 * float(np.mean(length2)) if len(edges) else 1.0  # six neighbours and the vertex itself
    n_steps = min(max(round(0.5 * radius**2 / max(stride2, 1e-300)), 1), MOST_STEPS)  # E r^2 = 2 s^2, R^2 = 4 s^2
    mass, total = weight, weight * np.where(side.is_assessed, side.distances, 0.0)
    for _ in range(n_steps):
        mass, total = walk @ mass, walk @ total
    return np.where(side.is_assessed, total / np.maximum(mass, 1e-300), np.nan)


def _walk_matrix(edges: Ints, n: int) -> csr_matrix:
    """Return the symmetric matrix (n, n) of one step: an even share to each neighbour, the rest stays."""
    degree = np.bincount(edges.ravel(), minlength=n)
    share = 1.0 / (1.0 + np.maximum(degree[edges[:, 0]], degree[edges[:, 1]]))
    given = np.bincount(edges.ravel(), np.repeat(share, 2), minlength=n)
    rows = np.concatenate([edges[:, 0], edges[:, 1], np.arange(n)])
    columns = np.concatenate([edges[:, 1], edges[:, 0], np.arange(n)])
    return coo_matrix((np.concatenate([share, share, 1.0 - given]), (rows, columns)), shape=(n, n)).tocsr()
