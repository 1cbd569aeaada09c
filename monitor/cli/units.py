"""Where millimetres and degrees of the command line become metres and radians (those of `plan` in `planning`)."""

from __future__ import annotations

import math

from projects.errors import ParameterError

DIRECTIONS = {"north": 0.0, "east": 90.0, "south": 180.0, "west": 270.0}  # degrees clockwise from +y


def metres_from_millimetres(value: float, option: str) -> float:
    """Return a positive length in metres, or refuse it under the option's name."""
    if not (math.isfinite(value) and value > 0):
        raise ParameterError(f"{option} {value}: a length above 0 mm is needed")
    return value / 1000.0


def bearing_from_direction(value: str | float, option: str) -> float:
    """Return the bearing [rad], from 0 to below 2 pi, of a side by its name or in degrees clockwise from +y, or refuse
    it under the option's name."""
    named = DIRECTIONS.get(str(value).strip().lower())
    try:
        degrees = float(value) if named is None else named
    except (ValueError, OverflowError):
        degrees = math.nan
    if not 0.0 <= degrees <= 360.0:
        raise ParameterError(
            f"{option} {value}: {', '.join(DIRECTIONS)} are allowed (north is +y, east +x), or degrees clockwise from "
            "north, 0 to 360; without one the front is found from the surface"
        )
    return math.radians(degrees % 360.0)
