"""Nouns to and from the libraries that a notebook goes on with: trimesh, pyvista, pandas, Open3D.

What is known of each point or vertex goes along under the names of `projects.model`; what a library has no place for
is left out. Coordinates, units and signs do not change. Arrays are copied.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from projects.errors import ParameterError, ShapeError
from projects.model import ComparedSurface, Floats, PointCloud, Surface
from projects.open3d_library import load_open3d

if TYPE_CHECKING:
    import pyvista
    import trimesh

NAMES = {
    "points": ("x", "y", "z"),
    "vertices": ("x", "y", "z"),
    "normals": ("nx", "ny", "nz"),
    "origins": ("origin_x", "origin_y", "origin_z"),
    "colors": ("red", "green", "blue"),
}
COMPARED = ("distances", "lod95", "assessment", "region", "reasons", "told_from")
READ = {"Normals": "normals", "RGB": "colors", "RGBA": "colors"}  # as pyvista's readers and filters name them
AS_MADE = 1e-6  # how far normals that follow from the faces come out apart, as rounded by files and motions
INVENTED, COARSE = "face_invented", "coarse_from"  # of each face, and of a whole side


def _known(noun: PointCloud | Surface | ComparedSurface, n: int) -> dict[str, Any]:
    """Return every array of a noun that has one row a point, by name; a shared origin is repeated."""
    known = {}
    for field in dataclasses.fields(noun):
        values = getattr(noun, field.name)
        if field.name == "origins" and values is not None and values.ndim == 1:
            values = np.tile(values, (n, 1))
        if isinstance(values, np.ndarray) and field.name not in ("faces", INVENTED):
            known[field.name] = values.copy()
    return known


def cloud_to_pandas(cloud: PointCloud) -> pd.DataFrame:
    """Return a table with one row a point: x y z, then what is known (nx ny nz, red green blue, sigma, ...)."""
    return _table(_known(cloud, len(cloud)))


def surface_to_pandas(surface: Surface) -> pd.DataFrame:
    """Return a table with one row a vertex: x y z, then what is known. Faces are left out."""
    return _table(_known(surface, len(surface.vertices)))


def compared_to_pandas(compared: ComparedSurface) -> pd.DataFrame:
    """Return a table with one row a vertex: the surface's columns, then distances, lod95, assessment and so on."""
    table = surface_to_pandas(compared.surface)
    return table.assign(**_changes(compared))


def _changes(compared: ComparedSurface) -> dict[str, Any]:
    """Return the arrays of a compared surface that are known, by name."""
    return {name: values.copy() for name in COMPARED if (values := getattr(compared, name)) is not None}


def _table(known: dict[str, Any]) -> pd.DataFrame:
    """Return arrays as columns, vectors under the names of their parts."""
    columns: dict[str, Any] = {}
    for name, values in known.items():
        parts = NAMES.get(name)
        columns |= {name: values} if parts is None else {part: values[:, k] for k, part in enumerate(parts)}
    return pd.DataFrame(columns)


def cloud_from_pandas(table: pd.DataFrame) -> PointCloud:
    """Return a cloud from a table with the columns x y z and any of those that `cloud_to_pandas` writes.

    Raises
    ------
    ShapeError
        A column of x y z is missing.
    """
    missing = [name for name in NAMES["points"] if name not in table]
    if missing:
        raise ShapeError(f"the table lacks the columns {', '.join(missing)}; x, y, z [m] are needed")
    known: dict[str, Any] = {}
    for field in dataclasses.fields(PointCloud):
        parts = list(NAMES.get(field.name, (field.name,)))
        if all(part in table for part in parts):
            values = table[parts].to_numpy()
            known[field.name] = values if field.name in NAMES else values[:, 0]
    return PointCloud(**known)


