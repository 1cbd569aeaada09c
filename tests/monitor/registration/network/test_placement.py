"""Where the network put its scans: what bends or swells the surface counts, what moves it as a whole does not."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from monitor.quality import join_shared
from monitor.registration.network.placement import lay_out_placement, placement_sigma
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
    sigma = placement_sigma(where, lay_out_placement(clouds, 0.01, block_diag(*covariances), np.zeros((4, 3))))
    # a shift and a turn of the whole leave the residuals of a line through four values: 1 - 1/4 - x^2 / sum x^2
    left = 1.0 - 0.25 - np.array([-3.0, -1.0, 1.0, 3.0]) ** 2 / 20.0
    assert sigma == pytest.approx(0.001 * np.sqrt(left), rel=0.03)


def test_a_motion_that_all_scans_share_is_left_to_the_registration(rng: np.random.Generator) -> None:
    clouds = walls_of_a_cube(rng)
    common = np.diag([1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3]) ** 2
    placement = lay_out_placement(clouds, 0.01, np.tile(common, (6, 6)), np.zeros((6, 3)))
    sigma = placement_sigma(clouds[0].points, placement)
    assert sigma.max() < 1e-8


def test_scans_that_all_lie_outward_make_the_body_too_large(rng: np.random.Generator) -> None:
    clouds = walls_of_a_cube(rng)
    outward = np.concatenate([np.append(np.zeros(3), c.normals[0]) for c in clouds])  # type: ignore[index]
    joint = 0.0004**2 * np.outer(outward, outward)
    sigma = placement_sigma(clouds[0].points, lay_out_placement(clouds, 0.01, joint, np.zeros((6, 3))))
    assert np.median(sigma) == pytest.approx(0.0004, rel=0.02)


def test_where_two_scans_see_a_place_it_errs_as_their_mean(rng: np.random.Generator) -> None:
    def outwards(sigma: float) -> Floats:
        return np.diag([0.0, 0.0, 0.0, sigma**2, sigma**2, sigma**2])

    clouds = walls_of_a_cube(rng)
    corner = np.full((1, 3), 0.5)
    once = lay_out_placement(clouds, 0.01, block_diag(*[outwards(0.001)] * 6), np.zeros((6, 3)))
    both = [c for c in clouds for _ in range(2)]
    twice = lay_out_placement(both, 0.01, block_diag(*[outwards(0.001)] * 12), np.zeros((12, 3)))
    ratio = placement_sigma(corner, twice)[0] / placement_sigma(corner, once)[0]
    assert ratio == pytest.approx(1.0 / np.sqrt(2.0), rel=1e-6)


def test_scans_at_their_given_poses_add_nothing(rng: np.random.Generator) -> None:
    clouds = [wall(rng, 0.0), wall(rng, 3.0)]
    unknown = np.full((12, 12), np.nan), np.full((2, 3), np.nan)
    assert not placement_sigma(clouds[0].points[:7], lay_out_placement(clouds, 0.01, *unknown)).any()


def test_what_the_registration_leaves_out_is_as_sure_as_its_scan_against_the_rest(rng: np.random.Generator) -> None:
    """Three scans of which the registration holds to two: they lie about their own middle, the third off it."""
    clouds = [wall(rng, 0.0, -1.5, -0.5), wall(rng, 0.0, -0.5, 0.5), wall(rng, 0.0, 0.5, 1.5)]
    shifts = np.zeros((3, 6, 6))
    shifts[:, 3, 3] = 0.001**2
    where = np.array([[0.0, y, 0.0] for y in (-1.0, 0.0, 1.0)])
    placement = lay_out_placement(clouds, 0.01, block_diag(*shifts), np.zeros((3, 3)))
    vertices = np.concatenate([c.points for c in clouds] + [where])
    sigma = placement_sigma(vertices, placement, vertices[:, 1] < 0.5)[-3:]
    # the line that follows two steps e1 and e2 best rises by 0.75 (e2 - e1) a metre: 1.625 e2 - 0.625 e1 at the third
    assert sigma[:2].max() < 0.5e-3
    assert sigma[2] == pytest.approx(0.001 * np.sqrt(1.0 + 1.625**2 + 0.625**2), rel=0.03)
    assert placement_sigma(vertices, placement)[-1] < 0.6e-3  # about the mean of all: 1 of 6 is left of each


def test_scans_that_share_nothing_are_still_no_better_placed_than_their_targets_say() -> None:
    disagreement = np.array([0.003, np.nan, np.nan, 0.003])
    placed = np.array([0.004, 0.004, 0.0, 0.0])
    assert join_shared(disagreement, placed) == pytest.approx([0.005, 0.004, np.nan, 0.003], nan_ok=True)
