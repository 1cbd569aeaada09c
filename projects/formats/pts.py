"""PTS points in (Leica Cyclone): a line of the count, then x y z [intensity] [red green blue] in project coordinates.

Runs in the child process. Names of columns and comments may stand before the first count, as CloudCompare writes them.
Several clouds may follow one another, each with its count; they are one scan here.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from projects.errors import FormatError
from projects.formats import xyz
from projects.formats.columns import are_names
from projects.formats.rawscan import Columns, ScanHeader, scaled
from projects.formats.text import skip_blank, skip_rows, whole_numbers

COMMENTS = ("#", "//", "%", ";", "!")


def list_scans(path: str) -> list[ScanHeader]:
    """Return the one scan of the file; its count is the sum of those of its clouds, or None without counts."""
    header = xyz.find_layout(path, is_pts=True)
    if header.n_declared is None:
        return [header]
    parts = list(_parts(path))
    n_declared = sum(part["n_rows"] for part in parts)
    return [dataclasses.replace(header, n_declared=n_declared, place={**header.place, "parts": parts})]


def read_scan(path: str, header: ScanHeader) -> Iterator[Columns]:
    """Yield the points of all clouds of the file."""
    return scaled(lambda: _read_blocks(path, header))


def _read_blocks(path: str, header: ScanHeader) -> Iterator[Columns]:
    """Yield the points of all clouds with intensities and colours as the file has them."""
    layout = header.place["layout"]
    for part in header.place.get("parts", [{}]):
        place = {**header.place, "layout": {**layout, **part}}
        yield from xyz.read_blocks(path, dataclasses.replace(header, n_declared=part.get("n_rows"), place=place))


def _parts(path: str) -> Iterator[dict[str, Any]]:
    """Yield where each cloud of the file begins and how many lines it has."""
    offset, line = _skip_titles(path)
    while offset < os.path.getsize(path):
        with Path(path).open("rb") as file:
            file.seek(offset)
            counts = whole_numbers(file.readline(1000).removeprefix(b"\xef\xbb\xbf"))
            begin = file.tell()
        if counts is None or len(counts) != 1:
            raise FormatError(f"line {line} should be the number of points that follow; more points than promised?")
        if counts[0]:
            yield {"offset": begin, "n_rows": counts[0], "first_line": line + 1}
        offset, line = skip_blank(path, *skip_rows(path, begin, line + 1, counts[0]))


def _skip_titles(path: str) -> tuple[int, int]:
    """Return the offset and the number of the first line that is neither blank nor names of columns nor a comment."""
    offset, line = skip_blank(path, 0, 1)
    while offset < os.path.getsize(path):
        with Path(path).open("rb") as file:
            file.seek(offset)
            text = file.readline(1000)
        words = text.decode("utf-8-sig", "replace").strip()
        if not words.startswith(COMMENTS) and not are_names(words):
            break
        offset, line = skip_blank(path, offset + len(text), line + 1)
    return offset, line
