"""What lies straight under, or over, a region of the other surface, though a nearer part of that decides what it is.

Ground that a panel was put on, next to the panel's side, is nearest to the foot of that side, or to the end of what was
seen there, and has no perpendicular that is assessed. Its way along its normal still meets the panel's face: it is of
the body between the surfaces, which would else be closed aslant, from where the perpendiculars end.
"""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.comparison.enclosure import SIGNS
from monitor.comparison.feet import local_point
from monitor.comparison.mesh_tree import MeshTree, build_tree
from monitor.comparison.search import DEPTH, first_crossing
from monitor.comparison.side import Side
from monitor.comparison.spreading import spread_along
from monitor.threads import run_tasks
from projects.model import Floats, Ints, NotAssessed, Surface

ANY_ANGLE = np.pi  # faces of a tree that is asked for crossings alone may look any way


def take_covered(sides: tuple[Side, Side], regions: tuple[Ints, Ints], signs: Floats,
                 limit: float) -> tuple[Ints, Ints]:  # fmt: skip
    """Return the regions (n,) of both sides with what they cover of the other one.

    A vertex that is not assessed and of no region is covered where its way along its normal, to the side on which the
    change of the region lies (`signs` (r + 1,)), first meets within `limit` [m] a face of that region which looks as
    the vertex does. It must hang together with the region along its own surface: the wall far behind a chest that
    gained is under it too, but no end of what came.
    """
    out = []
    for k, side in enumerate(sides):
        own = regions[k].copy()
        for sign in SIGNS:
            faces = _faces_of(sides[1 - k], regions[1 - k], signs == sign)
            if len(faces) and (own > 0).any():
                _take(
                    side, own, _regions_ahead(side, own, sides[1 - k], regions[1 - k], faces, -sign * SIGNS[k] * limit)
                )
        out.append(own)
    return out[0], out[1]


def _faces_of(side: Side, region: Ints, fitting: Ints) -> Ints:
    """Return the faces (m, 3) of a side whose corners are all of one region that fits (r + 1,)."""
    faces = np.asarray(side.surface.faces)
    first = region[faces[:, 0]]
    return faces[(first > 0) & fitting[first] & (region[faces[:, 1]] == first) & (region[faces[:, 2]] == first)]


def _regions_ahead(side: Side, own: Ints, other: Side, regions: Ints, faces: Ints, way: float) -> Ints:
    """Return the region (n,) of the face that each vertex without one first meets `way` [m] along its normal, if that
    looks as it does; 0 where none."""
    out = np.zeros(len(own), dtype=own.dtype)
    corners, numbers = np.unique(faces, return_inverse=True)
    patch = Surface(other.surface.vertices[corners], numbers.reshape(-1, 3).astype(np.int32))
    low, high = patch.vertices.min(axis=0) - abs(way), patch.vertices.max(axis=0) + abs(way)
    points = side.surface.vertices
    is_asked = ~side.is_assessed & (own == 0) & (side.reasons != NotAssessed.NO_ONE_SURFACE)
    which = np.flatnonzero(is_asked & ((points >= low) & (points <= high)).all(axis=1))
    if not len(which):
        return out
    tree = build_tree(patch, low, ANY_ANGLE)
    met = np.full(len(which), -1, dtype=np.int64)
    ahead = way * side.normals[which]
    run_tasks(_write_met, len(which), tree, np.ascontiguousarray(points[which]), ahead, met)
    a, b, c = (patch.vertices[patch.faces[tree.order[met]][:, k]] for k in range(3))
    looks_alike = np.einsum("ij,ij->i", np.cross(b - a, c - a), side.normals[which]) > 0.0
    out[which] = np.where((met >= 0) & looks_alike, regions[corners[patch.faces[tree.order[met], 0]]], 0)
    return out


def _take(side: Side, own: Ints, ahead: Ints) -> None:
    """Give vertices the region `ahead` (n,) of them, where they hang together with it."""
    seeds = np.flatnonzero(own > 0)
    source = spread_along(side, seeds, (own > 0) | (ahead > 0), np.inf)
    taken = (own == 0) & (ahead > 0) & (source >= 0)
    taken[taken] = own[source[taken]] == ahead[taken]
    own[taken] = ahead[taken]


@jit(nopython=True, cache=True, nogil=True)
def _write_met(first, last, tree: MeshTree, points, ahead, met):  # type: ignore[no-untyped-def]
    """Write the face, in the tree's order, that each point first meets on its way ahead, -1 for none."""
    stack = np.empty(DEPTH, dtype=np.int64)
    for i in range(first, last):
        met[i] = first_crossing(
            tree, local_point(tree.shift, points, i), (ahead[i, 0], ahead[i, 1], ahead[i, 2]), stack
        )
