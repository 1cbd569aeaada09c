"""Who touches whom on a mesh: the faces around each vertex, and what follows from them.

In: vertices and faces. Out: normals, areas, neighbours and the border, made where they are asked for and not kept: the
stars are all that a mesh holds beside its faces. Each loop step writes its own output, so threads change nothing.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit

from monitor.threads import run_tasks
from monitor.tuples import along, cross, dot, less, sub, unit
from projects.model import Bools, Floats, Ints


class Mesh(NamedTuple):  # a named tuple, since kernels take it whole; a `MeshTree` has these fields too
    """Vertices (n, 3) [m], which kernels see less `shift` (3,), faces (m, 3), and the faces around vertex v, rising:
    from star_starts[v] on."""

    vertices: Floats
    faces: Ints
    star_starts: Ints
    star_faces: Ints
    shift: Floats


class Neighbours(NamedTuple):  # a named tuple, since kernels take it whole
    """The vertices that share an edge with vertex v, rising: `vertices[starts[v]:starts[v + 1]]`."""

    starts: Ints
    vertices: Ints


def make_mesh(vertices: Floats, faces: Ints, shift: Floats | None = None) -> Mesh:
    """Return a mesh with its stars, in coordinates less `shift` (3,) [m], which is 0 where left out."""
    faces = np.ascontiguousarray(faces)
    shift = np.zeros(3) if shift is None else shift
    starts, around = _gather_stars(faces, len(vertices))
    return Mesh(np.ascontiguousarray(vertices), faces, starts, around, shift)


class Survey(NamedTuple):
    """Of each vertex (n,) the unit normal (n, 3), area [m2], whether it is on the border, and its number of
    neighbours."""

    normals: Floats
    areas: Floats
    is_border: Bools
    n_neighbours: Ints


def survey_vertices(mesh: Mesh) -> Survey:
    """Return what the faces around each vertex tell of it.

    The normal is the unit pseudo-normal, face normals weighted by their angle there, 0 without faces; the area a third
    of the faces around; the border is where an edge is free.

    References
    ----------
    Baerentzen and Aanaes (2005), Signed distance computation using the angle weighted pseudonormal.
    """
    n = len(mesh.vertices)
    out = Survey(np.empty((n, 3)), np.empty(n), np.empty(n, dtype=np.bool_), np.empty(n, dtype=np.int32))
    run_tasks(_survey_stars, n, mesh, _widest_star(mesh), out)
    return out


def angle_weighted_normals(mesh: Mesh) -> Floats:
    """Return the unit pseudo-normal of each vertex (n, 3); see `survey_vertices`."""
    return survey_vertices(mesh).normals


def vertex_areas(mesh: Mesh) -> Floats:
    """Return the area each vertex stands for (n,) [m2]; see `survey_vertices`."""
    return survey_vertices(mesh).areas


def face_normals(mesh: Mesh) -> Floats:
    """Return the unit normal (m, 3) float32 of each face, zeros where it has no area."""
    out = np.empty((len(mesh.faces), 3), dtype=np.float32)
    run_tasks(_write_face_normals, len(mesh.faces), mesh, out)
    return out


def gather_neighbours(mesh: Any, n_neighbours: Ints | None = None) -> Neighbours:
    """Return the neighbours of each vertex of a mesh; `n_neighbours` (n,) are as many, where they are known already."""
    counts = survey_vertices(mesh).n_neighbours if n_neighbours is None else n_neighbours
    starts = np.zeros(len(counts) + 1, dtype=np.int32)
    np.cumsum(counts, out=starts[1:])
    near = np.empty(starts[-1], dtype=np.int32)
    run_tasks(_list_neighbours, len(counts), mesh, _widest_star(mesh), starts, near)
    return Neighbours(starts, near)


def free_edges(mesh: Any, is_border: Bools) -> Ints:
    """Return the free edges (e, 2), each in the direction of its face."""
    face, side = np.nonzero(_find_free_sides(mesh, is_border))
    return np.column_stack([mesh.faces[face, side], mesh.faces[face, (side + 1) % 3]])


@jit(nopython=True, cache=True, nogil=True)
def first_sides(mesh):  # type: ignore[no-untyped-def]
    """Return the length (m,) [m] of the first side of each face."""
    out = np.empty(len(mesh.faces))
    for f in range(len(mesh.faces)):
        side = sub(corner_of(mesh, f, 0), corner_of(mesh, f, 1))
        out[f] = np.sqrt(dot(side, side))
    return out


def _widest_star(mesh: Any) -> int:
    """Return the most ends that edges in the star of one vertex can have."""
    return 3 * int(np.diff(mesh.star_starts).max(initial=0))


@jit(nopython=True, cache=True, nogil=True)
def _gather_stars(faces, n_vertices):  # type: ignore[no-untyped-def]
    """Return starts (n + 1,) and faces (3 m,) of the stars."""
    starts = np.zeros(n_vertices + 1, dtype=np.int32)
    for f in range(len(faces)):
        for k in range(3):
            starts[faces[f, k] + 1] += 1
    for v in range(n_vertices):
        starts[v + 1] += starts[v]
    around, filled = np.empty(3 * len(faces), dtype=np.int32), starts[:-1].copy()
    for f in range(len(faces)):
        for k in range(3):
            v = faces[f, k]
            around[filled[v]] = f
            filled[v] += 1
    return starts, around


@jit(nopython=True, cache=True, forceinline=True)
def vertex_of(mesh, v):  # type: ignore[no-untyped-def]
    """Return vertex v, less the mesh's shift, as a tuple."""
    return less(mesh.vertices, v, mesh.shift)


