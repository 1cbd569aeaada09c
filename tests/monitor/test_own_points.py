"""What points say of a mesh: nothing beyond their noise where it passes through them, how far it is off elsewhere."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from monitor.reconstruction import reconstruct
from monitor.reconstruction.own_points import misfit_at_vertices
from projects import PointCloud, Surface

NOISE = 3e-4  # m
STEP = 2e-3


def sheet(height: object) -> Surface:
    """Return a sheet of 60 x 60 vertices at a height, a function of x."""
    axis = np.arange(60) * STEP
    x, y = (a.ravel() for a in np.meshgrid(axis, axis, indexing="ij"))
    index = np.arange(3600).reshape(60, 60)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return Surface(np.column_stack([x, y, height(x)]), faces)  # type: ignore[operator]


def points_on_plane(rng: np.random.Generator, n: int = 20_000) -> PointCloud:
    points = np.column_stack([rng.uniform(0.0, 59 * STEP, (n, 2)), rng.normal(0.0, NOISE, n)])
    return PointCloud(points, normals=np.tile([0.0, 0.0, 1.0], (n, 1)))


def misfit(surface: Surface, cloud: PointCloud) -> np.ndarray:
    return misfit_at_vertices(surface, cloud, cKDTree(cloud.points), np.zeros(3), NOISE)


def test_noise_alone_is_a_misfit_at_one_vertex_in_a_thousand(rng: np.random.Generator) -> None:
    found = misfit(sheet(np.zeros_like), points_on_plane(rng))
    assert np.mean(found > 0.0) < 0.004  # neighbours share their points


def test_what_the_mesh_is_off_is_its_misfit(rng: np.random.Generator) -> None:
    off = 1.5e-3
    surface = sheet(lambda x: np.where(x > 0.06, off, 0.0))
    found, x = misfit(surface, points_on_plane(rng)), surface.vertices[:, 0]
    assert np.median(found[x > 0.066]) == pytest.approx(off, rel=0.15)  # the nearest nine lie a little this way
    assert np.mean(found[x < 0.054] > 0.0) < 0.01


def test_one_stray_point_is_no_misfit(rng: np.random.Generator) -> None:
    cloud = points_on_plane(rng)
    cloud.points[np.argmin(np.linalg.norm(cloud.points - [0.05, 0.05, 0.0], axis=1)), 2] += 0.01
    surface = sheet(np.zeros_like)
    near = np.linalg.norm(surface.vertices - [0.05, 0.05, 0.0], axis=1) < 0.004
    assert (misfit(surface, cloud)[near] == 0.0).mean() > 0.9


def test_relief_too_fine_for_the_cells_is_part_of_sigma(rng: np.random.Generator) -> None:
    n, wave, height = 40_000, 4e-3, 1e-3  # four points a wave; cells of one and a half spacings cannot follow it
    points = np.column_stack([rng.uniform(0.0, 0.2, (n, 2)), np.zeros(n)])
    points[:, 2] = height * np.sin(2 * np.pi * points[:, 0] / wave) * (points[:, 0] > 0.1) + rng.normal(0, 1e-4, n)
    surface = reconstruct(PointCloud(points, origins=np.array([0.1, 0.1, 2.0])))
    inner = (np.abs(surface.vertices - [0.1, 0.1, 0.0])[:, :2] < 0.09).all(axis=1)
    true = height * np.sin(2 * np.pi * surface.vertices[:, 0] / wave) * (surface.vertices[:, 0] > 0.1)
    error, x = surface.vertices[:, 2] - true, surface.vertices[:, 0]
    for here in (inner & (x > 0.11), inner & (x < 0.09)):
        assert np.sqrt(np.mean(error[here] ** 2)) < 1.5 * np.sqrt(np.mean(surface.sigma[here] ** 2))
    assert np.median(surface.sigma[inner & (x < 0.09)]) < 1e-4
