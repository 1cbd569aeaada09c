"""Marching cubes on the cells of a band: triangles between the nodes where the field changes sign.

In: the field at lattice nodes, the cells that may hold surface. Out: vertices on lattice edges, each known by its
edge, and triangles counter-clockwise seen from where the field is positive. The table is made here, not copied: on
each face of a cell the negative corners are cut off, a rule that depends on that face only, so that neighbours agree
and the surface is closed; and no triangle's inner edge lies in a face, so that no edge gets more than two triangles.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numba import jit

from projects.model import Floats, Ints

# Edge e runs along axis EDGE_AXIS[e] from corner EDGE_CORNER[e]; corner q is at (q & 1, (q >> 1) & 1, q >> 2).
EDGE_AXIS = np.repeat(np.arange(3), 4)
EDGE_CORNER = np.array([q for axis in range(3) for q in range(8) if not (q >> axis) & 1])
NEAREST_TO_NODE = 0.05  # of an edge: vertices stay off the nodes, so that no triangle degenerates


def _edge_between(p: int, q: int) -> int:
    """Return the number of the edge of a cell between its corners p and q."""
    starts = list(zip(EDGE_CORNER.tolist(), EDGE_AXIS.tolist(), strict=True))
    return starts.index((min(p, q), (p ^ q).bit_length() - 1))


@functools.cache
def _faces() -> tuple[tuple[int, ...], ...]:
    """Return the corners of the six faces, each counter-clockwise seen from outside of the cell."""
    out = []
    for axis in range(3):
        u, v = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
        low = (0, v, u + v, u)
        out += [low, tuple((1 << axis) + q for q in reversed(low))]
    return tuple(out)


def _loops(is_outside: list[bool]) -> list[list[int]]:
    """Return the closed loops of edges that bound the surface in a cell."""
    follows = {}
    for face in _faces():
        signs = [is_outside[q] for q in face]
        for k in range(4):
            if signs[k] and not signs[(k + 1) % 4]:
                end = next(j for j in range(k + 1, k + 5) if not signs[j % 4] and signs[(j + 1) % 4])
                enter = _edge_between(face[k], face[(k + 1) % 4])
                follows[enter] = _edge_between(face[end % 4], face[(end + 1) % 4])
    loops = []
    while follows:
        loop = [min(follows)]
        while loop[-1] in follows:
            loop.append(follows.pop(loop[-1]))
        loops.append(loop[:-1])
    return loops


def _share_a_face(e: int, f: int) -> bool:
    """Return whether one face of a cell holds the edges e and f."""
    ends = [{int(EDGE_CORNER[k]), int(EDGE_CORNER[k]) | (1 << int(EDGE_AXIS[k]))} for k in (e, f)]
    return any(ends[0] | ends[1] <= set(face) for face in _faces())


def _triangulate(loop: list[int]) -> list[tuple[int, int, int]] | None:
    """Return triangles of a loop whose inner edges lie in no face of the cell, None where there are none."""
    if len(loop) == 3:
        return [(loop[0], loop[1], loop[2])]
    for k in range(1, len(loop) - 1):
        parts, left, right = [], loop[: k + 1], loop[k:]
        if (k > 1 and _share_a_face(loop[0], loop[k])) or (k < len(loop) - 2 and _share_a_face(loop[k], loop[-1])):
            continue
        for part in (left, right):
            if len(part) > 2:
                parts.append(_triangulate(part))
        if all(p is not None for p in parts):
            return [(loop[0], loop[k], loop[-1])] + [t for p in parts if p is not None for t in p]
    return None


@functools.cache
def triangle_table() -> Ints:
    """Return (256, 16): edges of up to five triangles per sign pattern (bit q set: corner q outside), -1 at the end."""
    table = np.full((256, 16), -1, np.int8)
    for code in range(256):
        triangles = []
        for loop in _loops([bool(code >> q & 1) for q in range(8)]):
            made = _triangulate(loop)
            assert made is not None, code
            triangles += made
        flat = [e for t in triangles for e in t]
        table[code, : len(flat)] = flat
    return table


@jit(nopython=True, cache=True, nogil=True)
def cell_code(values: Any, index: Any, nodes: Ints, i: int) -> int:
    """Sign pattern of the cell above node i; 0 where a corner is not in the band."""
    code = 0
    for q in range(8):
        x, y, z = nodes[i, 0] + (q & 1), nodes[i, 1] + ((q >> 1) & 1), nodes[i, 2] + (q >> 2)
        if x >= index.shape[0] or y >= index.shape[1] or z >= index.shape[2] or index[x, y, z] < 0:
            return 0
        if values[index[x, y, z]] > 0.0:
            code |= 1 << q
    return code


@jit(nopython=True, cache=True, nogil=True)
def march(values: Any, index: Any, nodes: Ints, is_own: Any, table: Any, axes: Ints, corners: Ints) -> Any:
    """Contour of the cells above own nodes: vertices (k, 3), their node and axis (k, 2), triangles (m, 3).

    Coordinates are in cells of the tile. The vertex of an edge is linear between its two nodes.
    """
    n_triangles = 0
    codes = np.zeros(len(nodes), np.uint8)
    for i in range(len(nodes)):
        if is_own[i]:
            codes[i] = cell_code(values, index, nodes, i)
            k = 0
            while k < 15 and table[codes[i], k] >= 0:
                k += 3
            n_triangles += k // 3
    triangles = np.empty((n_triangles, 3), np.int32)
    vertices, origin = np.empty((3 * n_triangles, 3)), np.empty((3 * n_triangles, 2), np.int32)
    vertex_of = np.full((len(nodes), 3), -1, np.int32)
    n_vertices, t = 0, 0
    for i in range(len(nodes)):
        k = 0
        while k < 15 and table[codes[i], k] >= 0:
            for m in range(3):
                e = table[codes[i], k + m]
                q, axis = corners[e], axes[e]
                low = index[nodes[i, 0] + (q & 1), nodes[i, 1] + ((q >> 1) & 1), nodes[i, 2] + (q >> 2)]
                if vertex_of[low, axis] < 0:
                    x, y, z = nodes[low, 0], nodes[low, 1], nodes[low, 2]
                    high = index[x + (axis == 0), y + (axis == 1), z + (axis == 2)]
                    along = values[low] / (values[low] - values[high])
                    vertices[n_vertices, 0], vertices[n_vertices, 1], vertices[n_vertices, 2] = x, y, z
                    vertices[n_vertices, axis] += min(max(along, NEAREST_TO_NODE), 1.0 - NEAREST_TO_NODE)
                    origin[n_vertices, 0], origin[n_vertices, 1] = low, axis
                    vertex_of[low, axis] = n_vertices
                    n_vertices += 1
                triangles[t, m] = vertex_of[low, axis]
            t += 1
            k += 3
    return vertices[:n_vertices].copy(), origin[:n_vertices].copy(), triangles


def contour_tile(values: Any, index: Any, nodes: Ints, is_own: Any) -> tuple[Floats, Ints, Ints]:
    """Return vertices, their (node, axis) and triangles of one tile; see `march`."""
    vertices, origin, triangles = march(values, index, nodes, is_own, triangle_table(), EDGE_AXIS, EDGE_CORNER)
    return vertices, origin, triangles
