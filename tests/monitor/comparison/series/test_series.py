"""Trends against closed forms and simulated courses; identities of regions that grow, split, merge and sleep."""

from __future__ import annotations

import dataclasses
import datetime
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import trimesh

from monitor.comparison import compare
from monitor.comparison.series.epoch_change import EpochChange
from monitor.comparison.series.follow import follow
from monitor.comparison.series.identity import follow_regions, sign_of_regions
from monitor.comparison.series.trend import fit_course, fit_polynomial, predict
from projects.errors import ComparisonError, ParameterError
from projects.model import ComparedSurface, Floats, Registration, Surface


def test_rate_of_one_epoch_is_the_difference_over_the_time() -> None:
    fit = fit_polynomial(np.array([2.0]), np.array([[0.004]]), np.array([[0.0005]]), np.array([0.0003]))
    assert fit.parameters[0, 1] == pytest.approx(0.002, rel=1e-12)
    assert np.sqrt(fit.covariance[0, 1, 1]) == pytest.approx(0.0005 / 2.0, rel=1e-12)


def test_error_of_the_reference_is_common_to_all_differences() -> None:
    """Generalized least squares with the full covariance of the differences, written out."""
    years, sigma, own = np.array([1.0, 2.5, 4.0]), np.array([5e-4, 7e-4, 6e-4]), 4e-4
    covariance = np.diag(sigma**2 - own**2) + own**2
    design = years[:, None]
    expected = np.sqrt(1.0 / (design.T @ np.linalg.inv(covariance) @ design)[0, 0])
    fit = fit_polynomial(years, np.zeros((3, 1)), sigma[:, None], np.array([own]))
    assert np.sqrt(fit.covariance[0, 1, 1]) == pytest.approx(expected, rel=1e-9)
    independent = np.sqrt(1.0 / (years**2 / sigma**2).sum())
    assert abs(expected / independent - 1.0) > 0.05  # the nearest wrong formula


def test_unknown_epochs_do_not_count_and_too_few_give_nan() -> None:
    years = np.array([1.0, 2.0, 3.0])
    values = np.array([[1e-3, np.nan], [np.nan, np.nan], [3e-3, np.nan]])
    fit = fit_polynomial(years, values, np.full((3, 2), 1e-4), np.full(2, 5e-5))
    assert fit.parameters[0, 1] == pytest.approx(1e-3, rel=1e-9)
    assert np.isnan(fit.parameters[1]).all()


def draw_course(rng: np.random.Generator, truth: Floats, sigma: float, own: float) -> Floats:
    return truth + rng.normal(0, np.sqrt(sigma**2 - own**2), len(truth)) - rng.normal(0, own)


def test_rates_hold_the_truth_and_steady_courses_seldom_look_otherwise(rng: np.random.Generator) -> None:
    years, sigma, own = np.array([0.7, 1.9, 3.0, 4.2, 5.5]), 4e-4, 2.5e-4
    courses = [
        fit_course(years, draw_course(rng, 5e-4 * years, sigma, own), np.full(5, sigma), own, seed=k)
        for k in range(150)
    ]
    inside = np.mean([abs(c.rate - 5e-4) < 1.96 * c.sigma_rate for c in courses])
    assert 0.90 <= inside <= 0.99
    assert np.mean([c.p_onset <= 0.05 for c in courses]) <= 0.10  # 5 % is promised; 150 courses
    assert np.mean([c.p_acceleration <= 0.05 for c in courses]) <= 0.10
    assert np.mean([c.model == "irregular" for c in courses]) <= 0.05  # 1 % is promised


@pytest.mark.parametrize("means", [(-5, -5, 0), (-4, -6, -5, -1), (-5, -0.5), (-3, -3, -6, -6)])
def test_what_comes_and_goes_or_jumps_twice_has_no_one_course(means: tuple[float, ...]) -> None:
    """In tenths of a millimetre, known to 0.02 mm: neither a jump nor a rate tells a change that was undone."""
    values = 1e-4 * np.array(means, dtype=float)
    course = fit_course(np.arange(1.0, len(means) + 1.0), values, np.full(len(means), 2e-5), 1e-5)
    assert course.model == "irregular"
    assert np.isnan(course.onset).all()


