"""What unchanged patches show of the errors of scans: simulated patches, of which the true scale is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm, t

from monitor.comparison.scan_errors import AS_STATED, FAR, LEAST_SCALE, ScanErrors, believe_stated, learn_scans
from projects.model import Floats

N, OWN = 4000, 2e-5  # patches of each of three sizes; m


def simulate(rng: np.random.Generator, scale: Floats | float, stated: Floats) -> tuple[Floats, Floats, Floats]:
    """Return means, own variance and what is stated (p, 3) of patches whose scans err by `scale` times that."""
    own2 = OWN**2 * np.array([4.0, 1.0, 0.25])
    means = np.sqrt(own2) * rng.normal(size=(N, 3)) + (scale * stated * rng.normal(size=N))[:, None]
    return means, np.broadcast_to(own2, means.shape), np.repeat(stated[:, None], 3, axis=1)


@pytest.mark.parametrize("scale", [0.3, 0.6, 2.0])
def test_the_scale_is_what_patches_show_held_by_what_is_stated(rng: np.random.Generator, scale: float) -> None:
    found = learn_scans(*simulate(rng, scale, np.full(N, 1e-4)), 1.0)
    assert found.scales[0] == pytest.approx(scale ** (20.0 / 22.0), rel=0.04)


def test_scans_that_err_alike_in_both_epochs_are_held_to_err_by_a_quarter(rng: np.random.Generator) -> None:
    found = learn_scans(*simulate(rng, 0.0, np.full(N, 1e-4)), 1.0)
    assert found.scales == pytest.approx(np.full(4, LEAST_SCALE ** (20.0 / 22.0)), rel=1e-9)
    assert found.n_witnesses == pytest.approx(np.full(4, 20.0))


def test_where_more_is_stated_the_scale_may_be_larger_and_is_never_smaller(rng: np.random.Generator) -> None:
    stated = np.where(np.arange(N) < 0.75 * N, 1e-4, 3e-4)
    worse = learn_scans(*simulate(rng, np.where(stated > 2e-4, 0.6, 0.1), stated), 1.0)
    low, high = worse.sigma_of(np.array([1e-4, 3e-4])) / [1e-4, 3e-4]
    assert low < 0.45
    assert 1.25 * low < high < 0.6
    better = learn_scans(*simulate(rng, np.where(stated > 2e-4, 0.1, 0.5), stated), 1.0)
    low, high = better.sigma_of(np.array([1e-4, 3e-4])) / [1e-4, 3e-4]
    assert low == pytest.approx(high)
    assert low > 0.4


def test_the_size_that_shows_most_counts(rng: np.random.Generator) -> None:
    """In small patches their own noise hides what scans disagree by, in wide ones what agrees only so far averages."""
    means, own2, stated = simulate(rng, 0.0, np.full(N, 1e-4))
    means[:, 1] += 0.5e-4 * rng.normal(size=N)
    assert learn_scans(means, own2, stated, 1.0).scales[0] == pytest.approx(0.5 ** (20.0 / 22.0), rel=0.06)


def test_patches_that_are_not_calm_do_not_tell(rng: np.random.Generator) -> None:
    means, own2, stated = simulate(rng, 0.5, np.full(N, 1e-4))
    still = learn_scans(means, own2, stated, 0.7)
    means[: N // 3] = np.nan
    assert learn_scans(means, own2, stated, 0.7).scales == pytest.approx(still.scales, rel=0.05)


def test_too_few_patches_and_scans_that_state_nothing_are_as_stated(rng: np.random.Generator) -> None:
    means, own2, stated = simulate(rng, 0.5, np.full(N, 1e-4))
    assert learn_scans(means, own2, 0.0 * stated, 1.0) is AS_STATED
    assert learn_scans(means[:19], own2[:19], stated[:19], 1.0) is AS_STATED


def test_few_witnesses_ask_for_no_more_than_what_is_stated() -> None:
    """A scale of a half that three places show asks for more, far out, than what is stated does; of twenty for less."""
    scales = np.array([0.5, 1.4])
    for n, vague in ((3.0, True), (20.0, False)):
        assert (0.5 * t.isf(0.5 * FAR, n) > norm.isf(0.5 * FAR)) == vague
        believed, witnesses = believe_stated(scales, n)
        assert believed == pytest.approx([1.0 if vague else 0.5, 1.4])
        assert (witnesses < 1e6).tolist() == [not vague, False]


def test_the_degrees_of_freedom_are_those_of_the_scans_share() -> None:
    """Satterthwaite (1946): the variances of two estimates add up, and one of them is known."""
    scans = ScanErrors(np.array([0.0, 2e-4]), np.array([0.5, 1.0]), np.array([20.0, 10.0]))
    stated = np.array([1e-4, 1e-4, 3e-4, 0.0])
    shared2 = np.array([0.5e-4, 0.5e-4, 3e-4, 0.0]) ** 2
    assert scans.sigma_of(stated) ** 2 == pytest.approx(shared2)
    dofs = scans.dof_of(shared2 * [1.0, 3.0, 1.0, 1.0] + np.array([0.0, 0.0, 0.0, 1e-9]), stated)
    assert dofs[:3] == pytest.approx([20.0, 180.0, 10.0])
    assert dofs[3] > 1e8
    draws = np.random.default_rng(1)
    sigma = 0.5e-4 * np.sqrt(draws.chisquare(20.0, 400_000) / 20.0)
    beyond = np.abs(draws.normal(0.0, 0.5e-4, 400_000)) > 3.0 * sigma
    assert beyond.mean() == pytest.approx(2.0 * norm.sf(scans.as_normal(3.0, 0.5e-4, 1e-4)), rel=0.05)
