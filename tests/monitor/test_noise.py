"""What stable areas say of the size of errors: too much stated is scaled down, too little gets a floor."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from monitor.comparison.correlation import Correlation, spherical
from monitor.comparison.noise import STATED_WITNESSES, count_witnesses, size_of_errors


def test_witnesses_of_a_variance_are_those_that_its_scatter_shows(rng: np.random.Generator) -> None:
    points = np.column_stack([rng.uniform(0.0, 1.0, (300, 2)), np.zeros(300)])
    correlation = Correlation(np.array([0.6]), np.array([0.4]))
    lag = cdist(points, points)
    rho = np.where(lag > 0.0, 0.6 * spherical(lag / 0.4), 1.0)
    errors = np.linalg.cholesky(rho) @ rng.normal(size=(300, 4000))
    scatter2 = np.var(np.mean(errors**2, axis=0))  # 2 / n of n independent ones
    assert count_witnesses(points, correlation, rng) == pytest.approx(2.0 / scatter2, rel=0.1)  # of means: a quarter


def test_many_witnesses_scale_down_what_is_stated_too_large(rng: np.random.Generator) -> None:
    sigma = rng.uniform(0.001, 0.002, 50_000)
    floor, scale = size_of_errors(0.5 * sigma * rng.normal(size=50_000), sigma, 0.95, 1e6)
    assert floor == 0.0
    assert scale == pytest.approx(0.5, rel=0.02)


def test_few_witnesses_leave_most_of_what_is_stated(rng: np.random.Generator) -> None:
    sigma = np.full(50_000, 0.001)
    _, scale = size_of_errors(0.5 * sigma * rng.normal(size=50_000), sigma, 0.95, STATED_WITNESSES)
    assert scale == pytest.approx(np.sqrt((0.25 + 1.0) / 2.0), rel=0.02)
    assert size_of_errors(0.5 * sigma, sigma, 0.95, 0.0) == (0.0, 1.0)  # the first look knows of none


def test_what_nothing_states_is_a_floor_and_not_a_scale(rng: np.random.Generator) -> None:
    sigma = np.full(50_000, 0.001)
    floor, scale = size_of_errors(np.hypot(0.001, 0.003) * rng.normal(size=50_000), sigma, 0.95, 1e6)
    assert floor == pytest.approx(0.003, rel=0.02)
    assert scale == 1.0
