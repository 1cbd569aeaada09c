"""Chips as small as one witness of errors are told where both surfaces show them; what one alone shows is not known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from monitor.comparison import compare
from monitor.comparison.distances.stars import gather_neighbours, make_mesh, vertex_areas
from monitor.comparison.noise.level_of_detection import far_levels
from monitor.comparison.regions import chips
from monitor.comparison.regions import finding as regions
from projects.model import Assessment, Comparison, NotAssessed, Registration, Surface

N, EDGE, NOISE = 121, 2e-3, 5e-5  # of the sheets; m
WAVE = 0.05  # m, over which their errors agree: the area of one witness is 20 cm2
MIDDLE = 0.5 * (N - 1) * EDGE


def errors(rng: np.random.Generator) -> np.ndarray:
    """Return errors (N, N) [m] that agree over `WAVE`, as large as the noise of the vertices, and this noise."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(N, EDGE), np.fft.fftfreq(N, EDGE)))
    smooth = np.fft.ifft2(np.fft.fft2(rng.normal(size=(N, N))) * np.exp(-((np.pi * WAVE * frequency) ** 2) / 2.0)).real
    return NOISE * (smooth / smooth.std() + rng.normal(size=(N, N)))


def sheet(heights: np.ndarray, to_samples: float | None = None) -> Surface:
    i = np.arange((N - 1) * N).reshape(N - 1, N)[:, :-1].ravel()
    faces = np.vstack([np.c_[i, i + N, i + 1], np.c_[i + 1, i + N, i + N + 1]])
    x, y = np.divmod(np.arange(N * N), N)
    return Surface(np.c_[EDGE * x, EDGE * y, heights.ravel()], faces, sigma=np.full(N * N, NOISE),
                   sample_distance=None if to_samples is None else np.full(N * N, to_samples))  # fmt: skip


def pit(depth: float, width: float, along: float = MIDDLE) -> np.ndarray:
    """Return a pit (N, N) [m] with a flat bottom and walls two edges wide, in the middle of the sheet or so far along x
    in it."""
    y, x = np.meshgrid(EDGE * np.arange(N), EDGE * np.arange(N))
    inside = 0.5 * width - np.hypot(x - along, y - MIDDLE)
    return -depth * np.clip(inside / (2.0 * EDGE) + 0.5, 0.0, 1.0)


def compared(
    before: np.ndarray, after: np.ndarray, points: str = "of both", to_samples: float | None = None
) -> Comparison:
    """Compare two sheets of these heights; the points that they were made of, where known, lie at their vertices."""
    fixed = Registration(np.eye(4), np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                         is_stable=np.ones(N * N, dtype=bool))  # fmt: skip
    first, second = sheet(before, to_samples), sheet(after, to_samples)
    if points == "of none":
        return compare(first, second, fixed)
    return compare(first, second, fixed,
                   points=lambda: (first.vertices, second.vertices if points == "of both" else None))  # fmt: skip


def test_a_chip_that_no_points_bear_out_is_not_told_and_not_unchanged(rng: np.random.Generator) -> None:
    before, after = errors(rng), errors(rng) + pit(2e-3, 0.010)
    for points in ("of one epoch", "of none"):
        found = compared(before, after, points)
        assert not len(found.regions)
        for side in (found.on_reference, found.on_compared):
            middle = np.abs(pit(1.0, 0.006)).ravel() > 0.5
            assert (side.assessment[middle] == Assessment.NOT_ASSESSABLE).all()


def test_a_chip_smaller_than_one_witness_is_a_region(rng: np.random.Generator) -> None:
    found = compared(errors(rng), errors(rng) + pit(2e-3, 0.010))
    assert found.statistics["correlation_length_m"] > 0.010
    assert list(found.regions["kind"]) == ["lost"]
    region = found.regions.iloc[0]
    assert region.extreme_m == pytest.approx(-2e-3, abs=3.0 * region.sigma_extreme_m)
    assert region.area_m2 == pytest.approx(0.25 * np.pi * 0.010**2, abs=2.0 * region.sigma_area_m2)
    assert region.sigma_area_m2 < 0.5 * region.area_m2
    assert np.hypot(region.x - MIDDLE, region.y - MIDDLE) < EDGE


def test_how_deep_a_chip_off_an_edge_is_has_no_margin(rng: np.random.Generator) -> None:
    roof = -np.abs(EDGE * np.arange(N) - MIDDLE)[:, None] * np.ones(N)  # a right angle from one row to the next
    found = compared(errors(rng) + roof, errors(rng) + roof + pit(2e-3, 0.010))
    assert len(found.regions) == 1
    region = found.regions.iloc[0]
    assert region.extreme_m < -1e-3
    assert np.isnan(region.sigma_extreme_m)
    assert np.isfinite(region.sigma_area_m2)


