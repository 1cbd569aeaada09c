"""Where millimetres of the command line become metres, and nowhere else."""

from __future__ import annotations

import math

from projects.errors import ParameterError


def metres_from_millimetres(value: float, option: str) -> float:
    """Return a positive length in metres, or refuse it under the option's name."""
    if not (math.isfinite(value) and value > 0):
        raise ParameterError(f"{option} {value}: a length above 0 mm is needed")
    return value / 1000.0
