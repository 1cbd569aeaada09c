"""What lies near, and what can be used: against a search through all."""

import numpy as np
import pytest

from monitor.boxes import box_of
from monitor.reconstruction import reconstruct_with_record
from monitor.reconstruction.moments import level_of_points
from monitor.reconstruction.nearness import has_near
from monitor.reconstruction.usable import mark_usable
from projects.model import PointCloud


@pytest.mark.parametrize("radius", [0.005, 0.05, 0.3])
def test_near_is_what_a_search_through_all_finds_near_and_looking_that_way(rng, radius):
    points, places = rng.uniform(size=(400, 3)), rng.uniform(-0.1, 1.1, size=(500, 3))
    normals, ways = (a / np.linalg.norm(a, axis=1)[:, None] for a in rng.normal(size=(2, 500, 3)))
    level = level_of_points(points, normals[:400], radius)
    near = np.linalg.norm(places[:, None] - points, axis=2) < 0.1
    assert has_near(level, places, ways, 0.1).tolist() == near.any(axis=1).tolist()
    alike = near & (ways @ normals[:400].T > 0.5)
    assert has_near(level, places, ways, 0.1, 0.5).tolist() == alike.any(axis=1).tolist()
    assert 0 < alike.any(axis=1).sum() < near.any(axis=1).sum() < 500


def test_places_that_ask_no_way_may_lie_metres_off_behind_what_is_near(rng):
    towards = rng.normal(size=(300, 3))
    points = 3.0 * towards / np.linalg.norm(towards, axis=1)[:, None]  # a room that looks inwards
    level = level_of_points(points, -points / 3.0, 0.3)
    assert has_near(level, points, points, 0.1).all()


def test_a_room_six_metres_wide_keeps_its_surface(rng):
    towards = rng.normal(size=(6000, 3))
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    result = reconstruct_with_record(PointCloud(3.0 * towards + 0.002 * rng.normal(size=(6000, 1)) * towards, -towards))
    assert result.counts["faces_untouched_by_samples"] < 0.01 * result.counts["faces_raw"]
    assert result.automatic["uncovered_share"] < 0.01
    triangles = result.surface.vertices[result.surface.faces]
    area = 0.5 * np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    assert area.sum() == pytest.approx(4.0 * np.pi * 9.0, rel=0.02)


def test_points_are_used_that_are_finite_and_have_a_unit_normal():
    points, normals = np.zeros((6, 3)), np.tile([0.0, 0.6, 0.8], (6, 1))
    points[1, 2], points[2, 0], normals[3, 1], normals[4] = np.nan, -np.inf, np.nan, [0.0, 0.3, 0.4]
    assert mark_usable(points, normals).tolist() == [True, False, False, False, False, True]
    low, high = box_of(np.array([[1.0, -2.0, 3.0], [0.5, 4.0, 3.0]]))
    assert (low.tolist(), high.tolist()) == ([0.5, -2.0, 3.0], [1.0, 4.0, 3.0])
