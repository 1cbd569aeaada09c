"""Units of files: metres per unit by name, and the question whether metres can be meant.

The objects followed here are sculptures, stoves, staircases, rooms and buildings. Measured as metres by mistake, a
figure of 0.1 to 50 m in millimetres reads as 100 to 50 000, so a size above 100 is questioned, and one below 5 mm,
which no terrestrial scanner resolves, too. Formats that define metres (E57, PTX, glTF) also hold what stands around
the object and are questioned only beyond the reach of terrestrial scanners, 2 km across. Inches and feet within these
limits cannot be told from metres: state them.
"""

from __future__ import annotations

import numpy as np

from projects.errors import ParameterError, UnitError
from projects.model import Floats
from projects.reference_systems import SAME_UNIT, ReferenceSystem

METRES = {"m": 1.0, "mm": 0.001, "cm": 0.01, "in": 0.0254, "ft": 0.3048}
SMALLEST, LARGEST, LARGEST_WHERE_METRES_ARE_DEFINED = 0.005, 100.0, 2000.0  # m
DEFINED_IN_METRES = ("e57", "ptx", "glb")


def metres_per_unit(name: str) -> float:
    """Return the factor from a unit's name (m, mm, cm, in, ft) to metres."""
    if name not in METRES:
        raise UnitError(f"unit {name!r} is not known; one of {', '.join(METRES)} is needed")
    return METRES[name]


def require_unit(unit: float) -> float:
    """Return a factor to metres if it is positive and finite; raise otherwise."""
    if not (np.isfinite(unit) and unit > 0):
        raise ParameterError(f"unit = {unit!r}: metres per file unit, a positive number, is needed")
    return unit


def question_system(system: ReferenceSystem | None, unit_stated: bool, name: str) -> None:
    """Raise `UnitError` where a file says that its coordinates are no metres and nobody said what they are.

    Parameters
    ----------
    system : what the file says, None where it says nothing or its format defines metres.
    unit_stated : the user named the unit, which goes before what the file says.
    name : of the file, for the message.
    """
    if unit_stated or system is None:
        return
    of_system = f" ({system.name})" if system.name else ""
    if system.heights:
        raise UnitError(
            f"{name} says that its heights are in {system.heights} and its plane coordinates in {system.unit}"
            f"{of_system}; bring all three into metres first, or say with --unit that they have one unit"
        )
    if system.metres == 1.0:
        return
    if system.metres is None:
        raise UnitError(
            f"{name} says that its coordinates are angles ({system.name}, {system.unit}); bring them into a plane "
            "system in metres first, or say with --unit that they are none"
        )
    fitting = [unit for unit, metres in METRES.items() if abs(metres / system.metres - 1.0) < SAME_UNIT]
    what = f"--unit {fitting[0]}" if fitting else "bring them into metres first, or say with --unit what they are"
    raise UnitError(f"{name} says that its coordinates are in {system.unit}{of_system}; state it: {what}")


def question_unit(bounds: Floats, unit_stated: bool, format_name: str = "", name: str = "the scan") -> None:
    """Raise where a size in metres is improbable and nobody said that metres are meant.

    Parameters
    ----------
    bounds : (2, 3) least and greatest coordinates, in file units taken as metres.
    unit_stated : the user named the unit; then nothing is questioned.
    format_name : of `sniff_format`; formats that define metres have a wider limit.
    name : what is measured, for the message.

    Raises
    ------
    UnitError
        The size, and what it would be in each unit.
    """
    size = float(np.ptp(np.asarray(bounds, dtype=np.float64), axis=0).max())
    largest = LARGEST_WHERE_METRES_ARE_DEFINED if format_name in DEFINED_IN_METRES else LARGEST
    if unit_stated or size == 0.0 or SMALLEST <= size <= largest:  # a single point has no size in any unit
        return
    others = ", ".join(f"{_plainly(size * factor)} m if in {unit}" for unit, factor in METRES.items() if unit != "m")
    raise UnitError(
        f"{name} is {_plainly(size)} m across if its numbers are metres, which is improbable ({others}); "
        "state the unit: --unit m, mm, cm, in or ft"
    )


def _plainly(length: float) -> str:
    """Return a length with three significant digits and no exponent."""
    return np.format_float_positional(float(f"{length:.3g}"), trim="-")