def test_one_epoch_tells_no_course() -> None:
    course = fit_course(np.array([1.0, 4.0]), np.array([-3e-4, np.nan]), np.array([1e-5, np.nan]), 5e-6)
    assert course.model == "single"


def test_onset_jump_and_acceleration_are_told_apart(rng: np.random.Generator) -> None:
    years, sigma, own = np.arange(1.0, 9.0), 2e-4, 1e-4
    after = np.maximum(years - 4.0, 0.0) * 1e-3
    late = fit_course(years, draw_course(rng, after, sigma, own), np.full(8, sigma), own)
    assert late.model == "onset"
    assert late.onset[0] <= 4.0 <= late.onset[1]
    at_once = fit_course(years, draw_course(rng, 2e-3 * (years >= 6.0), sigma, own), np.full(8, sigma), own)
    assert (at_once.model, at_once.onset) == ("jump", (5.0, 6.0))
    bent = fit_course(years, draw_course(rng, 1e-4 * years**2, sigma, own), np.full(8, sigma), own)
    assert abs(bent.acceleration - 2e-4) < 3.0 * bent.sigma_acceleration
    assert bent.p_acceleration < 0.01
    still = fit_course(years, draw_course(rng, np.zeros(8), sigma, own), np.full(8, sigma), own)
    assert still.model == "none"


def test_prediction_band_holds_the_next_epoch_in_95_per_cent(rng: np.random.Generator) -> None:
    years, sigma, own = np.array([1.0, 2.0, 3.0, 4.0, 6.0]), 3e-4, 2e-4
    hits = 0
    for _ in range(400):
        course = draw_course(rng, 3e-4 * years, sigma, own)
        mean, band = predict(years[:4], course[:4], np.full(4, sigma), own, years[4:])
        hits += abs(course[4] - mean[0]) < 1.96 * band[0]
    assert 0.925 <= hits / 400 <= 0.975


def test_times_that_do_not_ascend_are_refused() -> None:
    with pytest.raises(ParameterError, match="ascending"):
        fit_polynomial(np.array([2.0, 1.0]), np.zeros((2, 1)), np.ones((2, 1)), np.zeros(1))


def stripe(region: list[int]) -> ComparedSurface:
    """Return a surface of ten places in a row, each in a region or in none (0)."""
    x = np.arange(10.0)
    surface = Surface(np.column_stack([x, x * 0, x * 0]), np.array([[0, 1, 2]]))
    number = np.array(region, dtype=np.int32)
    return ComparedSurface(surface, np.zeros(10), np.ones(10), np.where(number, 2, 1).astype(np.uint8), number,
                           np.zeros(10, dtype=np.uint8))  # fmt: skip


def test_a_region_whose_mean_is_not_known_goes_on_by_the_sign_of_its_extreme() -> None:
    table = pd.DataFrame({"region": [1, 2, 3], "mean_m": [np.nan, 2e-3, np.nan], "extreme_m": [-0.03, -4e-3, np.nan]})
    signs = sign_of_regions(SimpleNamespace(regions=table))  # type: ignore[arg-type]
    np.testing.assert_array_equal(signs, [0.0, -1.0, 1.0, np.nan])
    side = stripe([1, 1, 1, 0, 0, 0, 0, 0, 0, 0])
    assert len(follow_regions([side.changed_region] * 2, [signs[:2]] * 2, np.ones(10))) == 1


