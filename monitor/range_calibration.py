"""The range calibration of each scan of an epoch, kept with it: found once, used by its filtering.

Step 2 of docs/method.md. In: the stored scans, whole, for walls and floor are what is looked for; out: one step a
scan, and its `Calibration`.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from monitor.engine import Engine
from monitor.filtering import Calibration, CalibrationSettings, calibrate_range
from monitor.record import Asked, Made, Place, find_step, latest_step, put_step
from monitor.scans import sample_stored
from monitor.settings import as_mapping
from monitor.setups import setups_of
from monitor.simulation.instruments import INSTRUMENTS
from projects.model import Ints, Scan, Step

ARRAYS = ("wavelengths", "covariance", "profile")


@dataclass(frozen=True)
class CalibrationTask:
    """A sample of one scan, ready to be calibrated anywhere."""

    scan: Scan
    settings: CalibrationSettings


def calibrate_scans(
    place: Place, settings: CalibrationSettings, engine: Engine, notify: Callable[[str], None]
) -> list[Step | None]:
    """Return the calibration step of each scan of an epoch; None for all where calibration is switched off.

    Of the scans of one set-up the largest is calibrated, and the others with it: a fine window has no walls.
    """
    headers = place.project.scan_headers(place.object_id, place.epoch_id)
    if not settings.enabled:
        return [None] * len(headers)
    settings = with_preset(settings, place.project.epoch(place.object_id, place.epoch_id).scanner)
    asked = _ask_scans(place, settings, [header.name for header in headers])
    largest = largest_of_setups(setups_of(place), [header.n_points for header in headers])
    steps = {k: find_step(place, asked[k]) for k in np.unique(largest).tolist()}
    missing = [k for k, step in steps.items() if step is None]

    def tasks() -> Iterator[CalibrationTask]:
        """Yield samples of the scans that are missing one by one."""
        for k in missing:
            notify(f"{place.epoch_id}: looking for cyclic range errors, scan {k + 1} of {len(headers)}")
            scan = sample_stored(place.project, place.object_id, place.epoch_id, k, settings.max_points)
            yield CalibrationTask(scan, settings)

    started = time.perf_counter()
    for k, found in zip(missing, engine.map(calibration_task, tasks()), strict=True):
        finished = time.perf_counter()
        steps[k] = put_step(place, asked[k], as_made(found), finished - started)
        started = finished
    return [steps[k] for k in largest.tolist()]


def largest_of_setups(setups: Ints, n_points: Sequence[int]) -> Ints:
    """Return for each scan (n,) the scan of its set-up that has most points, the first of equal ones."""
    count = np.asarray(n_points)
    members = [np.flatnonzero(setups == number) for number in setups]
    return np.array([m[np.argmax(count[m])] for m in members], dtype=np.int64)


def calibration_of(place: Place, step: Step | None) -> Calibration | None:
    """Return what a calibration step found, None where there is none."""
    if step is None:
        return None
    arrays = {name: np.array(value, dtype=float) for name, value in place.get(step).items()}
    found = {f.name: step.automatic[f.name] for f in dataclasses.fields(Calibration) if f.name not in arrays}
    lists = {name: np.array(value, dtype=float) for name, value in found.items() if isinstance(value, list)}
    return Calibration(**{**found, **lists, **arrays})


def calibration_task(task: CalibrationTask) -> Calibration:
    """Calibrate one scan (runs on any worker)."""
    return calibrate_range(task.scan, task.settings)


def with_preset(settings: CalibrationSettings, scanner: str | None) -> CalibrationSettings:
    """Return the settings with the wavelength of the scanner's preset where none is given."""
    if settings.wavelength is not None or scanner is None or scanner not in INSTRUMENTS:
        return settings
    return dataclasses.replace(settings, wavelength=INSTRUMENTS[scanner].cyclic_wavelength)


def as_made(found: Calibration) -> Made:
    """Return a calibration as a step keeps it: its arrays as the product, the rest among what was found."""
    values = {f.name: getattr(found, f.name) for f in dataclasses.fields(Calibration)}
    plain = {n: v.tolist() if isinstance(v, np.ndarray) else v for n, v in values.items() if n not in ARRAYS}
    return Made({name: values[name] for name in ARRAYS}, plain)


def _ask_scans(place: Place, settings: CalibrationSettings, names: list[str]) -> list[Asked]:
    """Return what is asked of each scan."""
    raw = latest_step(place, "raw")
    given = {"calibration": as_mapping(settings)}
    return [
        Asked(f"calibration{k:03d}", "calibration", {**given, "scan": k, "name": name}, (raw,))
        for k, name in enumerate(names)
    ]
