"""Vertices whose faces lie around them like the cells of a map: no two of these faces meet but in what they share.

In: vertices (n, 3), faces (m, 3). Out: which vertices. Seen along the sum of the normals of the faces around a vertex,
each face is a wedge. Where all wedges are turned one way, their sides are paired, and the wedges go round once, they
cover the plane once: so do the faces. Nearly all vertices of a mesh are such, and each settles all pairs around it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

from monitor.threads import run_tasks
from projects.model import Bools, Floats, Ints

MOST_FACES = 16  # around a vertex; more, and it is not looked at
LEAST_COSINE2 = 1e-4  # squared, of a face's normal with their sum: clear of rounding
LEAST_SINE2 = 1e-12  # squared, of a face's angle at the vertex


def find_fans(vertices: Floats, faces: Ints) -> Bools:
    """Return which vertices (n,) are such; those at a free edge are not."""
    corners, starts = corners_by_vertex(faces, len(vertices))
    out = np.empty(len(vertices), np.bool_)
    run_tasks(_mark_fans, len(vertices), vertices, faces, corners, starts, out)
    return out


@jit(nopython=True, cache=True, nogil=True)
def corners_by_vertex(faces: Ints, n_vertices: int) -> Any:
    """Corners 3 f + k (3 m,) sorted by their vertex, and where those of each vertex start (n + 2,)."""
    starts = np.zeros(n_vertices + 2, np.int64)
    for f in range(len(faces)):
        for k in range(3):
            starts[faces[f, k] + 2] += 1
    for v in range(2, n_vertices + 2):
        starts[v] += starts[v - 1]
    corners = np.empty(3 * len(faces), np.int64)
    for f in range(len(faces)):
        for k in range(3):
            v = faces[f, k]
            corners[starts[v + 1]] = 3 * f + k
            starts[v + 1] += 1
    return corners, starts


@jit(nopython=True, cache=True, nogil=True)
def _mark_fans(first: int, last: int, vertices: Floats, faces: Ints, corners: Ints, starts: Ints, out: Any) -> None:
    """Mark the vertices `first` to `last`, for `run_tasks`."""
    ways, normals, ends = np.empty((MOST_FACES, 3)), np.empty((MOST_FACES, 3)), np.empty((MOST_FACES, 2), np.int64)
    for v in range(first, last):
        n = starts[v + 1] - starts[v]
        out[v] = 3 <= n <= MOST_FACES
        if out[v]:
            for q in range(n):
                f, k = corners[starts[v] + q] // 3, corners[starts[v] + q] % 3
                ends[q, 0], ends[q, 1] = faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
            out[v] = are_paired(ends, n) and go_round_once(vertices, v, ends, n, ways, normals)


@jit(nopython=True, cache=True)
def are_paired(ends: Ints, n: int) -> bool:
    """Whether each side of n wedges is where one of them begins and one ends."""
    paired = True
    for q in range(n):
        n_begin, n_end = 0, 0
        for p in range(n):
            n_begin += ends[p, 0] == ends[q, 0]
            n_end += ends[p, 1] == ends[q, 0]
        paired &= (n_begin == 1) & (n_end == 1)
    return paired


@jit(nopython=True, cache=True)
def go_round_once(vertices: Floats, v: int, ends: Ints, n: int, ways: Floats, normals: Floats) -> bool:
    """Whether n wedges, their sides being paired, are all turned one way and cover each direction once.

    How many cover a direction is the same for all of them: that of the first side lies in those that begin at or
    before it and end after it.
    """
    x, y, z = 0.0, 0.0, 0.0
    for q in range(n):
        for a in range(3):
            ways[q, a] = vertices[ends[q, 0], a] - vertices[v, a]
    for q in range(n):
        b = (vertices[ends[q, 1], 0] - vertices[v, 0], vertices[ends[q, 1], 1] - vertices[v, 1],
             vertices[ends[q, 1], 2] - vertices[v, 2])  # fmt: skip
        nx, ny, nz = (ways[q, 1] * b[2] - ways[q, 2] * b[1], ways[q, 2] * b[0] - ways[q, 0] * b[2],
                      ways[q, 0] * b[1] - ways[q, 1] * b[0])  # fmt: skip
        length2 = (ways[q, 0] ** 2 + ways[q, 1] ** 2 + ways[q, 2] ** 2) * (b[0] ** 2 + b[1] ** 2 + b[2] ** 2)
        if not nx * nx + ny * ny + nz * nz > LEAST_SINE2 * length2:
            return False
        normals[q, 0], normals[q, 1], normals[q, 2] = nx, ny, nz
        x, y, z = x + nx, y + ny, z + nz
    sum2 = x * x + y * y + z * z
    sx, sy, sz = ways[0, 1] * z - ways[0, 2] * y, ways[0, 2] * x - ways[0, 0] * z, ways[0, 0] * y - ways[0, 1] * x
    n_over = 0
    for q in range(n):
        nx, ny, nz = normals[q, 0], normals[q, 1], normals[q, 2]
        along = nx * x + ny * y + nz * z
        if not (along > 0.0 and along * along > LEAST_COSINE2 * sum2 * (nx * nx + ny * ny + nz * nz)):
            return False
        begins = q == 0 or ways[q, 0] * sx + ways[q, 1] * sy + ways[q, 2] * sz >= 0.0
        p = ends[q, 1]
        end = (vertices[p, 0] - vertices[v, 0]) * sx + (vertices[p, 1] - vertices[v, 1]) * sy + (
            vertices[p, 2] - vertices[v, 2]) * sz  # fmt: skip
        n_over += begins and p != ends[0, 0] and end < 0.0
    return n_over == 1
