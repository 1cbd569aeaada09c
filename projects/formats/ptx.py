"""PTX scans in (Leica Cyclone): several a file, each a grid in its scanner's frame with a transform and `0 0 0` rows.

Runs in the child process. The header of a scan is ten lines: columns, rows, the scanner's position, its three axes,
and the 4 x 4 transform for row vectors. The points follow column by column: x y z intensity [red green blue].
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from projects.errors import FormatError
from projects.formats.rawscan import Columns, ScanHeader, scaled
from projects.formats.text import TableLayout, is_number, read_table, skip_blank, skip_rows, whole_numbers

N_HEADER_LINES = 10
N_PLACES, BYTES_AT_PLACE = 16, 2**13  # of a scan, where lines are looked at for the range of intensities
VALUES = (1, 1, 3, 3, 3, 3, 4, 4, 4, 4)  # of each header line


def list_scans(path: str) -> list[ScanHeader]:
    """Return the header of every scan, with the place of its points."""
    headers: list[ScanHeader] = []
    beside: list[list[float]] = []
    offset, line = skip_blank(path, 0, 1)
    while offset < os.path.getsize(path):
        header, begin, line = _read_header(path, offset, line, len(headers) + 1)
        headers.append(header)
        offset, line = skip_rows(path, begin, line, header.n_declared or 0)
        beside.append(_some_intensities(path, begin, offset, header.place["layout"]["n_columns"]))
        offset, line = skip_blank(path, offset, line)
    if not headers:
        raise FormatError("holds no scans; it is empty")
    told = [number for numbers in beside for number in numbers]
    return [dataclasses.replace(header, place={**header.place, "beside": told}) for header in headers]


def _some_intensities(path: str, begin: int, end: int, n_columns: int) -> list[float]:
    """Return the least and the largest intensity, and one with decimals where there is any, of whole lines from places
    spread over a scan: all scans of a file have one range, in which each of them may be dark."""
    if n_columns not in (4, 7):
        return []
    lines: list[list[bytes]] = []
    with Path(path).open("rb") as file:
        for place in np.unique(np.linspace(begin, end, N_PLACES + 1, dtype=np.int64)[:-1]):
            file.seek(int(place))
            text = file.read(min(BYTES_AT_PLACE, end - int(place))).split(b"\n")
            lines += [words.split() for words in text[int(place > begin) : -1]]
    whole = [[w.decode("ascii", "replace") for w in words] for words in lines if len(words) == n_columns]
    numbers = [[float(w) for w in words[:4]] for words in whole if all(map(is_number, words))]
    told = sorted(i for *xyz, i in numbers if any(xyz) and np.isfinite(i))
    return [told[0], told[-1], *[i for i in told if i != np.floor(i)][:1]] if told else []


def read_scan(path: str, header: ScanHeader) -> Iterator[Columns]:
    """Yield the points of one scan, no-returns among them as 0 0 0."""
    return scaled(lambda: _read_blocks(path, header), np.array(header.place["beside"], dtype=np.float64))


def _read_blocks(path: str, header: ScanHeader) -> Iterator[Columns]:
    """Yield the points of one scan with intensities and colours as the file has them."""
    layout = TableLayout(**header.place["layout"])
    n_grid_rows = header.place["n_grid_rows"]
    start = 0
    for rows in read_table(path, layout):
        index = np.arange(start, start + len(rows))
        start += len(rows)
        columns: Columns = {"points": rows[:, :3]}
        has_return = (rows[:, :3] != 0.0).any(axis=1)
        if layout.n_columns in (4, 7):
            columns["intensity"] = np.where(has_return, rows[:, 3], np.nan)
        if layout.n_columns in (6, 7):
            columns["colors"] = rows[:, -3:]
        columns["columns"], columns["rows"] = np.divmod(index, n_grid_rows)
        yield columns


def _read_header(path: str, offset: int, line: int, number: int) -> tuple[ScanHeader, int, int]:
    """Return the header that begins at an offset, and where its points begin."""
    with Path(path).open("rb") as file:
        file.seek(offset)
        lines = [file.readline(1000) for _ in range(N_HEADER_LINES)]
        begin = file.tell()
        first = file.readline(1000).split()
    values = [text.split() for text in lines]
    for k, (words, n) in enumerate(zip(values, VALUES, strict=True)):
        if len(words) != n or not all(is_number(w.decode("ascii", "replace")) for w in words):
            raise FormatError(
                f"scan {number}: line {line + k} should hold {n} number{'s' if n > 1 else ''} of the PTX header "
                f"and holds {b' '.join(words)[:60].decode('ascii', 'replace')!r}"
            )
    counts = whole_numbers(b" ".join(lines[:2]))
    if counts is None:
        raise FormatError(f"scan {number}: line {line} and the next should be the numbers of columns and rows")
    n_columns, n_rows = counts
    if n_columns * n_rows and len(first) not in (3, 4, 6, 7):
        raise FormatError(f"scan {number}: line {line + 10} holds {len(first)} values; 3, 4, 6 or 7 make a PTX point")
    numbers = np.array([float(w) for words in values[2:] for w in words])
    place = {"offset": begin, "n_columns": len(first), "n_rows": n_columns * n_rows, "first_line": line + 10}
    return _header(numbers, place, (n_rows, n_columns)), begin, line + N_HEADER_LINES


def _header(numbers: Any, layout: dict[str, Any], size: tuple[int, int]) -> ScanHeader:
    """Return the header made of the 28 numbers after the size."""
    position, axes = numbers[:3], numbers[3:12].reshape(3, 3)
    pose = numbers[12:].reshape(4, 4).T
    origin = _origin(position, axes, pose)
    return ScanHeader(
        pose=pose.tolist(),
        origin=origin,
        n_declared=size[0] * size[1],
        is_grid=min(size) > 1,
        is_centred=True,
        is_doubted=origin is None,
        place={"layout": layout, "n_grid_rows": max(size[0], 1)},
    )


def _origin(position: Any, axes: Any, pose: Any) -> list[float] | None:
    """Return the scanner's position in the scan's frame; None where the header leaves it at its default, or has none.

    The position is in the frame that the transform leads to, so it is taken back through the transform: 0 0 0 for a
    scan in its own frame, the station's coordinates for one that was exported in project coordinates.
    """
    says_nothing = not np.isfinite(position).all() or (not position.any() and (axes == np.eye(3)).all())
    if says_nothing or abs(np.linalg.det(pose[:3, :3])) < 1e-9:
        return None
    origin = np.linalg.solve(pose[:3, :3], position - pose[:3, 3])
    return [0.0, 0.0, 0.0] if np.abs(origin).max() < 1e-5 else origin.tolist()  # the header's last digit
