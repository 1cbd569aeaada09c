"""Holes closed by faces that nobody measured: found as loops of free edges, spanned, made as fine as the mesh.

In: a two-manifold with boundary. Out: the same faces, and behind them those that close holes. The span is the
triangulation of least area (Barequet & Sharir 1995, "Filling gaps in the boundary of a polyhedron"); its inner
vertices, put in until its edges are as long as asked, lie in the middle of their neighbours. A hole whose span would
meet other faces stays open.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import spsolve
from scipy.spatial.distance import pdist

from monitor.reconstruction.intersections import find_intersections
from monitor.reconstruction.mesh import edge_table
from projects.model import Floats, Ints

MOST_CORNERS = 400  # of a loop spanned at once: least area takes time with the cube; a longer one is cut into bays
MOST_ROUNDS = 16  # of refinement, each of which halves the long edges


class Closed(NamedTuple):
    """Vertices, new ones behind the old; faces, those that close holes behind the old; what was closed and what not."""

    vertices: Floats
    faces: Ints
    n_closed: int
    n_left_open: int


def close_holes(vertices: Floats, faces: Ints, widest: float, longest_edge: float) -> Closed:
    """Close every hole up to `widest` (m; infinite: all) across, with faces whose edges are below `longest_edge` (m).

    The free edge around the whole of an open surface is a hole too, if a wide one. Holes are closed in the order of
    their lowest vertex; one whose faces would meet others, refined or not, stays open and is counted.
    """
    n_closed = n_left_open = 0
    for loop in free_loops(faces):
        if width(vertices[loop]) > widest:
            continue
        closed = _close(vertices, faces, loop, longest_edge)
        if closed is None:
            n_left_open += 1
        else:
            vertices, faces = closed
            n_closed += 1
    return Closed(vertices, faces, n_closed, n_left_open)


def free_loops(faces: Ints) -> list[Ints]:
    """Return the loops of free edges as vertices in the order in which faces that close them go round."""
    _, edge_of, n_faces = edge_table(faces)
    is_free = n_faces[edge_of] == 1
    start, end = faces.ravel()[is_free], np.roll(faces, -1, axis=1).ravel()[is_free]
    following = dict(zip(end.tolist(), start.tolist(), strict=True))  # the other way than the faces that are there
    loops = []
    for first in sorted(following):
        if first in following:
            loop = [first]
            while (after := following.pop(loop[-1], first)) != first:
                loop.append(after)
            loops.append(np.array(loop, np.int64))
    return [loop for loop in loops if len(loop) > 2]


def width(corners: Floats) -> float:
    """Return the largest distance between two corners (n, 3) of a loop, of every k-th where there are very many."""
    return float(pdist(corners[:: 1 + len(corners) // 2000]).max())


def _close(vertices: Floats, faces: Ints, loop: Ints, longest_edge: float) -> tuple[Floats, Ints] | None:
    """Return vertices and faces with one hole closed; None where that cannot be done without faces that meet."""
    corners = np.ascontiguousarray(vertices[loop])
    patch = _span(corners, _edges_across(faces, loop))
    if patch is None:
        return None
    for places, span in (_refine(corners, patch, longest_edge), (corners, patch)):
        names = np.r_[loop, len(vertices) + np.arange(len(places) - len(loop))]
        more = np.r_[vertices, places[len(loop) :]]
        joined = np.r_[faces, names[span].astype(faces.dtype)]
        is_new = np.arange(len(joined)) >= len(faces)
        if not len(find_intersections(more, joined, is_new)):
            return more, joined
    return None


def _edges_across(faces: Ints, loop: Ints) -> Any:
    """Return which corners of the loop (n, n) some edge of the mesh joins already."""
    place = np.full(int(max(faces.max(), loop.max())) + 1, -1)
    place[loop] = np.arange(len(loop))
    edges = edge_table(faces)[0]
    near = place[edges]
    near = near[(near >= 0).all(axis=1)]
    out = np.zeros((len(loop), len(loop)), np.bool_)
    out[near[:, 0], near[:, 1]] = out[near[:, 1], near[:, 0]] = True
    return out


def _span(corners: Floats, is_taken: Any) -> Ints | None:
    """Return the triangles (n - 2, 3) of least area that span a loop; no inner edge may be one that is taken."""
    n = len(corners)
    if n == 3:
        return np.array([[0, 1, 2]])
    if n > MOST_CORNERS:
        return _span_by_bays(corners, is_taken)
    cost, middle = _least_area(corners, is_taken)
    if not np.isfinite(cost[0, n - 1]):
        return None
    triangles, todo = [], [(0, n - 1)]
    while todo:
        i, k = todo.pop()
        if k - i > 1:
            m = int(middle[i, k])
            triangles.append((i, m, k))
            todo += [(i, m), (m, k)]
    return np.array(triangles)


def _span_by_bays(corners: Floats, is_taken: Any) -> Ints | None:
    """Span every k-th corner, and the corners between two such each by itself."""
    n = len(corners)
    headlands = np.arange(0, n, -(-n // MOST_CORNERS))
    parts = [headlands]
    parts += [np.arange(i, k + 1) % n for i, k in zip(headlands, [*headlands[1:], n], strict=True) if k > i + 1]
    spans = []
    for part in parts:
        span = _span(np.ascontiguousarray(corners[part]), np.ascontiguousarray(is_taken[np.ix_(part, part)]))
        if span is None or (part is not headlands and is_taken[part[0], part[-1]]):
            return None
        spans.append(part[span])
    return np.concatenate(spans)


@jit(nopython=True, cache=True)
def _least_area(corners: Floats, is_taken: Any) -> Any:
    """Least area (n, n) of a triangulation of the corners i to k, and the corner that it puts on the edge i k."""
    n = len(corners)
    cost, middle = np.zeros((n, n)), np.zeros((n, n), np.int32)
    for apart in range(2, n):
        for i in range(n - apart):
            k = i + apart
            best, at = np.inf, i + 1
            if not (is_taken[i, k] and apart < n - 1):
                for m in range(i + 1, k):
                    this = cost[i, m] + cost[m, k] + _area(corners, i, m, k)
                    if this < best:
                        best, at = this, m
            cost[i, k], middle[i, k] = best, at
    return cost, middle


@jit(nopython=True, cache=True)
def _area(corners: Floats, i: int, m: int, k: int) -> float:
    """Area of the triangle of three corners."""
    ux, uy, uz = corners[k, 0] - corners[i, 0], corners[k, 1] - corners[i, 1], corners[k, 2] - corners[i, 2]
    vx, vy, vz = corners[m, 0] - corners[i, 0], corners[m, 1] - corners[i, 1], corners[m, 2] - corners[i, 2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return 0.5 * np.sqrt(x * x + y * y + z * z)


def _refine(corners: Floats, patch: Ints, longest: float) -> tuple[Floats, Ints]:
    """Return a patch with its inner edges below `longest` (m), its inner vertices amid their neighbours."""
    n_fixed, places = len(corners), corners
    for _ in range(MOST_ROUNDS):
        edges, edge_of, n_faces = edge_table(patch)
        is_long = np.linalg.norm(places[edges[:, 0]] - places[edges[:, 1]], axis=1) > longest
        is_long &= n_faces == 2
        if not is_long.any():
            break
        patch = _split(patch, edge_of.reshape(-1, 3), is_long, len(places))
        places = np.r_[places, places[edges[is_long]].mean(axis=1)]
        places = _relax(places, patch, n_fixed)
    return places, patch


def _split(patch: Ints, edge_of: Ints, is_split: Any, n_vertices: int) -> Ints:
    """Return the faces with the marked edges cut in two, by the vertices numbered from `n_vertices` on."""
    middle = np.where(is_split, n_vertices + np.cumsum(is_split) - 1, -1)
    out: list[tuple[int, int, int]] = []
    for (a, b, c), (x, y, z) in zip(patch.tolist(), middle[edge_of].tolist(), strict=True):
        out += _cut((a, b, c), (x, y, z))
    return np.array(out)


def _cut(corners: tuple[int, int, int], middles: tuple[int, int, int]) -> list[tuple[int, int, int]]:
    """Return the triangles of one whose edges ab, bc, ca have a vertex in the middle where that is not -1."""
    n_cut = sum(m >= 0 for m in middles)
    for _ in range(3):  # turn until the pattern is: none, ab, ab and bc, all
        x, y, z = middles
        if n_cut in (0, 3) or (n_cut == 1 and x >= 0) or (n_cut == 2 and z < 0):
            break
        corners, middles = (corners[1], corners[2], corners[0]), (y, z, x)
    (a, b, c), (x, y, z) = corners, middles
    if n_cut == 0:
        return [corners]
    if n_cut == 1:
        return [(a, x, c), (x, b, c)]
    if n_cut == 2:
        return [(x, b, y), (a, x, y), (a, y, c)]
    return [(a, x, z), (x, b, y), (z, y, c), (x, y, z)]


def _relax(places: Floats, patch: Ints, n_fixed: int) -> Floats:
    """Return the places with each but the first `n_fixed` in the middle of its neighbours."""
    edges, n = edge_table(patch)[0], len(places)
    both = np.r_[edges, edges[:, ::-1]]
    links = coo_matrix((np.ones(len(both)), both.T), shape=(n, n)).tocsr()
    system = (diags(np.asarray(links.sum(axis=1)).ravel()) - links).tocsr()[n_fixed:]
    inner = spsolve(system[:, n_fixed:].tocsc(), -(system[:, :n_fixed] @ places[:n_fixed]))
    return np.r_[places[:n_fixed], np.asarray(inner).reshape(-1, 3)]
