"""The network step of the chain: scans, their targets and the epoch's control in one adjustment.

Step 7 of docs/method.md. In: the steps of the filtered scans and of their targets; scans of one set-up move together.
Out: the step that holds the motion of each scan, covariances and how everything fits; an adjustment that did not
settle is refused with its reason.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from monitor.beside_extent import lie_beside_extent
from monitor.record import Asked, Made, Place, once_step
from monitor.registration.motion.covariance import about
from monitor.registration.motion.held import Frames
from monitor.registration.network.adjustment import Adjustment, AdjustmentSettings, adjust_scans
from monitor.registration.network.snooping import TieFit
from monitor.registration.network.ties import identify_targets, why_none_is_known
from monitor.settings import as_mapping
from monitor.setups import join_setups, join_targets, setups_of
from monitor.target_search import targets_of
from projects.control_held import control_holds_whole
from projects.errors import RegistrationError, StoreError
from projects.model import Floats, Ints, PointCloud, Step, SurveyTarget
from projects.transforms import apply


def adjust_epoch(
    place: Place, settings: AdjustmentSettings, scans: Sequence[Step], targets: Sequence[Step],
    notify: Callable[[str], None],
) -> Step:  # fmt: skip
    """Fit the scans of an epoch onto each other and onto control (`papers/002`; Dorninger & Nothegger 2009)."""
    control = place.project.epoch(place.object_id, place.epoch_id).control
    parameters: dict[str, Any] = {"adjust": as_mapping(settings)}
    if control:
        parameters["control"] = [{"name": c.name, "position": c.position.tolist(), "sigma": c.sigma} for c in control]

    def make() -> Made:
        """Adjust the set-ups that saw the object; refuse where none did, or where the adjustment did not settle."""
        if len(scans) > 1:
            notify(f"{place.epoch_id}: fitting {len(scans)} scans onto each other")
        setups = setups_of(place)[: len(scans)]
        has_points = np.array([len(place.get(step)) > 0 for step in scans])
        seen = [int(np.flatnonzero(setups == s)[0]) for s in np.unique(setups[has_points])]
        if not seen:
            beside = lie_beside_extent(place)
            where = f": {beside}" if beside else ""
            raise StoreError(f"{_why_nothing_is_left(scans)}{where}")
        in_scans = _targets(place, targets, setups, seen)
        found = adjust_scans(_clouds(place, scans, setups, seen), settings, identify_targets(in_scans, control))
        if not found.converged:
            raise RegistrationError(
                f"the scans could not be fitted onto each other: {found.reason}; check their poses, give better ones "
                "with --poses, or keep them as given with the setting adjust.enabled = false"
            )
        figures = _figures(found, seen) | {"n_setups": int(setups.max()) + 1}
        if settings.enabled and not found.ties:  # else the scans stand as they were given, on control or not
            figures["n_control"] = 0
        if control and figures.get("n_control") == 0:
            figures["no_control_reason"] = why_none_is_known(in_scans, control)
        return Made(_as_arrays(found, seen, setups), figures)

    return once_step(place, Asked("network", "network", parameters, (*scans, *targets)), make)


def _why_nothing_is_left(scans: Sequence[Step]) -> str:
    """Return what became of the points of scans of which none is left."""
    counts: Counter[str] = sum((Counter(step.counts) for step in scans), Counter())
    reasons = ", ".join(
        f"{name.replace('_', ' ')} {n}" for name, n in counts.items() if n and name not in ("read", "in")
    )
    return (
        f"no point is left of {counts['read']} in {len(scans)} scan{'s' if len(scans) > 1 else ''} ({reasons}); check "
        "the object's extent, the poses and the unit"
    )


def _clouds(place: Place, scans: Sequence[Step], setups: Ints, seen: Sequence[int]) -> Iterator[PointCloud]:
    """Yield the filtered points of each set-up whose first scan is in `seen`."""
    for first in seen:
        members = [place.get(scans[k]) for k in _members(setups, first)]
        yield from join_setups(members, np.zeros(len(members), dtype=np.int64))


def _members(setups: Ints, first: int) -> list[int]:
    """Return the scans of the set-up that scan `first` belongs to."""
    return [int(k) for k in np.flatnonzero(setups == setups[first])]


def _targets(place: Place, targets: Sequence[Step], setups: Ints, seen: Sequence[int]) -> list[Sequence[SurveyTarget]]:
    """Return the targets of the set-ups that saw the object, in the project's frame; none where none were sought."""
    if not targets:
        return []
    poses = [h.pose for h in place.project.scan_headers(place.object_id, place.epoch_id)]
    return [
        join_targets([[in_project(t, poses[k]) for t in targets_of(place, targets[k])]
                      for k in _members(setups, first)])
        for first in seen
    ]  # fmt: skip


def in_project(target: SurveyTarget, pose: Floats) -> SurveyTarget:
    """Return a target of a scan's frame in the project's, under the pose T_project_scanner."""
    R = pose[:3, :3]
    return replace(target, centre=apply(pose, target.centre), covariance=R @ target.covariance @ R.T)


def _as_arrays(found: Adjustment, seen: Sequence[int], setups: Ints) -> dict[str, np.ndarray]:
    """Return motions and covariances of all scans, those of a set-up alike; of one that saw nothing the identity and
    NaN."""
    n_scans = len(setups)
    motions, centres = np.tile(np.eye(4), (n_scans, 1, 1)), np.full((n_scans, 3), np.nan)
    covariances, is_of = np.full((n_scans, 6, 6), np.nan), np.zeros((n_scans, len(seen)))
    for j, first in enumerate(seen):
        members = setups == setups[first]
        motions[members] = found.motions[j]
        is_of[members, j] = 1.0
        if len(found.covariances):
            covariances[members], centres[members] = found.covariances[j], found.centres[j]
    return {"T_project_given": motions, "covariances": covariances, "centres": centres, "setups": setups,
            "joint_covariance": _spread(found.joint_covariance, is_of),
            "covariance": found.covariance, "centre": found.centre}  # fmt: skip


