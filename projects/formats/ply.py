"""PLY points and meshes in: text, little and big endian, any properties in any order, elements with lists.

Runs in the child process. Words that the format does not know are passed over in the header; the body must then hold
exactly what the header promises, so that a misread layout cannot give wrong points.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from projects.errors import FormatError
from projects.formats.plyfaces import ListReader, fan
from projects.formats.rawscan import CHUNK, Columns, ScanHeader, scaled
from projects.formats.text import TableLayout, line_blocks, read_table, skip_rows

TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
         "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
         "float32": "f4", "float64": "f8", "int64": "i8", "uint64": "u8"}  # fmt: skip
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
LONGEST_HEADER = 2**20
LONGEST_TAIL = 2  # bytes, a line end
KNOWN = ("ply", "comment", "obj_info", "end_header")
SCALAR = "scalar_"  # before what CloudCompare keeps as a scalar field
ROLES = {"intensity": "intensity", "reflectance": "intensity", "red": "red", "green": "green", "blue": "blue",
         "diffuse_red": "red", "diffuse_green": "green", "diffuse_blue": "blue", "r": "red", "g": "green", "b": "blue",
         "nx": "nx", "ny": "ny", "nz": "nz", "x": "x", "y": "y", "z": "z"}  # fmt: skip


@dataclass(frozen=True)
class Element:
    """One element of the header: how many, and its properties as (name, type, type of the list's length or "")."""

    name: str
    n: int
    properties: list[tuple[str, str, str]]

    @property
    def has_lists(self) -> bool:
        """Whether a property is a list, so that its rows differ in length."""
        return any(length for _, _, length in self.properties)


@dataclass(frozen=True)
class Layout:
    """The header: byte order ("" for text), the elements in order, where the body begins and its first line.

    `unknown` is a line that the format does not know, "" where there is none.
    """

    order: str
    elements: list[Element]
    offset: int
    line: int
    unknown: str = ""

    def dtype(self, element: Element) -> np.dtype[Any]:
        """Return the record of an element without lists."""
        return np.dtype([(f"{k}", self.order + kind) for k, (_, kind, _) in enumerate(element.properties)])


def list_scans(path: str) -> list[ScanHeader]:
    """Return the one scan of the file: its vertices."""
    layout = read_layout(path)
    _require_nothing_left(path, layout)
    has_faces = any(element.name == "face" and element.n > 0 for element in layout.elements)
    return [ScanHeader(n_declared=_vertices(layout).n, has_faces=has_faces)]


def _require_nothing_left(path: str, layout: Layout) -> None:
    """Raise where a binary body is longer than the header promises: a damaged count, or a property not understood.

    Lists are walked only where the header has a line that PLY does not know.
    """
    has_lists = any(element.has_lists for element in layout.elements)
    if not layout.order or (has_lists and not layout.unknown):
        return
    left = os.path.getsize(path) - _begin(path, layout, None)[0]
    if left > LONGEST_TAIL:
        why = f"; it has a line that PLY does not know: {layout.unknown[:60]!r}" if layout.unknown else ""
        raise FormatError(f"goes on for {left} bytes after what its header promises{why}")


def _surplus(path: str, layout: Layout, n: int) -> Iterator[Columns]:
    """Yield the lines after all that a text body promises, flagged as such; more of them than promised is an error."""
    end, line = _begin(path, layout, None)
    n_surplus = sum(1 for block in line_blocks(path, end) for text in block.split(b"\n") if text.strip())
    if n_surplus > n:
        raise FormatError(f"goes on for {n_surplus} lines from line {line} on, after the {n} points that it promises")
    yield {"points": np.ones((n_surplus, 3)), "surplus": np.ones(n_surplus, bool)}


def read_scan(path: str, header: ScanHeader) -> Iterator[Columns]:
    """Yield the vertices."""
    layout = read_layout(path)
    vertices = _vertices(layout)
    names = [_role(name.lower()) for name, _, _ in vertices.properties]
    place = _begin(path, layout, vertices)
    yield from scaled(lambda: (_columns(values, names, vertices) for values in _rows(path, layout, vertices, place)))
    if not layout.order:
        yield from _surplus(path, layout, vertices.n)


def _role(name: str) -> str:
    """Return what a property in lower case is; what is of no use here is called by a dash. No scalar field is x y z."""
    role = ROLES.get(name.removeprefix(SCALAR), "-")
    return "-" if name.startswith(SCALAR) and role in "xyz" else role


def read_mesh(path: str) -> Columns:
    """Return the vertices and triangles, and which are invented, as our own files say; polygons are cut into fans."""
    layout = read_layout(path)
    blocks = [block for block in read_scan(path, ScanHeader()) if "surplus" not in block]
    faces = next((e for e in layout.elements if e.name == "face" and e.n), None)
    if not blocks or faces is None:
        raise FormatError("holds no faces; add it as a scan, without --mesh")
    mesh = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
    indices = [k for k, (name, _, length) in enumerate(faces.properties) if length and name.startswith("vertex_ind")]
    if not indices:
        raise FormatError("its faces have no list vertex_indices")
    place = _begin(path, layout, faces)
    lists = _lists(path, layout, faces, place)
    polygons = lists.read(indices[0])
    marks = [k for k, p in enumerate(faces.properties) if p[0] == "invented" and p[1][0] in "iu" and not p[2]]
    if marks and all(table.shape[1] == 3 for table in polygons):
        mesh["invented"] = (lists.read(marks[0])[0][:, 0] != 0).astype(np.uint8)
    return mesh | {"faces": fan(polygons)}


def read_layout(path: str) -> Layout:
    """Return what the header says."""
    with Path(path).open("rb") as file:
        raw = file.read(LONGEST_HEADER)
    mark = raw.find(b"end_header")
    end = raw.find(b"\n", mark) + 1 or raw.find(b"\r", mark) + 1
    if mark < 0 or not end:
        raise FormatError("its header has no end (end_header)")
    lines = raw[:end].decode("latin-1").splitlines()
    order, elements, unknown = None, [], ""
    for number, words in enumerate((line.split() for line in lines), start=1):
        if words[:1] == ["format"]:
            order = ORDERS.get(" ".join(words[1:2]))
        elif words[:1] == ["element"]:
            elements.append(_element(words, number))
        elif words[:1] == ["property"]:
            _add_property(elements, words, number)
        elif words and words[0] not in KNOWN:
            unknown = lines[number - 1]
    if order is None:
        raise FormatError("its header names none of the formats ascii, binary_little_endian, binary_big_endian")
    return Layout(order, elements, end, len(lines) + 1, unknown)


def _element(words: list[str], number: int) -> Element:
    """Return the element that a line of the header begins."""
    if len(words) != 3 or not words[2].isdecimal() or len(words[2]) > 18:
        raise FormatError(f"line {number} of its header should be: element name count")
    return Element(words[1], int(words[2]), [])


def _add_property(elements: list[Element], words: list[str], number: int) -> None:
    """Add the property of a line of the header to the last element."""
    is_list = words[1:2] == ["list"]
    kinds, name = (words[2:4], words[4:]) if is_list else (words[1:2], words[2:])
    if not elements or len(name) != 1 or not all(kind in TYPES for kind in kinds) or not kinds:
        raise FormatError(f"line {number} of its header is no property: {' '.join(words)[:60]!r}")
    elements[-1].properties.append((name[0], TYPES[kinds[-1]], TYPES[kinds[0]] if is_list else ""))


def _vertices(layout: Layout) -> Element:
    """Return the element of the points."""
    found = [element for element in layout.elements if element.name in ("vertex", "vertices", "point")]
    if not found:
        raise FormatError("holds no points: its header names no element vertex")
    names = [name.lower() for name, _, _ in found[0].properties]
    if not {"x", "y", "z"} <= set(names) or len(set(names)) != len(names) or found[0].has_lists:
        raise FormatError(f"its vertices have the properties {', '.join(names)[:100]}; x, y, z, once and not as lists")
    return found[0]


def _begin(path: str, layout: Layout, wanted: Element | None) -> tuple[int, int]:
    """Return the offset and the line at which an element begins, past those before it; None stands for the end."""
    offset, line = layout.offset, layout.line
    for element in layout.elements:
        if element is wanted:
            break
        if not layout.order:
            offset, line = _skip_lines(path, offset, line, element.n)
        elif element.has_lists:
            offset = _lists(path, layout, element, (offset, line)).end()
        else:
            offset += element.n * layout.dtype(element).itemsize
    return offset, line


def _skip_lines(path: str, offset: int, line: int, n: int) -> tuple[int, int]:
    """Return the offset and line after n lines, however short they are."""
    for block in line_blocks(path, offset, n):
        offset += len(block)
    return offset, line + n


def _lists(path: str, layout: Layout, element: Element, place: tuple[int, int]) -> ListReader:
    """Return the reader of an element with lists."""
    return ListReader(path, layout.order, element.n, element.properties, place)


def _rows(path: str, layout: Layout, element: Element, place: tuple[int, int]) -> Iterator[list[Any]]:
    """Yield the properties of an element without lists, block by block, each a column."""
    offset, line = place
    if not layout.order:
        skip_rows(path, offset, line, element.n)
        table = TableLayout(offset=offset, n_columns=len(element.properties), n_rows=element.n, first_line=line)
        for rows in read_table(path, table):
            yield list(rows.T)
        return
    record = layout.dtype(element)
    room = (os.path.getsize(path) - offset) // record.itemsize
    if room < element.n:
        raise FormatError(f"promises {element.n} points, {max(room, 0)} fit in the file; it is cut off")
    with Path(path).open("rb") as file:
        file.seek(offset)
        for start in range(0, element.n, CHUNK):
            block = np.fromfile(file, record, min(CHUNK, element.n - start))
            yield [block[name] for name in record.names or ()]


def _columns(values: list[Any], names: list[str], vertices: Element) -> Columns:
    """Return the properties as the columns that every format gives."""
    chosen = {name: values[k] for k, name in reversed(list(enumerate(names)))}  # the first of a role counts
    kinds = {name: kind for name, (_, kind, _) in zip(reversed(names), reversed(vertices.properties), strict=True)}
    columns: Columns = {"points": np.column_stack([chosen[axis] for axis in "xyz"]).astype(np.float64)}
    if {"nx", "ny", "nz"} <= set(chosen):
        columns["normals"] = np.column_stack([chosen[axis] for axis in ("nx", "ny", "nz")]).astype(np.float64)
    if {"red", "green", "blue"} <= set(chosen):
        colours = np.column_stack([chosen[c] for c in ("red", "green", "blue")])
        columns["colors"] = colours.astype(np.uint8) if kinds["red"] == "u1" else colours
    if "intensity" in chosen:
        columns["intensity"] = np.asarray(chosen["intensity"])
    return columns
