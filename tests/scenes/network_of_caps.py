"""Scans of a bumpy ball with known pose errors, and targets around it: the known truth of the adjustment's tests."""

from __future__ import annotations

import dataclasses

import numpy as np
from bumpy_body import correlated_noise
from scipy.spatial.transform import Rotation

from monitor.registration.network.adjustment import Adjustment, AdjustmentSettings, adjust_scans
from monitor.registration.network.ties import identify_targets
from projects.model import ControlPoint, Floats, PointCloud, SurveyTarget
from projects.transforms import apply, perturb, rotate

SIGMA_TARGET, SIGMA_CONTROL = 0.0002, 0.0005


def bumpy_cap(rng: np.random.Generator, turn: float, noise: float) -> PointCloud:
    """Return the part of a bumpy ball of 0.5 m that a station at azimuth `turn` sees."""
    v = rng.normal(size=(24_000, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    v = v[v @ np.array([np.cos(turn), np.sin(turn), 0.0]) > 0.15]
    radius = 0.5 + 0.02 * np.sin(9 * v[:, 0]) * np.cos(7 * v[:, 1] + 2 * v[:, 2])
    slope = 0.02 * np.column_stack([
        9 * np.cos(9 * v[:, 0]) * np.cos(7 * v[:, 1] + 2 * v[:, 2]),
        -7 * np.sin(9 * v[:, 0]) * np.sin(7 * v[:, 1] + 2 * v[:, 2]),
        -2 * np.sin(9 * v[:, 0]) * np.sin(7 * v[:, 1] + 2 * v[:, 2]),
    ])  # fmt: skip
    slope -= np.sum(slope * v, axis=1)[:, None] * v
    normals = v - slope / radius[:, None]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = radius[:, None] * v + rng.normal(0, noise, len(v))[:, None] * normals
    return PointCloud(points, normals=normals)


def displaced(cloud: PointCloud, T: np.ndarray) -> PointCloud:
    """Return the cloud moved by T, normals and all."""
    return dataclasses.replace(cloud, points=apply(T, cloud.points), normals=rotate(T, cloud.normals))


def small_motion(T: Floats, centre: Floats) -> Floats:
    """Return (w, t) of a small motion about a centre, rad and m."""
    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), apply(T, centre) - centre])


def noisy_caps(rng: np.random.Generator, n: int, reach: float | None, n_points: int = 6_000) -> list[PointCloud]:
    """Return n overlapping parts of the ball, seen from all around, with noise of points and, with `reach` [m], noise
    that neighbours share."""
    clouds = []
    for turn in np.arange(n) * 2 * np.pi / n:
        cloud = bumpy_cap(rng, turn, 0.0003)
        cloud = cloud.take(rng.choice(len(cloud), min(n_points, len(cloud)), replace=False))
        normals = cloud.normals + rng.normal(0, 0.03, cloud.normals.shape)
        cloud = dataclasses.replace(cloud, normals=normals / np.linalg.norm(normals, axis=1, keepdims=True))
        if reach is not None:
            lift = correlated_noise(cloud.points, rng, 0.0004, reach)
            cloud = dataclasses.replace(cloud, points=cloud.points + cloud.normals * lift[:, None])
        clouds.append(cloud)
    return clouds


def pose_errors(rng: np.random.Generator, n: int, angle: float = 0.002, way: float = 0.0015) -> list[Floats]:
    return [perturb(np.eye(4), np.zeros(3), d) for d in rng.normal(0, [angle] * 3 + [way] * 3, (n, 6))]


def target_places(n: int) -> Floats:
    """Return the places of n targets about a metre from the ball."""
    turn = np.arange(n) * 2.39996
    height = np.linspace(-0.9, 0.9, n)
    return np.column_stack([np.cos(turn), np.sin(turn), height]) * (1.0 + 0.1 * np.cos(5.0 * turn))[:, None]


def seen_targets(rng: np.random.Generator, places: Floats, errors: list[Floats]) -> list[list[SurveyTarget]]:
    """Return the targets that each scan sees, with noise, where its wrong pose puts them."""
    covariance = np.eye(3) * SIGMA_TARGET**2
    return [
        [SurveyTarget("sphere", apply(E, p + rng.normal(0, SIGMA_TARGET, 3)), covariance, 0.0725, 0.0002, 300, 1.0)
         for p in places]
        for E in errors
    ]  # fmt: skip


def known_points(rng: np.random.Generator, places: Floats) -> tuple[ControlPoint, ...]:
    """Return control points with noise, named P0 and so on."""
    return tuple(
        ControlPoint(f"P{k}", p + rng.normal(0, SIGMA_CONTROL, 3), SIGMA_CONTROL) for k, p in enumerate(places)
    )


def relative_errors(found: Adjustment, errors: list[Floats]) -> list[float]:
    """Return e' C^-1 e of each scan's motion less the mean of all."""
    left = np.array([small_motion(M @ E, np.zeros(3)) for M, E in zip(found.motions, errors, strict=True)])
    squared = []
    for e, C, centre in zip(left - left.mean(axis=0), found.covariances, found.centres, strict=True):
        about = np.concatenate([e[:3], e[3:] + np.cross(e[:3], centre)])
        squared.append(float(about @ np.linalg.solve(C, about)))
    return squared


def absolute_error(found: Adjustment, errors: list[Floats]) -> float:
    """Return e' C^-1 e of the epoch as a whole."""
    left = [small_motion(M @ E, found.centre) for M, E in zip(found.motions, errors, strict=True)]
    e = np.mean(left, axis=0)
    return float(e @ np.linalg.solve(found.covariance, e))


def simulate_network(seed: int, reach: float | None, *, is_absolute: bool) -> tuple[list[float], float]:
    """Return the squared errors of one simulated adjustment of four scans: of each scan, and of the whole."""
    rng = np.random.default_rng(seed)
    clouds, errors = noisy_caps(rng, 4, reach), pose_errors(rng, 4)
    ties = None
    if is_absolute:
        places = target_places(6)
        ties = identify_targets(seen_targets(rng, places, errors), known_points(rng, places))
    given = [displaced(c, E) for c, E in zip(clouds, errors, strict=True)]
    found = adjust_scans(given, AdjustmentSettings(n_samples=1500), ties)
    assert found.applied, found.reason
    if not is_absolute:
        return relative_errors(found, errors), float("nan")
    each = [
        small_motion(M @ E, c) @ np.linalg.solve(C, small_motion(M @ E, c))
        for M, E, C, c in zip(found.motions, errors, found.covariances, found.centres, strict=True)
    ]
    return each, absolute_error(found, errors)
