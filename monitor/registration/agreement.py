"""How well the scans of one epoch agree: what registration and calibration left between them, place by place.

In: the epoch's surface and the signed distances of each scan's points to it. Out: for every vertex one sigma of the
error that whole neighbourhoods of a scan share. It does not shrink with the number of points, and no single scan shows
it: only where scans overlap does it come to light (Dorninger and Nothegger 2009: remaining differences between the
scans; Nothegger 2011: the scans never match perfectly).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from projects.model import Floats, Ints

PATCH_IN_SPACINGS = 10.0  # edge of a patch: a hundred points average the noise down to a tenth
FEWEST_POINTS = 10  # of a scan in a patch
PRIOR_SCANS = 2.0  # what all patches together say counts in each as much as this many further scans
N_PATCHES_AROUND = 4  # that a vertex takes its sigma from


@dataclass(frozen=True)
class Agreement:
    """How well the scans of an epoch agree.

    Attributes
    ----------
    sigma : (n,) m, of each vertex, one sigma of the error shared by its neighbourhood; NaN all over where no two
        scans overlap, since nothing shows it then.
    sigma_scan : m, of one scan's patch, over the whole epoch (root mean square).
    patch_size : m.
    n_patches, n_overlapping : patches with points, and those seen by two scans or more.
    """

    sigma: Floats
    sigma_scan: float
    patch_size: float
    n_patches: int
    n_overlapping: int


@dataclass(frozen=True)
class _Groups:
    """Points by (patch, scan): patch of each group, number of points, mean distance [m] and the variance of it [m2]."""

    patch: Ints
    n: Ints
    mean: Floats
    variance: Floats


def assess_agreement(
    vertices: Floats, points: Sequence[Floats], distances: Sequence[Floats], spacing: float
) -> Agreement:
    """Estimate the error that whole patches of a scan share, from where scans overlap.

    Parameters
    ----------
    vertices : (n, 3) m, of the epoch's surface.
    points : of each scan, (k, 3) m, in the frame of the surface.
    distances : of each scan, (k,) m, signed, of its points to the surface; NaN where unknown.
    spacing : m, typical distance between neighbouring points.

    Notes
    -----
    In a patch seen by k scans with mean distances m_s, s2 = sum (m_s - mean)^2 / (k - 1) less the noise of the means
    estimates the variance of one scan there. Pooled over all patches, weighted by k - 1, it is sigma_scan^2. A patch
    has (PRIOR_SCANS sigma_scan^2 + (k - 1) s2) / (PRIOR_SCANS + k - 1), for one scan and for the surface alike: scans
    that were fitted onto each other share the error of the network, so two that agree are not twice as sure. Nothing
    is trimmed: between scans of one epoch nothing has changed, so a large difference is an error that counts.
    """
    size = PATCH_IN_SPACINGS * spacing
    patch, centres = _cut_patches(np.concatenate(points), size)
    scan = np.repeat(np.arange(len(points)), [len(p) for p in points])
    groups = _group(patch, scan, np.concatenate(distances), len(points))
    n_scans = np.bincount(groups.patch, minlength=len(centres))
    within = _variance_within(groups, len(centres))
    freedom = np.maximum(n_scans - 1, 0)
    n_overlapping = int((freedom > 0).sum())
    if not n_overlapping:
        return Agreement(np.full(len(vertices), np.nan), float("nan"), size, int((n_scans > 0).sum()), 0)
    pooled = float(max(np.sum(freedom * within) / freedom.sum(), 0.0))
    one = (PRIOR_SCANS * pooled + freedom * np.maximum(within, 0.0)) / (PRIOR_SCANS + freedom)
    seen = n_scans > 0
    sigma = np.sqrt(_spread_to(vertices, centres[seen], one[seen]))
    return Agreement(sigma, float(np.sqrt(pooled)), size, int(seen.sum()), n_overlapping)


def _cut_patches(points: Floats, size: float) -> tuple[Ints, Floats]:
    """Return the patch of each point, cubes of edge `size`, and the patches' centres (p, 3) [m]."""
    cell = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    shape = cell.max(axis=0) + 1
    _, patch = np.unique(np.ravel_multi_index(tuple(cell.T), tuple(shape)), return_inverse=True)
    count = np.bincount(patch)
    centres = np.column_stack([np.bincount(patch, points[:, k]) / count for k in range(3)])
    return patch, centres


def _group(patch: Ints, scan: Ints, distance: Floats, n_scans: int) -> _Groups:
    """Return the figures of each (patch, scan) that has enough points."""
    known = np.isfinite(distance)
    key, group = np.unique(patch[known] * n_scans + scan[known], return_inverse=True)
    n = np.bincount(group)
    mean = np.bincount(group, distance[known]) / n
    spread2 = np.bincount(group, (distance[known] - mean[group]) ** 2) / np.maximum(n - 1, 1)
    enough = n >= FEWEST_POINTS
    return _Groups((key // n_scans)[enough], n[enough], mean[enough], (spread2 / n)[enough])


def _variance_within(groups: _Groups, n_patches: int) -> Floats:
    """Return the variance [m2] of the scans' means in each patch, less what the noise of the means explains."""
    count = np.bincount(groups.patch, minlength=n_patches)
    middle = np.bincount(groups.patch, groups.mean, minlength=n_patches) / np.maximum(count, 1)
    square = np.bincount(groups.patch, (groups.mean - middle[groups.patch]) ** 2, minlength=n_patches)
    noise = np.bincount(groups.patch, groups.variance, minlength=n_patches) / np.maximum(count, 1)
    return np.where(count > 1, square / np.maximum(count - 1, 1) - noise, 0.0)


def _spread_to(vertices: Floats, centres: Floats, variance: Floats) -> Floats:
    """Return the variance [m2] at each vertex: of the patches around it, the near ones counting more."""
    k = min(N_PATCHES_AROUND, len(centres))
    lag, near = cKDTree(centres).query(vertices, k=k, workers=-1)
    lag, near = lag.reshape(-1, k), near.reshape(-1, k)
    weight = 1.0 / np.maximum(lag, 1e-9) ** 2
    return np.asarray((weight * variance[near]).sum(axis=1) / weight.sum(axis=1))
