"""What the vertices around each vertex of a mesh have together: sums, and the largest.

In: the neighbours of each vertex and a value of each (n,). Out: as many.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numba import jit

from monitor.comparison.distances.stars import Neighbours
from monitor.threads import run_tasks
from projects.model import Floats, Ints

Number = TypeVar("Number", Ints, Floats)


def sum_around(neighbours: Neighbours, values: Number) -> Number:
    """Return the sum of the values (n,) of each vertex and its neighbours."""
    out = np.empty_like(values)
    run_tasks(_add_neighbours, len(values), neighbours, values, out)
    return out


def largest_around(neighbours: Neighbours, values: Floats) -> Floats:
    """Return the largest of the values (n,) from 0 on of the neighbours of each vertex."""
    out = np.zeros(len(values))
    np.maximum.at(out, np.repeat(np.arange(len(values)), np.diff(neighbours.starts)), values[neighbours.vertices])
    return out


@jit(nopython=True, cache=True, nogil=True)
def _add_neighbours(first, last, neighbours, values, out):  # type: ignore[no-untyped-def]
    """Write what `sum_around` returns of the vertices from `first` to `last`."""
    for v in range(first, last):
        total = values[v]
        for k in range(neighbours.starts[v], neighbours.starts[v + 1]):
            total += values[neighbours.vertices[k]]
        out[v] = total
