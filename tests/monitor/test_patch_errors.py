"""How means of unchanged patches scatter: their width, tails where there are any, and what the registration adds."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student

from monitor.comparison.patches import NORMAL, calm_errors, outline_patches, tail_freedom
from monitor.comparison.reaches import gather_reaches
from monitor.comparison.units import Units
from projects.model import Registration


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


@pytest.mark.parametrize("share", [0.0, 0.75, 1.0])
def test_the_registration_counts_as_far_as_it_does_not_rest_on_what_lies_around(share: float) -> None:
    n, size, sigma, shared = 12, 0.01, 2e-4, 1e-4
    x, y = (size * a.ravel() for a in np.meshgrid(np.arange(n), np.arange(n)))
    centres = np.column_stack([x, y, np.zeros(n * n)])
    up = np.tile([0.0, 0.0, 1.0], (n * n, 1))
    ones, unknown = np.ones(n * n), np.full(n * n, np.nan)
    number, rows = np.arange(n * n), np.hstack([np.zeros((n * n, 3)), up])
    units = Units(number, size**2 * ones, number * 0 + 9, centres, 0.0 * ones, shared * ones, rows, share * ones,
                  unknown, unknown)  # fmt: skip
    radii = [0.0, 1.2 * size, 2.4 * size]
    registration = Registration(np.eye(4), np.diag([0.0] * 5 + [sigma**2]), np.zeros(3), True, stable_share=1.0,
                                is_stable=np.ones(n * n, dtype=bool))  # fmt: skip
    found = outline_patches(units, gather_reaches(centres, up, radii), len(radii), registration)
    assert found.common2 == pytest.approx(np.full((n * n, 3), (1.0 - share) * sigma**2 + shared**2))
    half = replace(units, stable_shares=(x > 5.5 * size) * 1.0)  # one half only: a place in the other is no fit's datum
    found = outline_patches(half, gather_reaches(centres, up, radii), len(radii), registration)
    assert found.common2[x == 0.0] == pytest.approx(sigma**2 + shared**2)
    assert found.common2[x == 11 * size] == pytest.approx(shared**2)
