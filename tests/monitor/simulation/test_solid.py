"""Solids, their contours, the change measured between two of them, and the scenes' truths."""

import numpy as np
import pytest
import trimesh
from torus_shape import torus

from monitor.simulation import plane_scene, sphere_scene, step_scene, wave_scene
from monitor.simulation.changes import hollow_out
from monitor.simulation.inscription import write_line
from monitor.simulation.shapes import ball, box, capsule, draw_polygon, ellipsoid
from monitor.simulation.solid import Part, Solid, contour, evaluate, smooth_min
from monitor.simulation.true_change import measure_change
from monitor.simulation.truth import close_in
from projects.errors import ParameterError


def test_contour_of_a_ball_is_closed_outward_and_on_the_ball():
    vertices, faces = contour(ball((0.01, 0.02, -0.01), 0.1), np.array([[-0.12] * 3, [0.13] * 3]), cell=0.004)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 1e-3, rel=1e-3)
    np.testing.assert_allclose(np.linalg.norm(vertices - [0.01, 0.02, -0.01], axis=1), 0.1, atol=1e-6)


def test_contour_of_a_ring_has_a_hole():
    vertices, faces = contour(
        torus((0, 0, 0), (0.3, 0.1, 1), 0.1, 0.03), np.array([[-0.14] * 3, [0.14] * 3]), cell=0.005
    )
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.euler_number == 0
    assert mesh.volume == pytest.approx(2 * np.pi**2 * 0.1 * 0.03**2, rel=0.01)


def test_contour_follows_a_field_that_is_far_steeper_than_expected():
    def steep(p):
        return 2.5 * (np.sqrt((p * p).sum(axis=0)) - 0.05 - 0.02 * np.sin(40.0 * p[0]))

    vertices, faces = contour(steep, np.array([[-0.1] * 3, [0.1] * 3]), cell=0.004, slope=1.0, n_levels=3)
    assert trimesh.Trimesh(vertices, faces, process=False).is_watertight


def test_a_solid_that_leaves_its_box_is_refused():
    with pytest.raises(ParameterError, match="leaves the box"):
        contour(ball((0, 0, 0), 0.1), np.array([[-0.05] * 3, [0.2] * 3]), cell=0.01)


def test_a_solid_skips_far_parts_without_changing_its_surface(rng):
    parts = [("a", ball((0, 0, 0), 0.05), -0.05, 0.05), ("b", ball((0.06, 0, 0), 0.04), 0.02, 0.10),
             ("c", ball((0.4, 0, 0), 0.05), 0.35, 0.45)]  # fmt: skip
    solid = Solid(tuple(Part(n, f, np.array([[a, -0.05, -0.05], [b, 0.05, 0.05]]), 0.02) for n, f, a, b in parts))
    points = rng.uniform([-0.1, -0.1, -0.1], [0.5, 0.1, 0.1], (4000, 3))
    whole = smooth_min(smooth_min(parts[0][1](points.T), parts[1][1](points.T), 0.02), parts[2][1](points.T), 0.02)
    found = evaluate(solid, points)
    near = np.abs(whole) < 0.005
    np.testing.assert_allclose(found[near], whole[near], atol=1e-12)
    np.testing.assert_array_equal(found < 0, whole < 0)


@pytest.mark.parametrize(
    ("field", "points", "distances"),
    [
        (box((0, 0, 0), (1, 2, 3)), [(2, 0, 0), (0, 0, 0), (2, 3, 0)], [1, -1, np.sqrt(2)]),
        (capsule((0, 0, 0), (0, 0, 2), 0.5), [(1, 0, 1), (0, 0, 3)], [0.5, 0.5]),
        (ellipsoid((0, 0, 0), (2, 1, 1)), [(2, 0, 0), (0, 1, 0), (0, 0, 0)], [0, 0, -1]),
        (torus((0, 0, 0), (0, 0, 1), 2.0, 0.5), [(2, 0, 0), (0, 3, 0)], [-0.5, 0.5]),
    ],
)
def test_shapes_have_their_distances(field, points, distances):
    np.testing.assert_allclose(field(np.array(points, dtype=float).T), distances, atol=1e-12)


def test_a_drawn_polygon_has_signed_distances():
    square = draw_polygon(np.array([(-1, -1), (1, -1), (1, 1), (-1, 1.0)]), (-2, -2), (2, 2), step=0.01)
    np.testing.assert_allclose(square(np.array([0.0, 1.5, 0.9]), np.array([0.0, 0.0, 0.5])), [-1, 0.5, -0.1], atol=1e-6)


def test_an_inscription_is_centred_and_as_high_as_asked():
    strokes = np.concatenate(write_line("HERITAGE", height=0.036, middle=(0.1, 0.2)))
    assert np.ptp(strokes[:, 1]) == pytest.approx(0.036, rel=1e-6)
    assert strokes[:, 1].mean() == pytest.approx(0.2, abs=0.004)
    assert 0.5 * (strokes[:, 0].min() + strokes[:, 0].max()) == pytest.approx(0.1, abs=0.003)
    with pytest.raises(ParameterError, match="no strokes for Q"):
        write_line("Q", height=1.0, middle=(0, 0))


