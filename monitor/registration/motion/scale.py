"""A wrong scale: the seventh parameter of an epoch that nobody measured a length in, told beside the motion.

In: the pairs of all samples at the motion that was found. Out: how many times as large the source is, where that
explains what no motion does, and its words. Photographs show shapes without sizes: a model of them by a rod that was
read wrongly, or a scanner's range that is off in proportion, grows from its middle, most at its ends. The motion stays
that of equal sizes, for no measured length is altered here; what the scale makes of the differences is told instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from monitor.lengths import in_millimetres
from monitor.registration.motion.alignment import Alignment, AlignmentRules, align
from monitor.registration.motion.covariance import estimate_covariance
from monitor.registration.motion.layer import SURE, leaves_less, reach_of, sharpen
from monitor.registration.motion.matching import Samples
from monitor.registration.motion.partners import Partners
from monitor.registration.motion.patch_sums import Patches, sum_patches
from monitor.registration.motion.sides import Side
from monitor.registration.motion.stable_areas import WIDER
from projects.model import Z95, Floats, Ints
from projects.transforms import apply, invert, perturb

N_ROUNDS = 30  # pairs of nearest points close by a part of the way in each: half as large again took ten
SETTLED = 1e-5  # of a scale: a step that puts the ends of two metres 10 micrometres off
N_SAMPLES = 10_000  # suffice for one number
LEAST_MARGIN = 1e-6  # of a scale: what two models of the same numbers agree by says no more of lengths


@dataclass(frozen=True)
class Scale:
    """How many times as large the source is as the target, with one `sigma`, and how far [m] the samples' ends lie off
    by it."""

    ratio: float
    sigma: float
    at_ends: float

    @property
    def words(self) -> str:
        """The scale as a doubt about a motion that leaves it in the differences."""
        margin = max(Z95 * self.sigma, LEAST_MARGIN)
        decimals = count_decimals(margin)
        return (
            f"the compared epoch is {self.ratio:.{decimals}f} ± {margin:.{decimals}f} times as large as the reference, "
            f"which puts its ends {in_millimetres(self.at_ends)} off: unless all of it grew or shrank, correct its "
            "scale and add it again; until then no difference tells change from scale"
        )


def count_decimals(margin: float) -> int:
    """Return the decimals of a number with this margin, as reports round: two digits of a margin that begins with 1 or
    2, one of others, six decimals at most."""
    exponent = math.floor(math.log10(margin))
    return min((1 if round(margin / 10.0**exponent, 1) < 3.0 else 0) - exponent, 6)


def find_scale(samples: Samples, target: Side, found: Alignment, rules: AlignmentRules, numbers: Ints,
               both_oriented: bool) -> Scale | None:  # fmt: skip
    """Return the scale that the source has beside its motion; None where none is told.

    It is told where, with it, four fifths of the patches lie within a reach less by `WIDER` than without, and nearer
    than with a layer all over, which on a round body is the same, where it has settled, and is beyond 3 sigma. Nor may
    the better half of the patches lie as near without it: where a part of an object changed, the others follow one
    motion, and a scale between both is nobody's.
    """
    pairs = found.matches
    patches = sum_patches(pairs, numbers[pairs.source], found.centre, beside="scale")
    motion = sharpen(patches)
    if not (leaves_less(patches, motion) and _leaves_less_of_half(patches, motion)):
        return None
    if _fits_a_layer(found, numbers, reach_of(np.abs(patches.left_by(motion)))):
        return None
    step = max(len(samples.points) // N_SAMPLES, 1)
    samples, numbers, ratio = samples.every(step), numbers[::step], 1.0
    middle = apply(invert(found.T_target_source), found.centre[None])[0]
    for _ in range(N_ROUNDS):
        ratio *= 1.0 + float(motion[6])
        shrunk = replace(samples, points=middle + (samples.points - middle) / ratio)
        found = align(shrunk, target, perturb(found.T_target_source, found.centre, motion[:6]), rules, fine=True,
                      both_oriented=both_oriented, partners=Partners(target.tree, len(samples.points)))  # fmt: skip
        if not found.weights.any():
            return None
        motion = sharpen(sum_patches(found.matches, numbers[found.matches.source], found.centre, beside="scale"))
        if abs(motion[6]) < SETTLED:
            break
    else:
        return None
    covariance = estimate_covariance(found.matches, found.sigma, found.centre, beside="scale")
    sigma = float(np.sqrt(covariance[6, 6]))
    if not abs(ratio - 1.0) > SURE * sigma:
        return None
    return Scale(ratio, sigma, abs(ratio - 1.0) * _half_length(samples))


def _leaves_less_of_half(patches: Patches, motion: Floats) -> bool:
    """Return whether a motion beside a scale (7,) leaves less of the better half of the patches than no step does."""
    return float(np.median(np.abs(patches.mean))) > WIDER * float(np.median(np.abs(patches.left_by(motion))))


def _fits_a_layer(found: Alignment, numbers: Ints, reach: float) -> bool:
    """Return whether a layer all over explains the patches within `reach` [m] as well."""
    patches = sum_patches(found.matches, numbers[found.matches.source], found.centre, beside="layer")
    return reach_of(np.abs(patches.left_by(sharpen(patches)))) <= reach


def _half_length(samples: Samples) -> float:
    """Return half the longest edge [m] of the box of the samples: so far is an end from the middle."""
    return 0.5 * float(np.ptp(samples.points, axis=0).max())
