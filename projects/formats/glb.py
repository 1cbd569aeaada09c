"""GLB meshes in (binary glTF 2.0), metres by definition; every node of the scene in its place, vertex colours kept.

glTF takes y as up and colours as amounts of light: out come coordinates with z up, and colours as screens take them.

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
from projects.formats.glb_writer import Z_UP_TO_Y_UP, as_shown
from projects.formats.rawscan import CHUNK, Columns, ScanHeader
from projects.model import Floats, Ints
from projects.transforms import apply


def list_scans(path: str) -> list[ScanHeader]:
    """Return the one scan of the file: all its vertices."""
    return [ScanHeader(has_faces=any(len(getattr(part, "faces", ())) for part, _ in _parts(path)))]


def read_scan(path: str, header: ScanHeader) -> Iterator[Columns]:
    """Yield the vertices."""
    parts = [_columns(part, pose) for part, pose in _parts(path) if len(part.vertices)]
    names = set.intersection(*(set(part) for part in parts)) if parts else set()
    for part in parts:
        for start in range(0, len(part["points"]), CHUNK):
            yield {name: part[name][start : start + CHUNK] for name in names}


def read_mesh(path: str) -> Columns:
    """Return the vertices and triangles of all nodes together; colours where all of them have some."""
    parts = [(part, pose) for part, pose in _parts(path) if len(getattr(part, "faces", ()))]
    if not parts:
        raise FormatError("holds no faces")
    columns = [_columns(part, pose) for part, pose in parts]
    before = np.cumsum([0, *(len(part.vertices) for part, _ in parts)])
    faces = [_faces(part, pose) + n for (part, pose), n in zip(parts, before, strict=False)]
    together = {name: np.concatenate([c[name] for c in columns]) for name in set.intersection(*map(set, columns))}
    return together | {"faces": np.concatenate(faces)}


def _faces(part: Any, pose: Floats) -> Ints:
    """Return the triangles (m, 3), counter-clockwise from outside where the node mirrors its part, too."""
    faces = np.asarray(part.faces)
    return faces[:, ::-1] if np.linalg.det(pose[:3, :3]) < 0.0 else faces


def _parts(path: str) -> list[tuple[Any, Floats]]:
    """Return what hangs on each node of the scene, as it is in the file, with the node's place (4, 4)."""
    scene = trimesh.load_scene(io.BytesIO(Path(path).read_bytes()), file_type="glb", process=False)
    places = (scene.graph[node] for node in scene.graph.nodes_geometry)
    return [(scene.geometry[name], np.asarray(pose, dtype=np.float64)) for pose, name in places]


def _columns(part: Any, pose: Floats) -> Columns:
    """Return vertices in the scene, and colours where the vertices have them."""
    places = apply(pose, np.asarray(part.vertices, dtype=np.float64))
    columns: Columns = {"points": places @ Z_UP_TO_Y_UP}
    light = _light(part)
    if light is not None and np.shape(light) in ((len(part.vertices), 3), (len(part.vertices), 4)):
        columns["colors"] = as_shown(light[:, :3])
    return columns


def _light(part: Any) -> Any:
    """Return the amounts of light of each vertex, 0 to 1, None where the part has none."""
    given, attributes = getattr(part, "colors", None), getattr(part.visual, "vertex_attributes", {})
    if "color" in attributes:  # of a part with a material
        given = attributes["color"]
    elif getattr(part.visual, "kind", None) == "vertex":
        given = part.visual.vertex_colors
    if given is None:
        return None
    values = np.asarray(given)
    return values / np.iinfo(values.dtype).max if values.dtype.kind == "u" else values
