"""Where the network put its scans: the sigma at the surface is the scan's own, along the normal."""

import numpy as np
import pytest

from monitor.registration.placement import placement_sigma
from projects.model import PointCloud


def wall(rng: np.random.Generator, x: float, n: int = 2000) -> PointCloud:
    """A wall one metre square across x, facing +x."""
    points = np.column_stack([np.full(n, x), rng.uniform(-0.5, 0.5, n), rng.uniform(-0.5, 0.5, n)])
    return PointCloud(points, normals=np.tile([1.0, 0.0, 0.0], (n, 1)))


def test_sigma_is_that_of_the_nearest_scan_along_its_normal(rng: np.random.Generator) -> None:
    clouds = [wall(rng, 0.0), wall(rng, 3.0)]
    covariances = np.zeros((2, 6, 6))
    covariances[0, 3, 3], covariances[0, 4, 4] = 0.0002**2, 0.05**2  # what slides along the wall does not matter
    covariances[1, 2, 2] = 0.001**2  # rad2, turns about the vertical
    centres = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    where = np.array([[0.0, 0.1, 0.1], [3.0, 0.45, 0.0], [3.0, 0.02, 0.0]])
    sigma = placement_sigma(where, clouds, 0.01, covariances, centres)
    assert sigma[0] == pytest.approx(0.0002, rel=1e-6)
    assert sigma[1] == pytest.approx(0.00045, rel=0.1)  # grows with the lever arm
    assert sigma[2] < 0.0001


def test_scans_at_their_given_poses_add_nothing(rng: np.random.Generator) -> None:
    clouds = [wall(rng, 0.0), wall(rng, 3.0)]
    unknown = np.full((2, 6, 6), np.nan), np.full((2, 3), np.nan)
    assert not placement_sigma(clouds[0].points[:7], clouds, 0.01, *unknown).any()
