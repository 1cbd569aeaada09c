"""Models of named parts, the changes made to them, and how large each truly is."""

import numpy as np
import pytest
import trimesh

from monitor.simulation import (
    Model,
    ModelPart,
    box_part,
    break_off,
    build_scene,
    change_at,
    change_model,
    clean,
    coat,
    erode,
    fill,
    hollow_out,
    measure_changes,
    move_part,
    move_whole,
)
from monitor.simulation.scenes import make_box
from monitor.simulation.shapes import ball
from projects.errors import ParameterError
from projects.transforms import apply, perturb

RADIUS = 0.1


def still_life(cell=0.006):
    """Return a ball beside a block that stands on another, before a wall that is not monitored."""
    globe = ModelPart(
        "globe", ball((0.3, 0.0, 0.2), RADIUS), np.array([[0.2, -0.1, 0.1], [0.4, 0.1, 0.3]]), cell, gloss=0.04
    )
    upper = box_part("upper block", [-0.15, -0.15, 0.2], [0.05, 0.05, 0.4], cell=cell)
    lower = box_part("lower block", [-0.2, -0.2, 0.0], [0.1, 0.1, 0.2], cell=cell)
    wall = make_box("wall", np.array([-1.0, 0.5, 0.0]), np.array([1.0, 0.6, 1.0]))
    return Model("still life", (globe, upper, lower), (wall,))


@pytest.fixture
def model():
    """Return the still life in coarse triangles."""
    return still_life()


def surface_point(direction, radius=RADIUS):
    """Return a point of the globe."""
    return np.array([0.3, 0.0, 0.2]) + radius * np.asarray(direction, dtype=float) / np.linalg.norm(direction)


def change_near(model, point, changes):
    """Return the true change at the vertex of the globe nearest to a point."""
    vertices = build_scene(model).bodies[0].vertices
    nearest = vertices[np.linalg.norm(vertices - point, axis=1).argmin()]
    return float(change_at(nearest[None], build_scene(model, changes).truth)[0])


def rigid(w, t, centre=(0.0, 0.0, 0.0)):
    """Return the motion by rotation vector w about a centre, then t."""
    return perturb(np.eye(4), np.asarray(centre, dtype=float), np.concatenate([w, t]))


def test_each_body_of_a_built_scene_is_closed_and_the_truth_holds_its_vertices(model):
    scene = build_scene(model)
    assert [body.name for body in scene.bodies] == ["globe", "upper block", "lower block", "wall"]
    assert scene.bodies[0].gloss == 0.04
    for body in scene.bodies:
        assert trimesh.Trimesh(body.vertices, body.faces, process=False).is_watertight
    assert len(scene.bodies[1].faces) == 12  # the block keeps its exact triangles
    np.testing.assert_allclose(scene.truth.signed_distance(scene.bodies[0].vertices), 0.0, atol=1e-7)


def test_the_truth_of_parts_is_exact_beside_each_of_them(model):
    truth = build_scene(still_life(cell=0.0015)).truth  # facets lie 2.8 um inside the globe at the most
    points = np.array(
        [[0.3, 0.0, 0.35], [0.3, 0.0, 0.295], [-0.05, -0.05, 0.43], [-0.05, -0.05, 0.39], [0.08, 0.0, 0.21]]
    )
    distances = truth.signed_distance(points)
    np.testing.assert_allclose(distances[:2], [0.05, -0.005], atol=5e-6)
    np.testing.assert_allclose(distances[2:], [0.03, -0.01, 0.01], atol=1e-12)
    np.testing.assert_allclose(
        truth.normal(points), [[0, 0, 1.0], [0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 1]], atol=0.02
    )
    np.testing.assert_allclose(truth.closest_point(points)[0], [0.3, 0.0, 0.3], atol=4e-4)
    np.testing.assert_allclose(truth.curvature(points), [[10, 10], [10, 10], [0, 0], [0, 0], [0, 0]], atol=1e-4)


