"""The neighbourhood size and the noise from the variogram of lambda3."""

import math

import numpy as np
import pytest

from monitor.filtering.nearest import build_index, canonical_order
from monitor.filtering.neighbourhoods import fit_spherical, spherical_variogram
from monitor.filtering.sizes import NormalSettings, sample_neighbourhoods

SIZES = np.array([10, 12, 15, 18, 21, 26, 31, 38, 46, 55, 67, 81, 100])


def plane(rng, noise, n_points=6000):
    """Return a plane of spacing 1 mm with noise [m] across."""
    side = 0.001 * np.sqrt(n_points)
    points = np.c_[rng.uniform(0, side, (n_points, 2)), rng.normal(0, noise, n_points)]
    return points[canonical_order(points)]


def test_spherical_model_is_one_from_its_range_on_and_11_16_at_half_of_it():
    assert np.allclose(spherical_variogram([0, 20, 40, 60], 40), [0, 11 / 16, 1, 1])


@pytest.mark.parametrize("growth", [0.0, 2e-4])
def test_fit_finds_range_sill_and_growth_of_noisy_curves(rng, growth):
    """Relative errors of nested variances, those of the median of 15 samples; 20 % is three sigma of the range."""
    truth = 4.0 * spherical_variogram(SIZES, 40.0) + growth * SIZES**2
    variances = 2.0 / (SIZES - 3.0) / 15 * 1.5
    steps = np.sqrt(np.append(variances[:-1] - variances[1:], variances[-1]))
    walk = np.cumsum((steps * rng.normal(size=(60, len(SIZES))))[:, ::-1], axis=1)[:, ::-1]
    n_range, sill, grows = fit_spherical(SIZES, truth * (1.0 + walk))
    assert np.isclose(np.median(n_range), 40.0, rtol=0.2)
    assert np.isclose(np.median(sill), 4.0, rtol=0.08)
    assert np.isclose(np.median(grows), growth, atol=5e-5)


def test_noise_is_found_and_a_plane_takes_all_the_neighbours_it_may_have(rng):
    """The sill is the noise variance; 6 % in its root is the spread of 600 samples, 20 % where the range nears its
    bound. On a plane the normal of more neighbours is always the better one, however thick the band of noise."""
    for noise, tolerance in ((0.1e-3, 0.06), (0.5e-3, 0.06), (1e-3, 0.08), (2e-3, 0.08)):
        model = sample_neighbourhoods(build_index(plane(rng, noise)), NormalSettings())
        assert np.isclose(np.median(model.noise), noise, rtol=tolerance)
        assert np.median(model.sizes) == 100
        assert np.quantile(model.sizes, 0.1) > 100 / 1.5


@pytest.mark.parametrize("times", [2, 3, 5, 8])
def test_noise_thicker_than_a_hundred_points_are_wide_is_told_by_points_farther_apart(rng, times):
    """Of the 100 nearest alone it would be 0.8, 0.7, 0.54, 0.39 of the truth: a ball cuts the band of noise."""
    points = plane(rng, times * 1e-3, n_points=40_000)
    model = sample_neighbourhoods(build_index(points), NormalSettings())
    inside = (np.abs(model.points[:, :2] - 0.1) < 0.08).all(axis=1)
    assert np.isclose(np.median(model.noise[inside]), times * 1e-3, rtol=0.08)
    assert (times / 1.3) ** 2 < np.median(model.strides[inside]) * math.pi < (3 * times) ** 2
    assert np.median(model.sizes) > 60


def test_where_noise_grows_over_a_scan_the_stride_follows_and_what_is_told_of_points_with_it(rng):
    """0.5 mm at the left, 6 mm at the right, points 1 mm apart."""
    points = plane(rng, 1.0, n_points=90_000)
    noise = 1e-3 * np.interp(points[:, 0], [0.0, 0.3], [0.5, 6.0])
    points = (points * np.c_[np.ones((len(points), 2)), noise])[canonical_order(points * [1, 1, 0])]
    points = points[canonical_order(points)]
    noise = 1e-3 * np.interp(points[:, 0], [0.0, 0.3], [0.5, 6.0])
    sizes, told, strides = sample_neighbourhoods(build_index(points), NormalSettings()).at(points)
    inside = (np.abs(points[:, :2] - 0.15) < 0.12).all(axis=1)
    assert np.quantile(told[inside] / noise[inside], [0.1, 0.5, 0.9]) == pytest.approx([0.85, 0.98, 1.1], abs=0.08)
    assert (strides[points[:, 0] < 0.01] == 1).all()
    assert strides[inside & (points[:, 0] > 0.24)].min() >= 8
    assert sizes.max() <= 100


def test_a_heap_has_not_the_noise_of_a_surface_beside_it(rng):
    """Wide neighbourhoods of a heap find the wall's plane and its 0.3 mm of noise."""
    heap = rng.uniform([0.0, 0.0, 0.01], [0.2, 0.2, 0.21], (8000, 3))
    points = np.concatenate([heap, plane(rng, 0.3e-3, n_points=40_000)])
    points = points[canonical_order(points)]
    model = sample_neighbourhoods(build_index(points), NormalSettings(n_samples=2000))
    in_heap = (model.points[:, 2] > 0.03) & (model.points[:, 2] < 0.18)
    assert in_heap.sum() > 200
    assert np.quantile(model.noise[in_heap], 0.05) > 3e-3


def test_neighbourhoods_grow_with_noise_over_spacing_on_waves(rng):
    """The size of least error goes with the root of the noise: three times the noise, 1.73 times the size."""
    sizes = []
    for noise in (0.1e-3, 0.3e-3):
        points = plane(rng, noise)
        points[:, 2] += 0.6 * 0.02 / (2 * np.pi) * np.prod(np.sin(2 * np.pi * points[:, :2] / 0.02), axis=1)
        points = points[canonical_order(points)]
        sizes.append(np.median(sample_neighbourhoods(build_index(points), NormalSettings()).sizes))
    assert np.isclose(sizes[1] / sizes[0], math.sqrt(3.0), rtol=0.25)


def test_sizes_keep_within_their_bounds(rng):
    settings = NormalSettings(min_neighbours=20, max_neighbours=30)
    for noise in (0.05e-3, 3e-3):
        model = sample_neighbourhoods(build_index(plane(rng, noise)), settings)
        assert model.sizes.min() >= 20
        assert model.sizes.max() <= 30


def test_noise_follows_the_scan_where_it_changes(rng):
    """Left half 0.1 mm, right half 0.4 mm."""
    points = plane(rng, 1.0, n_points=12_000)
    left = points[:, 0] < np.median(points[:, 0])
    points[:, 2] *= np.where(left, 0.1e-3, 0.4e-3)
    points = points[canonical_order(points)]
    left = points[:, 0] < np.median(points[:, 0])
    _, noise, _ = sample_neighbourhoods(build_index(points), NormalSettings()).at(points)
    assert np.isclose(np.median(noise[left]), 0.1e-3, rtol=0.1)
    assert np.isclose(np.median(noise[~left]), 0.4e-3, rtol=0.1)


def test_outliers_do_not_pass_for_noise(rng):
    """A fifth of the points up to 20 mm off the plane; the noise of the others is 0.3 mm."""
    points = plane(rng, 0.3e-3)
    bad = rng.random(len(points)) < 0.2
    points[bad, 2] += rng.uniform(2e-3, 20e-3, bad.sum())
    points = points[canonical_order(points)]
    model = sample_neighbourhoods(build_index(points), NormalSettings())
    assert np.isclose(np.median(model.noise), 0.3e-3, rtol=0.15)
