"""Poses of scans that bring none, from the targets that they share with control points or with other scans.

In: the targets of each scan in its own frame, the poses that are known, control points. Out: the pose of every scan
that three or more shared targets place without ambiguity (`papers/004`), and the reason for each other one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monitor.registration.motion.six_parameters import six_parameters
from monitor.registration.network.ties import control_arrays, sigma_of
from monitor.registration.targets.homologous import PointPairs, match_points
from projects.errors import RegistrationError
from projects.model import ControlPoint, Floats, SurveyTarget
from projects.transforms import apply

SAME_POINT = 0.05  # m: targets of placed scans nearer to a known point are that point


@dataclass(frozen=True)
class Placement:
    """`poses` T_project_scan (n, 4, 4), NaN where targets do not suffice; `reasons` (n,), empty where they do."""

    poses: Floats
    reasons: tuple[str, ...]


def place_scans(
    targets: Sequence[Sequence[SurveyTarget]], poses: Sequence[Floats | None], control: Sequence[ControlPoint] = ()
) -> Placement:
    """Place the scans without poses by their targets.

    Parameters
    ----------
    targets : of each scan, in its own frame.
    poses : T_project_scan of each scan, None where unknown. Where none is known and there is no control, the scan with
        most targets stands in the project's frame.
    control : known points in the project's frame.
    """
    placed: list[Floats | None] = list(poses)
    if not control and all(pose is None for pose in placed):
        placed[int(np.argmax([len(seen) for seen in targets]))] = np.eye(4)
    known, sigma = control_arrays(control)
    for k, pose in enumerate(placed):
        if pose is not None:
            known, sigma = _with_targets(known, sigma, targets[k], pose)
    reasons = {k: "" for k, pose in enumerate(placed) if pose is None}
    while reasons:
        tried = {k: _match(targets[k], known, sigma) for k in reasons}
        found = {k: pairs for k, pairs in tried.items() if isinstance(pairs, PointPairs)}
        reasons = {k: pairs for k, pairs in tried.items() if isinstance(pairs, str)}
        if not found:
            break
        best = max(found, key=lambda k: len(found[k]))
        pose = _pose(targets[best], known, sigma, found.pop(best))
        placed[best] = pose
        known, sigma = _with_targets(known, sigma, targets[best], pose)
        reasons |= dict.fromkeys(found, "")
    unknown = np.full((4, 4), np.nan)
    return Placement(np.array([unknown if p is None else p for p in placed]),
                     tuple(reasons.get(k, "") for k in range(len(placed))))  # fmt: skip


def _match(seen: Sequence[SurveyTarget], known: Floats, sigma: Floats) -> PointPairs | str:
    """Return which targets are which known points, or why that cannot be told."""
    try:
        return match_points(np.array([t.centre for t in seen]).reshape(-1, 3), known, sigma_of(seen), sigma)
    except RegistrationError as error:
        return str(error)


def _pose(seen: Sequence[SurveyTarget], known: Floats, sigma: Floats, pairs: PointPairs) -> Floats:
    """Return the pose from paired points."""
    which = [seen[int(i)] for i in pairs.source]
    return six_parameters(
        np.array([t.centre for t in which]), known[pairs.target],
        np.array([t.covariance for t in which]), np.eye(3) * sigma[pairs.target, None, None] ** 2,
    ).T_target_source  # fmt: skip


def _with_targets(known: Floats, sigma: Floats, seen: Sequence[SurveyTarget], pose: Floats) -> tuple[Floats, Floats]:
    """Return the known points with those targets of a placed scan that are none of them yet."""
    if not len(seen):
        return known, sigma
    places = apply(pose, np.array([t.centre for t in seen]))
    apart = np.linalg.norm(places[:, None] - known[None], axis=2).min(axis=1) if len(known) else np.full(len(places), 1)
    new = apart > SAME_POINT
    return np.concatenate([known, places[new]]), np.concatenate([sigma, sigma_of(seen)[new]])
