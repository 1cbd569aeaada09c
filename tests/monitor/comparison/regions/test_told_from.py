"""How large a change must at least be to be told, place by place: the level of detection, or what no guess makes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.stats import norm
from sheets_with_mouldings import EDGE, GUESSED, NOISE, N, along_one, compared, mouldings
from stated_side import side_of

from monitor.comparison.noise.correlation import Correlation
from monitor.comparison.noise.guesses import SURE
from monitor.comparison.noise.model import Noise
from monitor.comparison.noise.strata import N_STRATA
from monitor.comparison.regions.finding import is_significant, sigmas_needed
from monitor.comparison.regions.told_from import (
    COARSE,
    add_told_from,
    coarse_beyond,
    coarse_figures,
    of_own_patch,
    quantile_by_area,
    tell_smallest,
)
from projects.model import Assessment, Comparison, Roughness

ROUGH, SMOOTH = Roughness.ROUGH, Roughness.SMOOTH
GUESS = np.sqrt(2.0 * (GUESSED**2 - (2.0 * NOISE) ** 2))  # m, of both surfaces on a moulding


def found_on(lod95: tuple[Any, Any], numbers: tuple[Any, Any], scale: float) -> Any:
    """Return what was detected as far as it matters: levels and units of both sides, and how stated noise is scaled."""
    scales = np.full(N_STRATA, scale)
    noise = Noise(np.zeros(N_STRATA), *[scales] * 3, Correlation(np.zeros(1), np.ones(1)), 1.0, usual=0.5)
    units = [SimpleNamespace(number=n, areas=np.ones(n.max() + 1)) for n in numbers]
    return SimpleNamespace(noise=noise, test=SimpleNamespace(units=units),
                           sides=[SimpleNamespace(lod95=level) for level in lod95])  # fmt: skip


@pytest.mark.parametrize("scale", [0.2, 3.0])
def test_a_guessed_place_tells_from_what_a_region_of_its_part_of_a_unit_must_have(scale: float) -> None:
    """Of 100 m2 60 are guessed: of unit 0 one, of unit 1 ten, of unit 2 the rest."""
    first = cast(Any, side_of([3.0] * 60 + [0.3] * 40, [ROUGH] * 60 + [SMOOTH] * 40))
    second = cast(Any, side_of([0.3] * 50, [SMOOTH] * 50))
    first.areas, second.areas = np.ones(100), np.ones(50)
    first.sigma_surfaces[1] = 5.0
    numbers = np.repeat([0, 1, 2, 0, 3], [1, 10, 49, 5, 35]), np.zeros(50, dtype=np.int64)
    levels = np.full(100, 0.01), np.full(50, 8.0)
    needs = np.tile([[0.1, 0.05]], (4, 1)), np.full((1, 2), 7.0)
    needs[0][2, 0] = 1000.0
    told = tell_smallest((first, second), found_on(levels, numbers, scale), needs, 0.05, are_points_asked=True)
    more = max(scale, 1.0)  # than what is stated: as regions hold it
    among = [norm.isf(0.025 / 60.0), norm.isf(0.025 * 10.0 / 100.0), norm.isf(0.025 * 49.0 / 100.0)]
    mean2 = [8.0, (9.0 * 8.0 + 24.0) / 10.0, 8.0]  # of the guessed vertices: 3.0 (one 5.0) beyond twice 0.5
    expected = [more * z * np.sqrt(g) for z, g in zip(among, mean2, strict=True)]
    assert told[0][[0, 1]] == pytest.approx(expected[:2], rel=1e-5)
    assert among[0] > SURE > among[1]
    assert expected[2] < 1000.0
    assert told[0][20] == 1000.0  # what its patch needs is more
    assert told[0][60:] == pytest.approx(0.1)  # nor does what a unit guesses elsewhere touch what is known
    assert told[1] == pytest.approx(7.0)


def test_a_scrap_tells_what_a_wider_patch_of_it_does_and_what_is_in_none_is_not_known() -> None:
    needs = np.array([[1.0, 0.5], [np.nan, 0.7], [np.nan, np.nan]])
    told = of_own_patch(np.array([0, 1, 2, -1]), needs)
    assert told.tolist() == pytest.approx([1.0, 0.7, np.nan, np.nan], nan_ok=True)
    assert told.dtype == np.float32


def test_three_sigmas_are_asked_of_what_is_half_of_all_that_is_guessed() -> None:
    side = cast(Any, side_of([3.0] * 4 + [0.3] * 996, [ROUGH] * 4 + [SMOOTH] * 996))
    side.areas = np.ones(1000)
    number = np.repeat([0, 1, 2], [2, 2, 996])
    found = found_on((np.full(1000, 0.1),) * 2, (number, number), 1.0)
    told = tell_smallest((side, side), found, (np.full((3, 1), 0.1),) * 2, 0.05, are_points_asked=True)
    assert told[0][:4] == pytest.approx(SURE * np.sqrt(8.0), rel=1e-5)


def test_a_guessed_place_near_to_samples_tells_from_half_the_way_to_them_or_its_own_margin() -> None:
    n, guess = 1000, np.sqrt(8.0)  # of vertices that state 3.0, beyond twice 0.5
    side = cast(Any, side_of([3.0] * 6 + [0.3] * (n - 6), [ROUGH] * 6 + [SMOOTH] * (n - 6)))
    side.areas = np.ones(n)
    side.surface.sample_distance = np.concatenate([[11.0, 13.0], [0.5, 0.5], [90.0, 90.0], np.full(n - 6, 0.01)])
    side.other.sample_distance = np.full(n, 2.0)
    number, levels, needs = np.repeat([0, 1, 2, 3], [2, 2, 2, n - 6]), np.full(n, 0.01), (np.full((4, 1), 0.1),) * 2
    found = found_on((levels, levels), (number, number), 1.0)
    told = tell_smallest((side, side), found, needs, 0.05, are_points_asked=True)
    assert told[0][:2] == pytest.approx(0.5 * 14.0, rel=1e-5)
    assert told[0][2:4] == pytest.approx(norm.isf(0.025) * guess, rel=1e-5)  # half of the way is 1.25
    assert told[0][4:6] == pytest.approx(SURE * guess, rel=1e-5)
    assert told[0][6:] == pytest.approx(0.1)
    unasked = tell_smallest((side, side), found, needs, 0.05, are_points_asked=False)
    assert unasked[0][[0, 2]] == pytest.approx(SURE * guess, rel=1e-5)


def test_figures_are_of_the_assessed_area(unchanged: Comparison) -> None:
    n = 4
    state, reasons = np.array([1, 1, 2, 0], np.uint8), np.array([0, 0, 0, 3], np.uint8)
    side = replace(unchanged.on_compared, assessment=state, lod95=np.array([1.0, 1.0, 2.0, 9.0]), reasons=reasons,
                   distances=np.zeros(n), region=np.zeros(n, np.int32))  # fmt: skip
    assert coarse_beyond(np.array([1.0, 6.0, 8.0])) == COARSE * 6.0
    told = add_told_from((side, side), (np.full(n, 99.0), np.array([0.5, 6.0, 1.0, 9.0])))[1]
    assert told.told_from is not None
    assert told.told_from[:3].tolist() == [0.5, 6.0, 1.0]
    assert np.isnan(told.told_from[3])
    assert told.is_coarse.tolist() == [False, True, False, False]
    figures = coarse_figures(told, np.array([1.0, 2.0, 5.0, 9.0]), 0.5)
    assert figures == {"told_from_median_m": 1.0, "coarse_from_m": 4.0, "coarse_area_share": 0.25,
                       "coarse_told_from_m": 6.0, "share_coarser_than_tolerance": 7.0 / 8.0}  # fmt: skip
    assert coarse_figures(told, np.array([1.0, 2.0, 5.0, 9.0]), 5.0)["share_coarser_than_tolerance"] == 2.0 / 8.0
    nothing = replace(side, reasons=np.full(n, 3, np.uint8))
    assert np.isnan(coarse_beyond(np.zeros(0)))
    unknown = add_told_from((nothing, nothing), (np.ones(n), np.ones(n)))[1]
    assert np.isnan(coarse_figures(unknown, np.ones(n), None)["coarse_area_share"])
    of_meshes = add_told_from((side, side), (np.full(n, np.nan),) * 2)[1]
    assert not of_meshes.is_coarse.any()
    assert np.isnan(list(coarse_figures(of_meshes, np.ones(n), 0.5).values())).all()


def test_a_mean_of_so_many_sigmas_is_just_significant() -> None:
    for n, level in ((1.0, 0.05), (40.0, 0.05), (3000.0, 0.01)):
        z = float(sigmas_needed(np.array(n), level))
        assert is_significant(np.array([z + 1e-6, z - 1e-6]), np.full(2, n), level).tolist() == [True, False]
    assert sigmas_needed(np.array(0.2), 0.05) == pytest.approx(1.95996, abs=1e-5)  # of what there is once


def test_a_quantile_by_area_is_that_of_the_area() -> None:
    values, areas = np.array([3.0, 1.0, 2.0]), np.array([1.0, 8.0, 1.0])
    assert [quantile_by_area(values, areas, share) for share in (0.5, 0.85, 0.95, 1.0)] == [1.0, 2.0, 3.0, 3.0]
    assert np.isnan(quantile_by_area(np.zeros(0), np.zeros(0), 0.95))


@pytest.fixture(scope="module")
def unchanged() -> Comparison:
    """Two sheets with mouldings, of which nothing changed."""
    return compared(np.random.default_rng(5), np.zeros((N, N)))


def test_mouldings_tell_from_what_surfaces_guess_there_and_the_rest_from_its_level(unchanged: Comparison) -> None:
    side, on = unchanged.on_compared, mouldings().ravel()
    assessed = side.assessment != Assessment.NOT_ASSESSABLE
    told = side.told_from
    assert told is not None
    assert np.isnan(told[~assessed]).all()
    assert np.median(told[assessed & ~on]) == pytest.approx(unchanged.statistics["told_by_width_m"][0][1], rel=0.05)
    assert (told[assessed & on] >= SURE * 0.95 * GUESS).all()
    assert (told[assessed & on] <= norm.isf(0.025 * EDGE**2 / (EDGE * N) ** 2) * 1.05 * GUESS).all()


def test_what_is_coarse_is_counted_by_area(unchanged: Comparison) -> None:
    side, figures = unchanged.on_compared, unchanged.statistics
    assert figures["coarse_from_m"] == side.coarse_from == COARSE * figures["told_from_median_m"]
    assert unchanged.on_reference.coarse_from == side.coarse_from
    assert side.told_from is not None
    is_coarse = (side.assessment == Assessment.UNCHANGED) & (side.told_from > side.coarse_from)
    assert side.is_coarse.tolist() == is_coarse.tolist()
    share = side.is_coarse.sum() / (side.assessment != Assessment.NOT_ASSESSABLE).sum()  # of even areas, but for rims
    assert figures["coarse_area_share"] == pytest.approx(share, rel=0.02)
    assert side.is_coarse[mouldings().ravel()].mean() > 0.9
    assert figures["coarse_told_from_m"] == pytest.approx(np.quantile(side.told_from[side.is_coarse], 0.95), rel=0.02)


@pytest.mark.parametrize(("depth", "is_told"), [(-12.0 * GUESSED, True), (-1.2 * GUESSED, False)])
def test_what_is_told_is_larger_than_what_its_place_tells_from(
    unchanged: Comparison, depth: float, is_told: bool
) -> None:
    change = along_one(depth)
    found = compared(np.random.default_rng(7), change)
    assert unchanged.on_compared.told_from is not None
    there = np.nanmedian(unchanged.on_compared.told_from[change.ravel() != 0.0])
    assert (len(found.regions) > 0) == is_told
    assert (abs(depth) > there) == is_told


def test_nothing_is_coarse_where_it_is_not_known(unchanged: Comparison) -> None:
    side = replace(unchanged.on_compared, told_from=None)
    assert unchanged.on_compared.is_coarse.any()
    assert not side.is_coarse.any()
