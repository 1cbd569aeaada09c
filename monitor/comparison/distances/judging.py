"""What the foot of each vertex says of its change and of what limits it, in one pass over the vertices.

In: the feet of a surface's vertices on the other one and what is stated of both surfaces. Out: change, noise and reason
of each vertex.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import jit

from monitor.comparison.distances.perpendicular import Feet
from monitor.threads import run_tasks
from projects.model import Bools, Floats, Ints, NotAssessed

ASSESSED, FREE_EDGE, TOO_UNCERTAIN, NOT_SEEN = (
    int(r) for r in (NotAssessed.ASSESSED, NotAssessed.FREE_EDGE, NotAssessed.TOO_UNCERTAIN, NotAssessed.NOT_SEEN)
)
NOTHING = np.zeros(0)  # what is not stated: 0 everywhere


class Stated(NamedTuple):  # a named tuple, since kernels take it whole
    """What is stated of the vertices (n,) of a surface: their noise `sigma` and their `discord` [m]; empty: nothing."""

    sigma: Floats
    discord: Floats


class Judged(NamedTuple):  # a named tuple, since kernels take it whole
    """Of each vertex (n,) the change `distances` [m], NaN where `reasons` is not 0; one sigma [m] of both surfaces and
    of what their fits contradict each other by, `discord`; `to_rim` [m], the nearer one of its own and of its foot's;
    the corner of the foot's face nearest to it, -1 without a foot."""

    distances: Floats
    sigma: Floats
    discord: Floats
    to_rim: Floats
    reasons: Ints
    corners: Ints


def judge_vertices(feet: Feet, faces: Ints, stated: tuple[Stated, Stated], bow: Floats, own_rim: Floats,
                   on_nothing: Bools, sign: float, least_to_rim: float) -> Judged:  # fmt: skip
    """Return what the feet say of the vertices (n,).

    Parameters
    ----------
    faces : (m, 3) of the other surface.
    stated : of the surface itself and of the other one.
    bow : (n,) m, how far the other surface lies outside of its face at the foot.
    own_rim : (n,) m to a free edge of the surface itself; empty: it has none.
    on_nothing : (n,) vertices all around which nothing was measured; empty: none.
    sign : +1 or -1, what the perpendicular distance is taken times.
    least_to_rim : m, nearer to a free edge than this nothing is told.
    """
    n = len(feet.faces)
    out = Judged(np.empty(n), np.empty(n), np.empty(n), np.empty(n), feet.reasons.copy(), np.empty(n, dtype=np.int32))
    run_tasks(_judge, n, (feet.faces, feet.weights, feet.distances, feet.to_rim), faces, stated[0], stated[1], bow,
              own_rim, on_nothing, sign, least_to_rim, out)  # fmt: skip
    return out


@jit(nopython=True, cache=True, forceinline=True)
def _value(values, v):  # type: ignore[no-untyped-def]
    """Return the value of vertex v, 0 where none are stated."""
    return values[v] if len(values) > 0 else 0.0


@jit(nopython=True, cache=True, forceinline=True)
def _at_foot(values, faces, f, weights, v):  # type: ignore[no-untyped-def]
    """Return the weighted mean of the values at the corners of face f; NaN without a face, 0 if nothing is stated."""
    if len(values) == 0:
        return 0.0
    if f < 0:
        return np.nan
    ends = weights[v, 0] * values[faces[f, 0]] + weights[v, 2] * values[faces[f, 2]]
    return ends + weights[v, 1] * values[faces[f, 1]]


@jit(nopython=True, cache=True, nogil=True)
def _judge(first, last, feet, faces, own, other, bow, own_rim, on_nothing, sign, least_to_rim, out):  # type: ignore[no-untyped-def]
    """Write the figures of the vertices from `first` to `last`."""
    at, weights, distances, to_rim = feet
    for v in range(first, last):
        f = at[v]
        out.sigma[v] = math.hypot(_value(own.sigma, v), _at_foot(other.sigma, faces, f, weights, v))
        there = _at_foot(other.discord, faces, f, weights, v)
        out.discord[v] = math.hypot(_value(own.discord, v), there if np.isfinite(there) else 0.0)
        mine = own_rim[v] if len(own_rim) > 0 else np.inf
        out.to_rim[v] = mine if np.isnan(to_rim[v]) or mine < to_rim[v] else to_rim[v]
        if out.reasons[v] == ASSESSED and not np.isfinite(out.sigma[v]):
            out.reasons[v] = TOO_UNCERTAIN
        if out.reasons[v] == ASSESSED and out.to_rim[v] < least_to_rim:
            out.reasons[v] = FREE_EDGE
        if len(on_nothing) > 0 and on_nothing[v]:
            out.reasons[v] = NOT_SEEN
        out.distances[v] = sign * (distances[v] - bow[v]) if out.reasons[v] == ASSESSED else np.nan
        k = 1 if weights[v, 1] > weights[v, 0] else 0
        k = 2 if weights[v, 2] > weights[v, k] else k
        out.corners[v] = faces[f, k] if f >= 0 else -1
