"""The motion between two epochs of an object: from where they are given, or, where that is far off, by shape alone.

In: the surfaces of both epochs. Out: the fine registration and what was needed for it. An object that stood in a
workshop comes back anywhere; one that was scanned in the same frame never needs to be looked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from monitor.registration.anywhere.coarse import register_from_anywhere
from monitor.registration.anywhere.mirrored import say_mirrored
from monitor.registration.motion.held import Frames
from monitor.registration.motion.icp import IcpSettings, Within, register
from projects.model import PointCloud, Registration, Surface

UNLIKE_SIZE = 2.0  # times as large: more than what parts of one object are that overlap by half, and less than a foot
FOUND_NEAR = 0.5  # share of the samples with a partner: the epochs lie near each other, whatever else is wrong


def register_epochs(compared: Surface | PointCloud, reference: Surface | PointCloud,
                    settings: IcpSettings | None = None, frames: Frames | None = None,
                    within: Within | None = None,
                    ) -> tuple[Registration, Mapping[str, Any]]:  # fmt: skip
    """Return the registration of a compared epoch onto its reference, and how its start was found.

    `frames`, of epochs that control holds, keep what the shape does not; `within` tells where nothing moved, in the
    reference's frame (both as in `register`).

    Returns
    -------
    Registration
        Not converged, with the reasons of both attempts, where neither the given frames nor the shapes lead to one.
    mapping
        Empty where the epochs were given near each other; else `start` in words, `coarse_score` and `coarse_ambiguity`
        of the pose found by shape (`CoarseAlignment`). Where the mirror image of one epoch fits the other, and it
        does not itself, the reason says so, or the doubt.
    """
    near = register(compared, reference, settings, frames=frames, within=within)
    if near.converged or near.overlap >= FOUND_NEAR:
        return _with_doubt(near, say_mirrored(compared, reference, near)), {}
    far, coarse = register_from_anywhere(compared, reference, settings, within)
    figures = {"start": "by shape alone: the epochs are not near each other as given", "coarse_score": coarse.score,
               "coarse_ambiguity": coarse.ambiguity}  # fmt: skip
    mirrored = say_mirrored(compared, reference, far)
    if far.converged:
        return _with_doubt(far, mirrored), figures
    further = _say_size(compared, reference) or mirrored
    reason = f"{near.reason}; by shape alone: {coarse.reason or far.reason}{further and '; '}{further}"
    return replace(near, reason=reason), figures


def _with_doubt(found: Registration, further: str) -> Registration:
    """Return a registration with what else speaks against it, which is told first: in its reason where it is refused,
    else in its doubt."""
    if not further:
        return found
    if found.converged:
        return replace(found, doubt="; ".join(filter(None, (further, found.doubt))))
    return replace(found, reason=f"{found.reason}; {further}")


def _say_size(compared: Surface | PointCloud, reference: Surface | PointCloud) -> str:
    """Return that one epoch is much larger than the other, as in another unit or without a scale; "" where none is.

    The size is the root mean square distance from the middle, which no motion changes.
    """
    sizes = []
    for noun in (compared, reference):
        points = noun.vertices if isinstance(noun, Surface) else noun.points
        sizes.append(float(np.sqrt(np.mean(np.var(points[np.isfinite(points).all(axis=1)], axis=0)))))
    ratio = sizes[0] / max(sizes[1], 1e-300)
    if 1.0 / UNLIKE_SIZE < ratio < UNLIKE_SIZE:
        return ""
    return f"the compared epoch is {ratio:.3g} times as large as the reference: is it in another unit or scale?"


def held_by_frames(frames: Frames, failed: Registration) -> Registration:
    """Return what control alone says of the motion between two epochs, none within its uncertainty, where the shapes
    say nothing; the differences of absolute mode need no more."""
    return replace(
        failed, T_target_source=np.eye(4), covariance=frames.covariance, centre=frames.centre, converged=True,
        is_stable=None, weights=None, held_by_frames=f"every motion ({failed.reason})",
    )  # fmt: skip