@jit(nopython=True, cache=True, forceinline=True)
def corner_of(mesh, f, k):  # type: ignore[no-untyped-def]
    """Return corner k of face f as a tuple."""
    return vertex_of(mesh, mesh.faces[f, k])


@jit(nopython=True, cache=True, nogil=True)
def face_normal(mesh, f):  # type: ignore[no-untyped-def]
    """Return the unit normal of face f; zeros where it has no area."""
    a = corner_of(mesh, f, 0)
    return unit(cross(sub(corner_of(mesh, f, 1), a), sub(corner_of(mesh, f, 2), a)))


@jit(nopython=True, cache=True, nogil=True)
def _write_face_normals(first, last, mesh, out):  # type: ignore[no-untyped-def]
    """Write the unit normals of the faces `first` to `last`."""
    for f in range(first, last):
        out[f, 0], out[f, 1], out[f, 2] = face_normal(mesh, f)


@jit(nopython=True, cache=True, nogil=True)
def face_across(mesh, f, side):  # type: ignore[no-untyped-def]
    """Return the face across the edge ab, bc or ca (`side`) of face f; -1 where the edge is free.

    Where more than two faces share the edge they follow each other in their order, the first after the last.
    """
    start, end = mesh.faces[f, side], mesh.faces[f, (side + 1) % 3]
    here, first, before = 3 * f + side, -1, -1
    for s in range(mesh.star_starts[start], mesh.star_starts[start + 1]):
        g = mesh.star_faces[s]
        if g == before:  # a face without area that has the vertex twice
            continue
        before = g
        for k in range(3):
            a, b = mesh.faces[g, k], mesh.faces[g, (k + 1) % 3]
            if (a == start and b == end) or (a == end and b == start):
                if 3 * g + k > here:
                    return g
                if first < 0:
                    first = 3 * g + k
    return first // 3 if first != here else -1


@jit(nopython=True, cache=True, forceinline=True)
def _edge_ends(faces, starts, around, v, ends):  # type: ignore[no-untyped-def]
    """Write the other ends of the edges of v's faces at v, one for each face; return how many they are."""
    n, before = 0, -1
    for s in range(starts[v], starts[v + 1]):
        f = around[s]
        if f == before:
            continue
        before = f
        for k in range(3):
            a, b = faces[f, k], faces[f, k + 1 if k < 2 else 0]
            if (a == v) != (b == v):
                ends[n] = b if a == v else a
                n += 1
    return n


