"""Whether an object moves on as a whole, and at which rate: a figure that leans further, a stair that goes on settling.

In: where it stood at several epochs against the first, with the covariance of all of them together. Out: a
`SteadyMotion`. What the first epoch errs by is in all of its differences: epochs taken for independent would state the
wrong margins.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from projects.errors import ParameterError, ShapeError
from projects.model import Floats


@dataclass(frozen=True)
class SteadyMotion:
    """The motion per year that fits all epochs best.

    Attributes
    ----------
    rate : (6,) of (w, t), rad/year and m/year, of the object about the centre that the motions are given about.
    covariance : (6, 6) of it.
    p_rate, p_turn, p_shift : how often chance makes as much of an object at rest: of all six, of the turn, of the
        shift.
    p_fit : how often chance leaves as much of an object that moves steadily.
    """

    rate: Floats
    covariance: Floats
    p_rate: float
    p_turn: float
    p_shift: float
    p_fit: float


def fit_steady_motion(years: Floats, motions: Floats, covariance: Floats) -> SteadyMotion:
    """Return the steady motion through the first epoch, by least squares with known covariance.

    Parameters
    ----------
    years : (k,) since the first epoch, ascending, above 0; two or more.
    motions : (k, 6) of (w, t), rad and m, of the object since then; small turns.
    covariance : (6 k, 6 k) of all motions together, what the first epoch errs by in each.

    Raises
    ------
    ParameterError
        For fewer than two epochs after the first, or years that do not ascend.
    ShapeError
        For arrays of other shapes.
    """
    years, n = np.asarray(years, dtype=float), len(years)
    if n < 2 or not (np.diff(years, prepend=0.0) > 0.0).all():
        raise ParameterError(
            f"years {years.tolist()}: two or more, ascending and above 0, the first epoch's, are needed"
        )
    if motions.shape != (n, 6) or covariance.shape != (6 * n, 6 * n):
        raise ShapeError(f"{n} years, motions {motions.shape}, covariance {covariance.shape}; "
                         f"({n}, 6) and ({6 * n}, {6 * n}) are needed")  # fmt: skip
    unit = np.sqrt(np.diag(covariance))  # rad and m: the solver sees one size
    design, values = np.kron(years[:, None], np.eye(6)) / unit[:, None], motions.ravel() / unit
    weight = np.linalg.inv(covariance / np.outer(unit, unit))
    of_rate = np.linalg.inv(design.T @ weight @ design)
    rate = of_rate @ design.T @ weight @ values
    left = values - design @ rate
    return SteadyMotion(
        rate, of_rate, _p_of_rest(rate, of_rate, slice(0, 6)), _p_of_rest(rate, of_rate, slice(0, 3)),
        _p_of_rest(rate, of_rate, slice(3, 6)), float(chi2.sf(left @ weight @ left, 6 * (n - 1))),
    )  # fmt: skip


def _p_of_rest(rate: Floats, covariance: Floats, part: slice) -> float:
    """Return how often chance makes as much of some parts of a rate where nothing moves."""
    own = rate[part]
    return float(chi2.sf(own @ np.linalg.solve(covariance[part, part], own), len(own)))
