"""Reference systems of coordinates: what the EPSG register or a file says of them, and how other files are told.

Axes of points are as in geodata everywhere: x east, y north, z up, whatever order the register gives them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from projects.errors import ParameterError

if TYPE_CHECKING:
    from pyproj import CRS

SAME_UNIT = 3e-6  # the foot of surveys in the United States is 2 millionths longer than the foot
NEEDED = "a projected system in metres of the EPSG register is needed, like EPSG:31256"


@dataclass(frozen=True)
class ReferenceSystem:
    """What a file says of its coordinates: the system's name (EPSG:n where the register has it), the unit in words,
    metres in that unit, None where it is an angle, and the unit of heights where it is another one than the plane's."""

    name: str
    unit: str
    metres: float | None
    heights: str = ""


def require_projected_metres(code: str) -> None:
    """Raise `ParameterError` unless EPSG:n names a projected system in metres (its heights, if any, in metres too)."""
    system = _look_up(code)
    told = f"{code} ({system.name})"
    if not system.is_projected:
        raise ParameterError(f"{told} is no plane system of x and y; {NEEDED}")
    others = sorted({axis.unit_name for axis in system.axis_info if abs(axis.unit_conversion_factor - 1.0) > 1e-12})
    if others:
        raise ParameterError(f"{told} has the unit {' and '.join(others)}; {NEEDED}")


def wkt_of(code: str) -> str:
    """Return a system of the EPSG register in OGC's words (WKT 1, which LAS 1.4 and E57 ask for); empty where `code` is
    empty or unknown, as in projects of older programs."""
    try:
        return str(_look_up(code).to_wkt("WKT1_GDAL")) if code else ""
    except ParameterError:
        return ""


def name_of_plane(code: str) -> str:
    """Return the name of a system's horizontal part, as `describe_system` gives it for files; empty where `code` is
    empty or unknown."""
    try:
        return describe_system(_look_up(code)).name if code else ""
    except ParameterError:
        return ""


def describe_system(system: CRS) -> ReferenceSystem:
    """Return what is known of a file's system: of its horizontal part, and whether its heights have another unit."""
    plane = system.sub_crs_list[0] if system.is_compound else system
    stated = plane.to_json_dict().get("id") or {}  # to_epsg() looks for one that is alike, and misses northings first
    name = f"EPSG:{stated['code']}" if stated.get("authority") == "EPSG" else plane.name
    if not plane.axis_info:
        return ReferenceSystem(name, "metre", 1.0)
    axis = plane.axis_info[0]
    if plane.is_geographic:
        return ReferenceSystem(name, axis.unit_name, None)
    metres = float(axis.unit_conversion_factor)
    other = [up for up in system.axis_info[2:] if abs(up.unit_conversion_factor / metres - 1.0) > SAME_UNIT]
    return ReferenceSystem(name, axis.unit_name, metres, other[0].unit_name if other else "")


def read_wkt(text: str) -> ReferenceSystem | None:
    """Return what OGC's words in a file say, None where they say nothing that is understood."""
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        return describe_system(CRS.from_wkt(text)) if text.strip() else None
    except CRSError:
        return None


def _look_up(code: str) -> Any:
    """Return the system of the EPSG register."""
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    number = code.removeprefix("EPSG:")
    if not (code.startswith("EPSG:") and number.isascii() and number.isdigit()):
        raise ParameterError(f"{code}: {NEEDED}")
    try:
        return CRS.from_epsg(int(number))
    except CRSError as error:
        raise ParameterError(f"{code} is not in the EPSG register; {NEEDED}") from error
