"""The scatter of patches: its width, and its tails where nothing but other patches bears out what is told."""

import numpy as np
import pytest
from scipy.stats import t as student

from monitor.comparison.patch_errors import NORMAL, calm_errors, dof_of, quantile_of, tailed_errors

N = 20_000


def test_degrees_of_freedom_are_told_by_two_quantiles() -> None:
    for dof in (3.0, 5.0, 20.0):
        assert dof_of(quantile_of(dof, 0.99) / quantile_of(dof, 0.9)) == pytest.approx(dof, rel=1e-6)
    assert dof_of(1.5) == NORMAL  # less than the normal distribution's 1.566


def test_each_kind_has_tails_of_its_own(rng: np.random.Generator) -> None:
    kinds = np.repeat([0, 1], N)
    z = np.concatenate([rng.normal(size=N), 1.3 * student.rvs(4.0, size=N, random_state=rng)])
    errors = tailed_errors(z, kinds)
    assert errors.dofs[0] > 30.0
    assert errors.dofs[1] == pytest.approx(4.0, rel=0.25)
    assert errors.scales == pytest.approx([1.0, 1.3], rel=0.06)
    p = errors.p_values(z, kinds)
    far = [float(np.mean(p[kinds == kind] < 1e-3)) for kind in (0, 1)]
    assert far == pytest.approx([1e-3, 1e-3], abs=1e-3)
    plain = calm_errors(z, kinds)
    assert np.mean(plain.p_values(z, kinds)[kinds == 1] < 1e-3) > 5e-3  # as if it were normal


def test_what_scatters_less_than_stated_is_as_wide_as_stated(rng: np.random.Generator) -> None:
    z, kinds = 0.5 * rng.normal(size=N), np.zeros(N, dtype=np.int64)
    assert tailed_errors(z, kinds).scales == pytest.approx([1.0, 1.0])
    assert calm_errors(z, kinds).scales == pytest.approx([1.0, 1.0])


def test_where_a_kind_has_few_patches_all_tell(rng: np.random.Generator) -> None:
    kinds = np.repeat([0, 1], [3000, 50])
    z = student.rvs(4.0, size=len(kinds), random_state=rng)
    errors = tailed_errors(z, kinds)
    assert errors.dofs[0] < 7.0
    assert errors.dofs[1] < 7.0
    assert (tailed_errors(z[:100], kinds[:100]).dofs == NORMAL).all()
