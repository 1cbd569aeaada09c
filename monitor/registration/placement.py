"""How well the scans of an epoch are placed, seen at its surface: the part of the network's error that overlaps hide.

In: the surface's vertices, the scans' points with normals, and the covariances of an adjustment. Out: for every vertex
one sigma along the normal. Scans around a body that all lie outwards by as much fit each other as well as before, and
the body is too large: only the covariance of the adjustment knows how little holds that (n' J C J' n).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from monitor.registration.agreement import PATCH_IN_SPACINGS, cut_cubes, spread_to
from monitor.registration.sampling import motion_rows
from projects.model import Floats, Ints, PointCloud


def placement_sigma(
    vertices: Floats, clouds: Sequence[PointCloud], spacing: float, covariances: Floats, centres: Floats
) -> Floats:
    """Return one sigma (n,) [m] along the normal of where the adjustment put the scans that each vertex comes from.

    Parameters
    ----------
    vertices : (n, 3) m.
    clouds : of each scan, registered, with normals.
    spacing : m, typical distance between neighbouring points.
    covariances, centres : (s, 6, 6) rad, m about (s, 3) m, of each scan's motion; a scan of which they are NaN (its
        pose was given and stays) counts as well placed, since its error shows where it overlaps others.

    Notes
    -----
    Where several scans see a patch, their variances are averaged over the points and not divided by their number: scans
    that were fitted onto each other err together.
    """
    known = [k for k, c in enumerate(clouds) if c.normals is not None and len(c) and np.isfinite(covariances[k]).all()]
    if not known:
        return np.zeros(len(vertices))
    points = np.concatenate([clouds[k].points for k in known])
    variance = np.concatenate([_variance_at(clouds[k], covariances[k], centres[k]) for k in known])
    patch, middles = cut_cubes(points, PATCH_IN_SPACINGS * spacing)
    mean = _mean_by(patch, variance)
    return np.sqrt(spread_to(vertices, middles, mean))


def _variance_at(cloud: PointCloud, covariance: Floats, centre: Floats) -> Floats:
    """Return the variance (k,) [m2] along the normal of each point of a scan so placed; NaN without a normal."""
    assert cloud.normals is not None
    rows = motion_rows(cloud.points, cloud.normals, centre)
    return np.asarray(np.einsum("ni,ij,nj->n", rows, covariance, rows))


def _mean_by(member: Ints, values: Floats) -> Floats:
    """Return the mean (n,) of the finite values of each member, 0 where there is none."""
    finite = np.isfinite(values)
    n = int(member.max()) + 1
    count = np.bincount(member[finite], minlength=n)
    return np.asarray(np.bincount(member[finite], values[finite], n) / np.maximum(count, 1))
