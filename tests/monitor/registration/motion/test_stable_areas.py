"""Stable areas found patch by patch: the majority's motion under change, and the words for motions left free."""

from dataclasses import replace

import numpy as np
import pytest
from bumpy_body import NOISE, bumpy_points, unit
from scipy.ndimage import gaussian_filter

from monitor.registration import register
from monitor.registration.motion.degeneracy import describe
from monitor.registration.motion.matching import Matches
from monitor.registration.motion.patches import cut_patches
from monitor.registration.motion.stable_areas import doubt_stable, find_stable, weighted_median
from monitor.registration.motion.trial_motions import least_median
from monitor.registration.motion.weights import huber_weights, residual_sigma
from monitor.robust import tukey_slope, tukey_weights
from projects.model import Bools, Floats, Ints, Surface


def make_pairs(rng: np.random.Generator, changed: float, motion: Floats) -> tuple[Matches, Ints, Bools]:
    """Return pairs whose residuals show `motion` left to do, patch numbers, and which pairs changed by 1 to 3 mm."""
    points, normals = bumpy_points(20_000, rng)
    numbers = cut_patches(points, normals, 25).numbers(points, normals)
    is_changed = unit(points) @ np.array([0.6, 0.64, 0.48]) > np.quantile(unit(points) @ [0.6, 0.64, 0.48], 1 - changed)
    way = motion[3:] + np.cross(motion[:3], points)
    residuals = rng.normal(0, NOISE, len(points)) - np.sum(way * normals, axis=1)
    residuals += np.where(is_changed, 0.002 + 0.001 * np.sin(30 * points[:, 0]), 0.0)
    zeros = np.zeros(len(points))
    return (
        Matches(
            np.arange(len(points)),
            points,
            residuals,
            normals,
            normals,
            normals,
            zeros,
            zeros,
            np.arange(len(points)),
            zeros,
            zeros,
            zeros,
            zeros,
        ),
        numbers,
        is_changed,
    )


@pytest.mark.parametrize("changed", [0.0, 0.2, 0.4, 0.45])
def test_the_majority_is_found_while_the_rest_changed_to_one_side(rng: np.random.Generator, changed: float) -> None:
    motion = np.array([1e-3, -5e-4, 8e-4, 3e-4, -2e-4, 1e-4])
    pairs, numbers, is_changed = make_pairs(rng, changed, motion)
    found, is_stable, _ = find_stable(pairs, numbers, np.zeros(3), np.random.default_rng(0))
    # 0.2 mm / sqrt(10 000 / 6) is 5 um; kept patches on the rim of the change may add as much again
    assert found[3:] == pytest.approx(motion[3:], abs=15e-6)
    assert found[:3] == pytest.approx(motion[:3], abs=15e-6 / 0.15)
    assert is_stable[~is_changed].mean() > 0.93
    assert not changed or is_stable[is_changed].mean() < 0.02


def test_what_scans_of_an_epoch_disagree_by_has_not_moved(rng: np.random.Generator) -> None:
    pairs, numbers, is_off = make_pairs(rng, 0.4, np.zeros(6))  # off by 1 to 3 mm, all to one side
    stated = Matches(**{**vars(pairs), "shared": np.full(len(pairs), 0.0015)})
    motion, is_stable, _ = find_stable(stated, numbers, np.zeros(3), np.random.default_rng(0))
    assert is_stable[is_off].mean() > 0.95  # without: less than 0.02, and the motion that of the other side
    assert np.linalg.norm(motion[3:]) > 1e-4


