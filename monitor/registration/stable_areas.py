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
from monitor.registration.weights import residual_sigma, robust_scale, rounding_of, weighted_median
from projects.model import Bools, Floats, Ints

N_TRIALS = 600
N_PATCHES_PER_TRIAL = 8  # 0.6**8 = 1.7 %: ten of 600 trials are free of change where 40 % of the surface changed
KEEP_SIGMAS = 3.0
KEEP_SCATTER = 2.5  # a patch that scatters so many times more than the others has changed without moving as a whole
N_ROUNDS = 20
N_HALVINGS = 20
MEAN_OF_ABSOLUTE = float(np.sqrt(2.0 / np.pi))
LEAST_SCATTER = 0.5 * MEAN_OF_ABSOLUTE  # usual of patches; they have less only where nothing but rounding is left
DOUBTFUL = 3.0  # times what is stated of patches: so far off each other, what is taken for stable moved


@dataclass(frozen=True)
class Patches:
    """Sums over the pairs of each patch: count, mean residual [m], mean row, normal equations, the variance `shared2`
    [m2] that the two surfaces state for whole neighbourhoods there, that of the mean by the noise of points, `noise2`
    [m2], and the mean absolute deviation from the mean over what such points have elsewhere, `scatter`."""

    count: Floats
    mean: Floats
    row: Floats
    information: Floats
    right: Floats
    member: Ints
    shared2: Floats
    noise2: Floats
    scatter: Floats


def sum_patches(matches: Matches, numbers: Ints, centre: Floats) -> Patches:
    """Return the sums of each patch; `numbers` (n pairs) are patch numbers."""
    _, member = np.unique(numbers, return_inverse=True)
    n = int(member.max()) + 1
    rows = motion_rows(matches.points, matches.normals, centre)
    count = np.bincount(member, minlength=n).astype(float)

    def total(values: Floats) -> Floats:
        return np.stack([np.bincount(member, column, n) for column in values.T], axis=1)

    mean = np.bincount(member, matches.residuals, n) / count
    # by deviations within patches alone, in which no motion of a patch is
    deviation = (matches.residuals - mean[member]) * np.sqrt(count / np.maximum(count - 1.0, 1.0))[member]
    sigma = residual_sigma(deviation, matches.causes, count[member] > 1, rounding_of(matches.points))
    weighted = rows / sigma[:, None] ** 2
    one, other = np.triu_indices(6)
    information = np.empty((n, 6, 6))
    information[:, one, other] = information[:, other, one] = total(weighted[:, one] * rows[:, other])
    return Patches(
        count=count,
        mean=mean,
        row=total(rows) / count[:, None],
        information=information,
        right=-total(weighted * matches.residuals[:, None]),
        member=member,
        shared2=np.bincount(member, matches.shared**2, n) / count,
        noise2=np.bincount(member, sigma**2, n) / count**2,
        scatter=np.bincount(member, np.abs(deviation) / sigma, n) / count,
    )


def find_stable(
    matches: Matches, numbers: Ints, centre: Floats, rng: np.random.Generator
) -> tuple[Floats, Bools, Floats]:
    """Return the motion (6,) of the majority about `centre` and, for each pair, whether its patch follows it and by
    what factor its patch's variance exceeds that of independent noise (`share_noise`)."""
    patches = sum_patches(matches, numbers, centre)
    motion = start_motion(patches, rng)
    keep = np.zeros(len(patches.count), dtype=bool)
    for _ in range(N_ROUNDS):
        previous, keep = keep, follows(patches, motion, keep)
        if np.array_equal(previous, keep):
            break
        motion = solve_patches(patches, keep)
    return motion, keep[patches.member], share_noise(patches, motion, keep)[patches.member]


def share_noise(patches: Patches, motion: Floats, keep: Bools) -> Floats:
    """Return by what factor, 1 or more, the variance of each patch's mean exceeds that of independent noise of points.

    Points of a patch err together, by more where it is rough or seen steeply: the kept patches tell how the factor
    rises with the noise of points. A weight by the noise of points alone would overrate smooth and rough places alike,
    but rough ones more.
    """
    if not keep.any():
        return np.ones(len(keep))
    ratio = (patches.mean + patches.row @ motion) / np.sqrt(patches.noise2)
    return np.maximum(residual_sigma(ratio, (patches.noise2 * patches.count,), keep), 1.0) ** 2


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
    return trials[least_median(left, patches.count)]