def _spread(joint: Floats, is_of: Floats) -> Floats:
    """Return the joint covariance of all scans (6 n, 6 n) from that of the set-ups that saw something; `is_of` (n, s)
    is 1 where a scan is of a set-up; NaN for the others, and all over where none is known."""
    take = np.kron(is_of, np.eye(6))
    if not len(joint):
        return np.full((len(take), len(take)), np.nan)
    unknown = np.where(take.any(axis=1), 0.0, np.nan)
    return take @ joint @ take.T + unknown[:, None] + unknown


def _figures(found: Adjustment, seen: Sequence[int]) -> dict[str, Any]:
    """Return what is recorded with the step: fits of pairs, targets and control, variance components, blunders."""
    figures: dict[str, Any] = {
        "applied": found.applied,
        "reason": found.reason,
        "doubt": found.doubt,
        "misfit_before_m": found.sigma_before,
        "misfit_after_m": found.sigma_after,
        "n_iterations": found.n_iterations,
        "pairs": [{**as_mapping(p), "first": seen[p.first], "second": seen[p.second]} for p in found.pairs],
        "alone": _alone(found, seen),
    }
    if not found.ties:
        return figures
    sigma = np.sqrt(np.diag(found.covariance))
    return figures | {
        "ties": [_tie(t, seen) for t in found.ties],
        "n_targets": sum(t.scan >= 0 for t in found.ties),
        "n_control": sum(t.scan < 0 and not t.is_blunder for t in found.ties),
        "blunders": [_place_name(t, seen) for t in found.blunders],
        "target_rms_m": _rms([t for t in found.ties if t.scan >= 0 and not t.is_blunder]),
        "control_rms_m": _rms([t for t in found.ties if t.scan < 0 and not t.is_blunder]),
        "variance_component_targets": found.components.targets,
        "variance_component_control": found.components.control,
        "sigma_position_m": float(np.sqrt(np.mean(sigma[3:] ** 2))),
        "sigma_rotation_rad": float(np.sqrt(np.mean(sigma[:3] ** 2))),
    }


def _alone(found: Adjustment, seen: Sequence[int]) -> list[int]:
    """Return which of several set-ups, by their first scan, nothing ties to another one or to control: their poses are
    as given, whether right or wrong."""
    held = {k for pair in found.pairs for k in (pair.first, pair.second)}
    held |= {fit.scan for fit in found.ties if not fit.is_blunder}
    return [first for k, first in enumerate(seen) if k not in held] if len(seen) > 1 else []


def _tie(fit: TieFit, seen: Sequence[int]) -> dict[str, Any]:
    """Return how one target or control point fits, as it is recorded."""
    return {
        "name": fit.name, "scan": seen[fit.scan] if fit.scan >= 0 else -1, "residual_m": fit.residual.tolist(),
        "statistic": fit.statistic, "redundancy": fit.redundancy, "is_blunder": fit.is_blunder,
        "is_control": fit.is_control,
    }  # fmt: skip


def _place_name(fit: TieFit, seen: Sequence[int]) -> str:
    """Return which observation a blunder is, in words."""
    return f"control point {fit.name}" if fit.scan < 0 else f"{fit.name} in scan {seen[fit.scan] + 1}"


def tell_control(figures: Mapping[str, Any], n_given: int) -> str:
    """Return what is wrong with the targets and the `n_given` control points of an epoch, by the figures of its network
    step: none found, too few to hold the whole, some left out; "" where nothing is."""
    told = []
    n_held = figures.get("n_control")
    if n_given and n_held == 0:
        reason = figures.get("no_control_reason")
        told.append(f"none of its {n_given} control points holds a target of its scans, so control holds nothing"
                    f"{f' ({reason})' if reason else ''}")  # fmt: skip
    elif n_held and not control_holds_whole(figures):
        told.append(f"{n_held} of its {n_given} control points hold targets, and a turn of the whole stays free; how "
                    "sure its frame is takes three that are not on one line")  # fmt: skip
    if figures.get("blunders"):
        told.append(f"left out, as beyond chance against the others: {', '.join(figures['blunders'])}")
    return "; ".join(told)


def _rms(fits: Sequence[TieFit]) -> float:
    """Return the root mean square [m] of the lengths of residuals in space, NaN without any."""
    return float(np.sqrt(np.mean([float(f.residual @ f.residual) for f in fits]))) if fits else float("nan")


def frames_between(networks: Sequence[dict[str, Any]]) -> Frames | None:
    """Return what the frames of two epochs may differ by, both held by control; None where one is not."""
    centre = np.asarray(networks[0].get("centre", np.full(3, np.nan)), dtype=float)
    total = np.zeros((6, 6))
    for network in networks:
        covariance = np.asarray(network.get("covariance", np.nan), dtype=float)
        if covariance.shape != (6, 6) or not np.isfinite(covariance).all():
            return None
        total += about(covariance, centre - np.asarray(network["centre"], dtype=float))
    return Frames(total, centre)


def frames_of(places: Sequence[Place]) -> Frames | None:
    """Return how far the frames of two epochs may differ; None where control holds not both."""
    steps = [p.project.latest(p.object_id, p.epoch_id, "network") for p in places]
    networks = [p.get(step) for p, step in zip(places, steps, strict=True) if step is not None]
    return frames_between(networks) if len(networks) == len(places) else None
