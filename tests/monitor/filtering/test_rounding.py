"""Coordinates that a file holds rounded: the step is found, noise and sigma stay true, nothing is lost."""

import numpy as np
import pytest

from monitor.filtering import filter_scan_with_record
from monitor.filtering.copies import find_copies
from monitor.filtering.nearest import canonical_order
from monitor.filtering.rounding import cell_codes, error_of_rounding, find_step, spread_rounded
from projects.model import PointCloud, Scan

AT = np.array([0.0, 0.0, 2.0])


def plane(rng, slope, noise, n=40_000):
    """Return points (n, 3) [m] of a plane of 0.3 m about 0.3 mm above a whole millimetre, and the plane's heights."""
    xy = rng.uniform(-0.15, 0.15, (n, 2))
    height = xy @ np.array(slope) + 3e-4
    return np.c_[xy, height + rng.normal(0.0, noise, n)]


def filtered(points):
    return filter_scan_with_record(Scan("s", PointCloud(points), np.eye(4), origin=AT))


def errors(cloud, slope):
    """Return how far the thinned points (k,) lie off the plane [m], away from its border, and what is stated."""
    inside = (np.abs(cloud.points[:, :2]) < 0.13).all(axis=1)
    off = cloud.points[:, 2] - 3e-4 - cloud.points[:, :2] @ np.array(slope)
    return off[inside] / np.sqrt(1.0 + np.dot(slope, slope)), cloud.sigma[inside]


@pytest.mark.parametrize(("digits", "shift"), [(3, 0.0), (4, 0.0), (3, 1.2e6)])
def test_the_step_of_rounded_coordinates_is_found(rng, digits, shift):
    points = rng.normal(0.0, 0.1, (5000, 3)) + shift
    assert find_step(np.round(points, digits)) == pytest.approx(10.0**-digits, rel=1e-9)
    assert find_step(points) == 0.0
    assert find_step(points.astype(np.float32).astype(float)) == 0.0 or shift > 0.0


def test_a_grid_of_its_own_spacing_is_not_rounded():
    x, y = (a.ravel() for a in np.meshgrid(np.arange(60) * 1e-3, np.arange(60) * 1e-3))
    assert find_step(np.c_[x, y, 0.0 * x]) == 0.0
    assert find_step(np.c_[x, y, np.sin(40 * x)]) == 0.0


@pytest.mark.parametrize("begin", [0.5, 0.3, -30.5])
def test_a_grid_is_one_wherever_it_begins(begin):
    """Of the middles of voxels, and of an even number of places about 0, two had one number: a grid passed for rounded,
    its points were moved by up to half its spacing, and a third of that was the sigma of an exact plane."""
    x, y = (a.ravel() for a in np.meshgrid(*2 * [(np.arange(60) + begin) * 1e-3]))
    assert find_step(np.c_[x, y, 0.0 * x]) == 0.0
    assert find_step(np.c_[x, y, (np.floor(2e2 * x) + begin) * 1e-3]) == 0.0
    assert filtered(np.c_[x, y, 0.0 * x]).automatic["noise_before"] < 1e-6


@pytest.mark.parametrize("begin", [0.0, 5e-4])
def test_no_two_places_have_one_cell_whether_steps_are_counted_from_0_or_a_half(rng, begin):
    """On halves a third of the places had the cell of a neighbour, and were spread just as that was."""
    points = np.round(plane(rng, (0.03, 0.05), 3e-4, n=5000), 3) + begin
    places = np.unique(points, axis=0)
    assert len(np.unique(cell_codes(points, 1e-3))) == len(places)
    spread = spread_rounded(places[canonical_order(places)], 1e-3) - places[canonical_order(places)]
    assert len(np.unique(np.round(spread, 9), axis=0)) == len(places)


@pytest.mark.parametrize(("slope", "noise"), [((0.0, 0.0), 5e-4), ((0.03, 0.05), 3e-4), ((0.1, 0.1), 0.0)])
def test_noise_and_sigma_of_rounded_coordinates_are_true_and_nothing_is_lost(rng, slope, noise):
    """A plane on one or two whole millimetres once had 0.00001 mm of noise told, and lost a third of its points."""
    found = filtered(np.round(plane(rng, slope, noise), 3))
    assert found.automatic["coordinate_step"] == 0.001
    assert found.automatic["noise_before"] == pytest.approx(np.hypot(noise, 1e-3 / np.sqrt(6.0)), rel=0.15)
    assert found.counts["outlier"] + found.counts["rim"] < 100
    off, sigma = errors(found.cloud, slope)
    assert 0.85 < 1.4826 * np.median(np.abs(off / sigma)) < 1.2


def test_what_rounding_moves_as_a_whole_is_stated(rng):
    """Without noise a face along the axes lies on the next whole millimetre, 0.3 mm off, however many points it has."""
    off, sigma = errors(filtered(np.round(plane(rng, (0.0, 0.0), 0.0), 3)).cloud, (0.0, 0.0))
    assert np.mean(off) == pytest.approx(-3e-4, abs=5e-5)
    assert 0.85 < np.sqrt(np.mean((off / sigma) ** 2)) < 1.3


def test_the_error_that_rounding_leaves_is_that_of_many_draws(rng):
    """Of discs somewhere above a millimetre, of 400 points each."""
    normal = np.array([0.1, 0.05, 1.0]) / np.linalg.norm([0.1, 0.05, 1.0])
    for noise, radius in ((1e-4, 2e-3), (2.5e-4, 1e-3), (5e-5, 1e-3)):
        means = []
        for _ in range(400):
            aside = (
                radius
                * np.sqrt(rng.uniform(size=(400, 1)))
                * np.array([[np.cos(a), np.sin(a)] for a in rng.uniform(0, 2 * np.pi, 400)])
            )
            z = rng.uniform(0, 1e-3) - aside @ normal[:2] / normal[2] + rng.normal(0, noise, 400) / normal[2]
            means.append(np.mean(np.round(z, 3) - z) * normal[2])
        left = error_of_rounding(normal[None], np.hypot(noise, 1e-3 / np.sqrt(6.0)), radius, 1e-3)[0]
        chance = 1e-3 / np.sqrt(12.0 * 400)
        assert np.hypot(left, chance) == pytest.approx(np.std(means), rel=0.35)


def test_points_are_spread_evenly_and_always_alike(rng):
    points = np.round(plane(rng, (0.0, 0.0), 1e-4), 3)
    points = points[canonical_order(points)]
    spread = (spread_rounded(points, 1e-3) - points) / 1e-3
    assert np.abs(spread).max() <= 0.5
    np.testing.assert_allclose(spread.std(axis=0), np.sqrt(1 / 12), rtol=0.02)
    assert len(np.unique(spread, axis=0)) == len(spread)
    assert np.array_equal(spread_rounded(points, 1e-3), spread_rounded(points.copy(), 1e-3))


def test_a_part_that_is_there_twice_is_told_from_what_rounding_brings_together(rng):
    once = np.round(plane(rng, (0.1, 0.1), 3e-4), 3)
    once = once[canonical_order(once)]
    assert len(once) - len(np.unique(once, axis=0)) > 500
    assert not find_copies(once, 1e-3).any()
    fine = np.round(plane(rng, (0.1, 0.1), 3e-4), 4)
    twice = np.r_[fine, fine[:20_000]]
    assert find_copies(twice[canonical_order(twice)], 1e-4).sum() >= 20_000