def cloud_to_trimesh(cloud: PointCloud) -> trimesh.PointCloud:
    """Return a `trimesh.PointCloud` with colours where known; it has no place for more."""
    import trimesh

    opaque = None if cloud.colors is None else np.c_[cloud.colors, np.full(len(cloud), 255, np.uint8)]
    return trimesh.PointCloud(cloud.points.copy(), colors=opaque)


def cloud_from_trimesh(converted: trimesh.PointCloud) -> PointCloud:
    """Return a cloud from a `trimesh.PointCloud` (metres), with colours where it has them."""
    import trimesh

    if not isinstance(converted, trimesh.PointCloud):
        raise ParameterError(f"what a cloud is made of is a {type(converted).__name__}; a trimesh.PointCloud is needed")
    colors = np.array(converted.colors)[:, :3] if len(converted.colors) else None
    return PointCloud(points=np.array(converted.vertices), colors=colors)


def surface_to_trimesh(surface: Surface) -> trimesh.Trimesh:
    """Return a `trimesh.Trimesh`, vertices in the same order; what else is known as `vertex_attributes`."""
    import trimesh

    known = _known(surface, len(surface.vertices))
    colors = known.pop("colors", None)
    mesh = trimesh.Trimesh(
        known.pop("vertices"), surface.faces.copy(), vertex_normals=known.pop("normals", None), process=False,
        vertex_colors=None if colors is None else np.c_[colors, np.full(len(colors), 255, np.uint8)],
    )  # fmt: skip
    mesh.vertex_attributes.update(known)
    if surface.face_invented is not None:
        mesh.face_attributes[INVENTED] = surface.face_invented.copy()
    return mesh


def surface_from_trimesh(mesh: trimesh.Trimesh) -> Surface:
    """Return a surface from a `trimesh.Trimesh` (metres), with its own vertex normals, colours and known attributes.

    All vertices stay, in their order. Normals that trimesh makes of the faces are none of its own.

    Raises
    ------
    ParameterError
        What was given is no `trimesh.Trimesh`, as the scene that `trimesh.load` returns of some files.
    """
    import trimesh

    if not isinstance(mesh, trimesh.Trimesh):
        hint = "; a scene.to_mesh() is one" if isinstance(mesh, trimesh.Scene) else ""
        raise ParameterError(f"what a surface is made of is a {type(mesh).__name__}; a trimesh.Trimesh is needed{hint}")
    names = {field.name for field in dataclasses.fields(Surface)} - {"vertices", "faces", INVENTED}
    known = {name: np.array(values) for name, values in mesh.vertex_attributes.items() if name in names}
    normals = _stated_normals(mesh)
    if normals is not None:
        known.setdefault("normals", normals)
    if INVENTED in mesh.face_attributes:
        known[INVENTED] = np.array(mesh.face_attributes[INVENTED])
    if mesh.visual.kind == "vertex":
        known["colors"] = np.asarray(mesh.visual.vertex_colors)[:, :3]
    return Surface(vertices=np.array(mesh.vertices), faces=np.array(mesh.faces), **known)


def _stated_normals(mesh: trimesh.Trimesh) -> Floats | None:
    """Return the vertex normals (n, 3) that a mesh states; None where it has only those that follow from its faces,
    which are zero at vertices of no face."""
    stated = np.array(mesh.vertex_normals)
    made = mesh.copy().vertex_normals  # a copy keeps vertices and faces alone
    return None if np.allclose(stated, made, rtol=0.0, atol=AS_MADE) else stated


def cloud_to_pyvista(cloud: PointCloud) -> pyvista.PolyData:
    """Return a `pyvista.PolyData` of points; what is known as point data."""
    import pyvista

    known = _known(cloud, len(cloud))
    return _with_point_data(pyvista.PolyData(known.pop("points")), known)


def surface_to_pyvista(surface: Surface) -> pyvista.PolyData:
    """Return a `pyvista.PolyData` of triangles; what is known of vertices as point data, of faces as cell data."""
    import pyvista

    known = _known(surface, len(surface.vertices))
    mesh = _with_point_data(pyvista.PolyData.from_regular_faces(known.pop("vertices"), surface.faces), known)
    if surface.face_invented is not None:
        mesh.cell_data[INVENTED] = surface.face_invented.copy()
    return mesh


