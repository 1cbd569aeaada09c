"""Regions that no single epoch shows and all epochs together do: their identity, their figures, and what becomes of
those that epochs found a part of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_series import START, STEP, YEARS, plane, simulate_series, square

from monitor.comparison.series.follow import follow
from monitor.comparison.series.identity import Followed, follow_rates
from monitor.comparison.series.rate_regions import RateRegions
from projects.model import Series
from reports.courses import tell_series

RATE = 1e-4  # m/year
MOVING = square(0.025)
AREA = float(MOVING.sum()) * STEP**2


@pytest.fixture(scope="module")
def bulging() -> Series:
    """Ten years of a bulge of 50 x 50 mm, 0.1 mm a year, in epochs that are known to 1 mm each."""
    return follow(simulate_series(np.random.default_rng(11), YEARS, RATE * MOVING), "r", START)


def test_a_bulge_that_no_epoch_shows_is_one_region_found_by_its_trend(bulging: Series) -> None:
    assert len(bulging.regions) == 1
    row = bulging.regions.iloc[0]
    assert (row.identity, row.found_by, row.first_seen, row.last_seen, row.model) == (1, "trend", "", "", "steady")
    assert abs(row.rate_m_per_year - RATE) < 1.96 * row.sigma_rate_m_per_year
    assert row.sigma_rate_m_per_year == pytest.approx(1e-5, rel=0.4)  # 3.4e-5 of a vertex, over some 12 witnesses
    assert row.area_m2 == pytest.approx(AREA, rel=0.15)
    assert row.volume_rate_m3_per_year == pytest.approx(row.rate_m_per_year * row.area_m2, rel=1e-9)
    assert np.hypot(row.x, row.y) < 0.004
    inside = bulging.identity == 1
    assert inside[MOVING].mean() > 0.8
    assert (inside == (bulging.rate_assessment == 2)).all()


def test_its_history_holds_every_epoch_and_says_how_it_was_found(bulging: Series) -> None:
    history = bulging.history
    assert (history["region"] == 0).all()
    assert history[["area_m2", "sigma_area_m2"]].isna().all(axis=None)
    assert list(history["event"]) == [""] * 9 + ["found by its trend"]
    late = history.iloc[-1]
    assert abs(late.mean_m - 1e-3) < 2.5 * late.sigma_mean_m
    assert late.change_m3 == pytest.approx(late.mean_m * bulging.regions["area_m2"].iloc[0], rel=1e-9)
    assert len(bulging.forecast) > 0


def test_the_report_says_that_no_single_epoch_shows_it(bulging: Series) -> None:
    told = tell_series(bulging)
    assert told.lead.endswith(" on changing. No single epoch shows it: all epochs together do, by its trend.")
    assert told.courses[0].first_seen == "by its trend alone"
    assert told.courses[0].volume_rate.unit == "cm³/year"
    older = bulging.regions.drop(columns=["found_by", "volume_rate_m3_per_year", "sigma_volume_rate_m3_per_year"])
    object.__setattr__(bulging, "regions", older.assign(first_seen="e1"))
    told = tell_series(bulging)
    assert "No single epoch" not in told.lead
    assert told.courses[0].volume_rate.value == "not known"


def test_rates_of_regions_found_by_their_trend_are_as_sure_as_they_say(rng: np.random.Generator) -> None:
    """Of what was chosen for being large, a little is chance: nine in ten are asked for, of 95 in a hundred."""
    n, inside = 20, 0
    for _ in range(n):
        row = follow(simulate_series(rng, YEARS, 2.0 * RATE * MOVING), "r", START).regions.iloc[0]
        inside += abs(row.rate_m_per_year - 2.0 * RATE) < 2.58 * row.sigma_rate_m_per_year
    assert inside >= 18


def test_a_series_says_from_how_large_a_rate_on_one_is_told_and_where_surfaces_guess(rng: np.random.Generator) -> None:
    """A strip of 10 mm states ten times what the rest does: a guess, which must be three sigmas as wide as it is."""
    strip = np.abs(plane().vertices[:, 0]) < 0.005
    changes, more = [], np.where(strip, 10.0, 1.0)
    for c in simulate_series(rng, YEARS):
        surface = replace(c.side.surface, sigma=np.full(len(strip), 1e-4))  # no finished mesh
        side = replace(c.side, surface=surface, lod95=more * c.side.lod95, distances=more * c.side.distances)
        changes.append(replace(c, comparison=replace(c.comparison, on_reference=side)))
    series = follow(changes, "r", START)
    told, sigma = series.rate_told_from, series.sigma_rate
    assert told is not None
    level = series.statistics["told_from_median_m_per_year"]
    assert level == pytest.approx(4.0 * np.median(sigma[~strip]), rel=0.15)  # 6.0 of a patch, which keeps two thirds
    assert np.median(told[~strip]) == pytest.approx(level, rel=0.05)
    assert np.nanmin(told[strip]) > 3.0 * 0.9 * np.median(sigma[strip])
    assert np.nanmax(told[strip]) < 5.0 * np.median(sigma[strip])
    assert series.statistics["coarse_from_m_per_year"] == pytest.approx(4.0 * level)
    is_coarse = told > 4.0 * level
    assert is_coarse[strip].all()
    assert np.abs(plane().vertices[is_coarse, 0]).max() < 0.016  # no farther than the units that hold some of it
    assert series.statistics["coarse_area_share"] == pytest.approx(is_coarse.mean(), rel=0.1)
    coarse = series.statistics["coarse_told_from_m_per_year"]
    assert np.nanmedian(told[strip]) <= coarse <= np.nanmax(told[strip])
    assert (np.isnan(told) == (series.rate_assessment == 0)).all()


def followed(identity: int, sign: float, at: slice) -> Followed:
    mask = np.zeros(20, dtype=bool)
    mask[at] = True
    return Followed(identity, sign, mask, mask.copy(), numbers={0: 1})


def rates_at(at: slice, mean: float) -> RateRegions:
    region = np.zeros(20, dtype=np.int32)
    region[at] = 1
    told = np.full(20, 1e-3)
    return RateRegions(region, (region + 1).astype(np.uint8), np.array([mean]), np.zeros(1), np.array([0.2]), told)


def test_a_region_that_epochs_and_rates_show_stays_one_and_is_found_by_both() -> None:
    (one,) = follow_rates([followed(1, 1.0, slice(2, 9))], rates_at(slice(2, 11), 1e-3), np.ones(20), 3)
    assert (one.identity, one.found_by, one.is_grown) == (1, "both", False)
    assert one.footprint.sum() == 7


def test_where_epochs_found_a_part_the_region_grows_to_what_its_rates_show() -> None:
    first, second = followed(1, 1.0, slice(4, 7)), followed(2, 1.0, slice(9, 11))
    out = follow_rates([first, second], rates_at(slice(2, 14), 1e-3), np.ones(20), 3)
    assert [f.identity for f in out] == [1, 2]
    assert out[0].is_grown
    np.testing.assert_array_equal(np.flatnonzero(out[0].footprint), [2, 3, 4, 5, 6, 7, 8, 11, 12, 13])
    assert out[1].footprint.sum() == 2
    assert {f.found_by for f in out} == {"both"}


@pytest.mark.parametrize(("at", "mean"), [(slice(12, 18), 1e-3), (slice(2, 9), -1e-3)])
def test_elsewhere_or_of_the_other_sign_it_is_another_region(at: slice, mean: float) -> None:
    old, new = follow_rates([followed(1, 1.0, slice(2, 9))], rates_at(at, mean), np.ones(20), 3)
    assert old.found_by == "epochs"
    assert (new.identity, new.found_by, new.sign, new.kept) == (2, "trend", np.sign(mean), 0.2)
    assert (new.numbers, new.events) == ({}, {3: "found by its trend"})
