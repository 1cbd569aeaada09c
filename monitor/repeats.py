"""An epoch of repeated scans from one station (`add-epoch --repeated`): averaged to one scan, which is then filtered.

In: the stored scans of the epoch, their calibrations and the settings; out: one step, the filtered mean of them all.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from monitor.engine import Engine
from monitor.filtering import Calibration, FilterSettings, average_scans, correct_range, filter_scan_with_record
from monitor.range_calibration import calibration_of
from monitor.record import Asked, Made, Place, latest_step, once_step
from monitor.scans import read_within
from monitor.settings import as_mapping
from projects.model import PointCloud, Scan, Step


@dataclass(frozen=True)
class RepeatsTask:
    """Repeated scans within the object's extent, ready to be averaged and filtered anywhere."""

    scans: tuple[Scan, ...]
    settings: FilterSettings
    counts: Mapping[str, int]
    calibrations: tuple[Calibration | None, ...]


def is_averaged(place: Place, settings: FilterSettings) -> bool:
    """Return whether the scans of an epoch are averaged: repeated, several, and known where they stood."""
    headers = place.project.scan_headers(place.object_id, place.epoch_id)
    is_repeated = place.project.epoch(place.object_id, place.epoch_id).repeated and len(headers) > 1
    return settings.averaging.enabled and is_repeated and all(np.isfinite(h.origin).all() for h in headers)


def filter_repeats(
    place: Place, settings: FilterSettings, calibrations: Sequence[Step | None], engine: Engine,
    notify: Callable[[str], None],
) -> Step:  # fmt: skip
    """Average the scans of an epoch and filter their mean (paper 003, section 4.2); one step, `scan000`."""
    names = [h.name for h in place.project.scan_headers(place.object_id, place.epoch_id)]

    def make() -> Made:
        """Read all of the scans, average and filter them as one."""
        notify(f"{place.epoch_id}: averaging {len(names)} repeated scans")
        read = [read_within(place.project, place.object_id, place.epoch_id, k) for k in range(len(names))]
        counts: Counter[str] = sum((Counter(c) for _, c in read), Counter())
        found = tuple(calibration_of(place, step) for step in calibrations)
        task = RepeatsTask(tuple(scan for scan, _ in read), settings, {"read": 0, "outside_extent": 0} | counts, found)
        (made,) = engine.map(repeats_task, [task])
        return replace(made, noun=replace(made.noun, scan_index=np.zeros(len(made.noun), dtype=np.int32)))

    extent = place.project.object(place.object_id).extent
    given = {"filter": as_mapping(settings), "extent": extent, "scan": 0, "name": names[0], "repeats": len(names)}
    inputs = (latest_step(place, "raw"), *(step for step in calibrations if step is not None))
    return once_step(place, Asked("scan000", "averaged", given, inputs), make)


def repeats_task(task: RepeatsTask) -> Made:
    """Average and filter (runs on any worker); what saw nothing of the object is skipped, and said to be."""
    if not any(len(scan.cloud) for scan in task.scans):
        return Made(PointCloud(np.empty((0, 3))), {"skipped": "no point within the extent"}, task.counts)
    pairs = zip(task.scans, task.calibrations, strict=True)
    averaged = average_scans([s if c is None else correct_range(s, c) for s, c in pairs], task.settings.averaging)
    result = filter_scan_with_record(averaged.scan, task.settings)
    lost = {reason: n for reason, n in averaged.counts.items() if reason not in ("in", "out")}
    rounded = {name: step for name, step in averaged.automatic.items() if name == "coordinate_step"}
    automatic = {**result.automatic, **rounded, "averaging": averaged.automatic}
    return Made(result.cloud, automatic, {**task.counts, **lost, **result.counts})
