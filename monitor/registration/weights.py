"""Robust weights of residuals: scale, Huber and Tukey, and the variance of each residual.

In: residuals [m] and what is stated of their sigma. Out: numbers without unit.
"""

from __future__ import annotations

import numpy as np

from projects.model import Bools, Floats

HUBER = 1.345  # 95 % efficiency under normal noise
TUKEY = 4.685  # 95 % efficiency under normal noise


def robust_scale(residuals: Floats) -> float:
    """Return 1.4826 median |r| about zero, the sigma of normal residuals; NaN without residuals."""
    return 1.4826 * float(np.median(np.abs(residuals))) if len(residuals) else float("nan")


def residual_sigma(residuals: Floats, sigma_stated: Floats, is_kept: Bools) -> Floats:
    """Return one sigma (n,) [m] of each residual: what is stated of it and, common to all, the scatter beyond that.

    The scatter is that of the residuals `is_kept` about zero; the standardized ones have a robust scale of one.
    """
    scale2 = max(robust_scale(residuals[is_kept]) ** 2, 1e-30)
    common2 = max(scale2 - float(np.median(sigma_stated[is_kept])) ** 2, 0.0)
    # stated sigmas are never believed to be below a tenth of the scatter: one point must not outweigh a hundred
    sigma = np.sqrt(np.maximum(sigma_stated**2 + common2, 0.01 * scale2))
    return sigma * max(robust_scale(residuals[is_kept] / sigma[is_kept]), 1e-6)


def huber_weights(u: Floats) -> Floats:
    """Return psi(u) / u of Huber for standardized residuals u."""
    return HUBER / np.maximum(np.abs(u), HUBER)


def tukey_weights(u: Floats) -> Floats:
    """Return psi(u) / u of Tukey's biweight for standardized residuals u: none beyond 4.685 sigma."""
    return np.maximum(1.0 - (u / TUKEY) ** 2, 0.0) ** 2


def tukey_slope(u: Floats) -> Floats:
    """Return the derivative of psi of Tukey's biweight."""
    z = np.minimum((u / TUKEY) ** 2, 1.0)
    return (1.0 - z) * (1.0 - 5.0 * z)
