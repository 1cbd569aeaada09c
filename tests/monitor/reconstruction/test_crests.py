"""Faces split along edges: nothing lost, nothing turned over, one fan around each vertex."""

from __future__ import annotations

import numpy as np
import pytest

from monitor.reconstruction.crests import Splits, propose, snap, split_along, split_faces, spoiled, two_of_each
from monitor.reconstruction.mesh import edge_table, face_areas_and_normals
from monitor.reconstruction.projection import Projection
from monitor.reconstruction.roofs import Roofs, no_roofs
from projects.model import Floats, Ints

CELL = 1.0


def on_points(vertices: Floats, normals: Floats) -> Projection:
    """Return vertices that are known to a hundredth of a cell."""
    n = len(vertices)
    return Projection(np.asarray(vertices, float), np.asarray(normals, float), np.full(n, 0.01), np.full(n, 0.1),
                      np.full(n, 9), np.ones(n, bool), np.full(n, 0.1))  # fmt: skip


def flat(vertices: Floats) -> Projection:
    """Return vertices that all look up."""
    return on_points(vertices, np.tile([0.0, 0.0, 1.0], (len(vertices), 1)))


@pytest.mark.parametrize(
    ("which", "n_faces"), [([0], 2), ([1], 2), ([0, 1], 3), ([1, 2], 3), ([0, 2], 3), ([0, 1, 2], 4)]
)
def test_a_split_face_keeps_its_area_and_its_way(which: list[int], n_faces: int) -> None:
    vertices, faces = np.array([[0.0, 0, 0], [1, 0, 0], [0.2, 1, 0]]), np.array([[0, 1, 2]])
    edges, edge_of, _ = edge_table(faces)
    place = vertices[edges[which]].mean(axis=1)
    splits = Splits(np.array(which), place, np.tile([0.0, 0.0, 1.0], (len(which), 1)), np.full(len(which), 0.01))
    made = split_faces(flat(vertices), faces, np.zeros(3, bool), edges, edge_of, splits)
    areas, normals = face_areas_and_normals(made.projection.vertices, made.faces)
    assert len(made.faces) == n_faces
    assert areas.sum() == pytest.approx(0.5, rel=1e-12)
    assert areas.min() > 0.05
    np.testing.assert_allclose(normals[:, 2], 1.0, atol=1e-12)
    np.testing.assert_array_equal(made.is_crest, np.arange(3 + len(which)) > 2)
    assert edge_table(made.faces)[2].max() <= 2
    if which == [0, 2]:  # of a, b and the apex over a: the diagonal from a is the shorter one
        assert [0, 4] in edge_table(made.faces)[0].tolist()


def test_a_new_vertex_knows_no_more_than_the_ends_of_its_edge() -> None:
    vertices, faces = np.array([[0.0, 0, 0], [1, 0, 0], [0.2, 1, 0]]), np.array([[0, 1, 2]])
    edges, edge_of, _ = edge_table(faces)
    split = Splits(np.array([1]), vertices[edges[[1]]].mean(axis=1), np.array([[0.0, 0.0, 1.0]]), np.array([0.01]))
    known = flat(vertices)._replace(scatter=np.array([0.1, 0.2, 0.4]), n_support=np.array([9, 7, 4]))
    made = split_faces(known, faces, np.zeros(3, bool), edges, edge_of, split).projection
    ends = edges[1]
    assert made.scatter[3] == pytest.approx(known.scatter[ends].mean())
    assert made.n_support[3] == known.n_support[ends].min()
    assert made.is_fitted[3]


def roof_of_four() -> tuple[Projection, Ints, Roofs]:
    """Return two faces over a ridge of 90 degrees along y, cut off between x = -0.5 and 0.5, whose corners know it."""
    vertices = np.array([[-0.5, 0.0, -0.5], [0.5, 0.0, -0.5], [0.5, 1.0, -0.5], [-0.5, 1.0, -0.5]])
    left, right = np.array([[-1.0, 0.0, 1.0], [1.0, 0.0, 1.0]]) / np.sqrt(2.0)
    own, other = np.array([left, right, right, left]), np.array([right, left, left, right])
    crest = vertices * [0.0, 1.0, 0.0]
    roofs = Roofs(np.arange(4), own, other, crest, np.zeros(4, bool), np.zeros(4))
    return on_points(vertices, own), np.array([[0, 1, 2], [0, 2, 3]]), roofs