def test_regions_split_merge_and_sleep_without_losing_their_history() -> None:
    sides = [
        stripe([1, 1, 1, 1, 1, 0, 0, 2, 2, 0]),
        stripe([0, 0, 0, 0, 0, 0, 0, 1, 1, 1]),  # the first sleeps
        stripe([2, 2, 2, 0, 1, 0, 0, 3, 3, 3]),  # and wakes as two
        stripe([1, 1, 1, 1, 1, 1, 1, 1, 1, 1]),  # all are one
    ]
    signs = [np.array([0.0, *[-1.0] * int(s.region.max())]) for s in sides]
    found = follow_regions([s.changed_region for s in sides], signs, np.ones(10))
    assert [f.identity for f in found] == [1, 2, 3]
    assert found[0].numbers == {0: 1, 2: 2, 3: 1} or found[1].numbers == {0: 2, 1: 1, 2: 3, 3: 1}
    assert found[2].parent == 1
    assert found[2].events[2] == "split from 1"
    survivors = [f for f in found if 3 in f.numbers]
    assert len(survivors) == 1
    assert {f.merged_into for f in found if f not in survivors} == {survivors[0].identity}
    assert survivors[0].footprint.all()


def test_gain_and_loss_in_one_place_are_not_the_same_region() -> None:
    sides = [stripe([1] * 5 + [0] * 5), stripe([1] * 5 + [0] * 5)]
    found = follow_regions(
        [s.changed_region for s in sides], [np.array([0.0, -1.0]), np.array([0.0, 1.0])], np.ones(10)
    )
    assert [f.sign for f in found] == [-1.0, 1.0]


def worn_sphere(rng: np.random.Generator, depth: float) -> Surface:
    """Return a sphere of 0.1 m with noise, worn around +z by `depth` [m] and grown around -z by half of it."""
    mesh = trimesh.creation.icosphere(subdivisions=5)
    angle = np.arccos(np.clip(mesh.vertices[:, 2], -1, 1))
    bump = np.where(angle < 0.5, 0.5 * (1 + np.cos(np.pi * angle / 0.5)), 0.0)
    other = np.where(np.pi - angle < 0.3, 0.5 * (1 + np.cos(np.pi * (np.pi - angle) / 0.3)), 0.0)
    radius = 0.1 - depth * bump + 0.5 * depth * other + rng.normal(0, 5e-5, len(angle))
    return Surface(mesh.vertices * radius[:, None], mesh.faces, sigma=np.full(len(angle), 5e-5))


def still(surface: Surface) -> Registration:
    return Registration(np.eye(4), np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                        is_stable=np.ones(len(surface.vertices), dtype=bool))  # fmt: skip


@pytest.fixture(scope="module")
def worn_series():
    rng = np.random.default_rng(5)
    reference = worn_sphere(rng, 0.0)
    start = datetime.date(2020, 1, 1)
    changes = []
    for year in (4, 1, 2, 3):
        later = worn_sphere(rng, 5e-4 * year)
        date = start + datetime.timedelta(days=round(365.25 * year))
        changes.append(EpochChange(f"y{year}", date, compare(reference, later, still(later))))
    return follow(changes, "y0", start), changes, start


def test_wear_of_a_sphere_is_followed_with_its_rate(worn_series) -> None:
    series, changes, _ = worn_series
    assert series.epoch_ids == ("y1", "y2", "y3", "y4")
    top = int(np.argmin(series.rate))
    assert series.rate[top] == pytest.approx(-5e-4, abs=3.0 * series.sigma_rate[top])
    assert series.sigma_rate[top] < 5e-5
    worn = series.regions[series.regions["rate_m_per_year"] < 0]
    grown = series.regions[series.regions["rate_m_per_year"] > 0]
    assert len(worn) == len(grown) == 1
    assert worn.iloc[0].z > 0.09 > -0.09 > grown.iloc[0].z
    assert worn.iloc[0].model in ("steady", "accelerating")
    history = series.history[series.history["identity"] == worn.iloc[0].identity]
    assert (np.diff(history["mean_m"]) < 0).all()
    assert history["mean_m"].iloc[3] / history["mean_m"].iloc[0] == pytest.approx(4.0, rel=0.1)
    last = changes[0].comparison.regions.iloc[int(history["region"].iloc[3]) - 1]
    assert history["change_m3"].iloc[3] == last["volume_m3"]
    assert history["area_m2"].iloc[3] == last["area_m2"]
    assert history["sigma_area_m2"].iloc[3] == last["sigma_area_m2"]
    angle = np.linspace(0.0, 0.5, 2001)  # of a bowl: 2 pi r2 times the integral of depth over the solid angle
    truth = -2 * np.pi * 0.1**2 * np.trapezoid(5e-4 * 0.5 * (1 + np.cos(np.pi * angle / 0.5)) * np.sin(angle), angle)
    np.testing.assert_allclose(history["change_m3"], truth * np.arange(1, 5), rtol=0.06)


