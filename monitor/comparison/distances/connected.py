"""What hangs together along edges: parts of neighbours of one kind, numbered in the order of their first vertices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import jit

from monitor.comparison.distances.stars import Neighbours
from monitor.union_find import first_of, unite
from projects.model import Ints


def connect_like(kinds: Ints, surfaces: Sequence[Neighbours], links: Sequence[Ints] = ()) -> Ints:
    """Return the connected part (n,) int32 of each vertex: neighbouring or linked vertices of one kind belong together.

    `kinds` (n,) integers of the vertices of all `surfaces`, one surface after the other, below 0 where a vertex belongs
    to nothing (part -1); `links` (e, 2) are pairs of them. Parts are numbered from 0 in the order of their first
    vertices.
    """
    above, first = np.arange(len(kinds), dtype=np.int32), 0
    for neighbours in surfaces:
        _join_neighbours(above, kinds, neighbours, first)
        first += len(neighbours.starts) - 1
    for pairs in links:
        _join_links(above, kinds, pairs)
    return np.asarray(_number_parts(above, kinds))


@jit(nopython=True, cache=True, nogil=True)
def _join(above, kinds, a, b):  # type: ignore[no-untyped-def]
    """Join the parts of two vertices of one kind; `above` leads each vertex towards the first of its part."""
    if kinds[a] == kinds[b]:
        unite(above, a, b)


@jit(nopython=True, cache=True, nogil=True)
def _join_neighbours(above, kinds, neighbours, first):  # type: ignore[no-untyped-def]
    """Join neighbours on a surface whose vertices are numbered from `first` on."""
    for v in range(len(neighbours.starts) - 1):
        if kinds[first + v] >= 0:
            for k in range(neighbours.starts[v], neighbours.starts[v + 1]):
                if neighbours.vertices[k] > v:
                    _join(above, kinds, first + v, first + neighbours.vertices[k])


@jit(nopython=True, cache=True, nogil=True)
def _join_links(above, kinds, pairs):  # type: ignore[no-untyped-def]
    """Join the vertices of each pair (k, 2), where both are of one kind that is not none."""
    for e in range(len(pairs)):
        if kinds[pairs[e, 0]] >= 0:
            _join(above, kinds, pairs[e, 0], pairs[e, 1])


@jit(nopython=True, cache=True, nogil=True)
def _number_parts(above, kinds):  # type: ignore[no-untyped-def]
    """Return the number (n,) of the part of each vertex, in the order of their first; -1 where its kind is none."""
    out, n = np.full(len(above), -1, dtype=np.int32), 0
    for v in range(len(above)):
        if kinds[v] < 0:
            continue
        first = first_of(above, v)
        if first == v:
            out[v] = n
            n += 1
        else:
            out[v] = out[first]
    return out
