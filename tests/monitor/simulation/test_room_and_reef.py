"""The ornate room, scanned from inside, and the oyster reef, seen at shallow angles: closed, of true size."""

import numpy as np
import pytest
import trimesh

from monitor.simulation import INSTRUMENTS, Window, simulate_scan, stand_at, without_errors
from monitor.simulation import reef as reef_file
from monitor.simulation.changes import erode, fill
from monitor.simulation.height_field import HeightField, refine_axis
from monitor.simulation.reef import reef_scene
from monitor.simulation.room import HEIGHT, LENGTH, STATIONS, WIDTH, cartouche_height, room_scene
from monitor.simulation.true_change import change_at
from projects.transforms import apply

EXACT = without_errors(INSTRUMENTS["faro-photon120"])


@pytest.fixture(scope="module")
def room():
    return room_scene(cell=0.03)


@pytest.fixture(scope="module")
def reef():
    return reef_scene(cell=0.05)


def test_bodies_of_room_and_reef_are_closed(room, reef):
    for body in (*room.bodies, *reef.bodies):
        mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
        assert mesh.is_watertight, body.name
        assert mesh.volume > 0, body.name


def test_the_room_is_seven_and_a_half_by_seven_metres_inside(room, rng):
    below_panels = 0.40  # between skirting and panels the walls are plain
    for axis, half in ((0, 0.5 * LENGTH), (1, 0.5 * WIDTH)):
        for side in (-1.0, 1.0):
            points = np.column_stack([rng.uniform(-2.5, 2.5, (50, 2)), np.full(50, below_panels)])
            points[:, axis] = side * (half - 0.05)
            if axis == 1 and side < 0:
                points[:, 0] += np.where(np.abs(points[:, 0]) < 0.8, 1.8, 0.0)  # beside the door
            np.testing.assert_allclose(room.truth.signed_distance(points), 0.05, atol=1e-9)
            np.testing.assert_allclose(room.truth.normal(points)[:, axis], -side, atol=1e-12)
    up = np.column_stack([rng.uniform(-3.0, -2.5, (20, 2)), np.full(20, HEIGHT - 0.01)])
    np.testing.assert_allclose(room.truth.signed_distance(up), 0.01, atol=1e-9)
    assert room.truth.signed_distance(np.array([[0.0, 0.0, -0.05]])) == pytest.approx(-0.05, abs=1e-9)


def test_a_scan_from_within_meets_the_room_all_round(room):
    pose = stand_at(STATIONS[0], facing=[0.0, 0.0, 0.0])
    scan = simulate_scan(room, EXACT, pose, Window(-np.pi, np.pi, -1.1, 1.5), step=0.02, n_subrays=1)
    assert scan.dropped["no return"] == 0
    points = apply(pose, scan.cloud.points)
    assert np.abs(room.truth.signed_distance(points)).max() < 5e-6
    assert np.all(np.abs(points) < [0.5 * LENGTH + 0.13, 0.5 * WIDTH + 0.13, HEIGHT + 1e-3])  # the door lies 0.12 deep


def test_a_cartouche_has_a_boss_of_forty_millimetres_and_the_walls_show_it(room):
    assert cartouche_height(np.zeros(1), np.zeros(1)) == pytest.approx(0.040)
    at = np.array([[0.0, 0.5 * WIDTH - 0.032, 3.15]])  # the boss stands on a panel sunk by 8 mm
    assert room.truth.signed_distance(at) == pytest.approx(0.0, abs=2e-3)
    # An ellipsoid 40 mm high with half axes 160 and 220 mm: curvatures h / a^2 at its top.
    np.testing.assert_allclose(room.truth.curvature(at), [[0.04 / 0.16**2, 0.04 / 0.22**2]], rtol=0.02)


