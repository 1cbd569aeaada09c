"""Closest points and distances of bodies that are their meshes, against boxes whose answers are known."""

import numpy as np
import pytest
import trimesh

from monitor.simulation.mesh_truth import closest_on_faces, truth_of_bodies
from monitor.simulation.scenes import Body, make_ball, make_box


@pytest.fixture(scope="module")
def truth():
    """Return the truth of a box of 2 x 2 x 2 m about the origin, 15 m aside from a small box that it touches not."""
    far = make_box("far", np.array([14.0, -0.1, -0.1]), np.array([15.0, 0.1, 0.1]))
    return truth_of_bodies([make_box("box", -np.ones(3), np.ones(3)), far])


def test_distance_to_a_box_is_that_of_its_formula_on_both_sides(truth, rng):
    points = rng.uniform(-2.0, 2.0, (3000, 3))
    q = np.abs(points) - 1.0
    expected = np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)
    np.testing.assert_allclose(truth.signed_distance(points), expected, atol=1e-12)
    foot = points + 0.0
    outside = expected > 0
    np.testing.assert_allclose(truth.closest_point(points)[outside], np.clip(foot, -1.0, 1.0)[outside], atol=1e-12)


def test_the_side_is_right_a_nanometre_off_the_face(truth, rng):
    points = np.column_stack([rng.uniform(-0.9, 0.9, (100, 2)), np.ones(100)])
    for height in (1e-9, -1e-9, 1e-4, -1e-4):
        np.testing.assert_allclose(truth.signed_distance(points + np.array([0, 0, height])), height, rtol=1e-5)


def test_faces_are_flat_and_edges_of_unknown_curvature(truth):
    found = truth.curvature(np.array([[0.2, 0.3, 1.1], [1.5, 1.5, 0.3]]))
    np.testing.assert_array_equal(found, [[0.0, 0.0], [np.nan, np.nan]])
    np.testing.assert_allclose(truth.normal(np.array([[0.2, 0.3, 1.1]])), [[0, 0, 1]])


def test_a_body_touching_another_adds_no_side_of_its_own():
    truth = truth_of_bodies([make_box("low", -np.ones(3), np.ones(3)), make_box("high", [-1, -1, 1], [1, 1, 3])])
    np.testing.assert_allclose(truth.signed_distance(np.array([[0.5, 0, 2.5], [1.4, 0, 1.0]])), [-0.5, 0.4], atol=1e-9)


def chamfered(name, middle, towards):
    """Return a block of 2 m whose upper edge towards a neighbour at x = 0 is cut off by 0.1 m."""
    profile = np.array([[0.0, 0.0], [0.0, 0.9], [-0.1, 1.0], [-1.0, 1.0], [-1.0, 0.0]])
    corners = [[-towards * x, y, z] for x, z in profile for y in (-1.0, 1.0)]
    hull = trimesh.convex.convex_hull(np.array(corners))
    return Body(name, np.asarray(hull.vertices) + middle, np.asarray(hull.faces, dtype=np.int32))


def test_beneath_the_groove_of_a_joint_the_surface_is_the_groove_and_not_the_hidden_joint():
    truth = truth_of_bodies([chamfered("left", np.zeros(3), -1.0), chamfered("right", np.zeros(3), 1.0)])
    within = np.array([[0.01, 0.2, 0.85], [-0.02, 0.1, 0.7], [0.03, -0.4, 0.8]])
    foot = within * [0.0, 1.0, 0.0] + [0.0, 0.0, 0.9]
    np.testing.assert_allclose(truth.closest_point(within), foot, atol=1e-9)
    np.testing.assert_allclose(truth.signed_distance(within), -np.linalg.norm(within - foot, axis=1), atol=1e-9)


def test_a_ball_far_from_the_meshs_middle_keeps_its_distances(rng):
    centre = np.array([19.0, 3.0, -3.0])
    other = make_box("other", [-20, -1, -1], [-19, 1, 1])
    truth = truth_of_bodies([make_ball("ball", centre, 0.0725, n_rings=60), other])
    off = rng.normal(size=(500, 3))
    off /= np.linalg.norm(off, axis=1, keepdims=True)
    # The facets lie inside of the sphere by up to (pi / 60)^2 / 4 of its radius, 50 micrometres.
    found = truth.signed_distance(centre + 0.08 * off) - 0.0075
    assert np.all((found > -1e-9) & (found < 51e-6))


def test_triangles_are_met_on_face_edge_and_corner():
    triangle = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    points = np.array([[0.2, 0.2, 0.5], [0.5, -1.0, 0.1], [-1.0, -1.0, 0.0], [1.0, 1.0, 2.0]])
    feet, inside = closest_on_faces(points, np.repeat(triangle, 4, axis=0))
    np.testing.assert_allclose(feet, [[0.2, 0.2, 0], [0.5, 0, 0], [0, 0, 0], [0.5, 0.5, 0]], atol=1e-15)
    np.testing.assert_array_equal(inside, [True, False, False, False])
