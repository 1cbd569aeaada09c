"""What single faces of a mesh are: area, normal, angles, short edges, opposite corners; kernels, one pass each.

In: vertices (n, 3) m, faces (m, 3). Out: arrays over the faces, or over the vertices.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

from projects.model import Bools, Floats, Ints


@jit(nopython=True, cache=True)
def way(vertices: Floats, i: int, j: int) -> Any:
    """The vector from vertex i to vertex j."""
    return (vertices[j, 0] - vertices[i, 0], vertices[j, 1] - vertices[i, 1], vertices[j, 2] - vertices[i, 2])


@jit(nopython=True, cache=True)
def length_of(x: Any) -> float:
    """Length of a vector."""
    length: float = np.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    return length


@jit(nopython=True, cache=True)
def area_vector(vertices: Floats, i: int, j: int, k: int) -> Any:
    """Normal of the triangle of three vertices, as long as twice its area; i, j and k turn left seen from its end."""
    e, g = way(vertices, i, j), way(vertices, i, k)
    return e[1] * g[2] - e[2] * g[1], e[2] * g[0] - e[0] * g[2], e[0] * g[1] - e[1] * g[0]


@jit(nopython=True, cache=True, nogil=True)
def measure_faces(vertices: Floats, faces: Ints) -> Any:
    """Area (m,) and unit normal (m, 3) of each face, zero for a degenerate one."""
    areas, normals = np.empty(len(faces)), np.empty((len(faces), 3))
    for f in range(len(faces)):
        x, y, z = area_vector(vertices, faces[f, 0], faces[f, 1], faces[f, 2])
        length = length_of((x, y, z))
        per = 1.0 / length if length > 0.0 else 1.0
        areas[f] = 0.5 * length
        normals[f, 0], normals[f, 1], normals[f, 2] = per * x, per * y, per * z
    return areas, normals


@jit(nopython=True, cache=True, nogil=True)
def sum_normals_by_angle(vertices: Floats, faces: Ints, areas: Floats, normals: Floats) -> Floats:
    """Unit sums (n, 3) of the normals of the faces around each vertex, by their angles there; zero without faces."""
    out = np.zeros((len(vertices), 3))
    for f in range(len(faces)):
        for k in range(3):
            v = faces[f, k]
            e, g = way(vertices, v, faces[f, (k + 1) % 3]), way(vertices, v, faces[f, (k + 2) % 3])
            angle = np.arctan2(2.0 * areas[f], e[0] * g[0] + e[1] * g[1] + e[2] * g[2])
            for a in range(3):
                out[v, a] += angle * normals[f, a]
    for v in range(len(out)):
        length = length_of(out[v])
        if length > 0.0:
            for a in range(3):
                out[v, a] /= length
    return out


@jit(nopython=True, cache=True, nogil=True)
def find_short_edges(vertices: Floats, faces: Ints, shortest: float) -> Ints:
    """Edges (k, 2) below `shortest` (m), as often as faces have them."""
    found = np.zeros(len(faces), np.uint8)  # bits: edges that are short
    n = 0
    for f in range(len(faces)):
        for k in range(3):
            if length_of(way(vertices, faces[f, k], faces[f, (k + 1) % 3])) < shortest:
                found[f] |= 1 << k
                n += 1
    ends = np.empty((n, 2), np.int64)
    n = 0
    for f in range(len(faces)):
        for k in range(3):
            if found[f] >> k & 1:
                ends[n, 0], ends[n, 1] = faces[f, k], faces[f, (k + 1) % 3]
                n += 1
    return ends


@jit(nopython=True, cache=True, nogil=True)
def mark_flat(vertices: Floats, faces: Ints, shortest: float) -> Bools:
    """Which faces (m,) name a vertex twice or have a height below `shortest` (m)."""
    areas, _ = measure_faces(vertices, faces)
    out = np.empty(len(faces), np.bool_)
    for f in range(len(faces)):
        longest = shortest
        for k in range(3):
            longest = max(longest, length_of(way(vertices, faces[f, k], faces[f, (k + 1) % 3])))
        out[f] = 2.0 * areas[f] <= shortest * longest
    return out


@jit(nopython=True, cache=True, nogil=True)
def least_cosines(directions: Floats, faces: Ints) -> Floats:
    """The least cosine (m,) between the unit directions (n, 3) of two corners of each face."""
    out = np.empty(len(faces))
    for f in range(len(faces)):
        out[f] = 1.0
        for k in range(3):
            i, j, cosine = faces[f, k], faces[f, (k + 1) % 3], 0.0
            for a in range(3):
                cosine += directions[i, a] * directions[j, a]
            out[f] = min(out[f], cosine)
    return out
