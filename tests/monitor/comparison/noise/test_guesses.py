"""What surfaces guess between their points counts as stated, and along a moulding as often as the moulding is long."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from sheets_with_mouldings import GUESSED, NOISE, N, along_one, compared, mouldings
from stated_side import side_of

from monitor import blocks as blocks_of_vertices
from monitor.comparison.noise import guesses
from monitor.comparison.noise.correlation import Correlation
from monitor.comparison.noise.guesses import (
    areas_of_guesses,
    is_smooth,
    mean_to_samples,
    sigma_of_guess,
    split_stated,
    usual_sigma,
)
from monitor.comparison.noise.model import Noise
from monitor.comparison.noise.strata import N_STRATA
from monitor.comparison.regions import finding as regions
from monitor.comparison.regions.finding import known_of, lies_beyond_guesses, significant
from projects.model import Assessment, Bools, Roughness

SMOOTH, MEDIUM, ROUGH = Roughness.SMOOTH, Roughness.MEDIUM, Roughness.ROUGH


def test_a_guess_is_what_exceeds_twice_the_usual_where_it_is_not_smooth() -> None:
    side = side_of([0.5, 1.0, 3.0, 3.0, np.inf], [ROUGH, ROUGH, SMOOTH, MEDIUM, SMOOTH])
    noise2, guess2 = split_stated(side, 0.5)
    assert noise2 == pytest.approx([0.25, 1.0, 9.0, 1.0, np.inf])
    assert guess2 == pytest.approx([0.0, 0.0, 0.0, 8.0, 0.0])
    assert split_stated(side, 0.5, np.array([3]))[1] == pytest.approx([8.0])
    assert split_stated(side, np.inf)[1] == pytest.approx(np.zeros(5))
    assert split_stated(side_of([np.inf], [ROUGH]), 0.5)[1].tolist() == [np.inf]  # not assessed, and no warning


def test_a_place_is_smooth_where_both_epochs_say_so_or_the_one_that_knows() -> None:
    assert is_smooth(side_of([1.0] * 3, [SMOOTH, SMOOTH, ROUGH], [SMOOTH, MEDIUM, SMOOTH])).tolist() == [1, 0, 0]
    assert is_smooth(side_of([1.0] * 2, None, [SMOOTH, MEDIUM])).tolist() == [1, 0]
    assert is_smooth(side_of([1.0] * 2, [SMOOTH, MEDIUM], None)).tolist() == [1, 0]
    assert is_smooth(side_of([1.0] * 2, None)).tolist() == [0, 0]
    without_foot = side_of([1.0, 1.0], [SMOOTH, ROUGH], [ROUGH, ROUGH])
    without_foot.foot_vertices = np.array([-1, -1])
    assert is_smooth(without_foot, np.array([0, 1])).tolist() == [1, 0]


def test_the_usual_is_the_median_of_what_is_stated_of_the_assessed_vertices_of_both_sides() -> None:
    first, second = side_of([9.0, 1.0, 2.0], None), side_of([3.0, 4.0, 5.0], None)
    first.is_assessed[0] = False
    assert usual_sigma((first, second)) == 3.0
    first.is_assessed[:] = second.is_assessed[:] = False
    assert usual_sigma((first, second)) == np.inf


@pytest.mark.parametrize(("smooth", "n_rough", "usual"), [(1.4, 19, 1.4), (1.4, 20, 3.0), (1.6, 19, 3.0)])
def test_the_usual_is_that_of_smooth_places_where_most_is_a_guess(smooth: float, n_rough: int, usual: float) -> None:
    """One smooth vertex of twenty says what is usual, of 21 not; nor where most state no more than twice that."""
    kinds = [SMOOTH] + [ROUGH] * n_rough
    sides = side_of([smooth] + [3.0] * n_rough, kinds), side_of([smooth] + [3.0] * n_rough, kinds)
    assert usual_sigma(sides) == usual
    sides[0].is_assessed[0] = sides[1].is_assessed[0] = False
    assert usual_sigma(sides) == 3.0


def test_a_guess_counts_as_stated_or_more_and_the_rest_is_scaled() -> None:
    def noise(scale: float) -> Noise:
        """Return a noise that scales all by so much."""
        scales = np.full(N_STRATA, scale)
        return Noise(np.zeros(N_STRATA), *[scales] * 3, Correlation(np.zeros(1), np.ones(1)), 1.0, usual=0.5)

    side = side_of([0.5, 3.0], [ROUGH] * 2)
    noise2, guess2 = noise(0.1).parts_of(side)
    assert noise2 == pytest.approx([0.01 * 0.25, 0.01 * 1.0])
    assert guess2 == pytest.approx([0.0, 8.0])
    assert noise(0.1).variance_of(side) == pytest.approx([0.01 * 0.25, 0.01 * 9.0])  # of a level: all is scaled
    assert np.add(*noise(3.0).parts_of(side)) == pytest.approx([9.0 * 0.25, 9.0 * 9.0])  # stable areas show more


X, Y = (c.ravel() for c in np.meshgrid(np.arange(0.005, 1.0, 0.01), np.arange(0.005, 1.0, 0.01)))


def mean_of(held: Bools, guessed: Bools) -> float:
    """Return the sigma of the mean over what is `held` of a square of 1 m, of which 2 is a guess where `guessed`; units
    are 0.1 m long."""
    points = np.column_stack([X, Y, np.zeros(len(X))])[held]
    areas = np.full(len(points), 1e-4)
    return sigma_of_guess(points, areas, np.where(guessed[held], 4.0, 0.0), 0.1) / max(float(areas.sum()), 1e-300)


def test_a_strip_keeps_all_of_a_guess_and_a_square_what_its_rows_keep() -> None:
    all_of_it = np.ones(len(X), dtype=bool)
    assert mean_of(Y < 0.1, all_of_it) == pytest.approx(2.0, rel=1e-3)  # 1 m long
    assert mean_of(Y < 0.4, all_of_it) == pytest.approx(1.0, rel=1e-2)  # four rows
    assert mean_of(Y < 0.01, all_of_it) == pytest.approx(2.0)
    assert mean_of(Y < 0.0, all_of_it) == 0.0
    assert mean_of(Y < 0.4, ~all_of_it) == 0.0


def test_one_row_of_ten_brings_a_tenth_of_its_guess_into_the_mean() -> None:
    one = Y < 0.1
    assert mean_of(Y < 2.0, one) == pytest.approx(0.2, rel=1e-2)  # diluted, and not by the root of ten once more
    alone, beside = (mean_of(held, one) * held.sum() for held in (one, Y < 0.3))
    assert beside == pytest.approx(alone, rel=1e-2)  # of the sum: a margin that guesses nothing takes nothing off


def test_a_frame_is_as_wide_as_its_moulding_and_not_as_its_opening() -> None:
    frame = (np.minimum(X, 1.0 - X) < 0.1) | (np.minimum(Y, 1.0 - Y) < 0.1)
    assert mean_of(frame, frame) > 1.0  # of 2, by its extent alone 0.6


def test_a_level_knows_how_much_of_what_is_stated_shows_where_much_is(rng: np.random.Generator) -> None:
    error = np.where(mouldings(), rng.normal(scale=0.3 * np.sqrt(2.0) * GUESSED, size=(N, N)), 0.0)
    side = compared(rng, error).on_compared
    on, known = mouldings().ravel(), np.isfinite(side.lod95)
    beyond = np.abs(side.distances) > side.lod95
    assert 0.03 < beyond[on & known].mean() < 0.08  # by one scale of all that is stated 0
    assert 0.03 < beyond[~on & known].mean() < 0.07


def test_a_moulding_that_errs_by_what_it_states_is_no_region(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = rng.bit_generator.state
    change = along_one(-1.2 * GUESSED)
    found = compared(rng, change)
    assert not len(found.regions)
    for side in (found.on_reference, found.on_compared):  # nor is it unchanged
        assert np.mean(side.assessment[change.ravel() != 0.0] == Assessment.NOT_ASSESSABLE) > 0.8
    monkeypatch.setattr(guesses, "FARTHER", np.inf)  # all scaled to what the rest of the sheet and of mouldings show
    rng.bit_generator.state = state
    assert len(compared(rng, change).regions) == 1


def test_hardly_a_guess_is_beyond_half_of_the_way_to_the_samples_and_its_own_margin() -> None:
    side, region = side_of([1.0] * 4, None), np.ones(4, dtype=np.int64)
    side.areas = np.ones(4)
    side.surface.sample_distance, side.other.sample_distance = np.full(4, 1.5), np.full(4, 2.5)
    for mean, z, known in ((-2.05, 2.0, True), (2.05, 2.0, True), (-1.95, 2.0, False), (-2.05, 1.9, False),
                           (-2.05, np.nan, False)):  # fmt: skip
        told = lies_beyond_guesses(pd.DataFrame({"mean_m": [mean]}), (side, side), (region, region), np.array([z]))
        assert told.tolist() == [known], (mean, z)


@pytest.mark.parametrize(("points", "way", "n_told"), [(True, 0.8, 1), (True, 4.4, 0), (False, 0.8, 0)])
def test_a_moulding_near_its_samples_is_known_where_points_bear_it_out(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, points: bool, way: float, n_told: int
) -> None:
    monkeypatch.setattr(regions, "known_of", lambda table, *_: np.zeros(len(table), dtype=np.bool_))
    found = compared(rng, along_one(-4.0 * GUESSED), way * GUESSED, points=points)
    assert list(found.regions["kind"]) == ["lost"] * n_told


def test_the_way_to_the_samples_is_that_of_both_surfaces_in_the_mean_over_what_is_assessed_of_both() -> None:
    first, second = side_of([1.0] * 5, None), side_of([1.0] * 4, None)
    first.areas, second.areas = np.array([1.0, 3.0, 1.0, 1.0, 1.0]), np.ones(4)
    first.surface.sample_distance = second.other.sample_distance = np.array([1.0, 2.0, 5.0, 4.0, 1.0])
    second.surface.sample_distance = first.other.sample_distance = np.array([0.5, 0.25, 9.0, 1.0])
    first.foot_vertices, second.foot_vertices = np.array([0, 1, 2, -1, 0]), np.array([1, 0, 0, 0])
    first.is_assessed[2] = False
    numbers = np.array([1, 1, 1, 2, 3]), np.array([1, 0, 4, 2])
    way = mean_to_samples((first, second), numbers, 5)
    assert way[0] == pytest.approx((1.0 * 1.5 + 3.0 * 2.25 + 1.0 * 2.5) / 5.0)
    assert way[1:].tolist() == [np.inf] * 4  # without a foot, of the one side or the other alone, without a vertex
    second.surface.sample_distance = first.other.sample_distance = None
    assert mean_to_samples((first, second), numbers, 5).tolist() == [np.inf] * 5


def test_a_moulding_that_lost_many_times_what_it_states_is_a_region(rng: np.random.Generator) -> None:
    found = compared(rng, along_one(-12.0 * GUESSED)).regions
    assert list(found["kind"]) == ["lost"]
    assert found.iloc[0].mean_m == pytest.approx(-12.0 * GUESSED, abs=2.0 * found.iloc[0].sigma_mean_m)
    told = np.sqrt(2.0 * (GUESSED**2 - (2.0 * NOISE) ** 2))  # both surfaces guess; a fifth of the region is its flanks
    of_volume = found.iloc[0].sigma_volume_m3 / found.iloc[0].area_m2
    assert of_volume == pytest.approx(found.iloc[0].sigma_mean_m, rel=0.5)
    assert found.iloc[0].sigma_mean_m == pytest.approx(0.9 * told, rel=0.15)  # by the noise's correlation a tenth


def guessing_sides(n: int) -> tuple[Any, Any]:
    """Return sides of n vertices of 1 m2, of which the first 50 are guesses in either, and smooth ones."""
    kinds = [ROUGH] * 50 + [SMOOTH] * (n - 50)
    sides = side_of([3.0] * n, kinds), side_of([3.0] * n, kinds)
    for side in sides:
        side.areas = np.ones(n)
    return sides


def test_a_region_is_known_beyond_three_sigmas_where_it_is_significant_among_the_places_of_guesses() -> None:
    """One m2 of guesses among 50 asks for 3.29 sigmas, ten among 50 for 2.58, and then for three."""
    sides, region = guessing_sides(2000), np.zeros(2000, dtype=np.int64)
    region[:10], region[10], region[50:60] = 1, 2, 3
    table = pd.DataFrame({"area_m2": [10.0, 1.0, 10.0]})
    gone = np.zeros(3, dtype=np.bool_)
    for z, known in ((2.9, [False, False, False]), (3.1, [True, False, False]), (3.4, [True, True, False]),
                     (4.1, [True, True, True])):  # fmt: skip
        found = known_of(table, sides, (region, region), np.full(3, z), 1.0, gone, 0.05)
        assert found.tolist() == known, z
    table = pd.DataFrame({"area_m2": [2000.0, 1.0, 10.0]})  # all there is: one place
    assert known_of(table, sides, (region, region), np.full(3, 2.5), 1.0, gone, 0.05).tolist() == [True, False, False]
    gone[2] = True
    assert known_of(table, sides, (region, region), np.full(3, 1.0), 1.0, gone, 0.05).tolist() == [False, False, True]


def test_a_mean_is_significant_among_as_many_places_as_there_is_room_for() -> None:
    table = pd.DataFrame({"area_m2": [1e-3, 1e-3, 1.0, 1.0]})
    z, gone = np.array([4.0, 4.1, 1.9, 2.0]), np.zeros(4, dtype=np.bool_)
    assert significant(table, 1.0, z, gone, 0.05).tolist() == [False, True, False, True]  # 4.06 sigmas, or 1.96
    gone[0] = True
    assert significant(table, 1.0, z, gone, 0.05).tolist() == [True, True, False, True]


@pytest.mark.parametrize("block", [2, 1000])
def test_places_of_guesses_are_counted_by_their_area_on_the_side_that_has_more(
    monkeypatch: pytest.MonkeyPatch, block: int
) -> None:
    monkeypatch.setattr(blocks_of_vertices, "BLOCK", block)
    kinds = [ROUGH, ROUGH, ROUGH, SMOOTH]
    few, more = side_of([1.9, 2.1, 1.0, 9.0], kinds), side_of([9.0, 9.0, 9.0, 9.0], kinds)
    for side in (few, more):
        side.areas = np.array([1.0, 2.0, 4.0, 8.0])
    more.is_assessed[2] = False
    region = np.array([0, 2, 1, 1])
    total, within = areas_of_guesses((few, more), 1.0, (region, region), 2)
    assert total == 3.0
    assert within.tolist() == [0.0, 2.0]
    total, within = areas_of_guesses((few, few), 1.0, (region, region), 2)
    assert total == 2.0
