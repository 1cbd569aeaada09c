"""The staircase: closed parts of true size, exact distances at 20 m from the origin, targets, and what it undergoes."""

import numpy as np
import pytest
import trimesh

from monitor.simulation import INSTRUMENTS, Window, simulate_scan, stand_at, without_errors
from monitor.simulation.changes import erode, move_part, move_whole
from monitor.simulation.prisms import prism_part, triangulate_polygon
from monitor.simulation.solid import evaluate
from monitor.simulation.staircase import (
    BACK,
    BLACK,
    FRONT,
    RISE,
    TOP,
    TREAD,
    WHITE,
    make_board,
    settlement,
    staircase_scene,
)
from monitor.simulation.true_change import change_at
from projects.errors import ParameterError
from projects.transforms import apply

EXACT = without_errors(INSTRUMENTS["faro-photon120"])


@pytest.fixture(scope="module")
def staircase():
    return staircase_scene(ornament=0.03)


def test_every_part_is_closed_and_the_whole_forty_by_eight_by_eight_metres(staircase):
    own = [b for b in staircase.bodies if not b.name.startswith(("ground", "board", "sphere", "foot"))]
    for body in staircase.bodies:
        mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
        assert mesh.is_watertight, body.name
        assert mesh.volume > 0, body.name
    box = np.stack([np.min([b.vertices.min(axis=0) for b in own], axis=0),
                    np.max([b.vertices.max(axis=0) for b in own], axis=0)])  # fmt: skip
    np.testing.assert_allclose(box, [[-20.03, -4.0, 0.0], [20.03, 4.0, 8.0]], atol=1e-9)  # with the lowest noses


def test_distances_to_treads_walls_and_landing_are_exact_far_from_the_origin(staircase, rng):
    n = 200
    y = rng.uniform(-1.0, 1.0, n)
    k = rng.integers(1, 25, n)
    tread = np.column_stack([-20.0 + (k - 0.7) * TREAD + rng.uniform(0, 0.2, n), y, k * RISE])
    landing = np.column_stack([rng.uniform(-7, 7, n), y, np.full(n, TOP)])
    front = np.column_stack([rng.uniform(-19, 19, n), np.full(n, FRONT), np.full(n, 0.1)])
    for points, normal in ((tread, [0, 0, 1.0]), (landing, [0, 0, 1.0]), (front, [0, -1.0, 0])):
        for height in (0.01, -0.01, 1e-5, -1e-5):
            found = staircase.truth.signed_distance(points + height * np.array(normal))
            np.testing.assert_allclose(found, height, atol=1e-9)
        np.testing.assert_allclose(staircase.truth.normal(points), np.tile(normal, (n, 1)), atol=1e-12)
        assert not np.nan_to_num(staircase.truth.curvature(points + 1e-3 * np.array(normal))).any()


def test_just_below_a_nosing_the_nearest_surface_is_its_underside(staircase):
    heights = np.array([-1e-3, -1e-4, -1e-5, 1e-5, 1e-4, 1e-3])
    near = np.column_stack([np.full(6, -20.00097676), np.full(6, -0.13538802), 0.1 + heights])
    expected = np.where(heights < -9.7e-4, 0.00097676, -heights)  # a millimetre below, the riser is as near
    np.testing.assert_allclose(staircase.truth.signed_distance(near), expected, atol=1e-9)


def test_a_scan_shows_the_far_wall_to_float32s_two_micrometres(staircase):
    pose = stand_at([13.0, -0.5, 4.0], facing=[13.0, 4.0, 4.0])
    scan = simulate_scan(staircase, EXACT, pose, Window(-0.05, 0.05, 0.15, 0.2), step=0.002)
    y = apply(pose, scan.cloud.points)[:, 1]
    assert len(y) > 1000
    assert np.abs(y - BACK).max() < 4e-6  # float32 at 20 m rounds to 1 um; the beam's inverse-square weight adds 1


