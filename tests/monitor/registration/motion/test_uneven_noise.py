"""Surfaces of unlike roughness: what scatters more weighs less and is stable all the same; what roughened is not."""

import dataclasses

import numpy as np
import pytest
from bumpy_body import bumpy_points, move, unit
from motion_errors import error_of

from monitor.registration import register
from monitor.registration.motion.alignment import AlignmentRules, align, weigh
from monitor.registration.motion.covariance import bearing_patches, standardize
from monitor.registration.motion.matching import Matches, MatchLimits, compare_relief, make_samples, match, with_relief
from monitor.registration.motion.sides import Side
from monitor.registration.motion.stable_areas import common_variance, share_noise, sum_patches
from projects.model import Bools, Floats, PointCloud
from projects.transforms import invert, perturb

N = 8_000
SMOOTH, ROUGH = 2e-4, 2.5e-3  # m, of points
T = perturb(np.eye(4), np.zeros(3), np.array([0.005, -0.003, 0.004, 0.002, -0.001, 0.0015]))


def is_rough(points: Floats) -> Bools:
    """Return which points lie in the rough half of the body."""
    return points[:, 0] > 0.0


def uneven_cloud(rng: np.random.Generator, roughness: float) -> PointCloud:
    """Return the bumpy body with relief too fine for its points on the half towards +x."""
    points, normals = bumpy_points(N, rng)
    lift = rng.normal(0, np.where(is_rough(points), roughness, SMOOTH))
    return PointCloud(points + normals * lift[:, None], unit(normals + rng.normal(0, 0.02, (N, 3))))


def test_an_unchanged_body_that_is_rough_on_one_half_is_stable_all_over() -> None:
    squared = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        found = register(move(uneven_cloud(rng, ROUGH), invert(T)), uneven_cloud(rng, ROUGH))
        assert found.converged, found.reason  # with one sigma for all, the rough half was no part of the majority
        assert found.stable_share > 0.9
        error = error_of(found, T)
        squared.append(float(error @ np.linalg.solve(found.covariance, error)))
    assert np.mean(squared) < 12.0  # of 6, one sigma 2


def test_the_rough_half_takes_nothing_from_what_the_smooth_one_knows() -> None:
    errors = []
    for roughness in (SMOOTH, ROUGH):
        ways = []
        for seed in range(3):
            rng = np.random.default_rng(seed)
            found = register(move(uneven_cloud(rng, roughness), invert(T)), uneven_cloud(rng, roughness))
            ways.append(np.linalg.norm(error_of(found, T)[3:]))
        errors.append(float(np.sqrt(np.mean(np.square(ways)))))
    # half the points and a worse geometry: two to three times
    assert errors[1] < 4.0 * errors[0]


def test_a_half_that_roughened_is_not_stable(rng: np.random.Generator) -> None:
    source = uneven_cloud(rng, ROUGH)
    found = register(source, uneven_cloud(rng, SMOOTH))
    rough = is_rough(source.points)
    assert found.is_stable is not None
    assert found.is_stable[rough].mean() < 0.1
    assert found.is_stable[~rough].mean() > 0.85


def test_relief_is_that_of_the_smoother_side_and_not_of_the_point_itself(rng: np.random.Generator) -> None:
    x, y = (v.ravel() for v in np.meshgrid(np.arange(60) * 0.01, np.arange(60) * 0.01))
    up = np.tile([0.0, 0.0, 1.0], (len(x), 1))
    x, y = x + rng.normal(0, 0.003, len(x)), y + rng.normal(0, 0.003, len(x))
    heights = rng.normal(0, 1e-3, len(x))
    rough = Side(np.column_stack([x, y, heights]), up, None, np.arange(len(x)))
    spike = heights.copy()
    spike[1830] = 0.5
    spiked = Side(np.column_stack([x, y, spike]), up, None, np.arange(len(x)))
    inner = np.flatnonzero((x > 0.1) & (x < 0.5) & (y > 0.1) & (y < 0.5))
    assert np.sqrt(np.mean(rough.relief_of(inner) ** 2)) == pytest.approx(1e-3, rel=0.05)
    assert spiked.relief_of(np.array([1830]))[0] < 2e-3  # the spike scatters its neighbours' surroundings, not its own
    flat = Side(np.column_stack([x, y, np.full(len(x), 1e-4)]), up, None, np.arange(len(x)))
    samples = with_relief(make_samples(rough, inner), rough)
    pairs = match(samples, flat, np.eye(4), MatchLimits(0.02, 0.02, 1.0), True)
    assert np.abs(compare_relief(pairs, samples, flat).relief).max() < 1e-12