@pytest.mark.parametrize(("width", "n_told"), [(0.010, 1), (0.070, 0)])
def test_depth_alone_makes_a_region_only_of_what_is_smaller_than_a_witness(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, width: float, n_told: int
) -> None:
    """What is larger has patches of its own; here none of them is significant."""
    monkeypatch.setattr(regions, "hold_patches", lambda sides, test, parts, n, level: np.zeros(n, dtype=np.bool_))
    assert len(compared(errors(rng), errors(rng) + pit(2e-3, width)).regions) == n_told


def test_a_chip_off_the_rim_of_what_was_seen_is_a_region_as_one_in_its_middle_is(rng: np.random.Generator) -> None:
    found = compared(errors(rng), errors(rng) + pit(2e-3, 0.016, along=EDGE))
    assert list(found.regions["kind"]) == ["lost"]
    assert 0.0 < found.regions.iloc[0].x < 4.0 * EDGE
    assert np.isnan(found.regions.iloc[0].sigma_extreme_m)


def test_a_chip_that_surfaces_may_have_guessed_is_not_known_however_near_its_samples_are(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(regions, "known_of", lambda table, *_: np.zeros(len(table), dtype=np.bool_))
    assert not len(compared(errors(rng), errors(rng) + pit(2e-3, 0.010), to_samples=1e-4).regions)
    assert len(compared(errors(rng), errors(rng) + pit(2e-3, 0.070), to_samples=1e-4).regions) == 1  # no chip


def side_of(levels: list[float], areas: list[float]) -> Any:
    """Return a side of 100 assessed vertices, the first of them so many levels of detection of 1 off zero and of these
    areas, the others unchanged and of the usual area, 1."""
    n = 100 - len(levels)
    return SimpleNamespace(areas=np.array(areas + [1.0] * n), distances=np.array(levels + [0.0] * n),
                           is_assessed=np.ones(100, bool))  # fmt: skip


@pytest.mark.parametrize(
    ("first", "second", "area", "stands"),
    [
        ([9.0] * 3, [-9.0] * 3, 1.0, True),
        ([9.0] * 3, [9.0] * 2, 1.0, False),  # two and a half in the mean
        ([9.0] * 2, [9.0] * 2, 1.0, False),  # two vertices of each: a spike
        ([9.0] * 2, [9.0] * 2, 1.5, True),
        ([9.0] * 5, [9.0] * 5, 0.5, False),
        ([9.0] * 5, [9.0] * 2, 1.0, True),  # an edge broken off, which the second turns by few
        ([9.0] * 30, [9.0], 1.6, False),  # one vertex
        ([9.0] * 30, [9.0, 9.0, 4.0], 1.0, True),
        ([4.0] * 30, [4.0] * 30, 1.0, False),  # as far off as some vertex is by chance
    ],
)
def test_what_both_surfaces_show_over_a_few_vertices_stands_by_its_depth(
    first: list[float], second: list[float], area: float, stands: bool
) -> None:
    n = 100
    sides = [side_of(v, [area] * len(v)) for v in (first, second)]
    for side in sides:
        side.sigma_surfaces, side.sigma_scans = np.full(n, 0.4), np.full(n, 0.3)
    parts = [np.where(np.arange(n) < len(v), 0, -1) for v in (first, second)]
    found = SimpleNamespace(sides=[SimpleNamespace(lod95=np.ones(n))] * 2, test=SimpleNamespace(far=5.0))
    told = chips.stand_alone(sides, cast(Any, found), cast(Any, parts), 2)
    assert told.tolist() == [stands, False]
    for side in sides:  # 1.8 sigmas as stated: single places may err by as much as they say
        side.sigma_surfaces, side.sigma_scans = np.full(n, 4.0), np.full(n, 3.0)
    assert not chips.stand_alone(sides, cast(Any, found), cast(Any, parts), 2).any()


def test_a_faint_spot_as_small_is_none_and_stays_unchanged(rng: np.random.Generator) -> None:
    found = compared(errors(rng), errors(rng) + pit(2.5e-4, 0.010))
    assert not len(found.regions)
    assert found.statistics["not_assessed"]["unexplained"] == 0


def test_no_unchanged_sheet_shows_a_chip(rng: np.random.Generator) -> None:
    for _ in range(4):
        found = compared(errors(rng), errors(rng))
        assert not len(found.regions)
        assert found.statistics["not_assessed"]["unexplained"] <= 1


def test_a_spike_of_few_vertices_is_neither_changed_nor_unchanged(rng: np.random.Generator) -> None:
    after = errors(rng)
    after[60, 60:62] += 3e-3  # fewer than a handful
    found = compared(errors(rng), after)
    assert not len(found.regions)
    side = found.on_compared
    spike = np.flatnonzero(side.reasons == NotAssessed.UNEXPLAINED)
    assert set(spike) >= {60 * N + 60, 60 * N + 61}
    assert (side.assessment[spike] == Assessment.NOT_ASSESSABLE).all()
    assert np.isnan(side.distances[spike]).all()
    assert found.statistics["not_assessed"]["unexplained"] == len(spike) < 20


def test_beside_a_region_the_skirt_of_its_step_is_unknown_as_far_as_it_exceeds_what_is_told(
    rng: np.random.Generator,
) -> None:
    found = compared(errors(rng), errors(rng) + pit(2e-3, 0.06))
    assert len(found.regions) == 1
    for side in (found.on_reference, found.on_compared):
        away = np.hypot(*(side.surface.vertices[:, :2] - MIDDLE).T) - 0.03
        is_open = side.reasons == NotAssessed.UNEXPLAINED
        assert is_open.any()
        assert np.abs(away[is_open]).max() < 3.0 * EDGE
        unchanged = side.assessment == Assessment.UNCHANGED
        assert np.abs(side.distances[unchanged & (np.abs(away) < 3.0 * EDGE)]).max() < 2.0 * np.nanmedian(
            side.told_from
        )


@pytest.mark.parametrize(("before", "after", "is_told"), [
    (0.0, 0.4, True), (0.4, 0.0, True), (0.4, 0.4, False), (0.2, 0.4, False), (0.0, 0.3, False),
])  # fmt: skip
def test_where_points_lie_off_the_surface_of_one_epoch_alone_it_is_not_called_unchanged(
    rng: np.random.Generator, before: float, after: float, is_told: bool
) -> None:
    """A pit that the surface passes over shows so; what is strewn alike in both is what edges are like."""
    here = (np.abs(pit(1.0, 0.02)) > 0.5).ravel()
    first, second = (replace(sheet(errors(rng)), stray_share=np.where(here, share, 0.0).astype(np.float32))
                     for share in (before, after))  # fmt: skip
    fixed = Registration(np.eye(4), np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0)
    found = compare(first, second, fixed)
    for side in (found.on_reference, found.on_compared):
        strewn = side.reasons == NotAssessed.UNEXPLAINED
        assert strewn[here].mean() == (1.0 if is_told else 0.0)
        assert strewn[~here].sum() <= 3


def test_the_farthest_of_many_is_no_farther_than_bonferroni_allows(rng: np.random.Generator) -> None:
    n = 2000
    farthest = np.abs(rng.normal(size=(4000, n))).max(axis=1) / 1.959964
    assert np.mean(farthest > far_levels(n, 0.05)) == pytest.approx(0.05, abs=0.012)


def test_a_handful_that_differs_by_more_than_its_place_tells_is_not_called_unchanged() -> None:
    """A crack that was filled is narrower than any patch, and by itself no vertex of it may be beyond errors."""
    surface = sheet(np.zeros((N, N)))
    mesh = make_mesh(surface.vertices, surface.faces)
    crack, lone, few = np.zeros((3, N, N), dtype=bool)
    crack[30:40, 60:62] = lone[80, 80] = few[20:22, 20:22] = True
    distances = np.where(crack | lone | few, 3.0, 0.0)
    side = cast(Any, SimpleNamespace(is_assessed=np.ones(N * N, dtype=bool), distances=distances.ravel(),
                                     areas=vertex_areas(mesh), neighbours=gather_neighbours(mesh)))  # fmt: skip
    found = cast(Any, SimpleNamespace(lod95=np.full(N * N, 2.0), smooth=distances.ravel()))
    told = np.full(N * N, 2.0)
    np.testing.assert_array_equal(chips.is_unlike(side, found, 4.0, told), crack.ravel())
    np.testing.assert_array_equal(chips.is_unlike(side, found, 1.2, told), (crack | lone | few).ravel())
    assert not chips.is_unlike(side, found, 4.0, np.full(N * N, np.nan)).any()
    assert not chips.is_unlike(side, found, 4.0, np.where(crack.ravel(), 4.0, told)).any()