def test_edges_over_a_ridge_get_a_vertex_on_it() -> None:
    projection, faces, roofs = roof_of_four()
    made = split_along(projection, faces, roofs, CELL)
    assert made.is_crest.sum() == 3  # two rungs and the diagonal
    crest = made.projection.vertices[made.is_crest]
    np.testing.assert_allclose(crest[:, [0, 2]], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.sort(crest[:, 1]), [0.0, 0.5, 1.0], atol=1e-12)
    np.testing.assert_allclose(made.projection.normals[made.is_crest], [[0.0, 0.0, 1.0]] * 3, atol=1e-12)
    areas, normals = face_areas_and_normals(made.projection.vertices, made.faces)
    assert areas.sum() == pytest.approx(np.sqrt(2.0), rel=1e-12)  # of both sides, where the cut had 1
    np.testing.assert_allclose(np.abs(normals[:, 0]), np.sqrt(0.5), atol=1e-12)
    # 0.01 of each plane: along the bisector of 90 degrees hypot(0.01, 0.01) / (2 cos 45)
    np.testing.assert_allclose(made.projection.sigma[made.is_crest], 0.01, rtol=1e-12)
    unseen = split_along(projection, faces, roofs._replace(hidden=np.full(4, 0.03)), CELL)
    np.testing.assert_allclose(unseen.projection.sigma[unseen.is_crest], np.hypot(0.01, 0.03), rtol=1e-12)


def n_proposed(projection: Projection, faces: Ints, roofs: Roofs) -> int:
    """Return how many edges of the mesh are to be split, of three that pass over the ridge."""
    return len(propose(projection, edge_table(faces)[0], roofs, np.zeros(4, bool), CELL).edge)


@pytest.mark.parametrize(("half", "rise", "n"), [(0.5, 0.0, 3), (0.15, 0.1, 3), (0.15, 0.55, 1), (0.6, -0.75, 0)])
def test_a_ridge_far_over_an_edge_or_that_its_ends_do_not_reach_is_none_of_its_own(
    half: float, rise: float, n: int
) -> None:
    """Farther than the edge is long (the diagonal is longer); and both ends 0.53 of a cell off the other plane."""
    projection, faces, roofs = roof_of_four()
    narrow = projection._replace(vertices=projection.vertices * [2.0 * half, 1.0, 2.0 * half])
    assert n_proposed(narrow, faces, roofs._replace(crest=roofs.crest + np.array([0.0, 0.0, rise]))) == n


@pytest.mark.parametrize(("aside", "n"), [(0.3, 3), (0.45, 1)])
def test_no_vertex_is_put_next_to_the_end_of_an_edge(aside: float, n: int) -> None:
    """The ridge passes at a fifth or a twentieth of the edges along x, half-way over the diagonal."""
    projection, faces, roofs = roof_of_four()
    moved = roofs._replace(crest=roofs.crest + np.array([aside, 0.0, -aside]))
    assert n_proposed(projection, faces, moved) == n


@pytest.mark.parametrize(("degrees", "n"), [(45.0, 3), (20.0, 3), (12.0, 0)])
def test_an_edge_is_split_where_its_ends_look_as_both_sides_do(degrees: float, n: int) -> None:
    """Ends that look 12 degrees to either side are 33 from the sides, which look 45."""
    projection, faces, roofs = roof_of_four()
    turn = np.radians(degrees)
    looks = np.column_stack([np.sign(projection.vertices[:, 0]) * np.sin(turn), np.zeros(4), np.full(4, np.cos(turn))])
    assert n_proposed(projection._replace(normals=looks), faces, roofs) == n


