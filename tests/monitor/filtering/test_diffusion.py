"""Anisotropic diffusion: noise gone, steps and bumps kept, spheres not shrunk, its end found by itself."""

import dataclasses

import numba
import numpy as np
import pytest

from monitor.filtering import DiffusionSettings, FilterSettings, diffuse, merge_scans
from monitor.filtering.diffusion import diffuse_with_record
from projects.errors import ParameterError
from projects.model import PointCloud

NOISE = 0.3e-3


def cloud_of(rng, height, n_points=9000, noise=NOISE):
    """Return a height field over a square of 0.6 mm spacing, seen from above."""
    side = 0.6e-3 * np.sqrt(n_points)
    xy = rng.uniform(0, side, (n_points, 2))
    z = height(xy[:, 0] / side, xy[:, 1] / side) + rng.normal(0, noise, n_points)
    return PointCloud(np.c_[xy, z], origins=np.array([0.5 * side, 0.5 * side, 3.0])), side


def rms(cloud, height, side):
    x, y, z = cloud.points.T
    return float(np.sqrt(np.mean((z - height(x / side, y / side)) ** 2)))


SHAPES = {
    "flat": lambda x, y: 0.0 * x,
    "step": lambda x, y: 0.003 * (x > 0.5),
    "relief": lambda x, y: 0.003 * np.exp(-((x - 0.5) ** 2 + (y - 0.5) ** 2) / 0.03) + 0.003 * (y > 0.8),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_steps_end_near_the_best_number_of_them(rng, shape):
    """Within a quarter of the least error that any number of steps reaches, and far below the noise."""
    cloud, side = cloud_of(rng, SHAPES[shape])
    found = diffuse_with_record(cloud)
    tried = [rms(diffuse(cloud, DiffusionSettings(n_steps=n)), SHAPES[shape], side) for n in (5, 10, 20, 40, 80)]
    mine = rms(found.cloud, SHAPES[shape], side)
    assert mine < 1.25 * min(tried)
    assert mine < 0.45 * NOISE
    assert found.automatic["noise_m"] == pytest.approx(NOISE, rel=0.12)


def test_a_step_keeps_its_height_and_its_place(rng):
    """3 mm, ten sigmas: plain diffusion of as many steps would carry half of it over to points 1 mm beside it."""
    cloud, side = cloud_of(rng, SHAPES["step"])
    after = diffuse(cloud)
    x, z = after.points[:, 0] - 0.5 * side, after.points[:, 2]
    beside = (np.abs(x) > 0.3e-3) & (np.abs(x) < 1.5e-3)
    assert np.median(z[beside & (x > 0)]) - np.median(z[beside & (x < 0)]) == pytest.approx(3e-3, abs=0.1e-3)
    assert np.mean(np.abs(z[beside] - 3e-3 * (x[beside] > 0)) > 1e-3) < 0.02


def test_a_sphere_does_not_shrink(rng):
    """Radius 30 mm, 60 steps: heights over a neighbour's own tangent plane would shrink it by 60 x 0.5 x s^2 / r."""
    direction = rng.normal(size=(9000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    points = direction * (0.03 + rng.normal(0, 0.1e-3, (9000, 1)))
    after = diffuse(PointCloud(points, normals=direction), DiffusionSettings(n_steps=60))
    radius = np.linalg.norm(after.points, axis=1)
    assert np.median(radius) == pytest.approx(0.03, abs=0.02e-3)
    assert np.std(radius) < 0.05e-3


@pytest.mark.parametrize("is_turned", [False, True])
def test_the_sides_of_a_thin_plate_are_smoothed_as_those_of_a_thick_one(rng, is_turned):
    """3 mm thick, points 2 mm apart: by planes of both sides 0.18 mm were left, and points moved 0.11 mm aside.

    Given normals may look either way where it is known from where the points were seen.
    """
    n_points, half = 8000, 0.063
    side = np.where(np.arange(n_points) % 2, 1.0, -1.0)
    points = np.c_[rng.uniform(-half, half, (n_points, 2)), 1.5e-3 * side + rng.normal(0, NOISE, n_points)]
    normals = np.c_[np.zeros((n_points, 2)), side]
    origins = np.c_[np.zeros((n_points, 2)), 5.0 * side]
    cloud = PointCloud(points, normals=side[:, None] * normals if is_turned else normals, origins=origins)
    inside = (np.abs(points[:, :2]) < 0.85 * half).all(axis=1)
    moved = diffuse(cloud).points
    left = (moved[:, 2] - 1.5e-3 * side)[inside]
    assert left.std() < 0.45 * NOISE
    assert abs((left * side[inside]).mean()) < 0.05 * NOISE
    assert np.sqrt(((moved - points)[inside, :2] ** 2).sum(axis=1).mean()) < 0.2 * NOISE


def test_order_and_threads_change_nothing(rng):
    cloud, _ = cloud_of(rng, SHAPES["relief"], n_points=3000)
    here = diffuse(cloud).points
    order, threads = rng.permutation(len(cloud)), numba.get_num_threads()
    numba.set_num_threads(1)
    there = diffuse(cloud.take(order)).points
    numba.set_num_threads(threads)
    assert np.array_equal(here[order], there)
    assert not np.array_equal(here, cloud.points)


def test_merging_diffuses_by_a_setting_and_records_what_it_did(rng):
    cloud, side = cloud_of(rng, SHAPES["flat"], n_points=4000)
    cloud = dataclasses.replace(cloud, normals=np.tile([0.0, 0.0, 1.0], (4000, 1)), sigma=np.full(4000, NOISE))
    plain = merge_scans([cloud])
    smooth = merge_scans([cloud], FilterSettings(diffusion=DiffusionSettings(enabled=True)))
    assert "diffusion" not in plain.automatic
    assert smooth.automatic["diffusion"]["n_steps"] > 1
    assert rms(smooth.cloud, SHAPES["flat"], side) < 0.8 * rms(plain.cloud, SHAPES["flat"], side)


def test_too_few_points_are_refused():
    with pytest.raises(ParameterError, match="at least 8"):
        diffuse(PointCloud(np.zeros((3, 3))))
