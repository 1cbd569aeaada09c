"""Surfaces out as GLB (glTF 2.0), metres: with vertex colours, or light with a normal map for the screen.

glTF takes y as up and colours as amounts of light. The surface's own axes, z up, stand in the file; the node that holds
them turns them, as viewers expect and readers undo (`glb`).
"""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from projects.errors import ShapeError
from projects.formats.complete_file import complete_file
from projects.model import Floats, Surface

FLOAT, UINT32 = 5126, 5125  # glTF's numbers of component types
MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", b"JSON", b"BIN\0"
Z_UP_TO_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
TURN = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]  # the same as a quaternion x y z w
Attribute = tuple[str, Any, str, int]  # name, values, glTF's type and number of the component


def write_glb(path: Path, surface: Surface, colors: NDArray[np.uint8] | None = None) -> None:
    """Write a surface as GLB with vertex colours.

    Parameters
    ----------
    path : where to write; an existing file is replaced when the new one is complete.
    surface : vertices and faces, normals where known. Stored as 32-bit numbers about their middle, which the node
        gives in full precision.
    colors : (n, 3) red green blue, in place of the surface's own.
    """
    colors = surface.colors if colors is None else np.asarray(colors, dtype=np.uint8)
    if colors is not None and colors.shape != surface.vertices.shape:
        raise ShapeError(f"colors has shape {colors.shape}; {surface.vertices.shape} is needed")
    arrays: list[Attribute] = []
    if surface.normals is not None:
        arrays.append(("NORMAL", _unit(surface.normals), "VEC3", FLOAT))
    _write(path, surface, colors, arrays, None)


def write_screen_glb(path: Path, surface: Surface, uv: Floats, tangents: Floats, normal_map: NDArray[np.uint8]) -> None:
    """Write a surface with its texture coordinates, tangents and normal map; `monitor.reconstruction.screen` makes it.

    Parameters
    ----------
    path : where to write; an existing file is replaced when the new one is complete.
    surface : vertices, faces and normals; colours where known. Stored as `write_glb` does.
    uv : (n, 2), 0 to 1 from the map's upper left corner.
    tangents : (n, 4), unit vectors and the side (1 or -1) of the bitangent.
    normal_map : (rows, columns, 3).
    """
    n = len(surface.vertices)
    if surface.normals is None or np.shape(uv) != (n, 2) or np.shape(tangents) != (n, 4):
        raise ShapeError(f"normals (n, 3), uv (n, 2) and tangents (n, 4) of {n} vertices are needed; "
                         f"uv has shape {np.shape(uv)}, tangents {np.shape(tangents)}")  # fmt: skip
    arrays: list[Attribute] = [
        ("NORMAL", surface.normals.astype("<f4"), "VEC3", FLOAT),
        ("TANGENT", np.asarray(tangents, "<f4"), "VEC4", FLOAT),
        ("TEXCOORD_0", np.asarray(uv, "<f4"), "VEC2", FLOAT),
    ]
    _write(path, surface, surface.colors, arrays, normal_map)


def linear_light(colors: NDArray[np.uint8]) -> Floats:
    """Return amounts of light, 0 to 1, of colours (n, 3) as screens take them (IEC 61966-2-1)."""
    shown = np.asarray(colors, dtype=np.float64) / 255.0
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def as_shown(light: Floats) -> NDArray[np.uint8]:
    """Return colours (n, 3) as screens take them of amounts of light, 0 to 1."""
    light = np.clip(light, 0.0, 1.0)
    shown = np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1.0 / 2.4) - 0.055)
    return np.asarray(np.rint(shown * 255.0), dtype=np.uint8)


def _unit(normals: Floats) -> Floats:
    """Return normals (n, 3) of length 1; of those that are not known any, since glTF takes no other."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    is_known = np.isfinite(length) & (length > 0.0)
    return np.where(is_known, normals / np.where(is_known, length, 1.0), [0.0, 0.0, 1.0]).astype("<f4")


def _write(path: Path, surface: Surface, colors: NDArray[np.uint8] | None, more: list[Attribute],
           normal_map: NDArray[np.uint8] | None) -> None:  # fmt: skip
    """Write a mesh of one primitive with its attributes and, where there is one, a normal map."""
    middle = np.zeros(3)
    if len(surface.vertices):
        middle = 0.5 * (surface.vertices.min(axis=0) + surface.vertices.max(axis=0))
    arrays: list[Attribute] = [("POSITION", (surface.vertices - middle).astype("<f4"), "VEC3", FLOAT), *more]
    if colors is not None:
        arrays.append(("COLOR_0", linear_light(colors).astype("<f4"), "VEC3", FLOAT))
    arrays.append(("", surface.faces.astype("<u4").reshape(-1, 1), "SCALAR", UINT32))
    blocks = [np.ascontiguousarray(values).tobytes() for _, values, _, _ in arrays]
    if normal_map is not None:
        blocks.append(_png(normal_map))
    content = _describe(arrays, [len(block) for block in blocks])
    content["nodes"][0] |= {"translation": (Z_UP_TO_Y_UP @ middle).tolist(), "rotation": TURN}
    binary = b"".join(block + b"\0" * (-len(block) % 4) for block in blocks)
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    with complete_file(path) as unfinished, unfinished.open("wb") as out:
        out.write(struct.pack("<4sII", MAGIC, 2, 28 + len(text) + len(binary)))
        out.write(struct.pack("<I4s", len(text), JSON_CHUNK) + text)
        out.write(struct.pack("<I4s", len(binary), BINARY_CHUNK) + binary)


def _png(image: NDArray[np.uint8]) -> bytes:
    """Return an image (rows, columns, 3) as PNG."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(image).save(out, format="png")
    return out.getvalue()


def _describe(arrays: list[Attribute], lengths: list[int]) -> dict[str, Any]:
    """Return the JSON part of the file: one mesh of one primitive, one material, with a normal texture where one more
    block than arrays is its picture."""
    starts = np.cumsum([0, *(n + -n % 4 for n in lengths)]).tolist()
    accessors: list[dict[str, Any]] = []
    for k, (name, values, kind, component) in enumerate(arrays):
        accessor = {"bufferView": k, "componentType": component, "count": len(values), "type": kind}
        if name == "POSITION" and len(values):
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        accessors.append(accessor)
    attributes = {name: k for k, (name, _, _, _) in enumerate(arrays) if name}
    material: dict[str, Any] = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.9},
                                "doubleSided": True}  # fmt: skip
    content: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "heritage-monitor"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": len(arrays) - 1, "material": 0}]}],
        "materials": [material],
        "accessors": accessors,
        "bufferViews": [{"buffer": 0, "byteOffset": starts[k], "byteLength": lengths[k]} for k in range(len(lengths))],
        "buffers": [{"byteLength": starts[-1]}],
    }
    if len(lengths) > len(arrays):
        material["normalTexture"] = {"index": 0}
        content |= {
            "textures": [{"source": 0, "sampler": 0}],
            "samplers": [{"magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071}],
            "images": [{"bufferView": len(arrays), "mimeType": "image/png"}],
        }
    return content
