"""The survey targets of each scan of an epoch, looked for in the whole scan, and kept with it.

In: the stored scans (targets stand beside the object, so its extent does not count here), corrected by their range
calibration. Out: one step a scan, and its `SurveyTarget`s.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from monitor.engine import Engine
from monitor.filtering import Calibration
from monitor.filtering.calibration import correct_range
from monitor.range_calibration import calibration_of
from monitor.record import Asked, Made, Place, find_step, latest_step, put_step
from monitor.registration.targets.finding import TargetSettings, find_targets
from monitor.scans import join_thinned
from monitor.settings import as_mapping
from projects.model import Scan, Step, SurveyTarget


@dataclass(frozen=True)
class TargetTask:
    """One scan, ready to be searched anywhere."""

    scan: Scan
    settings: TargetSettings
    calibration: Calibration | None


def is_wanted(place: Place, settings: TargetSettings) -> bool:
    """Return whether targets are looked for: where the epoch has control points, or as the settings say."""
    has_control = bool(place.project.epoch(place.object_id, place.epoch_id).control)
    return settings.search == "always" or (settings.search == "controlled" and has_control)


def search_targets(
    place: Place, settings: TargetSettings, calibrations: Sequence[Step | None], engine: Engine,
    notify: Callable[[str], None],
) -> list[Step]:  # fmt: skip
    """Return the step of each scan that holds its targets; none where they are not wanted."""
    if not is_wanted(place, settings):
        return []
    headers = place.project.scan_headers(place.object_id, place.epoch_id)
    raw = latest_step(place, "raw")
    asked = [
        Asked(f"targets{k:03d}", "targets", {"targets": as_mapping(settings), "scan": k, "name": header.name},
              (raw,) if step is None else (raw, step))
        for k, (header, step) in enumerate(zip(headers, calibrations, strict=True))
    ]  # fmt: skip
    steps = [find_step(place, a) for a in asked]
    missing = [k for k, step in enumerate(steps) if step is None]

    def tasks() -> Iterator[TargetTask]:
        """Yield the scans that are missing one by one, thinned."""
        for k in missing:
            notify(f"{place.epoch_id}: looking for targets, scan {k + 1} of {len(headers)} ({headers[k].name})")
            yield TargetTask(read_thinned(place, k), settings, calibration_of(place, calibrations[k]))

    started = time.perf_counter()
    for k, made in zip(missing, engine.map(target_task, tasks()), strict=True):
        finished = time.perf_counter()
        steps[k] = put_step(place, asked[k], made, finished - started)
        started = finished
    return [step for step in steps if step is not None]


def target_task(task: TargetTask) -> Made:
    """Search one scan (runs on any worker)."""
    scan = task.scan if task.calibration is None else correct_range(task.scan, task.calibration)
    found = find_targets(scan, task.settings)
    kinds = {kind: sum(t.kind == kind for t in found) for kind in ("sphere", "board")}
    return Made(as_arrays(found), counts={"spheres": kinds["sphere"], "boards": kinds["board"]})


def read_thinned(place: Place, index: int) -> Scan:
    """Return a whole stored scan; of one that is too large, every n-th row and column."""
    n_points = place.project.scan_headers(place.object_id, place.epoch_id)[index].n_points
    return join_thinned(place.project.iterate_scan(place.object_id, place.epoch_id, index), n_points)


def as_arrays(targets: Sequence[SurveyTarget]) -> dict[str, np.ndarray]:
    """Return targets as a step keeps them."""
    return {
        "centre": np.array([t.centre for t in targets], dtype=float).reshape(-1, 3),
        "covariance": np.array([t.covariance for t in targets], dtype=float).reshape(-1, 3, 3),
        "is_board": np.array([t.kind == "board" for t in targets], dtype=bool),
        "radius": np.array([t.radius for t in targets], dtype=float),
        "residual": np.array([t.residual for t in targets], dtype=float),
        "n_points": np.array([t.n_points for t in targets], dtype=np.int64),
        "completeness": np.array([t.completeness for t in targets], dtype=float),
    }


def targets_of(place: Place, step: Step) -> list[SurveyTarget]:
    """Return the targets that a step holds, in the scan's frame."""
    kept = place.get(step)
    columns = (kept[name] for name in ("is_board", "centre", "covariance", "radius", "residual", "n_points",
                                       "completeness"))  # fmt: skip
    return [
        SurveyTarget("board" if is_board else "sphere", centre, covariance, float(radius), float(residual), int(n),
                     float(completeness))
        for is_board, centre, covariance, radius, residual, n, completeness in zip(*columns, strict=True)
    ]  # fmt: skip
