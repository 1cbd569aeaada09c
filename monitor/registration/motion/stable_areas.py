"""Stable areas: the patches of the source that moved with the majority, under their own uncertainty.

In: pairs and their residuals at a pose near the solution. Out: the motion of the majority and which patches follow
it. The start is a least median over many small sets of patches, so that nearly half of the surface may have changed,
even all to one side; then patches are kept or dropped and the motion estimated again until nothing changes. A layer
taken off a third of an object, of a few sigmas, would so be shared out between the motion and a scale that grows until
it holds both: the search is made from the other side too, and what stands apart in it has changed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from monitor.apart import stand_apart
from monitor.lengths import in_millimetres
from monitor.registration.motion.matching import Matches
from monitor.registration.motion.patch_sums import Patches, solve_patches, sum_patches
from monitor.registration.motion.sampling import Beside
from monitor.registration.motion.trial_motions import PART, fit_least_part, leaves_least_median, try_motions
from monitor.registration.motion.weights import residual_sigma, rounding_of, weighted_median
from monitor.robust import robust_scale
from projects.model import Bools, Floats, Ints

KEEP_SIGMAS = 3.0
KEEP_SCATTER = 2.5  # a patch that scatters so many times more than the others has changed without moving as a whole
N_ROUNDS = 20
N_HALVINGS = 20
WIDER = 1.5  # times: so much more do patches scatter about a motion where what changed is shared out to all
OF_PART = float(norm.ppf(0.5 + 0.5 * PART))  # of normal errors, sigmas: so many lie within
MEAN_OF_ABSOLUTE = float(np.sqrt(2.0 / np.pi))
LEAST_SCATTER = 0.5 * MEAN_OF_ABSOLUTE  # usual of patches; they have less only where nothing but rounding is left
DOUBTFUL = 3.0  # times what is stated of patches: so far off each other, what is taken for stable moved


@dataclass(frozen=True)
class StableSamples:
    """Which samples (n,) are stable, and the factor (n,) of their variance that their neighbourhoods share."""

    is_kept: Bools
    shared: Floats


def keep_stable(n: int, matches: Matches, is_stable: Bools, shared: Floats) -> StableSamples:
    """Return which of n samples are stable; those without a partner are not."""
    kept = StableSamples(np.zeros(n, dtype=bool), np.ones(n))
    kept.is_kept[matches.source], kept.shared[matches.source] = is_stable, shared
    return kept


def find_stable(
    matches: Matches, numbers: Ints, centre: Floats, rng: np.random.Generator, beside: Beside = "nothing"
) -> tuple[Floats, Bools, Floats]:
    """Return the motion (6,) of the majority about `centre` and, for each pair, whether its patch follows it and by
    what factor its patch's variance exceeds that of independent noise (`share_noise`). `beside` a layer all over the
    motion is (7,), its last number the thickness [m]."""
    patches = sum_patches(matches, numbers, centre, beside)
    trials = try_motions(patches, rng)
    motion, keep = settle(patches, leaves_least_median(patches, trials), grow)
    narrow, near = settle_narrow(patches, fit_least_part(patches, trials))
    wide, close = robust_scale(patches.left_by(motion)[keep]), robust_scale(patches.left_by(narrow)[near])
    if lie_apart(patches, narrow, near).any() and wide > WIDER * close:
        motion, keep = narrow, near  # the wider scale takes for errors what stands apart in the narrower
    return motion, keep[patches.member], share_noise(patches, motion, keep)[patches.member]


def settle(patches: Patches, motion: Floats, choose: Callable[[Patches, Floats, Bools], Bools]) -> tuple[Floats, Bools]:
    """Return the motion (6,) that the patches ask for which follow it, and which these are; `choose` says which follow
    a motion, from those that followed the last one (none at first)."""
    keep = np.zeros(len(patches.count), dtype=bool)
    for _ in range(N_ROUNDS):
        previous, keep = keep, choose(patches, motion, keep)
        if np.array_equal(previous, keep):
            break
        motion = solve_patches(patches, keep)
    return motion, keep


def settle_narrow(patches: Patches, starts: Floats) -> tuple[Floats, Bools]:
    """Return the motion (6,) that most patches follow by the least scale of those settled from `starts` (k, 6), and
    which do: a wider scale holds more of what no one motion explains."""
    settled = [settle(patches, start, shrink) for start in starts]
    left = np.abs(np.array([patches.left_by(motion) for motion, _ in settled]))
    scale = min(robust_scale(of[near]) for of, (_, near) in zip(left, settled, strict=True))
    return settled[int(np.argmax((left <= KEEP_SIGMAS * scale) @ patches.count))]


def grow(patches: Patches, motion: Floats, keep: Bools) -> Bools:
    """Return which patches follow a motion by the scale of those that did before, at first of the better half, or by
    what their scans disagree by."""
    left = np.abs(patches.left_by(motion))
    return follows(patches, motion, keep if keep.any() else left <= weighted_median(left, patches.count),
                   patches.shared2)  # fmt: skip


def shrink(patches: Patches, motion: Floats, _last: Bools) -> Bools:
    """Return which patches follow a motion by the scale of themselves, found from above: as wide as the better third
    makes normal errors of all, then without those beyond it."""
    left = np.abs(patches.left_by(motion))
    keep: Bools = left <= KEEP_SIGMAS * float(np.quantile(left, PART)) / OF_PART
    for _ in range(N_ROUNDS):
        following = follows(patches, motion, keep, 0.0)
        if not following.any() or np.array_equal(following, keep):
            return following
        keep = following
    return keep


def lie_apart(patches: Patches, motion: Floats, near: Bools) -> Bools:
    """Return which patches lie in a group beside those that follow a motion, by more than scans disagree by."""
    left = patches.left_by(motion)
    apart = stand_apart(left, patches.count, near)
    if not apart.any():
        return apart
    common2 = common_variance(left[near], patches.noise2[near])
    sigma = np.sqrt(patches.noise2 + np.maximum(common2, patches.shared2))
    is_beyond = np.median(np.abs(left[apart]) / sigma[apart]) > KEEP_SIGMAS
    return apart & is_beyond


def share_noise(patches: Patches, motion: Floats, keep: Bools) -> Floats:
    """Return by what factor, 1 or more, the variance of each patch's mean exceeds that of independent noise of points.

    Points of a patch err together, by more where it is rough or seen steeply: the kept patches tell how the factor
    rises with the noise of points. A weight by the noise of points alone would overrate smooth and rough places alike,
    but rough ones more.
    """
    if not keep.any():
        return np.ones(len(keep))
    ratio = patches.left_by(motion) / np.sqrt(patches.noise2)
    return np.maximum(residual_sigma(ratio, (patches.noise2 * patches.count,), keep), 1.0) ** 2


def follows(patches: Patches, motion: Floats, among: Bools, least2: Floats | float) -> Bools:
    """Return which patches' mean residual and scatter are explained by noise as of those `among` them, once `motion` is
    applied.

    A patch that is off by no more than what its epochs' scans disagree by has not been seen to move; without it the
    motion would be that of one side, and the other side twice as far off.
    """
    left = patches.left_by(motion)
    # what patches scatter beyond the noise of their points: correlated errors of the surface, common to a patch
    common2 = common_variance(left[among], patches.noise2[among])
    usual = max(float(np.median(patches.scatter[among])), LEAST_SCATTER)
    stated = MEAN_OF_ABSOLUTE * np.sqrt(patches.shared2 / (patches.noise2 * patches.count))
    quiet = patches.scatter < KEEP_SCATTER * np.hypot(usual, stated)
    sigma = np.sqrt(patches.noise2 + np.maximum(common2, least2))
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
    measured ones. Surfaces state what whole neighbourhoods are off by, but not what their cells are too coarse to
    follow; of bare clouds nothing does, and pieces that moved look the same there as scans that err over as far as a
    piece. What is stated of single points or vertices may
    be common to all of a patch, as where fits to overlapping neighbourhoods made them: such a patch is no better known
    than one of them. Nor is one of a few large faces, whose points err by what their corners do, stated or not.
    """
    patches = sum_patches(stable, numbers, np.zeros(3))
    scatter, stated = robust_scale(patches.mean), stated_scatter(stable, patches, on_faces)
    if scatter <= DOUBTFUL * stated:
        return ""
    off = f"the stable areas lie {in_millimetres(scatter)} off each other, {scatter / stated:.0f} times what"
    if np.any(patches.shared2 > 0.0):
        return f"{off} their scans state: points of an epoch too coarse for its relief, or all of it moved, in pieces"
    return f"{off} the noise of their points explains: errors of the scans, or all of it moved, in pieces"


def stated_scatter(stable: Matches, patches: Patches, on_faces: Bools) -> float:
    """Return by what [m] the means of patches are off each other according to what is stated of them (see above)."""
    noise2 = max(robust_scale(stable.residuals - patches.mean[patches.member]), rounding_of(stable.points)) ** 2
    single2 = np.maximum(stable.sigma**2, np.where(on_faces, noise2, 0.0))
    single2 = np.bincount(patches.member, single2, len(patches.count)) / patches.count
    stated2 = noise2 / patches.count + np.where(patches.shared2 > 0.0, patches.shared2, single2)
    return float(np.sqrt(np.median(stated2)))
