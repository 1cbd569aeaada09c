"""The six parameters of a rigid motion from paired points, with their covariance.

In: the same points measured in two frames, each with its covariance. Out: the motion, closed form first (Horn 1987;
Kabsch 1976), then adjusted under the full covariances (`papers/004`, section 2.3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from projects.errors import RegistrationError, ShapeError
from projects.model import Floats
from projects.transforms import apply, cross_matrix, perturb

N_STEPS = 20
SETTLED = 1e-12  # m and rad
ACROSS_SIGMAS = 10.0  # points must spread across their line by so many sigma, or the turn about it is unknown


@dataclass(frozen=True)
class SixParameters:
    """A rigid motion from points.

    Attributes
    ----------
    T_target_source : (4, 4).
    covariance : (6, 6) of (w, t) in x -> c + exp([w]) (x - c) + t about `centre` (target frame), rad and m.
    centre : (3,) m, weighted mean of the target points.
    residuals : (n, 3) m, moved source less target.
    """

    T_target_source: Floats
    covariance: Floats
    centre: Floats
    residuals: Floats


def six_parameters(
    source: Floats, target: Floats, covariance_source: Floats | None = None, covariance_target: Floats | None = None
) -> SixParameters:
    """Return the motion that brings source points onto target points, row by row.

    Parameters
    ----------
    source, target : (n, 3) m, n of three or more, not on one line.
    covariance_source, covariance_target : (n, 3, 3) m2, each in its own frame; where both are left out all points
        count alike and the residuals alone tell their sigma.

    Raises
    ------
    RegistrationError
        For fewer than three points, or points so near to one line that the turn about it is unknown.

    Notes
    -----
    Minimizes sum v' (C_target + R C_source R')^-1 v by Gauss-Newton. The covariance is that of the stated ones, raised
    by as much as the squares of the residuals are larger than stated.
    """
    source, target = np.asarray(source, dtype=float), np.asarray(target, dtype=float)
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3:
        raise ShapeError(f"source {source.shape} and target {target.shape}; two arrays (n, 3) are needed")
    stated = covariance_source is not None or covariance_target is not None
    none = np.zeros((len(source), 3, 3))
    of_source = none if covariance_source is None else covariance_source
    of_target = (none + (0.0 if stated else np.eye(3))) if covariance_target is None else covariance_target
    sigma2 = np.trace(of_source + of_target, axis1=1, axis2=2) / 3.0
    require_spread(target, np.sqrt(sigma2) if stated else np.zeros(len(target)))
    T = closest_motion(source, target, 1.0 / sigma2)
    for _ in range(N_STEPS):
        R = T[:3, :3]
        weights = np.linalg.inv(of_target + R @ of_source @ R.T)
        centre = np.average(target, axis=0, weights=1.0 / sigma2)
        moved = apply(T, source)
        rows = point_rows(moved, centre)
        normal = np.einsum("nai,nab,nbj->ij", rows, weights, rows)
        delta = -np.linalg.solve(normal, np.einsum("nai,nab,nb->i", rows, weights, moved - target))
        T = perturb(T, centre, delta)
        if np.abs(delta).max() < SETTLED:
            break
    return _conclude(T, source, target, (weights, normal, centre), stated)


def _conclude(
    T: Floats, source: Floats, target: Floats, found: tuple[Floats, Floats, Floats], stated: bool
) -> SixParameters:
    """Return the result with the covariance that weights, normal matrix and residuals give."""
    weights, normal, centre = found
    residuals = apply(T, source) - target
    freedom = 3 * len(source) - 6
    sigma2 = float(np.einsum("ni,nij,nj->", residuals, weights, residuals)) / freedom
    covariance = np.linalg.inv(normal) * (max(1.0, sigma2) if stated else sigma2)
    return SixParameters(T, covariance, centre, residuals)


def point_rows(points: Floats, centre: Floats) -> Floats:
    """Return J (n, 3, 6): the way of each point under a small motion (w, t) about `centre`, w x (x - c) + t."""
    return np.concatenate(
        [np.array([-cross_matrix(p) for p in points - centre]), np.tile(np.eye(3), (len(points), 1, 1))], axis=2
    )


def closest_motion(source: Floats, target: Floats, weights: Floats) -> Floats:
    """Return T_target_source (4, 4) of least weighted squares, never a mirror image (Kabsch 1976)."""
    a, b = np.average(source, axis=0, weights=weights), np.average(target, axis=0, weights=weights)
    u, _, vt = np.linalg.svd((source - a).T @ ((target - b) * weights[:, None]))
    sign = np.sign(np.linalg.det(u @ vt))
    T = np.eye(4)
    T[:3, :3] = vt.T @ np.diag([1.0, 1.0, sign]) @ u.T
    T[:3, 3] = b - T[:3, :3] @ a
    return T


def require_spread(points: Floats, sigma: Floats) -> None:
    """Raise `RegistrationError` where points (n, 3) are too few or lie on one line within their sigma (n,) [m]."""
    if len(points) < 3:
        raise RegistrationError(f"{len(points)} homologous points; three or more that are not on one line are needed")
    lengths = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if lengths[1] <= max(ACROSS_SIGMAS * float(np.median(sigma)), 1e-9 * lengths[0]):
        raise RegistrationError(
            f"the {len(points)} homologous points lie on one line (they spread {lengths[1] * 1e3:.1f} mm across it), "
            "so the turn about it is unknown; place targets aside of it"
        )
