"""How means of unchanged patches scatter: their width, and tails where there are any."""

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student

from monitor.comparison.patches import NORMAL, calm_errors, tail_freedom


def test_normal_errors_have_no_tails_in_nineteen_of_twenty_objects(rng: np.random.Generator) -> None:
    found = np.array([tail_freedom([rng.normal(size=600) for _ in range(3)]) for _ in range(200)])
    assert np.mean(found < NORMAL) < 0.10
    assert found.min() > 12.0


@pytest.mark.parametrize("dof", [4.0, 8.0])
def test_tails_are_told_though_what_is_suspect_is_left_out(rng: np.random.Generator, dof: float) -> None:
    z = student.rvs(dof, size=(4, 8000), random_state=rng)
    suspect = norm.isf(0.0005) * student.ppf(0.95, dof) / norm.ppf(0.95)  # p of 0.001 by a normal as wide
    found = tail_freedom([v[np.abs(v) < suspect] for v in z])
    assert dof < found < 3.0 * dof  # not fewer degrees than there are: only what is sure


def test_a_wider_scatter_is_no_tail_and_a_tail_no_wider_scatter(rng: np.random.Generator) -> None:
    wide = calm_errors([1.5 * rng.normal(size=20_000)])[0]
    assert wide.scale == pytest.approx(1.5, rel=0.02)
    assert wide.dof > 50.0
    tailed = calm_errors([student.rvs(5.0, size=20_000, random_state=rng)])[0]
    assert 4.4 < tailed.dof < 7.0
    assert tailed.p_values(np.array([2.015]))[0] == pytest.approx(0.10, abs=0.01)  # nine tenths of them lie within
    assert tailed.p_values(np.array([6.0]))[0] > 1e-3  # a normal as wide: 1e-6


def test_errors_smaller_than_stated_are_judged_as_stated(rng: np.random.Generator) -> None:
    small = calm_errors([0.7 * rng.normal(size=20_000)])[0]
    assert small.p_values(np.array([1.645]))[0] == pytest.approx(0.10, abs=0.002)
    few = calm_errors([rng.normal(size=10)])[0]
    assert (few.scale, few.dof) == pytest.approx((1.0, NORMAL))
