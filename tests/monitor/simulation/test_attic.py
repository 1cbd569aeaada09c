"""The attic sculpture: closed, 2.5 m high, its limbs hide its chest, and its raised arm is a part of its own."""

import numpy as np
import pytest
import trimesh

from monitor.simulation import attic_model, attic_stations, break_off, build_scene, erode, measure_changes, move_part
from monitor.simulation.attic_sculpture import HEAD, PEDESTAL_HEIGHT
from monitor.simulation.model import change_model
from monitor.simulation.solid import evaluate
from projects.open3d_library import load_open3d
from projects.transforms import apply, perturb

CELL = 0.012


@pytest.fixture(scope="module")
def scene():
    """Return the sculpture in coarse triangles."""
    return build_scene(attic_model(cell=CELL))


def in_metres(heads):
    """Return points of the sculpture's own unit in metres on the pedestal."""
    return HEAD * np.asarray(heads, dtype=float) + [0.0, 0.0, PEDESTAL_HEIGHT]


def test_the_sculpture_is_closed_and_as_high_as_told(scene):
    assert [body.name for body in scene.bodies] == ["pedestal", "figure", "raised arm", "floor"]
    for body in scene.bodies:
        mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
        assert mesh.is_watertight  # each edge in two faces, one each way
        assert mesh.volume > 0
    assert max(body.vertices[:, 2].max() for body in scene.bodies) == pytest.approx(2.5, abs=0.05)


def test_the_chest_behind_the_arm_is_seen_from_fewer_stations_than_the_shin(scene):
    o3d = load_open3d()
    rays = o3d.t.geometry.RaycastingScene()
    for body in scene.bodies:
        rays.add_triangles(
            o3d.core.Tensor(body.vertices.astype(np.float32)), o3d.core.Tensor(body.faces.astype(np.uint32))
        )
    chest, shin = in_metres([(0.30, -0.60, 5.10)]), in_metres([(-0.50, -0.70, 1.50)])
    feet = scene.truth.closest_point(np.concatenate([chest, shin]))
    lifted = feet + 0.002 * scene.truth.normal(feet)
    stations = [s.T_project_scanner[:3, 3] for s in attic_stations()]
    sight = np.array([[[*p, *(s - p)] for s in stations] for p in lifted], dtype=np.float32)
    n_seeing = (~rays.test_occlusions(o3d.core.Tensor(sight), tfar=1.0).numpy()).sum(axis=1)
    assert n_seeing[0] < n_seeing[1]


def test_the_raised_arm_turns_about_its_dowel_and_the_figure_stays(scene):
    T = perturb(np.eye(4), in_metres([-0.80, 0.02, 5.92]), np.array([0.0, 0.02, 0.0, 0.0, 0.0, 0.0]))
    model = attic_model(cell=CELL)
    edit = move_part("arm set 20 mrad too low", "raised arm", T)
    after = build_scene(model, [edit])
    np.testing.assert_allclose(after.bodies[2].vertices, apply(T, scene.bodies[2].vertices), atol=1e-12)
    for k in (0, 1, 3):
        np.testing.assert_array_equal(after.bodies[k].vertices, scene.bodies[k].vertices)
    (change,) = measure_changes(model, [edit])
    reach = HEAD * np.hypot(8.58 - 5.92, 0.42 - 0.80)  # from the dowel to the baton's end
    assert change.kind == "moved"
    assert 0.3 * 0.02 * reach < abs(change.extreme) < 1.1 * 0.02 * (reach + 0.05)


def test_the_broken_end_of_the_baton_is_lost_with_its_volume(rng):
    model = attic_model(cell=CELL)
    end = in_metres([-0.42, -0.66, 8.58])
    box = np.stack([end - 0.07, end + 0.07])
    edit = break_off("end of the baton", end - np.array([0.015, 0.0, 0.015]), [0.7, -0.1, 0.7], box=box)
    (change,) = measure_changes(model, [edit])
    points = rng.uniform(*box, (300_000, 3))
    before, after = model.field(), change_model(model, [edit]).field()
    lost = (evaluate(after, points) < 0).astype(int) - (evaluate(before, points) < 0)
    volume = np.prod(np.ptp(box, axis=0))
    assert change.kind == "lost"
    assert abs(volume * lost.mean() - change.volume) < 4 * volume * lost.std() / np.sqrt(len(points))
    assert -0.08 < change.extreme < -0.03


def test_wear_leaves_what_lies_far_from_it_and_asks_nothing_of_no_points(scene):
    figure = attic_model(cell=CELL).part("figure").field
    knee = scene.truth.closest_point(in_metres([(-0.50, -0.90, 2.30)]))
    worn = erode("worn knee", knee[0], radius=0.04, depth=0.003).apply(figure)
    far = in_metres([(0.30, -0.60, 5.10), (0.0, 0.0, 7.0)]).T
    np.testing.assert_array_equal(worn(far), figure(far))
    assert worn(knee.T) - figure(knee.T) == pytest.approx(0.003, abs=1e-5)
