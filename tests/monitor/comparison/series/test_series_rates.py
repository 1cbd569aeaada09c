"""Rates that are significant, found as change is: few where nothing goes on, and what no single epoch shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom
from simulated_series import SIGMA, START, YEARS, simulate_series, square

from monitor.comparison.detection.detect import detect
from monitor.comparison.noise import patch_errors
from monitor.comparison.noise.patch_errors import NORMAL
from monitor.comparison.series.follow import follow
from monitor.comparison.series.rate_regions import detect_rates, pool_correlations
from monitor.comparison.series.rate_side import Fits, combine_motions, grown_by, make_rate_side
from monitor.comparison.series.trend import fit_polynomial, weights_of_last
from projects.model import Assessment, Floats, Registration


def count_shown(rng: np.random.Generator, n: int, years: Floats) -> int:
    """Return how many of n series of unchanged epochs show a significant rate."""
    shown = (follow(simulate_series(rng, years), "r", START).rate_assessment for _ in range(n))
    return sum(bool((state == Assessment.CHANGED).any()) for state in shown)


def test_unchanged_epochs_seldom_show_a_significant_rate(rng: np.random.Generator) -> None:
    assert count_shown(rng, 20, YEARS[:5]) <= binom.ppf(0.999, 20, 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("years", [YEARS, np.array([1.0, 3.0]), np.array([0.4, 1.9, 2.2, 5.0, 5.5, 9.0])])
def test_unchanged_epochs_show_a_significant_rate_in_five_per_cent_at_most(
    rng: np.random.Generator, years: Floats
) -> None:
    """Correlated noise, and half of the variance of each difference from the reference, common to all epochs."""
    assert count_shown(rng, 100, years) <= binom.ppf(0.999, 100, 0.05)


def test_vertices_by_themselves_would_be_called_significant_all_over(rng: np.random.Generator) -> None:
    series = follow(simulate_series(rng, YEARS), "r", START)
    alone = np.abs(series.rate) > 1.96 * series.sigma_rate
    assert 0.02 < alone.mean() < 0.10  # one in twenty, by chance
    assert (series.rate_assessment == Assessment.UNCHANGED).all()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_slow_rate_is_significant_where_it_is_and_nowhere_else(rng: np.random.Generator, sign: float) -> None:
    """0.1 mm a year for ten years, each vertex of each epoch known to 1 mm (95 %)."""
    moving = square(0.025)
    series = follow(simulate_series(rng, YEARS, sign * 1e-4 * moving), "r", START)
    found = series.rate_assessment == Assessment.CHANGED
    assert found[moving].mean() > 0.8
    assert found[~square(0.033)].mean() < 0.01  # noise at its border hangs together with it
    assert np.sign(series.rate[found]).mean() == pytest.approx(sign, abs=0.02)


def test_what_too_few_epochs_saw_is_not_assessable(rng: np.random.Generator) -> None:
    changes = simulate_series(rng, YEARS[:4])
    for change in changes[1:]:
        change.side.distances[:40], change.side.lod95[:40] = np.nan, np.nan
    series = follow(changes, "r", START)
    np.testing.assert_array_equal(series.rate_assessment == Assessment.NOT_ASSESSABLE, np.arange(3600) < 40)


def fits_of(years: Floats, distances: Floats, sigma: float, own: float) -> Fits:
    sigmas, owns = np.full(distances.shape, sigma), np.full(distances.shape[1], own)
    line, curve = (fit_polynomial(years, distances, sigmas, owns, degree) for degree in (1, 2))
    return Fits(line, curve, years, distances, sigmas, owns)


@pytest.mark.parametrize("degree", [1, 2])
def test_weights_of_the_last_parameter_are_its_derivatives(rng: np.random.Generator, degree: int) -> None:
    years, distances = np.array([0.7, 2.0, 3.1, 7.0]), rng.normal(0.0, 1e-3, (4, 3))
    sigmas, own = rng.uniform(3e-4, 6e-4, (4, 3)), np.full(3, 2e-4)
    fit = fit_polynomial(years, distances, sigmas, own, degree)
    weights = weights_of_last(fit, years, sigmas, own)
    np.testing.assert_allclose((weights * distances).sum(axis=0), fit.parameters[:, -1], rtol=1e-9)
    independent = (weights**2 * (sigmas**2 - own**2)).sum(axis=0) + weights.sum(axis=0) ** 2 * own**2
    np.testing.assert_allclose(independent, fit.covariance[:, -1, -1], rtol=1e-9)


def test_a_steady_rate_leaves_no_trace_in_what_errors_alone_make(rng: np.random.Generator) -> None:
    """Noise is learned from it: a rate that teaches its own level is never found."""
    changes = simulate_series(rng, YEARS)
    distances = np.stack([c.side.distances for c in changes])
    without = make_rate_side(changes, fits_of(YEARS, distances, SIGMA, SIGMA * np.sqrt(0.5)))
    steady = distances + 1e-3 * YEARS[:, None]
    with_it = make_rate_side(changes, fits_of(YEARS, steady, SIGMA, SIGMA * np.sqrt(0.5)))
    np.testing.assert_allclose(with_it.still.distances, without.still.distances, atol=1e-12)
    np.testing.assert_allclose(with_it.side.distances - without.side.distances, 1e-3 * YEARS[-1], rtol=1e-9)
    scatter = np.std(without.still.distances) / np.median(np.hypot(without.side.sigma_surfaces,
                                                                   without.side.sigma_common))  # fmt: skip
    assert scatter == pytest.approx(1.0, abs=0.15)  # some 250 witnesses: 0.06, one sigma


def test_how_errors_agree_is_learned_from_all_that_departs_from_a_line(rng: np.random.Generator) -> None:
    """One sum of the errors alone says it to a factor: a few witnesses may agree by chance, and far regions follow."""
    areas = []
    for _ in range(6):
        changes = simulate_series(rng, YEARS)
        distances = np.stack([c.side.distances for c in changes])
        rates = make_rate_side(changes, fits_of(YEARS, distances, SIGMA, SIGMA * np.sqrt(0.5)))
        assert rates.further.shape == (3, 3600)
        assert np.abs(np.corrcoef(np.vstack([rates.still.distances, rates.further])) - np.eye(4)).max() < 0.25
        np.testing.assert_allclose(np.std(rates.further, axis=1), 1.0, atol=0.15)
        learned = detect((rates.still, rates.still), rates.motion, 0.05, 0)
        areas.append((learned.noise.correlation.area, pool_correlations(rates, learned, 0).area))
    one, all_together = np.std(np.log(areas), axis=0)
    assert all_together < 0.7 * one


@pytest.mark.parametrize("states_noise", [False, True])
def test_rates_of_finished_meshes_are_held_against_their_tails(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, states_noise: bool
) -> None:
    """Blocks of 6 x 6 vertices err by more or less than others, in all epochs."""
    monkeypatch.setattr(patch_errors, "FEWEST_OF_TAILS", 50)
    changes = simulate_series(rng, YEARS)
    uneven = np.kron(np.exp(rng.normal(0.0, 0.8, (10, 10))), np.ones((6, 6))).ravel()
    distances = np.stack([c.side.distances for c in changes]) * uneven
    rates = make_rate_side(changes, fits_of(YEARS, distances, SIGMA, SIGMA * np.sqrt(0.5)))
    if states_noise:
        known = replace(rates.side.surface, sigma=np.full(3600, SIGMA))
        sides = (replace(s, surface=known, other=known) for s in (rates.side, rates.still))
        rates = replace(rates, **dict(zip(("side", "still"), sides, strict=True)))
    dofs = detect_rates(rates, 0.05, 0).test.errors[0].dofs
    assert (dofs == NORMAL).all() == states_noise
    assert (dofs < 10.0).all() == (not states_noise)


def test_registrations_add_up_by_squares_and_the_reference_s_part_by_their_sum() -> None:
    motions = [Registration(np.eye(4), np.diag([0.0] * 3 + [s**2] * 3), np.zeros(3), True) for s in (1e-4, 1e-4)]
    weights = np.array([0.8, -0.5])
    independent = combine_motions(motions, weights, 0.0).covariance[5, 5]
    common = combine_motions(motions, weights, 1.0).covariance[5, 5]
    assert independent == pytest.approx(1e-8 * (0.64 + 0.25), rel=1e-12)
    assert common == pytest.approx(1e-8 * 0.3**2, rel=1e-12)


def test_a_turn_about_another_centre_shifts_this_one() -> None:
    turn = np.diag([0.0, 0.0, 1e-8, 0.0, 0.0, 0.0])
    motions = [Registration(np.eye(4), 0.0 * turn, np.zeros(3), True),
               Registration(np.eye(4), turn, np.array([2.0, 0.0, 0.0]), True)]  # fmt: skip
    combined = combine_motions(motions, np.array([0.0, 1.0]), 0.0)
    assert combined.covariance[4, 4] == pytest.approx(4.0 * 1e-8, rel=1e-12)  # 2 m off: y moves by 2 w


def test_fewer_epochs_leave_more_of_the_registrations() -> None:
    weights = np.array([[0.5, 1.0], [0.5, 0.0]])
    np.testing.assert_allclose(grown_by(weights, np.array([0.5, 0.5]), np.zeros(2)), [0.0, 1.0])
    np.testing.assert_allclose(grown_by(weights, np.array([0.5, 0.5]), np.ones(2)), [0.0, 0.0])
