"""Vertices whose change none around them shows: each found its foot on another sheet than all of its neighbours.

In: a side. Out: the side without them. Where surfaces fold, as in the throat of an urn, the sheet that lies next to a
single vertex may look another way than its normal does, and one far behind the same way. So deep a change of one vertex
would stand as a region with the little that changed about it by chance.
"""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.comparison.distances.side import Side, unstated_noise
from monitor.threads import run_tasks
from projects.model import NotAssessed

SURE = 4.0  # sigmas by which a step must exceed the way between two vertices
FEWEST = 2  # neighbours from which a step surely parts a vertex


def drop_lone(side: Side) -> Side:
    """Return the side without the vertices that a step parts from each of those around them, from `FEWEST` surely:
    their feet lie on another sheet (`NotAssessed.SHEET_BETWEEN`).

    Along a surface the distance to another one grows by no more than the way that is gone. Where it grows by more there
    is a step, and of a vertex beside one some neighbour lies on its own side.
    """
    is_lone = np.zeros(len(side.areas), dtype=np.bool_)
    sigmas = side.sigma_surfaces, side.sigma_discord
    run_tasks(_mark_lone, len(is_lone), side.surface.vertices, side.distances, sigmas, unstated_noise(side),
              side.neighbours, is_lone)  # fmt: skip
    return side.without(is_lone, NotAssessed.SHEET_BETWEEN) if is_lone.any() else side


@jit(nopython=True, cache=True, nogil=True)
def _mark_lone(first, last, points, changes, sigmas, unstated, neighbours, out):  # type: ignore[no-untyped-def]
    """Write which of the vertices from `first` to `last` have a step to every neighbour that is assessed."""
    for v in range(first, last):
        n_sure, is_lone = 0, np.isfinite(changes[v])
        for k in range(neighbours.starts[v], neighbours.starts[v + 1]):
            u, length2, sigma2 = neighbours.vertices[k], 0.0, 2.0 * unstated**2
            if not is_lone:
                break
            if not np.isfinite(changes[u]):
                continue
            for c in range(3):
                length2 += (points[u, c] - points[v, c]) ** 2
            for sigma in sigmas:
                sigma2 += sigma[u] ** 2 + sigma[v] ** 2
            step = abs(changes[u] - changes[v]) - np.sqrt(length2)
            is_lone = step > 0.0
            n_sure += step > SURE * np.sqrt(sigma2)
        out[v] = is_lone and n_sure >= FEWEST
