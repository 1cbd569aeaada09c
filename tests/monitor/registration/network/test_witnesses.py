"""Pairs of scans weigh as well as their own patches agree, beside targets of stated covariance."""

import dataclasses

import numpy as np
import pytest

from monitor.registration.motion.matching import Matches
from monitor.registration.network.equations import Pairs, Scales, TieScales, pair_equations, solve_network
from monitor.registration.network.network_covariance import network_covariance
from monitor.registration.network.ties import no_ties
from monitor.registration.network.witnesses import count_sharers, pair_factors

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
    return Matches(number, points, residuals, up, up, up, none, none, number, none, none, none, none)


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


def test_m_scans_of_one_patch_are_m_less_one_witnesses_not_all_their_pairs(rng: np.random.Generator) -> None:
    shared, of_two = matches_of(rng, 60, 0.001, 1e-5), matches_of(rng, 60, 0.001, 1e-5)
    of_two = dataclasses.replace(of_two, points=of_two.points + np.array([0.0, 50 * PATCH, 0.0]))
    three = [(i, j) for i in range(3) for j in range(3) if i != j]
    pairs: Pairs = {**dict.fromkeys(three, shared), (3, 4): of_two, (4, 3): of_two}
    sharers = count_sharers(pairs, [np.eye(4)] * 5, PATCH)
    assert sharers == pytest.approx({**dict.fromkeys(three, 3.0), (3, 4): 2.0, (4, 3): 2.0})
    weighed = dataclasses.replace(scales(), pair_sharers=sharers)
    n_witnesses = {key: weighed.witness_share(key, m.points) * len(m) for key, m in pairs.items()}
    assert sum(n_witnesses[key] for key in three) == pytest.approx(2 * 60)
    assert n_witnesses[3, 4] + n_witnesses[4, 3] == pytest.approx(60)


def test_a_pair_that_shares_some_patches_with_others_counts_each_by_its_own_scans(rng: np.random.Generator) -> None:
    pair = matches_of(rng, 60, 0.001, 1e-5)
    third = pair.take(pair.points[:, 0] < 30 * PATCH)
    sharers = count_sharers({(0, 1): pair, (0, 2): third}, [np.eye(4)] * 3, PATCH)
    assert sharers[0, 2] == pytest.approx(3.0)
    assert 1.0 / sharers[0, 1] == pytest.approx(0.5 * (1 / 3 + 1 / 2), rel=0.02)


def test_blocks_joined_by_a_bad_pair_are_as_uncertain_as_that_pair_shows(rng: np.random.Generator) -> None:
    bump = rng.normal(0.0, 1.0, (400 * 20, 3))  # all motions are held
    normals = bump / np.linalg.norm(bump, axis=1, keepdims=True)

    def bumpy(n_patches: int, of_patch: float) -> Matches:
        m = matches_of(rng, n_patches, of_patch, 1e-5)
        return dataclasses.replace(
            m, **dict.fromkeys(("normals", "normals_source", "normals_target"), normals[: len(m)])
        )

    def sigma_apart(pairs: Pairs, n: int, one: int, other: int) -> float:
        motions = [np.eye(4)] * n
        held = dataclasses.replace(scales(), prior=np.full(2, 1.0))
        held = dataclasses.replace(held, pair_factors=pair_factors(pairs, motions, held))
        equations = pair_equations(pairs, motions, held)
        solution = solve_network(equations, no_ties(), np.empty((0, 3)), motions, (held, TieScales()))
        covariance = network_covariance(pairs, motions, held, solution, is_absolute=True)
        apart = np.zeros((6, 6 * n))
        apart[:, 6 * one : 6 * one + 6], apart[:, 6 * other : 6 * other + 6] = np.eye(6), -np.eye(6)
        return float(np.sqrt(np.trace((apart @ covariance @ apart.T)[3:, 3:])))

    bad = bumpy(40, 0.0025)
    alone = sigma_apart({(0, 1): bad}, 2, 0, 1)
    joined = sigma_apart({(0, 1): bumpy(400, 0.0005), (1, 2): bad, (2, 3): bumpy(400, 0.0005)}, 4, 1, 2)
    # one scatter for all pairs would say a quarter of it
    assert joined == pytest.approx(alone, rel=0.35)


def test_what_only_badly_fitting_places_hold_is_held_by_as_little_as_they_pull(rng: np.random.Generator) -> None:
    wall = matches_of(rng, 200, 0.0, 0.0)
    edge = np.arange(len(wall)) % 10 == 0  # a tenth looks along x and fits three times worse
    normals = np.where(edge[:, None], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    residuals = rng.normal(0.0, np.where(edge, 3.0 * SIGMA, SIGMA))
    pair = dataclasses.replace(
        wall, residuals=residuals, **dict.fromkeys(("normals", "normals_source", "normals_target"), normals)
    )
    held = dataclasses.replace(scales(), prior=np.full(2, 0.01))
    motions, pairs = [np.eye(4)] * 2, {(0, 1): pair}
    solution = solve_network(
        pair_equations(pairs, motions, held), no_ties(), np.empty((0, 3)), motions, (held, TieScales())
    )
    covariance = network_covariance(pairs, motions, held, solution, is_absolute=True)
    apart = np.hstack([np.eye(6), -np.eye(6)])
    sigma = np.sqrt(np.diag(apart @ covariance @ apart.T))[3:]
    # a tenth as many alone: 3.2 times; there psi pulls back with 0.15 of what it does on the wall, and scatters more
    assert sigma[0] > 5.0 * sigma[2]
