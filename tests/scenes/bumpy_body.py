"""A closed body of about 0.6 m with soft bumps, scanned with noise: the known truth of the registration's tests."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from projects.model import Floats, PointCloud
from projects.transforms import apply, rotate

NOISE = 2e-4  # m


def bumpy_points(n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return points and normals of a closed body of about 0.6 m with soft bumps, the same for every call."""
    shape = np.random.default_rng(5)
    waves, phases, heights = shape.normal(size=(12, 3)) * 4, shape.uniform(0, 6.28, 12), shape.uniform(0.005, 0.012, 12)

    def body(d: Floats) -> Floats:
        d = d / np.linalg.norm(d, axis=1)[:, None]
        radius = 0.3 * np.linalg.norm(d * [1.0, 0.8, 1.2], axis=1) + (heights * np.cos(d @ waves.T + phases)).sum(
            axis=1
        )
        return d * radius[:, None]

    d = unit(rng.normal(size=(n, 3)))
    a = unit(np.cross(d, [0.3, 0.5, 0.81]))
    b = np.cross(d, a)
    normals = unit(np.cross(body(d + 1e-5 * a) - body(d - 1e-5 * a), body(d + 1e-5 * b) - body(d - 1e-5 * b)))
    return body(d), normals * np.sign(np.sum(normals * d, axis=1))[:, None]


def unit(v: Floats) -> Floats:
    return v / np.linalg.norm(v, axis=1)[:, None]


def noisy_cloud(n: int, rng: np.random.Generator, change: Callable[[Floats], Floats] | None = None) -> PointCloud:
    """Return the bumpy body with noise of points and normals, each point lifted by `change` (of directions)."""
    points, normals = bumpy_points(n, rng)
    lift = 0.0 if change is None else change(unit(points))
    points = points + normals * (rng.normal(0, NOISE, n) + lift)[:, None]
    return PointCloud(points, unit(normals + rng.normal(0, 0.05, (n, 3))))


def move(cloud: PointCloud, T: Floats) -> PointCloud:
    return PointCloud(apply(T, cloud.points), None if cloud.normals is None else rotate(T, cloud.normals))


def correlated_noise(points: Floats, rng: np.random.Generator, sigma: float, reach: float) -> Floats:
    """Return a random field (n,) [m] with covariance sigma^2 exp(-d^2 / (2 reach^2)), by 150 random waves."""
    waves, phases = rng.normal(size=(150, 3)) / reach, rng.uniform(0, 2 * np.pi, 150)
    return sigma * np.sqrt(2 / 150) * np.cos(points @ waves.T + phases).sum(axis=1)
