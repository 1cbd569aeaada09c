"""The surface over many tiles is the surface over one: same places, one mesh, same bits for any number of workers."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.spatial import cKDTree

from monitor.reconstruction.intersections import find_intersections
from monitor.reconstruction.localized import localized_mesh
from monitor.reconstruction.mesh import edge_table

CELL = 0.0015


def noisy_plate(rng, n=90):
    """Return both sides of a wavy plate 3 mm thick, with noise, and a hole of 12 mm through it."""
    g = (np.arange(n) - 0.5 * n) * 0.001
    x, y = (a.ravel() for a in np.meshgrid(g, g))
    points, normals = [], []
    for side in (1.0, -1.0):
        u, v = (a + rng.uniform(-0.3e-3, 0.3e-3, len(a)) for a in (x, y))
        keep = np.hypot(u, v) > 0.006
        z = 0.004 * np.sin(80 * u) * np.cos(60 * v) + side * 0.0015 + 0.0003 * rng.normal(size=len(u))
        slope = np.c_[-0.32 * np.cos(80 * u) * np.cos(60 * v), 0.24 * np.sin(80 * u) * np.sin(60 * v), np.ones(len(u))]
        points.append(np.c_[u, v, z][keep])
        normals.append(side * (slope / np.linalg.norm(slope, axis=1)[:, None])[keep])
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return np.concatenate(points) @ turn.T, np.concatenate(normals) @ turn.T


def test_thin_plate_over_tiles_of_28_cells_agrees_with_one_tile_to_a_micrometre(rng):
    points, normals = noisy_plate(rng)
    one = localized_mesh(points, normals, CELL, 0.001, tile=256)
    many = localized_mesh(points, normals, CELL, 0.001, tile=28)
    assert len(many[0]) == len(one[0])
    apart, match = cKDTree(one[0]).query(many[0])
    assert apart.max() < 1e-6
    assert sorted(match.tolist()) == list(range(len(one[0])))
    once = {tuple(np.roll(f, -np.argmin(f))) for f in one[1].tolist()}
    assert {tuple(np.roll(f, -np.argmin(f))) for f in match[many[1]].tolist()} == once
    assert (edge_table(many[1])[2] <= 2).all()
    assert len(find_intersections(*many)) == 0


@pytest.mark.parametrize("n_workers", [2, 4])
def test_mesh_has_the_same_bits_for_any_number_of_workers(rng, n_workers):
    points, normals = noisy_plate(rng, n=60)

    def shared(function, numbers):
        with ThreadPoolExecutor(n_workers) as pool:
            return list(pool.map(function, numbers))

    def alone(function, numbers):
        return [function(j) for j in numbers]

    one = localized_mesh(points, normals, CELL, 0.001, tile=25, map_tiles=alone)
    other = localized_mesh(points, normals, CELL, 0.001, tile=25, map_tiles=shared)
    assert (one[0] == other[0]).all()
    assert (one[1] == other[1]).all()
