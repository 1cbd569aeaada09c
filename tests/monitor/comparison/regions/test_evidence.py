"""A finger is missing in one epoch: removed where a scan looked through its place, not seen where none did."""

from __future__ import annotations

import dataclasses
import datetime

import numpy as np
import pytest
import trimesh

from monitor.bearings import directions_of
from monitor.comparison import compare
from monitor.comparison.regions.evidence import Sights
from monitor.comparison.series.epoch_change import EpochChange
from monitor.comparison.series.follow import follow
from monitor.comparison.sight.beam_grid import GridBuilder
from monitor.comparison.sight.stations import StationSight, gather_sight
from monitor.simulation.solid import contour
from projects.model import Assessment, Comparison, NotAssessed, Registration, Surface

NOISE = 2e-5  # m
STATION = np.array([0.8, 0.0, 0.12])
MOTION = np.array([0.05, -0.02, 0.01])  # m, of the compared epoch's coordinates against the reference's


def plate(rng: np.random.Generator, with_finger: bool) -> Surface:
    """Return a plate of 0.1 x 0.1 x 0.02 m, on it a finger 12 mm wide and 50 mm high."""

    def field(p: np.ndarray) -> np.ndarray:
        q = np.abs(p) - np.array([0.05, 0.05, 0.01])[:, None] + 0.004
        slab = np.linalg.norm(np.maximum(q, 0.0), axis=0) + np.minimum(q.max(axis=0), 0.0) - 0.004
        along = np.clip(p[2], 0.0, 0.054)
        finger = np.sqrt(p[0] ** 2 + p[1] ** 2 + (p[2] - along) ** 2) - 0.006
        return np.minimum(slab, finger) if with_finger else slab

    vertices, faces = contour(field, np.array([[-0.06, -0.06, -0.02], [0.06, 0.06, 0.07]]), cell=0.002)
    normals = trimesh.Trimesh(vertices, faces, process=False).vertex_normals
    noisy = vertices + normals * rng.normal(0, NOISE, (len(vertices), 1))
    return Surface(noisy, faces, sigma=np.full(len(vertices), NOISE))


def look(distance: float) -> list[StationSight]:
    """Return the sight of a station that measured a wall `distance` m away, across the whole view."""
    angle = np.arange(-0.25, 0.25, 0.001)
    a, e = (g.ravel() for g in np.meshgrid(angle, angle))
    beams = np.column_stack([-np.ones(len(a)), np.tan(a), np.tan(e) - 0.12 / 0.8])
    sight = gather_sight(STATION, [STATION + distance * beams])
    assert sight is not None
    return [sight]


def shifted(sights: list[StationSight], by: np.ndarray) -> list[StationSight]:
    return [dataclasses.replace(s, origin=s.origin + by) for s in sights]


