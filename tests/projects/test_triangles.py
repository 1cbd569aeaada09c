"""Normals and areas of triangles and of the vertices that they meet at."""

import numpy as np
import pytest

from projects.model import Surface
from projects.triangles import area_vectors, face_areas, face_normals, unit_normals, vertex_areas, vertex_normals

FAR = np.array([6e5, 5e6, 100.0])
VERTICES = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 1.0], [9.0, 9.0, 9.0]]) + FAR
FACES = np.array([[0, 1, 2], [0, 2, 3], [0, 0, 1]])  # one flat, one upright, one without area


def test_normals_are_twice_the_area_long_and_follow_the_right_hand() -> None:
    corners = VERTICES[FACES]
    np.testing.assert_allclose(area_vectors(corners), [[0, 0, 6], [3, 0, 0], [0, 0, 0]], atol=1e-8)
    np.testing.assert_array_equal(face_normals(Surface(VERTICES, FACES)), area_vectors(corners))
    np.testing.assert_allclose(unit_normals(corners), [[0, 0, 1], [1, 0, 0], [0, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(face_areas(corners), [3.0, 1.5, 0.0], atol=1e-8)


def test_a_vertex_stands_for_a_third_of_its_faces() -> None:
    np.testing.assert_allclose(vertex_areas(VERTICES, FACES), [1.5, 1.0, 1.5, 0.5, 0.0], atol=1e-8)


def test_the_normal_of_a_vertex_is_the_mean_by_area_and_unknown_without_faces() -> None:
    found = vertex_normals(VERTICES, FACES)
    np.testing.assert_allclose(found[0], np.array([3.0, 0.0, 6.0]) / np.hypot(3.0, 6.0), atol=1e-12)
    np.testing.assert_allclose(found[1:4], [[0, 0, 1], [1 / 5**0.5, 0, 2 / 5**0.5], [1, 0, 0]], atol=1e-12)
    assert np.isnan(found[4]).all()


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_single_precision_stays_single(kind: type) -> None:
    assert area_vectors((VERTICES - FAR)[FACES].astype(kind)).dtype == kind
