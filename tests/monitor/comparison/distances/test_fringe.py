"""A surface goes on beyond its samples for some cells: that fringe is no area of the object.

Plates of known area; with the fringe each is by two or three spacings of its points wider on each side.
"""

from __future__ import annotations

import datetime
from dataclasses import replace

import numpy as np
import pytest

from monitor.comparison import compare
from monitor.comparison.distances.side import Side
from monitor.comparison.series.epoch_change import EpochChange
from monitor.comparison.series.follow import follow
from monitor.comparison.series.rate_side import lay_bare
from monitor.reconstruction.surface import reconstruct
from projects.model import Comparison, Floats, PointCloud, Registration, Surface

WIDE, DEPTH = 0.16, 0.004  # m: the plate's edge, and how deep its waves are
KNOWN = Registration(np.eye(4), np.diag([1e-6] * 3 + [2e-6] * 3) ** 2, np.array([WIDE / 2, WIDE / 2, 0.0]), True,
                     stable_share=1.0)  # fmt: skip


def wavy_plate(rng: np.random.Generator, spacing: float, *, is_grid: bool, lift: float = 0.0) -> PointCloud:
    """Return points on a plate of long waves; its last third along x is lifted by `lift` [m]."""
    if is_grid:
        axis = rng.uniform(0.0, spacing) + spacing * np.arange(-WIDE / spacing, 2.0 * WIDE / spacing)
        turn = rng.uniform(0.2, 1.3)
        x, y = (a.ravel() - WIDE / 2 for a in np.meshgrid(axis, axis))
        x, y = np.cos(turn) * x - np.sin(turn) * y + WIDE / 2, np.sin(turn) * x + np.cos(turn) * y + WIDE / 2
    else:
        x, y = rng.uniform(0.0, WIDE, (2, round((WIDE / spacing) ** 2)))
    inside = (x > 0.0) & (x < WIDE) & (y > 0.0) & (y < WIDE)
    x, y = x[inside], y[inside]
    z = DEPTH * np.sin(x / 0.03) * np.cos(y / 0.025) + np.where(x > WIDE * 2 / 3, lift, 0.0)
    slope = np.column_stack([-DEPTH / 0.03 * np.cos(x / 0.03) * np.cos(y / 0.025),
                             DEPTH / 0.025 * np.sin(x / 0.03) * np.sin(y / 0.025), np.ones(len(x))])  # fmt: skip
    points = np.column_stack([x, y, z + rng.normal(0.0, 2e-4, len(x))])
    return PointCloud(points, normals=slope / np.linalg.norm(slope, axis=1)[:, None])


def bare(surface: Surface) -> Side:
    return lay_bare(surface, KNOWN)


def flat_area(side: Side, areas: Floats) -> float:
    """Return such areas (n,) [m2] as they look from above, where the plate is as large as its edges say."""
    return float(areas @ np.abs(side.normals[:, 2]))


def beyond_edge(area: float) -> float:
    """Return how far [m] a square of such an area [m2] reaches over each edge of the plate."""
    return 0.5 * (np.sqrt(area) - WIDE)


@pytest.mark.parametrize(("spacing", "is_grid"), [(0.002, True), (0.002, False), (0.004, False)])
def test_without_its_fringe_a_surface_is_as_large_as_what_was_sampled(rng, spacing, is_grid) -> None:
    side = bare(reconstruct(wavy_plate(rng, spacing, is_grid=is_grid)))
    assert beyond_edge(flat_area(side, side.areas)) > 1.8 * spacing
    assert abs(beyond_edge(flat_area(side, side.measured_areas))) < 0.6 * spacing


def test_a_surface_that_says_nothing_of_samples_has_no_fringe(rng: np.random.Generator) -> None:
    side = bare(replace(reconstruct(wavy_plate(rng, 0.004, is_grid=False)), sample_distance=None))
    assert not side.is_fringe.any()


@pytest.fixture(scope="module")
def lifted() -> Comparison:
    """The plate, a third of which rose by 2 mm, as far as three of its edges."""
    rng = np.random.default_rng(4)
    epochs = [reconstruct(wavy_plate(rng, 0.002, is_grid=True, lift=lift)) for lift in (0.0, 0.002)]
    is_stable = epochs[1].vertices[:, 0] < 0.6 * WIDE
    return compare(*epochs, replace(KNOWN, is_stable=is_stable, stable_share=float(is_stable.mean())))


def changed_area(lifted: Comparison) -> float:
    """Return the area [m2] that rose, along the waves: as much of the plate as its edges say."""
    plate = bare(lifted.on_reference.surface)
    return WIDE**2 / 3 * float(plate.areas.sum()) / flat_area(plate, plate.areas)


def test_a_region_at_open_edges_is_as_large_as_what_changed(lifted: Comparison) -> None:
    top = lifted.regions.iloc[0]
    assert top["area_m2"] == pytest.approx(changed_area(lifted), rel=0.03)  # with the fringe 17 % more
    assert top["volume_m3"] == pytest.approx(0.002 * WIDE**2 / 3, rel=0.03)


def test_the_fringe_is_no_area_that_could_not_be_assessed(lifted: Comparison) -> None:
    """What is not assessed is the step."""
    assert lifted.statistics["assessed_area_share_reference"] > 0.95
    assert lifted.statistics["assessed_area_share"] > 0.95


def test_a_footprint_at_open_edges_is_as_large_as_what_changed(lifted: Comparison) -> None:
    dates = [datetime.date(2020 + k, 5, 1) for k in range(3)]
    series = follow([EpochChange(f"e{k}", dates[k], lifted) for k in (1, 2)], "e0", dates[0])
    assert series.regions["area_m2"].iloc[0] == pytest.approx(changed_area(lifted), rel=0.03)