def run(rng: np.random.Generator, fingers: tuple[bool, bool], walls: tuple[float, float] | None,
        sights: Sights | None = None) -> Comparison:  # fmt: skip
    """Compare two plates in relative mode, the compared one shifted by `MOTION`; stations see walls so far away, or
    what is given."""
    reference, there = plate(rng, fingers[0]), plate(rng, fingers[1])
    compared = Surface(there.vertices + MOTION, there.faces, sigma=there.sigma)
    T = np.eye(4)
    T[:3, 3] = -MOTION
    known = Registration(T, np.diag([1e-6] * 3 + [1e-7] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                         is_stable=np.ones(len(compared.vertices), dtype=bool))  # fmt: skip
    if sights is None and walls is not None:
        sights = (look(walls[0]), shifted(look(walls[1]), MOTION))
    return compare(reference, compared, known, sights=sights)


TRUTH = np.pi * 0.006**2 * (0.044 + 2.0 / 3.0 * 0.006)  # m3, of the finger above the plate


@pytest.mark.parametrize(("fingers", "kind", "sign"), [((True, False), "lost", -1.0), ((False, True), "added", 1.0)])
def test_a_finger_that_was_looked_through_is_gone_or_new(rng: np.random.Generator, fingers, kind, sign) -> None:
    result = run(rng, fingers, (2.0, 2.0))
    assert list(result.regions.kind) == [kind]
    region = result.regions.iloc[0]
    assert region.volume_m3 == pytest.approx(sign * TRUTH, rel=0.04)  # of a finger three cells wide
    assert abs(region.extreme_m) == pytest.approx(0.050, abs=0.002)
    # over all of the finger to the plate, not of the few vertices at its foot: -0.6 to +13 mm as these fell
    assert region.mean_m == pytest.approx(sign * 0.025, rel=0.04)
    assert 0.0 < region.sigma_mean_m < 1e-3
    side = result.on_reference if sign < 0 else result.on_compared
    upper = side.surface.vertices[:, 2] > 0.03
    assert (side.assessment[upper] == Assessment.CHANGED).mean() > 0.95
    assert (side.reasons[upper] == NotAssessed.LOOKED_THROUGH).mean() > 0.9
    through = side.reasons == NotAssessed.LOOKED_THROUGH
    np.testing.assert_allclose(side.distances[through], sign * (side.surface.vertices[through, 2] - 0.01), atol=2e-4)
    np.testing.assert_array_equal(np.isnan(side.distances), side.assessment == Assessment.NOT_ASSESSABLE)
    assert np.isfinite(result.statistics["share_above_lod95"])


@pytest.mark.parametrize("walls", [(2.0, 0.3), None])
def test_a_finger_that_something_hid_is_not_called_gone(rng: np.random.Generator, walls) -> None:
    result = run(rng, (True, False), walls)
    assert (result.regions.z < 0.02).all()  # at its foot, where the plate was measured
    upper = result.on_reference.surface.vertices[:, 2] > 0.03
    assert (result.on_reference.assessment[upper] == Assessment.NOT_ASSESSABLE).all()
    if walls is not None:
        assert (result.on_reference.reasons[upper] == NotAssessed.NOT_SEEN).all()
        assert result.statistics["not_assessed"]["looked_through"] == 0


def look_into_the_sky(is_grid: bool) -> list[StationSight]:
    """Return the sight of a station that measured a wall 2 m away, up to the finger's lower third, and beside it."""
    row, column = (i.ravel() for i in np.mgrid[:500, :500])
    turn, height = np.pi - 0.25 + 0.001 * column, 0.1 - 0.001 * row
    way = directions_of(turn, height)
    has_met = (height < -0.12) | (np.abs(turn - np.pi) > 0.2)
    builder = GridBuilder(len(row))
    builder.add(row[has_met], column[has_met], 2.0 * way[has_met])
    sight = gather_sight(STATION, [STATION + 2.0 * way[has_met]])
    assert sight is not None
    return [dataclasses.replace(sight, grid=builder.finish(np.eye(3)) if is_grid else None)]


@pytest.mark.parametrize("is_grid", [True, False])
def test_a_finger_before_the_sky_is_not_called_gone_but_said_to_have_met_nothing(
    rng: np.random.Generator, is_grid: bool
) -> None:
    result = run(rng, (True, False), (2.0, 2.0), (look(2.0), shifted(look_into_the_sky(is_grid), MOTION)))
    side = result.on_reference
    upper = side.surface.vertices[:, 2] > 0.04
    assert (side.assessment[upper] == Assessment.NOT_ASSESSABLE).all()
    assert (side.reasons[upper] == (NotAssessed.MET_NOTHING if is_grid else NotAssessed.NOT_SEEN)).mean() > 0.9
    of_finger = 2.0 * np.pi * 0.006 * 0.030  # m2, above 0.03 m: where it meets no wall any more, and a window beside it
    reference, compared = result.statistics["met_nothing_area_m2"]
    assert reference == pytest.approx(of_finger if is_grid else np.nan, rel=0.35, nan_ok=True)
    assert np.isnan(compared)  # the earlier station's beams are not known


def test_how_steeply_places_were_seen_enters_the_noise_where_stations_are_known(rng: np.random.Generator) -> None:
    seen = run(rng, (True, True), (2.0, 2.0)).statistics["error_scales_view"]
    blind = run(rng, (True, True), None).statistics["error_scales_view"]
    assert np.isfinite(seen[-1])  # no station measured the plate, only what is behind it
    assert np.isfinite(blind).tolist() == [True, False, False, False]


def test_a_finger_that_came_is_followed_by_its_body(rng: np.random.Generator) -> None:
    """The plate under it has no perpendicular, and the few vertices at its foot say nothing of its height."""
    before, start = plate(rng, False), datetime.date(2020, 1, 1)
    changes = []
    for year, has_finger in ((1, False), (2, True), (3, True)):
        later = plate(rng, has_finger)
        known = Registration(np.eye(4), np.diag([1e-6] * 3 + [1e-7] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                             is_stable=np.ones(len(later.vertices), dtype=bool))  # fmt: skip
        found = compare(before, later, known, sights=(look(2.0), look(2.0)))
        changes.append(EpochChange(f"y{year}", start.replace(year=2020 + year), found))
    series = follow(changes, "y0", start)
    (row,) = series.regions.itertuples()
    assert (row.model, row.first_seen) == ("jump", "y2")
    assert row.area_m2 == pytest.approx(np.pi * 0.006**2, rel=0.2)  # of its foot, three cells wide
    assert row.onset_to_years == pytest.approx(2.0, abs=0.01)
    np.testing.assert_allclose(series.history["change_m3"], [0.0, TRUTH, TRUTH], atol=0.04 * TRUTH)
    np.testing.assert_allclose(series.history["mean_m"][1:], TRUTH / row.area_m2, rtol=0.04)
