"""What lies ahead: the face of a patch of surface that a way meets first.

In: faces of one side, ways from points. Out: which of the faces each way meets first. The patch gets a tree of its own;
those of the whole surfaces are given back before regions are looked at.
"""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.comparison.distances.mesh_tree import MeshTree, build_tree
from monitor.comparison.distances.search import DEPTH, first_crossing
from monitor.comparison.distances.side import Side
from monitor.threads import run_tasks
from monitor.tuples import less
from projects.model import Bools, Floats, Ints, Surface
from projects.triangles import area_vectors, face_areas

ANY_ANGLE = np.pi  # faces of a tree that is asked for crossings alone may look any way
AT_ONCE = 1e-6  # of a way: what it starts on is not ahead of it
STEEP = 0.5  # the cosine to a face's normal from which on a way goes through the surface, and does not follow it


def first_met(vertices: Floats, faces: Ints, points: Floats, ahead: Floats, start: float = 0.0) -> Ints:
    """Return which of the faces (f, 3), of some area each, the ways `ahead` (m, 3) from points (m, 3) meet first, (m,),
    -1 where none, from a share `start` of them on."""
    corners, numbers = np.unique(faces, return_inverse=True)
    patch = Surface(vertices[corners], numbers.reshape(-1, 3).astype(np.int32))
    tree = build_tree(patch, patch.vertices.min(axis=0), ANY_ANGLE)
    met = np.full(len(points), -1, dtype=np.int64)
    run_tasks(_write_met, len(points), tree, np.ascontiguousarray(points), np.ascontiguousarray(ahead), start, met)
    return np.where(met >= 0, tree.order[met], -1)


def are_hidden(side: Side, which: Ints, places: Floats) -> Bools:
    """Return which of some vertices (m,) of a side their own surface hides from places (m, 3): their ways there meet
    one of its faces, and not aslant as they do where they follow it."""
    points = side.surface.vertices[which]
    ways = places - points
    faces = _faces_within(side, np.minimum(points, places).min(axis=0), np.maximum(points, places).max(axis=0))
    if not len(faces):
        return np.zeros(len(which), dtype=np.bool_)
    met = first_met(side.surface.vertices, faces, points, ways, AT_ONCE)
    normals = area_vectors(side.surface.vertices[faces[met]])
    along = np.abs(np.einsum("ij,ij->i", normals, ways))
    steep = along > STEEP * np.linalg.norm(normals, axis=1) * np.linalg.norm(ways, axis=1)
    return np.asarray((met >= 0) & steep)


def _faces_within(side: Side, low: Floats, high: Floats) -> Ints:
    """Return the faces (f, 3) of a side, of some area, that have a corner in a box."""
    vertices, faces = side.surface.vertices, np.asarray(side.surface.faces)
    inside: Bools = np.all((vertices >= low) & (vertices <= high), axis=1)
    faces = faces[inside[faces].any(axis=1)]
    return faces[face_areas(vertices[faces]) > 0.0]


@jit(nopython=True, cache=True, nogil=True)
def _write_met(first, last, tree: MeshTree, points, ahead, start, met):  # type: ignore[no-untyped-def]
    """Write the face, in the tree's order, that each point first meets on its way ahead, -1 for none."""
    stack = np.empty(DEPTH, dtype=np.int64)
    for i in range(first, last):
        way = (ahead[i, 0], ahead[i, 1], ahead[i, 2])
        met[i] = first_crossing(tree, less(points, i, tree.shift), way, (start, 1.0), stack)
