"""PCD points in (Point Cloud Library): text, binary and compressed, organised or not.

Runs in the child process. VIEWPOINT is taken as PCL's own normal estimation takes it, as the sensor's place in the
frame of the points: it gives the origin, and no pose. An organised cloud is a sensor's image: its 0 0 0 are no-returns.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from projects.errors import FormatError
from projects.formats.rawscan import CHUNK, Columns, ScanHeader, scaled
from projects.formats.text import TableLayout, is_number, read_table, skip_blank, skip_rows

LONGEST_HEADER = 65536
NORMALS = ("normal_x", "normal_y", "normal_z")
APART = (("r", "g", "b"), ("red", "green", "blue"))  # colours as fields of their own


@dataclass(frozen=True)
class Layout:
    """The header of a PCD file: fields as (name, type such as f4, count), the size, and how the body is written."""

    fields: list[tuple[str, str, int]]
    width: int
    height: int
    viewpoint: list[float]
    encoding: str
    offset: int
    line: int

    @property
    def n(self) -> int:
        """How many points the file promises."""
        return self.width * self.height

    @property
    def record(self) -> np.dtype[Any]:
        """The type of one point in binary files."""
        return np.dtype([(f"{k}", f"<{kind}", (count,)) for k, (_, kind, count) in enumerate(self.fields)])


def list_scans(path: str) -> list[ScanHeader]:
    """Return the one scan of the file."""
    layout = read_layout(path)
    origin = _origin(layout.viewpoint)
    is_grid = layout.height > 1
    return [ScanHeader(n_declared=layout.n, origin=origin, is_grid=is_grid, is_centred=is_grid and origin is None)]


def read_scan(path: str, header: ScanHeader) -> Iterator[Columns]:
    """Yield the points."""
    layout = read_layout(path)
    if layout.encoding == "binary_compressed":  # in one piece, and slow to unpack: once
        unpacked = list(_compressed_blocks(path, layout))
        return scaled(lambda: _as_columns(unpacked, header, layout))
    blocks = {"ascii": _text_blocks, "binary": _binary_blocks}[layout.encoding]
    return scaled(lambda: _as_columns(blocks(path, layout), header, layout))


def _as_columns(blocks: Iterable[dict[str, Any]], header: ScanHeader, layout: Layout) -> Iterator[Columns]:
    """Yield the points of blocks of fields, with intensities as the file has them."""
    start = 0
    for values in blocks:
        columns = _columns(values)
        if header.is_grid:
            index = np.arange(start, start + len(columns["points"]))
            columns["rows"], columns["columns"] = np.divmod(index, layout.width)
        start += len(columns["points"])
        yield columns


def read_layout(path: str) -> Layout:
    """Return what the header says."""
    with Path(path).open("rb") as file:
        head = file.read(LONGEST_HEADER)
    words: dict[str, list[str]] = {}
    offset, line = 0, 1
    while "DATA" not in words:
        end = head.find(b"\n", offset)
        if end < 0:
            raise FormatError("its header has no line DATA")
        parts = head[offset:end].decode("latin-1").split()
        if parts and not parts[0].startswith("#"):
            words[parts[0].upper()] = parts[1:]
        offset, line = end + 1, line + 1
    return _layout(words, offset, line)


def _layout(words: dict[str, list[str]], offset: int, line: int) -> Layout:
    """Return the header's words as numbers."""
    names = [name.lower() for name in words.get("FIELDS", [])]
    sizes, kinds = words.get("SIZE", []), words.get("TYPE", [])
    counts = words.get("COUNT", ["1"] * len(names))
    encoding = " ".join(words["DATA"]).lower()
    try:
        fields = [
            (name, {"F": "f", "I": "i", "U": "u"}[kind] + str(int(size)), int(count))
            for name, size, kind, count in zip(names, sizes, kinds, counts, strict=True)
        ]
        np.dtype([("", kind) for _, kind, _ in fields])
        width, height = int(words["WIDTH"][0]), int(words["HEIGHT"][0])
    except (KeyError, ValueError, IndexError, TypeError) as problem:
        raise FormatError(f"its header is no PCD header ({type(problem).__name__}: {problem})") from problem
    viewpoint = [float(w) for w in words.get("VIEWPOINT", []) if is_number(w)]
    promised = words.get("POINTS", [str(width * height)])
    if min(width, height, *(count for _, _, count in fields), 1) < 0 or promised != [str(width * height)]:
        raise FormatError(f"WIDTH {width} times HEIGHT {height} is not POINTS {' '.join(promised)[:20]}")
    if not {"x", "y", "z"} <= set(names) or encoding not in ("ascii", "binary", "binary_compressed"):
        raise FormatError(f"fields {' '.join(names)[:60]}, data {encoding[:30]}; x y z in ascii, binary or compressed")
    if any(kind[0] != "f" and kind[1] not in "1248" for _, kind, _ in fields) or any(c < 1 for _, _, c in fields):
        raise FormatError("its header gives a field of no size")
    return Layout(fields, width, height, viewpoint, encoding, offset, line)


