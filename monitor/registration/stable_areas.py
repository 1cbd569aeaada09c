"""Stable areas: the patches of the source that moved with the majority, under their own uncertainty.

In: pairs and their residuals at a pose near the solution. Out: the motion of the majority and which patches follow
it. The start is a least median over many small sets of patches, so that nearly half of the surface may have changed,
even all to one side; then patches are kept or dropped and the motion estimated again until nothing changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monitor.registration.matching import Matches
from monitor.registration.sampling import motion_rows
from monitor.registration.weights import robust_scale
from projects.model import Bools, Floats, Ints

N_TRIALS = 600
N_PATCHES_PER_TRIAL = 8  # 0.6**8 = 1.7 %: ten of 600 trials are free of change where 40 % of the surface changed
KEEP_SIGMAS = 3.0
KEEP_SCATTER = 2.5  # a patch that scatters so many times more than the others has changed without moving as a whole
N_ROUNDS = 20
DOUBTFUL = 3.0  # times what is stated of patches: so far off each other, what is taken for stable moved
MEAN_OF_ABSOLUTE = float(np.sqrt(2.0 / np.pi))


@dataclass(frozen=True)
class Patches:
    """Sums over the pairs of each patch: count, mean residual [m], mean row, normal equations, and the variance
    `shared2` [m2] that the two surfaces state for whole neighbourhoods there."""

    count: Floats
    mean: Floats
    row: Floats
    information: Floats
    right: Floats
    member: Ints
    shared2: Floats


def sum_patches(matches: Matches, numbers: Ints, centre: Floats) -> Patches:
    """Return the sums of each patch; `numbers` (n pairs) are patch numbers."""
    _, member = np.unique(numbers, return_inverse=True)
    n = int(member.max()) + 1
    rows = motion_rows(matches.points, matches.normals, centre)
    count = np.bincount(member, minlength=n).astype(float)

    def total(values: Floats) -> Floats:
        return np.stack([np.bincount(member, column, n) for column in values.T], axis=1)

    products = (rows[:, :, None] * rows[:, None, :]).reshape(-1, 36)
    return Patches(
        count=count,
        mean=np.bincount(member, matches.residuals, n) / count,
        row=total(rows) / count[:, None],
        information=total(products).reshape(-1, 6, 6),
        right=-total(rows * matches.residuals[:, None]),
        member=member,
        shared2=np.bincount(member, matches.shared**2, n) / count,
    )


def find_stable(matches: Matches, numbers: Ints, centre: Floats, rng: np.random.Generator) -> tuple[Floats, Bools]:
    """Return the motion (6,) of the majority about `centre` and, for each pair, whether its patch follows it."""
    patches = sum_patches(matches, numbers, centre)
    motion = start_motion(patches, rng)
    keep = np.zeros(len(patches.count), dtype=bool)
    for _ in range(N_ROUNDS):
        previous, keep = keep, follows(patches, matches, motion, keep, centre)
        if np.array_equal(previous, keep):
            break
        motion = solve_patches(patches, keep)
    return motion, keep[patches.member]


def solve_patches(patches: Patches, keep: Bools) -> Floats:
    """Return the motion (6,) that the kept patches ask for."""
    information, right = patches.information[keep].sum(axis=0), patches.right[keep].sum(axis=0)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    return scale * (np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-8, hermitian=True) @ (scale * right))


def start_motion(patches: Patches, rng: np.random.Generator) -> Floats:
    """Return the motion, of many from few patches each and of none, that leaves the least median residual."""
    n = len(patches.count)
    size = min(N_PATCHES_PER_TRIAL, n)
    probability = patches.count / patches.count.sum()
    picks = rng.choice(n, size=(N_TRIALS, size), p=probability)
    information = patches.information[picks].sum(axis=1)
    right = patches.right[picks].sum(axis=1)
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("nii->ni", information), 1e-300))
    inverse = np.linalg.pinv(information * scale[:, :, None] * scale[:, None, :], rcond=1e-6, hermitian=True)
    trials = scale * np.einsum("nij,nj->ni", inverse, scale * right)
    trials = np.vstack([np.zeros(6), trials])
    left = np.abs(patches.mean + trials @ patches.row.T)
    return trials[np.argmin([weighted_median(row, patches.count) for row in left])]


def weighted_median(values: Floats, weights: Floats) -> float:
    """Return the value at half of the weights."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def follows(patches: Patches, matches: Matches, motion: Floats, keep: Bools, centre: Floats) -> Bools:
    """Return which patches' mean residual and scatter are explained by noise once `motion` is applied.

    A patch that is off by no more than what its epochs' scans disagree by has not been seen to move; without it the
    motion would be that of one side, and the other side twice as far off.
    """
    left = patches.mean + patches.row @ motion
    residuals = matches.residuals + motion_rows(matches.points, matches.normals, centre) @ motion
    among = keep if keep.any() else np.abs(left) <= weighted_median(np.abs(left), patches.count)
    sigma = robust_scale(residuals[among[patches.member]])
    noise2 = sigma**2 / patches.count
    # what patches scatter beyond the noise of their points: correlated errors of the surface, common to a patch
    spread2 = robust_scale(left[among]) ** 2
    common2 = max(spread2 - float(np.median(noise2[among])), 0.0)
    scatter = np.bincount(patches.member, np.abs(residuals)) / patches.count
    usual = max(float(np.median(scatter[among])), 1e-300)
    quiet = scatter < KEEP_SCATTER * np.hypot(usual, MEAN_OF_ABSOLUTE * np.sqrt(patches.shared2))
    return (np.abs(left) <= KEEP_SIGMAS * np.sqrt(noise2 + np.maximum(common2, patches.shared2)) + 1e-12) & quiet


def doubt_stable(stable: Matches, numbers: Ints) -> str:
    """Return in words that patches held to be stable scatter by far more than is stated of them, else "".

    Where every piece of an object moved, the motion in their midst is nobody's, and the patches about it pass for badly
    measured ones. That can be told only where the surfaces state what whole neighbourhoods are off by.
    """
    patches = sum_patches(stable, numbers, np.zeros(3))
    stated2 = robust_scale(stable.residuals - patches.mean[patches.member]) ** 2 / patches.count + patches.shared2
    if not np.any(patches.shared2 > 0.0):
        return ""
    scatter, stated = robust_scale(patches.mean), float(np.sqrt(np.median(stated2)))
    if scatter <= DOUBTFUL * stated:
        return ""
    return (
        f"the stable areas lie {1e3 * scatter:.1f} mm off each other, {scatter / stated:.0f} times what their scans "
        "state: perhaps all of it moved, in pieces"
    )
