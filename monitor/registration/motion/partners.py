"""The nearest target point of each sample, found once and kept while it must still be the nearest.

In: the target's search tree and the samples' places at poses that differ little. Out: distance and number of the
nearest point, the same as a search anew would give: of k nearest found at one place, the nearest to another place is
known for certain where it is nearer than the k-th can have come.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from monitor.registration.motion.search_tree import SearchTree
from projects.model import Floats, Ints

N_KEPT = 8  # nearest of each sample: twice the time of one, and they serve while it moves by less than a spacing
FARTHER = 1.2  # than asked is looked, so that samples without a partner are known to have none for a while
ROUNDING = 1e-9  # relative, of distances


class Partners:
    """The nearest points of samples (n) that hardly move any more; of one target and one set of samples."""

    def __init__(self, tree: SearchTree, n_samples: int) -> None:
        self._tree = tree
        self._k = min(N_KEPT, tree.n)
        self._near = np.zeros((n_samples, self._k), dtype=np.int64)
        self._places = np.full((n_samples, self._k, 3), np.inf)
        self._from = np.full((n_samples, 3), np.nan)
        self._reach = np.full(n_samples, -np.inf)  # m, within which all points are known

    def find(self, moved: Floats, limit: float) -> tuple[Floats, Ints]:
        """Return distance (n,) [m], inf beyond the `limit` [m], and number (n,) of the nearest point of the target."""
        distance, best, known = _nearest_kept(moved, self._from, self._places, self._reach)
        unknown = np.flatnonzero(~(np.minimum(distance, limit) * (1.0 + ROUNDING) <= known))
        if len(unknown):
            there = moved[unknown]
            self._search(unknown, there, limit)
            distance[unknown], best[unknown], _ = _nearest_kept(
                there, there, self._places[unknown], self._reach[unknown]
            )
        return np.where(distance <= limit, distance, np.inf), self._near[np.arange(len(best)), best]

    def _search(self, rows: Ints, moved: Floats, limit: float) -> None:
        """Keep the nearest points of some samples at their present place."""
        bound = FARTHER * limit
        distance, near = self._tree.query(moved, k=range(1, self._k + 1), distance_upper_bound=bound)
        found = np.isfinite(distance)
        self._near[rows] = np.where(found, near, 0)
        self._places[rows] = np.where(found[:, :, None], self._tree.data[self._near[rows]], np.inf)
        self._from[rows] = moved
        self._reach[rows] = np.minimum(distance[:, -1], bound)


@njit(cache=True, error_model="numpy")
def _nearest_kept(moved: Any, at: Any, places: Any, reach: Any) -> Any:
    """Return distance and place in the row of the nearest point kept of each sample, and within which distance all
    points are known, `reach` less the way from where it was searched `at`."""
    n, k = places.shape[:2]
    distance, best, known = np.empty(n), np.empty(n, dtype=np.int64), np.empty(n)
    for i in range(n):
        x, y, z = moved[i, 0], moved[i, 1], moved[i, 2]
        nearest, which = np.inf, 0
        for j in range(k):
            dx, dy, dz = x - places[i, j, 0], y - places[i, j, 1], z - places[i, j, 2]
            d2 = dx * dx + dy * dy + dz * dz
            if d2 < nearest:
                nearest, which = d2, j
        dx, dy, dz = x - at[i, 0], y - at[i, 1], z - at[i, 2]
        distance[i], best[i] = math.sqrt(nearest), which
        known[i] = reach[i] - math.sqrt(dx * dx + dy * dy + dz * dz)
    return distance, best, known
