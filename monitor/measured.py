"""What the scans of an epoch measured, as its surface was made of it: raw points, calibrated and where adjusted.

In: an epoch of a project; out: its points in its own coordinates, within the object's extent, before any filtering.
They are what a surface, and a change between two of them, is held against in the end.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from monitor.filtering import Calibration, correct_range
from monitor.range_calibration import calibration_of
from monitor.record import Place
from monitor.scans import iterate_within
from projects.identifiers import scan_product
from projects.model import Floats, PointCloud, Step
from projects.transforms import apply

MOST_POINTS = 8_000_000  # at a time in memory, of one epoch


class RawScan(NamedTuple):
    """The raw points of a scan, in pieces (n, 3) [m] in the surface's frame, and one sigma [m] of what they may lie off
    it by: their noise, and what the scans of the epoch disagree by."""

    sigma: float
    pieces: Iterable[Floats]


def filtered(place: Place) -> PointCloud | None:
    """Return the points that an epoch's surface was made of, in the epoch's coordinates; None for a finished mesh."""
    step = place.project.latest(place.object_id, place.epoch_id, "filtered")
    return None if step is None else place.get(step)


def raw_scans(
    place: Place, scans: Sequence[Step], motions: Sequence[Floats], calibrations: Sequence[Calibration | None],
    disagreement: float,
) -> Iterator[RawScan]:  # fmt: skip
    """Yield what each scan of an epoch measured within the object's extent, calibrated and where the adjustment put it.

    `scans` are the steps that filtered them, which know their noise; one that was skipped has none, and is left out.
    `motions` (4, 4) are those of the adjustment, T_project_given; `disagreement` [m] is what its scans still disagree
    by, NaN where no two overlap.
    """
    shared = disagreement if np.isfinite(disagreement) else 0.0
    for k, (step, motion, calibration) in enumerate(zip(scans, motions, calibrations, strict=True)):
        noise = step.automatic.get("noise_before")
        if noise is not None and np.isfinite(noise):
            yield RawScan(float(np.hypot(noise, shared)), _pieces(place, k, motion, calibration))


def _pieces(place: Place, index: int, motion: Floats, calibration: Calibration | None) -> Iterator[Floats]:
    """Yield the points (n, 3) [m] of a raw scan in the epoch's coordinates."""
    for _, chunk in iterate_within(place.project, place.object_id, place.epoch_id, index):
        scan = chunk if calibration is None else correct_range(chunk, calibration)
        yield apply(motion @ scan.pose, scan.cloud.points)


def measured_points(place: Place) -> Floats | None:
    """Return what the scans of an epoch measured (n, 3) [m], in the epoch's coordinates; None for a finished mesh.

    Of more than `MOST_POINTS` every second, fourth, ... one. Of repeated scans, which drift from their mean, the
    filtered points of that mean.
    """
    cloud = filtered(place)
    steps = _steps_of_scans(place)
    if cloud is None or not steps:
        return None if cloud is None else cloud.points
    network = place.project.latest(place.object_id, place.epoch_id, "network")
    assert network is not None  # since there is a filtered cloud
    motions = place.get(network)["T_project_given"]
    if len(motions) != len(steps):
        return cloud.points
    calibrations = [_calibration_used(place, step) for step in steps]
    pieces = (piece for scan in raw_scans(place, steps, motions, calibrations, np.nan) for piece in scan.pieces)
    return join_evenly(pieces, MOST_POINTS)


def join_evenly(pieces: Iterable[Floats], most: int) -> Floats:
    """Return the points (n, 3) of all pieces: at most `most`, of more every second, fourth, ... of each piece."""
    kept: list[Floats] = []
    stride = 1
    for piece in pieces:
        kept.append(piece[::stride])
        while sum(map(len, kept)) > max(most, len(kept)):  # one point of each piece stays
            kept, stride = [points[::2] for points in kept], 2 * stride
    points = np.concatenate(kept) if kept else np.empty((0, 3))
    return points[:: max(-(-len(points) // most), 1)]


def _steps_of_scans(place: Place) -> list[Step]:
    """Return the steps that filtered each scan of an epoch; none where one is missing."""
    n_scans = len(place.project.scan_headers(place.object_id, place.epoch_id))
    steps = [place.project.latest(place.object_id, place.epoch_id, scan_product(k)) for k in range(n_scans)]
    return [step for step in steps if step is not None] if None not in steps else []


def _calibration_used(place: Place, scan: Step) -> Calibration | None:
    """Return the calibration that a scan was filtered with, that of a scan of the same set-up; None where none was."""
    n_scans = len(place.project.scan_headers(place.object_id, place.epoch_id))
    found = (place.project.latest(place.object_id, place.epoch_id, f"calibration{k:03d}") for k in range(n_scans))
    used = [step for step in found if step is not None and step.step_id in scan.inputs]
    return calibration_of(place, used[0]) if used else None