def test_a_board_shows_its_fields_about_its_centre(staircase):
    target = next(t for t in staircase.targets if t.name == "board 1")
    pose = stand_at(target.centre - [0.0, 4.0, 0.0], facing=target.centre)
    half = 0.06 / 4.0
    scan = simulate_scan(staircase, EXACT, pose, Window(-half, half, -half, half), step=half / 20)
    right, up = -scan.cloud.points[:, 1], scan.cloud.points[:, 2]
    clear = np.minimum(np.abs(right), np.abs(up)) > 0.006  # beyond the footprint's reach
    black = (right < 0) == (up > 0)
    seen = scan.cloud.intensity
    np.testing.assert_allclose(seen[clear & black], BLACK, rtol=0.12)
    np.testing.assert_allclose(seen[clear & ~black], WHITE, rtol=0.12)
    assert {t.kind for t in staircase.targets} == {"sphere", "board"}


def test_a_spheres_points_lie_about_its_centre(staircase):
    target = next(t for t in staircase.targets if t.kind == "sphere")
    assert target.size == 0.0725
    pose = stand_at(target.centre + np.array([0.0, -5.0, 1.0]), facing=target.centre)
    tilt = -np.arctan2(1.0, 5.0)
    scan = simulate_scan(
        staircase, EXACT, pose, Window(-0.01, 0.01, tilt - 0.01, tilt + 0.01), step=0.0005, n_subrays=1
    )
    r = np.linalg.norm(apply(pose, scan.cloud.points) - target.centre, axis=1)
    assert np.all((r <= target.size + 2e-6) & (r > target.size * (1 - (np.pi / 160) ** 2 / 4) - 2e-6))


def test_a_settlement_of_the_whole_and_a_lifted_step_are_told_exactly(staircase, rng):
    sunk = staircase_scene(ornament=0.03, changes=[move_whole("settlement", settlement(0.006))])
    points = np.column_stack([rng.uniform(-7, 7, 50), rng.uniform(-2, 2, 50), np.full(50, TOP)])
    np.testing.assert_allclose(change_at(points, sunk.truth), -0.006, atol=1e-9)
    lift = np.eye(4)
    lift[2, 3] = 0.05
    raised = staircase_scene(ornament=0.03, changes=[move_part("frost", "left step 5", lift)])
    tread = np.array([[-20.0 + 4.5 * TREAD, 0.0, 5 * RISE], [-20.0 + 3.5 * TREAD, 0.0, 4 * RISE]])
    np.testing.assert_allclose(change_at(tread, raised.truth), [0.05, 0.0], atol=1e-9)


@pytest.mark.slow
def test_a_worn_step_is_worn_by_its_depth(staircase):
    at = np.array([-20.0 + 4.5 * TREAD, 0.0, 5 * RISE])
    worn = staircase_scene(
        cell=0.02, ornament=0.03, changes=[erode("worn tread", at, radius=0.15, depth=0.01, part="left step 5")]
    )
    assert change_at(at[None], worn.truth) == pytest.approx(-0.01, abs=3e-4)
    far = at + np.array([0.0, 1.5, 0.0])
    assert change_at(far[None], worn.truth) == pytest.approx(0.0, abs=1e-6)


def test_a_prisms_field_is_the_distance_to_its_triangles(rng):
    polygon = np.array([[0, 0], [2, 0], [2, 1], [1.2, 0.4], [0.8, 1.4], [0, 1]], dtype=float)
    for plane in ("xz", "yz", "xy"):
        part = prism_part("p", polygon, -0.5, 0.7, plane=plane)
        mesh = trimesh.Trimesh(part.mesh.vertices, part.mesh.faces, process=False)
        assert mesh.is_watertight
        assert mesh.volume == pytest.approx(1.2 * 1.88, rel=1e-12)  # the polygon's area by the shoelace formula
        points = rng.uniform(-1, 3, (300, 3))
        _, distance, _ = trimesh.proximity.closest_point_naive(mesh, points)
        np.testing.assert_allclose(np.abs(evaluate(part.field, points)), distance, atol=1e-9)


def test_a_clockwise_polygon_is_refused():
    with pytest.raises(ParameterError, match="counter-clockwise"):
        triangulate_polygon(np.array([[0, 0], [0, 1], [1, 1], [1, 0.0]]))


def test_a_board_looks_where_it_was_told():
    body, target = make_board("b", np.array([1.0, 2.0, 3.0]), np.array([0.0, -2.0, 0.0]))
    np.testing.assert_allclose(target.centre, [1, 2, 3])
    np.testing.assert_allclose(target.normal, [0, -1, 0])
    corners = body.vertices[body.faces[:8]]
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(n / np.linalg.norm(n, axis=1, keepdims=True), np.tile([0, -1.0, 0], (8, 1)), atol=1e-12)
