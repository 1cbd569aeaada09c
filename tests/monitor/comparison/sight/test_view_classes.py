"""How steeply a place was seen: by the best station of the epoch that saw it worse, at the vertex or at its foot."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from monitor.comparison.distances.both_ways import make_shells, measure_sides
from monitor.comparison.distances.side import Side
from monitor.comparison.sight.stations import StationSight, gather_sight, is_measured
from monitor.comparison.sight.views import look_from, view_of
from projects.model import Registration, Surface

ANGLES = np.radians([60.0, 22.0, 18.0, 12.0, 6.0])  # of the beam above the plane z = 0
CLASSES = [0, 0, 1, 2, 3]
HIGH = 1.0  # m, of the station above the plane
PLACES = np.column_stack([HIGH / np.tan(ANGLES), np.zeros((len(ANGLES), 2))])


def plane_of(points: np.ndarray) -> Any:
    """Return as much of a side as a view needs: vertices in a plane that looks upwards."""
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return SimpleNamespace(surface=SimpleNamespace(vertices=points), normals=normals, areas=np.ones(len(points)))


def station(x: float = 0.0) -> StationSight:
    """Return the sight of a station `HIGH` above the plane at `x`, which measured it up to 12 m away."""
    down, side = np.meshgrid(np.radians(np.arange(4.5, 80.0, 0.1)), np.radians(np.arange(-3.0, 3.0, 0.1)))
    beams = np.column_stack([np.cos(down.ravel()) * np.cos(side.ravel()), np.cos(down.ravel()) * np.sin(side.ravel()),
                             -np.sin(down.ravel())])  # fmt: skip
    origin = np.array([x, 0.0, HIGH])
    sight = gather_sight(origin, [origin + beams * (HIGH / -beams[:, 2:])])
    assert sight is not None
    return sight


def test_the_class_of_view_is_that_of_the_angle_above_the_surface() -> None:
    assert view_of(plane_of(PLACES), [station()], np.eye(4)).tolist() == CLASSES


def test_the_best_of_the_stations_counts() -> None:
    views = view_of(plane_of(PLACES), [station(), station(7.0)], np.eye(4))
    assert views.tolist() == [0, 0, 1, 2, 0]  # the second, which looks along x too, sees the last from 2.5 m away


def test_a_station_that_measured_something_else_there_does_not_count() -> None:
    above = PLACES + np.array([0.0, 0.0, 0.3])  # nearer than what the station measured
    assert view_of(plane_of(above), [station()], np.eye(4)).tolist() == [3] * len(above)
    assert not is_measured(station(), above, np.sin(ANGLES)).any()
    assert is_measured(station(), PLACES, np.sin(ANGLES)).all()


def test_views_are_taken_in_the_stations_own_frame() -> None:
    T = np.array([[0.0, -1.0, 0.0, 0.5], [0.0, 0.0, 1.0, -2.0], [-1.0, 0.0, 0.0, 4.0], [0.0, 0.0, 0.0, 1.0]])
    back = np.linalg.inv(T)
    side = plane_of(PLACES @ back[:3, :3].T + back[:3, 3])
    side.normals[:] = back[:3, 2]
    assert view_of(side, [station()], T).tolist() == CLASSES


def flat_pair(gaps: tuple[float, float] = (0.0, 0.0)) -> tuple[Side, Side]:
    """Return the sides of two plates alike, 20 x 20 mm about the third of `PLACES`, vertices 1 mm apart; at the middle
    the nearest sample of the reference and of the compared one is so far [m]."""
    x, y = (g.ravel() for g in np.meshgrid(np.arange(21), np.arange(21)))
    points = PLACES[2] + 1e-3 * np.column_stack([x - 10, y - 10, np.zeros(len(x))])
    k = np.flatnonzero((x < 20) & (y < 20))
    faces = np.concatenate([np.column_stack([k, k + 1, k + 22]), np.column_stack([k, k + 22, k + 21])])
    at = np.hypot(x - 10, y - 10) < 0.5
    plates = [Surface(points, faces, sample_distance=np.where(at, gap, 2e-4)) for gap in gaps]
    fixed = Registration(np.eye(4), np.diag([1e-6] * 3 + [1e-7] * 3) ** 2, PLACES[2], True)
    return measure_sides(make_shells(plates[0], plates[1], (0.01, 1.0)), fixed)


def test_the_epoch_that_saw_worse_counts_on_both_sides() -> None:
    sides, far, near = flat_pair(), [station()], [station(1.5)]
    assert view_of(sides[0], near, np.eye(4)).max() == 0
    for sights in ((far, near), (near, far)):
        assert all((side.view == 1).all() for side in look_from(sides, sights, np.eye(4)))
    assert all((side.view == 0).all() for side in look_from(sides, (near, near), np.eye(4)))
    assert [side.n_scans for side in look_from(sides, (near, 3 * near), np.eye(4))] == [len(near)] * 2


def test_nothing_is_said_of_views_where_the_stations_of_an_epoch_are_not_known() -> None:
    assert all((side.view == 0).all() for side in look_from(flat_pair(), ([station()], []), np.eye(4)))
    assert [side.n_scans for side in look_from(flat_pair(), ([station()], []), np.eye(4))] == [0, 0]


def test_the_farther_sample_of_vertex_and_foot_tells_the_gap() -> None:
    for gaps, expected in (((8e-4, 2e-4), 1), ((2e-4, 8e-4), 1), ((2e-4, 11e-4), 2), ((7e-4, 7e-4), 0)):
        for side in flat_pair(gaps):
            assert (side.gap.max(), (side.gap > 0).sum()) == (expected, int(expected > 0))


def test_thirds_of_the_lever_arm_hold_as_many_assessed_vertices_each() -> None:
    side = flat_pair()[0]
    arm = np.linalg.norm(side.surface.vertices - PLACES[2], axis=1)
    n = np.bincount(side.arm[side.is_assessed], minlength=3)
    assert n / n.sum() == pytest.approx(np.full(3, 1.0 / 3.0), abs=0.05)  # many are as far as others
    assert all(arm[side.arm == k].max() < arm[side.arm == k + 1].min() for k in range(2))
