"""A course on which nothing goes on seldom gets a name, whichever test is asked, and what goes on keeps its own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import binom, norm

from monitor.comparison.detection.family import adjust_together, share_as_small
from monitor.comparison.series.trend import fit_course
from projects.model import Floats

SIGMA, OWN = 4e-4, 2.8e-4  # m, of a difference and of the reference's part of it
IRREGULAR = np.array([0.7, 1.9, 3.0, 4.2, 5.5])


def name_courses(rng: np.random.Generator, years: Floats, truth: Floats, n: int) -> list[str]:
    """Return the models of n courses that go on as `truth` (k,) [m], the error of the reference common to each."""
    noise = rng.normal(0.0, np.sqrt(SIGMA**2 - OWN**2), (n, len(years))) - rng.normal(0.0, OWN, (n, 1))
    sigmas = np.full(len(years), SIGMA)
    return [fit_course(years, truth + e, sigmas, OWN, seed=k).model for k, e in enumerate(noise)]


@pytest.mark.parametrize("years", [np.array([1.0, 2.0]), IRREGULAR, np.arange(1.0, 11.0)])
def test_a_course_on_which_nothing_goes_on_gets_a_name_in_five_per_cent(
    rng: np.random.Generator, years: Floats
) -> None:
    """Rate, acceleration, moment and misfit together: three tests of 5 % each named 11 to 14 %."""
    n = 400
    named = sum(m != "none" for m in name_courses(rng, years, np.zeros(len(years)), n))
    assert named <= binom.ppf(0.999, n, 0.05)


@pytest.mark.parametrize(
    ("names", "alone", "among", "shape"),
    [
        ({"steady"}, 0.90, 0.90, lambda t: t / t[-1]),
        ({"jump"}, 0.65, 0.92, lambda t: (t >= t[-1]) * 1.0),
        ({"jump"}, 0.75, 0.92, lambda t: (t >= t[0]) * 1.0),
        ({"onset", "jump", "accelerating", "bending"}, 0.75, 0.75, lambda t: np.maximum(t - 3.0, 0.0) / 2.5),
    ],
)
def test_what_goes_on_keeps_its_name(
    rng: np.random.Generator, names: set[str], alone: float, among: float, shape: Callable[[Floats], Floats]
) -> None:
    """Five sigmas in the end. A jump to the last epoch shows little rate: a gate of it first would lose it. One epoch
    shows it, and in a fifth of cases the others leave open whether it began before."""
    models = [set(m.split(" or ")) for m in name_courses(rng, IRREGULAR, 5.0 * SIGMA * shape(IRREGULAR), 150)]
    assert np.mean([m <= names for m in models]) >= alone
    assert np.mean([bool(m & names) for m in models]) >= among


def test_independent_tests_are_adjusted_as_sidak_says(rng: np.random.Generator) -> None:
    chance = rng.uniform(size=(3, 200_000))
    adjusted = adjust_together(np.array([0.2, 0.001, 0.02]), chance)
    expected = [0.2, 1.0 - (1.0 - 0.001) ** 3, 1.0 - (1.0 - 0.02) ** 2]
    np.testing.assert_allclose(adjusted, expected, rtol=0.1, atol=0.005)  # 200 000 draws: 0.001 to 4 %, one sigma


def test_tests_that_always_agree_cost_nothing_and_adjusted_values_keep_the_order() -> None:
    z = np.random.default_rng(1).standard_normal(100_000)
    p = 2.0 * norm.sf(np.abs(z))
    np.testing.assert_allclose(adjust_together(np.array([0.04, 0.01]), np.stack([p, p])), [0.04, 0.01], atol=0.002)
    apart = np.stack([p, 2.0 * norm.sf(np.abs(np.roll(z, 1)))])
    held = adjust_together(np.array([0.0201, 0.02]), apart)
    assert held[0] >= held[1] > 0.035  # the second of two counts no less than the first


def test_what_was_seen_counts_as_one_of_the_draws() -> None:
    np.testing.assert_array_equal(
        share_as_small(np.array([0.0, 0.3, 9.0]), np.array([0.1, 0.3, 0.2])), [0.25, 1.0, 1.0]
    )