def least_median(values: Floats, weights: Floats) -> int:
    """Return the number of the row (m, n) whose value at half of the weights is least, the first of equal ones."""
    best, least, half = 0, weighted_median(values[0], weights), 0.5 * weights.sum()
    for number in range(1, len(values)):  # sorted only where half of the weights lie below the least so far
        if weights @ (values[number] < least) >= half:
            best, least = number, weighted_median(values[number], weights)
    return best


def follows(patches: Patches, motion: Floats, keep: Bools) -> Bools:
    """Return which patches' mean residual and scatter are explained by noise once `motion` is applied.

    A patch that is off by no more than what its epochs' scans disagree by has not been seen to move; without it the
    motion would be that of one side, and the other side twice as far off.
    """
    left = patches.mean + patches.row @ motion
    among = keep if keep.any() else np.abs(left) <= weighted_median(np.abs(left), patches.count)
    # what patches scatter beyond the noise of their points: correlated errors of the surface, common to a patch
    common2 = common_variance(left[among], patches.noise2[among])
    usual = max(float(np.median(patches.scatter[among])), LEAST_SCATTER)
    stated = MEAN_OF_ABSOLUTE * np.sqrt(patches.shared2 / (patches.noise2 * patches.count))
    quiet = patches.scatter < KEEP_SCATTER * np.hypot(usual, stated)
    sigma = np.sqrt(patches.noise2 + np.maximum(common2, patches.shared2))
    return (np.abs(left) <= KEEP_SIGMAS * sigma + 1e-12) & quiet


def common_variance(left: Floats, noise2: Floats) -> float:
    """Return the variance [m2] beyond `noise2` (k,) under which what is `left` (k,) [m] has a robust scale of one."""
    low, high = 0.0, robust_scale(left) ** 2
    if robust_scale(left / np.sqrt(noise2)) <= 1.0:
        return 0.0
    for _ in range(N_HALVINGS):
        middle = 0.5 * (low + high)
        is_less = robust_scale(left / np.sqrt(noise2 + middle)) > 1.0
        low, high = (middle, high) if is_less else (low, middle)
    return 0.5 * (low + high)


def doubt_stable(stable: Matches, numbers: Ints, on_faces: Bools) -> str:
    """Return in words that patches held to be stable scatter by far more than is stated of them, else "".

    `on_faces` (n pairs) are those with a point that was put onto a large face of a mesh.

    Where every piece of an object moved, the motion in their midst is nobody's, and the patches about it pass for badly
    measured ones. Surfaces state what whole neighbourhoods are off by; of bare clouds nothing does, and pieces that
    moved look the same there as scans that err over as far as a piece. What is stated of single points or vertices may
    be common to all of a patch, as where fits to overlapping neighbourhoods made them: such a patch is no better known
    than one of them. Nor is one of a few large faces, whose points err by what their corners do, stated or not.
    """
    patches = sum_patches(stable, numbers, np.zeros(3))
    noise = max(robust_scale(stable.residuals - patches.mean[patches.member]), rounding_of(stable.points))
    noise2 = noise**2
    single2 = np.maximum(stable.sigma**2, np.where(on_faces, noise2, 0.0))
    single2 = np.bincount(patches.member, single2, len(patches.count)) / patches.count
    stated2 = noise2 / patches.count + np.where(patches.shared2 > 0.0, patches.shared2, single2)
    scatter, stated = robust_scale(patches.mean), float(np.sqrt(np.median(stated2)))
    if scatter <= DOUBTFUL * stated:
        return ""
    off = f"the stable areas lie {1e3 * scatter:.2g} mm off each other, {scatter / stated:.0f} times what"
    if np.any(patches.shared2 > 0.0):
        return f"{off} their scans state: perhaps all of it moved, in pieces"
    return f"{off} the noise of their points explains: errors of the scans, or all of it moved, in pieces"
