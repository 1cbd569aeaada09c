"""Errors agree farther where fits are wide: by what factor is found from calm vertices, by their sigma."""

import warnings

import numpy as np
import pytest
from scipy.spatial import cKDTree

from monitor.comparison.noise.correlation import Correlation, estimate_correlation, kept_variance
from monitor.comparison.noise.stretch import EVEN, Stretch, _number, learn_stretch
from projects.model import Floats, Ints

SPACING, SIDE = 0.01, 4.0  # m
NARROW, WIDE = 0.03, 0.06  # m, radii over which errors are averaged, and range of what comes out


def smoothed(points: Floats, radii: Floats, rng: np.random.Generator) -> Floats:
    """Return white noise averaged over a disc about each point, times what makes its scatter 1 / radius."""
    tree, white = cKDTree(points), rng.normal(size=len(points))
    near = tree.query_ball_point(points, radii)
    return np.array([white[k].sum() / np.sqrt(len(k)) for k in near]) * (1e-4 * NARROW / radii)


def wall(wide_share: float, side: float = SIDE) -> tuple[Floats, Floats, Floats]:
    """Return points (n, 3) [m] of a wall, radii (n,) [m] of its fits, wide over a share of it, and errors (n,) [m]."""
    rng = np.random.default_rng(3)
    x, z = np.meshgrid(np.arange(0, side, SPACING), np.arange(0, side, SPACING))
    points = np.column_stack([x.ravel(), np.zeros(x.size), z.ravel()])
    radii = np.where(points[:, 0] < wide_share * side, WIDE, NARROW)
    return points, radii, smoothed(points, radii, rng)


def learn(points: Floats, radii: Floats, errors: Floats) -> tuple[Correlation, Stretch]:
    sigma, areas = 1e-4 * NARROW / radii, np.full(len(points), SPACING**2)
    sigma *= np.random.default_rng(4).lognormal(sigma=1e-3, size=len(sigma))  # no two alike, as in life
    correlation = estimate_correlation(points, errors / sigma, areas, np.random.default_rng(0))

    def errors_of(which: Ints) -> tuple[Floats, Floats]:
        return errors[which] / sigma[which], sigma[which]

    places = np.arange(len(points), dtype=np.int32)
    return correlation, learn_stretch(points, places, areas, errors_of, correlation, np.random.default_rng(1))


def test_means_err_as_is_said_where_fits_are_wide() -> None:
    points, radii, errors = wall(0.4)
    correlation, stretch = learn(points, radii, errors)
    cell = np.floor(points[:, [0, 2]] / 0.1).astype(int) @ [100, 1]
    _, number, size = np.unique(cell, return_inverse=True, return_counts=True)
    means, wide = (np.bincount(number, v) / size for v in (errors, radii == WIDE))
    variance = (1e-4 * NARROW / WIDE) ** 2
    asked = np.array([0.01]), np.array([100]), correlation
    said, once = (
        float(np.sqrt(variance * kept_variance(*asked, s2)[0]))
        for s2 in (stretch.square_of(np.array([variance]))[0], 1)
    )
    found = float(np.sqrt(np.mean(means[wide == 1.0] ** 2)))
    assert said == pytest.approx(found, rel=0.15)
    assert once < 0.87 * found


def test_where_fits_are_as_wide_everywhere_nothing_is_stretched() -> None:
    _, stretch = learn(*wall(0.0))
    np.testing.assert_allclose(stretch.factors, 1.0, atol=0.12)


def test_no_place_is_surer_than_all_are_said_to_be() -> None:
    _, stretch = learn(*wall(0.4))
    assert stretch.factors.min() == 1.0
    assert stretch.factors[0] > 1.15
    assert stretch.factors[0] == pytest.approx(stretch.factors[1], rel=0.2)


def test_a_faint_step_on_a_small_object_does_not_teach_that_errors_agree_that_far() -> None:
    """It hid itself: a quarter of steps of three and a half times what a patch can show were not found for it."""
    points, radii, errors = wall(0.0, 0.9)
    is_step = (np.abs(points[:, [0, 2]] - 0.4) < 0.1).all(axis=1)
    _, stretch = learn(points, radii, errors + 2e-4 * is_step)
    assert stretch.factors.max() < 1.12


def test_few_vertices_tell_nothing() -> None:
    points, radii, errors = (v[::200] for v in wall(0.4))
    assert learn(points, radii, errors)[1] is EVEN


def test_classes_of_too_few_pairs_are_left_out_without_a_word() -> None:
    points, _, _ = wall(0.0, 0.5)
    areas, places = np.full(len(points), SPACING**2), np.arange(len(points), dtype=np.int32)
    hardly = Correlation(np.array([0.01]), np.array([0.05]))  # as small as none: no pair is near enough
    sigma = np.random.default_rng(4).lognormal(sigma=1e-3, size=len(points))
    with warnings.catch_warnings(action="error"):
        found = learn_stretch(points, places, areas, lambda k: (np.ones(len(k)), sigma[k]), hardly,
                              np.random.default_rng(1))  # fmt: skip
    assert found is EVEN


def test_a_patch_is_stretched_as_its_variance_asks() -> None:
    correlation = Correlation(np.array([0.8]), np.array([0.05]))
    areas, n = np.array([0.01, 0.02]), np.array([100, 200])
    plain = kept_variance(areas / 4.0, n, correlation)
    np.testing.assert_allclose(kept_variance(areas, n, correlation, 4.0), plain, rtol=1e-6)
    stretch = Stretch(np.array([1e-4, 4e-4]), np.array([2.0, 1.0]))
    np.testing.assert_allclose(stretch.square_of(np.array([1e-10, 1e-8, 4e-8, 1e-6])), [4.0, 4.0, 2.0, 1.0])
    weight, variance = np.array([0.75, 0.25]), np.array([1e-8, 1.6e-7])
    assert stretch.square_over(weight, variance) == pytest.approx((0.75 * 4.0 + 0.25 * 16.0) / (0.75 + 0.25 * 16.0))
    assert EVEN.square_over(weight, variance) == 1.0


@pytest.mark.parametrize("n_asked", [0, 1, 500])
def test_the_vertices_of_pairs_are_numbered_as_sorting_numbers_them(rng: np.random.Generator, n_asked: int) -> None:
    vertices = rng.integers(0, 300, n_asked).astype(np.int32)
    for found, sorted_ in zip(_number(vertices, 300), np.unique(vertices, return_inverse=True), strict=True):
        np.testing.assert_array_equal(found, sorted_)
