"""How often courses of every kind get their own name, several, or a wrong one, and how many dates are false."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from monitor.comparison.series.trend import Course, fit_course
from projects.model import Floats

SIGMA, OWN = 1.2e-4, 0.85e-4  # m, of a difference and of the reference's part of it
FIVE = np.array([0.649, 1.517, 2.111, 3.392, 3.986])  # years
TEN = np.arange(1.0, 11.0)
N = 60
BENDS = ("accelerating", "bending")


@dataclass(frozen=True)
class Case:
    """A true course [mm] at times, its names, how often at least one of them is named alone, and at least among others,
    and the moment of its change."""

    title: str
    years: Floats
    course: Callable[[Floats], Floats]
    names: Sequence[str]
    alone: float
    among: float
    moment: float | None = None


def from_rest(acceleration: float) -> Callable[[Floats], Floats]:
    return lambda t: acceleration * t**2 / 2.0


def going(rate: float, acceleration: float) -> Callable[[Floats], Floats]:
    return lambda t: rate * t + acceleration * t**2 / 2.0


def breaking(depth: float, moment: float, rate: float = 0.0, since: float = 0.0) -> Callable[[Floats], Floats]:
    return lambda t: rate * t + np.where(t > moment, depth + since * (t - moment), 0.0)


def starting(rate: float, moment: float) -> Callable[[Floats], Floats]:
    return lambda t: rate * np.maximum(t - moment, 0.0)


def stopping(rate: float, moment: float) -> Callable[[Floats], Floats]:
    return lambda t: rate * np.minimum(t, moment)


# Least shares: of 400 courses each, less three sigmas of a share of N.
CASES = (
    Case("nothing", FIVE, from_rest(0.0), ("none",), 0.88, 0.88),
    Case("steady", FIVE, going(0.5, 0.0), ("steady",), 0.88, 0.88),
    Case("from rest, 0.2", FIVE, from_rest(0.2), BENDS, 0.05, 0.90),
    Case("from rest, 0.3", FIVE, from_rest(0.3), BENDS, 0.27, 0.90),
    Case("from rest, 0.5", FIVE, from_rest(0.5), BENDS, 0.67, 0.90),
    Case("from rest, 0.7", FIVE, from_rest(0.7), BENDS, 0.88, 0.90),
    Case("from rest, ten epochs", TEN, from_rest(0.2), ("accelerating",), 0.90, 0.90),
    Case("faster", FIVE, going(1.5, 0.3), BENDS, 0.85, 0.90),
    Case("slower", FIVE, going(1.5, -0.3), BENDS, 0.48, 0.90),
    Case("doubling", FIVE, lambda t: 0.15 * (2.0**t - 1.0), BENDS, 0.66, 0.90),
    Case("settling", FIVE, lambda t: 2.0 * (1.0 - np.exp(-t)), BENDS, 0.66, 0.90),
    Case("jump", FIVE, breaking(3.0, 1.8), ("jump",), 0.88, 0.88, 1.8),
    Case("jump, eroding", FIVE, breaking(3.0, 1.8, rate=0.3), ("jump and rate",), 0.90, 0.90, 1.8),
    Case("jump, then eroding", FIVE, breaking(3.0, 1.8, since=0.5), ("jump and rate",), 0.90, 0.90, 1.8),
    Case("onset", FIVE, starting(1.0, 1.8), ("onset",), 0.50, 0.90, 1.8),
    Case("onset, ten epochs", TEN, starting(0.5, 4.5), ("onset",), 0.85, 0.90, 4.5),
    Case("stopped", FIVE, stopping(0.6, 2.0), ("stopped",), 0.08, 0.85, 2.0),
    Case("stopped, ten epochs", TEN, stopping(0.5, 4.5), ("stopped",), 0.90, 0.90, 4.5),
    Case("comes and goes", FIVE, lambda t: np.where(np.abs(t - 1.5) < 0.1, 1.0, 0.0), ("irregular",), 0.90, 0.90),
)


def name_courses(case: Case, n: int = N) -> list[Course]:
    rng, k = np.random.default_rng(1), len(case.years)
    truth, sigmas = -1e-3 * case.course(case.years), np.full(k, SIGMA)
    noise = rng.normal(0.0, np.sqrt(SIGMA**2 - OWN**2), (n, k)) - rng.normal(0.0, OWN, (n, 1))
    return [fit_course(case.years, truth + e, sigmas, OWN, seed=s) for s, e in enumerate(noise)]


def is_false_date(course: Course, moment: float | None) -> bool:
    return bool(np.isfinite(course.onset[0])) and (moment is None or not course.onset[0] <= moment <= course.onset[1])


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.title)
def test_a_course_gets_its_name_alone_or_among_others_and_no_false_date(case: Case) -> None:
    courses = name_courses(case)
    assert np.mean([c.model in case.names for c in courses]) >= case.alone
    assert np.mean([bool(set(c.model.split(" or ")) & set(case.names)) for c in courses]) >= case.among
    assert np.mean([is_false_date(c, case.moment) for c in courses]) <= 0.05


@pytest.mark.parametrize("course", [starting(0.31, 1.6), stopping(0.31, 1.6)], ids=["onset", "stopped"])
def test_a_faint_onset_or_stop_that_passes_for_a_jump_has_no_false_date(course: Callable[[Floats], Floats]) -> None:
    """Half a millimetre in all, of 0.1 mm noise: a jump fits as well, with one number less. Dated by it alone, four in
    five of those told so were dated wrongly."""
    years = np.arange(0.4, 3.3, 0.4)
    courses = name_courses(Case("faint", years, course, (), 0.0, 0.0), 500)
    at_once = [c for c in courses if c.model == "jump"]
    assert len(at_once) > 10
    assert np.mean([is_false_date(c, 1.6) for c in at_once]) <= 0.4
    assert np.mean([is_false_date(c, 1.6) for c in courses]) <= 0.03


def test_two_epochs_after_the_first_do_not_tell_an_acceleration_from_an_onset() -> None:
    """0, 1 and 4 mm lie on a parabola, and on a line that starts after the first epoch."""
    course = fit_course(np.array([1.0, 2.0]), np.array([-1e-3, -4e-3]), np.full(2, SIGMA), OWN)
    assert course.model == "accelerating or onset"
    assert np.isnan(course.onset).all()
