"""How large a change must at least be to be told, place by place: the level of detection, or what no guess makes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from scipy.stats import norm
from test_guesses import EDGE, GUESSED, NOISE, N, along_one, compared, mouldings, side_of

from monitor.comparison.guesses import SURE
from monitor.comparison.regions import is_significant, sigmas_needed
from monitor.comparison.told_from import COARSE, guess_of_units, quantile_by_area
from projects.model import Assessment, Comparison, Roughness

ROUGH = Roughness.ROUGH
GUESS = np.sqrt(2.0 * (GUESSED**2 - (2.0 * NOISE) ** 2))  # m, of both surfaces on a moulding


def test_the_guess_of_a_unit_is_the_root_of_its_mean_square_by_area() -> None:
    side = cast(Any, side_of([5.0, 0.1, 5.0, 5.0], [ROUGH] * 4))
    side.areas, side.is_assessed[2] = np.array([1.0, 3.0, 1.0, 1.0]), False
    found = guess_of_units(side, 0.5, np.array([0, 0, 0, -1]))
    assert found == pytest.approx([np.sqrt(24.0 / 4.0)] * 3 + [0.0])  # a vertex left out counts nothing, nor has it any


def test_a_mean_of_so_many_sigmas_is_just_significant() -> None:
    for n, level in ((1.0, 0.05), (40.0, 0.05), (3000.0, 0.01)):
        z = sigmas_needed(n, level)
        assert is_significant(np.array([z + 1e-6, z - 1e-6]), np.full(2, n), level).tolist() == [True, False]
    assert sigmas_needed(0.2, 0.05) == pytest.approx(1.95996, abs=1e-5)  # of what there is once


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
    guessed, unit = on.mean() * (EDGE * N) ** 2, unchanged.statistics["unit_size_m"]
    needed = max(SURE, norm.isf(0.025 * unit**2 / guessed))
    told = side.told_from
    assert told is not None
    assert np.isnan(told[~assessed]).all()
    assert np.nanmax(told) == pytest.approx(needed * GUESS, rel=0.05)  # of a unit all of which is guessed
    far = assessed & ~on & (told == side.lod95)
    assert far.sum() > 0.5 * (assessed & ~on).sum()  # beside a moulding units hold some of it
    assert (told[assessed & on] > 1.2 * side.lod95[assessed & on]).mean() > 0.9


def test_what_is_coarse_is_counted_by_area(unchanged: Comparison) -> None:
    side, figures = unchanged.on_compared, unchanged.statistics
    assert figures["coarse_from_m"] == side.coarse_from == COARSE * figures["lod95_median_m"]
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
