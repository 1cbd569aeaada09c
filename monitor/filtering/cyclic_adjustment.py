"""The adjustment of cyclic range errors: waves, planes and bows of all patches at once (Nothegger & Dorninger 2007).

In: plane patches of a scan; out: the coefficients of sin and cos of each wave, with the normal equations behind them
and what every patch says by itself. Points count by Tukey's biweight, patches by how plane they are and how well they
agree with the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor.filtering.patches import MIN_PATCH, PlanePatches
from monitor.robust import nmad, tukey_weights
from projects.model import Floats, Ints

N_ITERATIONS = 12
CONVERGED = 1e-7  # m
CELL_POINTS = (150, 50, 15)
LEAST_SHARE = 0.25  # of what cells vary by that the shape must leave: of fewer than eight it leaves next to nothing
N_SHAPE = 6  # terms of a patch's own shape: a plane and a bow
LONGEST, SHORTEST = 2.5, 0.3  # m, between which an unknown longest wavelength is looked for
N_FINE = 10  # parts of a step of that search
N_REFINED, SETTLED = 10, 0.01  # adjustments at most with the wavelength in them; sigmas of it that end them


@dataclass(frozen=True)
class Patch:
    """One patch of m points, ready for the adjustment.

    `ranges` (m,) [m] as measured; `slopes` (m,), n'u of the plane's normal n and the beams u: by how much a point
    leaves the plane where its range is longer; `heights` (m,) [m] over the plane; `shape` (m, 6), the columns of a
    bowed patch, which is its own; `cells`, the cell (m,) of each point for squares of several sizes; `wall`, the number
    of the plane that it is part of.
    """

    ranges: Floats
    slopes: Floats
    heights: Floats
    shape: Floats
    cells: tuple[Ints, ...]
    wall: int


@dataclass(frozen=True)
class Vote:
    """What a patch says of the coefficients: their normal equations, free of its own shape."""

    normal: Floats  # (c, c)
    right: Floats  # (c,)


@dataclass(frozen=True)
class Adjustment:
    """The `coefficients` (2 k,) [m], sines then cosines, of k waves of the `wavelengths` (k,) [m], and the matrix
    `normal` (2 k, 2 k) behind them; of each patch its vote, its share of all and its `residuals` (m,) [m]."""

    wavelengths: Floats
    coefficients: Floats
    normal: Floats
    votes: list[Vote]
    shares: Floats
    residuals: list[Floats]


def waves_at(ranges: Floats, wavelengths: Floats) -> Floats:
    """Return sin and then cos of every wave at ranges (m,), (m, 2 k); the k-th wavelength is the longest over k."""
    turn = np.exp((2j * math.pi / wavelengths[0]) * ranges)
    powers = np.cumprod(np.broadcast_to(turn[:, None], (len(ranges), len(wavelengths))), axis=1)
    return np.concatenate([powers.imag, powers.real], axis=1)


def true_ranges(measured: Floats, coefficients: Floats, wavelengths: Floats) -> Floats:
    """Return r of measured = r + e(r), by fixed-point iteration (the slope of e is a few hundredths)."""
    true = measured
    for _ in range(3):
        true = measured - waves_at(true, wavelengths) @ coefficients
    return true


def prepare_patches(found: PlanePatches) -> list[Patch]:
    """Return each patch in coordinates of its own plane."""
    patches = []
    for number, wall in enumerate(found.wall):
        points = found.points[found.patch == number]
        centre = np.median(points, axis=0)
        _, axes = np.linalg.eigh(np.cov((points - centre).T))
        local = (points - centre) @ axes
        ranges = np.linalg.norm(points, axis=1)
        u, v = local[:, 1] / np.abs(local[:, 1]).max(), local[:, 2] / np.abs(local[:, 2]).max()
        shape = np.column_stack([np.ones(len(u)), u, v, u * u, u * v, v * v])
        cells = tuple(_cells(local, n) for n in CELL_POINTS)
        patches.append(Patch(ranges, points @ axes[:, 0] / ranges, local[:, 0], shape, cells, int(wall)))
    return patches


def _cells(local: Floats, n_points: int) -> Ints:
    """Return the cell (m,) of each point of a patch: squares of its plane that hold `n_points` on average."""
    extent = np.ptp(local[:, 1:], axis=0)
    side = math.sqrt(max(extent[0] * extent[1], 1e-12) * n_points / len(local))
    square = np.floor((local[:, 1:] - local[:, 1:].min(axis=0)) / side).astype(np.int64)
    return np.unique(square[:, 0] * (square[:, 1].max() + 1) + square[:, 1], return_inverse=True)[1]


def _vote(
    patch: Patch, wavelengths: Floats, coefficients: Floats, weights: Floats, *, is_length_free: bool = False
) -> Vote:
    """Return what a patch says of the coefficients, its points weighted by (m,), free of its own shape.

    Where the length is free, of the change [1/m] of one over the longest wavelength too, which comes last.
    """
    root, ranges = np.sqrt(weights), true_ranges(patch.ranges, coefficients, wavelengths)
    shape = np.linalg.qr(root[:, None] * patch.shape)[0]
    waves = waves_at(ranges, wavelengths)
    if is_length_free:
        waves = np.column_stack([waves, _slope_of_length(ranges, waves, coefficients)])
    both = root[:, None] * np.column_stack([patch.slopes[:, None] * waves, patch.heights])
    both -= shape @ (shape.T @ both)
    waves, heights = both[:, :-1], both[:, -1]
    left = root * (heights - waves[:, : len(coefficients)] @ coefficients)
    variance = _cell_effect(patch, left, root, shape) * _variance(left, root) + 1e-18
    return Vote(waves.T @ waves / variance, waves.T @ heights / variance)


def _slope_of_length(ranges: Floats, waves: Floats, coefficients: Floats) -> Floats:
    """Return the derivative (m,) [m2] of the error at ranges (m,) by one over the longest wavelength."""
    sines, cosines = np.split(waves, 2, axis=1)
    of_sines, of_cosines = np.split(coefficients, 2)
    number = np.arange(1, len(of_sines) + 1)
    return np.asarray(2.0 * math.pi * ranges * (cosines @ (number * of_sines) - sines @ (number * of_cosines)))


def _variance(left: Floats, root: Floats) -> float:
    """Return the variance [m2] of a point of full weight by which the normal equations tell the estimate's covariance.

    That of Tukey's estimate is the mean square of psi = w r, here `left` (m,), over the square of its mean slope,
    5 w - 4 sqrt(w) under root weights `root` (m,) (Huber 1981, section 7.6). The mean of w r^2 is 14 % less.
    """
    weights = root**2
    slope = max(float((5.0 * weights - 4.0 * root).sum()), 1.0)
    freedom = max(len(left) - N_SHAPE, 1) / len(left)
    return float(left @ left) * float(weights.sum()) / slope**2 / freedom


def _cell_effect(patch: Patch, left: Floats, root: Floats, shape: Floats) -> float:
    """Return by how much the sums over cells of residuals (m,) vary more than those of independent ones, at least 1.

    What the points of a cell share is the shape of the wall: counted as noise, it takes from what the patch says. The
    largest over the sizes of cells, of which one is near the length of the wall's unevenness. A shape of six terms,
    `shape` (m, 6) under root weights `root` (m,), follows a few cells and leaves only a share of what they vary by.
    """
    total, effect = max(float(left @ left), 1e-300), 1.0
    for cells in patch.cells:
        followed = sum(float((np.bincount(cells, weights=root * term) ** 2).sum()) for term in shape.T)
        share = 1.0 - followed / float(root @ root)
        if share >= LEAST_SHARE:
            effect = max(effect, float((np.bincount(cells, weights=left) ** 2).sum()) / total / share)
    return effect


def residuals_of(patch: Patch, wavelengths: Floats, coefficients: Floats, weights: Floats) -> Floats:
    """Return the distances (m,) [m] of the points to their plane, bow included, once the waves are taken off."""
    waves = waves_at(true_ranges(patch.ranges, coefficients, wavelengths), wavelengths)
    heights = patch.heights - patch.slopes * (waves @ coefficients)
    weighted = weights[:, None] * patch.shape
    return heights - patch.shape @ np.linalg.solve(weighted.T @ patch.shape, weighted.T @ heights)


def _biweights(residuals: Floats) -> Floats:
    """Return Tukey's weights (m,) of residuals."""
    return tukey_weights(residuals / (nmad(residuals) + 1e-9))


