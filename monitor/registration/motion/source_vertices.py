"""What the pairs of a registration say of the vertices of its source: which are stable, and with what weight.

In: pairs in the patches of a source. Out: for every vertex or point that the source was made from, used or not.
"""

from __future__ import annotations

import numpy as np

from monitor.registration.motion.patches import PatchGrid
from monitor.registration.motion.sides import Side
from projects.model import Bools, Floats, Ints


def spread_to_vertices(source: Side, of_source: Ints, stable_patches: Ints, n_source: int) -> Bools:
    """Return for every point of the source, used or not (then False), whether it lies in a stable patch; `of_source`
    are the patches (n,) of its used ones (`patches_of`)."""
    is_stable = np.zeros(n_source, dtype=bool)
    is_vertex = source.index >= 0
    is_stable[source.index[is_vertex]] = np.isin(of_source, stable_patches)[is_vertex]
    return is_stable


def spread_weights(source: Side, of_source: Ints, numbers: Ints, weights: Floats, n_source: int) -> Floats:
    """Return the share (n_source,) that each point of the source has of all weight that falls on its points: what its
    patch has is shared out alike in it, and what lies in patches without any is left out.

    Parameters
    ----------
    of_source : the patches (n,) of the used points of the source (`patches_of`).
    numbers, weights : (k,) the patch of each pair, and its weight in the adjustment [1 / m2], 0 where it is left out.
    n_source : of the points or vertices that the source was made from, used or not (then 0).
    """
    shares = np.zeros(n_source)
    is_vertex = source.index >= 0
    if not is_vertex.any():
        return shares
    patches, member, n = np.unique(of_source[is_vertex], return_inverse=True, return_counts=True)
    at = np.minimum(np.searchsorted(patches, numbers), len(patches) - 1)
    of_patch = np.bincount(at, np.where(patches[at] == numbers, weights, 0.0), len(patches))
    shares[source.index[is_vertex]] = (of_patch / n)[member]
    return shares / max(float(shares.sum()), 1e-300)


def patches_of(source: Side, grid: PatchGrid) -> Ints:
    """Return the number (n,) of the patch of each point of the source."""
    return grid.numbers(source.points, source.own_normals)
