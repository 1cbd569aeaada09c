"""Each scan of an epoch filtered by itself (steps 0 to 6), on as many workers as there are.

In: the stored scans, their calibrations and the settings; out: of each one step with its thinned points, and one with
what was left out and another station may bear out. Repeated scans are filtered as one, their mean.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from monitor.engine import Engine
from monitor.filtering import Calibration, FilterSettings, filter_scan_with_record
from monitor.range_calibration import calibration_of
from monitor.record import Asked, Made, Place, find_step, latest_step, put_step
from monitor.repeats import filter_repeats, is_averaged
from monitor.scans import read_within
from monitor.settings import Settings, as_mapping
from projects.identifiers import scan_product
from projects.model import PointCloud, Scan, Step


class FilteredScans(NamedTuple):
    """One step for each scan, and one for its doubtful points; of averaged scans one, and none."""

    scans: list[Step]
    doubtful: list[Step]


@dataclass(frozen=True)
class ScanTask:
    """One scan within the object's extent, ready to be filtered anywhere."""

    scan: Scan
    settings: FilterSettings
    counts: Mapping[str, int]
    calibration: Calibration | None = None


def filter_scans(
    place: Place, settings: Settings, calibrations: list[Step | None], engine: Engine, notify: Callable[[str], None]
) -> FilteredScans:
    """Filter each scan by itself, repeated ones their mean; what was made already is found."""
    headers = place.project.scan_headers(place.object_id, place.epoch_id)
    if is_averaged(place, settings.filter):
        return FilteredScans([filter_repeats(place, settings.filter, calibrations, engine, notify)], [])
    asked = _ask_scans(place, settings, [header.name for header in headers], calibrations)
    found = [(find_step(place, scan), find_step(place, doubtful)) for scan, doubtful in asked]
    missing = [k for k, steps in enumerate(found) if None in steps]

    def tasks() -> Iterator[ScanTask]:
        """Yield the scans that are missing one by one, so that no more are read than workers take."""
        for k in missing:
            notify(f"{place.epoch_id}: filtering scan {k + 1} of {len(headers)} ({headers[k].name})")
            scan, counts = read_within(place.project, place.object_id, place.epoch_id, k)
            yield ScanTask(scan, settings.filter, counts, calibration_of(place, calibrations[k]))

    started = time.perf_counter()
    for k, (made, doubtful) in zip(missing, engine.map(filter_task, tasks()), strict=True):
        finished = time.perf_counter()
        beside = put_step(place, asked[k][1], _numbered(doubtful, k), 0.0)  # its time is that of the scan
        found[k] = put_step(place, asked[k][0], _numbered(made, k), finished - started), beside
        started = finished
    scans, left_out = zip(*found, strict=True)
    return FilteredScans([s for s in scans if s is not None], [s for s in left_out if s is not None])


def _numbered(made: Made, index: int) -> Made:
    """Return a step whose points know which scan of the epoch they come from."""
    return replace(made, noun=replace(made.noun, scan_index=np.full(len(made.noun), index, dtype=np.int32)))


def _ask_scans(
    place: Place, settings: Settings, names: Sequence[str], calibrations: list[Step | None]
) -> list[tuple[Asked, Asked]]:
    """Return what is asked of each scan: its points, and its doubtful ones."""
    raw = latest_step(place, "raw")
    extent = place.project.object(place.object_id).extent
    given = {"filter": as_mapping(settings.filter), "extent": extent}
    asked = []
    for k, (name, step) in enumerate(zip(names, calibrations, strict=True)):
        parameters, inputs = {**given, "scan": k, "name": name}, (raw,) if step is None else (raw, step)
        asked.append((Asked(scan_product(k), "scan", parameters, inputs),
                      Asked(f"doubtful{k:03d}", "scan", parameters, inputs)))  # fmt: skip
    return asked


def filter_task(task: ScanTask) -> tuple[Made, Made]:
    """Filter one scan (runs on any worker): its points, and the doubtful ones.

    A scan that saw nothing of the object is skipped, and said to be.
    """
    none = PointCloud(np.empty((0, 3)))
    if len(task.scan.cloud) == 0:
        return Made(none, {"skipped": "no point within the extent"}, task.counts), Made(none)
    result = filter_scan_with_record(task.scan, task.settings, task.calibration)
    doubtful = none if result.doubtful is None else result.doubtful
    made = Made(result.cloud, result.automatic, {**task.counts, **result.counts})
    return made, Made(doubtful, counts={"out": len(doubtful)})