def test_an_even_erosion_of_a_patch_sinks_it_by_its_depth_along_the_normal(model):
    centre = surface_point([0.0, -1.0, 0.4])
    edit = erode("worn", centre, radius=0.05, depth=0.002, plateau=0.8)
    (change,) = measure_changes(model, [edit])
    assert change.kind == "lost"
    assert change.extreme == pytest.approx(-0.002, rel=0.005)
    # The cap that a ball of 50 mm cuts from the globe has the area pi r**2; the rim is worn by half in the mean of
    # its radii: volume = depth * integral of 2 pi r w(r) dr less the shrinking of the sphere, (1 - depth / R).
    r = np.linspace(0.0, 0.05, 100_001)
    t = np.clip((r - 0.04) / 0.01, 0.0, 1.0)
    expected = 0.002 * np.trapezoid(2 * np.pi * r * (1.0 - t * t * (3 - 2 * t)), r)
    assert change.volume == pytest.approx(-expected, rel=0.03)
    assert change_near(model, centre, [edit]) == pytest.approx(-0.002, abs=2e-6)
    assert change_near(model, surface_point([1.0, 0.0, 0.0]), [edit]) == 0.0


def test_a_coat_rises_by_its_height_where_the_part_was_held_before(model):
    top = np.array([-0.05, -0.05, 0.4])
    edit = coat("mortar left", top, radius=0.04, height=0.003)
    scene = build_scene(model, [edit])
    np.testing.assert_allclose(change_at(top[None], scene.truth), [0.003], atol=1e-6)
    assert scene.bodies[1].vertices[:, 2].max() == pytest.approx(0.403, abs=1e-5)
    assert measure_changes(model, [edit])[0].extreme == pytest.approx(0.003, rel=0.01)


def test_cleaning_takes_the_same_everywhere_and_is_measured_below_the_threshold(model):
    edit = clean("glaze cleaned", depth=0.0003, part="globe")
    (change,) = measure_changes(model, [edit])
    sphere = 4.0 * np.pi * RADIUS**2
    assert change.kind == "lost"
    assert change.extreme == pytest.approx(-0.0003, rel=0.01)
    assert change.area == pytest.approx(sphere, rel=0.003)
    assert change.volume == pytest.approx(-4.0 / 3.0 * np.pi * (RADIUS**3 - (RADIUS - 0.0003) ** 3), rel=0.01)
    assert change.threshold == pytest.approx(0.00015, rel=0.01)


def test_cleaning_inside_a_box_leaves_the_rest(model):
    box = np.array([[0.2, -0.15, 0.1], [0.4, 0.0, 0.35]])
    edits = [clean("half cleaned", depth=0.0003, box=box, part="globe")]
    assert change_near(model, surface_point([0.3, -1.0, 0.2]), edits) == pytest.approx(-0.0003, abs=1e-6)
    assert change_near(model, surface_point([0.3, 1.0, 0.2]), edits) == 0.0


def test_a_hollow_that_was_filled_stands_level_again(model):
    top = np.array([-0.05, -0.05, 0.4])
    hollow = hollow_out("hollow", top + np.array([0, 0, 0.02]), np.array([0.03, 0.03, 0.03]), part="upper block")
    infill = fill("infill", top, [0.0, 0.0, 1.0], radius=0.035, depth=0.02, part="upper block")
    lost, added = measure_changes(model, [hollow, infill])
    assert (lost.kind, added.kind) == ("lost", "added")
    assert lost.volume < -2e-6
    assert added.volume == pytest.approx(-lost.volume, rel=0.01)
    after = build_scene(model, [hollow, infill]).truth
    np.testing.assert_allclose(change_at(top[None], after), [0.0], atol=1e-7)


def test_a_corner_broken_off_is_lost_in_the_volume_that_its_fracture_cuts(model, rng):
    corner = np.array([0.05, -0.15, 0.4])
    box = np.stack([corner - 0.06, corner + 0.02])
    edit = break_off("corner", corner - np.array([0.01, -0.01, 0.01]), [1.0, -1.0, 1.0], box=box)
    (change,) = measure_changes(model, [edit])
    # The plane x - y + z = -0.03 from the corner cuts a pyramid of legs 30 mm, give or take 2 mm of roughness.
    assert change.volume == pytest.approx(-(0.03**3) / 6.0, rel=0.1)
    points = rng.uniform(*box, (400_000, 3)).T
    before, after = model.field(), change_model(model, [edit]).field()
    share = (after(points) < 0).astype(int) - (before(points) < 0)
    sigma = np.prod(np.ptp(box, axis=0)) * share.std() / np.sqrt(points.shape[1])
    assert abs(np.prod(np.ptp(box, axis=0)) * share.mean() - change.volume) < 4 * sigma


