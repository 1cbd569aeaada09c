"""The unit of the demo's figure: its parts are drawn in heads from the soles and handed over in metres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from monitor.simulation.pedestal import HEIGHT
from monitor.simulation.shapes import placed
from monitor.simulation.solid import Field, Part

HEAD = 0.128  # m, height of the figure's head, an eighth of the figure
Points = Sequence[ArrayLike]


def part_in_heads(name: str, field: Field, box_points: Points, margin: float, blend: float = 0.0) -> Part:
    """Return a part given in heads as one in metres on the pedestal.

    Its box holds the `box_points` (k, 3) and `margin` around them; `blend` is the width of its join, all in heads.
    """
    corner = np.asarray(box_points, dtype=float)
    low, high = corner.min(axis=0) - margin, corner.max(axis=0) + margin
    lift = np.array([0.0, 0.0, HEIGHT])
    metres = np.stack([HEAD * low + lift, HEAD * high + lift])
    return Part(name, placed(field, at=lift, scale=HEAD), metres, blend * HEAD)
