"""Spans of holes made as fine as the mesh around them: long edges cut, edges turned, inner vertices amid their own.

In: the corners of a hole, rim first and in order, and triangles that span it. Out: places and triangles with the same
rim. An edge is cut in its middle where it is the longest beside it, and edges around are turned at once until each
pair of triangles is as Delaunay has it (Lawson 1977): so no place is nearer to its neighbours than about half the
longest edge, and angles are wide, as in the refinement of Liepa 2003, "Filling holes in meshes". Inner vertices then
lie in the middle of their neighbours.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import splu

from monitor.reconstruction.faces import area_vector, length_of, way
from monitor.reconstruction.mesh import edge_table, face_areas_and_normals
from projects.model import Bools, Floats, Ints

MOST_ROUNDS = 24  # of refinement, each to edges half as long until they are as long as asked
FEW = 0.01  # of the vertices: new ones are not worth a round
CROWDED = 8.0  # vertices on a square of the longest edge: never so many, whatever a span folded over itself does
CLEARLY = 1.0 - 1e-9  # of a cotangent, by which an angle is wider than by rounding
MOST_TURNS = 64  # of edges beside one that is cut
COS_SHARP = 0.5  # between the normals of two triangles: an edge turned makes no fold sharper than this, or than it was


class Web(NamedTuple):
    """Triangles with room for more, and what lies beyond each of their edges; half-edge 3 f + k is that of face f
    from its corner k to the next."""

    places: Floats  # (v, 3) m
    faces: Ints  # (f, 3)
    beyond: Ints  # (3 f,) the half-edge on the other side; -1 at the rim
    at: Ints  # (v,) a half-edge that starts at the vertex
    is_taken: Bools  # (n, n) corners of the rim that an edge joins already


def refine(corners: Floats, patch: Ints, is_taken: Bools, longest: float) -> tuple[Floats, Ints]:
    """Return places (k, 3) m, the `corners` (n, 3) of the rim first, and triangles with inner edges below `longest` m,
    but for those beside longer ones of the rim.

    No edge is put between corners of which `is_taken` (n, n) says that an edge joins them already.
    """
    n_fixed, places, patch = len(corners), corners, np.ascontiguousarray(patch, np.int64)
    at_most = longest
    while at_most < 0.5 * _longest_inner(places, patch):
        at_most *= 2.0
    for _ in range(MOST_ROUNDS):
        n_before = len(places)
        places, patch = _cut_long_edges(places, patch, is_taken, at_most)
        if len(places) - n_before <= FEW * n_before and at_most == longest:
            break  # they stay in the middle of edges that were cut
        places = relax(places, patch, n_fixed)
        at_most = max(longest, 0.5 * at_most)
    return places, patch


def relax(places: Floats, patch: Ints, n_fixed: int) -> Floats:
    """Return the places with each but the first `n_fixed` in the middle of its neighbours."""
    if len(places) == n_fixed:
        return places
    edges, n = edge_table(patch)[0], len(places)
    both = np.r_[edges, edges[:, ::-1]]
    links = coo_matrix((np.ones(len(both)), both.T), shape=(n, n)).tocsr()
    system = (diags(np.asarray(links.sum(axis=1)).ravel()) - links).tocsr()[n_fixed:]
    amid = -(system[:, :n_fixed] @ places[:n_fixed])
    factors = splu(system[:, n_fixed:].tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
                   options={"SymmetricMode": True})  # fmt: skip
    inner = factors.solve(amid)
    return np.r_[places[:n_fixed], np.asarray(inner)]


def _longest_inner(places: Floats, patch: Ints) -> float:
    """Return the length of the longest edge that two triangles share, m; 0 without one."""
    edges, _, n_faces = edge_table(patch)
    ends = edges[n_faces == 2]
    return float(np.linalg.norm(places[ends[:, 0]] - places[ends[:, 1]], axis=1).max(initial=0.0))


def _cut_long_edges(places: Floats, patch: Ints, is_taken: Bools, at_most: float) -> tuple[Floats, Ints]:
    """Return places and triangles with edges turned, and those inner ones cut that are longer than `at_most` (m)."""
    edges, edge_of, _ = edge_table(patch)
    area = face_areas_and_normals(places, patch)[0].sum()
    rim = np.linalg.norm(np.diff(places[: len(is_taken)], axis=0), axis=1).sum()
    room = int(CROWDED * (area / at_most**2 + rim / at_most)) + 64
    more, faces = np.empty((len(places) + room, 3)), np.empty((len(patch) + 2 * room, 3), np.int64)
    more[: len(places)], faces[: len(patch)] = places, patch
    beyond = np.full(3 * len(faces), -1)
    beyond[: 3 * len(patch)] = _half_edges_beyond(edge_of, len(edges))
    at = np.full(len(more), -1)
    at[patch.ravel()] = np.arange(patch.size)
    n_places, n_triangles = _cut(Web(more, faces, beyond, at, is_taken), len(places), len(patch), at_most)
    return more[:n_places].copy(), faces[:n_triangles].copy()


@jit(nopython=True, cache=True)
def _half_edges_beyond(edge_of: Ints, n_edges: int) -> Ints:
    """The half-edge (h,) on the other side of each, -1 where there is none, from the edge (h,) of each."""
    first, beyond = np.full(n_edges, -1), np.full(len(edge_of), -1)
    for h in range(len(edge_of)):
        other = first[edge_of[h]]
        if other < 0:
            first[edge_of[h]] = h
        else:
            beyond[h], beyond[other] = other, h
    return beyond


@jit(nopython=True, cache=True)
def _cut(web: Web, n_places: int, n_faces: int, at_most: float) -> tuple[int, int]:
    """Turn edges, and cut inner ones above `at_most` (m) longest first among those beside them: how many are then."""
    pending = np.empty(max(len(web.beyond), 3 * MOST_TURNS + 16), np.int64)
    for h in range(3 * n_faces):
        pending[h] = h
    _turn(web, pending, 3 * n_faces, MOST_TURNS * n_faces)
    is_changed = True
    while is_changed:
        is_changed = False
        h = 0
        while h < 3 * n_faces:
            if web.beyond[h] > h and n_places < len(web.places) and n_faces + 1 < len(web.faces):
                length = _length(web, h)
                if length > at_most and _is_longest_beside(web, h, length):
                    _cut_edge(web, h, n_places, n_faces, pending)
                    n_places, n_faces = n_places + 1, n_faces + 2
                    _turn(web, pending, 4, MOST_TURNS)
                    is_changed = True
            h += 1
    return n_places, n_faces


@jit(nopython=True, cache=True)
def _following(h: int) -> int:
    """The half-edge that follows one around its face."""
    return h - 2 if h % 3 == 2 else h + 1


@jit(nopython=True, cache=True)
def _start(web: Web, h: int) -> int:
    """The vertex that a half-edge starts at."""
    return web.faces[h // 3, h % 3]


@jit(nopython=True, cache=True)
def _length(web: Web, h: int) -> float:
    """The length of a half-edge, m."""
    return length_of(way(web.places, _start(web, h), _start(web, _following(h))))


@jit(nopython=True, cache=True)
def _is_longest_beside(web: Web, h: int, length: float) -> bool:
    """Whether no other edge of the two triangles of an edge is longer than that; beside a long one of the rim, which
    stays, cuts would pile up at its thirds."""
    for side in (h, web.beyond[h]):
        after = _following(side)
        for other in (after, _following(after)):
            if _length(web, other) > length:
                return False
    return True


@jit(nopython=True, cache=True)
def _link(web: Web, h: int, other: int) -> None:
    """Put two half-edges on the two sides of one edge; or one at the rim, the other being -1."""
    web.beyond[h] = other
    if other >= 0:
        web.beyond[other] = h


@jit(nopython=True, cache=True)
def _set_face(web: Web, f: int, a: int, b: int, c: int) -> None:
    """Make f the face of three vertices, its half-edges starting at them."""
    web.faces[f, 0], web.faces[f, 1], web.faces[f, 2] = a, b, c
    web.at[a], web.at[b], web.at[c] = 3 * f, 3 * f + 1, 3 * f + 2


@jit(nopython=True, cache=True)
def _cut_edge(web: Web, h: int, m: int, n_faces: int, pending: Ints) -> None:
    """Cut the edge a b of the faces a b c and b a d in two at the new vertex m, its four triangles the two that were
    and the two behind the last; `pending` gets the half-edges around them."""
    o = web.beyond[h]
    f, g, f2, g2 = h // 3, o // 3, n_faces, n_faces + 1
    bc, ad = _following(h), _following(o)
    ca, db = _following(bc), _following(ad)
    a, b, c, d = _start(web, h), _start(web, o), _start(web, ca), _start(web, db)
    beyond_bc, beyond_ca, beyond_ad, beyond_db = web.beyond[bc], web.beyond[ca], web.beyond[ad], web.beyond[db]
    for x in range(3):
        web.places[m, x] = 0.5 * (web.places[a, x] + web.places[b, x])
    _set_face(web, f, a, m, c)
    _set_face(web, g, b, m, d)
    _set_face(web, f2, m, b, c)
    _set_face(web, g2, m, a, d)
    _link(web, 3 * f, 3 * g2)
    _link(web, 3 * f + 1, 3 * f2 + 2)
    _link(web, 3 * f + 2, beyond_ca)
    _link(web, 3 * g, 3 * f2)
    _link(web, 3 * g + 1, 3 * g2 + 2)
    _link(web, 3 * g + 2, beyond_db)
    _link(web, 3 * f2 + 1, beyond_bc)
    _link(web, 3 * g2 + 1, beyond_ad)
    pending[0], pending[1], pending[2], pending[3] = 3 * f + 2, 3 * f2 + 1, 3 * g2 + 1, 3 * g + 2


@jit(nopython=True, cache=True)
def _turn(web: Web, pending: Ints, n_pending: int, at_most: int) -> None:
    """Turn the pending edges that Delaunay would have otherwise, and then those around them, `at_most` so many."""
    n_turned = 0
    while n_pending > 0 and n_turned < at_most:
        n_pending -= 1
        h = pending[n_pending]
        if web.beyond[h] < 0 or not _is_better_turned(web, h):
            continue
        f, g = h // 3, web.beyond[h] // 3
        _turn_edge(web, h)
        n_turned += 1
        for around in (3 * f, 3 * f + 2, 3 * g, 3 * g + 1):
            if n_pending < len(pending):
                pending[n_pending] = around
                n_pending += 1


@jit(nopython=True, cache=True)
def _is_better_turned(web: Web, h: int) -> bool:
    """Whether an edge's other diagonal may be, and makes the smallest angle beside it wider.

    In a plane that is so where the two angles opposite to it are wider together than two right ones. In space that
    alone may go round in circles, while an edge turned here never comes again: smallest angles only grow.
    """
    o = web.beyond[h]
    a, b = _start(web, h), _start(web, o)
    c, d = _start(web, _following(_following(h))), _start(web, _following(_following(o)))
    if not _cotangent(web.places, c, a, b) + _cotangent(web.places, d, b, a) < 0.0 or _are_joined(web, c, d):
        return False
    sharpest = max(_sharpest(web.places, a, b, c), _sharpest(web.places, b, a, d))
    if not max(_sharpest(web.places, a, d, c), _sharpest(web.places, d, b, c)) < CLEARLY * sharpest:
        return False
    before = _cosine(area_vector(web.places, a, b, c), area_vector(web.places, b, a, d))
    after = _cosine(area_vector(web.places, a, d, c), area_vector(web.places, d, b, c))
    return after >= min(before, COS_SHARP)


@jit(nopython=True, cache=True)
def _sharpest(places: Floats, i: int, j: int, k: int) -> float:
    """Cotangent of the smallest angle of a triangle; infinite where it has no area."""
    return max(_cotangent(places, i, j, k), _cotangent(places, j, k, i), _cotangent(places, k, i, j))


@jit(nopython=True, cache=True)
def _cotangent(places: Floats, i: int, j: int, k: int) -> float:
    """Cotangent of the angle at i between j and k; infinite where the three lie in line."""
    e, g = way(places, i, j), way(places, i, k)
    along = e[0] * g[0] + e[1] * g[1] + e[2] * g[2]
    across = length_of(area_vector(places, i, j, k))
    if across > 0.0:
        return along / across
    return np.inf if along > 0.0 else -np.inf


@jit(nopython=True, cache=True)
def _cosine(u: Any, v: Any) -> float:
    """Cosine between two vectors; -1 where one has no length."""
    lengths = length_of(u) * length_of(v)
    return (u[0] * v[0] + u[1] * v[1] + u[2] * v[2]) / lengths if lengths > 0.0 else -1.0


@jit(nopython=True, cache=True)
def _are_joined(web: Web, c: int, d: int) -> bool:
    """Whether an edge of the span joins two vertices, or one of the mesh around two corners of the rim."""
    if c < len(web.is_taken) and d < len(web.is_taken) and web.is_taken[c, d]:
        return True
    first = web.at[c]
    h = first
    while True:  # on around c, the faces to the left
        before = _following(_following(h))
        if _start(web, _following(h)) == d or _start(web, before) == d:
            return True
        h = web.beyond[before]
        if h == first:
            return False
        if h < 0:
            break
    h = web.beyond[first]
    while h >= 0:  # and back from the first, as far as the rim
        h = _following(h)
        if _start(web, _following(h)) == d or _start(web, _following(_following(h))) == d:
            return True
        h = web.beyond[h]
    return False


@jit(nopython=True, cache=True)
def _turn_edge(web: Web, h: int) -> None:
    """Make the faces a b c and b a d those of the other diagonal, a d c and d b c."""
    o = web.beyond[h]
    f, g = h // 3, o // 3
    bc, ad = _following(h), _following(o)
    ca, db = _following(bc), _following(ad)
    a, b, c, d = _start(web, h), _start(web, o), _start(web, ca), _start(web, db)
    beyond_bc, beyond_ca, beyond_ad, beyond_db = web.beyond[bc], web.beyond[ca], web.beyond[ad], web.beyond[db]
    _set_face(web, f, a, d, c)
    _set_face(web, g, d, b, c)
    _link(web, 3 * f, beyond_ad)
    _link(web, 3 * f + 1, 3 * g + 2)
    _link(web, 3 * f + 2, beyond_ca)
    _link(web, 3 * g, beyond_db)
    _link(web, 3 * g + 1, beyond_bc)
