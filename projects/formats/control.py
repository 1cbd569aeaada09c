"""Control points: CSV `name,x,y,z[,sigma]`, in the project's frame, or with a first line that names other columns."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from projects.errors import FormatError
from projects.formats.columns import SPELT, SYNONYMS, named_unit, plain_name
from projects.formats.text import is_number
from projects.formats.units import METRES, require_unit
from projects.model import ControlPoint
from projects.reference_systems import SAME_UNIT

MOST_BYTES = 64 * 2**20
BRACKETS = re.compile(r"([^,\[\]()]*)[\[(]\s*([^,\[\]()]*?)\.?\s*[\])]")  # behind a column's name
COLUMNS = ("name", "x", "y", "z", "sigma")
NAMED = {
    **{word: axis for word, axis in SYNONYMS.items() if axis in COLUMNS},
    **dict.fromkeys(
        ("name", "id", "nr", "no", "number", "point", "pointid", "punkt", "punktnr", "punktnummer"), "name"
    ),
    **dict.fromkeys(("sigma", "sd", "std", "stdev", "stddev"), "sigma"),
}


def read_control(path: Path, *, unit: float = 1.0) -> tuple[ControlPoint, ...]:
    """Return the control points of a CSV file, in metres.

    Parameters
    ----------
    path : lines `name,x,y,z` or `name,x,y,z,sigma`, or with their values as a first line names them, which may be a
        comment: eastings are x, northings y, whichever stands first. Blank lines and other lines that begin with `#`
        are passed over. Semicolons or tabs may stand for commas, which then are decimal commas.
    unit : metres per unit of its lengths, sigma included where its column has no unit of its own in brackets.

    Raises
    ------
    FormatError
        A first line of names of which one is not known, missing or there twice, or whose unit is not known or not
        `unit`; a line with the wrong count or a word that is no number, a sigma that is not positive and finite, a
        name given twice.
    """
    path = Path(path)
    require_unit(unit)
    separator, rows, comments = _rows(path)
    roles, of_sigma = [*COLUMNS], unit
    names = _names(rows, comments)
    if names is not None:
        rows = rows[1:] if names == rows[0] else rows
        where = f"{path}, line {names[0]}"
        roles, of_sigma = _roles(names[1], where), _unit_of_sigma(names[1], unit, where)
    points: dict[str, ControlPoint] = {}
    for number, words in rows:
        where = f"{path}, line {number}"
        ordered = _in_order(words, roles, where)
        if separator != ",":
            ordered = [*ordered[:1], *(word.replace(",", ".") for word in ordered[1:])]
        point = _control_point(ordered, unit, of_sigma, where)
        if point.name in points:
            raise FormatError(f"{where}: control point {point.name} is there already; give each a name of its own")
        points[point.name] = point
    if not points:
        raise FormatError(f"{path}: holds no control points; a line is name,x,y,z or name,x,y,z,sigma")
    return tuple(points.values())


def _rows(path: Path) -> tuple[str, list[tuple[int, list[str]]], list[tuple[int, list[str]]]]:
    """Return what separates words, the lines that say something, with their numbers, as words, and the comments before
    them."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise FormatError(f"{path}: is larger than 64 MiB and no control file")
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as problem:
        raise FormatError(f"{path}: cannot be read ({problem.strerror})") from problem
    except UnicodeDecodeError as problem:
        raise FormatError(f"{path}: is no text in UTF-8 ({problem})") from problem
    said = [(k, line.strip()) for k, line in enumerate(lines, start=1) if line.strip()]
    told = [(k, line) for k, line in said if not line.startswith("#")]
    before = [(k, line.lstrip("# ")) for k, line in said if told and k < told[0][0]]
    separator = next((mark for mark in (";", "\t") if told and mark in told[0][1]), ",")

    def split(of: list[tuple[int, str]]) -> list[tuple[int, list[str]]]:
        return [(k, [word.strip() for word in next(csv.reader([line], delimiter=separator))]) for k, line in of if line]

    return separator, split(told), split(before)


