"""GLB meshes in (binary glTF 2.0), metres by definition; every node of the scene in its place, vertex colours kept.

Runs in the child process. Read from memory, so that nothing the file names can be opened.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from projects.errors import FormatError
from projects.formats.rawscan import CHUNK, Columns, ScanHeader


def list_scans(path: str) -> list[ScanHeader]:
    """Return the one scan of the file: all its vertices."""
    return [ScanHeader(has_faces=any(len(getattr(part, "faces", ())) for part in _scene(path).dump()))]


def read_scan(path: str, header: ScanHeader) -> Iterator[Columns]:
    """Yield the vertices."""
    parts = [_columns(part) for part in _scene(path).dump() if len(part.vertices)]
    names = set.intersection(*(set(part) for part in parts)) if parts else set()
    for part in parts:
        for start in range(0, len(part["points"]), CHUNK):
            yield {name: part[name][start : start + CHUNK] for name in names}


def read_mesh(path: str) -> Columns:
    """Return the vertices and triangles of all nodes together."""
    mesh = _scene(path).to_mesh()
    if not len(mesh.faces):
        raise FormatError("holds no faces")
    return _columns(mesh) | {"faces": np.asarray(mesh.faces)}


def _scene(path: str) -> Any:
    """Return the scene, as it is in the file."""
    return trimesh.load_scene(io.BytesIO(Path(path).read_bytes()), file_type="glb", process=False)


def _columns(part: Any) -> Columns:
    """Return vertices, and colours where the vertices have them."""
    columns: Columns = {"points": np.asarray(part.vertices, dtype=np.float64)}
    colours = getattr(part, "colors", None)
    if getattr(part.visual, "kind", None) == "vertex":
        colours = part.visual.vertex_colors
    if colours is not None and np.shape(colours) == (len(part.vertices), 4):
        columns["colors"] = np.asarray(colours)[:, :3]
    return columns
