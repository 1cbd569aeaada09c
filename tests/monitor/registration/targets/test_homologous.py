"""Points are told to be the same by invariants alone: any rotation, no names, wrong and missing ones among them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from monitor.registration.motion.six_parameters import six_parameters
from monitor.registration.targets.homologous import match_points, verify_pairs
from projects.errors import RegistrationError
from projects.transforms import apply

SIGMA = 0.001


def turned(points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return the points under a random motion, and that motion T_target_source."""
    T = np.eye(4)
    T[:3, :3] = Rotation.random(rng=rng).as_matrix()
    T[:3, 3] = rng.normal(scale=30.0, size=3)
    return apply(T, points), T


def test_points_are_matched_among_wrong_and_missing_ones(rng: np.random.Generator) -> None:
    for _ in range(20):
        shared = rng.uniform([-10, -10, 0], [10, 10, 3], (7, 3))
        moved, T = turned(shared, rng)
        wrong_source, wrong_target = (rng.uniform(-10, 10, (k, 3)) for k in (4, 5))
        source = np.concatenate([shared, wrong_source]) + rng.normal(0, SIGMA, (11, 3))
        target = np.concatenate([moved, apply(T, wrong_target)]) + rng.normal(0, SIGMA, (12, 3))
        order = rng.permutation(len(target))
        pairs = match_points(source, target[order], SIGMA, SIGMA)
        assert dict(zip(pairs.source.tolist(), order[pairs.target].tolist(), strict=True)) == {k: k for k in range(7)}
        assert np.abs(apply(pairs.T_target_source, shared) - moved).max() < 5 * SIGMA


def test_forty_points_of_which_half_are_wrong_are_matched(rng: np.random.Generator) -> None:
    shared = rng.uniform([-20, -5, 0], [20, 5, 8], (20, 3))
    moved, _ = turned(shared, rng)
    source = np.concatenate([shared, rng.uniform(-20, 20, (20, 3))]) + rng.normal(0, SIGMA, (40, 3))
    target = np.concatenate([moved, moved.mean(axis=0) + rng.uniform(-20, 20, (20, 3))])
    pairs = match_points(source, target + rng.normal(0, SIGMA, (40, 3)), SIGMA, SIGMA)
    assert np.array_equal(pairs.source, pairs.target)
    assert len(pairs) == 20


def test_square_of_targets_is_refused_as_ambiguous() -> None:
    square = np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0.0]])
    with pytest.raises(RegistrationError, match="ambiguous"):
        match_points(square, square, SIGMA, SIGMA)


def test_square_with_one_targets_aside_is_still_ambiguous_if_only_that_one_tells() -> None:
    points = np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0], [1, 0.3, 0.0]])
    with pytest.raises(RegistrationError, match="ambiguous"):
        match_points(points, points, SIGMA, SIGMA)


def test_mirrored_arrangement_is_not_matched(rng: np.random.Generator) -> None:
    points = rng.uniform(-5, 5, (4, 3))
    with pytest.raises(RegistrationError):
        match_points(points, points * [1.0, 1.0, -1.0], SIGMA, SIGMA)


@pytest.mark.parametrize(("n_flat", "n_aside", "agree"), [(0, 5, "5 of 5"), (0, 8, "8 of 8"), (5, 2, "7 of 7")])
def test_mirrored_arrangement_is_said_to_be_mirrored(
    rng: np.random.Generator, n_flat: int, n_aside: int, agree: str
) -> None:
    """Any three points and their mirror image agree: that was told as an ambiguous arrangement; and five on a floor
    agree upside down, which was taken for the motion."""
    flat = rng.uniform([-8, -5, 0], [8, 5, 0], (n_flat, 3))
    points = np.concatenate([flat, rng.uniform([-8, -5, 1], [8, 5, 4], (n_aside, 3))])
    exchanged, _ = turned(points[:, [1, 0, 2]], rng)  # northings before eastings
    with pytest.raises(RegistrationError, match=f"mirrored: {agree} "):
        match_points(points, exchanged + rng.normal(0, SIGMA, points.shape), SIGMA, SIGMA)


def test_what_is_its_own_mirror_image_is_not_called_mirrored(rng: np.random.Generator) -> None:
    """Targets on a floor, and one seen from each side alone."""
    floor = rng.uniform([-8, -5, 0], [8, 5, 0], (6, 3))
    source, target = (np.vstack([floor, rng.uniform([-8, -5, 1], [8, 5, 4])]) for _ in range(2))
    pairs = match_points(source, target + rng.normal(0, SIGMA, target.shape), SIGMA, SIGMA)
    assert pairs.source.tolist() == pairs.target.tolist() == list(range(6))


def test_points_on_a_line_are_refused() -> None:
    line = np.array([0.0, 1.0, 3.5, 7.2, 11.1])[:, None] * [1.0, 0.5, 0.2]
    with pytest.raises(RegistrationError, match="line"):
        match_points(line, line, SIGMA, SIGMA)


def test_few_points_of_poor_sigma_are_refused_as_chance(rng: np.random.Generator) -> None:
    source, target = rng.uniform(-3, 3, (15, 3)), rng.uniform(-3, 3, (15, 3))
    with pytest.raises(RegistrationError, match=r"chance|ambiguous"):
        match_points(source, target, 0.05, 0.05)


def test_wrong_pair_is_dropped_by_invariants(rng: np.random.Generator) -> None:
    source = rng.uniform(-5, 5, (8, 3))
    target, _ = turned(source, rng)
    target = target + rng.normal(0, SIGMA, (8, 3))
    target[5] += [0.012, -0.006, 0.004]
    accepted = verify_pairs(source, target, 0.0, SIGMA)
    assert np.flatnonzero(~accepted).tolist() == [5]


def test_two_points_are_too_few() -> None:
    with pytest.raises(RegistrationError, match="three or more"):
        match_points(np.zeros((2, 3)), np.ones((5, 3)))


def test_covariance_of_six_parameters_holds_the_truth(rng: np.random.Generator) -> None:
    points = rng.uniform([-5, -5, 0], [5, 5, 2], (6, 3))
    shape = np.diag([4.0, 1.0, 0.25]) * SIGMA**2
    inside = []
    for _ in range(400):
        target, T = turned(points, rng)
        noise_source = rng.multivariate_normal(np.zeros(3), shape, 6)
        found = six_parameters(
            points + noise_source,
            target + rng.normal(0, SIGMA, (6, 3)),
            np.tile(shape, (6, 1, 1)),
            np.tile(np.eye(3) * SIGMA**2, (6, 1, 1)),
        )
        error = found.T_target_source @ np.linalg.inv(T)
        w = Rotation.from_matrix(error[:3, :3]).as_rotvec()
        t = apply(error, found.centre) - found.centre
        e = np.concatenate([w, t])
        inside.append(e @ np.linalg.solve(found.covariance, e) < chi2.ppf(0.95, 6))
    assert 0.93 <= np.mean(inside) <= 0.995  # sigma0 raises only: binomial 95 % of 400 is 0.928 to 0.97, and above


def test_motion_is_exact_on_exact_points_and_has_the_direction_of_its_name(rng: np.random.Generator) -> None:
    points = rng.uniform(-5, 5, (5, 3))
    target, T = turned(points, rng)
    found = six_parameters(points, target)
    assert np.abs(found.T_target_source - T).max() < 1e-12 * 100
    assert np.abs(found.residuals).max() < 1e-12 * 100
