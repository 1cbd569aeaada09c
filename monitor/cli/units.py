"""Where millimetres and other units of the user become metres, and nowhere else."""

from __future__ import annotations

import math

from projects.errors import ParameterError

METRES_PER_UNIT = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}


def metres_per_unit(unit: str | None) -> float:
    """Return how many metres a unit of `--unit` is; 1 where none was stated."""
    if unit is None:
        return 1.0
    if unit not in METRES_PER_UNIT:
        raise ParameterError(f"--unit {unit}: allowed are {', '.join(METRES_PER_UNIT)}")
    return METRES_PER_UNIT[unit]


def metres_from_millimetres(value: float, option: str) -> float:
    """Return a positive length in metres, or refuse it under the option's name."""
    if not (math.isfinite(value) and value > 0):
        raise ParameterError(f"{option} {value}: a length above 0 mm is needed")
    return value / 1000.0
