"""Where the network put its scans: what bends or swells the surface counts, what moves it as a whole does not."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from monitor.quality import join_shared
from monitor.registration.placement import placement_sigma
from projects.model import Floats, PointCloud


def wall(rng: np.random.Generator, x: float, y_from: float = -0.5, y_to: float = 0.5) -> PointCloud:
    """A wall across x, one metre high, facing +x."""
    n = int(4000 * (y_to - y_from))
    points = np.column_stack([np.full(n, x), rng.uniform(y_from, y_to, n), rng.uniform(-0.5, 0.5, n)])
    return PointCloud(points, normals=np.tile([1.0, 0.0, 0.0], (n, 1)))


def walls_of_a_cube(rng: np.random.Generator) -> list[PointCloud]:
    """Six walls half a metre from the origin, each facing outwards."""
    walls = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            points = rng.uniform(-0.5, 0.5, (4000, 3))
            points[:, axis] = 0.5 * side
            walls.append(PointCloud(points, normals=np.tile(side * np.eye(3)[axis], (4000, 1))))
    return walls


def test_two_scans_that_slide_off_each_other_err_by_half_the_way(rng: np.random.Generator) -> None:
    clouds = [wall(rng, 0.0, -1.5, -0.5), wall(rng, 0.0, 0.5, 1.5), wall(rng, 0.0, 2.5, 3.5), wall(rng, 0.0, 4.5, 5.5)]
    covariances = np.zeros((4, 6, 6))
    covariances[:, 3, 3] = 0.001**2
    covariances[:, 4, 4] = 0.05**2  # what slides along the wall does not matter
    where = np.array([[0.0, 0.0 + 2.0 * k, 0.0] for k in range(4)]) - [0.0, 1.0, 0.0]
    sigma = placement_sigma(where, clouds, 0.01, block_diag(*covariances), np.zeros((4, 3)))
    # a shift and a turn of the whole leave the residuals of a line through four values: 1 - 1/4 - x^2 / sum x^2
    left = 1.0 - 0.25 - np.array([-3.0, -1.0, 1.0, 3.0]) ** 2 / 20.0
    assert sigma == pytest.approx(0.001 * np.sqrt(left), rel=0.03)


def test_a_motion_that_all_scans_share_is_left_to_the_registration(rng: np.random.Generator) -> None:
    clouds = walls_of_a_cube(rng)
    common = np.diag([1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3]) ** 2
    sigma = placement_sigma(clouds[0].points, clouds, 0.01, np.tile(common, (6, 6)), np.zeros((6, 3)))
    assert sigma.max() < 1e-8


def test_scans_that_all_lie_outward_make_the_body_too_large(rng: np.random.Generator) -> None:
    clouds = walls_of_a_cube(rng)
    outward = np.concatenate([np.append(np.zeros(3), c.normals[0]) for c in clouds])  # type: ignore[index]
    sigma = placement_sigma(clouds[0].points, clouds, 0.01, 0.0004**2 * np.outer(outward, outward), np.zeros((6, 3)))
    assert np.median(sigma) == pytest.approx(0.0004, rel=0.02)


def test_where_two_scans_see_a_place_it_errs_as_their_mean(rng: np.random.Generator) -> None:
    def outwards(sigma: float) -> Floats:
        return np.diag([0.0, 0.0, 0.0, sigma**2, sigma**2, sigma**2])

    clouds = walls_of_a_cube(rng)
    once = placement_sigma(np.zeros((1, 3)) + 0.5, clouds, 0.01, block_diag(*[outwards(0.001)] * 6), np.zeros((6, 3)))
    twice = placement_sigma(np.zeros((1, 3)) + 0.5, [c for c in clouds for _ in range(2)], 0.01,
                            block_diag(*[outwards(0.001)] * 12), np.zeros((12, 3)))  # fmt: skip
    assert twice[0] == pytest.approx(once[0] / np.sqrt(2.0), rel=1e-6)


def test_scans_at_their_given_poses_add_nothing(rng: np.random.Generator) -> None:
    clouds = [wall(rng, 0.0), wall(rng, 3.0)]
    unknown = np.full((12, 12), np.nan), np.full((2, 3), np.nan)
    assert not placement_sigma(clouds[0].points[:7], clouds, 0.01, *unknown).any()


def test_scans_that_share_nothing_are_still_no_better_placed_than_their_targets_say() -> None:
    disagreement = np.array([0.003, np.nan, np.nan, 0.003])
    placed = np.array([0.004, 0.004, 0.0, 0.0])
    assert join_shared(disagreement, placed) == pytest.approx([0.005, 0.004, np.nan, 0.003], nan_ok=True)