def adjust_waves(patches: list[Patch], wavelengths: Floats) -> Adjustment:
    """Adjust the waves and the shapes of all patches together."""
    coefficients: Floats = np.zeros(2 * len(wavelengths))
    weights: list[Floats] = [np.ones(len(p.ranges)) for p in patches]
    shares: Floats = np.ones(len(patches))
    for _ in range(N_ITERATIONS):
        votes = [_vote(p, wavelengths, coefficients, w) for p, w in zip(patches, weights, strict=True)]
        normal, new = combine_votes(votes, shares)
        step, coefficients = float(np.abs(new - coefficients).max()), new
        residuals = [residuals_of(p, wavelengths, new, w) for p, w in zip(patches, weights, strict=True)]
        weights, shares = [_biweights(r) for r in residuals], _weigh_patches(votes, new)
        if step < CONVERGED:
            break
    return Adjustment(wavelengths, coefficients, normal, votes, shares, residuals)


def refine_length(patches: list[Patch], wavelengths: Floats, farthest: float) -> tuple[Adjustment, Floats]:
    """Adjust the waves and their length, one over which moves by less than `farthest` [1/m], from wavelengths (k,).

    Returns
    -------
    The adjustment, and the covariance (2 k, 2 k) [m2] of its coefficients, in which that of the length is. Phases count
    from the scanner, and the patches lie some waves away: a length that is a little wrong turns them by many sigmas of
    what they would have were it known.
    """
    start, best = 1.0 / wavelengths[0], adjust_waves(patches, wavelengths)
    number = np.arange(1, len(wavelengths) + 1)
    for _ in range(N_REFINED):
        step, sigma, covariance = _step_of_length(patches, best)
        turn = 1.0 / best.wavelengths[0] + step
        if not sigma < math.inf or abs(turn - start) > farthest:
            break
        best = adjust_waves(patches, 1.0 / (turn * number))
        if abs(step) < SETTLED * sigma:
            break
    return best, covariance


