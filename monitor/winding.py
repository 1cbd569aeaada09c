"""The faces of a finished mesh, turned to look the way of those around them, and outward where that can be told.

In: a mesh as some program wrote it. Out: the same mesh with its faces turned, how many were, and whether all of it
still looks inward. Inside out, all that was lost from it would be told as added, and nothing of it would match a scan.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from monitor.blocks import blocks
from monitor.copied_faces import without_copied_faces
from projects.model import Bools, Floats, Ints, Surface
from projects.triangles import area_vectors

ENCLOSES = 0.25  # of a mesh's area: the sum of its faces' areas as vectors is 0 of a closed body, all of it of a sheet
N_ASKED = 200_000  # about so many faces or edges of a large mesh tell how it is wound
NARROWEST_ROOM = 1.2  # m: twice the shortest range of the instruments of this field; nobody scans a narrower one inside


@dataclass(frozen=True)
class Wound:
    """A mesh, how many of its faces were turned, and whether it looks inward, as a room does or one inside out."""

    surface: Surface
    n_turned: int
    looks_inward: bool


def wind_outward(mesh: Surface) -> Wound:
    """Return the mesh with its faces turned to look outward, each there once.

    Faces that hang together over edges of two faces each look the same way as the larger part of them does. A mesh that
    encloses something and looks inward is turned as a whole where it is narrower than a room; a wider one may be one,
    and stays. The mesh's own normals are kept only where nothing was turned.
    """
    mesh = without_copied_faces(mesh, either_way=True)
    turned = find_against_neighbours(mesh)
    faces = np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces)
    inward = encloses_inward(mesh.vertices, faces)
    is_room = inward and _is_wide_as_room(mesh.vertices, faces)
    if inward and not is_room:
        turned, faces = ~turned, faces[:, ::-1]
    n_turned = int(turned.sum())
    surface = replace(mesh, faces=faces, normals=None) if n_turned else mesh
    return Wound(surface, n_turned, is_room)


def find_against_neighbours(mesh: Surface) -> Bools:
    """Return which faces (m,) look against most of the area that hangs together with them.

    Two faces look the same way where they run along their common edge in opposite directions. Each face stands in the
    graph twice, as it is and turned; as it is it hangs together with one of both of each neighbour. What cannot be
    turned to agree (a band with a twist) stays as it is.
    """
    n_faces = len(mesh.faces)
    first, second, is_alike = _neighbours(mesh.faces)
    partner = np.where(is_alike, second, second + n_faces)
    mirrored = np.where(is_alike, second + n_faces, second)
    rows, columns = np.concatenate([first, first + n_faces]), np.concatenate([partner, mirrored])
    graph = coo_array((np.ones(len(rows), dtype=np.bool_), (rows, columns)), shape=(2 * n_faces, 2 * n_faces))
    _, label = connected_components(graph, directed=False)
    area = np.linalg.norm(area_vectors(mesh.vertices[mesh.faces]), axis=1)
    weight = np.bincount(label[:n_faces], area, minlength=int(label.max()) + 1)  # of the faces as they are
    return np.asarray(weight[label[:n_faces]] < weight[label[n_faces:]])


def is_inside_out(mesh: Surface) -> bool:
    """Return whether a mesh encloses something, looks into it, and is too narrow to be a room, as some faces all over a
    large one show."""
    faces = mesh.faces[:: max(len(mesh.faces) // N_ASKED, 1)]
    return encloses_inward(mesh.vertices, faces) and not _is_wide_as_room(mesh.vertices, faces)


def share_against(mesh: Surface) -> float:
    """Return of the edges of two faces each, of some all over a large mesh, the share, 0 to 1, along which one of both
    looks against the other; as large as twice that of the faces where these are few."""
    step, some = max(3 * len(mesh.faces) // (2 * N_ASKED), 1), []
    for block in blocks(len(mesh.faces)):
        for corners in ((0, 1), (1, 2), (2, 0)):
            ends = mesh.faces[block][:, corners]
            some.append(ends[ends.min(axis=1) % step == 0])
    ends = np.concatenate(some) if some else np.empty((0, 2), dtype=np.int32)
    one, other = _pair_edges(ends)
    return float(np.mean(ends[one, 0] == ends[other, 0])) if len(one) else 0.0


def _is_wide_as_room(vertices: Floats, faces: Ints) -> bool:
    """Return whether somebody may have scanned from within what faces enclose."""
    return float(np.ptp(vertices[np.unique(faces)], axis=0).min()) >= NARROWEST_ROOM


def _neighbours(faces: Ints) -> tuple[Ints, Ints, Bools]:
    """Return the pairs of faces (k,), (k,) that alone share an edge, and whether they look the same way (k,)."""
    ends = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    owner, runs_up = np.repeat(np.arange(len(faces)), 3), ends[:, 0] < ends[:, 1]
    one, other = _pair_edges(ends)
    return owner[one], owner[other], runs_up[one] != runs_up[other]


def _pair_edges(ends: Ints) -> tuple[Ints, Ints]:
    """Return which (k,) and which other (k,) of the edges of faces, from and to vertices (e, 2), are one and the same,
    of those that no third face has."""
    ends = np.sort(ends, axis=1)
    order = np.lexsort(ends.T)
    starts = np.flatnonzero(np.append(True, (ends[order[1:]] != ends[order[:-1]]).any(axis=1)))
    paired = starts[np.diff(np.append(starts, len(order))) == 2]
    return order[paired], order[paired + 1]


def encloses_inward(vertices: Floats, faces: Ints) -> bool:
    """Return whether faces enclose something, but for a base that is left open, and look into it.

    By the divergence theorem the sum of n'(p - c) over a closed body is three times its volume, negative where its
    faces look inward; about the middle of what there is of them an opening adds little.
    """
    vectors = area_vectors(vertices[faces])
    areas = np.linalg.norm(vectors, axis=1)
    if np.linalg.norm(vectors.sum(axis=0)) > ENCLOSES * areas.sum():
        return False
    middles = vertices[faces].mean(axis=1)
    middles -= np.average(middles, axis=0, weights=areas)
    return bool((vectors * middles).sum() < 0.0)
