"""Surfaces out: PLY with any properties per vertex, OBJ, STL; coordinates in the surface's frame, metres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from projects.errors import FormatError, ShapeError
from projects.formats.complete_file import complete_file
from projects.model import Surface
from projects.triangles import unit_normals

PLY_TYPES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint", "f4": "float",
             "f8": "double"}  # fmt: skip
COARSEST = 1e-5  # m, what rounding to 32 bits may cost a coordinate


def write_ply_mesh(
    path: Path, surface: Surface, properties: Mapping[str, NDArray[Any]] | None = None, comments: Sequence[str] = ()
) -> None:
    """Write a surface as binary little-endian PLY.

    Parameters
    ----------
    path : where to write; an existing file is replaced when the new one is complete.
    surface : vertices as `x y z` double, faces as `vertex_indices`; where holes were closed, `invented` (uchar 0 or 1)
        a face.
    properties : after x y z, in this order, under these names and with these dtypes (8, 16, 32-bit integers, float32,
        float64), each (n,). None: `surface_properties(surface)`.
    comments : lines of the header.

    Raises
    ------
    ShapeError
        A property of another length, of a type that PLY does not have, or whose name cannot be written.
    """
    columns = {axis: surface.vertices[:, k] for k, axis in enumerate("xyz")}
    columns |= dict(surface_properties(surface) if properties is None else properties)
    kinds = {name: _ply_kind(name, np.asarray(values), len(surface.vertices)) for name, values in columns.items()}
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {' '.join(c.split())}" for c in comments)]
    header += [f"element vertex {len(surface.vertices)}"]
    header += [f"property {PLY_TYPES[kind]} {name}" for name, kind in kinds.items()]
    header += [f"element face {len(surface.faces)}", "property list uchar int vertex_indices"]
    header += [] if surface.face_invented is None else ["property uchar invented"]
    header += ["end_header", ""]
    vertices = np.empty(len(surface.vertices), [(name, f"<{kind}") for name, kind in kinds.items()])
    for name, values in columns.items():
        vertices[name] = values
    kind: list[Any] = [("n", "u1"), ("corners", "<i4", 3)] + [("invented", "u1")] * (surface.face_invented is not None)
    faces = np.empty(len(surface.faces), kind)
    faces["n"], faces["corners"] = 3, surface.faces
    if surface.face_invented is not None:
        faces["invented"] = surface.face_invented
    with complete_file(path) as unfinished, unfinished.open("wb") as out:
        out.write("\n".join(header).encode("ascii", "replace"))
        out.write(vertices.tobytes())
        out.write(faces.tobytes())


def surface_properties(surface: Surface) -> dict[str, NDArray[Any]]:
    """Return what is known of each vertex as PLY properties: normals, colours, intensity, sigma."""
    properties: dict[str, NDArray[Any]] = {}
    if surface.normals is not None:
        properties |= {f"n{axis}": surface.normals[:, k].astype(np.float32) for k, axis in enumerate("xyz")}
    if surface.colors is not None:
        properties |= {name: surface.colors[:, k] for k, name in enumerate(("red", "green", "blue"))}
    if surface.intensity is not None:
        properties["intensity"] = np.asarray(surface.intensity, dtype=np.float32)
    if surface.sigma is not None:
        properties["sigma"] = np.asarray(surface.sigma, dtype=np.float32)
    return properties


def _ply_kind(name: str, values: NDArray[Any], n: int) -> str:
    """Return the type of a property, such as f4."""
    kind = values.dtype.str[1:]
    if kind not in PLY_TYPES or values.shape != (n,) or not name.isascii() or not name.isprintable() or " " in name:
        raise ShapeError(
            f"PLY property {name!r} is {values.dtype} {values.shape}; {n} of {', '.join(PLY_TYPES)} are needed"
        )
    return kind


def write_obj(path: Path, surface: Surface, comments: Sequence[str] = ()) -> None:
    """Write a surface as OBJ with micrometres, normals and colours (after x y z, 0 to 1) where they are known."""
    with complete_file(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="\n") as out:
        out.writelines(f"# {' '.join(comment.split())}\n" for comment in comments)
        rows = surface.vertices if surface.colors is None else np.c_[surface.vertices, surface.colors / 255.0]
        _write_rows(out, "v" + " %.6f" * 3 + " %.4f" * (rows.shape[1] - 3), rows)
        corner = " %d"
        corners = surface.faces + 1
        if surface.normals is not None:
            _write_rows(out, "vn %.6f %.6f %.6f", np.nan_to_num(surface.normals))
            corner, corners = " %d//%d", np.repeat(corners, 2, axis=1)
        _write_rows(out, "f" + corner * 3, corners)


def _write_rows(out: Any, row: str, values: NDArray[Any], block: int = 50_000) -> None:
    """Write each row of a table in one format."""
    for start in range(0, len(values), block):
        part = values[start : start + block]
        out.write((row + "\n") * len(part) % tuple(part.ravel().tolist()))


def write_stl(path: Path, surface: Surface) -> None:
    """Write a surface as binary STL, with the normals of its faces.

    Raises
    ------
    FormatError
        The coordinates are too large for the format's 32-bit numbers to hold a hundredth of a millimetre.
    """
    require_stl_holds(path, surface)
    corners = surface.vertices[surface.faces]
    rounded = corners.astype("<f4")
    records = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    records["normal"], records["corners"] = unit_normals(corners), rounded
    with complete_file(path) as unfinished, unfinished.open("wb") as out:
        out.write(b"binary STL, metres".ljust(80) + np.uint32(len(records)).tobytes())
        out.write(records.tobytes())


def require_stl_holds(path: Path, surface: Surface) -> None:
    """Raise `FormatError` where 32-bit numbers would move a vertex by more than a hundredth of a millimetre."""
    loss = float(np.abs(surface.vertices.astype("<f4") - surface.vertices).max(initial=0.0))
    if loss > COARSEST:
        raise FormatError(
            f"{path}: STL holds 32-bit numbers, which would move these coordinates by up to {1e3 * loss:.3g} mm; "
            "write PLY or OBJ"
        )
