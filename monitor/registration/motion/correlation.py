"""How residuals of the stable areas err together, by distance.

In: residuals of some hundred patches and what a motion does to them. Out: a posterior over models "noise of points
plus a field of exponential correlation", by restricted maximum likelihood (Patterson & Thompson 1971), which knows
that six parameters were fitted. A single range is seldom certain, so later sums are averaged over the posterior.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from projects.model import Floats

N_RANGES = 6
N_RATIOS = 10
LOWEST_RANGE, HIGHEST_RANGE = 0.4, 0.6  # of the size of a patch, and of the distance between the farthest two
LOWEST_RATIO, HIGHEST_RATIO = 0.01, 30.0  # of the field's variance to that of a patch's mean under independent noise


@dataclass(frozen=True)
class CorrelationModel:
    """Residuals with variance `noise2` per point, independent, and `field2` R(d / `range` [m]) in common."""

    probability: float
    noise2: float
    field2: float
    range: float


def correlate(distances: Floats, reach: float) -> Floats:
    """Return the correlation of Matern 3/2, (1 + a) exp(-a) with a = sqrt(3) d / reach: once differentiable."""
    a = distances * (math.sqrt(3.0) / reach)
    return np.asarray((1.0 + a) * np.exp(-a))


def find_ranges(cell: float, farthest: float) -> tuple[float, ...]:
    """Return the ranges [m] that models of correlation may have, from the size of patches and the farthest two."""
    return tuple(np.geomspace(LOWEST_RANGE * cell, max(HIGHEST_RANGE * farthest, cell), N_RANGES).tolist())


def fit_correlation(means: Floats, rows: Floats, counts: Floats, correlations: Mapping[float, Floats],
                    common: Floats | float = 1.0) -> tuple[CorrelationModel, ...]:  # fmt: skip
    """Return the models of correlation with their posterior probabilities.

    Parameters
    ----------
    means : (p,) mean standardized residual of each patch, after the fit.
    rows : (p, k) mean row of each patch: what the fit could absorb.
    counts : (p,) points of each patch.
    correlations : (p, p) between the patches, by the range [m] of the field.
    common : (p,), by what factor the variance of a patch's mean exceeds that of independent points, without a field.

    Notes
    -----
    V = noise2 (diag(common/n) + ratio R); log L = -(log|V| + log|X'V^-1 X| + (p - k) log r'V^-1 r) / 2 with r the
    generalized least squares residual. Flat prior over the grid, in which "no field" has its place. Given the ratio,
    noise2 is scaled inverse chi2; its mean stands for it.
    """
    root = np.sqrt(counts / common)
    y, X = means * root, orthonormal(rows * root[:, None])
    free = max(len(means) - X.shape[1], 3)
    ratios = np.concatenate([[0.0], np.geomspace(LOWEST_RATIO, HIGHEST_RATIO, N_RATIOS)]) / counts.mean()
    found = []
    for reach, correlation in correlations.items():
        values, vectors = np.linalg.eigh(correlation * np.outer(root, root))
        y_turned, X_turned = vectors.T @ y, vectors.T @ X
        for ratio in ratios:
            likelihood, noise2 = restricted_likelihood(y_turned, X_turned, 1.0 + ratio * np.maximum(values, 0.0), free)
            found.append((likelihood, noise2, ratio * noise2, reach))
    best = max(likelihood for likelihood, *_ in found)
    total = sum(np.exp(likelihood - best) for likelihood, *_ in found)
    return tuple(CorrelationModel(float(np.exp(likelihood - best) / total), noise2, field2, reach)
                 for likelihood, noise2, field2, reach in found)  # fmt: skip


def orthonormal(rows: Floats) -> Floats:
    """Return an orthonormal basis (p, r) of what columns (p, k) of any scale span, rounding left out."""
    scaled = rows / np.maximum(np.sqrt(np.sum(rows**2, axis=0)), 1e-300)
    left, values, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(left[:, values > 1e-6 * values[0]])


def restricted_likelihood(y: Floats, X: Floats, variance: Floats, free: int) -> tuple[float, float]:
    """Return the restricted log likelihood and the variance factor's mean, in coordinates where V is diagonal."""
    weighted = X / variance[:, None]
    normal = X.T @ weighted
    left = y - X @ (np.linalg.solve(normal, weighted.T @ y))
    misfit = max(float(np.sum(left**2 / variance)), 1e-300)
    determinant = np.linalg.slogdet(normal)[1]
    return -0.5 * (float(np.sum(np.log(variance))) + determinant + free * np.log(misfit)), misfit / (free - 2)
