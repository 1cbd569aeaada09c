"""Motions to begin the search for stable areas with: each of a few patches, so that some are free of change.

In: sums over patches. Out: the motion that leaves the least median residual, and some that leave least in a third of
the patches, made sharp: what eight patches tell is too blurred to part those that changed by a few sigmas from others.
"""

from __future__ import annotations

import numpy as np

from monitor.registration.motion.patch_sums import Patches, solve_patches
from monitor.registration.motion.weights import weighted_median
from projects.model import Floats

N_TRIALS = 600
N_PATCHES_PER_TRIAL = 8  # 0.6**8 = 1.7 %: ten of 600 trials are free of change where 40 % of the surface changed
PART = 0.35  # of the patches: less than half, so that half of them may have changed
N_SHARPENED, N_CONCENTRATIONS = 20, 10
N_KEPT, DIGITS = 4, 6  # of sharp motions, those that leave the same to 1 um being one


def try_motions(patches: Patches, rng: np.random.Generator) -> Floats:
    """Return motions (k, 6), with a layer (k, 7): none, and many from few patches each."""
    n = len(patches.count)
    size = min(N_PATCHES_PER_TRIAL, n)
    probability = patches.count / patches.count.sum()
    picks = rng.choice(n, size=(N_TRIALS, size), p=probability)
    information = patches.information[picks].sum(axis=1)
    right = patches.right[picks].sum(axis=1)
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("nii->ni", information), 1e-300))
    inverse = np.linalg.pinv(information * scale[:, :, None] * scale[:, None, :], rcond=1e-6, hermitian=True)
    trials = scale * np.einsum("nij,nj->ni", inverse, scale * right)
    return np.vstack([np.zeros(trials.shape[1]), trials])


def leaves_least_median(patches: Patches, trials: Floats) -> Floats:
    """Return the one of the trials (k, 6) that leaves the least median residual."""
    left = np.abs(patches.mean + trials @ patches.row.T)
    return np.asarray(trials[least_median(left, patches.count)])


def fit_least_part(patches: Patches, trials: Floats) -> Floats:
    """Return motions (k, 6) that leave least in `PART` of the patches, of the best trials (n, 6) made sharp, each once.

    References
    ----------
    Rousseeuw and Van Driessen (2006), Computing LTS regression for large data sets: concentration steps.
    """
    rank = int(PART * len(patches.count))
    best = trials[np.argsort(_left_in_part(patches, trials, rank), kind="stable")[:N_SHARPENED]]
    sharp = np.array([_concentrate(patches, motion, rank) for motion in best])
    left = _left_in_part(patches, sharp, rank)
    rising = np.argsort(left, kind="stable")
    _, first = np.unique(left[rising].round(DIGITS), return_index=True)
    return np.asarray(sharp[rising[first]][:N_KEPT])


def _left_in_part(patches: Patches, motions: Floats, rank: int) -> Floats:
    """Return within what size (k,) [m] each of the motions (k, 6) leaves so many patches."""
    left = np.abs(patches.mean + motions @ patches.row.T)
    return np.asarray(np.partition(left, rank, axis=1)[:, rank])


def _concentrate(patches: Patches, motion: Floats, rank: int) -> Floats:
    """Return the motion (6,) that the patches which it fits best ask for, again and again."""
    for _ in range(N_CONCENTRATIONS):
        left = np.abs(patches.left_by(motion))
        motion = solve_patches(patches, left <= np.partition(left, rank)[rank])
    return motion


def least_median(values: Floats, weights: Floats) -> int:
    """Return the number of the row (m, n) whose value at half of the weights is least, the first of equal ones."""
    best, least, half = 0, weighted_median(values[0], weights), 0.5 * weights.sum()
    for number in range(1, len(values)):  # sorted only where half of the weights lie below the least so far
        if weights @ (values[number] < least) >= half:
            best, least = number, weighted_median(values[number], weights)
    return best
