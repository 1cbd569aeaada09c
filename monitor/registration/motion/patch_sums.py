"""Pairs summed over the patches that they lie in: few numbers a patch, of which motions are tried and solved for.

In: pairs, their residuals and patch numbers. Out: sums of each patch, and the motion that some of the patches ask for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monitor.registration.motion.matching import Matches
from monitor.registration.motion.sampling import Beside, parameter_rows
from monitor.registration.motion.weights import residual_sigma, rounding_of
from projects.model import Bools, Floats, Ints


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

    def left_by(self, motion: Floats) -> Floats:
        """Return the mean residual [m] of each patch once a `motion` (k,) about the centre of the rows is applied."""
        return np.asarray(self.mean + self.row @ motion)


def sum_patches(matches: Matches, numbers: Ints, centre: Floats, beside: Beside = "nothing") -> Patches:
    """Return the sums of each patch; `numbers` (n pairs) are patch numbers. `beside` a layer all over or a
    scale, motions have seven parameters, the last its thickness [m], or the excess of the scale over 1."""
    _, member = np.unique(numbers, return_inverse=True)
    n = int(member.max()) + 1
    rows = parameter_rows(matches.points, matches.normals, centre, beside)
    count = np.bincount(member, minlength=n).astype(float)

    def total(values: Floats) -> Floats:
        return np.stack([np.bincount(member, column, n) for column in values.T], axis=1)

    mean = np.bincount(member, matches.residuals, n) / count
    # by deviations within patches alone, in which no motion of a patch is
    deviation = (matches.residuals - mean[member]) * np.sqrt(count / np.maximum(count - 1.0, 1.0))[member]
    sigma = residual_sigma(deviation, matches.causes, count[member] > 1, rounding_of(matches.points))
    weighted = rows / sigma[:, None] ** 2
    k = rows.shape[1]
    one, other = np.triu_indices(k)
    information = np.empty((n, k, k))
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


def solve_patches(patches: Patches, keep: Bools) -> Floats:
    """Return the motion (k,) that the kept patches ask for."""
    information, right = patches.information[keep].sum(axis=0), patches.right[keep].sum(axis=0)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    return scale * (np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-8, hermitian=True) @ (scale * right))
