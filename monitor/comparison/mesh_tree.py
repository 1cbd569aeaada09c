"""A surface made ready for many questions: its faces in a tree of boxes and normal cones, and who touches whom.

The tree is complete and implicit: faces are sorted along a Morton curve, leaf k of n_leaves holds the faces
k m / n_leaves to (k + 1) m / n_leaves of that order, node i has the children 2 i + 1 and 2 i + 2. Nothing in it
depends on the number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import jit, prange

from monitor.comparison.triangles import cross, dot, sub
from projects.errors import ComparisonError
from projects.model import Bools, Floats, Ints, Surface

FACES_PER_LEAF = 2


class MeshTree(NamedTuple):  # a named tuple, since kernels take it whole
    """A mesh, its faces in the tree's order, in coordinates shifted by `shift` (global = local + shift).

    `nodes` (n_nodes, 10) float32: box low, box high (rounded outwards), axis of the normal cone, and the cosine
    below which no face of the node looks within the angle limit. `neighbours` (m, 3): face across the edges ab,
    bc, ca, -1 at a free edge. `star_starts`, `star_faces`: the faces around each vertex. `order`: face number in
    the surface as given.
    """

    vertices: Floats
    faces: Ints
    order: Ints
    shift: Floats
    nodes: Floats
    n_leaves: int
    neighbours: Ints
    star_starts: Ints
    star_faces: Ints
    vertex_normals: Floats
    is_border: Bools


def build_tree(surface: Surface, shift: Floats, max_angle: float) -> MeshTree:
    """Return the tree of a surface; `max_angle` [rad] between a vertex's and a face's normal is built into its cones.

    Raises
    ------
    ComparisonError
        Where the surface has no face with an area.
    """
    vertices = np.ascontiguousarray(surface.vertices - shift)
    faces = np.asarray(surface.faces)
    if not len(faces) or not np.isfinite(vertices[faces]).all():
        raise ComparisonError(f"a surface with {len(faces)} faces of finite vertices cannot be compared; give a mesh")
    centres = vertices[faces].mean(axis=1)
    order = np.argsort(morton_codes(centres), kind="stable")
    faces = np.ascontiguousarray(faces[order])
    n_leaves = 1 << max(int(np.ceil(np.log2(max(len(faces) / FACES_PER_LEAF, 1.0)))), 0)
    nodes = np.empty((2 * n_leaves - 1, 10), dtype=np.float32)
    half_angles = np.empty(2 * n_leaves - 1)
    _fill_leaves(vertices, faces, n_leaves, nodes, half_angles)
    _fill_inner(nodes, half_angles, n_leaves)
    nodes[:, 9] = np.where(half_angles + max_angle < np.pi, np.cos(half_angles + max_angle) - 1e-5, -2.0)
    neighbours = face_neighbours(faces)
    star_starts, star_faces = vertex_stars(faces, len(vertices))
    is_border = np.zeros(len(vertices), dtype=np.bool_)
    for k in range(3):
        free = neighbours[:, k] < 0
        is_border[faces[free, k]] = is_border[faces[free, (k + 1) % 3]] = True
    normals = angle_weighted_normals(vertices, faces)
    return MeshTree(vertices, faces, order, shift, nodes, n_leaves, neighbours, star_starts, star_faces,
                    normals, is_border)  # fmt: skip


def morton_codes(points: Floats) -> Ints:
    """Return the position of each point (n, 3) on a Morton curve through their bounding box, 21 bits an axis."""
    low = points.min(axis=0)
    extent = max(float((points.max(axis=0) - low).max()), 1e-300)
    cells = ((points - low) * ((2**21 - 1) / extent)).astype(np.uint64)
    code = np.zeros(len(points), dtype=np.uint64)
    for axis in range(3):
        spread = cells[:, axis]
        for step, mask in ((32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F),
                           (4, 0x10C30C30C30C30C3), (2, 0x1249249249249249)):  # fmt: skip
            spread = (spread | (spread << np.uint64(step))) & np.uint64(mask)
        code |= spread << np.uint64(axis)
    return code


def angle_weighted_normals(vertices: Floats, faces: Ints) -> Floats:
    """Return the unit pseudo-normal of each vertex (n, 3): face normals weighted by their angle there; 0 without faces.

    References
    ----------
    Baerentzen and Aanaes (2005), Signed distance computation using the angle weighted pseudonormal.
    """
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    total = np.zeros_like(vertices)
    for k in range(3):
        u, v = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        angle = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.einsum("ij,ij->i", u, v))
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, k], angle * normals[:, axis], minlength=len(vertices))
    return total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None]


def face_neighbours(faces: Ints) -> Ints:
    """Return the face across each edge ab, bc, ca (m, 3); -1 where the edge is free.

    Where more than two faces share an edge, they are taken in pairs in their order, the last with the first.
    """
    starts, ends = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    low, high = np.minimum(starts, ends).astype(np.int64), np.maximum(starts, ends).astype(np.int64)
    key = low * (int(faces.max()) + 1) + high
    order = np.argsort(key, kind="stable")
    sorted_key = key[order]
    first = np.concatenate(([True], sorted_key[1:] != sorted_key[:-1]))
    group_start = np.flatnonzero(first)
    size = np.diff(np.append(group_start, len(key)))
    group = np.cumsum(first) - 1
    following = np.arange(len(key)) + 1
    wrap = following == group_start[group] + size[group]
    following[wrap] = group_start[group[wrap]]
    neighbours = np.full(len(key), -1, dtype=np.int32)
    shared = size[group] > 1
    neighbours[order[shared]] = order[following[shared]] // 3
    return neighbours.reshape(-1, 3)


def vertex_stars(faces: Ints, n_vertices: int) -> tuple[Ints, Ints]:
    """Return starts (n + 1,) and faces (3 m,): the faces around vertex i are faces[starts[i]:starts[i + 1]]."""
    owners = faces.ravel()
    order = np.argsort(owners, kind="stable")
    starts = np.zeros(n_vertices + 1, dtype=np.int64)
    np.cumsum(np.bincount(owners, minlength=n_vertices), out=starts[1:])
    return starts, (order // 3).astype(np.int32)


@jit(nopython=True, parallel=True, cache=True)
def _fill_leaves(vertices, faces, n_leaves, nodes, half_angles):  # type: ignore[no-untyped-def]
    """Write the box and the normal cone of every leaf."""
    n_faces = len(faces)
    for leaf in prange(n_leaves):
        first, last = leaf * n_faces // n_leaves, (leaf + 1) * n_faces // n_leaves
        node = leaf + n_leaves - 1
        low, high, axis = np.full(3, np.inf), np.full(3, -np.inf), np.zeros(3)
        for f in range(first, last):
            n = _unit_normal(vertices, faces[f])
            for k in range(3):
                axis[k] += n[k]
                for corner in range(3):
                    low[k] = min(low[k], vertices[faces[f, corner], k])
                    high[k] = max(high[k], vertices[faces[f, corner], k])
        length = np.sqrt(dot(axis, axis))
        half = 0.0 if length > 0.0 else np.pi
        for f in range(first, last):
            n = _unit_normal(vertices, faces[f])
            if length > 0.0:
                half = max(half, np.arccos(min(max(dot(n, axis) / length, -1.0), 1.0)))
        half_angles[node] = half
        for k in range(3):
            margin = 1e-6 * max(abs(low[k]), abs(high[k]))  # float32 keeps seven digits
            nodes[node, k], nodes[node, 3 + k] = low[k] - margin, high[k] + margin
            nodes[node, 6 + k] = axis[k] / length if length > 0.0 else 0.0


@jit(nopython=True, cache=True)
def _fill_inner(nodes, half_angles, n_leaves):  # type: ignore[no-untyped-def]
    """Write the box and the normal cone of every inner node from its children."""
    axis = np.zeros(3)
    for node in range(n_leaves - 2, -1, -1):
        left, right = 2 * node + 1, 2 * node + 2
        for k in range(3):
            nodes[node, k] = min(nodes[left, k], nodes[right, k])
            nodes[node, 3 + k] = max(nodes[left, 3 + k], nodes[right, 3 + k])
            axis[k] = nodes[left, 6 + k] + nodes[right, 6 + k]
        length = np.sqrt(dot(axis, axis))
        half = np.pi
        if length > 0.0:
            half = 0.0
            for child in (left, right):
                cosine = dot(axis, nodes[child, 6:9]) / length
                half = max(half, np.arccos(min(max(cosine, -1.0), 1.0)) + half_angles[child])
        half_angles[node] = min(half, np.pi)
        for k in range(3):
            nodes[node, 6 + k] = axis[k] / length if length > 0.0 else 0.0


@jit(nopython=True, cache=True)
def _unit_normal(vertices, face):  # type: ignore[no-untyped-def]
    """Return the unit normal of a face; zeros where it has no area."""
    a = (vertices[face[0], 0], vertices[face[0], 1], vertices[face[0], 2])
    b = (vertices[face[1], 0], vertices[face[1], 1], vertices[face[1], 2])
    c = (vertices[face[2], 0], vertices[face[2], 1], vertices[face[2], 2])
    n = cross(sub(b, a), sub(c, a))
    length = np.sqrt(dot(n, n))
    if length == 0.0:
        return (0.0, 0.0, 0.0)
    return (n[0] / length, n[1] / length, n[2] / length)
