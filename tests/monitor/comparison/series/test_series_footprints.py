"""What a series knows of a region where an epoch saw a part of it, and what of all differences is the reference's."""

from __future__ import annotations

import datetime

import numpy as np
import pytest
import trimesh
from simulated_series import YEARS, plane, simulate_series, square

from monitor.comparison import compare
from monitor.comparison.series.epoch_change import EpochChange
from monitor.comparison.series.follow import follow, reference_part
from monitor.comparison.series.footprints import measure_footprint, missed_by_unseen
from monitor.comparison.series.identity import Followed
from monitor.comparison.series.rate_side import lay_bare
from monitor.comparison.series.trend import fit_course
from monitor.comparison.series.volumes import find_bodies
from projects.model import Comparison, Floats, Registration, Surface

NOISE = 5e-5  # m
START = datetime.date(2020, 1, 1)


def sphere(rng: np.random.Generator, stated: float | None) -> Surface:
    """Return a sphere of 0.1 m with noise, which states `stated` [m] as its sigma."""
    mesh = trimesh.creation.icosphere(subdivisions=4)
    radius = 0.1 + rng.normal(0, NOISE, len(mesh.vertices))
    sigma = None if stated is None else np.full(len(mesh.vertices), stated)
    return Surface(mesh.vertices * radius[:, None], mesh.faces, sigma=sigma)


def compare_still(reference: Surface, later: Surface) -> Comparison:
    known = Registration(np.eye(4), np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                         is_stable=np.ones(len(later.vertices), dtype=bool))  # fmt: skip
    return compare(reference, later, known)


@pytest.mark.parametrize("stated", [0.4 * NOISE, NOISE, 2.5 * NOISE])
def test_rates_are_as_sure_as_they_say_whatever_the_surfaces_state(rng: np.random.Generator, stated: float) -> None:
    reference = sphere(rng, stated)
    days = (365, 731, 1096, 1461)
    changes = [EpochChange(f"d{d}", START + datetime.timedelta(days=d), compare_still(reference, sphere(rng, stated)))
               for d in days]  # fmt: skip
    series = follow(changes, "d0", START)
    inside = np.mean((np.abs(series.rate) < 1.96 * series.sigma_rate)[np.isfinite(series.rate)])
    assert 0.935 <= inside <= 0.965  # 2562 vertices, hardly correlated: 95 % within 3.5 sigma


def test_the_part_of_the_reference_is_as_both_surfaces_state(rng: np.random.Generator) -> None:
    better = compare_still(sphere(rng, NOISE), sphere(rng, 2.0 * NOISE))
    assert reference_part(better) == pytest.approx(0.2, rel=1e-9)
    unstated = compare_still(sphere(rng, NOISE), sphere(rng, None))
    assert reference_part(unstated) == 0.5


def bowl(years: Floats, unseen: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Return a change (k, 100) [m] that deepens by up to 0.2 mm/year, its deeper 45 % not seen in some epochs, and what
    all of it changed by (k,) [m]."""
    shape = np.linspace(0.0, 2.0, 100)
    changes = -1e-4 * years[:, None] * shape
    whole = changes.mean(axis=1)
    changes[list(unseen), 55:] = np.nan
    return changes, whole


@pytest.mark.parametrize("unseen", [(2,), (4,), (1, 3)])
def test_an_epoch_that_saw_the_shallow_part_tells_no_slower_course(unseen: tuple[int, ...]) -> None:
    years, sigma = np.arange(1.0, 6.0), 1e-5
    changes, whole = bowl(years, unseen)
    seen = np.nanmean(changes, axis=1)
    assert fit_course(years, seen, np.full(5, sigma), 0.7 * sigma).model == "irregular"
    missed = missed_by_unseen(changes, np.ones(100))
    assert np.abs(seen + missed - whole)[list(unseen)] == pytest.approx(0.0, abs=np.abs(missed).max())
    assert (np.abs(seen + missed - whole) <= 1.96 * np.abs(missed)).all()
    course = fit_course(years, seen + missed, np.hypot(sigma, missed), 0.7 * sigma)
    assert course.model == "steady"
    assert abs(course.rate + 1e-4) < 1.96 * course.sigma_rate


def test_what_all_epochs_saw_misses_nothing_and_parts_that_nobody_else_saw_tell_nothing() -> None:
    changes, _ = bowl(np.arange(1.0, 4.0), ())
    np.testing.assert_array_equal(missed_by_unseen(changes, np.ones(100)), np.zeros(3))
    changes[0, :50], changes[1:, 50:] = np.nan, np.nan
    assert np.isnan(missed_by_unseen(changes, np.ones(100))[0])
    alone = np.where([[True] * 60 + [False] * 40], changes[:1], np.nan)
    alone[0, :60] = -1e-4
    np.testing.assert_array_equal(missed_by_unseen(alone, np.ones(100)), [0.0])


def test_what_merged_into_another_is_measured_until_then(rng: np.random.Generator) -> None:
    """From there on the other one tells of it; both told would count it twice."""
    changes, inside = simulate_series(rng, YEARS, -1e-4 * square(0.02)), square(0.02)
    side = lay_bare(plane(), changes[0].comparison.registration)
    measured = [
        measure_footprint(Followed(1, -1.0, inside, inside, merged_into=into, merged_at=at), changes,
                          [find_bodies(c, side) for c in changes], side, np.full(len(inside), 0.5), YEARS)
        for into, at in ((0, None), (2, 6))
    ]  # fmt: skip
    assert np.isfinite(measured[0].means).all()
    np.testing.assert_array_equal(measured[1].means[:6], measured[0].means[:6])
    for told in (measured[1].means, measured[1].sigmas, *measured[1].volumes.T):
        assert np.isnan(told[6:]).all()
        assert np.isfinite(told[:6]).all()
