"""Scale and weights that outliers do not move: what most of the values scatter by.

In: residuals or values, in any unit. Out: a sigma in that unit, or weights without one.
"""

from __future__ import annotations

import numpy as np

from projects.model import Floats

MAD_TO_SIGMA = 1.4826  # of the median absolute deviation of normal errors to their sigma
TUKEY = 4.685  # sigmas; 95 % efficiency under normal noise


def robust_scale(residuals: Floats) -> float:
    """Return 1.4826 median |r| about zero, the sigma of normal residuals; NaN without residuals."""
    return MAD_TO_SIGMA * float(np.median(np.abs(residuals))) if len(residuals) else float("nan")


def nmad(values: Floats) -> float:
    """Return 1.4826 times the median distance from the median, the sigma of normal values; NaN without values."""
    return robust_scale(values - np.median(values)) if len(values) else float("nan")


def tukey_weights(u: Floats) -> Floats:
    """Return psi(u) / u of Tukey's biweight for standardized residuals u: none beyond 4.685 sigma."""
    return np.maximum(1.0 - (u / TUKEY) ** 2, 0.0) ** 2


def tukey_slope(u: Floats) -> Floats:
    """Return the derivative of psi of Tukey's biweight."""
    z = np.minimum((u / TUKEY) ** 2, 1.0)
    return (1.0 - z) * (1.0 - 5.0 * z)
