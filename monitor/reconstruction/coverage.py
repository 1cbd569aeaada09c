"""Which points got no surface, and why: too sparse for the epoch's cell size, or two sheets too near each other.

In: a surface, the cloud it was made of. Out: counts for the record. What is left open is no error, but must be said.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from projects.model import Floats, Ints, PointCloud, Surface

N_LOOKED_AT = 24  # vertices or points near a point, among which one of its own or of the opposite sheet is sought
COS_SAME_SHEET, COS_OPPOSITE = 0.0, -0.7


def count_uncovered(surface: Surface, cloud: PointCloud, farthest: float) -> dict[str, int]:
    """Count points without a vertex of their sheet within `farthest` (m), and points where two sheets are unresolved.

    A vertex is of a point's sheet where its normal is within 90 degrees of the point's. The second count is of points
    whose vertex lies beside a place left open between two near sheets, or that have none and an opposite sheet near.
    What else has no surface lies where points are too sparse, or in pieces too small to be kept.
    """
    assert cloud.normals is not None
    assert surface.normals is not None
    nearest = nearest_looking(surface.vertices, surface.normals, cloud, farthest, COS_SAME_SHEET)
    lost = nearest < 0
    without = PointCloud(cloud.points[lost], normals=cloud.normals[lost])
    opposite = nearest_looking(cloud.points, -cloud.normals, without, farthest, -COS_OPPOSITE)
    at_opposite = int(np.count_nonzero(opposite >= 0))
    if surface.is_unresolved is not None:
        at_opposite += int(np.count_nonzero(surface.is_unresolved[nearest[~lost]]))
    return {"points_without_surface": int(np.count_nonzero(lost)), "points_at_unresolved_sheets": at_opposite}


def nearest_looking(
    places: Floats, directions: Floats, cloud: PointCloud, farthest: float, least_cosine: float
) -> Ints:
    """Return for each point the nearest of `places` within `farthest` (m) that looks the point's way, -1 for none.

    `least_cosine` is between a place's direction and the point's normal; the nearest few places are looked at.
    """
    assert cloud.normals is not None
    out = np.full(len(cloud), -1, np.int64)
    tree = cKDTree(places)
    for k in (1, min(N_LOOKED_AT, len(places))):
        todo = np.flatnonzero(out < 0)
        distance, index = tree.query(cloud.points[todo], k=[*range(1, k + 1)], distance_upper_bound=farthest, workers=2)
        is_near = np.isfinite(distance)
        index = np.where(is_near, index, 0)
        fits = is_near & (np.einsum("ijk,ik->ij", directions[index], cloud.normals[todo]) > least_cosine)
        first = np.argmax(fits, axis=1)
        row = np.arange(len(todo))
        out[todo] = np.where(fits[row, first], index[row, first], -1)
    return out
