"""Poses of scans that bring none and show no survey targets, from their shapes alone.

In: scan streams, some with poses. Out: the poses of all in one frame, or which could not be placed. Good enough for the
adjustment of all scans, which follows when the epoch is processed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from monitor.filtering import estimate_normals
from monitor.filtering.drawing_order import hash_points
from monitor.filtering.soundness import MIN_POINTS
from monitor.registration.anywhere.assembly import Assembly, assemble
from projects.errors import ParameterError
from projects.formats import ScanStream
from projects.model import Floats, PointCloud
from projects.transforms import invert

N_POINTS = 60_000  # of each scan: places of shape are some hundred


def assemble_streams(streams: Sequence[ScanStream]) -> Floats:
    """Return T_project_scan (n, 4, 4) of the scans put together by shape, NaN where one was not placed.

    The frame is that of the scans whose poses are known, through the first of them that was placed; where none is, it
    is the first scan's own. Poses that are known stay.
    """
    found = assemble([read_oriented(stream) for stream in streams])
    return into_project_frame(found, [stream.pose for stream in streams])


def into_project_frame(found: Assembly, known: Sequence[Floats | None]) -> Floats:
    """Return the poses (n, 4, 4) of an assembly in the frame of the known ones, or of the first scan."""
    poses = np.full((len(known), 4, 4), np.nan)
    placed = np.flatnonzero(found.is_placed)
    tied = [k for k in placed.tolist() if known[k] is not None]
    if not len(placed) or (not tied and any(pose is not None for pose in known)):
        return np.array([own if pose is None else pose for pose, own in zip(known, poses, strict=True)])
    fixed = tied[0] if tied else int(placed[0])
    pose = known[fixed]
    T_project_first = (np.eye(4) if pose is None else pose) @ invert(found.T_first_scan[fixed])
    for k, own in enumerate(known):
        if own is not None:
            poses[k] = own
        elif found.is_placed[k]:
            poses[k] = T_project_first @ found.T_first_scan[k]
    return poses


def _draw(points: Floats, share: float) -> Floats:
    """Return about a share of points, the same ones wherever they stand."""
    return points[hash_points(points, 0) <= min(1.0, share) * float(2**64 - 1)]


def read_oriented(stream: ScanStream) -> PointCloud:
    """Return about `N_POINTS` points of a scan, drawn evenly whatever their order, with oriented normals."""
    some: Floats = np.empty((0, 3))
    n = 0
    for chunk in stream.chunks():  # never all of them: those that a smaller share leaves are among those before
        n += len(chunk.cloud)
        some = _draw(np.concatenate([some, chunk.cloud.points]), N_POINTS / max(n, 1))
    some = some[np.isfinite(some).all(axis=1)]
    if len(some) < MIN_POINTS:
        raise ParameterError(
            f"{stream.name}: {len(some)} points have no shape to place scans by; give --poses FILE with a line for each"
        )
    origin = stream.origin if stream.is_origin_stated else None
    return estimate_normals(PointCloud(some, origins=origin))
