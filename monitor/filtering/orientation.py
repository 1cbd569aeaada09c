"""Which way normals point where nobody knows where the scanner stood (Hoppe et al. 1992).

In: points with normals of arbitrary sign; out: the sign of each. Signs are handed on along a spanning tree that
prefers neighbours with parallel normals; each connected part looks outward as a whole: by the divergence theorem the
sum of n'(p - c) is three times the volume of a closed body, and so positive, and it is positive of a cap that bulges.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

from projects.model import Floats, Ints

N_NEIGHBOURS = 8


def consistent_signs(points: Floats, normals: Floats) -> Floats:
    """Return +1 or -1 (n,) that makes neighbouring normals agree and each connected part look outward.

    Parameters
    ----------
    points : (n, 3) m.
    normals : (n, 3) unit vectors of arbitrary sign.
    """
    n_points = len(points)
    k = min(N_NEIGHBOURS, n_points)
    near = cKDTree(points).query(points, k, workers=2)[1].reshape(n_points, k)[:, 1:]
    rows, columns = np.repeat(np.arange(n_points), near.shape[1]), near.ravel()
    agreement = np.abs((normals[rows] * normals[columns]).sum(axis=1, dtype=np.float64))
    graph = coo_array((1.0 + 1e-9 - np.minimum(agreement, 1.0), (rows, columns)), shape=(n_points, n_points)).tocsr()
    tree = minimum_spanning_tree(graph)
    _, part = connected_components(tree, directed=False)
    outward = points - np.median(points, axis=0)
    roots = _outermost(np.linalg.norm(outward, axis=1), part)
    parent = _parents(tree, roots)
    signs = np.where((normals * normals[parent]).sum(axis=1) < 0, -1.0, 1.0)
    signs[roots] = 1.0
    while (parent[parent] != parent).any():  # each turn doubles the length of the way that a sign has come
        signs *= np.where(parent[parent] == parent, 1.0, signs[parent])
        parent = parent[parent]
    is_root = np.zeros(n_points, dtype=bool)
    is_root[roots] = True
    signs = np.where(is_root, signs, signs * signs[parent])
    bulge = np.bincount(part, signs * (normals * outward).sum(axis=1, dtype=np.float64))
    return signs * np.where(bulge < 0.0, -1.0, 1.0)[part]


def _outermost(distance: Floats, part: Ints) -> Ints:
    """Return for each part the point of greatest `distance`."""
    order = np.lexsort((distance, part))
    return order[np.append(np.diff(part[order]) != 0, True)]


def _parents(tree: csr_array, roots: Ints) -> Ints:
    """Return the point (n,) from which each gets its sign; roots are their own."""
    n_points = tree.shape[0]
    links = coo_array((np.ones(len(roots)), (np.full(len(roots), n_points), roots)), shape=(n_points + 1, n_points + 1))
    padded = tree.tocoo()
    whole = coo_array((padded.data, (padded.row, padded.col)), shape=(n_points + 1, n_points + 1)).tocsr() + links
    _, parent = breadth_first_order(whole.tocsr(), n_points, directed=False)
    parent = parent[:n_points]
    parent[roots] = roots
    return parent.astype(np.int64)
