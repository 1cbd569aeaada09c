"""The scatter of patches: its width, and its tails where nothing but other patches bears out what is told."""

import numpy as np
import pytest
from scipy.stats import t as student

from monitor.comparison.detection.units import cut_units, summarize_units
from monitor.comparison.distances.both_ways import make_shells, measure_sides
from monitor.comparison.noise.patch_errors import NORMAL, PatchErrors, calm_errors, dof_of, quantile_of, tailed_errors
from projects.model import Registration, Roughness, Surface

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
    p = errors.p_values(z, kinds, np.full(len(z), NORMAL))
    far = [float(np.mean(p[kinds == kind] < 1e-3)) for kind in (0, 1)]
    assert far == pytest.approx([1e-3, 1e-3], abs=1e-3)
    plain = calm_errors(z, kinds)
    assert np.mean(plain.p_values(z, kinds, np.full(len(z), NORMAL))[kinds == 1] < 1e-3) > 5e-3  # as if it were normal


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


def test_the_width_is_that_of_a_normal_distribution(rng: np.random.Generator) -> None:
    """The scale of Student's t is less than it: margins of regions would be a third too small."""
    z, kinds = 3.0 * student.rvs(3.5, size=N, random_state=rng), np.zeros(N, dtype=np.int64)
    assert tailed_errors(z, kinds).width == pytest.approx(calm_errors(z, kinds).width, rel=0.02)
    assert tailed_errors(z, kinds).scales[0] < 0.8 * calm_errors(z, kinds).width


def test_of_two_errors_each_kind_has_those_that_reach_farther() -> None:
    wide, tailed = PatchErrors(np.array([1.3, 1.0]), np.full(2, NORMAL)), PatchErrors(np.ones(2), np.array([60.0, 3.0]))
    both = wide.or_wider(tailed)
    assert both.scales == pytest.approx([1.3, 1.0])
    assert both.dofs == pytest.approx([NORMAL, 3.0])


@pytest.mark.parametrize("states_noise", [False, True])
def test_units_on_edges_are_rough_where_noise_is_not_stated(states_noise: bool) -> None:
    """Two faces of a roof: vertices within 4 mm of its ridge are rough."""
    x, y = (g.ravel() for g in np.meshgrid(np.linspace(-0.05, 0.05, 101), np.linspace(0.0, 0.05, 51), indexing="ij"))
    i = np.arange(100 * 51).reshape(100, 51)[:, :-1].ravel()
    faces = np.vstack([np.c_[i, i + 51, i + 1], np.c_[i + 1, i + 51, i + 52]])
    roughness = np.where(np.abs(x) < 0.004, Roughness.ROUGH, Roughness.SMOOTH).astype(np.uint8)
    sigma = np.full(len(x), 1e-4) if states_noise else None
    surface = Surface(np.c_[x, y, -np.abs(x)], faces, sigma=sigma, roughness=roughness)
    still = Registration(np.eye(4), np.zeros((6, 6)), np.zeros(3), True)
    sides = measure_sides(make_shells(surface, surface, (0.01, 1.0), np.eye(4)), still)
    units = summarize_units(sides[0], cut_units(sides[0], 0.01), still)
    on_ridge = np.abs(units.centres[:, 0]) < 0.007
    away = np.abs(units.centres[:, 0]) > 0.012
    assert on_ridge.any()
    assert (units.kinds[on_ridge] == (0 if states_noise else 1)).all()
    assert (units.kinds[away] == 0).all()
