"""What stable areas say of the size of errors: what is stated is scaled, in each stratum; what is not gets a floor."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from monitor.comparison.correlation import Correlation, spherical
from monitor.comparison.noise import N_STRATA, CalmVertices, asked_scale, believe, count_witnesses, learn_sizes
from projects.model import Floats, Ints


def test_witnesses_of_a_variance_are_those_that_its_scatter_shows(rng: np.random.Generator) -> None:
    points = np.column_stack([rng.uniform(0.0, 1.0, (300, 2)), np.zeros(300)])
    correlation = Correlation(np.array([0.6]), np.array([0.4]))
    lag = cdist(points, points)
    rho = np.where(lag > 0.0, 0.6 * spherical(lag / 0.4), 1.0)
    errors = np.linalg.cholesky(rho) @ rng.normal(size=(300, 4000))
    scatter2 = np.var(np.mean(errors**2, axis=0))  # 2 / n of n independent ones
    assert count_witnesses(points, np.arange(300), correlation, rng) == pytest.approx(
        2.0 / scatter2, rel=0.1
    )  # of means: a quarter


def asked_of(distances: Floats, own: Floats, motion: Floats) -> float:
    """Return the scale that vertices of one stratum ask for."""
    calm = CalmVertices(np.zeros((0, 3)), np.zeros(0, dtype=int), distances, own, motion, np.full(len(own), 3))
    return asked_scale([calm], np.array([3]), np.ones(N_STRATA), 0.95)


def test_the_registration_stays_as_stated_while_the_rest_is_scaled(rng: np.random.Generator) -> None:
    own, motion = rng.uniform(0.001, 0.002, 50_000), np.full(50_000, 0.0006)
    distances = np.hypot(0.5 * own, motion) * rng.normal(size=50_000)
    assert asked_of(distances, own, motion) == pytest.approx(0.5, rel=0.02)  # 0.6 if both are scaled


def test_the_registration_makes_up_for_half_of_what_is_seen_at_most(rng: np.random.Generator) -> None:
    own, motion = np.full(50_000, 0.001), np.full(50_000, 0.002)
    distances = 0.1 * np.hypot(own, motion) * rng.normal(size=50_000)  # the motion was fitted to them
    assert asked_of(distances, own, motion) == pytest.approx(0.1 * np.sqrt(0.5), rel=0.02)


def test_two_witnesses_are_believed_half() -> None:
    assert believe(0.25, 2.0) == pytest.approx(0.5)  # half of the logarithm
    assert believe(0.25, 1e6) == pytest.approx(0.25, rel=1e-4)
    assert believe(4.0, 2.0) == pytest.approx(2.0)


def calm_of(rng: np.random.Generator, true: Floats, stratum: Ints, motion: float = 0.0) -> CalmVertices:
    """Return vertices far from each other, stated as 1 mm, whose errors are `true` [mm] in their stratum."""
    n = len(stratum)
    distances = 1e-3 * np.hypot(true[stratum], motion) * rng.normal(size=n)
    points = np.column_stack([np.arange(n), np.zeros((n, 2))])
    return CalmVertices(points, np.arange(n), distances, np.full(n, 1e-3), np.full(n, 1e-3 * motion), stratum)


NO_AGREEMENT = Correlation(np.array([0.5]), np.array([0.1]))


def test_each_class_exceeds_its_level_in_one_vertex_of_twenty(rng: np.random.Generator) -> None:
    true = 0.6 * np.tile([0.9, 1.0, 1.6], N_STRATA // 3)  # rough places err more beside what is stated of them
    stratum = np.repeat(np.arange(12, 15), (4000, 2000, 40))
    calm = [calm_of(rng, true, stratum, 0.2) for _ in range(2)]
    floors, scales = learn_sizes(calm, 0.95, NO_AGREEMENT, rng)
    assert scales[12:14] == pytest.approx(true[12:14], rel=0.05)
    assert scales[14] == pytest.approx(true[14], rel=0.35)  # of 80, whose quantile is known to a tenth
    assert not floors.any()
    level = 1.96 * np.hypot(scales[stratum] * 1e-3, 0.2e-3)
    beyond = np.mean([np.abs(c.distances) > level for c in calm], axis=0)
    assert beyond.mean() == pytest.approx(0.05, abs=0.001)
    assert [beyond[stratum == k].mean() for k in (12, 13)] == pytest.approx([0.05, 0.05], abs=0.003)
    assert beyond[stratum == 14].mean() == pytest.approx(0.05, abs=0.02)  # 0.25 with the scale of all


def test_a_stratum_of_few_witnesses_goes_with_its_class(rng: np.random.Generator) -> None:
    true = np.ones(N_STRATA)
    true[[2, 14]] = 2.0
    stratum = np.r_[np.repeat([12, 14], (3000, 1000)), 2, 2, 2, 2]
    _, scales = learn_sizes([calm_of(rng, true, stratum)] * 2, 0.95, NO_AGREEMENT, rng)
    assert scales[2] == pytest.approx(scales[14], rel=0.01)
    assert scales[14] / scales[12] == pytest.approx(2.0, rel=0.1)


def test_the_first_look_that_knows_of_no_witness_takes_what_is_stated(rng: np.random.Generator) -> None:
    calm = [calm_of(rng, np.full(N_STRATA, 0.5), np.full(5000, 12))] * 2
    floors, scales = learn_sizes(calm, 0.6827, None, rng)
    assert not floors.any()
    assert (scales == 1.0).all()


def test_what_nothing_states_is_a_floor_and_not_a_scale(rng: np.random.Generator) -> None:
    calm = [calm_of(rng, np.full(N_STRATA, np.hypot(1.0, 3.0)), np.full(50_000, 12))] * 2
    floors, scales = learn_sizes(calm, 0.95, NO_AGREEMENT, rng)
    assert floors[12] == pytest.approx(0.003, rel=0.02)
    assert scales[12] == pytest.approx(1.0, rel=1e-6)
