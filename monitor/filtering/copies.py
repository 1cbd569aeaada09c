"""Points that are copies of others and no measurements. In: points (n, 3) in canonical order. Out: a mask."""

from __future__ import annotations

import numpy as np

from monitor.filtering.nearest import canonical_order
from monitor.filtering.rounding import AXES, cell_codes, find_repeats, find_step
from projects.model import Bools, Floats, PointCloud

MOST_COPIES = 6  # of a point: with more, its six nearest lie where it lies, and it has no spacing
MANY_MORE, FEW = 3.0, 10  # times what chance brings into one cell, and points besides, that are no chance


def find_copies(points: Floats, step: float = 0.0) -> Bools:
    """Return which points (n, 3) in canonical order are copies of one before them that are no measurements.

    No two measurements are at exactly one place, unless coordinates are rounded, to `step` [m]. Then copies are told
    where a file holds its scan, or a part of it, more than once, and where more than `MOST_COPIES` lie at one place: a
    program put there what it did not measure.
    """
    again = find_repeats(points)
    if step == 0.0 or not again.any() or again.sum() > MANY_MORE * count_chance(points, step) + FEW:
        return again
    counts = np.diff(np.append(np.flatnonzero(~again), len(points)))
    return again & np.repeat(counts > MOST_COPIES, counts)


def without_copies(cloud: PointCloud) -> PointCloud:
    """Return a cloud, in whatever order, without points that are copies of others; the cloud itself where none is.

    Points that are there twice bear witness twice: fits are held to be surer than they are, and wider ones refused.
    """
    first = np.sort(cloud.points[:, 0])
    if not (first[1:] == first[:-1]).any():
        return cloud
    known = np.flatnonzero(np.isfinite(cloud.points).all(axis=1))
    order = known[canonical_order(cloud.points[known])]
    ordered = cloud.points[order]
    keep = np.ones(len(cloud), dtype=np.bool_)
    keep[order[find_copies(ordered, find_step(ordered))]] = False
    return cloud if keep.all() else cloud.take(np.flatnonzero(keep))


def count_chance(points: Floats, step: float) -> int:
    """Return about how many points chance brings into the cell of another: as many as into the cell beside it, along
    whichever axis these are most."""
    codes = cell_codes(points, step)
    return max(int(np.isin(codes + k, codes).sum()) for k in AXES)
