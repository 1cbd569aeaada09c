"""Scans that nobody registered, whose files put all of them in one place: the identity stands for every pose.

In: scan streams with the poses of their files. Out: the same, without poses where the scans show that they cannot be
right: each was measured from 0 0 0 of its own frame, as its grid of even steps says, and from one place two of them
would have met other things in the same directions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from monitor.vantage import MOST_DOUBLE, cells_of, share_of_double, some_points
from projects.formats import ScanStream
from projects.model import Bools, Floats, Ints, Scan

UNEVEN = 0.2  # of the middle step of a grid, half of all steps within: as seen from elsewhere they go with the ranges
LEAST_STEPS = 1000  # of a grid, to be judged
LEAST_SHARED = 1000  # points in directions that both scans measured


def forget_common_place(streams: Sequence[ScanStream]) -> list[ScanStream]:
    """Return the streams without poses where all of them are the identity and cannot be, else as they are."""
    if len(streams) < 2 or any(s.pose is None or not s.is_grid or (s.pose != np.eye(4)).any() for s in streams):
        return list(streams)
    beams = [beams_in_own_frame(stream) for stream in streams]
    known = [b for b in beams if b is not None]
    if len(known) < len(streams) or not any(are_of_two_places(a, b) for a, b in combinations(known, 2)):
        return list(streams)
    return [replace(stream, pose=None, origin=np.zeros(3), is_origin_stated=True) for stream in streams]


def beams_in_own_frame(stream: ScanStream) -> Floats | None:
    """Return beams (n, 3) [m] of a scan from 0 0 0, evenly taken; None where its grid does not say it stood there."""
    if stream.is_origin_stated and stream.origin.any():
        return None
    first = next(iter(stream.chunks()), None)
    return some_points(stream) if first is not None and unevenness(first) <= UNEVEN else None


def unevenness(scan: Scan) -> float:
    """Return the spread of the angles, seen from 0 0 0, between neighbours along the columns of a grid, as a share of
    the middle one: half of all lie within it. NaN of few."""
    if scan.rows is None or scan.columns is None:
        return float("nan")
    order = np.lexsort((scan.rows, scan.columns))
    rows, columns, points = scan.rows[order], scan.columns[order], scan.cloud.points[order]
    is_next = (np.diff(rows) == 1) & (np.diff(columns) == 0)
    if is_next.sum() < LEAST_STEPS:
        return float("nan")
    ways = points / np.maximum(np.linalg.norm(points, axis=1), 1e-300)[:, None]
    steps = 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(np.diff(ways, axis=0)[is_next], axis=1), 0.0, 1.0))
    low, middle, high = np.quantile(steps, [0.25, 0.5, 0.75])
    return float((high - low) / max(middle, 1e-300))


def are_of_two_places(beams: Floats, other: Floats) -> bool:
    """Return whether two scans, beams (n, 3) and (m, 3) [m] from 0 0 0, met other things in the same directions."""
    both = np.concatenate([beams, other])
    cells, width = cells_of(both)
    of_first = np.arange(len(both)) < len(beams)
    shared = np.isin(cells, np.intersect1d(cells[of_first], cells[~of_first]))
    ranges = np.linalg.norm(both, axis=1)
    if shared.sum() < LEAST_SHARED:
        return False
    alone = max(_double(cells, ranges, width, shared & of_first), _double(cells, ranges, width, shared & ~of_first))
    return _double(cells, ranges, width, shared) > MOST_DOUBLE + alone


def _double(cells: Ints, ranges: Floats, width: float, which: Bools) -> float:
    """Return the share of points (n,) of a mask in cells that show two sheets."""
    return share_of_double(cells[which], ranges[which], width)
