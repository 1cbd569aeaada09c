"""Faces that cut each other: found without miss or false alarm, decided exactly, in any order of faces."""

from fractions import Fraction

import numpy as np
import pytest

from monitor.reconstruction.beside import mark_beside
from monitor.reconstruction.fans import find_fans
from monitor.reconstruction.intersections import find_intersections
from monitor.reconstruction.predicates import exact_room, side_of_line, side_of_plane

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])


def sign(value):
    return int(value > 0) - int(value < 0)


def determinant(a, b, c, d):
    """Sign of (a - d) . ((b - d) x (c - d)) in fractions."""
    p = [[Fraction(float(x)) - Fraction(float(y)) for x, y in zip(q, d, strict=True)] for q in (a, b, c)]
    cross = [p[1][(k + 1) % 3] * p[2][(k + 2) % 3] - p[1][(k + 2) % 3] * p[2][(k + 1) % 3] for k in range(3)]
    return sign(sum(x * y for x, y in zip(p[0], cross, strict=True)))


def meet_by_fractions(one, other, shared):
    """Whether two triangles in general position meet: an edge of one passes through the other (slow twin)."""
    for first, second in ((one, other), (other, one)):
        for k in range(3):
            p, q = first[k], first[(k + 1) % 3]
            if any((p == s).all() or (q == s).all() for s in shared):
                continue
            if determinant(*second, p) * determinant(*second, q) > 0:
                continue
            sides = [determinant(p, q, second[m], second[(m + 1) % 3]) for m in range(3)]
            if all(s >= 0 for s in sides) or all(s <= 0 for s in sides):
                return True
    return False


def test_side_of_a_plane_is_exact_where_floating_point_is_not(rng):
    room = exact_room()
    n_wrong = 0
    for _ in range(500):
        a, b, c = rng.normal(size=(3, 3)) * 10.0 ** rng.integers(-6, 7)
        w = rng.dirichlet(np.ones(3))
        d = w @ [a, b, c]  # in the plane but for rounding
        assert side_of_plane(tuple(a), tuple(b), tuple(c), tuple(d), room) == determinant(a, b, c, d)
        n_wrong += sign(np.linalg.det([a - d, b - d, c - d])) != determinant(a, b, c, d)
    assert n_wrong > 20


def test_side_of_a_line_is_exact_where_floating_point_is_not(rng):
    room = exact_room()
    for _ in range(500):
        a, b = rng.normal(size=(2, 2)) * 10.0 ** rng.integers(-6, 7)
        c = a + rng.uniform() * (b - a)
        p, q, r = ([Fraction(float(x)) for x in point] for point in (a, b, c))
        truth = sign((p[0] - r[0]) * (q[1] - r[1]) - (p[1] - r[1]) * (q[0] - r[0]))
        assert side_of_line(tuple(a), tuple(b), tuple(c), 0, 1, room) == truth


@pytest.mark.parametrize("far", [0.0, 1e6])
def test_same_pairs_as_by_brute_force_in_fractions(rng, far):
    vertices = rng.uniform(size=(40, 3)) + far
    faces = np.array([rng.choice(40, 3, replace=False) for _ in range(40)])
    wanted = []
    for f in range(len(faces)):
        for g in range(f + 1, len(faces)):
            both = set(faces[f]) & set(faces[g])
            if len(both) == 3 or (len(both) < 2 and meet_by_fractions(
                vertices[faces[f]], vertices[faces[g]], [vertices[v] for v in both]
            )):  # fmt: skip
                wanted.append([f, g])
    assert len(wanted) > 20
    assert find_intersections(vertices, faces).tolist() == wanted


def shifted(by, order=(0, 1, 2)):
    """Return a triangle and a copy of it that is moved, with no corner in common."""
    return np.r_[CORNERS, CORNERS[list(order)] + by], np.array([[0, 1, 2], [3, 4, 5]])


@pytest.mark.parametrize(
    ("by", "meets"),
    [
        ([0.2, 0.2, 0.0], True),  # overlap in one plane
        ([0.2, 0.2, 1e-300], False),  # the same, one above the other by the least that can be told
        ([1.0, 0.0, 0.0], True),  # corners touch
        ([1.0 + 1e-15, 0.0, 0.0], False),
        ([0.0, 0.0, 0.0], True),  # the same triangle with corners of its own
    ],
)
def test_triangles_of_one_plane_meet_when_they_share_a_point(by, meets):
    assert bool(len(find_intersections(*shifted(by)))) == meets


def test_faces_around_an_edge_meet_only_when_one_is_folded_onto_the_other():
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    for apex, meets in (([0.3, -0.5, 0.0], 0), ([0.3, 0.5, 0.0], 1), ([0.3, 0.5, 1e-18], 0), ([0.0, 1.0, 1e-9], 0)):
        assert len(find_intersections(np.r_[CORNERS, [apex]], faces)) == meets