def test_how_far_an_edge_may_be_round_unseen_is_told_by_the_end_that_knows_it() -> None:
    """Of the ends of each edge only the one on the right knows the ridge."""
    projection, faces, roofs = roof_of_four()
    right = Roofs(np.array([1, 2]), roofs.own[1:3], roofs.other[1:3], roofs.crest[1:3], np.zeros(2, bool),
                  np.array([0.03, 0.05]))  # fmt: skip
    made = propose(projection, edge_table(faces)[0], right, np.zeros(4, bool), CELL)
    by_y = dict(zip(made.place[:, 1].round(6).tolist(), made.sigma.tolist(), strict=True))
    assert by_y[0.0] == pytest.approx(np.hypot(0.01, 0.03))
    assert by_y[1.0] == pytest.approx(np.hypot(0.01, 0.05))


@pytest.mark.parametrize(("degrees", "n"), [(8.0, 0), (-8.0, 1)])
def test_an_end_that_looks_more_like_the_side_of_the_other_is_of_that_side(degrees: float, n: int) -> None:
    """Sides look 20 degrees to the left and to the right: an end beyond the ridge still looks 8 to the left."""
    half = np.radians(20.0)
    vertices = np.array([[-0.5, 0.0, -0.5 * np.tan(half)], [0.5, 0.0, -0.5 * np.tan(half)], [0.0, 1.0, 0.0]])
    left, right = np.array([[-np.sin(half), 0.0, np.cos(half)], [np.sin(half), 0.0, np.cos(half)]])
    look = -np.radians(degrees)
    projection = on_points(vertices, np.array([left, [np.sin(look), 0.0, np.cos(look)], [0.0, 0.0, 1.0]]))
    roof = Roofs(np.array([0]), left[None], right[None], np.zeros((1, 3)), np.zeros(1, bool), np.zeros(1))
    assert len(propose(projection, np.array([[0, 1]]), roof, np.zeros(3, bool), CELL).edge) == n


def test_an_edge_that_ends_on_the_ridge_is_split_no_more() -> None:
    projection, faces, roofs = roof_of_four()
    on = np.array([True, False, False, False])
    left = propose(projection, edge_table(faces)[0], roofs, on, CELL)
    assert edge_table(faces)[0][left.edge].tolist() == [[2, 3]]


def test_a_new_face_that_looks_as_one_of_its_corners_is_whole() -> None:
    """One corner looks 80 degrees aside, as a vertex held back over the other side may."""
    vertices, faces = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1, 0]]), np.array([[0, 1, 2]])
    edges, edge_of, _ = edge_table(faces)
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, np.sin(1.4), np.cos(1.4)]])
    split = Splits(np.array([0]), np.array([[0.5, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]]), np.array([0.01]))
    made = split_faces(on_points(vertices, normals), faces, np.zeros(3, bool), edges, edge_of, split)
    assert not spoiled(made, 3, 0.02).any()


def test_a_round_edge_is_not_split() -> None:
    projection, faces, roofs = roof_of_four()
    made = split_along(projection, faces, roofs._replace(is_round=np.ones(4, bool)), CELL)
    assert not made.is_crest.any()
    np.testing.assert_array_equal(made.faces, faces)


def test_nothing_is_split_where_both_ends_disagree() -> None:
    projection, faces, roofs = roof_of_four()
    crest = roofs.crest + np.where(np.arange(4)[:, None] % 3 == 0, 0.4, -0.4) * np.array([0.0, 0.0, 1.0])
    assert (
        len(propose(projection, edge_table(faces)[0], roofs._replace(crest=crest), np.zeros(4, bool), CELL).edge) == 0
    )


