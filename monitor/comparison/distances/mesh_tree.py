"""A surface made ready for many questions: its faces in a tree of boxes and normal cones, and who touches whom.

The tree is complete and implicit: faces are sorted along a Morton curve, every leaf holds a run of them, node i has the
children 2 i + 1 and 2 i + 2. Nothing in it depends on the number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import jit

from monitor.comparison.distances.stars import Mesh, Survey, face_normals, make_mesh, survey_vertices
from monitor.morton import Cells, face_order
from monitor.threads import run_tasks
from monitor.tuples import along, cross, dot, less, sub, unit
from projects.errors import ComparisonError
from projects.model import Bools, Floats, Ints, Surface

FACES_PER_LEAF = 4
BORDERED = 4.0  # as a half angle: of a node with a free edge, in place of any cone
WIDE = 1.4  # rad: half angle of a cone put together from two, from which on faces are asked themselves
MOST_LEAVES = 1 << 12  # of a node whose faces are
EACH = 3  # level of the tree, for what it takes: nodes between have the cone of the one above, if it is narrower


class MeshTree(NamedTuple):  # a named tuple, since kernels take it whole
    """A mesh (see `Mesh`), its faces in the tree's order, in coordinates less `shift` (global = local + shift).

    `nodes` (n_nodes, 11) float32: box low, box high (rounded outwards), axis of the normal cone, the cosine below which
    no face of the node looks within the angle limit, and the half angle [rad] of the cone that also holds the faces
    around the node's vertices, `BORDERED` where one is on the border. `order`: face number in the surface as given;
    `deepest`: the first node of the lowest level; `vertex_normals`, `areas` [m2], `is_border` of the vertices.
    """

    vertices: Floats
    faces: Ints
    star_starts: Ints
    star_faces: Ints
    shift: Floats
    order: Ints
    nodes: Floats
    n_leaves: int
    deepest: int
    vertex_normals: Floats
    areas: Floats
    is_border: Bools


def build_tree(surface: Surface, shift: Floats, max_angle: float, cells: Cells | None = None) -> MeshTree:
    """Return the tree of a surface; `max_angle` [rad] between a vertex's and a face's normal is built into its cones.

    `cells` are those that its faces are ordered by, of the box of its vertices where left out; see `face_order`.

    Raises
    ------
    ComparisonError
        Where the surface has no face with an area.
    """
    vertices, faces = require_faces(surface)
    order = face_order(vertices, faces, shift, cells)
    mesh = make_mesh(vertices, faces[order], shift)
    return grow_tree(mesh, order, survey_vertices(mesh), max_angle)


def grow_tree(mesh: Mesh, order: Ints, survey: Survey, max_angle: float) -> MeshTree:
    """Return the tree of a mesh whose faces come in the tree's order; see `build_tree`."""
    n_leaves = -(-len(mesh.faces) // FACES_PER_LEAF)
    nodes = np.empty((2 * n_leaves - 1, 11), dtype=np.float32)
    deepest = (1 << (len(nodes).bit_length() - 1)) - 1
    tree = MeshTree(*mesh, order, nodes, n_leaves, deepest, survey.normals, survey.areas, survey.is_border)
    half_angles = np.empty(len(nodes), dtype=np.float32)
    looks = face_normals(mesh)
    run_tasks(_fill_leaves, n_leaves, tree, looks, half_angles)
    _fill_inner(tree, looks, half_angles)
    nodes[:, 9] = np.where(half_angles + max_angle < np.pi, np.cos(half_angles + max_angle) - 1e-5, -2.0)
    return tree


def require_faces(surface: Surface) -> tuple[Floats, Ints]:
    """Return vertices and faces; raise `ComparisonError` where there is no face, or one that is not finite."""
    vertices, faces = np.ascontiguousarray(surface.vertices), np.asarray(surface.faces)
    if not len(faces) or not (np.isfinite(vertices).all() or np.isfinite(vertices[faces]).all()):
        raise ComparisonError(f"a surface with {len(faces)} faces of finite vertices cannot be compared; give a mesh")
    return vertices, faces


@jit(nopython=True, cache=True, forceinline=True)
def leaf_of_node(deepest, n_leaves, node):  # type: ignore[no-untyped-def]
    """Return which leaf, from left to right, a node at the bottom of the tree is: the deepest level comes first."""
    return node - deepest if node >= deepest else node - deepest + n_leaves


@jit(nopython=True, cache=True, forceinline=True)
def node_of_leaf(deepest, n_leaves, leaf):  # type: ignore[no-untyped-def]
    """Return the node of a leaf."""
    node = leaf + deepest
    return node if node < 2 * n_leaves - 1 else node - n_leaves


@jit(nopython=True, cache=True, nogil=True)
def _fill_leaves(begin, end, tree, looks, half_angles):  # type: ignore[no-untyped-def]
    """Write the box and the normal cones of the leaves from `begin` to `end`."""
    nodes, faces, vertices, shift, n_faces = tree.nodes, tree.faces, tree.vertices, tree.shift, len(tree.faces)
    own, seen = np.empty((FACES_PER_LEAF, 3)), np.empty(3 * FACES_PER_LEAF, dtype=np.int64)
    for leaf in range(begin, end):
        node = node_of_leaf(tree.deepest, tree.n_leaves, leaf)
        low, high, axis = (np.inf, np.inf, np.inf), (-np.inf, -np.inf, -np.inf), (0.0, 0.0, 0.0)
        first, last = leaf * FACES_PER_LEAF, min((leaf + 1) * FACES_PER_LEAF, n_faces)
        for f in range(first, last):
            a, b, c = (
                less(vertices, faces[f, 0], shift),
                less(vertices, faces[f, 1], shift),
                less(vertices, faces[f, 2], shift),
            )
            normal = unit(cross(sub(b, a), sub(c, a)))
            own[f - first, 0], own[f - first, 1], own[f - first, 2] = normal
            axis = along(axis, 1.0, normal)
            for p in (a, b, c):
                low = (min(low[0], p[0]), min(low[1], p[1]), min(low[2], p[2]))
                high = (max(high[0], p[0]), max(high[1], p[1]), max(high[2], p[2]))
        length = np.sqrt(dot(axis, axis))
        half = around = np.pi
        if length > 0.0:
            least, least_around, n_seen, touches_border = np.inf, np.inf, 0, False
            for f in range(first, last):
                least = min(least, _along(axis, own, f - first))
                for corner in range(3):
                    v, is_new = np.int64(faces[f, corner]), True
                    for k in range(n_seen):
                        is_new &= seen[k] != v
                    if not is_new:
                        continue
                    seen[n_seen] = v
                    n_seen += 1
                    touches_border |= tree.is_border[v]
                    for k in range(tree.star_starts[v], tree.star_starts[v + 1]):
                        least_around = min(least_around, _along(axis, looks, tree.star_faces[k]))
            half = _angle(min(least / length, 1.0))
            around = _angle(min(least_around / length, 1.0) - 1e-6)  # float32 keeps seven digits
            around = BORDERED if touches_border else around
        half_angles[node], nodes[node, 10] = half, around
        for k in range(3):
            margin = 1e-6 * max(abs(low[k]), abs(high[k]))  # float32 keeps seven digits
            nodes[node, k], nodes[node, 3 + k] = low[k] - margin, high[k] + margin
            nodes[node, 6 + k] = axis[k] / length if length > 0.0 else 0.0


def _fill_inner(tree: MeshTree, looks: Floats, half_angles: Floats) -> None:
    """Write the box and the normal cones of every inner node from its children, level by level from below."""
    n_inner = tree.n_leaves - 1
    first = (tree.deepest - 1) // 2  # of the level above the deepest
    while n_inner > 0 and first >= 0:
        n = min(2 * first + 1, n_inner) - first
        if n > 0:
            run_tasks(_join_children, n, first, tree, looks, half_angles)
        if first == 0:
            break
        first = (first - 1) // 2
    _hand_down(tree.nodes, half_angles)


@jit(nopython=True, cache=True, nogil=True)
def _hand_down(nodes, half_angles):  # type: ignore[no-untyped-def]
    """Give each node with a wide cone that of the node above, which holds its faces too, where it is narrower."""
    for node in range(1, len(nodes)):
        above = (node - 1) // 2
        if nodes[node, 10] > max(nodes[above, 10], WIDE):
            half_angles[node] = half_angles[above]
            for k in range(6, 11):
                nodes[node, k] = nodes[above, k]


@jit(nopython=True, cache=True, nogil=True)
def _join_children(begin, end, first, tree, looks, half_angles):  # type: ignore[no-untyped-def]
    """Write the box and the cones of the nodes from first + begin to first + end."""
    nodes = tree.nodes
    for node in range(first + begin, first + end):
        left, right = 2 * node + 1, 2 * node + 2
        for k in range(3):
            nodes[node, k] = min(nodes[left, k], nodes[right, k])
            nodes[node, 3 + k] = max(nodes[left, 3 + k], nodes[right, 3 + k])
        a, b = _axis_of(nodes, left), _axis_of(nodes, right)
        axis = along(a, 1.0, b)
        length = np.sqrt(dot(axis, axis))
        half, around = np.pi, np.pi
        if length > 0.0:
            to_left, to_right = _angle(dot(axis, a) / length), _angle(dot(axis, b) / length)
            half = max(to_left + half_angles[left], to_right + half_angles[right])
            around = max(to_left + nodes[left, 10], to_right + nodes[right, 10])
        half_angles[node], nodes[node, 10] = min(half, np.pi), min(around, np.pi)
        for k in range(3):
            nodes[node, 6 + k] = axis[k] / length if length > 0.0 else 0.0
        if max(nodes[left, 10], nodes[right, 10]) == BORDERED:
            nodes[node, 10] = BORDERED
        elif around > WIDE:
            _narrow_cones(tree, node, looks, half_angles)


@jit(nopython=True, cache=True)
def _narrow_cones(tree, node, looks, half_angles):  # type: ignore[no-untyped-def]
    """Write the cones of a node from its faces, about the mean of their normals, where they are narrower than those of
    its children together: on a rough surface angles that are added up soon reach all around."""
    n_inner, low, high = tree.n_leaves - 1, node, node
    while low < n_inner:
        low = 2 * low + 1
    while high < n_inner:
        high = 2 * high + 2
    low, high = leaf_of_node(tree.deepest, tree.n_leaves, low), leaf_of_node(tree.deepest, tree.n_leaves, high)
    if high - low >= MOST_LEAVES or _bits_of(high - low) % EACH != 1:
        return
    first, last = low * FACES_PER_LEAF, min((high + 1) * FACES_PER_LEAF, len(tree.faces))
    axis = (0.0, 0.0, 0.0)
    for f in range(first, last):
        axis = along(axis, 1.0, (np.float64(looks[f, 0]), np.float64(looks[f, 1]), np.float64(looks[f, 2])))
    length = np.sqrt(dot(axis, axis))
    if length == 0.0:
        return
    axis = (axis[0] / length, axis[1] / length, axis[2] / length)
    least = least_around = 1.0
    for f in range(first, last):
        least = min(least, _along(axis, looks, f))
        for corner in range(3):
            v = tree.faces[f, corner]
            if tree.is_border[v]:
                tree.nodes[node, 10] = BORDERED
                return
            k, end = tree.star_starts[v], tree.star_starts[v + 1]
            while tree.star_faces[k] < first:
                k += 1
            if tree.star_faces[k] != f:  # each vertex once, from the first of its faces in the node
                continue
            for k in range(tree.star_starts[v], end):
                least_around = min(least_around, _along(axis, looks, tree.star_faces[k]))
    around = _angle(least_around - 1e-6)
    if around < tree.nodes[node, 10]:
        half_angles[node], tree.nodes[node, 10] = _angle(least - 1e-6), around
        for k in range(3):
            tree.nodes[node, 6 + k] = axis[k]


@jit(nopython=True, cache=True, forceinline=True)
def _bits_of(n):  # type: ignore[no-untyped-def]
    """Return how many bits a whole number has."""
    level = 0
    while n > 0:
        n, level = n >> 1, level + 1
    return level


@jit(nopython=True, cache=True)
def _axis_of(nodes, i):  # type: ignore[no-untyped-def]
    """Return the axis (3,) of the cone of normals below node i."""
    return (np.float64(nodes[i, 6]), np.float64(nodes[i, 7]), np.float64(nodes[i, 8]))


@jit(nopython=True, cache=True, forceinline=True)
def _along(axis, looks, f):  # type: ignore[no-untyped-def]
    """Return how far the normal of face f reaches along an axis, times the axis's length."""
    return axis[0] * looks[f, 0] + axis[1] * looks[f, 1] + axis[2] * looks[f, 2]


@jit(nopython=True, cache=True)
def _angle(cosine):  # type: ignore[no-untyped-def]
    """Return the angle [rad] of a cosine, rounded upwards as far as float32 needs."""
    return np.arccos(min(max(cosine, -1.0), 1.0)) + 1e-6
