"""Points in plain text: XYZ, TXT, CSV, and PTS (Leica Cyclone), which is the same with a line of the count first.

Runs in the child process. The columns follow from a line of names where there is one (also behind `//` or `#`), else
from how many there are and what they hold (`columns`).
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from projects.errors import FormatError
from projects.formats.columns import (
    are_names,
    named_roles,
    named_unit,
    refuse_grid_places,
    refuse_line_numbers,
    roles_by_content,
    step_of_few_digits,
    step_of_fixed_decimals,
    unread_columns,
)
from projects.formats.rawscan import Columns, ScanHeader, scaled
from projects.formats.text import TableLayout, is_number, read_table, require_line_feeds, whole_numbers

N_SAMPLE_LINES = 200
N_PLACES, BYTES_AT_PLACE = 8, 2**13  # of a long file, where lines are looked at as well


def list_scans(path: str) -> list[ScanHeader]:
    """Return the one scan of a text file, with the layout found in its first lines."""
    return [find_layout(path)]


def read_scan(path: str, header: ScanHeader) -> Iterator[Columns]:
    """Yield the points."""
    return scaled(lambda: read_blocks(path, header))


def read_blocks(path: str, header: ScanHeader) -> Iterator[Columns]:
    """Yield the points with intensities and colours as the file has them."""
    layout = TableLayout(**header.place["layout"])
    names: list[str] = header.place["names"]
    n_read = 0
    for rows in read_table(path, layout):
        n_read += len(rows)
        columns: Columns = {"points": rows[:, [names.index(axis) for axis in "xyz"]]}
        if "intensity" in names:
            columns["intensity"] = rows[:, names.index("intensity")]
        if "red" in names:
            columns["colors"] = rows[:, [names.index(c) for c in ("red", "green", "blue")]]
        if "nx" in names:
            columns["normals"] = rows[:, [names.index(n) for n in ("nx", "ny", "nz")]]
        yield columns
    if header.n_declared not in (None, n_read):
        raise FormatError(f"promises {header.n_declared} points, {n_read} are there; the file is cut off or patched")


def find_layout(path: str, is_pts: bool = False) -> ScanHeader:
    """Return how a text file is laid out: where its numbers begin, what separates them, what each column is.

    A count before the points, or `is_pts`, is the mark of PTS, which orders its columns by definition.
    """
    lines, offsets = _first_lines(path)
    names, n_declared, start = _header_lines(lines)
    sample = [line for line in lines[start:] if line.strip() and not line.lstrip().startswith(("#", "//"))]
    if not sample:
        raise FormatError("holds no points")
    separator, has_decimal_comma = _separator(sample, names)
    words = [_words(line, separator, has_decimal_comma) for line in sample]
    n_columns = len(words[0])
    table = _sample_table(words, n_columns, start)
    if names:
        roles = named_roles(names, separator, n_columns)
    else:
        refuse_line_numbers(table)
        refuse_grid_places(table)
        later = [_words(line, separator, has_decimal_comma) for line in _later_lines(path, offsets[-1])]
        roles = roles_by_content(_numeric([*words, *later], n_columns), is_pts or n_declared is not None)
    places = [roles.index(axis) for axis in "xyz"]
    written = [[row[k] for k in places] for row in words if len(row) == n_columns and all(map(is_number, row))]
    step = max(step_of_few_digits(written), step_of_fixed_decimals(written))
    system = named_unit(names)
    layout = {"offset": offsets[start], "n_columns": n_columns, "separator": separator,
              "has_decimal_comma": has_decimal_comma, "first_line": start + 1}  # fmt: skip
    return ScanHeader(
        n_declared=n_declared, unread=unread_columns(roles), step=step,
        system=None if system is None else asdict(system), place={"layout": layout, "names": roles},
    )  # fmt: skip


def _first_lines(path: str) -> tuple[list[str], list[int]]:
    """Return the first lines of the file and the offset of each; the last one is left out if it may be cut."""
    lines, offsets, offset = [], [], 0
    with Path(path).open("rb") as file:
        for raw in itertools.islice(iter(lambda: file.readline(2**16), b""), N_SAMPLE_LINES):
            require_line_feeds(raw)
            text = raw.removeprefix(b"\xef\xbb\xbf") if not offset else raw
            lines.append(text.decode("utf-8", "replace").rstrip("\r\n"))
            offsets.append(offset + len(raw) - len(text))
            offset += len(raw)
    return lines, offsets


def _later_lines(path: str, after: int) -> list[str]:
    """Return whole lines from places spread over the rest of a file, behind an offset."""
    lines: list[str] = []
    with Path(path).open("rb") as file:
        size = file.seek(0, 2)
        for place in np.linspace(after, size, N_PLACES + 1, dtype=np.int64)[:-1]:
            file.seek(int(place))
            whole = file.read(BYTES_AT_PLACE).split(b"\n")[1:-1]
            lines += [line.decode("utf-8", "replace").strip() for line in whole]
    return lines


def _header_lines(lines: list[str]) -> tuple[str, int | None, int]:
    """Return the line of names ("" without), the count (None without), and the index of the first line of numbers."""
    names, n_declared = "", None
    for k, line in enumerate(lines):
        text = line.strip()
        unmarked = text.lstrip("#/%;! ")
        counts = whole_numbers(text.encode())
        if are_names(unmarked):
            names = unmarked
        elif not text or text.startswith(("#", "//", "%", ";", "!")):
            continue
        elif counts and len(counts) == 1 and n_declared is None:
            n_declared = counts[0]
        elif is_number(re.split(r"[\s,;]+", text.replace('"', " ").strip())[0].replace(",", ".")):
            return names, n_declared, k
        else:
            raise FormatError(
                f"line {k + 1} is neither numbers nor names of columns with x, y and z among them: {text[:60]!r}"
            )
    return names, n_declared, len(lines)


def _separator(sample: list[str], names: str) -> tuple[str, bool]:
    """Return what stands between numbers, and whether the decimal sign is a comma."""
    for mark in (";", "\t"):
        if all(mark in line for line in sample):
            return mark, _has_decimal_commas(sample, mark)
    if all("," in line for line in sample):
        if all(len(line.split()) >= 3 for line in sample) and _has_decimal_commas(sample, " "):
            return " ", True
        _refuse_ambiguous_commas(sample, names)
        return ",", False
    return " ", False


def _has_decimal_commas(sample: list[str], separator: str) -> bool:
    """Return whether the fields between separators hold a comma where a point would be."""
    words = [word for line in sample for word in (line.split() if separator == " " else line.split(separator))]
    words = [word.replace('"', " ") for word in words]
    fits = [re.fullmatch(r"\s*[-+]?\d+(,\d+)?([eE][-+]?\d+)?\s*", word) for word in words if word.strip()]
    return any("," in word for word in words) and all(fits)


def _refuse_ambiguous_commas(sample: list[str], names: str) -> None:
    """Raise where commas may separate numbers or be their decimal sign."""
    n_words = len(sample[0].split(","))
    looks_whole = not any(re.search(r"[.eE]", line) for line in sample)
    if not names and looks_whole and n_words >= 6 and n_words % 2 == 0:
        raise FormatError("its commas may separate numbers or be decimal commas; write points, or separate with ;")


def _words(line: str, separator: str, has_decimal_comma: bool) -> list[str]:
    """Return the words of a line."""
    line = line.replace('"', " ")
    if has_decimal_comma:
        line = line.replace(",", ".")
    return (line if separator in " \t" else line.replace(separator, " ")).split()


def _sample_table(words: list[list[str]], n_columns: int, start: int) -> NDArray[np.float64]:
    """Return the first lines as numbers (n, n_columns); a last line that is odd is left to the full reading."""
    table = _numeric(words, n_columns)
    wrong = [word for word in words[0] if not is_number(word)]
    if wrong and n_columns >= 3 and not len(table):
        raise FormatError(
            f"line {start + 1} has {wrong[0][:40]!r}, which is no number; mend it, or take a column of words out"
        )
    if n_columns < 3 or not len(table):
        raise FormatError(f"line {start + 1} holds {n_columns} values; a point needs three numbers, x y z")
    return table


def _numeric(words: list[list[str]], n_columns: int) -> NDArray[np.float64]:
    """Return those lines as numbers (n, n_columns) that hold as many as they should and nothing else."""
    whole = [row for row in words if len(row) == n_columns and all(map(is_number, row))]
    return np.array([[float(word) for word in row] for row in whole])
