"""Finished surfaces in (photogrammetry, CAD): PLY, OBJ, STL and GLB as a `Surface` in metres."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from projects.errors import FormatError
from projects.formats.parsing import ReadLimits, ask_child
from projects.formats.precision import require_precision
from projects.formats.rawscan import Columns
from projects.formats.sniffing import sniff_format
from projects.formats.units import require_unit
from projects.model import Surface

PARTED = 1e-3  # of the median edge: corners of free edges nearer each other were one before they were rounded
MESH_FORMATS = ("ply", "obj", "stl", "glb")


@dataclass(frozen=True)
class MeshFile:
    """A mesh as it was read, and how many of what it holds besides were left out, by what they are."""

    surface: Surface
    dropped: dict[str, int]


def read_mesh(path: Path, *, unit: float = 1.0, limits: ReadLimits | None = None) -> Surface:
    """Return the triangle mesh of a file, as `read_counted_mesh` does, without what was left out."""
    return read_counted_mesh(path, unit=unit, limits=limits).surface


def read_counted_mesh(path: Path, *, unit: float = 1.0, limits: ReadLimits | None = None) -> MeshFile:
    """Return the triangle mesh of a file, polygons cut into triangles; triangles without three corners and vertices of
    no triangle are left out and counted.

    Corners at exactly one place, and those of free edges that all but touch, are one vertex: files with textures part
    them along seams, others part all faces, and each seam would be a free edge.

    Parameters
    ----------
    path : PLY, OBJ, STL or GLB; parsed in a child process with `limits`.
    unit : metres per unit of the file.

    Raises
    ------
    FormatError
        Another format, a broken file, no faces, faces that name vertices that are not there, corners not finite, or in
        single precision where that is coarser than a scanner's noise.
    """
    path, limits = Path(path), limits or ReadLimits()
    require_unit(unit)
    format_name = sniff_format(path)
    if format_name not in MESH_FORMATS:
        raise FormatError(f"{path}: {format_name.upper()} holds no mesh; PLY, OBJ, STL or GLB is needed")
    pieces: list[Columns] = [columns for _, columns in ask_child(path, {"format": format_name, "job": "mesh"}, limits)]
    vertices = _joined([piece for piece in pieces if "points" in piece])
    faces = {"faces": np.empty((0, 3), np.int64)} | _joined([piece for piece in pieces if "faces" in piece])
    n_vertices, n_faces = len(vertices.get("points", ())), len(faces["faces"])
    faces = _true_triangles(path, faces, n_vertices)
    vertices, faces["faces"] = _only_corners(vertices, faces["faces"])
    n_alone = n_vertices - len(vertices["points"])
    _require_places(path, vertices["points"])
    require_precision(vertices["points"], unit, str(path))
    for join in (_joined_at_seams, _joined_where_parted):
        vertices, faces["faces"] = join(vertices, faces["faces"])
        faces = _true_triangles(path, faces, len(vertices["points"]))
    dropped = {"vertices_of_no_triangle": n_alone, "triangles_without_three_corners": n_faces - len(faces["faces"])}
    return MeshFile(_surface(vertices, faces, unit), {what: n for what, n in dropped.items() if n})


def _joined(pieces: list[Columns]) -> Columns:
    """Return pieces one after another."""
    names = pieces[0] if pieces else {}
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in names}


def _true_triangles(path: Path, faces: Columns, n_vertices: int) -> Columns:
    """Return the faces with three different corners; raise where one names a vertex that is not there."""
    corners = faces["faces"]
    if len(corners) and (corners.min() < 0 or corners.max() >= n_vertices):
        raise FormatError(
            f"{path}: its faces name vertices {corners.min()} to {corners.max()}; it has 0 to {n_vertices - 1}"
        )
    a, b, c = corners.T
    is_true = (a != b) & (b != c) & (c != a)
    if not is_true.any():
        raise FormatError(f"{path}: holds no faces with three different corners")
    return {name: values[is_true] for name, values in faces.items()}


def _only_corners(vertices: Columns, faces: np.ndarray) -> tuple[Columns, np.ndarray]:
    """Return vertices and faces without the vertices of no face: others would measure them as part of the surface."""
    used, places = np.unique(faces, return_inverse=True)
    return {name: values[used] for name, values in vertices.items()}, places.reshape(-1, 3)


def _require_places(path: Path, corners: np.ndarray) -> None:
    """Raise where corners of faces (n, 3) are not finite, or all at one place."""
    if not np.isfinite(corners).all():
        raise FormatError(f"{path}: has faces with corners that are not finite; the file is broken")
    if (corners == corners[0]).all():
        raise FormatError(f"{path}: all its corners lie at one place; the file is broken")


def _joined_at_seams(vertices: Columns, faces: np.ndarray) -> tuple[Columns, np.ndarray]:
    """Return vertices and faces with those at exactly one place as one: the first, its normal the mean of all."""
    points = vertices["points"]
    order = np.lexsort(points.T)
    is_new = np.ones(len(points), dtype=bool)
    is_new[1:] = (points[order[1:]] != points[order[:-1]]).any(axis=1)
    first = np.empty(len(points), dtype=np.int64)
    first[order] = order[is_new][np.cumsum(is_new) - 1]  # the sort is stable, so the first in the file
    return _joined_as(vertices, faces, first)


def _joined_where_parted(vertices: Columns, faces: np.ndarray) -> tuple[Columns, np.ndarray]:
    """Return vertices and faces with those of free edges that all but touch as one.

    Programs that move or round the corners of each face by itself part them by some 1e-7 of their coordinates; each
    would lie on a free edge, where nothing is compared. Only free edges are joined, and over much less than an edge.
    """
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, n_faces = np.unique(ends, axis=0, return_counts=True)
    free, points = np.unique(edges[n_faces == 1]), vertices["points"]
    near = PARTED * float(np.median(np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)))
    pairs = free[cKDTree(points[free]).query_pairs(near, output_type="ndarray")] if len(free) else edges[:0]
    if not len(pairs):
        return vertices, faces
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    _, group = connected_components(links, directed=False)
    _, first = np.unique(group, return_index=True)
    return _joined_as(vertices, faces, first[group])


def _joined_as(vertices: Columns, faces: np.ndarray, first: np.ndarray) -> tuple[Columns, np.ndarray]:
    """Return vertices and faces with each vertex as `first` (n,) says, the normal the mean of all that became one."""
    kept, place = np.unique(first, return_inverse=True)
    if len(kept) == len(first):
        return vertices, faces
    joined = {name: values[kept] for name, values in vertices.items()}
    if "normals" in vertices:
        total = np.stack([np.bincount(place, column, len(kept)) for column in vertices["normals"].T], axis=1)
        length = np.linalg.norm(total, axis=1, keepdims=True)
        joined["normals"] = np.divide(total, length, out=joined["normals"].astype(float), where=length > 0.0)
    return joined, place[faces]


def _surface(vertices: Columns, faces: Columns, unit: float) -> Surface:
    """Return the surface in metres."""
    known: dict[str, np.ndarray] = {
        name: vertices[name] for name in ("normals", "intensity", "colors") if name in vertices
    }
    if faces.get("invented", np.zeros(0)).any():
        known["face_invented"] = faces["invented"] != 0
    return Surface(vertices=vertices["points"] * unit, faces=faces["faces"], **known)
