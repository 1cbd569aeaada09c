"""What every step asks of its points before it works on them.

In: points or a scan; out: nothing, an error that says what is wrong of which scan, or the scan without what no scanner
measures.
"""

from __future__ import annotations

import numpy as np

from projects.errors import ParameterError
from projects.model import Floats, Scan
from projects.transforms import require_rigid

MIN_POINTS = 8
FARTHEST = 1e12  # m, coordinates: as the readers of files have it; squares of more would not hold


def require_points(points: Floats) -> None:
    """Raise `ParameterError` where there is nothing to fit a plane to."""
    if len(points) < MIN_POINTS:
        raise ParameterError(f"{len(points)} points were given; at least {MIN_POINTS} are needed for a tangent plane")
    require_finite(points, "the cloud")


def require_finite(points: Floats, what: str) -> None:
    """Raise `ParameterError` where a coordinate is not a number, or one of no place that was scanned."""
    good = np.abs(points) <= FARTHEST
    if not good.all():
        n_bad = int((~good).any(axis=1).sum())
        raise ParameterError(
            f"{what}: {n_bad} of {len(points)} points have coordinates that are not finite or exceed {FARTHEST:g} m; "
            "leave them out"
        )


def require_scan(scan: Scan) -> None:
    """Raise `ParameterError`, with the scan's name, where coordinates are not finite or the pose is no rigid motion."""
    require_finite(scan.cloud.points, f"scan {scan.name!r}")
    require_rigid(scan.pose, f"scan {scan.name!r}: its pose")


def without_zero_ranges(scan: Scan) -> Scan:
    """Return the scan without points exactly where the scanner stood; readers drop them, other sources may not."""
    points = scan.cloud.points
    at_scanner = (points[:, 0] == scan.origin[0]) & (points[:, 1] == scan.origin[1]) & (points[:, 2] == scan.origin[2])
    return scan.take(~at_scanner) if at_scanner.any() else scan
