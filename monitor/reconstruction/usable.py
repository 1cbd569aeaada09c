"""Which points a surface can be made of: a kernel that passes over them once. In: points (n, 3) m. Out: a mask."""

from __future__ import annotations

import numpy as np
from numba import jit

from projects.model import Bools, Floats

SHORTEST_NORMAL = 0.5  # a normal is a unit vector, or none


@jit(nopython=True, cache=True, nogil=True)
def mark_usable(points: Floats, normals: Floats) -> Bools:
    """Which points (n,) have finite coordinates and a finite normal."""
    out = np.empty(len(points), np.bool_)
    for i in range(len(points)):
        total, length2 = 0.0, 0.0
        for a in range(3):
            total += abs(points[i, a])
            length2 += normals[i, a] * normals[i, a]
        out[i] = np.isfinite(total) and np.isfinite(length2) and np.sqrt(length2) > SHORTEST_NORMAL
    return out