def test_what_lies_farther_off_itself_than_its_scans_state_is_doubted(rng: np.random.Generator) -> None:
    pairs, numbers, _ = make_pairs(rng, 0.0, np.zeros(6))
    pieces = 0.0015 * np.sign(np.sin(20 * pairs.points)).prod(axis=1)  # 16 cm wide, up and down by 1.5 mm
    off, none = Matches(**{**vars(pairs), "residuals": pairs.residuals + pieces}), np.zeros(len(pairs), bool)
    doubts = [
        doubt_stable(Matches(**{**vars(which), "shared": np.full(len(pairs), stated)}), numbers, none)
        for which, stated in ((off, 0.0003), (off, 0.0), (off, 0.001), (pairs, 0.0003), (pairs, 0.0))
    ]
    assert "times what their scans state" in doubts[0]
    assert "too coarse for its relief, or all of it moved, in pieces" in doubts[0]  # which of both is not known
    assert "times what the noise of their points explains: errors of the scans, or all of it moved" in doubts[1]
    assert doubts[2:] == ["", "", ""]  # twice what is stated; as stated; no more than noise


def test_a_patch_that_roughened_without_moving_is_not_stable(rng: np.random.Generator) -> None:
    pairs, numbers, _ = make_pairs(rng, 0.0, np.zeros(6))
    rough = pairs.points[:, 2] > 0.2
    residuals = pairs.residuals + np.where(rough, rng.normal(0, 10 * NOISE, len(rough)), 0.0)
    _, is_stable, _ = find_stable(Matches(**{**vars(pairs), "residuals": residuals}), numbers, np.zeros(3), rng)
    assert is_stable[rough].mean() < 0.05
    assert is_stable[~rough].mean() > 0.93


def test_patches_hold_the_asked_number_and_part_the_sides_of_a_slab(rng: np.random.Generator) -> None:
    points = np.column_stack([rng.uniform(0, 1, (5_000, 2)), np.repeat([0.0, 0.002], 2_500)])
    normals = np.tile([0.0, 0.0, 1.0], (5_000, 1)) * np.repeat([-1.0, 1.0], 2_500)[:, None]
    numbers = cut_patches(points, normals, 25).numbers(points, normals)
    assert 5_000 / len(np.unique(numbers)) == pytest.approx(25, rel=0.25)
    assert not set(numbers[:2_500]) & set(numbers[2_500:])


def test_weighted_median_counts_weights() -> None:
    assert weighted_median(np.array([3.0, 1.0, 2.0]), np.array([1.0, 1.0, 5.0])) == 2.0
    assert weighted_median(np.array([3.0, 1.0, 2.0]), np.array([9.0, 1.0, 5.0])) == 3.0


def test_the_least_median_is_that_of_the_first_row_whose_median_is_least(rng: np.random.Generator) -> None:
    weights = rng.integers(1, 30, 25).astype(float)
    for _ in range(200):
        values = rng.integers(0, 12, (40, 25)).astype(float)  # many equal ones
        assert least_median(values, weights) == np.argmin([weighted_median(row, weights) for row in values])


def test_weights_of_huber_and_tukey_have_their_known_values() -> None:
    assert huber_weights(np.array([0.0, 1.345, 2.69])) == pytest.approx([1.0, 1.0, 0.5])
    assert tukey_weights(np.array([0.0, 4.685 / 2, 4.685, 9.0])) == pytest.approx([1.0, 0.5625, 0.0, 0.0])
    u = np.linspace(-6.0, 6.0, 41)
    psi = [(v) * tukey_weights(v) for v in (u + 1e-6, u - 1e-6)]
    assert tukey_slope(u) == pytest.approx((psi[0] - psi[1]) / 2e-6, abs=1e-5)


@pytest.mark.parametrize("unit", [1.0, 50.0])
def test_sigma_rises_with_what_makes_residuals_scatter_by_as_much_as_they_show(
    rng: np.random.Generator, unit: float
) -> None:
    cause = unit * rng.uniform(1e-4, 4e-4, 40_000)  # in any unit: only its order counts
    sigma = np.hypot(cause / unit, 2e-4)
    found = residual_sigma(rng.normal(0, sigma), (cause,), np.ones(40_000, dtype=bool))
    inner = (cause > unit * 1.1e-4) & (cause < unit * 3.9e-4)
    assert found[inner] == pytest.approx(
        sigma[inner], rel=0.15
    )  # a class of 500 tells its scale to 4 %; of 0.22 to 0.45


