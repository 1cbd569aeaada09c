"""Thinning to the mode: against a plain search, honest sigmas, detail kept, nothing merged through a plate."""

import numpy as np
import pytest

from monitor.filtering.drawing_order import draw_order
from monitor.filtering.modes import MODE_SPREAD, MODE_WIDTH, density_mode
from monitor.filtering.nearest import build_index, canonical_order
from monitor.filtering.normals import TangentPlanes
from monitor.filtering.thinning import DISC_PACKING, ThinningSettings, list_members, target_spacings, thin
from projects.model import Roughness


def thin_all(points, normals, noise, targets, spacing=0.001, seed=0, relief2=0.0):
    """Thin with the same noise [m], target and spacing everywhere; `relief2` above the noise marks a curved surface."""
    ones = np.ones(len(points))
    planes = TangentPlanes(
        normals=normals, lambda3=ones, relief2=relief2 * ones, surface_variation=ones,
        noise=noise * ones, heights=ones,
        sigma_normal=ones, n_neighbours=40 * ones.astype(int), stride=ones.astype(int), spacing=spacing * ones,
        reach=ones, is_outlier=ones < 0,
    )  # fmt: skip
    return thin(build_index(points), planes, ones.astype(int), targets * ones, seed)


def wall(rng, n_points=8000, noise=1e-3):
    """Return a wall in z = 0 of 1 mm spacing and its normals, in canonical order."""
    side = 0.001 * np.sqrt(n_points)
    points = np.c_[rng.uniform(0, side, (n_points, 2)), rng.normal(0, noise, n_points)]
    points = points[canonical_order(points)]
    return points, np.tile([0.0, 0, 1.0], (n_points, 1))


def test_mode_is_where_the_density_is_greatest(rng):
    """Against a search on a grid of 1e-4 of the width, with two humps and outliers."""
    grid = np.linspace(-8, 12, 40_001)
    for _ in range(20):
        heights = np.r_[rng.normal(0, 1, 12), rng.normal(5, 1, 9), rng.uniform(-8, 12, 4)]
        weights = rng.uniform(0.5, 2.0, len(heights))
        u = (heights[:, None] - grid) / 3.0
        density = (weights[:, None] * np.maximum(1 - u**2, 0.0) ** 3).sum(axis=0)
        mode = density_mode(heights, weights, len(heights), 3.0)
        at_mode = (weights * np.maximum(1 - ((heights - mode) / 3.0) ** 2, 0.0) ** 3).sum()
        assert at_mode > density.max() * (1 - 1e-3)


@pytest.mark.parametrize("n", [2, 5, 20, 80])
def test_standard_error_of_the_mode_is_that_of_the_mean_times_its_factor(rng, n):
    """4000 draws: one standard error of the ratio is 1.1 %; the factor stands for all n within 4 %."""
    modes = [density_mode(rng.normal(0, 1, n), np.ones(n), n, MODE_WIDTH) for _ in range(4000)]
    assert np.isclose(np.std(modes) * np.sqrt(n), MODE_SPREAD, rtol=0.04)


def test_sigma_of_thinned_points_is_their_true_error(rng):
    """Wall with 1 mm noise, thinned to 4 mm: the rms error over the stated sigma is 1 within 8 %."""
    points, normals = wall(rng, n_points=20_000)
    thinned = thin_all(points, normals, 1e-3, 4e-3)
    assert np.median(thinned.n_merged) > 8
    assert np.isclose(np.sqrt(((thinned.points[:, 2] / thinned.sigma) ** 2).mean()), 1.0, atol=0.08)
    assert np.isclose(np.median(thinned.spread), 1e-3, rtol=0.08)


def test_outliers_within_the_cylinder_do_not_move_the_mode(rng):
    """A fifth of the points 6 to 9 sigma above: the mean would move by 1.5 mm, the modes stay within 0.1 mm."""
    points, normals = wall(rng)
    bad = rng.random(len(points)) < 0.2
    points[bad, 2] += rng.uniform(6e-3, 9e-3, bad.sum())
    order = canonical_order(points)
    thinned = thin_all(points[order], normals, 1e-3, 6e-3)
    on_wall = np.abs(thinned.points[:, 2]) < 4e-3
    assert np.average(on_wall, weights=thinned.n_merged) > 0.75
    assert abs(np.median(thinned.points[on_wall, 2])) < 0.1e-3


