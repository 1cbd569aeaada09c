"""Control points: CSV `name,x,y,z[,sigma]`, in the project's frame."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from projects.errors import FormatError
from projects.formats.text import is_number
from projects.formats.units import require_unit
from projects.model import ControlPoint

MOST_BYTES = 64 * 2**20


def read_control(path: Path, *, unit: float = 1.0) -> tuple[ControlPoint, ...]:
    """Return the control points of a CSV file, in metres.

    Parameters
    ----------
    path : lines `name,x,y,z` or `name,x,y,z,sigma`; a first line of names, blank lines and lines that begin with `#`
        are passed over. Semicolons or tabs may stand for commas, which then are decimal commas.
    unit : metres per unit of its lengths, sigma included.

    Raises
    ------
    FormatError
        A line with the wrong count or a word that is no number, a sigma that is not positive and finite, a name given
        twice.
    """
    path = Path(path)
    require_unit(unit)
    points: dict[str, ControlPoint] = {}
    for k, (number, words) in enumerate(_rows(path)):
        where = f"{path}, line {number}"
        if not k and len(words) in (4, 5) and not any(is_number(word) for word in words[1:]):
            continue  # the names of the columns
        point = _control_point(words, unit, where)
        if point.name in points:
            raise FormatError(f"{where}: control point {point.name} is there already; give each a name of its own")
        points[point.name] = point
    if not points:
        raise FormatError(f"{path}: holds no control points; a line is name,x,y,z or name,x,y,z,sigma")
    return tuple(points.values())


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return the lines that say something, with their numbers, as words."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise FormatError(f"{path}: is larger than 64 MiB and no control file")
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as problem:
        raise FormatError(f"{path}: cannot be read ({problem.strerror})") from problem
    except UnicodeDecodeError as problem:
        raise FormatError(f"{path}: is no text in UTF-8 ({problem})") from problem
    told = [(k, line) for k, line in enumerate(lines, start=1) if line.strip() and not line.lstrip().startswith("#")]
    separator = next((mark for mark in (";", "\t") if told and mark in told[0][1]), ",")
    rows = [(k, [word.strip() for word in next(csv.reader([line], delimiter=separator))]) for k, line in told]
    if separator == ",":
        return rows
    return [(k, [*words[:1], *(word.replace(",", ".") for word in words[1:])]) for k, words in rows]


def _control_point(words: list[str], unit: float, where: str) -> ControlPoint:
    """Return the point that a line's words make."""
    if len(words) not in (4, 5) or not words[0]:
        raise FormatError(f"{where}: {len(words)} values; name,x,y,z or name,x,y,z,sigma is needed")
    if not all(is_number(word) for word in words[1:] if word) or not all(words[1:4]):
        raise FormatError(f"{where}: {','.join(words[1:])[:80]!r} are not all numbers")
    position = unit * np.array([float(word) for word in words[1:4]])
    sigma = unit * float(words[4]) if len(words) == 5 and words[4] else np.nan
    if not np.isfinite(position).all():
        raise FormatError(f"{where}: a coordinate is not finite")
    if sigma <= 0 or np.isinf(sigma):
        raise FormatError(f"{where}: sigma {words[4]} is not positive and finite; leave it out where it is unknown")
    return ControlPoint(words[0], position, sigma)
