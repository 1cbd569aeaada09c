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
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from monitor.registration.network.steepness import N_CLASSES, Views, expected_at, steepness_of_points
from projects.model import Floats, Ints

PATCH_IN_SPACINGS = 10.0  # edge of a patch: a hundred points average the noise down to a tenth
FEWEST_POINTS = 10  # of a scan in a patch
PRIOR_SCANS = 2.0  # what all patches together say counts in each as much as this many further scans
N_ROUNDS = 4  # of least squares, each weighted by the variances of the one before
N_PATCHES_AROUND = 4  # that a vertex takes its sigma from


@dataclass(frozen=True)
class Agreement:
    """How well the scans of an epoch agree.

    Attributes
    ----------
    sigma : (n,) m, of each vertex, one sigma of the error shared by its neighbourhood; NaN all over where no two
        scans overlap, since nothing shows it then.
    sigma_scan : m, of one scan's patch, over the whole epoch (root mean square over the points).
    sigma_by_incidence : (c,) m, of a patch in each class of incidence (`steepness`): up to 45, 60, 70, 80 degrees, at a
        rim beyond 60, beyond 80; never falling; NaN without overlap.
    patch_size : m.
    n_patches, n_overlapping : patches with points, and those seen by two scans or more.
    """

    sigma: Floats
    sigma_scan: float
    sigma_by_incidence: Floats
    patch_size: float
    n_patches: int
    n_overlapping: int


@dataclass(frozen=True)
class _Groups:
    """Points by (patch, scan, incidence): patch, scan and class of each group, number of points, mean distance [m] and
    the variance of it [m2]."""

    patch: Ints
    scan: Ints
    steepness: Ints
    n: Ints
    mean: Floats
    variance: Floats


@dataclass(frozen=True)
class _Pairs:
    """Two groups of one patch from different scans: patch, classes (k, 2), squared difference [m2] of their means less
    its noise, and weight: a patch of s scans counts s - 1."""

    patch: Ints
    steepness: Ints
    squares: Floats
    weight: Floats


def assess_agreement(
    vertices: Floats,
    points: Sequence[Floats],
    distances: Sequence[Floats],
    spacing: float,
    views: Views | None = None,
) -> Agreement:
    """Estimate the error that whole patches of a scan share, from where scans overlap.

    Parameters
    ----------
    vertices : (n, 3) m, of the epoch's surface.
    points : of each scan, (k, 3) m, in the frame of the surface.
    distances : of each scan, (k,) m, signed, of its points to the surface; NaN where unknown.
    spacing : m, typical distance between neighbouring points.
    views : how all these points were seen; without them all count as seen from the front.

    Notes
    -----
    Two scans that see a patch, one at incidence a, the other at b, differ in their mean distances by variance
    s(a)^2 + s(b)^2 beside the noise of the means. A spot that partly misses a bent surface errs by tenths of its size
    and to one side, so s grows with the incidence, by the surface's own normals (`steepness`): it is found in steps
    that do not fall, by non-negative least squares over all patches, each difference weighted by what is expected of
    it. A vertex takes the square of the mean of s over the points about it, times (PRIOR_SCANS + (k - 1) r) /
    (PRIOR_SCANS + k - 1) of its patch, r being what its k scans differ by over what is expected of them. The surface
    errs as one scan does: scans that were fitted onto each other share the error of the network, so two that agree are
    not twice as sure. Nothing is trimmed: between scans of one epoch nothing has changed, so a large difference is an
    error that counts.
    """
    size = PATCH_IN_SPACINGS * spacing
    patch, centres = cut_cubes(np.concatenate(points), size)
    scan = np.repeat(np.arange(len(points)), [len(p) for p in points])
    steepness = steepness_of_points(views, vertices, np.concatenate(points))
    groups = _group(np.column_stack([patch, scan, steepness]), np.concatenate(distances))
    n_scans = _count_scans(groups, len(centres))
    n_overlapping, seen = int((n_scans > 1).sum()), n_scans > 0
    if not n_overlapping:
        unknown = np.full(N_CLASSES, np.nan)
        return Agreement(np.full(len(vertices), np.nan), float("nan"), unknown, size, int(seen.sum()), 0)
    pairs = _pair(groups, n_scans)
    variances = _variance_by_incidence(pairs)
    factor = spread_to(vertices, centres[seen], _own_factor(pairs, variances, n_scans)[seen])
    sigma = np.sqrt(factor * expected_at(views, vertices, np.concatenate(points), steepness, variances))
    pooled = float(groups.n @ variances[groups.steepness] / groups.n.sum())
    return Agreement(sigma, float(np.sqrt(pooled)), np.sqrt(variances), size, int(seen.sum()), n_overlapping)


