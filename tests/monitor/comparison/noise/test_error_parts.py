"""Which of the stated parts the errors follow, told from distances made of parts of known size."""

import numpy as np
import pytest

from monitor.comparison.noise.error_parts import Parts, fit_parts
from projects.model import Floats

N = 100_000


def mix(parts: Parts, surfaces: Floats, discord: Floats, shared: Floats) -> Floats:
    """Return one sigma (n,) [m] of what is stated."""
    own2 = (parts.surfaces * surfaces) ** 2 + (parts.discord * discord) ** 2
    return np.sqrt(own2 + (parts.shared * shared) ** 2 + parts.floor**2)


def made_of(
    rng: np.random.Generator, parts: Parts, motion: float = 0.0
) -> tuple[Floats, tuple[Floats, Floats, Floats, Floats]]:
    """Return distances [m] with errors of these parts, and what is stated of each."""
    surfaces, shared = rng.uniform(0.2e-3, 1.5e-3, N), rng.uniform(0.2e-3, 3e-3, N)
    discord, moved = 1e-3 * rng.gamma(1.0, 1.0, N), np.full(N, motion)
    sigma = np.hypot(mix(parts, surfaces, discord, shared), motion)
    return sigma * rng.normal(size=N), (surfaces, discord, shared, moved)


@pytest.mark.parametrize(
    "true", [Parts(0.7, 0.5, 0.3, 0.2e-3), Parts(1.4, 1.0, 0.6, 0.4e-3), Parts(0.6, 0.4, 1.0, 0.5e-3)]
)
def test_each_part_has_the_scale_that_the_errors_show(true: Parts, rng: np.random.Generator) -> None:
    found = fit_parts(*made_of(rng, true, motion=0.2e-3), N)
    assert np.array(found) == pytest.approx(np.array(true), rel=0.08, abs=0.03e-3)


def test_the_registration_stays_as_stated(rng: np.random.Generator) -> None:
    distances, stated = made_of(rng, Parts(0.5, 1e-3, 1e-3, 0.0), motion=1e-3)
    assert fit_parts(distances, stated, N).surfaces == pytest.approx(0.5, rel=0.15)  # 1.2 if it held none of it


def test_a_twentieth_that_changed_teaches_little(rng: np.random.Generator) -> None:
    true = Parts(0.7, 0.5, 0.3, 0.0)
    distances, stated = made_of(rng, true)
    distances[: N // 20] += 0.01
    found = fit_parts(distances, stated, N)
    assert found.surfaces == pytest.approx(0.7, rel=0.3)  # a normal likelihood: above 2
    assert np.median(mix(found, *stated[:3])) == pytest.approx(np.median(mix(true, *stated[:3])), rel=0.3)


def test_few_witnesses_leave_what_is_stated(rng: np.random.Generator) -> None:
    distances, stated = made_of(rng, Parts(1.0, 1.0, 0.02, 0.0))
    assert fit_parts(distances, stated, 0.01).shared == pytest.approx(1.0, rel=0.02)
    assert 0.15 < fit_parts(distances, stated, 10.0).shared < 0.8
    assert fit_parts(distances, stated, N).shared < 0.1


def test_without_any_distance_from_zero_all_stays_as_stated() -> None:
    assert fit_parts(np.zeros(9), (np.ones(9), np.ones(9), np.ones(9), np.ones(9)), 9.0) == (1.0, 1.0, 1.0, 0.0)
