"""A layer on most of an object: the rest, which lies where it lay, is what did not change.

In: the motion found without one, a compromise. Out: the motion beside the layer, and the rest as the stable areas. A
statue was cleaned and its pedestal was not: no motion brings the cleaned part onto itself, nor is the layer all over.
One motion and one thickness explain both parts; that the rest then lies at zero, of all places, says that instruments
do not differ and that it did not change.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from monitor.apart import stand_apart
from monitor.lengths import in_millimetres
from monitor.registration.motion.alignment import Alignment, AlignmentRules, align
from monitor.registration.motion.layer import N_ROUNDS, Layered, conclude_beside, reach_of, sharpen
from monitor.registration.motion.matching import Matches, Samples
from monitor.registration.motion.partners import Partners
from monitor.registration.motion.patch_sums import Patches, solve_patches, sum_patches
from monitor.registration.motion.sides import Side
from monitor.registration.motion.stable_areas import KEEP_SIGMAS, WIDER, keep_stable, share_noise
from monitor.registration.motion.trial_motions import fit_least_part, try_motions
from monitor.registration.motion.weights import weighted_median
from monitor.robust import robust_scale
from projects.model import Bools, Floats, Ints
from projects.transforms import perturb

N_CLASSIFIED = 20  # rounds of telling which patches have it
MIXED = 1.0 / 3.0  # of the thickness: a patch that lies off by more may lie across the layer's border
AT_ZERO = 0.2  # of the thickness: farther off the rest lies nowhere in particular
MOST = 0.5  # of the patches have it: of a layer on less the rest is the majority, and found as such


@dataclass(frozen=True)
class Parted:
    """Patches some of which have a layer: the motion (7,) with its thickness [m] last, which (k,) have it, which are
    explained, and what is `left` (k,) [m] of each."""

    motion: Floats
    has_layer: Bools
    keep: Bools
    left: Floats

    @property
    def is_still(self) -> Bools:
        """Which patches (k,) lie where they lay: not those half of which may have the layer."""
        return self.keep & ~self.has_layer & (self.left < MIXED * abs(self.motion[6]))


def find_layer_on_most(samples: Samples, target: Side, found: Alignment, rules: AlignmentRules, numbers: Ints,
                       rng: np.random.Generator, both_oriented: bool) -> Layered | None:  # fmt: skip
    """Return the registration beside a layer on most of the object, the rest stable; None where none is told.

    It is told as `is_told` says of what the motion alone leaves, and again of what each next one does, and where stable
    areas then lie off each other by no more than `WIDER` times what their scans state.
    """
    if not both_oriented:
        return None
    n, n_iterations = len(samples.points), 0
    thickness, is_peeled = 0.0, np.zeros(n, dtype=bool)
    for number in range(N_ROUNDS):
        pairs = found.matches
        as_it_is = replace(pairs, residuals=pairs.residuals + thickness * is_peeled[pairs.source])
        patches = sum_patches(as_it_is, numbers[pairs.source], found.centre, beside="layer")
        parted = part_patches(patches, rng)
        if not is_told(patches, parted):  # in a later round, too: others may be parted there
            return None
        if number == 0 and not fits_no_scale(pairs, numbers, found.centre, parted):
            return None
        last, thickness, member = thickness, float(parted.motion[6]), patches.member
        is_peeled = mark(n, pairs.source, parted.has_layer[member])
        is_still = mark(n, pairs.source, parted.is_still[member])
        shared = share_noise(with_layer_on(patches, parted.has_layer), parted.motion, parted.keep)
        stable = keep_stable(n, pairs, parted.keep[member], shared[member])
        peeled = replace(samples, points=samples.points - (thickness * is_peeled)[:, None] * samples.normals)
        found = align(peeled, target, perturb(found.T_target_source, found.centre, parted.motion[:6]), rules,
                      is_kept=stable.is_kept, fine=True, both_oriented=both_oriented, shared=stable.shared,
                      partners=Partners(target.tree, n))  # fmt: skip
        n_iterations += found.n_iterations
        if not found.weights.any():
            return None
        if abs(thickness - last) < rules.precision:
            break
    layered = conclude_beside(peeled, found, stable, n_iterations, thickness, numbers, "on most of it")
    if layered is None:
        return None
    doubt = "; ".join(filter(None, (in_words(thickness), layered.doubt)))
    return replace(layered, thickness=np.nan, sigma=np.nan, doubt=doubt, is_still=is_still)


def in_words(thickness: float) -> str:
    """Return what was taken for stable beside a layer of that thickness [m], for whoever knows better."""
    way = "further out, as coated" if thickness > 0.0 else "further in, as cleaned"
    return (
        "stable is taken to be the smaller part, which lies where it lay; the rest lies "
        f"{in_millimetres(abs(thickness))} {way}; a stable area that is given would confirm it"
    )


def mark(n: int, which: Ints, are: Bools) -> Bools:
    """Return a mask (n,) that holds of `which` those that `are`."""
    out = np.zeros(n, dtype=bool)
    out[which] = are
    return out


def part_patches(patches: Patches, rng: np.random.Generator) -> Parted:
    """Return the patches parted into those with a layer and those without, by what one motion and one thickness leave:
    of several starts, the motions beside a layer that leave least in a third of the patches, that which leaves least.
    """
    starts = fit_least_part(patches, try_motions(patches, rng))
    tried = [_settle(patches, motion) for motion in starts]
    return tried[int(np.argmin([reach_of(t.left) for t in tried]))]


def _settle(patches: Patches, motion: Floats) -> Parted:
    """Return the patches parted, from a first motion beside a layer on."""
    has_layer = np.zeros(len(patches.count), dtype=bool)
    for _ in range(N_CLASSIFIED):
        without = patches.mean + patches.row[:, :6] @ motion[:6]
        last, has_layer = has_layer, np.abs(without - motion[6]) < np.abs(without)
        own = with_layer_on(patches, has_layer)
        left = np.abs(own.left_by(motion))
        keep = left <= KEEP_SIGMAS * robust_scale(left) + 1e-12
        motion = solve_patches(own, keep)
        if np.array_equal(last, has_layer):
            break
    return Parted(motion, has_layer, keep, np.abs(own.left_by(motion)))


def with_layer_on(patches: Patches, has_layer: Bools) -> Patches:
    """Return patches of which only some have the layer, whose thickness is the last parameter of their motion."""
    column = np.ones((len(has_layer), 7))
    column[:, 6] = has_layer
    return replace(patches, row=patches.row * column, right=patches.right * column,
                   information=patches.information * column[:, :, None] * column[:, None, :])  # fmt: skip


def is_told(patches: Patches, parted: Parted) -> bool:
    """Return whether a layer on most of the patches is told from all else that might be.

    One motion and one thickness on a part leave four fifths of the patches within a scale less by `WIDER` than a motion
    or a layer all over does. Most patches are of the part, and the rest stands apart from it, at zero by the motion and
    thickness of the part alone. With the parts exchanged, as if the rest had gained what the part lost, no motion
    leaves as little.
    """
    has_layer, keep = parted.has_layer, parted.keep
    own, other = keep & has_layer, keep & ~has_layer
    if patches.count[has_layer].sum() < MOST * patches.count.sum() or not other.any():
        return False
    least = WIDER * reach_of(parted.left)
    rivals = [np.zeros(7), sharpen(patches)]
    if any(reach_of(np.abs(patches.left_by(motion))) < least for motion in rivals):
        return False
    part = solve_patches(patches, own)
    of_part = patches.left_by(part)
    if not stand_apart(of_part, patches.count, np.abs(of_part) <= KEEP_SIGMAS * robust_scale(of_part[own])).any():
        return False
    rest = weighted_median((of_part + part[6])[other], patches.count[other])
    exchanged = with_layer_on(patches, ~has_layer)
    back = np.abs(exchanged.left_by(solve_patches(exchanged, keep)))
    return bool(abs(rest) < AT_ZERO * abs(part[6]) and reach_of(back) > least)


def fits_no_scale(pairs: Matches, numbers: Ints, centre: Floats, parted: Parted) -> bool:
    """Return whether no scale of the whole, which grows from its middle, leaves as little."""
    patches = sum_patches(pairs, numbers[pairs.source], centre, beside="scale")
    return reach_of(np.abs(patches.left_by(sharpen(patches)))) > WIDER * reach_of(parted.left)
