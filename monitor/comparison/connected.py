"""What hangs together along edges: parts of neighbours of one kind, numbered in the order of their first vertices."""

from __future__ import annotations

import numpy as np
from numba import jit

from projects.model import Ints


def connect_like(kinds: Ints, *links: Ints) -> Ints:
    """Return the connected part (n,) int32 of each vertex: linked vertices of one kind belong together.

    `kinds` (n,) integers, below 0 where a vertex belongs to nothing (part -1); `links` (e, 2) pairs of vertices each.
    Parts are numbered from 0 in the order of their first vertices.
    """
    above = np.arange(len(kinds), dtype=np.int32)
    for pairs in links:
        _join(above, kinds, pairs)
    return np.asarray(_number_parts(above, kinds))


@jit(nopython=True, cache=True)
def _first_of(above, v):  # type: ignore[no-untyped-def]
    """Return the first vertex of the part of v, and shorten the way there."""
    while above[v] != v:
        above[v] = above[above[v]]
        v = above[v]
    return v


@jit(nopython=True, cache=True)
def _join(above, kinds, pairs):  # type: ignore[no-untyped-def]
    """Join the parts of linked vertices of one kind; `above` leads each vertex towards the first of its part."""
    for e in range(len(pairs)):
        a, b = pairs[e, 0], pairs[e, 1]
        if kinds[a] >= 0 and kinds[a] == kinds[b]:
            a, b = _first_of(above, a), _first_of(above, b)
            above[max(a, b)] = min(a, b)


@jit(nopython=True, cache=True)
def _number_parts(above, kinds):  # type: ignore[no-untyped-def]
    out, n = np.full(len(above), -1, dtype=np.int32), 0
    for v in range(len(above)):
        if kinds[v] < 0:
            continue
        first = _first_of(above, v)
        if first == v:
            out[v] = n
            n += 1
        else:
            out[v] = out[first]
    return out