def cut_cubes(points: Floats, size: float) -> tuple[Ints, Floats]:
    """Return the patch of each point, cubes of edge `size`, and the patches' centres (p, 3) [m]."""
    cell = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    shape = cell.max(axis=0) + 1
    _, patch = np.unique(np.ravel_multi_index(tuple(cell.T), tuple(shape)), return_inverse=True)
    count = np.bincount(patch)
    centres = np.column_stack([np.bincount(patch, points[:, k]) / count for k in range(3)])
    return patch, centres


def _group(keys: Ints, distance: Floats) -> _Groups:
    """Return the figures of each (patch, scan, class) that has enough points; `keys` (k, 3) are those of the points."""
    known = np.isfinite(distance)
    distance = distance[known]
    key, group = np.unique(keys[known], axis=0, return_inverse=True)
    group = group.reshape(-1)
    n = np.bincount(group)
    mean = np.bincount(group, distance) / n
    spread2 = np.bincount(group, (distance - mean[group]) ** 2) / np.maximum(n - 1, 1)
    enough = n >= FEWEST_POINTS
    patch, scan, steepness = key[enough].T
    return _Groups(patch, scan, steepness, n[enough], mean[enough], (spread2 / n)[enough])


def _count_scans(groups: _Groups, n_patches: int) -> Ints:
    """Return the number of scans (n_patches,) that see each patch."""
    pairs = np.unique(np.column_stack([groups.patch, groups.scan]), axis=0)
    return np.bincount(pairs[:, 0], minlength=n_patches)


def _pair(groups: _Groups, n_scans: Ints) -> _Pairs:
    """Return all pairs of groups of one patch and different scans."""
    first = np.searchsorted(groups.patch, groups.patch, side="left")  # groups are sorted by patch
    n_before = np.arange(len(first)) - first
    j = np.repeat(np.arange(len(first)), n_before)
    i = np.arange(len(j)) - np.repeat(np.cumsum(n_before) - n_before, n_before) + first[j]
    other = groups.scan[i] != groups.scan[j]
    i, j = i[other], j[other]
    squares = (groups.mean[i] - groups.mean[j]) ** 2 - groups.variance[i] - groups.variance[j]
    patch = groups.patch[j]
    n_pairs = np.bincount(patch, minlength=len(n_scans))
    weight = (n_scans - 1)[patch] / n_pairs[patch]
    return _Pairs(patch, np.column_stack([groups.steepness[i], groups.steepness[j]]), squares, weight)


def _variance_by_incidence(pairs: _Pairs) -> Floats:
    """Return the variance (c,) [m2] of one scan's patch in each class of incidence, never falling.

    A class that no pair holds is as the one before it: steeper than anything that overlaps.
    """
    steps = np.arange(N_CLASSES)
    rows = (pairs.steepness[:, :, None] >= steps).sum(axis=1).astype(float)
    expected = np.full(len(rows), max(float(pairs.weight @ pairs.squares / pairs.weight.sum()), 0.0))
    variances = np.zeros(len(steps))
    for _ in range(N_ROUNDS):
        weight = np.sqrt(pairs.weight) / np.maximum(expected, max(1e-3 * float(expected.max()), 1e-300))
        scale = float(weight.max())
        increments, _ = nnls(rows * (weight / scale)[:, None], pairs.squares * (weight / scale))
        variances, expected = np.cumsum(increments), rows @ increments
    return variances


def _own_factor(pairs: _Pairs, variances: Floats, n_scans: Ints) -> Floats:
    """Return by how much the variance of each patch (n,) is raised or lowered by what its own scans show."""
    expected = variances[pairs.steepness].sum(axis=1)
    ratio = np.divide(pairs.squares, expected, out=np.ones(len(expected)), where=expected > 0.0)
    total = np.bincount(pairs.patch, minlength=len(n_scans))
    mean = np.bincount(pairs.patch, ratio, minlength=len(n_scans)) / np.maximum(total, 1)
    freedom = np.maximum(n_scans - 1, 0)
    return np.asarray((PRIOR_SCANS + freedom * np.maximum(mean, 0.0)) / (PRIOR_SCANS + freedom))


def spread_to(vertices: Floats, centres: Floats, variance: Floats) -> Floats:
    """Return the variance [m2] at each vertex: of the patches around it, the near ones counting more."""
    k = min(N_PATCHES_AROUND, len(centres))
    lag, near = cKDTree(centres).query(vertices, k=k, workers=-1)
    lag, near = lag.reshape(-1, k), near.reshape(-1, k)
    weight = 1.0 / np.maximum(lag, 1e-9) ** 2
    return np.asarray((weight * variance[near]).sum(axis=1) / weight.sum(axis=1))
