"""What the store holds of an object, of an epoch, and of each product and how it came to be."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from projects.model.survey import ControlPoint


@dataclass(frozen=True)
class ObjectRecord:
    """The monitored thing as the archive knows it: its id, and free texts.

    `extent` is where it stands in the project's frame, as of `projects.extent`; `tolerance` [m] the client's own limit.
    `front` [rad] is the bearing to which its front faces, clockwise from +y of the project's frame, from 0 to below
    2 pi; None: nobody said. Of a room that is the wall ahead.
    """

    object_id: str
    name: str = ""
    inventory: str = ""
    place: str = ""
    material: str = ""
    description: str = ""
    extent: Mapping[str, Any] | None = None
    tolerance: float | None = None
    front: float | None = None


@dataclass(frozen=True)
class EpochRecord:
    """The state of an object at one date, from one or more scans or from one finished mesh (`is_mesh`).

    `scanner` is a preset of the instruments, where one was named; with `repeated` the scans are of one station, to be
    averaged. `sources` name the files: see `projects/FORMAT.md`. `control` are the points that hold the epoch's frame.
    `unit` [m] is what the numbers of its files were taken for; None: not known.
    """

    object_id: str
    epoch_id: str
    date: datetime.date
    label: str = ""
    scanner: str | None = None
    repeated: bool = False
    is_mesh: bool = False
    operator: str = ""
    sources: tuple[Mapping[str, Any], ...] = ()
    control: tuple[ControlPoint, ...] = ()
    unit: float | None = None


@dataclass(frozen=True)
class Step:
    """One product and how it came to be: identified by the hash of what was asked of which inputs.

    `parameters` are the settings asked for; `automatic` the values that were found; `counts` what went in, came out
    and was dropped with its reason; `inputs` the step ids or file hashes it was made from; `versions` the programs;
    `created` is ISO 8601 in UTC, and `seconds` how long it took.
    """

    step_id: str
    product: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    inputs: tuple[str, ...] = ()
    automatic: Mapping[str, Any] = field(default_factory=dict)
    counts: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    created: str = ""
    seconds: float = float("nan")
