"""Which parts of a surface that stand out are regions: what holds a significant patch, and what both sides bear out."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from monitor.comparison.detection.reaches import Reaches
from monitor.comparison.noise.correlation import Correlation
from monitor.comparison.noise.model import Noise
from monitor.comparison.noise.strata import N_STRATA
from monitor.comparison.regions.finding import bear_out_parts, hold_patches

NOISE = Noise(np.zeros(N_STRATA), *np.ones((3, N_STRATA)), Correlation(np.zeros(1), np.ones(1)), spacing=1e-3)


def side_of(distances: list[float], to_rim: float = np.inf) -> Any:
    """Return as much of a side as decides on parts: vertices of 1 mm2, one a unit, as far from a free edge."""
    n, best = len(distances), np.zeros(len(distances), dtype=np.uint8)
    return SimpleNamespace(areas=np.full(n, 1e-6), distances=np.array(distances), is_assessed=np.ones(n, dtype=bool),
                           to_rim=np.full(n, to_rim), surface=SimpleNamespace(roughness=None),
                           view=best, gap=best, stated=best, arm=best)  # fmt: skip


def one_patch_over(side: Any, p: float) -> Any:
    """Return the test of one patch, around the first unit, that holds all units of both sides."""
    n = len(side.areas)
    units = SimpleNamespace(number=np.arange(n), areas=side.areas, means=side.distances)
    reaches = Reaches(np.append(0, np.full(n, n)), np.arange(n), np.zeros(n, dtype=np.uint8))
    p_values = np.append(p, np.ones(n - 1))
    return SimpleNamespace(
        units=(units, units), reaches=(reaches, reaches), p_values=[p_values[:, None]] * 2, n_tested=2
    )


@pytest.mark.parametrize(
    ("parts", "holding"),
    [
        ([0, 0, 0, 1, 1, -1], [True, False]),  # the larger of two pieces of one faint change
        ([0, -1, -1, -1, -1, 1], [False, False]),  # specks in a change that no part makes up
        ([0, 0, 0, 0, 0, 1], [True, False]),  # a speck beside it
    ],
)
def test_the_largest_of_the_parts_that_make_up_a_patch_holds_it(parts: list[int], holding: list[bool]) -> None:
    side, numbers = side_of([-1e-4] * 6), np.array(parts)
    found = hold_patches((side, side), one_patch_over(side, 1e-6), (numbers, numbers), 2, 0.05)
    assert list(found) == holding
    faint = hold_patches((side, side), one_patch_over(side, 0.03), (numbers, numbers), 2, 0.05)
    assert not faint.any()


def test_a_gain_beside_a_loss_does_not_hold_its_patch() -> None:
    side, numbers = side_of([-3e-4] * 4 + [1e-4] * 2), np.array([0, 0, 0, 0, 1, 1])
    assert list(hold_patches((side, side), one_patch_over(side, 1e-6), (numbers, numbers), 2, 0.05)) == [True, False]


def test_beside_a_free_edge_one_side_alone_is_no_witness() -> None:
    here, nowhere = np.zeros(6, dtype=np.int64), np.full(6, -1)
    at_rim, inside = side_of([-1e-3] * 6, to_rim=3e-3), side_of([-1e-3] * 6, to_rim=9e-3)
    assert not bear_out_parts((at_rim, at_rim), NOISE, (here, nowhere), 1)[0]
    assert not bear_out_parts((at_rim, at_rim), NOISE, (nowhere, here), 1)[0]
    assert bear_out_parts((at_rim, at_rim), NOISE, (here, here), 1)[0]
    assert bear_out_parts((inside, inside), NOISE, (here, nowhere), 1)[0]
