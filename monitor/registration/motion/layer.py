"""A layer all over: the seventh parameter, where one thickness explains what no motion does.

In: the stable areas and the motion found without one. Out: the same beside a layer, where there is one. An object that
was cleaned all over, or scanned by an instrument whose ranges differ, is smaller or larger by the same amount
everywhere. Where it is not seen alike from all sides, its motion takes up part of that: -1 mm all over a body whose top
is seen steeply moved it by 0.5 mm. What all samples lie off by is peeled off them, and all goes on as without it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from monitor.lengths import in_millimetres
from monitor.registration.motion.alignment import Alignment, AlignmentRules, align
from monitor.registration.motion.covariance import estimate_covariance
from monitor.registration.motion.matching import Samples
from monitor.registration.motion.partners import Partners
from monitor.registration.motion.patch_sums import Patches, solve_patches, sum_patches
from monitor.registration.motion.sides import Side
from monitor.registration.motion.stable_areas import WIDER, StableSamples, find_stable, keep_stable, stated_scatter
from monitor.robust import robust_scale
from projects.model import Bools, Floats, Ints
from projects.transforms import perturb

N_ROUNDS = 4
N_CONCENTRATIONS = 20
ALL_OVER = 0.8  # of the patches: a layer explains them, not the better half of them
SURE = 3.0  # sigmas


@dataclass(frozen=True)
class Layered:
    """A registration beside a layer: the samples without it, where they lie, what is stable, the iterations taken, the
    `thickness` [m] (positive: the source lies outside of the target), its `sigma` [m], in which scans disagree as if
    all together, the motion's covariance (6, 6), what speaks against it in words, and, where the layer is not all over,
    which samples lie where nothing changed."""

    samples: Samples
    found: Alignment
    stable: StableSamples
    n_iterations: int
    thickness: float
    sigma: float
    covariance: Floats
    doubt: str
    is_still: Bools | None = None


def peel_off(samples: Samples, thickness: float) -> Samples:
    """Return samples put inward by a thickness [m] along their normals."""
    return replace(samples, points=samples.points - thickness * samples.normals)


def find_layer(samples: Samples, target: Side, found: Alignment, rules: AlignmentRules, numbers: Ints,
               rng: np.random.Generator, both_oriented: bool) -> Layered | None:  # fmt: skip
    """Return the registration beside a layer all over; None where none is told from what the motion alone leaves.

    It is told where, with it, four fifths of the patches lie within a scale less by `WIDER`, the stable areas by no
    more than so many times off each other as their scans state (in doubt where by more than they state), and its
    thickness is beyond 3 sigma. A layer on a part is not one all over, a flat or half-seen shape does not tell it from
    a shift, and where normals look either way nobody knows which way is out.
    """
    if not both_oriented:
        return None
    patches = sum_patches(found.matches, numbers[found.matches.source], found.centre, beside="layer")
    if not leaves_less(patches, sharpen(patches)):
        return None
    thickness, n_iterations, peeled = 0.0, 0, samples
    for number in range(N_ROUNDS):
        pairs = found.matches
        motion, is_stable, shared = find_stable(pairs, numbers[pairs.source], found.centre, rng, beside="layer")
        if number == 0 and not leaves_less(patches, motion):
            return None
        stable = keep_stable(len(samples.points), pairs, is_stable, shared)
        thickness += float(motion[6])
        peeled = peel_off(samples, thickness)
        found = align(peeled, target, perturb(found.T_target_source, found.centre, motion[:6]), rules,
                      is_kept=stable.is_kept, fine=True, both_oriented=both_oriented, shared=stable.shared,
                      partners=Partners(target.tree, len(samples.points)))  # fmt: skip
        n_iterations += found.n_iterations
        if not found.weights.any():
            return None
        if abs(motion[6]) < rules.precision:
            break
    return conclude_beside(peeled, found, stable, n_iterations, thickness, numbers, "all over")


def conclude_beside(peeled: Samples, found: Alignment, areas: StableSamples, n_iterations: int, thickness: float,
                    numbers: Ints, where: str) -> Layered | None:  # fmt: skip
    """Return the registration beside a layer where it is significant and leaves no more than is stated; `where` it
    lies, in words."""
    kept = areas.is_kept[found.matches.source]
    stable, shared = found.matches.take(kept), areas.shared[found.matches.source][kept]
    centre = stable.points.mean(axis=0)
    patches = sum_patches(stable, numbers[stable.source], centre)
    scatter = robust_scale(patches.mean)
    stated = stated_scatter(stable, patches, np.zeros(len(stable), dtype=bool))
    if scatter > WIDER * stated:
        return None
    covariance = estimate_covariance(stable, found.sigma[kept], centre, shared=shared, beside="layer")
    if not abs(thickness) > SURE * float(np.sqrt(covariance[6, 6])):
        return None
    sigma = float(np.sqrt(covariance[6, 6] + np.median(patches.shared2)))
    doubt = "" if scatter <= stated else in_doubt(thickness, scatter, where)
    return Layered(peeled, found, areas, n_iterations, thickness, sigma, covariance[:6, :6], doubt)


def in_doubt(thickness: float, scatter: float, where: str) -> str:
    """Return in words that stable areas lie `scatter` [m] off each other beside a layer, more than stated."""
    return (
        f"beside a layer {where} of {in_millimetres(thickness)} the stable areas lie {in_millimetres(scatter)} off "
        "each other, more than their scans state: perhaps it lies on a part of them alone, or ranges differ"
    )


def sharpen(patches: Patches) -> Floats:
    """Return the motion beside a layer (7,) that the four fifths of the patches ask for which it fits best."""
    motion: Floats = np.zeros(7)
    for _ in range(N_CONCENTRATIONS):
        left = np.abs(patches.left_by(motion))
        last, motion = motion, solve_patches(patches, left <= reach_of(left))
        if np.allclose(motion, last, rtol=0.0, atol=1e-7):
            break
    return motion


def leaves_less(patches: Patches, motion: Floats) -> bool:
    """Return whether a motion beside a layer (7,) leaves less of four fifths of the patches than no step does."""
    return reach_of(np.abs(patches.mean)) > WIDER * reach_of(np.abs(patches.left_by(motion)))


def reach_of(left: Floats) -> float:
    """Return within what [m] four fifths of the patches lie."""
    return float(np.quantile(left, ALL_OVER))
