"""How well the scans of an epoch are placed, seen at its surface: the part of the network's error that overlaps hide.

In: the surface's vertices, the scans' points with normals, and the joint covariance of an adjustment. Out: for every
vertex one sigma along the normal. Scans around a body that all lie outwards by as much fit each other as well as
before, and the body is too large: only the covariance of the adjustment knows how little holds that (n' J C J' n).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from monitor.registration.motion.sampling import motion_rows
from monitor.registration.network.agreement import PATCH_IN_SPACINGS, cut_cubes, spread_to
from projects.model import Floats, Ints, PointCloud


@dataclass(frozen=True)
class Placement:
    """How p patches of a surface follow the motions of its s scans.

    `middles` (p, 3) m; `rows` (p, 6 s) how far each goes along its normal under the motions of the scans that see it,
    each by its share of the points, and `common` (p, 6) under one motion of them all; `n_points` (p,) of each;
    `covariance` (6 s, 6 s) rad, m of the motions.
    """

    middles: Floats
    rows: Floats
    common: Floats
    n_points: Floats
    covariance: Floats


def lay_out_placement(
    clouds: Sequence[PointCloud], spacing: float, joint_covariance: Floats, centres: Floats
) -> Placement | None:
    """Return how the patches of a surface follow the motions of its scans; None where none of these was estimated.

    Parameters
    ----------
    clouds : of each scan, registered, with normals.
    spacing : m, typical distance between neighbouring points.
    joint_covariance, centres : (6 s, 6 s) rad, m about (s, 3) m, of the motions of all scans; one of which they are NaN
        (its pose was given and stays) counts as well placed, since its error shows where it overlaps others.
    """
    known = [k for k, c in enumerate(clouds) if c.normals is not None and len(c)]
    known = [k for k in known if np.isfinite(joint_covariance[6 * k, 6 * k])]
    if not known:
        return None
    points = np.concatenate([clouds[k].points for k in known])
    patch, middles = cut_cubes(points, PATCH_IN_SPACINGS * spacing)
    count = np.bincount(patch).astype(float)
    rows: Floats = np.zeros((len(count), 6 * len(known)))
    common: Floats = np.zeros((len(count), 6))
    start, middle = 0, points.mean(axis=0)
    for j, k in enumerate(known):
        member = patch[start : start + len(clouds[k])]
        start += len(clouds[k])
        rows[:, 6 * j : 6 * j + 6] = _sum_of_rows(clouds[k], centres[k], member, len(count))
        common += _sum_of_rows(clouds[k], middle, member, len(count))
    unknowns = (6 * np.array(known)[:, None] + np.arange(6)).ravel()
    covariance = joint_covariance[np.ix_(unknowns, unknowns)]
    return Placement(middles, rows / count[:, None], common / count[:, None], count, covariance)


def placement_sigma(vertices: Floats, placement: Placement | None, weights: Floats | None = None) -> Floats:
    """Return one sigma (n,) [m] along the normal of where the adjustment put the scans that each vertex comes from;
    0 where there is no `placement`.

    Parameters
    ----------
    vertices : (n, 3) m.
    weights : (n,) with which the registration of the epoch holds to the vertices; to all points alike where left out.

    Notes
    -----
    The surface follows the mean of the scans that see a patch: its row over all motions is the mean of
    n'(w x (x - c) + t). What the scans do in common as one rigid body is taken out, since the registration of the epoch
    finds that anew and states it (least squares over the patches, by the weights that it gives them); what bends or
    swells the whole stays. A part that the registration leaves out, or hardly holds to as one that stands off, is as
    sure as scans that see it are placed against those that see the rest.
    """
    if placement is None:
        return np.zeros(len(vertices))
    p = placement
    of_patch = p.n_points if weights is None else _sum_over_patches(p.middles, vertices, weights)
    rows = _less_common(p.rows, p.common, of_patch if np.any(of_patch) else p.n_points)
    return np.sqrt(spread_to(vertices, p.middles, np.einsum("pi,ij,pj->p", rows, p.covariance, rows, optimize=True)))


def _sum_over_patches(middles: Floats, vertices: Floats, weights: Floats) -> Floats:
    """Return the weight of each patch (p,): that of the vertices next to it."""
    patch = cKDTree(middles).query(vertices, workers=-1)[1]
    return np.bincount(patch, weights, len(middles)).astype(float)


def _sum_of_rows(cloud: PointCloud, centre: Floats, member: Ints, n: int) -> Floats:
    """Return the sum (n, 6) over each patch of how far points go along their normals under a motion about `centre`."""
    assert cloud.normals is not None
    rows = np.nan_to_num(motion_rows(cloud.points, cloud.normals, centre))  # a point without a normal says nothing
    return np.column_stack([np.bincount(member, rows[:, k], n) for k in range(6)])


def _less_common(rows: Floats, common: Floats, weight: Floats) -> Floats:
    """Return the rows (p, u) less the rigid motion of the whole that follows them best; `common` (p, 6) is its rows."""
    root = np.sqrt(weight)[:, None]
    return np.asarray(rows - common @ np.linalg.lstsq(root * common, root * rows, rcond=1e-9)[0])
