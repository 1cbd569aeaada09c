"""Points in plain text: XYZ, TXT, CSV, and PTS (Leica Cyclone), which is the same with a line of the count first.

Runs in the child process. The columns follow from a line of names where there is one (also behind `//` or `#`), else
from how many there are and what they hold. Coordinates that cannot be told with certainty are refused, not guessed.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from projects.errors import FormatError
from projects.formats.rawscan import Columns, ScanHeader, scaled
from projects.formats.text import (
    TableLayout,
    are_colours,
    are_unit_vectors,
    is_number,
    read_table,
    whole_numbers,
)

N_SAMPLE_LINES = 200
SYNONYMS = {
    "x": "x", "y": "y", "z": "z", "easting": "x", "northing": "y", "east": "x", "north": "y", "e": "x", "n": "y",
    "height": "z", "elevation": "z", "h": "z", "coordx": "x", "coordy": "y", "coordz": "z", "xcoordinate": "x",
    "ycoordinate": "y", "zcoordinate": "z", "intensity": "intensity", "scalarintensity": "intensity", "i": "intensity",
    "reflectance": "intensity", "r": "red", "g": "green", "b": "blue", "red": "red", "green": "green", "blue": "blue",
    "nx": "nx", "ny": "ny", "nz": "nz", "normalx": "nx", "normaly": "ny", "normalz": "nz",
    "rf": "red", "gf": "green", "bf": "blue",
}  # fmt: skip


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


def find_layout(path: str) -> ScanHeader:
    """Return how a text file is laid out: where its numbers begin, what separates them, what each column is."""
    lines, offsets = _first_lines(path)
    names, n_declared, start = _header_lines(lines)
    sample = [line for line in lines[start:] if line.strip() and not line.lstrip().startswith(("#", "//"))]
    if not sample:
        raise FormatError("holds no points")
    separator, has_decimal_comma = _separator(sample, names)
    words = [_words(line, separator, has_decimal_comma) for line in sample]
    n_columns = len(words[0])
    table = _sample_table(words, n_columns, start)
    roles = _named_roles(names, separator, n_columns) if names else _roles_by_content(table)
    layout = {"offset": offsets[start], "n_columns": n_columns, "separator": separator,
              "has_decimal_comma": has_decimal_comma, "first_line": start + 1}  # fmt: skip
    return ScanHeader(n_declared=n_declared, place={"layout": layout, "names": roles})


def _first_lines(path: str) -> tuple[list[str], list[int]]:
    """Return the first lines of the file and the offset of each; the last one is left out if it may be cut."""
    lines, offsets, offset = [], [], 0
    with Path(path).open("rb") as file:
        for raw in itertools.islice(iter(lambda: file.readline(2**16), b""), N_SAMPLE_LINES):
            text = raw.removeprefix(b"\xef\xbb\xbf") if not offset else raw
            lines.append(text.decode("utf-8", "replace").rstrip("\r\n"))
            offsets.append(offset + len(raw) - len(text))
            offset += len(raw)
    return lines, offsets


def _header_lines(lines: list[str]) -> tuple[str, int | None, int]:
    """Return the line of names ("" without), the count (None without), and the index of the first line of numbers."""
    names, n_declared = "", None
    for k, line in enumerate(lines):
        text = line.strip()
        bare = re.sub(r"\s*[\[(].*?[\])]", "", text.lstrip("#/%;! ")).strip()  # without marks and units
        counts = whole_numbers(text.encode())
        if _are_names(bare):
            names = bare
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


def _are_names(text: str) -> bool:
    """Return whether a line holds names of columns: x, y and z among its words."""
    roles = {SYNONYMS.get(_key(word)) for word in re.split(r"[\s,;]+", text)}
    return {"x", "y", "z"} <= roles


def _key(word: str) -> str:
    """Return a column's name without case, quotes, units and punctuation."""
    return re.sub(r"[^a-z]", "", re.sub(r"[\[(].*?[\])]", "", word.lower()))


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


def _sample_table(words: list[list[str]], n_columns: int, start: int) -> Any:
    """Return the first lines as numbers (n, n_columns); a last line that is odd is left to the full reading."""
    whole = [row for row in words if len(row) == n_columns and all(map(is_number, row))]
    if n_columns < 3 or not whole:
        raise FormatError(f"line {start + 1} holds {n_columns} values; a point needs three numbers, x y z")
    return np.array([[float(word) for word in row] for row in whole])


def _named_roles(names: str, separator: str, n_columns: int) -> list[str]:
    """Return the role of each column by its name; columns of no use here are called by a dash."""
    words = [w for w in (names.split() if separator == " " else re.split(r"[,;\t]", names)) if w.strip()]
    if len(words) != n_columns:
        words = re.split(r"[\s,;]+", names.strip())
    if len(words) != n_columns:
        raise FormatError(f"names {len(words)} columns ({names[:80]}), but its lines hold {n_columns} values")
    roles = [SYNONYMS.get(_key(word), "-") for word in words]
    twice = [words[k] for k, role in enumerate(roles) if role != "-" and role in roles[:k]]
    if twice:
        raise FormatError(f"names two columns for the same thing ({', '.join(twice)}); rename or remove one")
    whole = [set("xyz"), {"red", "green", "blue"}, {"nx", "ny", "nz"}, {"intensity"}]
    complete = set().union(*(group for group in whole if group <= set(roles)))
    return [role if role in complete else "-" for role in roles]


def _roles_by_content(table: Any) -> list[str]:
    """Return the role of each column of a table without names.

    x y z come first. After them: one column is intensity; three are colours or normals, by what they hold; four are
    intensity with colours before or after it. Anything else is left out.
    """
    n = table.shape[1]
    _refuse_line_numbers(table)
    rest = table[:, 3:]
    after = ["-"] * (n - 3)
    colours_first, colours_second = are_colours(rest[:, :3]), are_colours(rest[:, 1:4])
    is_opaque = n >= 7 and bool((rest[:, 3] == rest[0, 3]).all())  # red green blue and one constant alpha
    if n == 4:
        after = ["intensity"]
    elif n >= 7 and colours_second and not (colours_first and (is_opaque or n > 7)):
        after[:4] = ["intensity", "red", "green", "blue"]
    elif n >= 6 and colours_first:
        after[:3] = ["red", "green", "blue"]
    elif n >= 6 and are_unit_vectors(rest[:, :3]):
        after[:3] = ["nx", "ny", "nz"]
    return ["x", "y", "z", *after]


def _refuse_line_numbers(table: Any) -> None:
    """Raise where the first column counts the lines, so that the coordinates begin after it."""
    steps = np.diff(table[:, :2], axis=0)
    counts = len(table) > 3 and (steps[:, 0] == 1).all() and not (steps[:, 1] == 1).all()
    if counts and table.shape[1] > 3 and (table[:, 0] == np.floor(table[:, 0])).all():
        raise FormatError("its first column counts the points; name the columns in a first line, such as: id x y z")
