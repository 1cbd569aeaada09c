"""Fits of courses against closed forms and a scan written out; what is told beside a rival and what is not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from monitor.comparison.series.follow import forecast_rows
from monitor.comparison.series.footprints import Footprint
from monitor.comparison.series.identity import Followed
from monitor.comparison.series.kinds_of_course import (
    Candidate,
    chi2_of_exponential,
    choose_kind,
    fits,
    hinges,
    leave,
    parabola,
    summarize,
)
from monitor.comparison.series.trend import fit_course
from projects.model import Floats

TIMES = np.array([0.0, 0.7, 1.5, 2.1, 3.4, 4.0, 5.2])
SIGMA = np.array([0.8, 1.0, 1.2, 0.9, 1.0, 1.1, 1.0]) * 1e-4


def best_hinge(values: Floats) -> tuple[float, float]:
    """Return the least chi-square of a line that starts at any moment up to the last epoch but one, and that moment."""
    moments = np.linspace(0.0, TIMES[-2], 5201)
    left = [leave([np.ones(7), np.maximum(TIMES - m, 0.0)], values, SIGMA)[0] for m in moments]
    return min(left), float(moments[int(np.argmin(left))])


@pytest.mark.parametrize("seed", range(6))
def test_the_best_line_that_starts_late_is_that_of_a_scan_over_moments(seed: int) -> None:
    noise = np.random.default_rng(seed).normal(0.0, SIGMA)
    values = -1e-3 * np.maximum(TIMES - 1.9, 0.0) + noise
    expected, moment = best_hinge(values)
    left, between = min(hinges(TIMES, values, SIGMA))
    assert left == pytest.approx(
        expected, rel=1e-4
    )  # the scan's step is 1 mm/year times 0.001 years, a hundredth sigma
    assert between[0] - 1e-3 <= moment <= between[1] + 1e-3


def test_a_stop_is_a_start_with_time_turned_round() -> None:
    values = -1e-3 * np.minimum(TIMES, 2.6)
    choice = choose_kind(TIMES, values, SIGMA)
    assert (choice.kinds, choice.between) == (("stopped",), (2.1, 3.4))
    turned = choose_kind(TIMES[-1] - TIMES[::-1], values[::-1], SIGMA[::-1])
    assert turned.kinds == ("onset",)
    np.testing.assert_allclose(turned.between, (TIMES[-1] - 3.4, TIMES[-1] - 2.1), atol=1e-12)


def test_a_parabola_that_turns_back_is_fitted_by_one_that_stands_still_at_an_end() -> None:
    left, n_fitted = parabola(TIMES, 1e-4 * (TIMES**2 + 0.5 * TIMES), SIGMA)
    assert (round(left, 9), n_fitted) == (0.0, 3)
    values = 1e-3 * (TIMES - 1.0) ** 2
    left, n_fitted = parabola(TIMES, values, SIGMA)
    at_rest_first = leave([np.ones(7), TIMES**2], values, SIGMA)[0]
    assert n_fitted == 2
    assert left == pytest.approx(at_rest_first)  # at rest in the end is far worse
    assert left > 100.0


@pytest.mark.parametrize("span", [1.1, 2.0, 5.0, -1.1, -3.0])
def test_growth_and_decay_are_found_exactly(span: float) -> None:
    values = 2e-3 * (np.exp(TIMES / span) - 1.0) / (np.exp(TIMES[-1] / span) - 1.0)
    assert chi2_of_exponential(TIMES, values, SIGMA) < 1e-3


def test_a_candidate_fits_if_chance_leaves_as_much_in_one_of_a_hundred() -> None:
    assert fits(Candidate("jump", 11.3, 2, 3), 5)  # chi-square of 3: 11.345 at 1 %
    assert not fits(Candidate("jump", 11.4, 2, 3), 5)
    assert fits(Candidate("onset", 0.0, 3, 4), 3)


def test_rivals_are_named_up_to_twenty_times_less_likely_and_no_date_is_given_that_only_one_has() -> None:
    onset = Candidate("onset", 1.0, 3, 4, (1.0, 2.0))  # 9.0
    near, far = (Candidate("accelerating", c, 3, 3) for c in (8.9, 9.1))  # 14.9 and 15.1; 2 ln 20 = 5.99
    both = summarize([onset, near])
    assert both.kinds == ("accelerating", "onset")
    assert np.isnan(both.between).all()
    alone = summarize([onset, far])
    assert (alone.kinds, alone.between) == (("onset",), (1.0, 2.0))


def test_a_date_is_as_wide_as_the_moments_that_are_not_told_apart() -> None:
    jumps = [Candidate("jump", left, 2, 3, (t, t + 1.0)) for t, left in ((0.0, 9.0), (1.0, 1.0), (2.0, 3.0))]
    assert summarize(jumps).between == (1.0, 3.0)


def test_one_odd_epoch_at_the_end_of_a_steady_course_is_no_jump() -> None:
    values = -1e-3 * TIMES
    values[-1] += 2e-3
    assert choose_kind(TIMES, values, SIGMA).kinds == ()
    values[-2] += 2e-3
    choice = choose_kind(TIMES, values, SIGMA)
    assert (choice.kinds, choice.between) == (("jump and rate",), (3.4, 4.0))


def footprint(means: Floats, sigma: float, own: float) -> Footprint:
    k = len(means)
    sigmas = np.full(k, sigma)
    return Footprint(1e-2, np.zeros(3), means, sigmas, own, 1e-2 * np.column_stack([means, sigmas]), 1e-2 * own)


def test_what_slows_down_or_merged_is_not_forecast() -> None:
    """The parabola of a loss that comes to rest turns back: the stone would grow again."""
    years, followed = np.arange(1.0, 6.0), Followed(1, -1.0, np.ones(3, dtype=bool), np.ones(3, dtype=bool))
    slower = footprint(-3e-3 * (1.0 - np.exp(-years / 2.5)), 5e-5, 2e-5)
    course = dataclasses.replace(slower.course(years, 0), model="accelerating")
    assert course.rate < 0.0 < course.acceleration
    assert forecast_rows(followed, slower, course, years) == []
    faster = footprint(-2e-4 * years**2, 5e-5, 2e-5)
    course = dataclasses.replace(faster.course(years, 0), model="accelerating")
    assert len(forecast_rows(followed, faster, course, years)) > 1
    merged = dataclasses.replace(followed, merged_into=2, merged_at=3)
    assert forecast_rows(merged, faster, course, years) == []


def test_an_acceleration_is_forecast_with_a_band_that_holds_the_next_epoch_and_what_is_open_is_not() -> None:
    years, sigma, own, rng = np.array([0.6, 1.5, 2.1, 3.4, 4.0]), 1.2e-4, 8e-5, np.random.default_rng(3)
    at, hits, told = 1.25 * years[-1], 0, 0
    followed = Followed(1, -1.0, np.ones(3, dtype=bool), np.ones(3, dtype=bool))
    times = np.append(years, at)
    for seed in range(150):
        seen = -1.5e-3 * times - 1.5e-4 * times**2 + rng.normal(0.0, np.sqrt(sigma**2 - own**2), 6) - rng.normal(0, own)
        measured = footprint(seen[:5], sigma, own)
        course = measured.course(years, seed)
        rows = forecast_rows(followed, measured, course, years)
        assert bool(rows) == (course.model in ("accelerating", "steady"))
        if course.model == "accelerating":
            told += 1
            _, last, mean, band = rows[-1]
            assert last == pytest.approx(at)
            hits += abs(seen[5] - mean) < 1.96 * band
    assert told > 100
    assert 0.90 <= hits / told <= 0.99
    open_course = dataclasses.replace(
        fit_course(years, seen[:5], np.full(5, sigma), own), model="accelerating or onset"
    )
    assert forecast_rows(followed, measured, open_course, years) == []
