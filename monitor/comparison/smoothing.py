"""A mean of the change around each vertex, along the surface: what a patch says where one vertex says too little."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from monitor.comparison.side import Side
from projects.model import Floats, Ints

MOST_STEPS = 400


def smooth_distances(side: Side, radius: float, lod95: Floats | None = None) -> Floats:
    """Return the area-weighted mean of the distances around each vertex (n,) [m]; NaN where not assessable.

    The weights fall off like a Gaussian whose disc of equal weight has `radius` [m]: steps of the mean over a vertex
    and its neighbours, as many as take a random walker that far. Not assessable vertices take and give nothing.
    With `lod95` (n,) [m] neighbours whose distances differ by more than noise give each other little: what a steep
    change has lifted is not mixed with what lies beside it, or a region would grow by the radius all around.

    References
    ----------
    Perona and Malik (1990): the conductance exp(-(gradient / K)^2), with the noise for K; taken once, of what was
    measured.
    """
    n = len(side.areas)
    weight = np.where(side.is_assessed, side.areas, 0.0)
    edges = side.edges
    walk = _walk_matrix(edges, n, np.ones(len(edges)) if lod95 is None else _conductance(side, lod95))
    length2 = np.sum((side.surface.vertices[edges[:, 0]] - side.surface.vertices[edges[:, 1]]) ** 2, axis=1)
    stride2 = 6.0 / 7.0 * float(np.mean(length2)) if len(edges) else 1.0  # six neighbours and the vertex itself
    n_steps = min(max(round(0.5 * radius**2 / max(stride2, 1e-300)), 1), MOST_STEPS)  # E r^2 = 2 s^2, R^2 = 4 s^2
    mass, total = weight, weight * np.where(side.is_assessed, side.distances, 0.0)
    for _ in range(n_steps):
        mass, total = walk @ mass, walk @ total
    return np.where(side.is_assessed, total / np.maximum(mass, 1e-300), np.nan)


def _conductance(side: Side, lod95: Floats) -> Floats:
    """Return how much the ends of each edge (e,) give each other, 1 where they agree; 1 beside what is not assessed.

    lod95 is 1.96 sigma of one distance; the difference of two scatters by the root of their squares.
    """
    first, second = side.edges[:, 0], side.edges[:, 1]
    step2 = (side.distances[first] - side.distances[second]) ** 2 / (lod95[first] ** 2 + lod95[second] ** 2)
    return np.where(np.isfinite(step2), np.exp(-np.nan_to_num(step2)), 1.0)


def _walk_matrix(edges: Ints, n: int, conductance: Floats) -> csr_matrix:
    """Return the symmetric matrix (n, n) of one step: a share to each neighbour as its edge leads, the rest stays."""
    degree = np.bincount(edges.ravel(), minlength=n)
    share = conductance / (1.0 + np.maximum(degree[edges[:, 0]], degree[edges[:, 1]]))
    given = np.bincount(edges.ravel(), np.repeat(share, 2), minlength=n)
    rows = np.concatenate([edges[:, 0], edges[:, 1], np.arange(n)])
    columns = np.concatenate([edges[:, 1], edges[:, 0], np.arange(n)])
    return coo_matrix((np.concatenate([share, share, 1.0 - given]), (rows, columns)), shape=(n, n)).tocsr()
