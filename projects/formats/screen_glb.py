"""A light mesh with a normal map as GLB (glTF 2.0), for viewers; `monitor.reconstruction.screen` makes it."""

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

FLOAT, UINT8, UINT32 = 5126, 5121, 5125  # glTF's numbers of component types
MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", b"JSON", b"BIN\0"


def write_screen_glb(path: Path, surface: Surface, uv: Floats, tangents: Floats, normal_map: NDArray[np.uint8]) -> None:
    """Write a surface with its texture coordinates, tangents and normal map.

    Parameters
    ----------
    path : where to write; an existing file is replaced when the new one is complete.
    surface : vertices, faces and normals; colours where known. Stored as 32-bit numbers about their middle, which the
        node gives in full precision.
    uv : (n, 2), 0 to 1 from the map's upper left corner.
    tangents : (n, 4), unit vectors and the side (1 or -1) of the bitangent.
    normal_map : (rows, columns, 3).
    """
    n = len(surface.vertices)
    if surface.normals is None or np.shape(uv) != (n, 2) or np.shape(tangents) != (n, 4):
        raise ShapeError(f"normals (n, 3), uv (n, 2) and tangents (n, 4) of {n} vertices are needed; "
                         f"uv has shape {np.shape(uv)}, tangents {np.shape(tangents)}")  # fmt: skip
    middle = 0.5 * (surface.vertices.min(axis=0) + surface.vertices.max(axis=0))
    arrays: list[tuple[str, Any, str, int]] = [
        ("POSITION", (surface.vertices - middle).astype("<f4"), "VEC3", FLOAT),
        ("NORMAL", surface.normals.astype("<f4"), "VEC3", FLOAT),
        ("TANGENT", np.asarray(tangents, "<f4"), "VEC4", FLOAT),
        ("TEXCOORD_0", np.asarray(uv, "<f4"), "VEC2", FLOAT),
    ]
    if surface.colors is not None:
        arrays.append(("COLOR_0", np.c_[surface.colors, np.full(n, 255, np.uint8)], "VEC4", UINT8))
    arrays.append(("", surface.faces.astype("<u4").reshape(-1, 1), "SCALAR", UINT32))
    blocks = [np.ascontiguousarray(values).tobytes() for _, values, _, _ in arrays] + [_png(normal_map)]
    content = _describe(arrays, [len(block) for block in blocks])
    content["nodes"][0]["translation"] = middle.tolist()
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


def _describe(arrays: list[tuple[str, Any, str, int]], lengths: list[int]) -> dict[str, Any]:
    """Return the JSON part of the file: one mesh of one primitive, one material with a normal texture."""
    starts = np.cumsum([0, *(n + -n % 4 for n in lengths)]).tolist()
    accessors: list[dict[str, Any]] = []
    for k, (name, values, kind, component) in enumerate(arrays):
        accessor = {"bufferView": k, "componentType": component, "count": len(values), "type": kind}
        if name == "POSITION":
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        if name == "COLOR_0":
            accessor["normalized"] = True
        accessors.append(accessor)
    attributes = {name: k for k, (name, _, _, _) in enumerate(arrays) if name}
    return {
        "asset": {"version": "2.0", "generator": "heritage-monitor"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": len(arrays) - 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.9},
                       "normalTexture": {"index": 0}, "doubleSided": True}],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071}],
        "images": [{"bufferView": len(arrays), "mimeType": "image/png"}],
        "accessors": accessors,
        "bufferViews": [{"buffer": 0, "byteOffset": starts[k], "byteLength": lengths[k]} for k in range(len(lengths))],
        "buffers": [{"byteLength": starts[-1]}],
    }  # fmt: skip
