"""Edges of a mesh, and what hangs together by them: kernels that pass over the faces once.

In: faces (m, 3). Half-edge 3 f + k runs from corner k of face f to corner k + 1. Out: edges with their half-edges, or
for each face or corner the first one that it hangs together with.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

from monitor.union_find import first_of, unite
from projects.model import Ints

HALF_BITS = np.int64(32)  # of the number of a half-edge: meshes have less than 1.4e9 faces


@jit(nopython=True, cache=True, nogil=True)
def half_edges_by_vertex(faces: Ints, n_vertices: int) -> Any:
    """Half-edges (3 m,) sorted by their lower vertex, of one vertex as they come, and where each vertex's start.

    With each goes its higher vertex, in the bits above `HALF_BITS`.
    """
    starts = np.zeros(n_vertices + 2, np.int64)
    for f in range(len(faces)):
        for k in range(3):
            starts[min(faces[f, k], faces[f, (k + 1) % 3]) + 2] += 1
    for v in range(2, n_vertices + 2):
        starts[v] += starts[v - 1]
    halves = np.empty(3 * len(faces), np.int64)
    for f in range(len(faces)):
        for k in range(3):
            one, other = np.int64(faces[f, k]), np.int64(faces[f, (k + 1) % 3])
            lower, higher = min(one, other), max(one, other)
            halves[starts[lower + 1]] = higher << HALF_BITS | (3 * f + k)
            starts[lower + 1] += 1
    return halves, starts


@jit(nopython=True, cache=True, nogil=True)
def number_edges(faces: Ints, n_vertices: int) -> Any:
    """Edges (e, 2) in order of their lower and then their higher vertex, the edge of each half-edge, faces of each."""
    halves, starts = half_edges_by_vertex(faces, n_vertices)
    edges, n_faces = np.empty((len(halves), 2), np.int64), np.zeros(len(halves), np.int64)
    edge_of = np.empty(len(halves), np.int64)
    n = 0
    for v in range(n_vertices):
        for q in range(starts[v] + 1, starts[v + 1]):  # a few: by insertion, in order of the higher vertex
            half, to = halves[q], q
            while to > starts[v] and halves[to - 1] > half:
                halves[to] = halves[to - 1]
                to -= 1
            halves[to] = half
        for q in range(starts[v], starts[v + 1]):
            high = halves[q] >> HALF_BITS
            if q == starts[v] or high != edges[n - 1, 1]:
                edges[n, 0], edges[n, 1] = v, high
                n += 1
            n_faces[n - 1] += 1
            edge_of[halves[q] & ((1 << HALF_BITS) - 1)] = n - 1
    return edges[:n].copy(), edge_of, n_faces[:n].copy()


@jit(nopython=True, cache=True, nogil=True)
def faces_together(edge_of: Ints, n_edges: int) -> Ints:
    """The first face (m,) that each face hangs together with by edges."""
    parent, last = np.arange(len(edge_of) // 3), np.full(n_edges, -1, np.int64)
    for half in range(len(edge_of)):
        e = edge_of[half]
        if last[e] >= 0:
            unite(parent, last[e], half // 3)
        last[e] = half // 3
    for f in range(len(parent)):
        parent[f] = first_of(parent, f)
    return parent


@jit(nopython=True, cache=True, nogil=True)
def corners_together(faces: Ints, edge_of: Ints, n_edges: int) -> Ints:
    """The first corner (3 m,) that each corner makes one fan with: corners at one vertex whose faces share an edge."""
    parent, last = np.arange(len(edge_of)), np.full(n_edges, -1, np.int64)
    for half in range(len(edge_of)):
        e, f, k = edge_of[half], half // 3, half % 3
        if last[e] >= 0:
            other, end = last[e], 3 * f + (k + 1) % 3
            other_end = other - other % 3 + (other + 1) % 3
            if faces[f, k] != faces[other // 3, other % 3]:
                other, other_end = other_end, other
            unite(parent, half, other)
            unite(parent, end, other_end)
        last[e] = half
    for c in range(len(parent)):
        parent[c] = first_of(parent, c)
    return parent


@jit(nopython=True, cache=True, nogil=True)
def corners_of_several(fan: Ints, vertex: Ints, n_vertices: int) -> Ints:
    """The corners (k,) at vertices with more than one fan, by the fan and the vertex of each corner (3 m,)."""
    n_fans, n = np.zeros(n_vertices, np.int32), 0
    for c in range(len(fan)):
        n_fans[vertex[c]] += fan[c] == c
    for c in range(len(fan)):
        n += n_fans[vertex[c]] > 1
    out, k = np.empty(n, np.int64), 0
    for c in range(len(fan)):
        if n_fans[vertex[c]] > 1:
            out[k] = c
            k += 1
    return out
