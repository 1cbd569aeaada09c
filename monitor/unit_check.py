"""The question whether numbers mean what the user thinks: the size of each scan, and its place among the others.

In: the streams of an epoch and what was said of the unit; out: the same streams, which end with an error where either
is improbable.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from projects.errors import UnitError
from projects.formats import ScanStream, question_system, question_unit
from projects.formats.units import DEFINED_IN_METRES
from projects.model import Floats, Scan
from projects.transforms import apply

APART = 200.0  # widths between scans of one object; with metres taken for millimetres there are 500 and more


@dataclass(frozen=True)
class UnitCheck:
    """What a file's numbers mean: metres per unit, and whether the user said so."""

    metres: float = 1.0
    was_stated: bool = False


def with_questioned_unit(streams: list[ScanStream], unit: UnitCheck) -> Iterator[ScanStream]:
    """Yield the scans, each of which ends by questioning an improbable size, or place among the others (`UnitError`);
    of a file that says that its coordinates are no metres nothing is read.

    The store enters an epoch only when its stream has ended well, so nothing is kept of a questioned one.
    """
    boxes: list[Floats] = []  # of the scans that have been read
    for stream in streams:
        if stream.format not in DEFINED_IN_METRES:
            question_system(stream.system, unit.was_stated, stream.name)
    for stream in streams:
        yield replace(stream, chunks=_questioned(stream, unit, boxes))


def _questioned(stream: ScanStream, unit: UnitCheck, boxes: list[Floats]) -> Callable[[], Iterator[Scan]]:
    """Return the stream's `chunks`, which after the last one questions the size and the place of the scan's points."""

    def chunks() -> Iterator[Scan]:
        """Yield the chunks; after the last, question what unit their box can be in."""
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for scan in stream.chunks():
            if len(scan.cloud):
                low = np.minimum(low, scan.cloud.points.min(axis=0))
                high = np.maximum(high, scan.cloud.points.max(axis=0))
            yield scan
        if np.isfinite(low).all():
            question_unit(np.array([low, high]), unit.was_stated, stream.format, stream.name)
            boxes.append(_box_in_project(stream, low, high))
            if not unit.was_stated:
                question_place(boxes, stream.name)

    return chunks


def _box_in_project(stream: ScanStream, low: Floats, high: Floats) -> Floats:
    """Return the box (2, 3) [m] in the project's frame that holds a box of the scan's frame."""
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    placed = corners if stream.pose is None else apply(stream.pose, corners)
    return np.array([placed.min(axis=0), placed.max(axis=0)])


def question_place(boxes: Sequence[Floats], name: str) -> None:
    """Raise `UnitError` where the last scan lies `APART` times farther from those before than the largest is wide.

    Parameters
    ----------
    boxes : least and greatest coordinates (2, 3) [m] of each scan in the project's frame.
    name : of the last one, for the message.
    """
    *others, own = boxes
    if not others:
        return
    gaps = [float(np.linalg.norm(np.maximum(0.0, np.maximum(b[0] - own[1], own[0] - b[1])))) for b in others]
    widest = max(float(np.ptp(box, axis=0).max()) for box in boxes)
    if min(gaps) > APART * widest:
        raise UnitError(
            f"{name} lies {min(gaps):.3g} m from the scans before it, of which none is wider than {widest:.3g} m: its "
            "pose is wrong or in another unit than the points; correct it, or say with --unit that it is right"
        )
