"""What each column of a table of points is: by a line of names where there is one, else by what the columns hold.

Runs in the child process. What cannot be told with certainty is refused, or left out and said; nothing is guessed.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from projects.errors import FormatError
from projects.formats.units import METRES
from projects.reference_systems import ReferenceSystem

SYNONYMS = {
    "x": "x", "y": "y", "z": "z", "easting": "x", "northing": "y", "east": "x", "north": "y", "e": "x", "n": "y",
    "height": "z", "elevation": "z", "h": "z", "coordx": "x", "coordy": "y", "coordz": "z", "xcoordinate": "x",
    "ycoordinate": "y", "zcoordinate": "z", "intensity": "intensity", "i": "intensity",
    "reflectance": "intensity", "r": "red", "g": "green", "b": "blue", "red": "red", "green": "green", "blue": "blue",
    "nx": "nx", "ny": "ny", "nz": "nz", "normalx": "nx", "normaly": "ny", "normalz": "nz",
    "rf": "red", "gf": "green", "bf": "blue", "rechtswert": "x", "hochwert": "y", "hoehe": "z",
}  # fmt: skip
LESSER = ("scalar", "reflectance")  # names that yield to others for the same thing
SPELT = {"metre": "m", "meter": "m", "millimetre": "mm", "millimeter": "mm", "centimetre": "cm", "centimeter": "cm",
         "inch": "in", "inche": "in", "foot": "ft", "feet": "ft"}  # fmt: skip
UNIT = re.compile(r"([^,;\t\[\]()]*?)\s*[\[(]\s*([A-Za-z]+)\.?\s*[\])]")  # of a column, in brackets behind its name
COLOUR, NORMAL = ["red", "green", "blue"], ["nx", "ny", "nz"]
BRIGHTEST = 255  # of 8 bits
FEWEST_DIGITS, MOST_DIGITS = 5, 7  # significant, of numbers that a program shortened by default
N_WRITTEN = 20  # rows that tell with how many digits numbers are written
N_EVEN = 2  # steps, within a line and back to the next, of places that are laid out
N_TOLD = 4  # rows that tell whether whole numbers count something


def are_names(text: str) -> bool:
    """Return whether a line holds names of columns: x, y and z among its words."""
    roles = {SYNONYMS.get(_key(word)) for word in re.split(r"[\s,;]+", without_units(text))}
    return {"x", "y", "z"} <= roles


def without_units(names: str) -> str:
    """Return a line of names without what stands in brackets."""
    return re.sub(r"\s*[\[(].*?[\])]", "", names).strip()


def plain_name(word: str) -> str:
    """Return a column's name without case, quotes, units and punctuation."""
    return re.sub(r"[^a-z]", "", without_units(word.lower()).replace("ö", "oe"))


def _key(word: str) -> str:
    """Return a column's plain name without what CloudCompare puts before the names of scalar fields (never x y z)."""
    key = plain_name(word)
    plain = key.removeprefix("scalar")
    return key if SYNONYMS.get(plain) in ("x", "y", "z") else plain


def named_unit(names: str) -> ReferenceSystem | None:
    """Return the unit of the coordinates that a line of names states in brackets, such as X [ft]; None without.

    Raises `FormatError` where x and y have different ones.
    """
    stated: dict[str, str] = {}
    for name, word in UNIT.findall(names):
        role = SYNONYMS.get(_key(name)) or SYNONYMS.get(_key((name.split() or [""])[-1]))
        short = SPELT.get(word.lower().removesuffix("s"), word.lower())
        if role in ("x", "y", "z") and short in METRES:
            stated[role] = short
    if not stated:
        return None
    plane = stated.get("x") or stated.get("y") or stated["z"]
    if stated.get("y", plane) != plane:
        raise FormatError(f"names x in {stated['x']} and y in {stated['y']}; bring all coordinates into one unit")
    height = stated.get("z", plane)
    return ReferenceSystem("", plane, METRES[plane], height if height != plane else "")


