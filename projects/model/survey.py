"""What holds a survey in its frame: points of known position, and the targets found in scans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from projects.arrays import Floats, hold_array


@dataclass(frozen=True)
class ControlPoint:
    """A point, known by its `name`, of known `position` (3,) [m] in the project's frame; `sigma` [m] is that of each
    coordinate, NaN where it was not stated."""

    name: str
    position: Floats
    sigma: float = float("nan")


@dataclass(frozen=True)
class SurveyTarget:
    """A sphere or a black-and-white board found in a scan.

    Attributes
    ----------
    kind : "sphere" or "board".
    centre : (3,) m, of the sphere, or where the four fields of the board meet, in the scan's frame.
    covariance : (3, 3) m2, of the centre.
    radius : m, of the sphere; half the width of the board.
    residual : m, root mean square distance of its points from sphere or plane.
    n_points : measurements that it rests on.
    completeness : share of what should have been seen of it.
    name : of the control point that it is, empty where unknown.
    """

    kind: str
    centre: Floats
    covariance: Floats
    radius: float
    residual: float
    n_points: int
    completeness: float
    name: str = ""

    def __post_init__(self) -> None:
        hold_array(self, "centre", (3,), np.float64)
        hold_array(self, "covariance", (3, 3), np.float64)