def test_faces_around_a_vertex_meet_when_the_edge_across_passes_through():
    faces = np.array([[0, 1, 2], [0, 3, 4]])
    through = np.r_[CORNERS, [[0.3, 0.3, 0.2], [0.3, 0.3, -0.2]]]
    beside = np.r_[CORNERS, [[-0.3, 0.3, 0.2], [-0.3, 0.3, -0.2]]]
    along = np.r_[CORNERS, [[0.5, 0.0, 0.0], [0.5, -1.0, 0.0]]]  # lies along an edge of the first
    assert [len(find_intersections(v, faces)) for v in (through, beside, along)] == [1, 0, 1]


def wavy_sheet(n, height, rng):
    x, y = (a.ravel() for a in np.meshgrid(np.arange(n) / n, np.arange(n) / n))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    i = np.arange(n * n).reshape(n, n)
    low, right, up, far = (a.ravel() for a in (i[:-1, :-1], i[:-1, 1:], i[1:, :-1], i[1:, 1:]))
    vertices = np.c_[x, y, height * np.sin(9 * x) * np.cos(7 * y)] @ turn
    return vertices, np.r_[np.c_[low, right, far], np.c_[low, far, up]]


@pytest.mark.parametrize("height", [0.0, 0.1])
def test_a_sheet_has_none_until_a_vertex_is_pulled_through_it(rng, height):
    vertices, faces = wavy_sheet(40, height, rng)
    assert len(find_intersections(vertices, faces)) == 0
    v = 20 * 40 + 20
    pulled = vertices.copy()
    pulled[v] = 2.0 * vertices[v + 1] - vertices[v]  # mirrored beyond its neighbour
    pairs = find_intersections(pulled, faces)
    assert len(pairs)
    assert (faces[np.unique(pairs)] == v).any(axis=1).any()
    suspects = rng.uniform(size=len(faces)) < 0.5
    held = suspects[pairs].any(axis=1)
    assert 0 < np.count_nonzero(held) < len(pairs)
    assert find_intersections(pulled, faces, suspects).tolist() == pairs[held].tolist()
    order = rng.permutation(len(faces))
    again = np.sort(order[find_intersections(pulled, faces[order])], axis=1)
    assert sorted(again.tolist()) == pairs.tolist()


def fan(n, turns, heights=0.0):
    """Return n faces around vertex 0, that go round so many times."""
    angle = 2.0 * np.pi * turns * np.arange(n) / n
    rim = np.arange(n)
    vertices = np.r_[[[0.0, 0, 0]], np.c_[np.cos(angle), np.sin(angle), np.broadcast_to(heights, n)]]
    return vertices, np.c_[np.zeros(n, int), 1 + rim, 1 + np.roll(rim, -1)]


def test_faces_around_a_vertex_are_known_not_to_meet_where_they_go_round_once(rng):
    for n in (3, 6, 16):
        assert find_fans(*fan(n, 1, 0.3 * rng.normal(size=n))).tolist() == [True] + n * [False]
    assert not find_fans(*fan(17, 1))[0]  # too many to look at
    vertices, faces = fan(6, 1)
    assert not find_fans(vertices, faces[:5])[0]  # a free edge
    assert not find_fans(vertices, np.r_[faces[:5], faces[5:, ::-1]])[0]  # one turned over
    assert not find_fans(vertices, np.r_[faces, faces[:1]])[0]  # one twice
    vertices[2] = [0.8, -1.5, 0.0]  # one folded over the others
    assert not find_fans(vertices, faces)[0]


def test_faces_that_go_round_a_vertex_twice_meet_though_all_are_turned_one_way(rng):
    vertices, faces = fan(7, 2, 0.01 * rng.normal(size=7))
    assert not find_fans(vertices, faces)[0]
    assert len(find_intersections(vertices, faces)) > 0  # a rim that winds twice crosses itself


def test_faces_beside_a_few_are_all_whose_boxes_meet_theirs_and_few_others(rng):
    vertices, faces = wavy_sheet(40, 0.1, rng)
    faces = np.r_[faces, [[0, 39, 1599]]]  # one across all others
    asked = np.zeros(len(faces), bool)
    asked[[5, 700]] = True
    low, high = vertices[faces].min(axis=1), vertices[faces].max(axis=1)
    meet = ((low[:, None] <= high[asked]) & (high[:, None] >= low[asked])).all(axis=2).any(axis=1)
    found = mark_beside(vertices, faces, asked)
    assert found[meet].all()
    assert np.count_nonzero(meet) <= np.count_nonzero(found) < 100
