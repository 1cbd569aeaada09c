"""STL vertices and meshes in: binary or text. Corners at exactly the same place are one vertex.

Runs in the child process. STL repeats a vertex in every triangle that has it; the repetition is no measurement.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from projects.errors import FormatError
from projects.formats.rawscan import CHUNK, Columns, ScanHeader
from projects.formats.text import line_blocks, numbers_of_lines

RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
HEADER = 84


def list_scans(path: str) -> list[ScanHeader]:
    """Return the one scan of the file; how many vertices differ is known after reading."""
    return [ScanHeader(has_faces=True)]


def read_scan(path: str, header: ScanHeader) -> Iterator[Columns]:
    """Yield the vertices, each once."""
    points, _ = _mesh(path)
    for start in range(0, len(points), CHUNK):
        yield {"points": points[start : start + CHUNK]}


def read_mesh(path: str) -> Columns:
    """Return the vertices and triangles."""
    points, faces = _mesh(path)
    if not len(faces):
        raise FormatError("holds no faces")
    return {"points": points, "faces": faces}


def _mesh(path: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return vertices (n, 3), each once, and faces (m, 3)."""
    corners = _binary_corners(path) if _is_binary(path) else _text_corners(path)
    corners = corners + 0.0  # -0 and 0 are one place
    rows = np.ascontiguousarray(corners).view(np.dtype((np.void, corners.dtype.itemsize * 3))).ravel()
    _, first, which = np.unique(rows, return_index=True, return_inverse=True)
    order = np.argsort(first)  # in the order of the file
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return corners[first[order]].astype(np.float64), rank[which].reshape(-1, 3)


def _is_binary(path: str) -> bool:
    """Return whether the file is as long as the count in its header says."""
    with Path(path).open("rb") as file:
        head = file.read(HEADER)
    return len(head) == HEADER and os.path.getsize(path) == HEADER + RECORD.itemsize * int.from_bytes(
        head[80:], "little"
    )


def _binary_corners(path: str) -> NDArray[np.float32]:
    """Return the corners (3 m, 3) of the triangles."""
    return np.fromfile(path, RECORD, offset=HEADER)["corners"].reshape(-1, 3)


def _text_corners(path: str) -> NDArray[np.float64]:
    """Return the corners of a text STL; a file that ends before `endsolid` is cut off."""
    blocks, line, last = [np.empty((0, 3))], 1, b""
    for block in line_blocks(path, 0):
        lines = [text.lstrip() for text in block.split(b"\n")]
        told = {k: text[6:] for k, text in enumerate(lines, line) if text.startswith(b"vertex")}
        blocks.append(numbers_of_lines(told, 3) if told else np.empty((0, 3)))
        line += block.count(b"\n")
        last = next((text for text in reversed(lines) if text), last)
    corners = np.concatenate(blocks)
    if not last.startswith(b"endsolid") or len(corners) % 3:
        raise FormatError("ends before its last triangle (endsolid); the file is cut off")
    return corners
