"""Pairs of scans weigh as well as their own patches agree, beside targets of stated covariance."""

import numpy as np
import pytest

from monitor.registration.matching import Matches
from monitor.registration.network import Pairs, Scales
from monitor.registration.witnesses import pair_factors

SIGMA, PATCH = 0.001, 0.1


def scales() -> Scales:
    return Scales(SIGMA, np.full(2, 0.01), 1.0, PATCH, True)


def matches_of(rng: np.random.Generator, n_patches: int, of_patch: float, of_point: float, each: int = 20) -> Matches:
    """Return matches over a row of patches whose means err by `of_patch` [m] and points by `of_point` [m]."""
    n = n_patches * each
    x = np.repeat(np.arange(n_patches), each) * PATCH + rng.uniform(0.02, 0.08, n)
    points = np.column_stack([x, rng.uniform(0.0, 0.09, n), np.zeros(n)])
    points[0] = 0.0  # cubes are counted from the least corner
    up = np.tile([0.0, 0.0, 1.0], (n, 1))
    residuals = np.repeat(rng.normal(0.0, of_patch, n_patches), each) + rng.normal(0.0, of_point, n)
    number, none = np.arange(n), np.zeros(n)
    return Matches(number, points, residuals, up, up, up, none, none, number, none)


def test_a_pair_whose_patches_err_three_times_as_much_weighs_a_ninth(rng: np.random.Generator) -> None:
    pairs: Pairs = {(0, 1): matches_of(rng, 400, 0.0005, 1e-5), (1, 2): matches_of(rng, 400, 0.0015, 1e-5)}
    factors = pair_factors(pairs, [np.eye(4)] * 3, scales())
    # the robust variance of 400 patches is known to 12 %
    assert factors[0, 1] == pytest.approx(0.25, rel=0.3)
    assert factors[1, 2] == pytest.approx(2.25, rel=0.3)


def test_both_ways_of_a_pair_weigh_alike(rng: np.random.Generator) -> None:
    pairs: Pairs = {(0, 1): matches_of(rng, 50, 0.001, 1e-5), (1, 0): matches_of(rng, 30, 0.0005, 1e-5)}
    factors = pair_factors(pairs, [np.eye(4)] * 2, scales())
    assert factors[0, 1] == factors[1, 0]


def test_a_pair_of_few_patches_is_believed_little(rng: np.random.Generator) -> None:
    many, one = matches_of(rng, 400, 0.001, 1e-5), matches_of(rng, 1, 0.0, 1e-6)
    factors = pair_factors({(0, 1): many, (1, 2): one}, [np.eye(4)] * 3, scales())
    assert 0.8 * 0.8 < factors[1, 2] < 1.2  # four fifths of what all show


def test_independent_noise_of_points_is_no_error_of_patches(rng: np.random.Generator) -> None:
    factors = pair_factors({(0, 1): matches_of(rng, 300, 0.0, SIGMA)}, [np.eye(4)] * 2, scales())
    assert factors[0, 1] == pytest.approx(1.0 / 20.0, rel=0.3)  # of twenty points each
