"""What unchanged patches show of the errors of scans: simulated patches, of which the true scale is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm, t

from monitor.comparison.noise.patch_errors import NORMAL
from monitor.comparison.noise.scan_errors import AS_STATED, FAR, LEAST_SCALE, ScanErrors, believe_stated, learn_scans
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
    assert found.sigma_of(np.array(1e-4)) == pytest.approx(1e-4 * scale ** (20.0 / 22.0), rel=0.04)


def test_scans_that_err_alike_in_both_epochs_are_held_to_err_by_a_quarter(rng: np.random.Generator) -> None:
    found = learn_scans(*simulate(rng, 0.0, np.full(N, 1e-4)), 1.0)
    assert found.scales == pytest.approx([LEAST_SCALE ** (20.0 / 22.0), 1.0])  # no place states so much
    assert found.n_witnesses[0] == pytest.approx(20.0)


def test_where_more_is_stated_it_has_a_scale_of_its_own(rng: np.random.Generator) -> None:
    stated = np.where(np.arange(N) < 0.6 * N, 1e-4, 3e-4)
    worse = learn_scans(*simulate(rng, np.where(stated > 2e-4, 2.0, 0.1), stated), 1.0)
    assert worse.sigma_of(np.array(3e-4)) == pytest.approx(3e-4 * 2.0 ** (8.0 / 10.0), rel=0.05)
    better = learn_scans(*simulate(rng, np.where(stated > 2e-4, 0.1, 0.5), stated), 1.0)
    assert better.sigma_of(np.array([1e-4, 3e-4])) == pytest.approx([0.5e-4, 3e-4], rel=0.15)


def test_a_few_places_that_state_more_are_as_stated_beyond_the_rest(rng: np.random.Generator) -> None:
    """What most places show says nothing of what three in a hundred disagree by beyond them."""
    stated = np.where(np.arange(N) < 0.97 * N, 1e-4, 3e-4)
    found = learn_scans(*simulate(rng, np.where(stated > 2e-4, 1.0, 0.0), stated), 1.0)
    low, high = found.sigma_of(np.array([1e-4, 3e-4])) / [1e-4, 3e-4]
    assert low < 0.3
    assert found.scales[1] == pytest.approx(1.0, abs=0.05)
    assert high == pytest.approx(found.scales[1] * np.sqrt(0.25 * low**2 + 0.75))  # up to the step it falls out


def test_what_falls_out_of_the_change_does_so_where_a_place_errs_besides(rng: np.random.Generator) -> None:
    """All err alike in both epochs by 0.1 mm, a third by as much again, 1.7 times or 2.8 times, in one epoch alone."""
    own = 1e-4 * np.where(np.arange(N) < 0.7 * N, 0.0, np.array([1.0, 1.7, 2.8])[np.arange(N) % 3])
    stated = np.hypot(1e-4, own)
    found = learn_scans(*simulate(rng, own / stated, stated), 1.0)
    assert found.scales[1] == pytest.approx(1.0, abs=0.1)
    below, beyond = found.sigma_of(found.steps[1] * np.array([1.0 - 1e-9, 1.0]))
    assert beyond == pytest.approx(below, rel=0.1)
    for excess in (1.7e-4, 2.8e-4):
        assert 0.9 * excess < found.sigma_of(np.hypot(1e-4, excess)) < 1.1 * excess


@pytest.mark.parametrize("beyond", [1.0, 2.0])
def test_the_error_grows_with_what_is_stated(beyond: float) -> None:
    """No less than the first scale of all that is stated; far beyond the step its own."""
    scans = ScanErrors(np.array([0.0, 2e-4]), np.array([0.3, beyond]), np.array([20.0, 5.0]))
    stated = np.linspace(1e-5, 1e-3, 500)
    sigma = scans.sigma_of(stated)
    assert (np.diff(sigma) > 0.0).all()
    assert (sigma >= 0.3 * stated * (1.0 - 1e-12)).all()
    assert sigma[-1] == pytest.approx(beyond * np.sqrt(1e-6 - 0.91 * 4e-8))


@pytest.mark.parametrize("more", [1.6, 2.0, 3.0])
@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_what_three_in_ten_places_err_by_is_believed(rng: np.random.Generator, more: float, scale: float) -> None:
    """They state that much more than the rest, of which three tenths are true, and really err by all of it."""
    stated = 1e-4 * np.where(np.arange(N) < 0.7 * N, 1.0, more)
    found = learn_scans(*simulate(rng, np.where(stated > 1.5e-4, scale, 0.3), stated), 1.0)
    true = scale * more * 1e-4
    assert 0.8 * true < found.sigma_of(np.array(more * 1e-4)) < 1.1 * true


def test_no_jump_where_what_most_show_ends() -> None:
    scans = ScanErrors(np.array([0.0, 2e-4]), np.array([0.3, 1.0]), np.array([20.0, NORMAL]))
    around, sigma = 2e-4 * np.array([1.0 - 1e-9, 1.0]), 0.6e-4
    assert scans.sigma_of(around) == pytest.approx([sigma, sigma])
    assert scans.dof_of(np.full(2, sigma**2), around) == pytest.approx([20.0, 20.0])
    assert scans.sigma_of(np.array(2e-3)) == pytest.approx(np.sqrt(4.0 - 0.04 + 0.0036) * 1e-3)


def test_noise_that_is_understated_is_not_laid_on_the_scans(rng: np.random.Generator) -> None:
    """Seven tenths of the places state hardly anything of their scans and err by twice their own noise."""
    for little in (0.0, 2e-6):
        stated = np.where(np.arange(N) < 0.7 * N, little, 3e-4)
        means, own2, of_scans = simulate(rng, 0.0, stated)
        found = learn_scans(2.0 * means, own2, of_scans, 1.0)
        assert found.scales.max() <= 1.0
        assert found.sigma_of(np.array(3e-4)) <= 3e-4


def test_the_size_that_shows_most_counts(rng: np.random.Generator) -> None:
    """In small patches their own noise hides what scans disagree by, in wide ones what agrees only so far averages."""
    means, own2, stated = simulate(rng, 0.0, np.full(N, 1e-4))
    means[:, 1] += 0.5e-4 * rng.normal(size=N)
    assert learn_scans(means, own2, stated, 1.0).scales[0] == pytest.approx(0.5 ** (20.0 / 22.0), rel=0.06)


def test_patches_that_do_not_hold_still_do_not_tell(rng: np.random.Generator) -> None:
    means, own2, stated = simulate(rng, 0.5, np.full(N, 1e-4))
    still = learn_scans(means, own2, stated, 0.7)
    means[: N // 3] = np.nan
    assert learn_scans(means, own2, stated, 0.7).scales == pytest.approx(still.scales, rel=0.05)


def test_too_few_patches_and_scans_that_state_nothing_are_as_stated(rng: np.random.Generator) -> None:
    means, own2, stated = simulate(rng, 0.5, np.full(N, 1e-4))
    assert learn_scans(means, own2, 0.0 * stated, 1.0) is AS_STATED
    assert learn_scans(means[:39], own2[:39], stated[:39], 1.0) is AS_STATED
    few = (v[:56] for v in simulate(rng, 0.1, np.full(N, 1e-4)))
    assert learn_scans(*few, 1.0).n_witnesses[0] == pytest.approx(14.0)


def test_few_witnesses_ask_for_no_more_than_what_is_stated() -> None:
    """A scale of a half that three places show asks for more, far out, than what is stated does; of twenty for less."""
    for n, vague in ((0.0, True), (3.0, True), (20.0, False)):
        assert (0.5 * t.isf(0.5 * FAR, max(n, 1.0)) > norm.isf(0.5 * FAR)) == vague
        assert believe_stated(0.5, n) == ((1.0, NORMAL) if vague else (0.5, n))
        assert believe_stated(1.4, n) == (1.4, NORMAL)


def test_the_degrees_of_freedom_are_those_of_the_scans_share() -> None:
    """Satterthwaite (1946): the variances of two estimates add up, and one of them is known."""
    scans = ScanErrors(np.array([0.0, 2e-4]), np.array([0.5, 1.0]), np.array([20.0, 10.0]))
    stated = np.array([1e-4, 1e-4, 3e-4, 0.0])
    shared2 = np.array([0.5e-4**2, 0.5e-4**2, 1e-4**2 + 5e-8, 0.0])  # of the third a sixth as below the step
    assert scans.sigma_of(stated) ** 2 == pytest.approx(shared2)
    dofs = scans.dof_of(shared2 * [1.0, 3.0, 1.0, 1.0] + np.array([0.0, 0.0, 0.0, 1e-9]), stated)
    assert dofs[:3] == pytest.approx([20.0, 180.0, 36.0 / (1.0 / 20.0 + 25.0 / 10.0)])
    assert dofs[3] > 1e8
    draws = np.random.default_rng(1)
    sigma = 0.5e-4 * np.sqrt(draws.chisquare(20.0, 400_000) / 20.0)
    beyond = np.abs(draws.normal(0.0, 0.5e-4, 400_000)) > 3.0 * sigma
    assert beyond.mean() == pytest.approx(2.0 * norm.sf(scans.as_normal(3.0, 0.5e-4, 1e-4)), rel=0.05)


def test_what_lies_hundreds_of_sigmas_off_still_has_a_sign() -> None:
    """Student's t of thousands of degrees of freedom is 0 from 38 sigmas on; opposite sides were significant then."""
    scans = ScanErrors(np.zeros(1), np.array([0.2]), np.array([20.0]))
    away = [scans.as_normal(z, 1e-4, 1e-4) for z in (-400.0, -45.0, 45.0, np.inf)]
    assert away == [-37.0, -37.0, 37.0, 37.0]


@pytest.mark.parametrize(("n_scans", "n_witnesses"), [(0, 20.0), (5, 20.0), (4, 18.0), (3, 12.0)])
def test_few_scans_disagree_in_few_ways(rng: np.random.Generator, n_scans: int, n_witnesses: float) -> None:
    """Of three, which can lie off each other by twelve parameters, not twenty places bear witness."""
    found = learn_scans(*simulate(rng, 0.0, np.full(N, 1e-4)), 1.0, n_scans)
    assert found.n_witnesses[0] == pytest.approx(n_witnesses)


def test_what_two_scans_err_by_is_as_stated(rng: np.random.Generator) -> None:
    found = learn_scans(*simulate(rng, 0.1, np.full(N, 1e-4)), 1.0, 2)
    assert found.scales[0] == 1.0
    assert found.n_witnesses[0] == NORMAL
