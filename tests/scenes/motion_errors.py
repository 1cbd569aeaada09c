"""By how much an estimated motion is off the true one, and how that compares with its covariance."""

from __future__ import annotations

import numpy as np
from bumpy_body import correlated_noise, move, noisy_cloud
from scipy.spatial.transform import Rotation

from monitor.registration import register
from projects.model import Floats, Registration
from projects.transforms import apply, invert, perturb


def error_of(registration: Registration, T_truth: Floats) -> Floats:
    """Return (w, t) about the centre, the left perturbation that turns the estimate into the truth."""
    error = T_truth @ invert(registration.T_target_source)
    w = Rotation.from_matrix(error[:3, :3]).as_rotvec()
    return np.concatenate([w, apply(error, registration.centre) - registration.centre])


def squared_error(rng: np.random.Generator, reach: float | None) -> float:
    """Return the error of one simulated registration against its covariance: chi2 of 6 where that is honest."""
    clouds = []
    for _ in range(2):
        cloud = noisy_cloud(4_000, rng)
        if reach is not None and cloud.normals is not None:
            lift = correlated_noise(cloud.points, rng, 4e-4, reach)
            cloud = type(cloud)(cloud.points + cloud.normals * lift[:, None], cloud.normals)
        clouds.append(cloud)
    T = perturb(np.eye(4), np.zeros(3), np.concatenate([rng.normal(0, 0.015, 3), rng.normal(0, 0.005, 3)]))
    registration = register(move(clouds[0], invert(T)), clouds[1])
    assert registration.converged, registration.reason
    error = error_of(registration, T)
    return float(error @ np.linalg.solve(registration.covariance, error))