def test_rates_of_unchanged_vertices_are_as_sure_as_they_say(worn_series) -> None:
    series, _, _ = worn_series
    unchanged = (series.identity == 0) & np.isfinite(series.rate)
    inside = np.mean(np.abs(series.rate[unchanged]) < 1.96 * series.sigma_rate[unchanged])
    assert 0.92 <= inside <= 0.985


def test_series_of_other_reference_surfaces_or_equal_dates_are_refused(worn_series) -> None:
    _, changes, start = worn_series
    moved = dataclasses.replace(changes[0].side, surface=worn_sphere(np.random.default_rng(9), 0.0))
    other = dataclasses.replace(changes[0], comparison=dataclasses.replace(changes[0].comparison, on_reference=moved))
    with pytest.raises(ComparisonError, match="another surface"):
        follow([other, *changes[1:]], "y0", start)
    with pytest.raises(ComparisonError, match="different one"):
        follow([changes[0], dataclasses.replace(changes[1], date=changes[0].date)], "y0", start)
    with pytest.raises(ComparisonError, match="two or more"):
        follow(changes[:1], "y0", start)


def test_what_makes_no_series_is_refused_by_name(worn_series) -> None:
    """A level of 2 or NaN went through, and two epochs of one id were one in the table; dates ended in a TypeError."""
    _, changes, start = worn_series
    for level in (0.0, 2.0, float("nan"), True):
        with pytest.raises(ParameterError, match=r"level .* a share above 0 and up to 0.5"):
            follow(changes, "y0", start, level=level)
    with pytest.raises(ParameterError, match="seed -1"):
        follow(changes, "y0", start, seed=-1)
    with pytest.raises(ParameterError, match="change 1 of a series is a Comparison; a EpochChange is needed"):
        follow([c.comparison for c in changes], "y0", start)  # type: ignore[misc]
    for date in (datetime.datetime(2019, 1, 1), "2019-01-01"):
        with pytest.raises(ParameterError, match=r"a datetime\.date is needed"):
            follow(changes, "y0", date)  # type: ignore[arg-type]
    with pytest.raises(ComparisonError, match="a different id for each"):
        follow([changes[0], dataclasses.replace(changes[1], epoch_id=changes[0].epoch_id)], "y0", start)


def test_a_series_of_both_modes_is_refused(worn_series) -> None:
    """A body that stood 0.5 mm higher in all epochs came and went with the mode: 0.43 mm, "irregular"."""
    changes, start = worn_series[1], worn_series[2]
    absolute = dataclasses.replace(changes[1].comparison, mode="absolute")
    mixed = [changes[0], dataclasses.replace(changes[1], comparison=absolute), *changes[2:]]
    with pytest.raises(ComparisonError, match=r"modes y1 absolute, y2 relative, .* a series needs one for all"):
        follow(mixed, "y0", start)


def test_tables_have_their_columns(worn_series) -> None:
    series, _, _ = worn_series
    assert isinstance(series.regions, pd.DataFrame)
    assert len(series.history) == 4 * len(series.regions)