def _step_of_length(patches: list[Patch], adjusted: Adjustment) -> tuple[float, float, Floats]:
    """Return by how much [1/m] one over the length should move, its sigma, and the covariance of the coefficients.

    Where nothing varies with it, its sigma is infinite and the covariance that of waves whose length is known.
    """
    weights = [_biweights(r) for r in adjusted.residuals]
    about = adjusted.wavelengths, adjusted.coefficients
    votes = [_vote(p, *about, w, is_length_free=True) for p, w in zip(patches, weights, strict=True)]
    normal, solution = combine_votes(votes, adjusted.shares)
    scale = np.sqrt(np.diag(normal))
    if not scale[-1] > 0.0:
        return 0.0, math.inf, np.linalg.inv(adjusted.normal)
    covariance = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    return float(solution[-1]), math.sqrt(covariance[-1, -1]), covariance[:-1, :-1]


def combine_votes(votes: Sequence[Vote], shares: Floats) -> tuple[Floats, Floats]:
    """Return the normal equations of the votes under their shares (p,), and the coefficients that solve them."""
    normal = np.tensordot(shares, np.array([v.normal for v in votes]), 1)
    right = np.tensordot(shares, np.array([v.right for v in votes]), 1)
    return normal, np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(len(normal)), right)


def _weigh_patches(votes: list[Vote], coefficients: Floats) -> Floats:
    """Return the weight (p,) of each patch: less than 1 where it contradicts the others more than the usual patch does.

    The score g = b - N c of a patch that agrees has the covariance N, so that g' N^-1 g is chi-square.
    """
    misfit = []
    for vote in votes:
        score = vote.right - vote.normal @ coefficients
        misfit.append(float(score @ np.linalg.lstsq(vote.normal, score, rcond=1e-9)[0]) / len(score))
    ratio = np.sqrt(np.array(misfit) / max(float(np.median(misfit)), 1.0))
    return np.minimum(1.0, 1.5 / np.maximum(ratio, 1e-12)) ** 2


def search_wavelength(patches: list[Patch], n_harmonics: int) -> tuple[float, int, float]:
    """Return the longest wavelength that fits best, the number of those tried and their step [1/m].

    Of equal ones the shortest.
    """
    spans = [float(np.ptp(p.ranges)) for p in patches]
    step = 1.0 / (4.0 * n_harmonics * max(spans))
    tried = 1.0 / np.arange(1.0 / SHORTEST, 1.0 / min(LONGEST, max(spans)) - step, -step)
    few = [_thin_patch(p) for p in patches]
    gains = np.array([_gain(few, w / np.arange(1, n_harmonics + 1)) for w in tried])
    best = int(np.flatnonzero(gains >= 0.98 * gains.max())[0])
    around = 1.0 / (1.0 / tried[best] + step * np.linspace(-1.0, 1.0, 2 * N_FINE + 1))
    fine = [_gain(few, w / np.arange(1, n_harmonics + 1)) for w in around]
    return float(around[int(np.argmax(fine))]), len(tried), step


def _thin_patch(patch: Patch) -> Patch:
    """Return the patch with `MIN_PATCH` to twice as many of its points."""
    some = slice(None, None, max(1, len(patch.ranges) // MIN_PATCH))
    cells = tuple(np.unique(c[some], return_inverse=True)[1] for c in patch.cells)
    parts = (patch.ranges[some], patch.slopes[some], patch.heights[some], patch.shape[some])
    return Patch(*parts, cells, patch.wall)


def _gain(patches: list[Patch], wavelengths: Floats) -> float:
    """Return the chi-square by which waves of these lengths improve the patches."""
    start = np.zeros(2 * len(wavelengths))
    normal, c = combine_votes(
        [_vote(p, wavelengths, start, np.ones(len(p.ranges))) for p in patches], np.ones(len(patches))
    )
    return float(c @ normal @ c)


def median_deviation(residuals: Floats) -> float:
    """Return the median absolute deviation."""
    return float(np.median(np.abs(residuals - np.median(residuals))))
