"""What the pairs of a registration say of the vertices of its source: which are stable, and with what weight.

In: pairs in the patches of a source. Out: for every vertex or point that the source was made from, used or not.
"""

from __future__ import annotations

import numpy as np

from monitor.registration.patches import PatchGrid
from monitor.registration.sides import Side
from projects.model import Bools, Floats, Ints


def spread_to_vertices(source: Side, grid: PatchGrid, stable_patches: Ints, n_source: int) -> Bools:
    """Return for every point of the source, used or not (then False), whether it lies in a stable patch."""
    is_stable = np.zeros(n_source, dtype=bool)
    is_vertex = source.index >= 0
    is_inside = np.isin(_patches_of(source, grid), stable_patches)
    is_stable[source.index[is_vertex]] = is_inside[is_vertex]
    return is_stable


def spread_weights(source: Side, grid: PatchGrid, numbers: Ints, weights: Floats, n_source: int) -> Floats:
    """Return the share (n_source,) of all weight that each point of the source has, those of a patch alike.

    Parameters
    ----------
    numbers, weights : (k,) the patch of each pair, and its weight in the adjustment [1 / m2], 0 where it is left out.
    n_source : of the points or vertices that the source was made from, used or not (then 0).
    """
    shares = np.zeros(n_source)
    is_vertex = source.index >= 0
    patches, member, n = np.unique(_patches_of(source, grid)[is_vertex], return_inverse=True, return_counts=True)
    place = np.searchsorted(patches, numbers)
    at = np.minimum(place, max(len(patches) - 1, 0))
    is_known = patches[at] == numbers if len(patches) else np.zeros(len(numbers), dtype=bool)
    of_patch = np.bincount(at[is_known], weights[is_known], len(patches))
    shares[source.index[is_vertex]] = (of_patch / n)[member]
    return shares / max(float(shares.sum()), 1e-300)


def _patches_of(source: Side, grid: PatchGrid) -> Ints:
    """Return the number (n,) of the patch of each point of the source."""
    return grid.numbers(source.points, source.own_normals)
