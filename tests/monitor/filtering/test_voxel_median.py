"""The voxel median: real points, distances rejected beyond the accuracy, honest sigmas, two sides kept apart."""

import dataclasses

import numpy as np
import pytest

from monitor.filtering import (
    FilterSettings,
    ThinningSettings,
    VoxelMedianSettings,
    filter_scan_with_record,
    voxel_median,
)
from projects.errors import ParameterError
from projects.model import PointCloud, Scan

NOISE = 1e-3


def wall(rng, n_points=20_000, noise=NOISE, slope=0.0):
    """Return a wall of 1 mm spacing, `slope` against the axes, with the normals and noise that it has."""
    side = 0.001 * np.sqrt(n_points)
    xy = rng.uniform(0, side, (n_points, 2))
    normal = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    points = np.c_[xy, slope * xy[:, 0]] + rng.normal(0, noise, (n_points, 1)) * normal
    ones = np.ones(n_points)
    return PointCloud(points, normals=np.tile(normal, (n_points, 1)), sigma=noise * ones, spacing=1e-3 * ones)


@pytest.mark.parametrize("slope", [0.0, 0.8])
def test_points_are_measured_ones_and_their_sigma_is_their_error_on_any_slope(rng, slope):
    """The voxel mean of distances from the scanner would hold the slope: 0.8 mm more noise in voxels of 5 mm."""
    cloud = wall(rng, slope=slope)
    thin = voxel_median(cloud, VoxelMedianSettings(voxel_size=5e-3))
    assert {tuple(p) for p in thin.points} <= {tuple(p) for p in cloud.points}
    height = thin.points @ cloud.normals[0]
    assert np.median(thin.n_merged) > 15
    assert np.sqrt(np.mean((height / thin.sigma) ** 2)) == pytest.approx(1.0, abs=0.12)
    assert np.median(thin.spread) == pytest.approx(NOISE, rel=0.06)


def test_the_automatic_voxel_is_two_and_a_half_spacings_wide(rng):
    thin = voxel_median(wall(rng, noise=1e-5))
    assert 20_000 / len(thin) == pytest.approx(2.5**2, rel=0.08)


def test_what_is_farther_than_the_accuracy_is_rejected_and_not_counted(rng):
    """A tenth of the points 6 to 9 mm off: a mean would be pulled by 0.75 mm."""
    cloud = wall(rng)
    bad = rng.random(len(cloud)) < 0.1
    points = cloud.points.copy()
    points[bad, 2] += rng.uniform(6e-3, 9e-3, bad.sum())
    thin = voxel_median(dataclasses.replace(cloud, points=points), VoxelMedianSettings(voxel_size=20e-3))
    assert thin.n_merged.sum() == pytest.approx((~bad).sum(), rel=0.01)
    full = thin.n_merged > 50  # at the border a voxel may hold nothing but a bad point
    assert np.abs(thin.points[full, 2]).max() < 0.6e-3


def test_two_sides_of_a_thin_plate_stand_for_themselves(rng):
    front, back = wall(rng, noise=1e-5), wall(rng, noise=1e-5)
    both = PointCloud(
        np.r_[front.points, back.points - np.array([0, 0, 1e-3])], normals=np.r_[front.normals, -back.normals],
        sigma=np.r_[front.sigma, back.sigma], spacing=np.r_[front.spacing, back.spacing],
    )  # fmt: skip
    thin = voxel_median(both, VoxelMedianSettings(voxel_size=4e-3))
    is_front = thin.normals[:, 2] > 0
    assert np.abs(thin.points[is_front, 2]).max() < 1e-4
    assert np.abs(thin.points[~is_front, 2] + 1e-3).max() < 1e-4


def test_the_order_of_the_points_changes_nothing(rng):
    cloud = wall(rng, n_points=4000)
    here, there = voxel_median(cloud), voxel_median(cloud.take(rng.permutation(len(cloud))))
    for f in dataclasses.fields(PointCloud):
        a, b = getattr(here, f.name), getattr(there, f.name)
        assert (a is None and b is None) or np.array_equal(a, b), f.name


def test_the_chain_takes_it_by_a_setting_and_accounts_for_what_it_rejected(rng):
    cloud = wall(rng, n_points=8000)
    points = cloud.points - np.array([0.0, 0.0, 3.0])
    settings = FilterSettings(thinning=ThinningSettings(method="voxel_median", target_spacing=4e-3))
    result = filter_scan_with_record(Scan("a", PointCloud(points), np.eye(4)), settings)
    assert {tuple(p) for p in result.cloud.points} <= {tuple(p) for p in points}
    counts = dict(result.counts)
    assert counts.pop("in") == sum(counts.values()) == 8000
    assert result.cloud.n_merged.sum() == counts["merged"] + counts["out"]


def test_a_scan_of_which_every_point_is_dropped_leaves_nothing_and_accounts_for_it(rng):
    """Points on one line have no face to the scanner: all go as grazing, and the voxels of none ended in an error."""
    line = np.c_[np.linspace(-1.0, 1.0, 300), np.zeros(300), rng.normal(4.0, NOISE, 300)]
    settings = FilterSettings(thinning=ThinningSettings(method="voxel_median"))
    result = filter_scan_with_record(Scan("a", PointCloud(line), np.eye(4)), settings)
    assert len(result.cloud) == result.counts["out"] == 0
    assert result.counts["grazing"] == result.counts["in"] == 300


def test_voxels_too_small_to_be_numbered_are_refused(rng):
    cloud = wall(rng, n_points=100)
    far = dataclasses.replace(cloud, points=cloud.points * 1e7)
    with pytest.raises(ParameterError, match="larger ones"):
        voxel_median(far, VoxelMedianSettings(voxel_size=1e-5))