def _names(rows: Sequence[tuple[int, list[str]]], comments: Sequence[tuple[int, list[str]]],
           ) -> tuple[int, list[str]] | None:  # fmt: skip
    """Return the line that names the columns, with its number: the first one without a number in it, else the last
    comment before it that names x, y and z; None without."""
    if rows and not any(is_number(word.replace(",", ".")) for word in rows[0][1]):
        return rows[0]
    named = [line for line in comments if {"x", "y", "z"} <= {NAMED.get(plain_name(word)) for word in line[1]}]
    return named[-1] if named else None


def _roles(words: Sequence[str], where: str) -> list[str]:
    """Return which of `COLUMNS` each column is; the first is the points' name, however it is called, where no other is
    and it is none of the others. Empty where the line has an empty word, as behind a last separator."""
    roles = [NAMED.get(plain_name(word), "?") if word else "" for word in words]
    if roles[0] == "?" and "name" not in roles:
        roles[0] = "name"
    unknown = [word for word, role in zip(words, roles, strict=True) if role == "?"]
    missing = [role for role in COLUMNS[:4] if role not in roles]
    twice = [role for role in COLUMNS if roles.count(role) > 1]
    needed = "name the columns name, x (or easting), y (or northing), z (or height) and sigma, or leave that line out"
    if unknown:
        raise FormatError(f"{where}: {unknown[0][:40]!r} is no known name of a column; {needed}")
    if missing:
        raise FormatError(f"{where}: names no column for {', '.join(missing)}; {needed}")
    if twice:
        raise FormatError(f"{where}: names two columns for {', '.join(twice)}; {needed}")
    return roles


def _unit_of_sigma(words: Sequence[str], unit: float, where: str) -> float:
    """Return the metres per unit of sigma, by what its name has in brackets; raise where the coordinates have another
    unit in brackets than `unit`, or where a unit is not known."""
    line = ",".join(words)
    try:
        system = named_unit(line)
    except FormatError as problem:
        raise FormatError(f"{where}: {problem}") from problem
    if system and (system.heights or abs((system.metres or 0.0) / unit - 1.0) > SAME_UNIT):
        raise FormatError(
            f"{where}: names its coordinates in {system.unit}{system.heights and ' and ' + system.heights}, "
            f"but they are read with {unit:g} m to the unit, as the scans are (--unit); bring all into one unit"
        )
    in_brackets = [
        (name, SPELT.get(word.lower().removesuffix("s"), word.lower())) for name, word in BRACKETS.findall(line)
    ]
    unknown = [word for _, word in in_brackets if word not in METRES]
    if unknown:
        raise FormatError(f"{where}: [{unknown[0][:40]}] is no known unit; one of {', '.join(METRES)} is needed")
    return next((METRES[word] for name, word in in_brackets if NAMED.get(plain_name(name)) == "sigma"), unit)


def _in_order(words: list[str], roles: Sequence[str], where: str) -> list[str]:
    """Return a line's words in the order of `COLUMNS`; sigma may be left out where it is last."""
    n_least = max(k for k, role in enumerate(roles) if role in COLUMNS[:4]) + 1
    beyond = [word for word, role in zip(words, [*roles, *[""] * len(words)], strict=False) if word and not role]
    if len(words) < n_least or beyond:
        needed = ",".join(role for role in roles if role)
        raise FormatError(f"{where}: {len(words)} values; {needed} is needed")
    of_role = dict(zip(roles, [*words, *[""] * len(roles)], strict=False))
    return [of_role.get(role, "") for role in COLUMNS]


def _control_point(words: Sequence[str], unit: float, of_sigma: float, where: str) -> ControlPoint:
    """Return the point that a line's words make, in the order of `COLUMNS`."""
    if not words[0]:
        raise FormatError(f"{where}: has no name; name,x,y,z or name,x,y,z,sigma is needed")
    if not all(is_number(word) for word in words[1:] if word) or not all(words[1:4]):
        raise FormatError(f"{where}: {','.join(words[1:]).strip(',')[:80]!r} are not all numbers")
    position = unit * np.array([float(word) for word in words[1:4]])
    sigma = of_sigma * float(words[4]) if words[4] else np.nan
    if not np.isfinite(position).all():
        raise FormatError(f"{where}: a coordinate is not finite")
    if sigma <= 0 or np.isinf(sigma):
        raise FormatError(f"{where}: sigma {words[4]} is not positive and finite; leave it out where it is unknown")
    return ControlPoint(words[0], position, sigma)