def test_curvature_does_not_shift_the_representatives(rng):
    """Ball of 20 mm, cylinders of 4 mm: the plain mean of heights would lie 0.1 mm inside; ours within 0.01 mm."""
    normals = rng.normal(size=(12_000, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    points = 0.02 * normals + 0.02e-3 * normals * rng.normal(size=(12_000, 1))
    order = canonical_order(points)
    thinned = thin_all(points[order], normals[order], 0.02e-3, 4.8e-3, spacing=0.6e-3, relief2=1e-6)
    assert np.median(thinned.n_merged) > 20
    assert abs(np.mean(np.linalg.norm(thinned.points, axis=1)) - 0.02) < 0.01e-3


def test_nothing_is_merged_through_a_thin_plate(rng):
    """Two faces 0.5 mm apart, each with 0.1 mm noise, cylinders of 3 mm: every representative is of one face."""
    points, normals = wall(rng, noise=0.1e-3)
    back = rng.random(len(points)) < 0.5
    points[back, 2] -= 0.5e-3
    normals[back] *= -1
    order = canonical_order(points)
    points, normals, back = points[order], normals[order], back[order]
    thinned = thin_all(points, normals, 0.1e-3, 3e-3)
    share = np.add.reduceat(back[thinned.members].astype(float), thinned.starts[:-1]) / thinned.n_merged
    assert set(np.unique(share)) <= {0.0, 1.0}


def test_spacing_of_the_thinned_points_is_the_target(rng):
    points, normals = wall(rng, n_points=40_000)
    thinned = thin_all(points, normals, 0.5e-3, 5e-3)
    area = np.ptp(points[:, 0]) * np.ptp(points[:, 1])
    assert np.isclose(np.sqrt(area / len(thinned.points)), 5e-3, rtol=0.1)


def test_every_measurement_stands_in_one_representative(rng):
    points, normals = wall(rng)
    thinned = thin_all(points, normals, 1e-3, 4e-3)
    assert np.array_equal(np.sort(thinned.members), np.arange(len(points)))
    assert thinned.n_merged.sum() == len(points)
    assert (np.diff(thinned.starts) == thinned.n_merged).all()


def test_members_are_listed_by_owner_as_sorting_lists_them(rng):
    """In half the memory: whole numbers of 32 bits. Owners below zero are none; one of the seven has no member."""
    owner = rng.choice(np.array([-2, -1, 0, 1, 2, 4, 5, 6], dtype=np.int32), 3000)
    members, starts = list_members(owner, 7)
    assert members.dtype == np.int32
    assert np.array_equal(members, np.argsort(owner, kind="stable")[(owner < 0).sum() :])
    assert np.array_equal(np.diff(starts), np.bincount(owner[owner >= 0], minlength=7))


def test_a_measurement_belongs_to_the_nearest_axis(rng):
    """A wall without noise: of the cylinders that hold a point, none has its seed nearer than the point's own."""
    points, normals = wall(rng, noise=0.0)
    thinned = thin_all(points, normals, 1e-9, 4e-3)
    owner = np.empty(len(points), int)
    owner[thinned.members] = np.repeat(np.arange(len(thinned.points)), np.diff(thinned.starts))
    drawn = draw_order(points, 0)
    seeds = np.empty(len(thinned.points), int)
    apart = np.array([np.inf])
    n_seeds = 0
    for k in drawn:  # none nearer than a radius to another
        if n_seeds:
            apart = np.linalg.norm(points[seeds[:n_seeds]] - points[k], axis=1)
        if apart.min() > 4e-3 / DISC_PACKING:
            seeds[n_seeds] = k
            n_seeds += 1
    assert n_seeds == len(thinned.points)
    gaps = np.linalg.norm(points[:, None] - points[seeds], axis=2)
    assert np.array_equal(gaps.argmin(axis=1), owner)


def test_noise_left_is_that_of_an_even_share(rng):
    """20 000 points in 1 mm of noise, all alike: the standard error of shares of the same size is 9 % less."""
    points, normals = wall(rng, n_points=20_000)
    thinned = thin_all(points, normals, 1e-3, 4e-3)
    even = MODE_SPREAD * 1e-3 * np.sqrt(len(thinned.points) / len(points))
    assert even < thinned.points[:, 2].std() < 1.15 * even


def test_the_draw_depends_on_the_seed_and_on_nothing_else(rng):
    points, normals = wall(rng)
    first, again, other = (thin_all(points, normals, 1e-3, 4e-3, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first.points, again.points)
    assert len(other.points) != len(first.points) or not np.array_equal(other.points, first.points)
    shuffle = rng.permutation(len(points))
    assert np.array_equal(points[draw_order(points, 1)], points[shuffle][draw_order(points[shuffle], 1)])


def test_draw_order_is_spread_over_the_cloud(rng):
    """The first tenth drawn is a fair sample: its mean is the cloud's within 3 standard errors."""
    points, _ = wall(rng)
    first = points[draw_order(points, 0)[:800], :2]
    error = (first.mean(axis=0) - points[:, :2].mean(axis=0)) / (points[:, :2].std(axis=0) / np.sqrt(800))
    assert (np.abs(error) < 3).all()


def test_data_that_are_not_redundant_are_left_alone(rng):
    """Spacing 1 mm and noise 0.05 mm: a facet tilts by 4 degrees at most already."""
    points, normals = wall(rng, noise=0.05e-3)
    ones = np.ones(len(points))
    targets = target_spacings(1e-3 * ones, 0.05e-3 * ones, Roughness.SMOOTH * ones, ThinningSettings())
    thinned = thin_all(points, normals, 0.05e-3, targets)
    assert len(thinned.points) == len(points)
    assert np.allclose(np.sort(thinned.points[:, 2]), np.sort(points[:, 2]))


def test_target_spacing_makes_facets_tilt_as_much_as_the_setting_allows():
    """sqrt(2) 1.05 noise / sqrt((d / s)^2) / d = 0.3 rad; rough: 0.7 of it; half a footprint is the least."""
    noise, spacing, settings = np.array([1e-3, 1e-3]), np.array([0.7e-3, 0.7e-3]), ThinningSettings()
    classes = np.array([Roughness.SMOOTH, Roughness.ROUGH])
    target = target_spacings(spacing, noise, classes, settings)
    assert np.isclose(np.sqrt(2) * 1.05 * noise[0] * spacing[0] / target[0] ** 2, 0.3)
    assert np.isclose(target[1], 0.7 * target[0])
    assert np.isclose(target_spacings(spacing, noise, classes, ThinningSettings(footprint=8e-3))[0], 4e-3)
    assert np.isclose(target_spacings(spacing, noise, classes, ThinningSettings(target_spacing=5e-3))[0], 5e-3)
