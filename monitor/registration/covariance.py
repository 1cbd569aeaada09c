"""How well a motion is known: its 6 x 6 covariance, honest about neighbouring residuals that err together.

The covariance of independent residuals is too good by orders of magnitude. Here the residuals of the stable areas
themselves tell how they correlate with distance, and the covariance is that of the M-estimate under this correlation:
C = H^-1 B H^-1 with H the information of the shape and B = sum_ij J_i J_j' c(d_ij) (after Huber 1967, Conley 1999).
All covariances are of (w, t) in x -> c + exp([w]) (x - c) + t, radians and metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from monitor.registration.matching import Matches
from monitor.registration.sampling import motion_rows
from monitor.registration.weights import tukey_slope
from projects.errors import ShapeError
from projects.model import Floats, Ints

N_FAR = 2000  # points whose pairs, two million, show the correlation at distances beyond the nearest neighbours
N_NEAR = 8  # neighbours of every point that show it at short distances
N_BINS = 24
N_RANGES = 10
N_CORRECTIONS = 4


@dataclass(frozen=True)
class Correlation:
    """Covariance of standardized residuals against distance: nugget at zero plus sum of sills exp(-d / range [m])."""

    nugget: float
    sills: Floats
    ranges: Floats

    def at(self, distance: Floats) -> Floats:
        """Return the covariance of two different points `distance` [m] apart."""
        return np.exp(-distance[..., None] / self.ranges) @ self.sills


def propagate(covariance: Floats, centre: Floats, points: Floats, normals: Floats) -> Floats:
    """Return one sigma (n,) [m] along the normal that the uncertainty of a motion causes at each point.

    Parameters
    ----------
    covariance : (6, 6) of (w, t) about `centre`, rad and m.
    centre : (3,), m, target frame.
    points, normals : (n, 3), target frame, m and unit vectors.

    Returns
    -------
    sigma : (n,) m, sqrt(n' J C J' n); NaN where the normal is unknown.

    Notes
    -----
    A point moves by J (w, t) = w x (x - c) + t, so along n by ((x - c) x n) . w + n . t: it grows with the lever arm.
    """
    if np.shape(covariance) != (6, 6) or np.shape(points) != np.shape(normals):
        raise ShapeError(f"covariance {np.shape(covariance)}, points {np.shape(points)}, normals {np.shape(normals)}; "
                         "(6, 6) and twice (n, 3) are needed")  # fmt: skip
    rows = motion_rows(np.asarray(points, dtype=float), np.asarray(normals, dtype=float), np.asarray(centre))
    return np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", rows, covariance, rows), 0.0))


def shape_information(matches: Matches, centre: Floats, weights: Floats) -> Floats:
    """Return the information (6, 6) that the shape holds on the motion, free of the noise of the normals.

    Noise of a normal looks like relief that holds the surface in place. Source and target normals err independently,
    so the product of their rows has the shape alone in it.
    """
    a = motion_rows(matches.points, matches.normals_source, centre)
    b = motion_rows(matches.points, matches.normals_target, centre)
    cross = np.einsum("ni,nj->ij", a * weights[:, None], b)
    return 0.5 * (cross + cross.T)


@dataclass(frozen=True)
class Adjusted:
    """The pairs that a motion rests on: standardized residuals and rows divided by their sigma, ready to sum."""

    points: Floats
    u: Floats
    psi: Floats
    rows: Floats
    slope: float
    information: Floats
    patch: Ints


def estimate_covariance(matches: Matches, sigma: Floats, patch: Ints, centre: Floats, rng: np.random.Generator,
                        ) -> Floats:  # fmt: skip
    """Return the covariance (6, 6) of the motion that the pairs give; never below that of independent residuals."""
    adjusted = standardize(matches, sigma, patch, centre)
    naive = naive_covariance(adjusted)
    lags = collect_lags(adjusted.points, rng)
    covariance = naive
    for _ in range(N_CORRECTIONS):  # the fit itself took part of the correlation out of the residuals
        correlation = fit_correlation(adjusted, lags, covariance)
        bread = np.linalg.pinv(adjusted.slope * adjusted.information, hermitian=True)
        covariance = at_least(bread @ score_covariance(adjusted, correlation, lags) @ bread, naive)
    return covariance


def standardize(matches: Matches, sigma: Floats, patch: Ints, centre: Floats) -> Adjusted:
    """Return what the sums of the covariance are made of."""
    u = matches.residuals / sigma
    u = u / max(1.4826 * float(np.median(np.abs(u))), 1e-12)
    rows = motion_rows(matches.points, matches.normals, centre) / sigma[:, None]
    psi = u * np.maximum(1.0 - (u / 4.685) ** 2, 0.0) ** 2
    information = shape_information(matches, centre, 1.0 / sigma**2)
    return Adjusted(matches.points, u, psi, rows, float(np.mean(tukey_slope(u))), information, patch)


def naive_covariance(adjusted: Adjusted) -> Floats:
    """Return the covariance (6, 6) of the M-estimate as if all residuals were independent."""
    factor = float(np.mean(adjusted.psi**2)) / adjusted.slope**2
    return factor * np.linalg.pinv(adjusted.information, hermitian=True)


@dataclass(frozen=True)
class Lags:
    """Pairs of points (first, second), their distance [m] and the bin (n,) each falls in."""

    first: Ints
    second: Ints
    distance: Floats
    bin: Ints


def collect_lags(points: Floats, rng: np.random.Generator) -> Lags:
    """Return pairs of neighbours and pairs at random, in bins of distance."""
    n = len(points)
    _, near = cKDTree(points).query(points, k=min(N_NEAR + 1, n), workers=-1)
    some = rng.choice(n, min(N_FAR, n), replace=False)
    i, j = np.triu_indices(len(some), 1)
    first = np.concatenate([np.repeat(np.arange(n), near.shape[1] - 1), some[i]])
    second = np.concatenate([near[:, 1:].ravel(), some[j]])
    near_distance = np.linalg.norm(points[first[: n * (near.shape[1] - 1)]] - points[near[:, 1:].ravel()], axis=1)
    distance = np.concatenate([near_distance, pdist(points[some])])
    low, high = max(float(np.quantile(near_distance, 0.05)), 1e-9), float(distance.max())
    edges = np.geomspace(low, high * 1.000001, N_BINS)
    return Lags(first, second, distance, np.searchsorted(edges, distance))


def fit_correlation(adjusted: Adjusted, lags: Lags, covariance: Floats) -> Correlation:
    """Return the covariance of psi against distance: a sum of exponentials with sills that are not negative."""
    fitted = np.linalg.cholesky(covariance + 1e-12 * np.diag(np.diag(covariance)))
    absorbed = adjusted.slope * (adjusted.rows @ fitted)
    products = adjusted.psi[lags.first] * adjusted.psi[lags.second]
    products += np.einsum("ni,ni->n", absorbed[lags.first], absorbed[lags.second])
    count = np.bincount(lags.bin)
    filled = count > 0
    value = np.bincount(lags.bin, products)[filled] / count[filled]
    distance = np.bincount(lags.bin, lags.distance)[filled] / count[filled]
    ranges = np.geomspace(distance[0], distance[-1] / 3.0, N_RANGES)
    root = np.sqrt(count[filled])
    sills, _ = nnls(np.exp(-distance[:, None] / ranges) * root[:, None], value * root)
    variance = float(np.mean(adjusted.psi**2))
    return Correlation(max(variance - float(sills.sum()), 0.0), sills, ranges)


def score_covariance(adjusted: Adjusted, correlation: Correlation, lags: Lags) -> Floats:
    """Return B (6, 6) = sum over all pairs of J_i J_j' c(d_ij), summed patch by patch."""
    _, member = np.unique(adjusted.patch, return_inverse=True)
    count = np.bincount(member).astype(float)
    sums = np.stack([np.bincount(member, column) for column in adjusted.rows.T], axis=1)
    middles = np.stack([np.bincount(member, column) for column in adjusted.points.T], axis=1) / count[:, None]
    own = np.einsum("ni,nj->ij", adjusted.rows, adjusted.rows)
    between = correlation.at(np.linalg.norm(middles[:, None] - middles[None], axis=2))
    inside = lags.distance[member[lags.first] == member[lags.second]]
    within = float(correlation.at(inside).mean()) if len(inside) else 0.0
    np.fill_diagonal(between, within)
    variance = correlation.nugget + float(correlation.sills.sum())
    return (variance - within) * own + np.einsum("pi,pq,qj->ij", sums, between, sums, optimize=True)


def at_least(covariance: Floats, naive: Floats) -> Floats:
    """Return the covariance raised, in every direction of motion, to at least the naive one."""
    root = np.linalg.cholesky(naive + 1e-12 * np.diag(np.diag(naive)))
    whitened = np.linalg.solve(root, np.linalg.solve(root, covariance).T)
    values, vectors = np.linalg.eigh(0.5 * (whitened + whitened.T))
    raised = (vectors * np.maximum(values, 1.0)) @ vectors.T
    return root @ raised @ root.T
