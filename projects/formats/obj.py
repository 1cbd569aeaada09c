"""OBJ vertices and meshes in (Wavefront): `v` with optional colours, `f` with polygons and counting from the end.

Runs in the child process. Texture coordinates, normals, materials and groups are passed over; no other file is opened.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from projects.errors import FormatError
from projects.formats.plyfaces import fan, stack_by_length
from projects.formats.rawscan import Columns, ScanHeader, scaled
from projects.formats.text import line_blocks, numbers_of_lines

VERTEX = re.compile(rb"v([ \t]|\r?$)")
FACE = re.compile(rb"^[ \t]*f[ \t]", re.MULTILINE)


def list_scans(path: str) -> list[ScanHeader]:
    """Return the one scan of the file."""
    return [ScanHeader(has_faces=any(FACE.search(block) for block in line_blocks(path, 0)))]


def read_scan(path: str, header: ScanHeader) -> Iterator[Columns]:
    """Yield the vertices."""
    return scaled(lambda: _read_blocks(path))


def _read_blocks(path: str) -> Iterator[Columns]:
    """Yield the vertices with colours as the file has them."""
    line, n_columns = 1, 0
    for block in line_blocks(path, 0):
        lines = [text.lstrip() for text in block.split(b"\n")]
        told = {k: text[2:].split(b"#")[0] for k, text in enumerate(lines, line) if VERTEX.match(text)}
        if told:
            empty = [k for k, text in told.items() if not text.strip()]
            if empty:
                raise FormatError(f"line {empty[0]} has a vertex without numbers; the file is broken")
            n_columns = n_columns or len(next(iter(told.values())).split())
            yield _columns(numbers_of_lines(told, n_columns))
        line += block.count(b"\n")


def _columns(rows: NDArray[np.float64]) -> Columns:
    """Return x y z [w] or x y z r g b [a] as columns."""
    if rows.shape[1] not in (3, 4, 6, 7):
        raise FormatError(f"its vertices have {rows.shape[1]} numbers; x y z, with w or with red green blue, is needed")
    columns: Columns = {"points": rows[:, :3]}
    if rows.shape[1] >= 6:
        columns["colors"] = rows[:, 3:6]
    return columns


def read_mesh(path: str) -> Columns:
    """Return the vertices and triangles; polygons are cut into fans."""
    blocks = list(read_scan(path, ScanHeader()))
    polygons = list(_polygons(path))
    if not blocks or not polygons:
        raise FormatError("holds no faces; add it as a scan, without --mesh")
    mesh = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
    return mesh | {"faces": fan(stack_by_length(polygons))}


def _polygons(path: str) -> Iterator[list[int]]:
    """Yield the vertex indices of each face, from 0."""
    n_vertices, line = 0, 0
    for block in line_blocks(path, 0):
        for text in block.split(b"\n")[:-1]:
            line += 1
            words = text.split(b"#")[0].split()
            if words[:1] == [b"v"]:
                n_vertices += 1
            elif words[:1] == [b"f"]:
                if len(words) < 4:
                    raise FormatError(f"line {line} has a face of {len(words) - 1} corners; three or more are needed")
                yield [_index(word, n_vertices, line) for word in words[1:]]


def _index(word: bytes, n_vertices: int, line: int) -> int:
    """Return the vertex of a corner such as 3, 3/1, 3//2 or -1 (the last one so far), counted from 0."""
    try:
        number = int(word.split(b"/")[0])
    except ValueError as problem:
        raise FormatError(f"line {line} names no vertex: {word[:40].decode('latin-1')!r}") from problem
    if number == 0:
        raise FormatError(f"line {line} names vertex 0; OBJ counts from 1")
    return number - 1 if number > 0 else n_vertices + number
