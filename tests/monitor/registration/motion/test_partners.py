"""Nearest points that are kept from one pose to the next: the same as a search anew gives, with far fewer searches."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from monitor.registration.motion.partners import Partners
from monitor.registration.motion.search_tree import SearchTree


class CountingTree:
    """A search tree that counts the points it was asked for."""

    def __init__(self, points: np.ndarray) -> None:
        self._tree, self.n, self.data, self.asked = cKDTree(points), len(points), points, 0

    def query(self, places: np.ndarray, **options: object) -> object:
        self.asked += len(places)
        return self._tree.query(places, **options)


@pytest.mark.parametrize("step", [1e-4, 0.003, 0.03, 0.3])
def test_kept_partners_are_those_of_a_new_search(rng: np.random.Generator, step: float) -> None:
    target, samples = rng.uniform(size=(5_000, 3)), rng.uniform(-0.1, 1.1, size=(400, 3))
    tree, limit = CountingTree(target), 0.08  # a spacing is 0.06; many samples have no partner
    partners = Partners(tree, len(samples))  # type: ignore[arg-type]
    for _ in range(12):
        distance, nearest = partners.find(samples, limit)
        truth, which = cKDTree(target).query(samples, distance_upper_bound=limit)
        found = np.isfinite(truth)
        assert np.array_equal(np.isfinite(distance), found)
        assert distance[found] == pytest.approx(truth[found], rel=1e-12)
        assert np.array_equal(nearest[found], which[found])
        samples = samples + rng.normal(0, step, samples.shape)
    assert found.mean() < 0.95
    if step < 1e-3:
        assert tree.asked < 1.2 * len(samples)  # searched once, and again only where partners swap


def test_a_target_of_few_points_is_searched_as_a_whole(rng: np.random.Generator) -> None:
    target = rng.uniform(size=(3, 3))
    partners = Partners(SearchTree(target), 10)
    for _ in range(3):
        samples = rng.uniform(size=(10, 3))
        distance, nearest = partners.find(samples, 5.0)
        truth, which = cKDTree(target).query(samples)
        assert np.array_equal(nearest, which)
        assert distance == pytest.approx(truth)


@pytest.mark.parametrize("shape", ["ball", "plane", "line", "one place", "far off and crowded"])
def test_the_tree_finds_what_comparing_all_points_finds(rng: np.random.Generator, shape: str) -> None:
    points = rng.normal(size=(700, 3)) * {"plane": [1, 0, 2], "line": [0, 3, 0], "one place": [0, 0, 0]}.get(shape, 1)
    if shape == "far off and crowded":
        points = 1e6 + points * np.where(np.arange(700)[:, None] % 2, 1e-3, 10.0)
    places = points[:80] + rng.normal(0, 0.1, (80, 3))
    tree, every = SearchTree(points), np.linalg.norm(places[:, None] - points, axis=2)
    distance, near = tree.query(places, k=3)
    assert distance == pytest.approx(np.sort(every, axis=1)[:, :3], rel=1e-12)
    assert np.take_along_axis(every, near, axis=1) == pytest.approx(distance, rel=1e-12)  # numbered as given
    bound = float(np.median(distance[:, 0]))
    distance, near = tree.query(places, distance_upper_bound=bound)
    assert np.array_equal(near == tree.n, every.min(axis=1) >= bound)
    assert np.array_equal(np.isinf(distance), near == tree.n)
    assert np.array_equal([tree.mins, tree.maxes], [points.min(axis=0), points.max(axis=0)])
