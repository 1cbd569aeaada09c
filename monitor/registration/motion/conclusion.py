"""What a registration says once its alignment has settled: covariance, stable areas, what it is in doubt of.

In: the sides, their samples and where these came to lie. Out: `Registration`, also one on which nothing may be built.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from monitor.registration.motion.alignment import Alignment
from monitor.registration.motion.covariance import estimate_covariance
from monitor.registration.motion.degeneracy import find_free_motion
from monitor.registration.motion.held import Frames, FreeMotions, held_covariance
from monitor.registration.motion.layer import Layered
from monitor.registration.motion.matching import Samples
from monitor.registration.motion.patches import PatchGrid
from monitor.registration.motion.scale import Scale
from monitor.registration.motion.sides import Side
from monitor.registration.motion.source_vertices import patches_of, spread_to_vertices, spread_weights
from monitor.registration.motion.stable_areas import StableSamples, doubt_stable
from monitor.robust import robust_scale
from projects.model import Floats, Ints, Registration

MAJORITY = 0.5  # of the surface that finds partners: with less the areas that move alike may be any of several


@dataclass(frozen=True)
class Settled:
    """Where an alignment came to: both sides, the patches of the source, its samples (n,) and the patch of each, the
    alignment of those that are stable, which these are, and after how many iterations."""

    source: Side
    target: Side
    grid: PatchGrid
    samples: Samples
    numbers: Ints
    found: Alignment
    stable: StableSamples
    n_iterations: int


def conclude(settled: Settled, n_source: int, *, held: tuple[FreeMotions, Frames] | None = None,
             layered: Layered | None = None, scale: Scale | None = None) -> Registration:  # fmt: skip
    """Return the registration with its covariance, its stable areas and its doubts.

    Parameters
    ----------
    settled : where the alignment of the stable areas came to.
    n_source : vertices or points of the source as it was given, of which the prepared side may hold some.
    held : what the shape leaves free and the frames that hold it.
    layered : where all of the source lies off by a layer.
    scale : where it is of another size.
    """
    samples, numbers, found = settled.samples, settled.numbers, settled.found
    pairs = found.matches
    if not found.weights.any():
        return failed(found.T_target_source, found.reason, n_source, found, len(samples.points))
    kept = settled.stable.is_kept[pairs.source]
    stable, sigma = pairs.take(kept), found.sigma[kept]
    shared = settled.stable.shared[pairs.source][kept]
    centre = stable.points.mean(axis=0)
    free = "" if held is not None else find_free_motion(stable, centre, numbers[stable.source])
    reason = free or found.reason or doubt_majority(float(kept.mean()))
    covariance = np.full((6, 6), np.nan)
    if not reason and held is not None:
        covariance = held_covariance(stable, sigma, centre, *held, shared)
    elif not reason and layered is not None:
        covariance = layered.covariance
    elif not reason:
        covariance = estimate_covariance(stable, sigma, centre, shared=shared)
    inlier = (found.weights > 0) & kept
    of_source = patches_of(settled.source, settled.grid)
    weights = found.weights / found.sigma**2
    still = kept if layered is None or layered.is_still is None else layered.is_still[pairs.source]
    of_faces = settled.source.index[samples.index][stable.source] < 0
    on_faces = of_faces | (settled.target.index[stable.target] < 0)
    return Registration(
        T_target_source=found.T_target_source, covariance=covariance, centre=centre,
        converged=not reason, reason=reason,
        n_inliers=int(inlier.sum()), n_correspondences=len(pairs), n_iterations=settled.n_iterations,
        rmse=float(np.sqrt(np.mean(pairs.residuals[inlier] ** 2))),
        sigma=robust_scale(stable.residuals),
        overlap=len(pairs) / len(samples.points), stable_share=float(still.mean()),
        is_stable=spread_to_vertices(settled.source, of_source, np.unique(numbers[pairs.source[still]]), n_source),
        weights=spread_weights(settled.source, of_source, numbers[pairs.source], weights, n_source),
        held_by_frames="" if held is None else held[0].words,
        doubt=scale.words if scale is not None else layered.doubt if layered is not None
        else doubt_stable(stable, numbers[stable.source], on_faces),
        layer=math.nan if layered is None else layered.thickness,
        sigma_layer=math.nan if layered is None else layered.sigma,
        stable_is_rest=layered is not None and layered.is_still is not None,
        scale=math.nan if scale is None else scale.ratio,
        sigma_scale=math.nan if scale is None else scale.sigma,
    )  # fmt: skip


def doubt_majority(stable_share: float) -> str:
    """Return why a motion that so small a share of the surface follows is not that of the stable areas, else ""."""
    if stable_share >= MAJORITY:
        return ""
    return (
        f"only {100 * stable_share:.0f} % of the surface follows one motion, so that none is the majority's; say where "
        "nothing moved, or give control points"
    )


def failed(T: Floats, reason: str, n_source: int, found: Alignment | None = None, n_samples: int = 1) -> Registration:
    """Return a registration on which nothing may be built, with its reason."""
    n_pairs = 0 if found is None else len(found.matches)
    return Registration(
        T_target_source=T, covariance=np.full((6, 6), np.nan), centre=T[:3, 3] * 0.0, converged=False, reason=reason,
        n_correspondences=n_pairs, n_iterations=0 if found is None else found.n_iterations,
        overlap=n_pairs / n_samples, stable_share=0.0, is_stable=np.zeros(n_source, dtype=bool),
    )  # fmt: skip