def test_what_does_not_matter_to_residuals_changes_no_weight(rng: np.random.Generator) -> None:
    causes = tuple(rng.lognormal(0.0, 1.0, (3, 40_000)))
    sigma = residual_sigma(rng.normal(0, 1e-3, 40_000), causes, np.ones(40_000, dtype=bool))
    assert np.std(sigma) < 0.05 * 1e-3  # classes of 500 tell a scale to 4 %


def test_causes_multiply_and_those_not_kept_tell_nothing(rng: np.random.Generator) -> None:
    rough, steep = rng.integers(0, 2, (2, 40_000)).astype(float)
    truth = 1e-3 * np.where(rough > 0, 3.0, 1.0) * np.where(steep > 0, 2.0, 1.0)
    kept = rng.random(40_000) < 0.7
    residuals = np.where(kept, rng.normal(0, truth), 0.1 * rough)  # what changed lies off, and where it is rough
    sigma = residual_sigma(residuals, (rough, steep), kept)
    assert sigma == pytest.approx(truth, rel=0.1)


def test_free_motions_are_told_in_words() -> None:
    assert describe(np.array([0, 0, 2.0, 0, 0, 0.1]), 0.5).startswith("turn about the axis (0.00, 0.00, 1.00)")
    assert describe(np.array([0, 0, 0.1, 0.3, 0, 0]), 0.5).startswith("slide along (1.00, 0.00, 0.00)")


def relief(noise: Floats, moved: Floats) -> Surface:
    """Return a relief 15 cm wide of n x n vertices with `noise` (n, n) m, its sixteen tiles `moved` (16,) m up."""
    n = len(noise)
    x, y = np.meshgrid(0.15 / n * np.arange(n), 0.15 / n * np.arange(n), indexing="ij")
    tile = (x // 0.0376).astype(int) * 4 + (y // 0.0376).astype(int)
    z = 0.01 * np.sin(60.0 * x) * np.cos(45.0 * y) + 0.005 * np.sin(90.0 * y + 30.0 * x) + noise + moved[tile]
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return Surface(np.column_stack([x.ravel(), y.ravel(), z.ravel()]), faces)


def relief_with_shared_noise(rng: np.random.Generator, moved: float = 0.0) -> Surface:
    """Return a relief with vertices 1 mm apart, 0.1 mm of noise that neighbours over 5 mm have in common, stated.

    Its tiles are `moved` (m) up or down each by itself.
    """
    noise = gaussian_filter(rng.normal(size=(150, 150)), 5.0)
    made = relief(1e-4 * noise / noise.std(), moved * rng.normal(size=16))
    return replace(made, sigma=np.full(len(made.vertices), 1e-4))


def test_noise_that_neighbours_share_is_no_doubt_about_the_motion_where_it_is_stated(rng: np.random.Generator) -> None:
    """As if each vertex erred by itself, an unchanged pair was doubted: eight times what the noise explains."""
    before = relief_with_shared_noise(rng)
    assert register(relief_with_shared_noise(rng), before).doubt == ""
    moved = register(relief_with_shared_noise(rng, 0.001), before)
    assert not moved.converged or "or all of it moved, in pieces" in moved.doubt


@pytest.mark.parametrize("n", [40, 75])
def test_the_corners_of_a_coarse_mesh_are_no_doubt_about_the_motion(rng: np.random.Generator, n: int) -> None:
    """Of a finished mesh nothing is stated. Forty points on a face err by what three corners do: it was doubted."""
    before, after = (relief(1e-4 * rng.normal(size=(n, n)), np.zeros(16)) for _ in range(2))
    assert register(after, before).doubt == ""
    moved = register(relief(1e-4 * rng.normal(size=(n, n)), 0.001 * rng.normal(size=16)), before)
    assert not moved.converged or "or all of it moved, in pieces" in moved.doubt
