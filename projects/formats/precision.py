"""Coordinates in single precision or of few digits, far from 0: numbers too coarse for what a scanner measures.

In: points or a step in file units, and metres per unit; out: nothing, or an error. Single precision has 24 bits: 50 km
from 0 its numbers are 4 mm apart. On a face along an axis all points then have one coordinate: it shows no noise, and
lies aside.
"""

from __future__ import annotations

import numpy as np

from projects.errors import FormatError
from projects.model import Floats

COARSEST = 5e-4  # m between neighbouring numbers: the noise of a good scanner, which hides steps of its own size
FEWEST = 100  # points that are no single-precision numbers by chance
WRITTEN = 1e-3  # of the step, by which such a number written as text may be off


def require_precision(points: Floats, unit: float, what: str) -> None:
    """Raise where points (n, 3), in units of `unit` [m], are single-precision numbers more than `COARSEST` apart.

    Raises
    ------
    FormatError
        How far from 0 the points lie, how far apart numbers are there, and what to do.
    """
    if len(points) < FEWEST:
        return
    farthest = float(np.abs(points).max())
    if not np.finfo(np.float32).tiny < farthest < np.finfo(np.float32).max:
        return
    step = float(np.spacing(np.float32(farthest)))
    is_whole = bool((points == np.floor(points)).all())  # counts, of cells or of a drawing
    if unit * step > COARSEST and not is_whole and (np.abs(points - points.astype(np.float32)) <= WRITTEN * step).all():
        raise FormatError(
            f"{what}: its coordinates are numbers of single precision, as far as {unit * farthest:.0f} m from 0, where "
            f"they are rounded to {1e3 * unit * step:.2g} mm; export it with double precision, or moved near 0"
        )


def require_digits(step: float, unit: float, what: str) -> None:
    """Raise where some coordinates are rounded to a `step` in units of `unit` [m], others finer, and that is coarse:
    written with few significant digits, fewer decimals, or with the scales of LAS.

    Raises
    ------
    FormatError
        To what they are rounded, and what to do.
    """
    if unit * step > COARSEST:
        raise FormatError(
            f"{what}: some of its coordinates are rounded to {1e3 * unit * step:.2g} mm and others finer (few "
            "significant digits, fewer decimals, or scales of LAS that differ); export it with as many decimals in each"
        )
