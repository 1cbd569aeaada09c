"""The light-section sensor: its noise and resolution, and the shadows of a light that stands beside the eye."""

import dataclasses

import numpy as np
import pytest
import trimesh

from monitor.simulation import Body, Scene, Window
from monitor.simulation.scenes import make_box
from monitor.simulation.triangulation import TriangulationSensor, scan_by_triangulation
from projects.errors import ParameterError

SENSOR = TriangulationSensor()
WINDOW = Window(-0.02, 0.02, -0.02, 0.02)


def wall(distance):
    return make_box("wall", np.array([distance, -1.0, -1.0]), np.array([distance + 0.1, 1.0, 1.0]))


@pytest.mark.parametrize("distance", [0.7, 1.5])
def test_noise_grows_with_the_square_of_the_range_and_spacing_is_the_resolution(distance):
    scan = scan_by_triangulation(Scene("wall", (wall(distance),)), SENSOR, np.eye(4), WINDOW, distance=distance)
    range_ = distance / (scan.cloud.points[:, 0] / np.linalg.norm(scan.cloud.points, axis=1))
    noise = np.linalg.norm(scan.cloud.points, axis=1) - range_
    assert np.std(noise) == pytest.approx(30e-6 * distance**2, rel=0.03)  # more than 30000 points: 0.4 % one sigma
    assert abs(noise.mean()) < 4 * np.std(noise) / np.sqrt(len(noise)) + 1e-7
    column = scan.cloud.points[scan.rows == 100]
    assert np.median(np.diff(np.sort(column[:, 1]))) == pytest.approx(0.12e-3, rel=0.02)


def test_a_step_shadows_the_wall_behind_it_by_the_base_line():
    silent = dataclasses.replace(SENSOR, noise_1m=0.0)
    block = make_box("block", np.array([0.9, -0.05, -0.5]), np.array([1.0, 0.0, 0.5]))  # 10 cm before the wall at 1 m
    scan = scan_by_triangulation(Scene("s", (wall(1.0), block)), silent, np.eye(4), Window(-0.1, 0.1, -1e-3, 1e-3),
                                 distance=1.0)  # fmt: skip
    y = scan.cloud.points[scan.cloud.points[:, 0] > 0.99, 1]
    # The laser at y = 0.25 sees past the block's far edge, (0.9, -0.05): that ray meets the wall at this y.
    assert y[y < -0.051].max() == pytest.approx(0.25 + (-0.05 - 0.25) / 0.9, abs=3e-4)
    assert y[y > -0.01].min() == pytest.approx(0.0, abs=3e-4)  # at the near edge nothing is hidden from the laser
    assert scan.dropped["shadow"] > 0


def test_what_view_or_light_touch_more_steeply_than_told_is_not_measured():
    """A cylinder about z at 1 m: seen to where the camera's, and the laser's, incidence reaches its limit."""
    limit, radius = np.radians(60.0), 0.1
    turn = np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)
    cylinder = trimesh.creation.cylinder(radius=radius, height=0.4, sections=2000).apply_translation([1.0, 0.0, 0.0])
    body = Body("cylinder", np.asarray(cylinder.vertices), np.asarray(cylinder.faces, dtype=np.int32))
    sensor = dataclasses.replace(SENSOR, noise_1m=0.0, incidence_max=limit, resolution=0.5e-3)
    scan = scan_by_triangulation(Scene("c", (body,)), sensor, np.eye(4), Window(-0.12, 0.12, -5e-4, 5e-4), distance=1.0)
    on = np.column_stack([1.0 + radius * np.cos(turn), radius * np.sin(turn)])
    normal = np.column_stack([np.cos(turn), np.sin(turn)])
    seen = np.ones(len(turn), dtype=bool)
    for eye in ([0.0, 0.0], [0.0, sensor.base_line]):
        towards = np.array(eye) - on
        seen &= (towards * normal).sum(axis=1) > np.cos(limit) * np.linalg.norm(towards, axis=1)
    y = scan.cloud.points[:, 1]
    np.testing.assert_allclose([y.min(), y.max()], [on[seen, 1].min(), on[seen, 1].max()], atol=6e-4)


def test_an_error_of_the_calibration_lengthens_all_ranges_alike():
    scans = [
        scan_by_triangulation(Scene("wall", (wall(1.0),)), sensor, np.eye(4), WINDOW, distance=4.0, seed=3)
        for sensor in (SENSOR, dataclasses.replace(SENSOR, calibration_error=2e-4))
    ]
    true, off = (np.linalg.norm(scan.cloud.points, axis=1) for scan in scans)
    np.testing.assert_allclose(off - true, 2e-4, atol=1e-9)


def test_what_lies_beyond_its_range_is_not_seen():
    scan = scan_by_triangulation(Scene("wall", (wall(2.5),)), SENSOR, np.eye(4), WINDOW, distance=2.0)
    assert len(scan.cloud) == 0
    assert scan.dropped["no return"] > 0


def test_a_wide_view_is_refused():
    with pytest.raises(ParameterError, match="1 rad at most"):
        scan_by_triangulation(Scene("wall", (wall(1.0),)), SENSOR, np.eye(4), Window(-1, 1, -0.1, 0.1), distance=1.0)
