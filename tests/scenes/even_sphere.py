"""Directions spread evenly over a sphere."""

from __future__ import annotations

import numpy as np

from projects.model import Floats


def even_directions(n: int) -> Floats:
    """Return n unit vectors (n, 3) along a Fibonacci spiral from the upper to the lower pole."""
    i = np.arange(n) + 0.5
    z, turn = 1.0 - 2.0 * i / n, np.pi * (1.0 + 5.0**0.5) * i
    s = np.sqrt(1.0 - z * z)
    return np.c_[s * np.cos(turn), s * np.sin(turn), z]