def named_roles(names: str, separator: str, n_columns: int) -> list[str]:
    """Return the role of each column by its name; columns of no use here are called by a dash."""
    names = without_units(names)
    words = [w for w in (names.split() if separator == " " else re.split(r"[,;\t]", names)) if w.strip()]
    if len(words) != n_columns:
        words = re.split(r"[\s,;]+", names.strip())
    if len(words) != n_columns:
        raise FormatError(f"names {len(words)} columns ({names[:80]}), but its lines hold {n_columns} values")
    roles = _without_lesser(words, [SYNONYMS.get(_key(word), "-") for word in words])
    twice = [words[k] for k, role in enumerate(roles) if role != "-" and role in roles[:k]]
    if twice:
        raise FormatError(f"names two columns for the same thing ({', '.join(twice)}); rename or remove one")
    whole = [set("xyz"), set(COLOUR), set(NORMAL), {"intensity"}]
    complete = set().union(*(group for group in whole if group <= set(roles)))
    return [role if role in complete else "-" for role in roles]


def _without_lesser(words: list[str], roles: list[str]) -> list[str]:
    """Return the roles with a dash for scalar fields and reflectances of what another column holds by its plain name:
    colours and their copies, intensities beside reflectances."""
    is_lesser = [word.lower().lstrip('"').startswith(LESSER) for word in words]
    plain = {role for role, lesser in zip(roles, is_lesser, strict=True) if not lesser}
    return ["-" if lesser and role in plain else role for role, lesser in zip(roles, is_lesser, strict=True)]


def roles_by_content(table: NDArray[np.float64], is_pts: bool) -> list[str]:
    """Return the role of each column of a table without names; what nobody can tell is called by a question mark.

    x y z come first. After them: one column is intensity; three are colours or normals, by what they hold, and the
    other of the two may follow; four are intensity with colours before or after it.

    Parameters
    ----------
    table : (n, columns), rows from all over the file.
    is_pts : the file is laid out as PTS, where intensity comes before colours.

    Raises
    ------
    FormatError
        Four columns that may be intensity and colours as well as colours and intensity.
    """
    rest = table[:, 3:]
    n = rest.shape[1]
    after = ["intensity"] if n == 1 else _colours_or_normals(rest, is_pts)
    return ["x", "y", "z", *after, *["?"] * (n - len(after))]


def _colours_or_normals(rest: NDArray[np.float64], is_pts: bool) -> list[str]:
    """Return the roles of the columns after x y z as far as they are told, of two columns or more."""
    first, second = are_colours(rest[:, :3]), are_colours(rest[:, 1:4])
    if is_pts and not first and rest.shape[1] == 4 and _are_dark(rest[:, 1:]):
        return ["intensity", "-", "-", "-"]
    if first and second:
        after = _intensity_beside_colours(rest, is_pts)
    elif second:
        after = ["intensity", *COLOUR]
    elif first:
        after = COLOUR + (["-"] if _is_alpha(rest) else [])
    elif are_unit_vectors(rest[:, :3]):
        return NORMAL + (COLOUR if are_colours(rest[:, 3:6]) else [])
    else:
        return []
    n = len(after)
    return after + (NORMAL if are_unit_vectors(rest[:, n : n + 3]) else [])


def _intensity_beside_colours(rest: NDArray[np.float64], is_pts: bool) -> list[str]:
    """Return the roles of four columns of which the first three and the last three may be colours."""
    if _is_alpha(rest):
        return [*COLOUR, "-"]
    highest = rest[:, :4].max(axis=0)
    if is_pts or are_unit_vectors(rest[:, 4:7]) or highest[0] > BRIGHTEST >= highest[1:].max():
        return ["intensity", *COLOUR]
    if highest[3] > BRIGHTEST >= highest[:3].max():
        return [*COLOUR, "intensity"]
    raise FormatError(
        "its columns 4 to 7 may be intensity red green blue or red green blue intensity; name the columns in a first "
        "line, such as: x y z intensity red green blue"
    )


def _are_dark(values: NDArray[np.float64]) -> bool:
    """Return whether columns (n, 3) are 0 throughout, as the colours of a scan without a camera."""
    return bool(values.size and not values.any())


def _is_alpha(rest: NDArray[np.float64]) -> bool:
    """Return whether a fourth column holds one whole number throughout, as behind colours."""
    fourth = rest[:, 3:4]
    return bool(fourth.size and (fourth == fourth[0]).all() and fourth[0, 0] == np.floor(fourth[0, 0]))


