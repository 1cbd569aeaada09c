"""How many neighbours a tangent plane needs, and the noise of the scan (Nothegger and Dorninger, section 2.3).

lambda3 of growing neighbourhoods is a variogram in n: it rises while the neighbourhood is a blob within the band of
noise and stays once it is a disc. In: lambda3 at sampled points; out: the sill (the noise variance) and the range of a
spherical model fitted by generalized least squares (Genton 1998), interpolated over the scan.

The paper takes the range for n_o. From there on the normal means something, but its error goes on falling with 1 / n
until the shape of the surface takes over: on simulated waves and spheres it is two to eight times what the best n
leaves. n_o is therefore the n of least error, measured on the normals themselves as n grows (`find_sizes`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from projects.model import Floats, Ints

GROUP = 15  # sampled points whose curves are put together before fitting
N_RANGES = 60
SIGNIFICANT = 6.6 / GROUP  # chi-square, 1 degree of freedom, 0.99; a curve is the median of GROUP others
GROWS = 2.0  # times the least size that the largest must be for a growth to be told from chance
N_POOLED = 40  # sampled points whose normals are put together
N_APART = 4  # sizes apart, up to which normals are compared: farther ones differ by more than the third order
LARGEST = 400  # n_o that can be told
N_ITERATIONS = 3  # of the covariance, which depends on the model it serves to fit


@dataclass(frozen=True)
class NeighbourhoodModel:
    """Neighbourhood size and noise at sampled points; `at` interpolates them.

    Attributes
    ----------
    points : (s, 3) float64, m.
    sizes : (s,) float64, n_o within its bounds.
    noise : (s,) float64, m, square root of the sill.
    strides : (s,) 1 where n_o counts all points, 2, 4, ... where every second, fourth, ...: noise is thick there.
    """

    points: Floats
    sizes: Floats
    noise: Floats
    strides: Ints

    def at(self, points: Floats) -> tuple[Ints, Floats, Ints]:
        """Return n_o (n,), the noise (n,) [m] and the stride (n,) at `points`.

        The stride is that of the nearest sample; noise and n_o, counted in all points, are geometric means of the four
        nearest samples, and of that n_o a share is taken by the stride.
        """
        k = min(4, len(self.points))
        distances, nearest = cKDTree(self.points).query(points, k, workers=2)
        distances, nearest = distances.reshape(len(points), k), nearest.reshape(len(points), k)
        weights = 1.0 / (distances + 1e-3 * distances.max(axis=1, keepdims=True) + 1e-12)
        weights /= weights.sum(axis=1, keepdims=True)
        strides = self.strides[nearest[:, 0]]
        sizes = np.exp((weights * np.log(self.sizes * self.strides)[nearest]).sum(axis=1)) / strides
        noise = np.exp((weights * np.log(self.noise)[nearest]).sum(axis=1))
        sizes = np.clip(sizes, self.sizes.min(), self.sizes.max())
        return np.rint(sizes).astype(np.int64), noise, strides


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
    growing, is_told = (n / n[-1]) ** 2, bool(n[-1] >= GROWS * n[0])
    floor = 1e-3 * lambda3.max(axis=1, keepdims=True) + 1e-300
    model, rows = np.maximum(lambda3, floor), np.arange(len(lambda3))
    for _ in range(N_ITERATIONS):
        misfits, sills, growths = _fit_linear(sphericals, growing, lambda3, model, steps, is_told)
        best = np.argmin(misfits, axis=1)
        sill, growth = sills[rows, best], growths[rows, best]
        model = np.maximum(sill[:, None] * sphericals[best] + growth[:, None] * growing, floor)
    return candidates[best], sill, growth / n[-1] ** 2


def _fit_linear(
    sphericals: Floats, growing: Floats, lambda3: Floats, model: Floats, steps: Floats, is_told: bool
) -> tuple[Floats, Floats, Floats]:
    """Return misfit, sill and growth (s, c) of every curve with every candidate range, none of them negative.

    Without a growth where sizes do not tell one (`is_told`).
    """

    def whiten(relative: Floats) -> Floats:
        """Return residuals relative to the model as uncorrelated ones of variance 1: increments over their steps."""
        return np.concatenate([relative[..., :-1] - relative[..., 1:], relative[..., -1:]], axis=-1) / steps

    a = whiten(sphericals[None] / model[:, None, :])  # (s, c, j)
    b = whiten(growing / model)[:, None, :]
    y = whiten(lambda3 / model)[:, None, :]
    aa, ab, bb = (a * a).sum(-1), (a * b).sum(-1), (b * b).sum(-1)
    ay, by, yy = (a * y).sum(-1), (b * y).sum(-1), (y * y).sum(-1)
    only_a = np.maximum(ay, 0.0) / aa
    misfit, sill, growth = yy - only_a * ay, only_a, np.zeros_like(only_a)
    det = aa * bb - ab**2
    with np.errstate(invalid="ignore", divide="ignore"):  # two sizes or fewer tell no growth: `better` says so
        both_a, both_b = (bb * ay - ab * by) / det, (aa * by - ab * ay) / det
    both = yy - both_a * ay - both_b * by + SIGNIFICANT
    better = is_told & (both_a >= 0) & (both_b >= 0) & (det > 1e-9 * aa * bb) & (both < misfit)
    return np.where(better, both, misfit), np.where(better, both_a, sill), np.where(better, both_b, growth)


def find_sizes(points: Floats, sizes: Ints, normals: Floats, least: Floats) -> Floats:
    """Return the neighbourhood size n_o (s,) whose normals have the least error, within 10 and `LARGEST`.

    Parameters
    ----------
    points : (s, 3) m, sampled points.
    sizes : (j,) growing neighbourhood sizes.
    normals : (s, j, 3) unit normals at each sample and size, of either sign.
    least : (s,) size from which on a neighbourhood reaches beyond the band of noise; smaller ones say nothing.

    Notes
    -----
    Noise turns the normal of a disc of n points by a variance a / n^2 (that of the points over their number and the
    mean square radius, which is as n); a surface of third order by an angle as r^2, b n. Neighbourhoods are nested, so
    that normals at n and m differ by a (1 / n^2 - 1 / m^2) + b^2 (m - n)^2 in the mean square, whatever the true one.
    The error a / n^2 + b^2 n^2 is least at n_o = (a / b^2)^(1/4): the n_o whose differences, on a logarithmic scale
    and up to a common factor, come nearest to those measured, the squared mean of angles among `N_POOLED` samples.
    Where fewer than three pairs are above `least`, n_o is `LARGEST`.
    """
    if len(sizes) < 3:
        return np.full(len(points), float(sizes[-1]))
    i, j = np.triu_indices(len(sizes), 1)
    i, j = i[j - i <= N_APART], j[j - i <= N_APART]
    sines = np.sqrt(np.maximum(1.0 - (normals[:, i] * normals[:, j]).sum(axis=2) ** 2, 0.0))
    _, groups = cKDTree(points).query(points, min(N_POOLED, len(points)))
    measured = 2.0 * np.log(np.maximum(sines[groups.reshape(len(points), -1)].mean(axis=1), 1e-9))
    n, m = np.asarray(sizes, dtype=float)[i], np.asarray(sizes, dtype=float)[j]
    candidates = np.geomspace(10.0, LARGEST, N_RANGES)
    models = np.log(1.0 / n**2 - 1.0 / m**2 + (m - n) ** 2 / candidates[:, None] ** 4)
    is_disc = n >= least[:, None]
    is_known = is_disc.sum(axis=1) >= 3
    used = is_disc | ~is_known[:, None]
    misfit = np.stack([np.var(measured - model, axis=1, where=used) for model in models])
    return np.where(is_known, candidates[np.argmin(misfit, axis=0)], float(LARGEST))


def model_noise(points: Floats, sizes: Ints, lambda3: Floats, radii: Floats, largest: int) -> NeighbourhoodModel:
    """Fit the noise at sampled points; their sizes are the ranges of the variograms, where the level is reached.

    Parameters
    ----------
    points : (s, 3) m, the sampled points.
    sizes : (j,) the neighbourhood sizes tried.
    lambda3 : (s, j) m2, robust least eigenvalue at each sample and size, free of the bias of small n.
    radii : (s,) m, radius of the largest neighbourhood.
    largest : the largest size that has a meaning.
    """
    _, groups = cKDTree(points).query(points, min(GROUP, len(points)))
    curves = np.median(lambda3[groups.reshape(len(points), -1)], axis=1)
    floor = 1e-12 * float(np.median(curves[:, -1])) + 1e-18
    n_range, sill, _ = fit_spherical(sizes, np.maximum(curves, floor))
    sill = np.maximum(sill, floor)
    noise = np.sqrt(undo_ball(sill, radii**2))
    return NeighbourhoodModel(points, np.minimum(n_range, largest), noise, np.ones(len(points), dtype=np.int64))


def undo_ball(lambda3: Floats, radii2: Floats) -> Floats:
    """Return the noise variance (n,) [m2] whose share within balls of squared radius `radii2` [m2] is `lambda3`.

    The nearest points in space are a ball, which cuts the band of noise at its rim: the mean of h^2 under the weights
    R^2 - h^2 of its discs is sigma^2 (R^2 - 3 sigma^2) / (R^2 - sigma^2). Inverted to first order.
    """
    return lambda3 * (1.0 + 2.0 * lambda3 / np.maximum(radii2, 4.0 * lambda3 + 1e-300))
