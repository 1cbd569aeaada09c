"""The motion that brings one epoch or scan onto another, and how well it is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from projects.arrays import Bools, Floats, hold_array


@dataclass(frozen=True)
class Registration:
    """The motion that brings a source onto a target, and how well it is known.

    Attributes
    ----------
    T_target_source : (4, 4) float64, rigid; maps coordinates of the source to those of the target.
    covariance : (6, 6) float64, rad and m, of (w, t) in x -> c + exp([w]) (x - c) + t, a left perturbation applied
        after `T_target_source` about `centre` c.
    centre : (3,) float64, m, in the target's frame.
    converged : whether the motion settled; nothing may be built on one that did not.
    reason : why it did not converge, in words.
    n_inliers : pairs of points that were held to be unmoved.
    n_correspondences : pairs of points that look the same way near each other.
    n_iterations : steps taken.
    rmse : m, root mean square of the inliers' residuals, the signed distances of a pair along the mean of
        both normals.
    sigma : m, 1.4826 times the median size of the residuals of the stable pairs.
    overlap : share of the samples of the source that found a partner.
    stable_share : share of these that was held to be unmoved.
    is_stable : (n,) bool, which points or vertices of the source were held to be unmoved.
    weights : (n,) float64, the share that each of them has of all weight in the adjustment that falls on points or
        vertices, robust weights counted: what the motion rests on. What is held unmoved and hardly fits has little.
    held_by_frames : names, in words, the motions that the shape does not hold and that stay as the frames of both sides
        say, with the uncertainty of those.
    doubt : says in words what speaks against the stable areas being stable, or against this pose beside others that fit
        as well; empty where nothing does.
    layer : m, the thickness by which the stable areas of the source all lie outside of the target, beside which the
        motion was found; NaN where none is told.
    sigma_layer : m, one sigma of it, in which scans disagree as if all together; NaN where none is told.
    stable_is_rest : most of the source lies off by one thickness, and the stable areas are the rest, which alone did
        not change.
    scale : how many times as large the source is as the target, which the motion leaves in the differences; NaN where
        no other scale than 1 is told.
    sigma_scale : one sigma of it; NaN where none is told.
    """

    T_target_source: Floats
    covariance: Floats
    centre: Floats
    converged: bool
    reason: str = ""
    n_inliers: int = 0
    n_correspondences: int = 0
    n_iterations: int = 0
    rmse: float = float("nan")
    sigma: float = float("nan")
    overlap: float = float("nan")
    stable_share: float = float("nan")
    is_stable: Bools | None = None
    weights: Floats | None = None
    held_by_frames: str = ""
    doubt: str = ""
    layer: float = float("nan")
    sigma_layer: float = float("nan")
    stable_is_rest: bool = False
    scale: float = float("nan")
    sigma_scale: float = float("nan")

    def __post_init__(self) -> None:
        hold_array(self, "T_target_source", (4, 4), np.float64)
        hold_array(self, "covariance", (6, 6), np.float64)
        hold_array(self, "centre", (3,), np.float64)
