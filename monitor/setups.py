"""Set-ups of the scanner: several scans taken without moving it, such as the fine windows of the survey targets.

In: the poses of an epoch's scans, or their clouds. Out: which scans are of one set-up, and their clouds in one. Scans
of a set-up have one motion and one range calibration: what the targets in a fine window say holds for the panorama
beside it, and what its walls say of the ranges holds for the windows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from monitor.filtering.merging import concatenate_clouds
from monitor.record import Place
from projects.model import Floats, Ints, PointCloud, SurveyTarget

SAME = 1e-9  # m and rad: poses registered apart are never so alike
SAME_PLACE = 1e-3  # m, of the scanner in the project: no tripod is set up again so near
SAME_TARGET = 0.5  # of a target's radius: targets of one set-up nearer to each other are one


def number_setups(poses: Sequence[Floats], origins: Sequence[Floats] = ()) -> Ints:
    """Return the number (n,) of the set-up of each scan, rising from 0, by its pose T_project_scanner (4, 4) and where
    the scanner stood in the scan's frame (3,) [m], 0 0 0 of all where left out.

    Scans whose pose is the identity may have been brought into the project's frame from anywhere: each stands alone.
    Several in another common frame share its pose and not the scanner's place, or nobody knows that.
    """
    places = origins if len(origins) else [np.zeros(3)] * len(poses)
    numbers: Ints = np.full(len(poses), -1, dtype=np.int64)
    firsts: list[int] = []
    for k, pose in enumerate(poses):
        same = [] if _is_same(pose, np.eye(4)) else [
            j for j, first in enumerate(firsts)
            if _is_same(pose, poses[first]) and np.linalg.norm(places[k] - places[first]) <= SAME_PLACE
        ]  # fmt: skip
        numbers[k] = same[0] if same else len(firsts)
        if not same:
            firsts.append(k)
    return numbers


def setups_of(place: Place) -> Ints:
    """Return the number (n,) of the set-up of each scan of an epoch; repeated scans, which may drift, stand alone."""
    headers = place.project.scan_headers(place.object_id, place.epoch_id)
    if place.project.epoch(place.object_id, place.epoch_id).repeated:
        return np.arange(len(headers))
    return number_setups([header.pose for header in headers], [header.origin for header in headers])


def _is_same(pose: Floats, other: Floats) -> bool:
    """Return whether two poses (4, 4) are one; NaN is like nothing."""
    return bool(np.abs(pose - other).max() <= SAME)  # NaN is like nothing


def join_setups(clouds: Sequence[PointCloud], setups: Ints) -> list[PointCloud]:
    """Return one cloud for each set-up with points, in order; `setups` (n,) numbers the set-up of each cloud.

    A cloud that stands alone is returned as it is. All were measured from one place: the origin stays (3,) where it is
    known of all.
    """
    joined = []
    for number in np.unique(setups):
        members = [c for c, s in zip(clouds, setups, strict=True) if s == number and len(c)]
        if len(members) > 1:
            origins = [c.origins for c in members]
            is_one = all(o is not None and o.shape == (3,) for o in origins)
            joined.append(dataclasses.replace(concatenate_clouds(members), origins=origins[0] if is_one else None))
        else:
            joined += members
    return joined


def join_targets(targets: Sequence[Sequence[SurveyTarget]]) -> list[SurveyTarget]:
    """Return the targets that the scans of one set-up saw, each once, as the scan saw it that knows its centre best."""
    kept: list[SurveyTarget] = []
    for target in sorted((t for seen in targets for t in seen), key=lambda t: float(np.trace(t.covariance))):
        if all(np.linalg.norm(t.centre - target.centre) > SAME_TARGET * t.radius for t in kept):
            kept.append(target)
    return kept
