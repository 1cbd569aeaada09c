"""Neighbours that look the same way: the two sides of a thin part lie as near as points of one surface.

In: neighbours of points and oriented normals; out: those of them that are not turned away.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange

from projects.model import Floats, Ints

LEAST = 8  # neighbours that a plane needs; where fewer look the same way, the normal is not to be trusted


def same_facing(which: Ints, near: Ints, n: Ints, normals: Floats) -> tuple[Ints, Ints]:
    """Return the neighbours (m, k) of the points `which` that look the same way, in their order, and how many (m,).

    Parameters
    ----------
    near, n : (m, k) and (m,), of which the first n of a row count.
    normals : (p, 3) oriented normals of all points. A neighbour whose normal has a negative product with the point's
        is left out; a point with fewer than `LEAST` others keeps all it has.
    """
    kept, n_kept = near.copy(), np.empty(len(n), dtype=np.int64)
    _compact(which, near, n, normals, kept, n_kept)
    return kept, n_kept


@njit(cache=True, parallel=True, error_model="numpy")
def _compact(which: Any, near: Any, n: Any, normals: Any, kept: Any, n_kept: Any) -> None:
    """Write the neighbours that look the same way to the front of each row, and their number."""
    for row in prange(near.shape[0]):
        i, found = which[row], 0
        for j in range(n[row]):
            q = near[row, j]
            across = normals[i, 0] * normals[q, 0] + normals[i, 1] * normals[q, 1] + normals[i, 2] * normals[q, 2]
            if across >= 0.0:
                kept[row, found] = q
                found += 1
        if found < min(LEAST, n[row]):
            found = n[row]
            for j in range(found):
                kept[row, j] = near[row, j]
        n_kept[row] = found
