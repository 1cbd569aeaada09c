"""How errors agree along a surface, estimated from one field, against fields whose correlation is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from monitor.comparison.noise.correlation import (
    Correlation,
    estimate_correlation,
    estimate_of_many,
    kept_variance,
    spherical,
)
from monitor.comparison.noise.pairs import draw_evenly, pair_within

REACH = 0.02  # m, of the discs that the field's points are means over


def average_over_discs(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return n random places in a square of 0.5 m and unit noise averaged over discs about them, as fits average.

    The noise is that of 20 000 places of its own, 100 in a disc.
    """
    points = np.column_stack([rng.uniform(0.0, 0.5, (n, 2)), np.zeros(n)])
    measured = np.column_stack([rng.uniform(0.0, 0.5, (20_000, 2)), np.zeros(20_000)])
    near = cKDTree(points).sparse_distance_matrix(cKDTree(measured), REACH, output_type="coo_matrix").tocsr()
    near.data[:] = 1.0
    field = near @ rng.normal(size=len(measured)) / np.sqrt(np.asarray(near.sum(axis=1)).ravel())
    return points, field


def overlap(lag: np.ndarray) -> np.ndarray:
    """Return the share that two discs have in common, their centres `lag` apart: the correlation of that field."""
    u = np.minimum(lag / (2.0 * REACH), 1.0)
    return 2.0 / np.pi * (np.arccos(u) - u * np.sqrt(1.0 - u * u))


def test_spherical_model_is_matherons() -> None:
    np.testing.assert_allclose(spherical(np.array([0.0, 0.5, 1.0, 3.0])), [1.0, 0.3125, 0.0, 0.0])


def test_correlation_of_a_field_is_found(rng: np.random.Generator) -> None:
    lags, found = np.array([0.03, 0.1]), []
    for _ in range(6):
        points = rng.uniform(0, 1, (1000, 3)) * [1, 1, 0]
        lag = np.linalg.norm(points[:, None] - points[None], axis=-1)
        field = np.linalg.cholesky(0.7 * np.exp(-lag / 0.05) + 0.3 * np.eye(1000)) @ rng.normal(size=1000)
        found.append(estimate_correlation(points, field, np.full(1000, 1e-3), rng).at(lags))
    # one field scatters by 0.05, the mean of six by 0.02
    np.testing.assert_allclose(np.mean(found, axis=0), 0.7 * np.exp(-lags / 0.05), atol=0.06)


def test_fits_that_share_no_point_do_not_agree(rng: np.random.Generator) -> None:
    n, lags = 20_000, np.array([0.01, 0.02, 0.03, 0.05, 0.08])
    found = []
    for _ in range(6):
        points, field = average_over_discs(rng, n)
        found.append(estimate_correlation(points, field, np.full(n, 0.25 / n), rng))
    np.testing.assert_allclose(np.mean([c.at(lags) for c in found], axis=0), overlap(lags), atol=0.05)
    radius = np.array([0.03, 0.06])  # of patches
    places = np.linspace(0.0, 2.0, 2001)[1:] * radius[:, None]
    u = places / (2.0 * radius[:, None])
    density = u * (np.arccos(u) - u * np.sqrt(1.0 - u * u))  # of two points of a disc, by their distance
    truth = (overlap(places) * density).sum(axis=1) / density.sum(axis=1)
    kept = np.mean([kept_variance(np.pi * radius**2, np.full(2, n), c) for c in found], axis=0)
    np.testing.assert_allclose(kept, truth, rtol=0.15)  # exponential models keep a quarter and more too much


def test_mean_over_a_patch_keeps_what_its_correlation_leaves(rng: np.random.Generator) -> None:
    correlation = Correlation(np.array([0.8]), np.array([0.03]))
    n, radius = 400, 0.02
    angle = rng.uniform(0, 2 * np.pi, n)
    points = radius * np.sqrt(rng.uniform(size=n))[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    lag = np.linalg.norm(points[:, None] - points[None], axis=-1)
    by_hand = np.mean(np.where(lag > 0, 0.8 * spherical(lag / 0.03), 1.0))
    kept = kept_variance(np.array([np.pi * radius**2]), np.array([n]), correlation)
    assert kept[0] == pytest.approx(by_hand, rel=0.03)
    h = np.linspace(0.0, 0.03, 3001)
    assert correlation.area == pytest.approx(np.trapezoid(2 * np.pi * h * correlation.at(h), h), rel=1e-3)


@pytest.mark.parametrize("reach", [0.02, 0.2, 3.0], ids=["few", "some", "all"])
def test_pairs_are_all_within_reach_of_each_other(rng: np.random.Generator, reach: float) -> None:
    points = rng.normal(size=(3000, 3))
    samples, drawn = np.arange(0, 3000, 60), np.arange(0, 3000, 3)  # each third sample is drawn itself
    found = pair_within(points, samples, drawn, reach)
    lag = np.linalg.norm(points[drawn][:, None] - points[samples], axis=2)
    at, sample = np.nonzero((lag <= reach) & (drawn[:, None] != samples))
    assert found.second.tolist() == drawn[at].tolist()
    order = np.lexsort([found.first, found.second])
    assert found.first[order].tolist() == samples[sample].tolist()
    np.testing.assert_allclose(found.lags[order], lag[at, sample], rtol=1e-12)


@pytest.mark.parametrize("k", [0, 1, 7, 30, 31])
def test_one_of_each_run_is_drawn(rng: np.random.Generator, k: int) -> None:
    drawn = np.array([draw_evenly(31, k, rng) for _ in range(400)])
    first = np.arange(k + 1) * 31 // max(k, 1)
    for run in range(k):
        assert set(drawn[:, run]) == set(range(first[run], first[run + 1]))


def test_of_many_only_those_in_pairs_are_asked_and_show_the_same(rng: np.random.Generator) -> None:
    n, lags = 100_000, np.array([0.01, 0.02, 0.03, 0.05, 0.08])
    found, asked = [], []
    for _ in range(4):
        points, field = average_over_discs(rng, n)
        field[:2000] = 50.0  # a change does not speak for the noise

        def errors_of(which: np.ndarray, field: np.ndarray = field) -> np.ndarray:
            asked.append(len(which) / n)
            return field[which]

        found.append(estimate_of_many(points, np.arange(n), np.full(n, 0.25 / n), errors_of, rng))
    np.testing.assert_allclose(np.mean([c.at(lags) for c in found], axis=0), overlap(lags), atol=0.05)
    assert max(asked) < 0.95


def test_many_errors_that_are_all_zero_have_no_correlation(rng: np.random.Generator) -> None:
    points = rng.uniform(0.0, 1.0, (5000, 3))
    found = estimate_of_many(points, np.arange(5000), np.full(5000, 1e-3), lambda which: np.zeros(len(which)), rng)
    assert not found.sills.any()
