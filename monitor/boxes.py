"""The box that points lie in, by a kernel that passes over them once (numpy takes ten times as long along rows), its
middle and its corners."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

from projects.model import Floats, Ints


@jit(nopython=True, cache=True, nogil=True)
def box_of(points: Floats) -> Any:
    """Return the low and the high corner (3,) of the box of points (n, 3); NaN are left out; infinite without any."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(len(points)):
        for a in range(3):
            low[a], high[a] = min(low[a], points[i, a]), max(high[a], points[i, a])
    return low, high


@jit(nopython=True, cache=True, nogil=True)
def box_of_some(points: Floats, which: Ints) -> Any:
    """Return the box of the points `which` (k,) of (n, 3), as `box_of` does."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in which:
        for a in range(3):
            low[a], high[a] = min(low[a], points[i, a]), max(high[a], points[i, a])
    return low, high


def middle_of(points: Floats) -> Floats:
    """Return the middle (3,) of the box of points (n, 3)."""
    low, high = box_of(points)
    return np.asarray(0.5 * (low + high))


def corners_of(box: Floats) -> Floats:
    """Return the corners (8, 3) of a box, its low and high corner (2, 3)."""
    return np.stack(np.meshgrid(*box.T, indexing="ij"), axis=-1).reshape(8, 3)