def test_a_vertex_near_an_edge_moves_onto_it_and_looks_between_its_sides() -> None:
    projection, faces, roofs = roof_of_four()
    near = projection._replace(vertices=projection.vertices * [0.4, 1.0, 0.4])
    snapped = snap(near, faces[:0], roofs, CELL)
    np.testing.assert_allclose(snapped.vertices, roofs.crest, atol=1e-15)
    np.testing.assert_allclose(snapped.sigma, 0.01, rtol=1e-12)  # as of a split: both planes alike
    made = split_along(snapped, faces, roofs, CELL)
    assert made.is_crest.all()
    np.testing.assert_allclose(made.projection.normals, [[0.0, 0.0, 1.0]] * 4, atol=1e-12)
    unseen = snap(near, faces[:0], roofs._replace(hidden=np.full(4, 0.03)), CELL)
    np.testing.assert_allclose(unseen.sigma, np.hypot(0.01, 0.03), rtol=1e-12)
    left = snap(near, faces[:0], roofs._replace(is_round=np.ones(4, bool)), CELL)
    np.testing.assert_array_equal(left.vertices, near.vertices)
    np.testing.assert_array_equal(
        snap(projection, faces[:0], roofs, CELL).vertices, projection.vertices
    )  # 0.7 of a cell off


def test_a_vertex_held_back_on_its_way_to_the_edge_looks_as_it_did() -> None:
    """Where a smooth fit is better known than the roof, its normal is too."""
    projection, faces, roofs = roof_of_four()
    tilted = projection.normals + np.array([0.0, 0.1, 0.0])
    tilted /= np.linalg.norm(tilted, axis=1)[:, None]
    held = projection._replace(vertices=projection.vertices * [0.2, 1.0, 0.2], normals=tilted)
    made = split_along(held, faces, roofs._replace(is_round=np.ones(4, bool)), CELL)
    assert not made.is_crest.any()
    np.testing.assert_array_equal(made.projection.normals, tilted)


def test_a_split_that_would_turn_a_face_over_is_told() -> None:
    vertices, faces = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1, 0]]), np.array([[0, 1, 2]])
    edges, edge_of, _ = edge_table(faces)
    beyond = Splits(np.array([0]), np.array([[0.5, 1.5, 0.0]]), np.array([[0.0, 0.0, 1.0]]), np.array([0.01]))
    made = split_faces(flat(vertices), faces, np.zeros(3, bool), edges, edge_of, beyond)
    assert spoiled(made, 3, 0.02).tolist() == [True]
    level = beyond._replace(place=np.array([[0.5, 0.1, 0.0]]))
    assert spoiled(split_faces(flat(vertices), faces, np.zeros(3, bool), edges, edge_of, level), 3, 0.02).tolist() == [
        False
    ]


def test_a_split_that_leaves_a_sliver_or_meets_another_face_is_told() -> None:
    beside = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.4, 0.2, 0.15], [0.6, 0.2, 0.15], [0.5, 0.8, 0.15]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    edges, edge_of, _ = edge_table(faces)
    first = int(np.flatnonzero((edges == [0, 1]).all(axis=1))[0])
    for place, is_bad in (([0.5, 0.1, 0.0], False), ([0.5, 0.1, 0.3], True), ([0.5, 0.995, 0.0], True)):
        split = Splits(np.array([first]), np.array([place]), np.array([[0.0, 0.0, 1.0]]), np.array([0.01]))
        made = split_faces(flat(beside), faces, np.zeros(6, bool), edges, edge_of, split)
        assert spoiled(made, 6, 0.02).tolist() == [is_bad]


def test_without_roofs_nothing_changes() -> None:
    projection, faces, _ = roof_of_four()
    made = split_along(projection, faces, no_roofs(), CELL)
    np.testing.assert_array_equal(made.faces, faces)
    assert made.projection is projection


def test_of_no_face_all_three_corners_move_onto_an_edge() -> None:
    """All three on one line would make the face flat, and the mesh hold back around it."""
    faces, off = np.array([[0, 1, 2], [1, 2, 3]]), np.array([0.3, 0.1, 0.2, 0.05])
    assert two_of_each(faces, off, 0.35).tolist() == [False, True, False, True]
    assert two_of_each(faces, off, 0.15).tolist() == [False, True, False, True]
    assert two_of_each(faces[:1], off, 0.35).tolist() == [False, True, True, True]