def _origin(viewpoint: list[float]) -> list[float] | None:
    """Return the sensor's place, or None for the default and for what is no viewpoint."""
    is_pose = len(viewpoint) == 7 and bool(np.isfinite(viewpoint).all())
    if not is_pose or abs(np.linalg.norm(viewpoint[3:]) - 1.0) > 1e-3 or not any(viewpoint[:3]):
        return None
    return viewpoint[:3]


def _text_blocks(path: str, layout: Layout) -> Iterator[dict[str, Any]]:
    """Yield the first value of each field from text; a packed colour is a number of the field's type."""
    n_columns = sum(count for _, _, count in layout.fields)
    starts = np.cumsum([0, *(count for _, _, count in layout.fields)])
    end, line = skip_rows(path, layout.offset, layout.line, layout.n)
    if skip_blank(path, end, line)[0] < os.path.getsize(path):
        raise FormatError(f"goes on after line {line - 1}, where its header says that the points end")
    table = TableLayout(offset=layout.offset, n_columns=n_columns, n_rows=layout.n, first_line=layout.line)
    for rows in read_table(path, table):
        yield {
            name: rows[:, k].astype(kind) if name in ("rgb", "rgba") else rows[:, k]
            for (name, kind, _), k in zip(layout.fields, starts[:-1], strict=True)
        }


def _binary_blocks(path: str, layout: Layout) -> Iterator[dict[str, Any]]:
    """Yield the first value of each field from records."""
    room = (os.path.getsize(path) - layout.offset) // layout.record.itemsize
    if room != layout.n:
        raise FormatError(f"promises {layout.n} points, {room} fit in the file; it is cut off or damaged")
    with Path(path).open("rb") as file:
        file.seek(layout.offset)
        for start in range(0, layout.n, CHUNK):
            block = np.fromfile(file, layout.record, min(CHUNK, layout.n - start))
            yield {name: block[f"{k}"][:, 0] for k, (name, _, _) in enumerate(layout.fields)}


def _compressed_blocks(path: str, layout: Layout) -> Iterator[dict[str, Any]]:
    """Yield the first value of each field from a body that is compressed field by field."""
    with Path(path).open("rb") as file:
        file.seek(layout.offset)
        sizes = np.fromfile(file, "<u4", 2)
        packed = file.read(int(sizes[0])) if len(sizes) == 2 else b""
    if len(sizes) < 2 or len(packed) < sizes[0] or sizes[1] != layout.n * layout.record.itemsize:
        raise FormatError(f"its compressed body does not hold the {layout.n} points promised; it is cut off")
    body = decompress_lzf(packed, int(sizes[1]))
    values, offset = {}, 0
    for name, kind, count in layout.fields:
        field = np.frombuffer(body, f"<{kind}", layout.n * count, offset)
        offset += field.nbytes
        values[name] = field.reshape(layout.n, count)[:, 0]
    for start in range(0, layout.n, CHUNK):
        yield {name: field[start : start + CHUNK] for name, field in values.items()}


def decompress_lzf(packed: bytes, n: int) -> bytearray:
    """Return n bytes from their LZF form (Lehmann's libLZF): runs of literals and references back.

    Raises
    ------
    FormatError
        A reference before the beginning, or another length than promised.
    """
    out = bytearray()
    at, end = 0, len(packed)
    try:
        while at < end:
            control = packed[at]
            at += 1
            if control < 32:
                out += packed[at : at + control + 1]
                at += control + 1
                continue
            length, back = control >> 5, (control & 31) << 8
            if length == 7:
                length += packed[at]
                at += 1
            start = len(out) - back - packed[at] - 1
            at += 1
            if start < 0 or len(out) > n:
                raise IndexError
            seen = out[start : start + length + 2]  # shorter than the reference where it repeats itself
            out += (seen * (length + 2))[: length + 2] if len(seen) < length + 2 else seen
    except IndexError as problem:
        raise FormatError("its compressed body is damaged") from problem
    if len(out) != n:
        raise FormatError("its compressed body is damaged")
    return out


def _columns(values: dict[str, Any]) -> Columns:
    """Return the fields as the columns that every format gives."""
    columns: Columns = {"points": np.column_stack([values[axis] for axis in "xyz"]).astype(np.float64)}
    if "intensity" in values:
        columns["intensity"] = values["intensity"]
    if set(NORMALS) <= set(values):
        columns["normals"] = np.column_stack([values[name] for name in NORMALS]).astype(np.float64)
    packed = values.get("rgb", values.get("rgba"))
    if packed is not None and packed.dtype.itemsize == 4:
        bits = np.ascontiguousarray(packed).view(np.uint32)
        columns["colors"] = np.column_stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255]).astype(np.uint8)
        return columns
    for names in APART:
        if set(names) <= set(values):
            columns["colors"] = np.column_stack([values[name] for name in names])
            break
    return columns
