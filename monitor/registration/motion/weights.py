"""Robust weights of residuals: median, Huber, and the variance of each residual by what is stated of it.

In: residuals [m] and what is stated of their sigma. Out: numbers without unit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import isotonic_regression

from monitor.robust import robust_scale
from projects.model import Bools, Floats

HUBER = 1.345  # 95 % efficiency under normal noise
N_PER_CLASS, MOST_CLASSES = 50, 20  # residuals that tell a scale to 12 %; classes that tell how it rises
MOST_TELLING = 10_000
ROUNDING = 2.0**-22  # of the size of an object: twice what numbers of 32 bits are rounded to, which files hold
LEAST_SIGMA = 0.1  # of the scale of all: one point must not outweigh a hundred


def weighted_median(values: Floats, weights: Floats) -> float:
    """Return the value at half of the weights."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def draw_in(values: Floats) -> Floats:
    """Return the values (n,), those beyond three robust sigmas of their median drawn in to there (winsorized)."""
    middle = float(np.median(values))
    away = 3.0 * robust_scale(values - middle)
    return np.clip(values, middle - away, middle + away)


def residual_sigma(residuals: Floats, causes: Sequence[Floats], is_kept: Bools, least: float = 1e-15) -> Floats:
    """Return one sigma (n,) [m] of each residual: what causes of uncertainty predict, by as much as residuals show.

    Parameters
    ----------
    residuals : (n,) m, about zero.
    causes : (n,) each, in any unit: the more of it, the less certain is a residual, if it matters at all.
    is_kept : (n,), the residuals that tell.
    least : m, what no residual is known better than. Surfaces that are copies of each other miss each other by what
        their numbers are rounded to, which is no noise: large here and nothing there.

    Notes
    -----
    sigma = s g_1(c_1) g_2(c_2) ...: a cause alone gives the order, the residuals by how much sigma rises along it. Each
    g is found in turn, from classes of equal number, as the robust scale of the residuals over the sigma so far; it
    never falls (pool adjacent violators: Ayer et al. 1955), so that a cause that does not matter has a g of 1.
    """
    telling = np.flatnonzero(is_kept)
    telling = telling[:: max(len(telling) // MOST_TELLING, 1)]
    scale = max(robust_scale(residuals[telling]), 1e-15)
    sigma = np.full(len(residuals), scale)
    for cause in causes:
        sigma = sigma * _rise(np.abs(residuals[telling] / sigma[telling]), cause[telling], cause)
    sigma = np.maximum(sigma, LEAST_SIGMA * scale)
    return np.maximum(sigma * max(robust_scale(residuals[is_kept] / sigma[is_kept]), 1e-6), least)


def rounding_of(points: Floats) -> float:
    """Return what points (n, 3) [m] of an object may be off by the rounding of their numbers [m]."""
    return ROUNDING * float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0


def _rise(u: Floats, known: Floats, cause: Floats) -> Floats:
    """Return by what factor (n,) the scale of residuals rises with a cause (n,), as `u` (k,) with `known` (k,) tell."""
    n_classes = min(len(u) // N_PER_CLASS, MOST_CLASSES)
    if n_classes < 2 or known.min() == known.max():
        return np.ones(len(cause))
    edges = np.unique(np.quantile(known, np.arange(1, n_classes) / n_classes))
    member = np.searchsorted(edges, known)
    order = np.argsort(member, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(member[order])) + 1)
    scale = np.array([robust_scale(u[part]) for part in parts])
    middle = np.array([np.median(known[part]) for part in parts])
    risen = isotonic_regression(scale**2, weights=[len(part) for part in parts]).x
    return np.asarray(np.sqrt(np.maximum(np.interp(cause, middle, risen), LEAST_SIGMA**2)))


def huber_weights(u: Floats) -> Floats:
    """Return psi(u) / u of Huber for standardized residuals u."""
    return HUBER / np.maximum(np.abs(u), HUBER)