@pytest.mark.slow
def test_wear_and_infill_of_a_wall_are_as_deep_as_told(room):
    at = np.array([-2.4, 0.5 * WIDTH + 0.008, 1.3])  # a panel's field
    changes = [erode("worn", at, radius=0.3, depth=0.005), fill("filled", [2.4, 0.5 * WIDTH - 0.012, 1.3],
                                                               [0.0, -1.0, 0.0], radius=0.2, depth=0.1)]  # fmt: skip
    after = room_scene(cell=0.03, plain_cell=0.03, changes=changes)
    change = change_at(np.array([at, [2.4, 0.5 * WIDTH + 0.008, 1.3], [0.0, 0.5 * WIDTH + 0.008, 1.3]]), after.truth)
    np.testing.assert_allclose(change, [-0.005, 0.020, 0.0], atol=1e-4)


def test_the_reef_is_seen_at_shallow_angles_and_its_pits_floors_are_not(reef):
    size = np.ptp(reef.bodies[0].vertices, axis=0)
    np.testing.assert_allclose(size[:2], [20.0, 15.0], rtol=0.02)
    feet, incidence = [], []
    for station in reef_file.STATIONS:
        pose = stand_at(station, facing=[0.0, 0.0, 0.0])
        scan = simulate_scan(reef, EXACT, pose, Window(-np.pi, np.pi, -1.1, 0.3), step=0.01, n_subrays=1)
        points = apply(pose, scan.cloud.points)
        feet.append(points)
        beams = (points - station) / np.linalg.norm(points - station, axis=1, keepdims=True)
        incidence.append(np.degrees(np.arcsin(-beams[:, 2])))
    feet = np.concatenate(feet)
    inner = (np.abs(feet[:, 0]) < 5.0) & (np.abs(feet[:, 1]) < 3.0)
    assert np.median(np.concatenate(incidence)[inner]) < 20.0  # degrees above the ground
    pits = reef_file._pits(8)
    floors = pits[pits[:, 2] > 0.15]
    seen = 0
    for u, v, radius in floors:
        floor = np.array([[u, v, 0.0]])
        near = feet[np.linalg.norm((feet - apply(reef_file.slope_frame(), floor))[:, :2], axis=1) < 0.5 * radius]
        depth = (near - apply(reef_file.slope_frame(), floor))[:, 2]
        seen += bool((depth < -0.9 * reef_file.PIT_DEPTH + 0.15).sum() > 5)
    assert seen < 0.5 * len(floors)
    assert reef.regions["pits"](
        apply(reef_file.slope_frame(), np.column_stack([pits[:, :2], np.zeros(len(pits))]))
    ).all()


def test_grid_lines_are_fine_where_asked_and_end_where_told():
    lines = refine_axis(-1.0, 1.0, coarse=0.5, fine=0.01, within=[(-0.2, 0.1), (0.95, 1.4)])
    steps = np.diff(lines)
    assert lines[0] == -1.0
    assert lines[-1] == 1.0
    assert steps.min() > 0.009
    fine = (lines[:-1] >= -0.2 - 1e-9) & (lines[1:] <= 0.1 + 1e-9)
    np.testing.assert_allclose(steps[fine], 0.01, rtol=1e-9)
    assert steps.max() <= 0.5


def test_a_height_fields_field_is_the_height_above_it_in_any_frame(rng):
    T = np.array([[0, 0, 1.0, 2.0], [1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
    axis = np.linspace(-1.0, 1.0, 21)
    slab = HeightField(lambda u, v: 0.1 * u * v, axis, axis, -0.3, 0.2, T)
    u, v, h = rng.uniform(-0.9, 0.9, (3, 50))
    points = apply(T, np.column_stack([u, v, h]))
    np.testing.assert_allclose(slab.field(points.T), np.maximum(h - 0.1 * u * v, -0.3 - h), atol=1e-12)
    body = slab.triangulate(slab.field)
    np.testing.assert_allclose(body.vertices[:441] @ T[:3, 2] - 2.0, 0.1 * np.outer(axis, axis).ravel(), atol=1e-12)
