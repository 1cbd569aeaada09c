"""Holes closed by faces that nobody measured: found as loops of free edges, spanned, made as fine as the mesh.

In: a two-manifold with boundary. Out: its faces, and behind them those that close holes. The span is the triangulation
of least area (Barequet & Sharir 1995, "Filling gaps in the boundary of a polyhedron"), where it must be without faces
that fold back over the rim (Liepa 2003, "Filling holes in meshes"), made as fine as asked (`spans.py`). Faces of a
jagged rim that a span meets are given up, with those that it meets itself beside. A hole that cannot be closed so gets
a span without inner vertices where that meets nothing; else it stays open.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit
from scipy.spatial.distance import pdist

from monitor.reconstruction.alongside import lies_along
from monitor.reconstruction.edges import faces_together
from monitor.reconstruction.faces import area_vector, length_of
from monitor.reconstruction.intersections import find_intersections
from monitor.reconstruction.mesh import bow_ties, edge_table, face_areas_and_normals
from monitor.reconstruction.spans import refine
from projects.model import Bools, Floats, Ints

MOST_CORNERS = 400  # of a loop spanned at once: least area takes time with the cube; a longer one is cut into bays
COS_FOLDS = -0.7  # between normals: beyond it a face lies back over the one beside it
MOST_STEPS = 12  # of a rim, each back from the faces that a span meets


class Closed(NamedTuple):
    """A mesh with holes closed: vertices, new ones behind the old; faces, the first `n_measured` of the old ones, then
    those that close holes; how many holes were closed and how many not. Old vertices may be left without a face."""

    vertices: Floats
    faces: Ints
    n_measured: int
    n_closed: int = 0
    n_left_open: int = 0


class Attempt(NamedTuple):
    """A mesh with one hole more closed, None where faces would meet; then those of the mesh (k,) that are met."""

    mesh: Closed | None
    met: Ints


def close_holes(vertices: Floats, faces: Ints, widest: float, longest_edge: float) -> Closed:
    """Close every hole up to `widest` (m; infinite: all) across, with faces whose edges are below `longest_edge` (m).

    The free edge around the whole of an open surface is a hole too, if a wide one. Holes are closed in the order of
    their lowest vertex; one whose faces would meet others, refined or not, is tried again without the faces of its rim
    that are met, then stays open and is counted. So does one whose faces would lie along a measured sheet.
    """
    mesh = Closed(vertices, faces, len(faces))
    for loop in free_loops(faces):
        if width(vertices[loop]) > widest:
            continue
        closed = _close(mesh, loop, longest_edge)
        if closed is None:
            mesh = mesh._replace(n_left_open=mesh.n_left_open + 1)
        else:
            mesh = closed._replace(n_closed=mesh.n_closed + 1)
    return mesh


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


def _close(mesh: Closed, loop: Ints, longest_edge: float) -> Closed | None:
    """Return the mesh with one hole closed; None where that cannot be done without faces that meet.

    Rims step back until a fine span meets nothing. Where they cannot, the hole as it was gets a coarse one.
    """
    fewer, rim = mesh, loop
    for _ in range(MOST_STEPS):
        attempt = _try(fewer, rim, longest_edge)
        if attempt.mesh is not None or not len(attempt.met):
            return attempt.mesh
        stepped = _step_back(fewer, rim, attempt.met)
        if stepped is None:
            break
        fewer, rim = stepped
    return _try(mesh, loop, np.inf).mesh


def _try(mesh: Closed, loop: Ints, longest_edge: float) -> Attempt:
    """Close one hole by a span of least area, or by one that nowhere folds back over the rim.

    Where both meet faces of the mesh, those are told that the one meets which meets fewer; none where a span lies
    along a measured sheet.
    """
    corners, met = np.ascontiguousarray(mesh.vertices[loop]), None
    is_taken, beyond = _edges_across(mesh.faces, loop), _normals_beyond(mesh.vertices, mesh.faces, loop)
    for normals in (np.zeros_like(beyond), beyond):
        patch = _span(corners, is_taken, normals)
        if patch is None:
            continue
        places, span = refine(corners, patch, is_taken, longest_edge)
        if lies_along(places, len(loop), mesh.vertices, mesh.faces[: mesh.n_measured], longest_edge):
            return Attempt(None, np.empty(0, np.int64))
        joined, pairs = _join(mesh, loop, places, span)
        if not len(pairs):
            return Attempt(joined, np.empty(0, np.int64))
        these = _met(joined.faces, len(mesh.faces), pairs)
        met = these if met is None or len(these) < len(met) else met
    return Attempt(None, np.empty(0, np.int64) if met is None else met)


def _met(faces: Ints, n_before: int, pairs: Ints) -> Ints:
    """Return those of the first `n_before` faces that a span, the others, meets, and those with an edge on one of its
    faces that meet each other."""
    of_span = faces[np.unique(pairs[(pairs >= n_before).all(axis=1)])]
    is_theirs = np.zeros(int(faces.max()) + 1, bool)
    is_theirs[of_span] = True
    beside = np.flatnonzero(is_theirs[faces[:n_before]].sum(axis=1) > 1)
    return np.union1d(pairs[pairs < n_before], beside)


def _join(mesh: Closed, loop: Ints, places: Floats, span: Ints) -> tuple[Closed, Ints]:
    """Return the mesh with a span of a loop, its `places` those of the loop first, and pairs of faces that meet."""
    names = np.r_[loop, len(mesh.vertices) + np.arange(len(places) - len(loop))]
    vertices = np.r_[mesh.vertices, places[len(loop) :]]
    faces = np.r_[mesh.faces, names[span].astype(mesh.faces.dtype)]
    return mesh._replace(vertices=vertices, faces=faces), find_intersections(
        vertices, faces, np.arange(len(faces)) >= len(mesh.faces)
    )


def _step_back(mesh: Closed, loop: Ints, met: Ints) -> tuple[Closed, Ints] | None:
    """Return the mesh without the measured faces at the rim of a hole that its span met, and the new loop.

    None where there are none, or where that would take more faces than the rim has edges, a piece of surface, or
    anything of another hole.
    """
    at_rim = np.isin(mesh.faces[met], loop).any(axis=1) & (met < mesh.n_measured)
    keep = np.ones(len(mesh.faces), bool)
    keep[met[at_rim]] = False
    while (ties := bow_ties(mesh.faces[keep])).any():
        keep[np.flatnonzero(keep)[ties]] = False
    keep[keep] = ~_broken_off(mesh.faces, keep)
    n_lost = int(np.count_nonzero(~keep))
    if not 0 < n_lost <= len(loop) or not keep[mesh.n_measured :].all():
        return None
    fewer = mesh._replace(faces=mesh.faces[keep], n_measured=mesh.n_measured - n_lost)
    others = {tuple(other.tolist()) for other in free_loops(mesh.faces)} - {tuple(loop.tolist())}
    after = {tuple(other.tolist()) for other in free_loops(fewer.faces)}
    if not others <= after or len(after - others) != 1:
        return None
    return fewer, np.array((after - others).pop(), np.int64)


def _broken_off(faces: Ints, keep: Bools) -> Bools:
    """Return which of the faces to keep lie in a piece that hung together with a larger one by those that are lost."""
    before, after = _pieces(faces)[keep], _pieces(faces[keep])
    size = np.bincount(after)[after]
    largest = np.zeros(len(faces), np.int64)
    np.maximum.at(largest, before, size)
    out: Bools = size < largest[before]
    return out


def _pieces(faces: Ints) -> Ints:
    """Return the number of the piece of each face (m,); faces hang together by edges."""
    _, edge_of, n_faces = edge_table(faces)
    return faces_together(edge_of, len(n_faces))


def _normals_beyond(vertices: Floats, faces: Ints, loop: Ints) -> Floats:
    """Return the unit normals (n, 3) of the faces beyond the edges of a loop, from each corner to the next."""
    _, edge_of, n_faces = edge_table(faces)
    free = np.flatnonzero(n_faces[edge_of] == 1)
    ends = np.roll(faces, -1, axis=1).ravel()[free]
    face_at = np.full(len(vertices), -1)
    face_at[ends] = free // 3  # loops go the other way than the faces: their edges start where those of faces end
    return face_areas_and_normals(vertices, faces[face_at[loop]])[1]


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


def _span(corners: Floats, is_taken: Any, beyond: Floats) -> Ints | None:
    """Return the triangles (n - 2, 3) of least area that span a loop; no inner edge may be one that is taken, and no
    triangle may fold back over a face with the normal `beyond` (n, 3) the edge that follows a corner."""
    n = len(corners)
    if n == 3:
        return np.array([[0, 1, 2]])
    if n > MOST_CORNERS:
        return _span_by_bays(corners, is_taken, beyond)
    cost, middle = _least_area(corners, is_taken, beyond)
    if not np.isfinite(cost[0, n - 1]):
        return None
    triangles, pending = [], [(0, n - 1)]
    while pending:
        i, k = pending.pop()
        if k - i > 1:
            m = int(middle[i, k])
            triangles.append((i, m, k))
            pending += [(i, m), (m, k)]
    return np.array(triangles)


def _span_by_bays(corners: Floats, is_taken: Any, beyond: Floats) -> Ints | None:
    """Span every k-th corner, and the corners between two such each by itself."""
    n = len(corners)
    headlands = np.arange(0, n, -(-n // MOST_CORNERS))
    parts = [headlands]
    parts += [np.arange(i, k + 1) % n for i, k in zip(headlands, [*headlands[1:], n], strict=True) if k > i + 1]
    spans = []
    for part in parts:
        rim = np.where(np.roll(part, -1)[:, None] == (part[:, None] + 1) % n, beyond[part], 0.0)
        span = _span(np.ascontiguousarray(corners[part]), np.ascontiguousarray(is_taken[np.ix_(part, part)]), rim)
        if span is None or (part is not headlands and is_taken[part[0], part[-1]]):
            return None
        spans.append(part[span])
    return np.concatenate(spans)


@jit(nopython=True, cache=True)
def _least_area(corners: Floats, is_taken: Any, beyond: Floats) -> Any:
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
                    if this < best and not _folds_back(corners, i, m, k, beyond):
                        best, at = this, m
            cost[i, k], middle[i, k] = best, at
    return cost, middle


@jit(nopython=True, cache=True)
def _folds_back(corners: Floats, i: int, m: int, k: int, beyond: Floats) -> bool:
    """Whether the triangle of three corners lies back over the face beyond one of its edges, if that is of the rim."""
    x, y, z = area_vector(corners, i, m, k)
    least = COS_FOLDS * length_of((x, y, z))
    for a, b in ((i, m), (m, k), (k, i)):
        on_rim = b == a + 1 or (b == 0 and a == len(corners) - 1)
        if on_rim and x * beyond[a, 0] + y * beyond[a, 1] + z * beyond[a, 2] < least:
            return True
    return False


@jit(nopython=True, cache=True)
def _area(corners: Floats, i: int, m: int, k: int) -> float:
    """Area of the triangle of three corners."""
    return 0.5 * length_of(area_vector(corners, i, m, k))