def refuse_line_numbers(table: NDArray[np.float64]) -> None:
    """Raise where the first column counts the lines (rows that follow each other), so that x is the second."""
    steps = np.diff(table[:, :2], axis=0)
    counts = len(table) >= N_TOLD and (steps[:, 0] == 1).all() and not (steps[:, 1] == 1).all()
    if counts and table.shape[1] > 3 and (table[:, 0] == np.floor(table[:, 0])).all():
        raise FormatError("its first column counts the points; name the columns in a first line, such as: id x y z")


def refuse_grid_places(table: NDArray[np.float64]) -> None:
    """Raise where the first two columns are whole numbers from 0 on, as rows and columns of a grid are, and the three
    after them are not: x is the third then (FARO writes it so)."""
    place, after = table[:, :2], table[:, 2:5]
    if len(table) < N_TOLD or after.shape[1] < 3 or (place < 0).any() or (place != np.floor(place)).any():
        return
    if (after != np.floor(after)).any(axis=0).all():
        raise FormatError(
            "its first two columns are whole numbers, as rows and columns of a grid; name the columns in a first line, "
            "such as: row column x y z, or x y z"
        )


def step_of_few_digits(rows: Sequence[Sequence[str]]) -> float:
    """Return the coarsest step of coordinates, rows of their words x y z, that are written with as many significant
    digits each, as programs do by default (12.3456 123.456 1.23456); 0 where they are not."""
    figures = [[_figures(row[axis]) for row in rows if len(row) >= 3] for axis in range(3)]
    digits = [max((n for n, _ in of_axis), default=0) for of_axis in figures]
    decimals = [max((n for _, n in of_axis), default=0) for of_axis in figures]
    is_default = FEWEST_DIGITS <= min(digits) == max(digits) <= MOST_DIGITS and min(decimals) < max(decimals)
    return 10.0 ** -min(decimals) if is_default and len(figures[0]) >= N_WRITTEN else 0.0


def step_of_fixed_decimals(rows: Sequence[Sequence[str]]) -> float:
    """Return the coarsest step of coordinates, rows of their words x y z, each of which has a fixed number of decimals,
    one fewer than another (1.234 2.345 0.1234); 0 where all have as many, and of a raster.

    A coordinate of one value or of whole numbers, or one that steps evenly, is laid out and not rounded.
    """
    whole = [row for row in rows if len(row) >= 3]
    decimals = [{_figures(row[axis])[1] for row in whole} for axis in range(3)]
    if len(whole) < N_WRITTEN or any(len(of_axis) > 1 for of_axis in decimals):
        return 0.0
    least, most = min(min(d) for d in decimals), max(max(d) for d in decimals)
    coarse = [axis for axis in range(3) if min(decimals[axis]) == least]
    is_rounded = any(_is_scattered([float(row[axis]) for row in whole], least) for axis in coarse)
    return 10.0**-least if 0 < least < most and is_rounded else 0.0


def _is_scattered(values: Sequence[float], n_decimals: int) -> bool:
    """Return whether values go from one to the next by steps of more than two sizes, of so many decimals."""
    return len(np.unique(np.diff(values).round(n_decimals))) > N_EVEN


def _figures(word: str) -> tuple[int, int]:
    """Return how many significant digits and how many decimals a number is written with."""
    mantissa, _, power = word.lower().lstrip("+-").partition("e")
    whole, _, fraction = mantissa.partition(".")
    exponent = int(power) if power.lstrip("+-").isdigit() else 0
    return len((whole + fraction).lstrip("0")), len(fraction) - exponent


def unread_columns(roles: list[str]) -> str:
    """Return in words which columns nobody could tell, empty where there are none."""
    unknown = [k + 1 for k, role in enumerate(roles) if role == "?"]
    if not unknown:
        return ""
    return f"column {unknown[0]}" if len(unknown) == 1 else f"columns {unknown[0]} to {unknown[-1]}"


def are_colours(values: NDArray[Any]) -> bool:
    """Return whether columns (n, 3) look like 8-bit or 16-bit colours: whole, not negative, not all 0 or 1."""
    whole = np.isfinite(values).all() and (values == np.floor(values)).all()
    return bool(values.size and values.shape[1] == 3 and whole and values.min() >= 0 and 1 < values.max() <= 65535)


def are_unit_vectors(values: NDArray[Any]) -> bool:
    """Return whether columns (n, 3) look like normals: nine in ten of length one within a hundredth."""
    length = np.linalg.norm(values, axis=1)
    return bool(values.size and values.shape[1] == 3 and (np.abs(length - 1.0) < 0.01).mean() > 0.9)
