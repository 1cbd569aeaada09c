"""Kernels of the comparison against slow twins: quantiles, parts, ways along a surface, units around units."""

from types import SimpleNamespace

import numba
import numpy as np
import pytest
import trimesh
from same_bits import assert_same_bits
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial.distance import cdist

from monitor import blocks
from monitor.comparison import compare
from monitor.comparison.detection.reaches import gather_reaches, least_of_patches, members_of, sum_over
from monitor.comparison.distances.connected import connect_like
from monitor.comparison.distances.quantile import median, quantile
from monitor.comparison.distances.spreading import spread_along
from monitor.comparison.distances.stars import gather_neighbours, make_mesh
from monitor.comparison.noise import model as noise
from projects.model import Floats, Registration, Surface


@pytest.mark.parametrize("n", [1, 2, 7, 1000, 1001])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 0.95, 1.0])
def test_quantiles_are_those_of_numpy_to_the_last_bit(rng: np.random.Generator, n: int, share: float) -> None:
    values = rng.normal(size=n) * 10.0 ** rng.integers(-300, 300, n)
    values[rng.random(n) < 0.2] = values[0]
    assert quantile(values, share) == np.quantile(values, share)
    assert median(values) == np.median(values)


def test_between_two_numbers_quantiles_are_rounded_as_numpy_rounds_them(rng: np.random.Generator) -> None:
    values = rng.normal(size=100)
    for share in rng.uniform(size=500):
        assert quantile(values, share) == np.quantile(values, share)


@pytest.fixture
def ball(rng: np.random.Generator) -> tuple[trimesh.Trimesh, SimpleNamespace]:
    """Return a rough ball and as much of a side as its ways ask for."""
    mesh = trimesh.creation.icosphere(subdivisions=4)
    vertices = mesh.vertices * rng.uniform(0.9, 1.1, (len(mesh.vertices), 1))
    side = SimpleNamespace(surface=SimpleNamespace(vertices=vertices),
                           neighbours=gather_neighbours(make_mesh(vertices, mesh.faces)))  # fmt: skip
    return mesh, side


def test_parts_of_one_kind_are_those_that_a_graph_has(rng: np.random.Generator, ball: tuple) -> None:  # type: ignore[type-arg]
    mesh, side = ball
    kinds, n = rng.integers(-1, 2, len(mesh.vertices)), len(mesh.vertices)
    links = rng.integers(0, n, (50, 2))
    pairs = np.vstack([mesh.edges_unique, links])
    pairs = pairs[(kinds[pairs[:, 0]] >= 0) & (kinds[pairs[:, 0]] == kinds[pairs[:, 1]])]
    _, part = connected_components(coo_matrix((np.ones(len(pairs)), pairs.T), shape=(n, n)), directed=False)
    _, wanted = np.unique(part[kinds >= 0], return_inverse=True)
    found = connect_like(kinds, [side.neighbours], [links])
    assert np.array_equal(found[kinds >= 0], wanted)
    assert (found[kinds < 0] == -1).all()


def test_ways_along_a_surface_are_those_of_a_graph(rng: np.random.Generator, ball: tuple) -> None:  # type: ignore[type-arg]
    mesh, side = ball
    vertices, seeds = side.surface.vertices, np.array([3, 500, 1200])
    allowed = rng.random(len(vertices)) < 0.9
    allowed[seeds] = True
    edges = mesh.edges_unique[allowed[mesh.edges_unique].all(axis=1)]
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    graph = coo_matrix((length, edges.T), shape=(len(vertices), len(vertices))).tocsr()
    _, _, wanted = dijkstra(graph, directed=False, indices=seeds, limit=0.7, min_only=True, return_predecessors=True)
    found = spread_along(side, seeds, allowed, 0.7)  # type: ignore[arg-type]
    assert np.array_equal(found, np.maximum(wanted, -1))
    assert 0.1 < np.mean(found >= 0) < 0.9


def test_patches_hold_the_units_within_reach_that_look_the_same_way(rng: np.random.Generator) -> None:
    centres, normals = rng.uniform(0.0, 1.0, (300, 3)), rng.normal(size=(300, 3))
    values, radii = rng.normal(size=(300, 2)), [0.0, 0.1, 0.25]
    reaches = gather_reaches(centres, normals, radii)
    unit = normals / np.linalg.norm(normals, axis=1)[:, None]
    means, p_values = rng.normal(size=(300, 3)), rng.uniform(size=(300, 3))
    above, below = np.ones(300), np.ones(300)
    sums = sum_over(reaches, 3, values, slice(100, 300))
    for size, radius in enumerate(radii):
        near = (cdist(centres, centres) <= radius) & (unit @ unit.T >= 0.5) | np.eye(300, dtype=bool)
        assert np.array_equal(members_of(reaches, size, np.arange(300)).toarray() > 0.0, near)
        np.testing.assert_allclose(sums[:, size], (near @ values)[100:], atol=1e-13)
        for least, sign in ((above, 1.0), (below, -1.0)):
            p = np.where(np.sign(means[:, size]) == sign, p_values[:, size], 1.0)
            np.minimum(least, np.where(near, p, 1.0).min(axis=1), out=least)
    found = least_of_patches(reaches, means, p_values)
    assert np.array_equal(found[0], above)
    assert np.array_equal(found[1], below)


def dented_pair(rng: np.random.Generator) -> tuple[Surface, Surface, Registration]:
    """Return an open bowl twice, the second with a dent, and an identity that is known well."""
    surfaces = []
    for depth in (0.0, 0.02):
        mesh = trimesh.creation.icosphere(subdivisions=5)
        d: Floats = mesh.vertices
        dent = depth * np.exp(-((np.linalg.norm(d - [1.0, 0.0, 0.0], axis=1) / 0.15) ** 2))
        vertices = 0.5 * d * (1.0 - dent + rng.normal(0.0, 2e-4, len(d)))[:, None]
        faces = mesh.faces[(vertices[mesh.faces][:, :, 2] > -0.3).all(axis=1)]
        surfaces.append(Surface(vertices, faces.astype(np.int32), sigma=np.full(len(d), 1e-4)))
    return surfaces[0], surfaces[1], Registration(np.eye(4), np.eye(6) * 1e-12, np.zeros(3), True)


@pytest.mark.parametrize("many", [300_000, 1000])
def test_neither_threads_nor_blocks_change_a_bit_of_a_comparison(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, many: int
) -> None:
    monkeypatch.setattr(noise, "MANY", many)
    monkeypatch.setattr(noise, "N_LEARNT", many)
    pair, threads = dented_pair(rng), numba.get_num_threads()
    many = compare(*pair)
    monkeypatch.setattr(blocks, "BLOCK", 1000)
    try:
        numba.set_num_threads(1)
        assert_same_bits(compare(*pair), many)
    finally:
        numba.set_num_threads(threads)
