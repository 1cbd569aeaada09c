"""Directions as an instrument turns to them: the turn about the vertical of its frame, the height above its horizon.

In and out: vectors (n, 3) and angles (n,) [rad]; the turn goes from the x axis towards the y axis.
"""

from __future__ import annotations

import numpy as np

from projects.model import Floats


def angles_of(beams: Floats) -> tuple[Floats, Floats]:
    """Return the turn and the height (n,) [rad] of beams (n, 3) of any length."""
    return np.arctan2(beams[:, 1], beams[:, 0]), np.arctan2(beams[:, 2], np.hypot(beams[:, 0], beams[:, 1]))


def directions_of(turn: Floats, height: Floats) -> Floats:
    """Return the unit vectors (n, 3) of turns and heights (n,) [rad]."""
    flat = np.cos(height)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), np.sin(height)])