def compared_to_pyvista(compared: ComparedSurface) -> pyvista.PolyData:
    """Return one side of a comparison as triangles, with distances, lod95, assessment and so on as point data, and
    `coarse_from` as field data."""
    mesh = _with_point_data(surface_to_pyvista(compared.surface), _changes(compared))
    mesh.field_data[COARSE] = [compared.coarse_from]
    return mesh


def _with_point_data(mesh: pyvista.PolyData, known: dict[str, Any]) -> pyvista.PolyData:
    """Return the mesh with arrays added under their names."""
    for name, values in known.items():
        mesh.point_data[name] = values
    return mesh


def cloud_from_pyvista(mesh: pyvista.PolyData) -> PointCloud:
    """Return a cloud from the points of a `pyvista.PolyData` (metres) and the point data it knows by name."""
    return PointCloud(points=np.array(mesh.points, dtype=np.float64), **_point_data(mesh, PointCloud))


def surface_from_pyvista(mesh: pyvista.PolyData) -> Surface:
    """Return a surface from a `pyvista.PolyData` (metres); polygons are triangulated, known point data goes along."""
    triangles = mesh if mesh.is_all_triangles else mesh.triangulate()
    known = _point_data(triangles, Surface)
    if INVENTED in triangles.cell_data:
        known[INVENTED] = np.array(triangles.cell_data[INVENTED], dtype=np.bool_)
    return Surface(
        vertices=np.array(triangles.points, dtype=np.float64), faces=np.array(triangles.regular_faces).reshape(-1, 3),
        **known,
    )  # fmt: skip


def compared_from_pyvista(mesh: pyvista.PolyData) -> ComparedSurface:
    """Return one side of a comparison from triangles that `compared_to_pyvista` made."""
    missing = [name for name in COMPARED if name != "told_from" and name not in mesh.point_data]
    if missing:
        raise ShapeError(f"the mesh lacks the point data {', '.join(missing)}, which every comparison has")
    known: dict[str, Any] = {name: np.array(mesh.point_data[name]) for name in COMPARED if name in mesh.point_data}
    if COARSE in mesh.field_data:
        known[COARSE] = float(mesh.field_data[COARSE][0])
    return ComparedSurface(surface_from_pyvista(mesh), **known)


def _point_data(mesh: pyvista.PolyData, noun: type) -> dict[str, Any]:
    """Return the point data that a noun has a field for, normals and colours also under the names of `READ`."""
    names = {field.name for field in dataclasses.fields(noun)} - {"points", "vertices", "faces"}
    known = {name: np.array(mesh.point_data[name]) for name in mesh.point_data if name in names}
    for name, own in READ.items():
        if name in mesh.point_data and own not in known:
            known[own] = np.array(mesh.point_data[name])[:, :3]
    return known


def cloud_to_open3d(cloud: PointCloud) -> Any:
    """Return an `open3d.geometry.PointCloud` with normals and colours where known."""
    open3d = load_open3d()
    converted = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(cloud.points))
    if cloud.normals is not None:
        converted.normals = open3d.utility.Vector3dVector(cloud.normals)
    if cloud.colors is not None:
        converted.colors = open3d.utility.Vector3dVector(cloud.colors / 255.0)
    return converted


def cloud_from_open3d(converted: Any) -> PointCloud:
    """Return a cloud from an `open3d.geometry.PointCloud` (metres), with normals and colours where it has them."""
    normals = np.array(converted.normals) if converted.has_normals() else None
    colors = np.rint(255 * np.asarray(converted.colors)).astype(np.uint8) if converted.has_colors() else None
    return PointCloud(points=np.array(converted.points), normals=normals, colors=colors)
