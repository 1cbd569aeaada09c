"""Points that no surface has: grazing incidence, mixed pixels, isolated specks (Nothegger and Dorninger, section 2.1).

In: points with normals and where the scanner stood, rows and columns where the scan is a grid; out: masks of points.
A mixed pixel's range lies between those of two surfaces that the beam touched (papers: HDS 6000 relief, section 1.2.2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from monitor.declare import check_settings, setting
from projects.model import Bools, Floats, Ints

BETWEEN_SIGMAS = 3.0


@dataclass(frozen=True, kw_only=True)
class SilhouetteSettings:
    """Silhouettes and specks. Angles in radians."""

    max_incidence: float = setting(
        math.radians(80.0),
        unit="rad",
        meaning="largest angle between beam and normal: the spot is 6 times as long as wide",
        low=0.5,
        high=1.57,
    )
    isolation: float = setting(
        4.0,
        unit="1",
        meaning="a speck's neighbours are this many times farther than the scan's spacing there",
        low=1.5,
        high=100.0,
    )

    def __post_init__(self) -> None:
        check_settings(self)


def find_grazing(beams: Floats, normals: Floats, max_incidence: float) -> Bools:
    """Return the points (n,) whose incidence angle, between beam (n, 3) and normal, exceeds `max_incidence` [rad]."""
    return np.abs((beams * normals).sum(axis=1)) < math.cos(max_incidence) * np.linalg.norm(beams, axis=1)


def find_mixed(beams: Floats, rows: Ints, columns: Ints, noise: Floats, max_incidence: float) -> Bools:
    """Return the points (n,) of a grid scan whose range lies between those of the two sides of a jump.

    Along the row or the column the neighbour on one side is nearer and that on the other side farther, both by more
    than a surface at `max_incidence` [rad] and the noise explain.

    Parameters
    ----------
    beams : (n, 3) m, from the scanner to the points.
    rows, columns : (n,) place in the grid; -1 where a point has none.
    noise : (n,) m, one sigma of a range.
    """
    along_rows = _mixed_along(np.lexsort((columns, rows)), rows, columns, beams, noise, max_incidence)
    return along_rows | _mixed_along(np.lexsort((rows, columns)), columns, rows, beams, noise, max_incidence)


def _mixed_along(order: Ints, line: Ints, place: Ints, beams: Floats, noise: Floats, max_incidence: float) -> Bools:
    """Return the mixed points along the lines of a grid, whose points come line by line in `order`."""
    mixed = np.zeros(len(order), dtype=bool)
    ranges, sigma = np.linalg.norm(beams[order], axis=1), noise[order]
    adjacent = (np.diff(line[order]) == 0) & (np.diff(place[order]) == 1) & (line[order][1:] >= 0)
    if not adjacent.any():
        return mixed
    directions = beams[order] / ranges[:, None]
    step = float(np.median(np.linalg.norm(np.diff(directions, axis=0)[adjacent], axis=1)))
    rise = np.diff(ranges)
    limit = ranges[1:] * step * math.tan(max_incidence) + BETWEEN_SIGMAS * math.sqrt(2.0) * sigma[1:]
    jump = np.where(adjacent & (np.abs(rise) > limit), np.sign(rise), 0.0)
    mixed[order[1:-1]] = (jump[:-1] != 0) & (jump[:-1] == jump[1:])
    return mixed


def find_specks(reach: Floats, ranges: Floats, isolation: float) -> Bools:
    """Return the points (n,) whose nearest few lie `isolation` times farther than the scan's points do at that range.

    Parameters
    ----------
    reach : (n,) m, distance to the sixth nearest point.
    ranges : (n,) m, from the scanner, to which the spacing of its points is proportional; where it is not known, the
        spacing of the neighbourhood in its place.
    """
    relative = reach / np.maximum(ranges, 1e-300)
    return relative > isolation * np.median(relative)
