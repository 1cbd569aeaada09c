import numpy as np
import pytest

from monitor.reconstruction.mesh import (
    bow_ties,
    edge_table,
    face_areas_and_normals,
    is_degenerate,
    normals_by_angle,
    piece_areas,
    short_edges,
    untie,
)


@pytest.fixture
def soup(rng):
    """Faces in any way over few vertices: edges with one face, two and more."""
    faces = rng.integers(0, 60, (300, 3))
    return rng.normal(size=(60, 3)), faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)].astype(np.int32)


def test_edges_are_those_that_sorting_finds(soup):
    _, faces = soup
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    want, edge_of, n_faces = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    found = edge_table(faces)
    assert np.array_equal(found[0], want)
    assert np.array_equal(found[1], edge_of.ravel())
    assert np.array_equal(found[2], n_faces)


def test_no_faces_have_no_edges():
    assert [len(a) for a in edge_table(np.empty((0, 3), int))] == [0, 0, 0]


def test_areas_and_normals_are_those_of_the_cross_product(soup):
    vertices, faces = soup
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    areas, normals = face_areas_and_normals(vertices, faces)
    assert areas == pytest.approx(0.5 * np.linalg.norm(cross, axis=1), rel=1e-12)
    assert normals * 2.0 * areas[:, None] == pytest.approx(cross, abs=1e-12)


def test_normal_of_a_cubes_corner_is_its_diagonal_however_its_faces_are_cut():
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    faces = np.array([[7, 3, 2], [7, 2, 6], [7, 6, 4], [7, 4, 5], [7, 5, 1], [7, 1, 3]])  # two of each side at corner 7
    one_cut = np.array([[7, 3, 2], [7, 2, 6], [7, 6, 5], [6, 4, 5], [7, 5, 1], [7, 1, 3]])  # the side x = 1 cut once
    for cut in (faces, one_cut):
        assert np.abs(normals_by_angle(corners, cut)[7]) == pytest.approx(np.full(3, 3.0**-0.5), abs=1e-12)


def test_short_edges_and_low_faces_are_found():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0.01, 0], [0.5, 1, 0], [0.52, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [1, 4, 3]])
    assert short_edges(vertices, faces, 0.021).tolist() == [[4, 3]]
    assert is_degenerate(vertices, faces, 0.0099).tolist() == [False, False, False]
    assert is_degenerate(vertices, faces, 0.0101).tolist() == [True, False, False]


def test_pieces_hang_together_by_edges_and_not_by_vertices():
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    vertices = np.r_[square, [[2.0, 1, 0], [2, 2, 0]]]
    faces = np.array([[0, 1, 2], [2, 4, 5], [0, 2, 3]])  # the second meets the others in vertex 2 only
    assert piece_areas(vertices, faces).tolist() == [1.0, 0.5, 1.0]
    assert bow_ties(faces).tolist() == [False, True, False]


def test_untied_faces_are_those_left_when_bow_ties_are_dropped_until_there_are_none(rng):
    i, n_again = np.arange(64).reshape(8, 8), 0
    low, right, up, far = (a.ravel() for a in (i[:-1, :-1], i[:-1, 1:], i[1:, :-1], i[1:, 1:]))
    sheet = np.r_[np.c_[low, right, far], np.c_[low, far, up]]
    for _ in range(50):
        faces = sheet[rng.uniform(size=len(sheet)) < 0.7]
        left = faces[~bow_ties(faces)]
        while bow_ties(left).any():
            left, n_again = left[~bow_ties(left)], n_again + 1
        assert untie(faces).tolist() == left.tolist()
    assert n_again > 5  # dropping makes new ones
