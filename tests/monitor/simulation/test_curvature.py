"""The curvature that a truth tells: analytic scenes, and fields against shapes whose curvature is known."""

import numpy as np
import pytest
from torus_shape import torus

from monitor.simulation import plane_scene, sphere_scene, step_scene, wave_scene
from monitor.simulation.shapes import ball
from monitor.simulation.solid import principal_curvatures
from projects.transforms import perturb


def test_a_ball_is_convex_everywhere_by_one_over_its_radius(rng):
    points = rng.normal(size=(50, 3))
    np.testing.assert_allclose(sphere_scene(radius=0.2, n_rings=10).truth.curvature(points), 5.0)
    on_ball = 0.2 * points / np.linalg.norm(points, axis=1, keepdims=True)
    np.testing.assert_allclose(principal_curvatures(ball(np.zeros(3), 0.2), on_ball), 5.0, rtol=1e-4)


def test_a_field_twice_as_steep_has_the_same_curvature(rng):
    on_ball = rng.normal(size=(50, 3))
    on_ball *= 0.1 / np.linalg.norm(on_ball, axis=1, keepdims=True)
    steep = principal_curvatures(lambda p: 2.0 * ball(np.zeros(3), 0.1)(p), on_ball)
    np.testing.assert_allclose(steep, 10.0, rtol=1e-4)


def test_a_ring_is_a_saddle_inside_and_convex_outside():
    ring = torus(np.zeros(3), [0.0, 0.0, 1.0], 0.3, 0.1)
    outside, inside = np.array([[0.4, 0.0, 0.0]]), np.array([[0.0, 0.2, 0.0]])
    np.testing.assert_allclose(principal_curvatures(ring, outside), [[10.0, 2.5]], rtol=1e-4)
    np.testing.assert_allclose(principal_curvatures(ring, inside), [[10.0, -5.0]], rtol=1e-4)


def test_a_wave_bends_by_its_second_derivative_at_the_crest_and_against_it_in_the_trough():
    truth = wave_scene(wavelength=0.01, amplitude=0.0005).truth
    bend = 0.0005 * (2 * np.pi / 0.01) ** 2
    found = truth.curvature(np.array([[0.0, 0.0, 0.0005], [0.005, 0.0, -0.0005], [0.0025, 0.0, 0.0]]))
    np.testing.assert_allclose(found, [[bend, 0.0], [0.0, -bend], [0.0, 0.0]], atol=1e-6)
    # Between crest and zero the slope counts: the normals' turn along the path, by differences of the truth itself.
    x = 0.0012 + np.array([-1e-6, 1e-6])
    path = np.column_stack([x, 0 * x, 0.0005 * np.cos(2 * np.pi * x / 0.01)])
    n = truth.normal(path)
    turn = np.arcsin(np.cross(n[1], n[0])[1] * -1) / np.linalg.norm(path[1] - path[0])
    assert truth.curvature(path)[0, 0] == pytest.approx(abs(turn), rel=1e-3)


def test_planes_are_flat_and_edges_unknown():
    assert not plane_scene().truth.curvature(np.ones((3, 3))).any()
    truth = step_scene(height=0.05).truth
    found = truth.curvature(np.array([[-0.2, 0.0, 0.01], [-0.01, 0.0, 0.02], [-0.01, 0.0, 0.08]]))
    np.testing.assert_array_equal(found, [[0, 0], [0, 0], [np.nan, np.nan]])


def test_curvature_moves_with_the_body(rng):
    T = perturb(np.eye(4), np.zeros(3), rng.normal(size=6))
    truth = wave_scene().truth
    points = np.column_stack([rng.uniform(-0.02, 0.02, (20, 2)), np.zeros(20)])
    moved = truth.moved(T).curvature(points @ T[:3, :3].T + T[:3, 3])
    np.testing.assert_allclose(moved, truth.curvature(points), atol=1e-6)
