"""How many neighbours a tangent plane needs, and the noise of the scan (Nothegger and Dorninger, section 2.3).

lambda3 of growing neighbourhoods is a variogram in n: it rises while the neighbourhood is a blob within the band of
noise and stays once it is a disc. In: lambda3 at sampled points; out: the range n_o and the sill (the noise variance)
of a spherical model fitted by generalized least squares (Genton 1998), interpolated over the scan.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from projects.model import Floats, Ints

GROUP = 15  # sampled points whose curves are put together before fitting
N_RANGES = 60
SIGNIFICANT = 6.6 / GROUP  # chi-square, 1 degree of freedom, 0.99; a curve is the median of GROUP others
N_ITERATIONS = 3  # of the covariance, which depends on the model it serves to fit


@dataclass(frozen=True)
class NeighbourhoodModel:
    """Neighbourhood size and noise at sampled points; `at` interpolates them.

    Attributes
    ----------
    points : (s, 3) float64, m.
    sizes : (s,) float64, n_o within its bounds.
    noise : (s,) float64, m, square root of the sill.
    """

    points: Floats
    sizes: Floats
    noise: Floats

    def at(self, points: Floats) -> tuple[Ints, Floats]:
        """Return n_o (n,) and the noise (n,) [m] at `points`: geometric means of the four nearest samples."""
        k = min(4, len(self.points))
        distances, nearest = cKDTree(self.points).query(points, k, workers=2)
        distances, nearest = distances.reshape(len(points), k), nearest.reshape(len(points), k)
        weights = 1.0 / (distances + 1e-3 * distances.max(axis=1, keepdims=True) + 1e-12)
        weights /= weights.sum(axis=1, keepdims=True)
        sizes = np.exp((weights * np.log(self.sizes)[nearest]).sum(axis=1))
        noise = np.exp((weights * np.log(self.noise)[nearest]).sum(axis=1))
        return np.rint(sizes).astype(np.int64), noise


def spherical_variogram(n: Floats | Ints, n_range: float) -> Floats:
    """Return the spherical model of unit sill at n: 1.5 u - 0.5 u^3 with u = n / range, 1 beyond the range."""
    u = np.minimum(np.asarray(n, dtype=float) / n_range, 1.0)
    return 1.5 * u - 0.5 * u**3


def fit_spherical(n: Ints, lambda3: Floats) -> tuple[Floats, Floats, Floats]:
    """Fit lambda3 = sill * spherical(n / range) + growth * n^2 to many curves at once.

    Parameters
    ----------
    n : (j,) growing neighbourhood sizes.
    lambda3 : (s, j) m2, free of the bias of small n.

    Returns
    -------
    range (s,), sill (s,) [m2], growth (s,) [m2]. The growth is that of a curved surface (the height of a paraboloid
    over a disc has a variance proportional to n^2), taken only where it improves the fit significantly.

    Notes
    -----
    Generalized least squares with an explicit covariance, as Genton (1998): the model's values times the correlation
    that independent errors would have, fitted again as the model changes. Variances from nested neighbourhoods have
    Cov(l_i, l_j) = 2 g_i g_j / (max(n_i, n_j) - 3): relative errors make a Brownian motion in 1 / (n - 3), so that
    their differences from one n to the next are independent.
    """
    n, lambda3 = np.asarray(n, dtype=float), np.asarray(lambda3, dtype=float)
    variances = 2.0 / (n - 3.0)
    steps = np.sqrt(np.append(variances[:-1] - variances[1:], variances[-1]))
    candidates = np.geomspace(n[0], n[-1], N_RANGES)
    sphericals = np.stack([spherical_variogram(n, a) for a in candidates])
    growing = (n / n[-1]) ** 2
    floor = 1e-3 * lambda3.max(axis=1, keepdims=True) + 1e-300
    model, rows = np.maximum(lambda3, floor), np.arange(len(lambda3))
    for _ in range(N_ITERATIONS):
        misfits, sills, growths = _fit_linear(sphericals, growing, lambda3, model, steps)
        best = np.argmin(misfits, axis=1)
        sill, growth = sills[rows, best], growths[rows, best]
        model = np.maximum(sill[:, None] * sphericals[best] + growth[:, None] * growing, floor)
    return candidates[best], sill, growth / n[-1] ** 2


def _fit_linear(
    sphericals: Floats, growing: Floats, lambda3: Floats, model: Floats, steps: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return misfit, sill and growth (s, c) of every curve with every candidate range, none of them negative."""

    def whiten(relative: Floats) -> Floats:
        return np.concatenate([relative[..., :-1] - relative[..., 1:], relative[..., -1:]], axis=-1) / steps

    a = whiten(sphericals[None] / model[:, None, :])  # (s, c, j)
    b = whiten(growing / model)[:, None, :]
    y = whiten(lambda3 / model)[:, None, :]
    aa, ab, bb = (a * a).sum(-1), (a * b).sum(-1), (b * b).sum(-1)
    ay, by, yy = (a * y).sum(-1), (b * y).sum(-1), (y * y).sum(-1)
    only_a = np.maximum(ay, 0.0) / aa
    misfit, sill, growth = yy - only_a * ay, only_a, np.zeros_like(only_a)
    det = aa * bb - ab**2
    both_a, both_b = (bb * ay - ab * by) / det, (aa * by - ab * ay) / det
    both = yy - both_a * ay - both_b * by + SIGNIFICANT
    better = (both_a >= 0) & (both_b >= 0) & (det > 1e-9 * aa * bb) & (both < misfit)
    return np.where(better, both, misfit), np.where(better, both_a, sill), np.where(better, both_b, growth)


def model_neighbourhoods(
    points: Floats, sizes: Ints, lambda3: Floats, radii: Floats, bounds: tuple[int, int]
) -> NeighbourhoodModel:
    """Fit n_o and the noise at sampled points.

    Parameters
    ----------
    points : (s, 3) m, the sampled points.
    sizes : (j,) the neighbourhood sizes tried.
    lambda3 : (s, j) m2, robust least eigenvalue at each sample and size, free of the bias of small n.
    radii : (s,) m, radius of the largest neighbourhood.
    bounds : least and largest n_o.
    """
    _, groups = cKDTree(points).query(points, min(GROUP, len(points)))
    curves = np.median(lambda3[groups.reshape(len(points), -1)], axis=1)
    floor = 1e-12 * float(np.median(curves[:, -1])) + 1e-18
    n_range, sill, growth = fit_spherical(sizes, np.maximum(curves, floor))
    sill = np.maximum(sill, floor)
    # Beyond the second of the two the shape of the surface outweighs the noise.
    n_best = np.minimum(n_range, np.sqrt(sill / np.maximum(growth, 1e-12 * sill)))
    return NeighbourhoodModel(points, np.clip(n_best, *bounds), np.sqrt(undo_ball(sill, radii**2)))


def undo_ball(lambda3: Floats, radii2: Floats) -> Floats:
    """Return the noise variance (n,) [m2] whose share within balls of squared radius `radii2` [m2] is `lambda3`.

    The nearest points in space are a ball, which cuts the band of noise at its rim: the mean of h^2 under the weights
    R^2 - h^2 of its discs is sigma^2 (R^2 - 3 sigma^2) / (R^2 - sigma^2). Inverted to first order.
    """
    return lambda3 * (1.0 + 2.0 * lambda3 / np.maximum(radii2, 4.0 * lambda3 + 1e-300))