def test_a_moved_part_moves_and_nothing_else_does(model):
    T = rigid([0.0, 0.0, 0.05], [0.004, 0.0, 0.0], centre=[-0.05, -0.05, 0.3])
    edit = move_part("upper block shifted", "upper block", T)
    before, after = build_scene(model), build_scene(model, [edit])
    np.testing.assert_allclose(after.bodies[1].vertices, apply(T, before.bodies[1].vertices), atol=1e-12)
    for k in (0, 2, 3):
        np.testing.assert_array_equal(after.bodies[k].vertices, before.bodies[k].vertices)
    np.testing.assert_allclose(after.truth.signed_distance(after.bodies[1].vertices[4:]), 0.0, atol=1e-6)
    (change,) = measure_changes(model, [edit])
    assert change.kind == "moved"
    assert change.volume == pytest.approx(0.0, abs=1e-12)
    # The corner of the block's lateral face lies (0.1, 0.1) from the axis: it comes out by 4 mm + 0.05 * 0.1 m.
    assert abs(change.extreme) == pytest.approx(0.009, rel=0.03)


def test_a_part_can_be_changed_after_it_was_moved(model):
    T = rigid([0.0, 0.0, 0.0], [0.0, 0.0, 0.05])
    centre = surface_point([0.0, -1.0, 0.0]) + np.array([0.0, 0.0, 0.05])
    edits = [move_part("globe lifted", "globe", T), erode("worn", centre, radius=0.03, depth=0.001, part="globe")]
    globe = [build_scene(model, edits[:n]).bodies[0].vertices for n in (0, 1, 2)]
    np.testing.assert_allclose(globe[1], globe[0] + [0.0, 0.0, 0.05], atol=1e-12)
    worn = np.linalg.norm(globe[2] - globe[1], axis=1)
    at_centre = np.linalg.norm(globe[1] - centre, axis=1) < 0.012
    np.testing.assert_allclose(worn[at_centre], 0.001, atol=1e-9)
    np.testing.assert_array_equal(worn[np.linalg.norm(globe[1] - centre, axis=1) > 0.03], 0.0)


def test_moving_the_whole_leaves_the_surroundings_and_is_no_region(model):
    T = rigid([0.0, 0.01, 0.0], [0.0, 0.003, 0.0])
    before, after = build_scene(model), build_scene(model, [move_whole("settled", T)])
    for k in (0, 1, 2):
        np.testing.assert_allclose(after.bodies[k].vertices, apply(T, before.bodies[k].vertices), atol=1e-12)
    np.testing.assert_array_equal(after.bodies[3].vertices, before.bodies[3].vertices)
    assert measure_changes(model, [move_whole("settled", T)]) == ()
    points = np.array([[0.3, 0.0, 0.35], [-0.05, -0.05, 0.43]])
    np.testing.assert_allclose(
        after.truth.signed_distance(apply(T, points)), before.truth.signed_distance(points), atol=1e-7
    )


def test_changes_that_name_no_part_or_reach_none_are_refused(model):
    with pytest.raises(ParameterError, match=r"no part 'shelf'; its parts are globe, upper block"):
        change_model(model, [move_part("x", "shelf", np.eye(4))])
    with pytest.raises(ParameterError, match="reaches 0 parts"):
        change_model(model, [erode("far off", [3.0, 0.0, 0.0], radius=0.1, depth=0.001)])
    with pytest.raises(ParameterError, match="reaches 2 parts"):
        change_model(model, [fill("joint", [0.05, -0.05, 0.2], [1, 0, 0], radius=0.02, depth=0.01)])
    with pytest.raises(ParameterError, match="mirrors"):
        move_part("x", "globe", np.diag([1.0, 1.0, -1.0, 1.0]))


def test_faces_inside_of_another_part_are_no_surface():
    tile = box_part("tile", [-0.05, -0.02, 0.0], [0.05, 0.06, 0.1], cell=0.01)
    core = box_part("core", [-0.2, 0.0, -0.2], [0.2, 0.3, 0.3], cell=0.01)
    truth = build_scene(Model("tiled wall", (tile, core))).truth
    # The second point lies 2 mm from the tile's back, which is deep in the core: its sides, covered in part, are next.
    points = np.array([[0.0, -0.03, 0.05], [0.0, 0.058, 0.05], [0.1, -0.03, 0.05], [0.0, 0.15, 0.2]])
    np.testing.assert_allclose(truth.signed_distance(points), [0.01, -0.05, 0.03, -0.1], atol=1e-9)
    np.testing.assert_allclose(truth.normal(points)[2], [0.0, -1.0, 0.0], atol=1e-9)
