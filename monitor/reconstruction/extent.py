"""Where points lie and which can be used: kernels that pass over them once.

In: points (n, 3) m. Out: their lowest and highest coordinates, or a mask. Numpy takes ten times as long along rows.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

from projects.model import Bools, Floats

SHORTEST_NORMAL = 0.5  # a normal is a unit vector, or none


@jit(nopython=True, cache=True, nogil=True)
def bounds(points: Floats) -> Any:
    """Lowest and highest coordinates (3,) of points (n, 3), infinite where there are none."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(len(points)):
        for a in range(3):
            low[a], high[a] = min(low[a], points[i, a]), max(high[a], points[i, a])
    return low, high


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
