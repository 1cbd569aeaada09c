"""What a report says, as plain texts ready to print: made by `reports.document`, laid out by `reports.html`."""

from __future__ import annotations

import datetime
from dataclasses import dataclass

from projects.extent import Extent
from projects.model import Comparison, Floats, Series
from reports.quantities import USUAL, Estimate, Measures


@dataclass(frozen=True)
class Table:
    """A table of texts; the first column names the row, `note` stands below."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


@dataclass(frozen=True)
class KeyFigure:
    """One number that the reader takes home."""

    label: str
    value: str
    note: str


@dataclass(frozen=True)
class Told:
    """What is told of one thing, which `subject` names."""

    subject: str
    text: str


@dataclass(frozen=True)
class Answer:
    """The answer before all else: one line, what changed, the largest changes one by one, the figures to remember, and
    how sure that is; a change's `subject` is the beginning of its sentence, what is sure has it as a heading."""

    headline: str
    changed: tuple[str, ...]
    largest: tuple[Told, ...]
    figures: tuple[KeyFigure, ...]
    sure: tuple[Told, ...]


@dataclass(frozen=True)
class RegionFacts:
    """One region of change; `side` is "lost", "gained" or "other" and chooses its colour."""

    number: int
    kind: str
    meaning: str
    side: str
    where: str
    area: Estimate
    volume: Estimate
    extreme: Estimate
    mean: Estimate


@dataclass(frozen=True)
class CourseFacts:
    """How one region goes on over several epochs; `origin` says where it split from or merged into, if it did, and
    `first_seen` which epoch shows it first, or that none does by itself. `where` it lies, and its number `on_map`, in
    the pictures of the comparison that ends the series, are put in by `followed.place_courses`."""

    number: int
    side: str
    course: str
    origin: str
    first_seen: str
    area: Estimate
    mean: Estimate
    rate: Estimate
    volume_rate: Estimate
    where: str = ""
    on_map: str = ""


@dataclass(frozen=True)
class SeriesFacts:
    """What goes on over more than two epochs; `series` is what its charts are drawn from, `measures` the units of its
    areas and volumes."""

    lead: str
    courses: tuple[CourseFacts, ...]
    series: Series
    measures: Measures = USUAL
    motions: Table | None = None


@dataclass(frozen=True)
class StepFacts:
    """What one step of the chain was asked for and what it found, value by value."""

    title: str
    settings: tuple[tuple[str, str], ...]
    found: tuple[Table, ...]


@dataclass(frozen=True)
class EpochFacts:
    """An epoch as the captions name it; `order` is its place in time against the other, "earlier" or "later", or in the
    pair where both are of one date, "first" or "second"."""

    epoch_id: str
    date: str
    label: str
    order: str

    @property
    def caption(self) -> str:
        """Date and label in one."""
        return f"{self.date}, {self.label}" if self.label else self.date


@dataclass(frozen=True)
class CalibrationFacts:
    """The calibration of one scan: what was found, in a sentence, and its profile (m, 3) [m]: range, before, after."""

    text: str
    profile: Floats


@dataclass(frozen=True)
class ReportFacts:
    """Everything that a report of one comparison says; `comparison` is what its pictures are drawn from.

    Attributes
    ----------
    title, subtitle : the object, and what was compared.
    made : when the comparison was computed.
    remarks : what the reader must know before trusting the rest.
    before, after : the reference and the compared epoch.
    certainty : how well the change is known, table by table.
    object_rows : name and text of what is known of the object.
    history : the two epochs side by side, and what became of their points.
    measures : the units of the areas and volumes of its regions.
    series : how regions go on over more than two epochs, where the compared epoch ends such a series.
    parts : the parts that moved rigidly, where there are any.
    stable : where the user says that nothing moved, where they did.
    crs : the reference system of the project's coordinates, "" where it is local.
    is_room : the object is seen from within, and words of place are those of a room.
    is_flat : the object lies flat, and words of place are those of its plan.
    front : rad, the bearing of the front as it was given with the object, None where it was found from the surface.
    computed : the day of the computation that `made` tells in words, None where it is not known.
    calibrations : the range calibration of a scan of each epoch, where one was corrected.
    record : the steps in order; versions and inputs : what they were made with and from.
    """

    title: str
    subtitle: str
    made: str
    remarks: tuple[str, ...]
    before: EpochFacts
    after: EpochFacts
    answer: Answer
    regions: tuple[RegionFacts, ...]
    certainty: tuple[Table, ...]
    object_rows: tuple[tuple[str, str], ...]
    history: tuple[Table, ...]
    record: tuple[StepFacts, ...]
    versions: Table
    inputs: Table
    mode: str
    comparison: Comparison
    measures: Measures = USUAL
    series: SeriesFacts | None = None
    calibrations: tuple[CalibrationFacts, ...] = ()
    parts: Table | None = None
    stable: Extent | None = None
    crs: str = ""
    is_room: bool = False
    front: float | None = None
    is_flat: bool = False
    computed: datetime.date | None = None
