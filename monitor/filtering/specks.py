"""Specks: points in the air, far from all others for how densely the scanner looked there.

In: points, where the scanner stood and the distance to the sixth nearest of each; out: a mask of points.
"""

from __future__ import annotations

import numpy as np

from monitor.blocks import blocks
from monitor.filtering.nearest import PointIndex, build_index, canonical_order, find_nearest_sorted
from projects.model import Bools, Floats, Ints

SIXTH = 6  # nearest, to which `reach` is measured
N_AROUND = 16  # directions whose spacing is the scan's at a place: a stray and five beside it do not decide it
BLOCK = 32_768  # points at a time


def find_isolated(reach: Floats, scale: Floats, isolation: float) -> Bools:
    """Return the points (n,) whose nearest few lie `isolation` times farther than the median of all tells.

    Parameters
    ----------
    reach : (n,) m, distance to the sixth nearest point.
    scale : (n,) m, what the spacing of points is proportional to: the range from the scanner; where it is not known,
        the spacing of the neighbourhood.
    """
    relative = reach / np.maximum(scale, 1e-300)
    return relative > isolation * np.median(relative)


def find_specks(points: Floats, origin: Floats, reach: Floats, isolation: float) -> Bools:
    """Return the points (n,) whose nearest few lie `isolation` times farther than the scan's points do at that range.

    The spacing of a scan is an angle. It is the median of all points, or that of the directions around a point where
    these are wider: an overview beside a window of finer steps is no speck. A point in the air lies before or beside
    surfaces, whose directions are as dense as anywhere.

    Parameters
    ----------
    points, origin : (n, 3) and (3,) m, of the scan and its scanner.
    reach : (n,) m, distance to the sixth nearest point.
    """
    ranges = np.concatenate([np.linalg.norm(points[b] - origin, axis=1) for b in blocks(len(points), BLOCK)])
    specks = find_isolated(reach, ranges, isolation)
    which = np.flatnonzero(specks)
    if len(which):
        around = angles_around(points, origin, which)
        specks[which] = reach[which] > isolation * around * ranges[which]
    return specks


def angles_around(points: Floats, origin: Floats, which: Ints) -> Floats:
    """Return how far apart [rad] the scanner's directions are around the points `which`, to the sixth nearest.

    The median of the `N_AROUND` nearest directions, so that a few strays beside each other have the spacing of what
    lies around them.
    """
    directions = np.empty(points.shape, dtype=np.float32)  # a scan may have tens of millions
    for block in blocks(len(points), BLOCK):
        beams = points[block] - origin
        directions[block] = beams / np.linalg.norm(beams, axis=1, keepdims=True)
    order = canonical_order(directions)
    index = build_index(directions[order])
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    around = np.empty(len(which))
    for block in blocks(len(which), BLOCK):
        near = find_nearest_sorted(index, place[which[block]], min(N_AROUND + 1, len(order)))[:, 1:]
        asked, back = np.unique(near, return_inverse=True)
        around[block] = np.median(_to_sixth(index, asked)[back.reshape(near.shape)], axis=1)
    return around


def _to_sixth(index: PointIndex, which: Ints) -> Floats:
    """Return the angle (len(which),) [rad] of each direction to its sixth nearest."""
    angles = np.empty(len(which))
    for block in blocks(len(which), BLOCK):
        near = find_nearest_sorted(index, which[block], min(SIXTH + 1, len(index.points)))
        angles[block] = np.linalg.norm(index.points[near[:, -1]] - index.points[which[block]], axis=1)
    return angles