def test_what_patches_err_by_in_common_is_found_beside_unlike_noise(rng: np.random.Generator) -> None:
    noise2 = rng.choice([1e-10, 4e-8], 20_000)
    left = rng.normal(0, np.sqrt(noise2 + 1e-8))
    assert common_variance(left, noise2) == pytest.approx(1e-8, rel=0.1)
    assert common_variance(0.5 * rng.normal(0, np.sqrt(noise2)), noise2) == 0.0


def rough_pairs(rng: np.random.Generator) -> tuple[Matches, Bools]:
    """Return 20 000 pairs in runs of 25, every other run four times rougher, and which these are."""
    points, normals = bumpy_points(20_000, rng)
    side = Side(points, normals, None, np.arange(len(points)))
    pairs = match(make_samples(side, np.arange(20_000)), side, np.eye(4), MatchLimits(0.01, 0.0, 1.0), True)
    rough = np.arange(20_000) // 25 % 2 == 1
    noise = np.where(rough, 1e-3, 2.5e-4)
    return dataclasses.replace(pairs, residuals=rng.normal(0, noise), relief=noise), rough


def test_pairs_weigh_by_how_much_they_scatter(rng: np.random.Generator) -> None:
    pairs, rough = rough_pairs(rng)
    for fine in (False, True):
        _, sigma = weigh(pairs, np.ones(20_000, dtype=bool), fine)
        assert sigma[rough] == pytest.approx(1e-3, rel=0.15)  # alike they would have 0.5 mm
        assert sigma[~rough] == pytest.approx(2.5e-4, rel=0.15)


def test_samples_weigh_the_less_the_more_their_neighbourhoods_share(rng: np.random.Generator) -> None:
    points, normals = bumpy_points(4_000, rng)
    side = Side(points, normals, None, np.arange(len(points)))
    shared = np.where(is_rough(points), 9.0, 1.0)
    rules = AlignmentRules(0.01, 1.0, 30, 1e-6, 5)
    found = align(make_samples(side, np.arange(4_000)), side, np.eye(4), rules, fine=True, shared=shared)
    assert found.weights == pytest.approx(1.0 / shared[found.matches.source], rel=1e-9)  # a copy of itself fits exactly


def test_what_weighs_little_does_not_tell_how_the_rest_errs(rng: np.random.Generator) -> None:
    pairs, rough = rough_pairs(rng)
    number = np.arange(20_000) // 25
    sigma = np.where(rough, 1e-3, 2.5e-4)
    for factor, bears in ((1.0, False), (0.4, True)):  # a sixteenth of the weight of the others; a tenth of the mean
        of_all = standardize(pairs, np.where(rough, factor, 1.0) * sigma, np.zeros(3))
        assert np.array_equal(bearing_patches(of_all, number), np.arange(800) if bears else np.arange(0, 800, 2))


def test_patches_that_err_together_are_believed_less(rng: np.random.Generator) -> None:
    pairs, rough = rough_pairs(rng)
    number = np.arange(20_000) // 25
    common = rng.normal(0, 1.0, 800)[number] * np.where(rough, 8.0, 1.0) * 1e-4
    pairs = dataclasses.replace(pairs, residuals=pairs.residuals + common)
    patches = sum_patches(pairs, number, np.zeros(3))
    factor = share_noise(patches, np.zeros(6), np.ones(800, dtype=bool))[patches.member]
    # 1 + (0.1 / 0.05)^2 and 1 + (0.8 / 0.2)^2 of the means of 25; 400 patches tell a variance to 12 %
    assert np.median(factor[~rough]) == pytest.approx(5.0, rel=0.35)
    assert np.median(factor[rough]) == pytest.approx(17.0, rel=0.35)