@jit(nopython=True, cache=True, forceinline=True)
def _keep_once(ends, n):  # type: ignore[no-untyped-def]
    """Bring the first `n` ends into rising order, each once, in front; return how many they are."""
    kept = 0
    for i in range(n):
        end, at = ends[i], kept
        while at > 0 and ends[at - 1] > end:
            at -= 1
        if at > 0 and ends[at - 1] == end:
            continue
        for j in range(kept, at, -1):
            ends[j] = ends[j - 1]
        ends[at] = end
        kept += 1
    return kept


@jit(nopython=True, cache=True, nogil=True)
def _list_neighbours(first, last, mesh, widest, places, out):  # type: ignore[no-untyped-def]
    """Write the neighbours of vertex v from places[v] on."""
    faces, starts, around, ends = mesh.faces, mesh.star_starts, mesh.star_faces, np.empty(widest, dtype=np.int32)
    for v in range(first, last):
        for k in range(_keep_once(ends, _edge_ends(faces, starts, around, v, ends))):
            out[places[v] + k] = ends[k]


@jit(nopython=True, cache=True, forceinline=True)
def _count_ends(ends, n):  # type: ignore[no-untyped-def]
    """Return how many different ones the first `n` ends are, which are sorted, and whether one is there once only: its
    edge has one face."""
    for i in range(1, n):
        end, at = ends[i], i
        while at > 0 and ends[at - 1] > end:
            ends[at] = ends[at - 1]
            at -= 1
        ends[at] = end
    n_different, n_same, has_lone = 0, 0, False
    for i in range(n):
        n_same = n_same + 1 if i > 0 and ends[i] == ends[i - 1] else 1
        if n_same == 1:
            n_different += 1
            has_lone |= i + 1 == n or ends[i + 1] != ends[i]
    return n_different, has_lone


@jit(nopython=True, cache=True, nogil=True)
def _find_free_sides(mesh, is_border):  # type: ignore[no-untyped-def]
    """Return which sides (m, 3) of the faces no other face joins."""
    out = np.zeros((len(mesh.faces), 3), dtype=np.bool_)
    for f in range(len(mesh.faces)):
        for side in range(3):
            a, b = mesh.faces[f, side], mesh.faces[f, (side + 1) % 3]
            out[f, side] = a != b and is_border[a] and is_border[b] and face_across(mesh, f, side) < 0
    return out


@jit(nopython=True, cache=True, forceinline=True)
def _weigh_star(vertices, faces, starts, around, shift, v):  # type: ignore[no-untyped-def]
    """Return the angle-weighted unit normal of vertex v, zeros without faces, and a third of the faces' area."""
    at, total, area = less(vertices, v, shift), (0.0, 0.0, 0.0), 0.0
    for s in range(starts[v], starts[v + 1]):
        f = around[s]
        k = 0 if faces[f, 0] == v else 1 if faces[f, 1] == v else 2
        following, last = faces[f, k + 1 if k < 2 else 0], faces[f, k - 1 if k > 0 else 2]
        to_next, to_last = sub(less(vertices, following, shift), at), sub(less(vertices, last, shift), at)
        across = cross(to_next, to_last)
        size = np.sqrt(dot(across, across))
        area += size / 6.0
        if size > 0.0:
            total = along(total, np.arctan2(size, dot(to_next, to_last)) / size, across)
    return unit(total), area


@jit(nopython=True, cache=True, nogil=True)
def _survey_stars(first, last, mesh, widest, out):  # type: ignore[no-untyped-def]
    """Write the figures of the vertices from `first` to `last`; see `survey_vertices`."""
    vertices, faces, starts, around, shift = mesh.vertices, mesh.faces, mesh.star_starts, mesh.star_faces, mesh.shift
    ends = np.empty(widest, dtype=np.int32)
    for v in range(first, last):
        normal, out.areas[v] = _weigh_star(vertices, faces, starts, around, shift, v)
        out.normals[v, 0], out.normals[v, 1], out.normals[v, 2] = normal
        out.n_neighbours[v], out.is_border[v] = _count_ends(ends, _edge_ends(faces, starts, around, v, ends))
