"""The index of points against a brute search, and the canonical order."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from monitor.filtering.nearest import (
    build_index,
    canonical_order,
    end_of_run,
    find_nearest,
    find_nearest_of_every,
    find_nearest_sorted,
    gather_ball,
)


def ordered(points):
    return points[canonical_order(points)]


def clouds(rng):
    """Surfaces, a density that changes a thousandfold, a lattice of ties, and points that coincide."""
    wall = np.c_[rng.uniform(0, 1, (3000, 2)), 0.001 * rng.normal(size=3000)]
    ranges = np.exp(rng.uniform(0, 4, 3000))
    lattice = np.stack(np.meshgrid(*[np.arange(12.0)] * 3), axis=-1).reshape(-1, 3)
    doubled = np.repeat(wall[:500], 4, axis=0)
    return {
        "wall": wall,
        "floor seen at a shallow angle": np.c_[ranges, ranges * rng.uniform(-1, 1, 3000), np.zeros(3000)],
        "lattice": lattice,
        "coinciding": doubled,
        "far from the origin": wall + np.array([4.5e6, 5.2e6, 100.0]),
        "few": wall[:9],
    }


@pytest.mark.parametrize("k", [1, 6, 48])
def test_distances_to_the_nearest_points_are_those_of_a_tree_search(rng, k):
    for name, points in clouds(rng).items():
        points = ordered(points)
        k_here = min(k, len(points))
        near = find_nearest(build_index(points), 0, len(points), np.full(len(points), k_here))
        ours = np.sort(np.linalg.norm(points[near] - points[:, None], axis=2), axis=1)
        theirs = cKDTree(points).query(points, k_here)[0].reshape(len(points), k_here)
        assert np.allclose(ours, theirs, rtol=1e-9, atol=1e-12), name
        assert all(len(set(row)) == k_here for row in near), name


def test_every_point_may_ask_for_its_own_number_of_neighbours(rng):
    points = ordered(clouds(rng)["wall"])
    k = rng.integers(1, 40, len(points))
    near = find_nearest(build_index(points), 0, len(points), k)
    assert ((near >= 0).sum(axis=1) == k).all()


def test_neighbours_of_chosen_points_come_nearest_first(rng):
    points = ordered(clouds(rng)["wall"])
    which = np.array([5, 2999, 17])
    near = find_nearest_sorted(build_index(points), which, 30)
    assert np.array_equal(near, cKDTree(points).query(points[which], 30)[1])


def test_a_block_of_queries_gives_what_the_whole_gives(rng):
    points = ordered(clouds(rng)["wall"])
    index, k = build_index(points), np.full(3000, 20)
    whole = find_nearest(index, 0, 3000, k)
    assert (find_nearest(index, 800, 1601, k[800:1601]) == whole[800:1601]).all()


@pytest.mark.parametrize("stride", [2, 7, 64])
def test_neighbours_among_every_few_points_are_the_nearest_of_those_and_the_point_itself(rng, stride):
    points = ordered(clouds(rng)["wall"])
    index, some, k = build_index(points), build_index(points[::stride]), np.full(1600, 20)
    k[::3] = 12
    near = find_nearest_of_every(index, stride, some, 800, 2400, k)
    which = np.arange(0, 1600, 37)
    chosen = find_nearest_sorted(index, 800 + which, 20, stride, some)
    tree = cKDTree(points[::stride])
    for row, listed in zip(which, chosen, strict=True):
        i = 800 + row
        among = stride * tree.query(points[i], 20)[1]
        expected = among if i % stride == 0 else np.r_[i, among[:-1]]
        assert np.array_equal(listed, expected)
        assert sorted(near[row, : k[row]]) == sorted(expected[: k[row]])
        assert (near[row, k[row] :] == -1).all()


def test_points_of_a_leaf_are_sought_together_as_far_as_they_lie_together(rng):
    """The curve jumps: were both sides of a jump sought in one ball, it would hold all that lies between them."""
    here, there = rng.uniform(0, 0.01, (20, 3)), rng.uniform(0, 0.01, (20, 3)) + 5.0
    points, same = np.concatenate([here, there]), np.zeros((8, 3))
    assert end_of_run(points, 16, 24, 9, 1, points) == 20
    assert end_of_run(points, 20, 24, 9, 1, points) == 24
    assert end_of_run(same, 0, 8, 4, 1, same) == 8


def test_of_points_at_one_distance_the_first_are_taken():
    points = np.array([[0.0, 0.0, 0.0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    near = find_nearest(build_index(points), 0, 5, np.full(5, 3))
    assert sorted(near[0]) == [0, 1, 2]


def test_a_ball_holds_all_points_within_its_radius(rng):
    points = ordered(clouds(rng)["wall"])
    index = build_index(points)
    found = np.empty(3000, dtype=np.int32)
    n = gather_ball(points, index.low, index.high, points[77], 0.05**2, np.empty(128, dtype=np.int64), found)
    inside = np.flatnonzero(((points - points[77]) ** 2).sum(axis=1) <= 0.05**2)
    assert np.array_equal(found[:n], inside)


def test_canonical_order_does_not_depend_on_the_order_of_the_file(rng):
    for points in clouds(rng).values():
        shuffled = points[rng.permutation(len(points))]
        assert np.array_equal(ordered(points), ordered(shuffled))


def test_boxes_are_as_narrow_far_from_the_origin_as_at_it(rng):
    """In single precision they would be half a metre wide at 5000 km, and every search would visit every leaf."""
    wall = clouds(rng)["wall"]
    widths = []
    for shift in (0.0, 5e6):
        index = build_index(ordered(wall + shift))
        leaves = slice(index.n_leaves, index.n_leaves + len(wall) // 8)
        widths.append(float((index.high[leaves] - index.low[leaves]).max(axis=1).mean()))
    assert np.isclose(widths[0], widths[1], rtol=0.02)
    assert build_index(wall[:0]).n_leaves == 1