def test_a_hollow_is_measured_as_the_spherical_cap_that_it_is():
    radius, depth = 0.05, 0.01
    block = box((0, 0, -0.05), (0.08, 0.08, 0.05))
    cap = ball((0, 0, radius - depth), radius)
    area_box = np.array([[-0.04, -0.04, -0.02], [0.04, 0.04, 0.01]])
    change = measure_change("cap", block, lambda p: np.maximum(block(p), -cap(p)), area_box)
    rim2 = 2 * radius * depth - depth**2
    assert change.kind == "lost"
    assert change.volume == pytest.approx(-np.pi * depth**2 * (radius - depth / 3), rel=0.01)
    assert change.extreme == pytest.approx(-depth, rel=0.01)
    # Where the hollow is deeper than the threshold, seen from the block's flat top.
    inner = (radius - depth) / (radius - change.threshold)  # distance to the cap > threshold inside this circle
    assert change.area == pytest.approx(np.pi * (radius - depth) ** 2 * (1 / inner**2 - 1), rel=0.03)
    assert change.area < np.pi * rim2
    np.testing.assert_allclose(change.centre, 0.0, atol=5e-4)


def test_an_uneven_hollow_changes_nothing_outside_of_its_box(rng):
    edit = hollow_out("hollow", np.array([0.0, 0.0, 0.03]), np.array([0.05, 0.05, 0.04]))
    block = box((0, 0, -0.05), (0.2, 0.2, 0.05))
    points = rng.uniform(-0.2, 0.2, (20000, 3)).T
    outside = ((points < edit.box[0][:, None]) | (points > edit.box[1][:, None])).any(axis=0)
    same = np.abs(edit.apply(block)(points) - block(points)) < 1e-12
    assert same[outside & (np.abs(block(points)) < 0.0015)].all()
    assert not same.all()


def test_sliding_along_the_surface_finds_the_closest_point(rng):
    field = ellipsoid((0, 0, 0), (0.2, 0.1, 0.05))
    turn = rng.normal(size=(200, 3))
    foot = turn / np.linalg.norm(turn / [0.2, 0.1, 0.05], axis=1, keepdims=True)
    normal = foot / np.array([0.2, 0.1, 0.05]) ** 2
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    points = foot + 0.004 * normal
    start = foot + rng.normal(scale=0.002, size=foot.shape)
    start = start / np.linalg.norm(start / [0.2, 0.1, 0.05], axis=1, keepdims=True)
    found = close_in(field, points, start, n_steps=20)
    np.testing.assert_allclose(np.linalg.norm(points - found, axis=1), 0.004, atol=2e-6)


@pytest.mark.parametrize("scene", [plane_scene(), sphere_scene(n_rings=200), step_scene(), wave_scene(size=0.05)])
def test_scenes_are_closed_and_their_truth_agrees_with_their_mesh(scene, rng):
    for body in scene.bodies:
        assert trimesh.Trimesh(body.vertices, body.faces, process=False).is_watertight
        assert trimesh.Trimesh(body.vertices, body.faces, process=False).volume > 0
    points = rng.uniform(-0.02, 0.02, (300, 3)) + (np.array([0, 0, 0.1]) if scene.name == "sphere" else 0.0)
    truth = scene.truth
    foot, distance, normal = truth.closest_point(points), truth.signed_distance(points), truth.normal(points)
    np.testing.assert_allclose(np.linalg.norm(points - foot, axis=1), np.abs(distance), atol=1e-9)
    np.testing.assert_allclose(truth.signed_distance(foot), 0.0, atol=1e-9)
    smooth = np.abs(np.einsum("ij,ij->i", points - foot, normal)) > 0.999 * np.abs(distance)
    assert smooth.mean() > (0.6 if scene.name == "step" else 0.999)
    np.testing.assert_array_equal(
        np.sign(np.einsum("ij,ij->i", points - foot, normal))[smooth], np.sign(distance)[smooth]
    )


def test_the_closest_point_of_a_wave_is_closer_than_any_sample_of_it(rng):
    truth = wave_scene(wavelength=0.01, amplitude=0.001).truth
    points = rng.uniform([-0.02, 0, -0.004], [0.02, 0, 0.004], (200, 3))
    x = np.linspace(-0.04, 0.04, 200_001)
    curve = np.column_stack([x, np.zeros_like(x), 0.001 * np.cos(2 * np.pi * x / 0.01)])
    best = np.array([np.linalg.norm(curve - p, axis=1).min() for p in points])
    np.testing.assert_allclose(np.abs(truth.signed_distance(points)), best, atol=2e-7)
