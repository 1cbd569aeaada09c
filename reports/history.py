"""Where the result comes from: the object, its epochs, what became of their points, each step's settings and findings.

In: the records of the store. Out: tables of texts. Values of the record stand as they are kept: metres and radians.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from projects.model import EpochRecord, ObjectRecord, Step
from reports.facts import StepFacts, Table
from reports.quantities import NOT_KNOWN, coordinates, count, day, height, listed, percent, tell_bearing

STEP_TITLES = {
    "raw": "Reading", "calibration": "Range calibration of each scan", "scan": "Filtering each scan",
    "targets": "Survey targets of each scan", "network": "Fitting the scans onto each other",
    "filtered": "Merging the scans", "surface": "Surface", "quality": "Surface against its scans",
    "mesh": "Finished mesh", "comparison": "Registration and comparison of the epochs",
}  # fmt: skip
FILTERING = {
    "outside_extent": "outside the object’s extent", "speck": "specks in the air",
    "outlier": "outliers of one scan alone",
    "mixed_pixel": "mixed pixels at silhouettes", "rim": "at the rims of surfaces",
    "fringe": "past the limbs of surfaces",
    "grazing": "seen at a grazing angle", "rejected": "too far from the median of their voxel",
    "at_scanner": "where the scanner stood", "copy": "copies of other points",
    "too_few": "scans with too few points", "merged": "merged by thinning",
    "no_counterpart": "repeated, and in no cell of their own", "split": "repeated, and saw two surfaces",
    "disagreeing": "repeated, and unlike the other ranges there", "averaged": "averaged with other repeats",
    "out": "left after filtering each scan",
}  # fmt: skip
MERGING = {
    "seen_through": "dropped because another scan looked through them",
    "copy": "copies of other points in the merged cloud", "outlier": "dropped as outliers of the merged cloud",
    "rejected": "too far from the median of their voxel in the merged cloud",
    "merged": "merged by the second thinning", "out": "left after merging",
}  # fmt: skip
NOT_DROPPED = ("read", "in", "borne_out")
BARE_CELLS = 8.0  # cells along and across: as much area without a surface in one piece is told
UNCOVERED = 0.15  # of the area between the points: more without a surface is said with what an epoch became
UNITS = {1.0: "metre", 0.01: "centimetre", 0.001: "millimetre", 0.3048: "foot", 0.0254: "inch"}  # of so many m
ON_READING = "not_measured_"  # counted with each scan, too, though none of them is among what was read


@dataclass(frozen=True)
class EpochHistory:
    """An epoch and the steps of its chain, in order; `scanners` as the files name them."""

    record: EpochRecord
    steps: tuple[Step, ...] = ()
    scanners: tuple[str, ...] = field(default=())

    def step(self, product: str) -> Step | None:
        """Return the step of a product, None where there is none."""
        return next((s for s in self.steps if s.product == product), None)


def describe_object(record: ObjectRecord, project_name: str = "", crs: str = "") -> tuple[tuple[str, str], ...]:
    """Return what is known of the object, name and text; what was not entered is left out."""
    rows = (
        ("Object", record.name or record.object_id), ("Identifier", record.object_id),
        ("Inventory", record.inventory), ("Place", record.place), ("Material", record.material),
        ("Description", record.description), ("Front", _say_front(record)), ("Project", project_name),
        ("Coordinates", crs),
    )  # fmt: skip
    return tuple((name, text) for name, text in rows if text)


def _say_front(record: ObjectRecord) -> str:
    """Return to which side the front faces, "" where nobody said."""
    return "" if record.front is None else f"faces {tell_bearing(record.front)}"


def epochs_table(epochs: Sequence[EpochHistory]) -> Table:
    """Return the epochs side by side: date, instrument, operator, scans."""
    rows: tuple[tuple[str, ...], ...] = (
        ("Epoch", *(e.record.epoch_id for e in epochs)),
        ("Date", *(day(e.record.date) for e in epochs)),
        ("Label", *(e.record.label or "–" for e in epochs)),
        ("Instrument", *(_instrument(e) for e in epochs)),
        ("Operator", *(e.record.operator or "not stated" for e in epochs)),
        ("Measured as", *(_measured_as(e) for e in epochs)),
        ("Control points", *(count(len(e.record.control)) for e in epochs)),
    )
    if any(e.record.unit not in (None, 1.0) for e in epochs):
        rows = (*rows, ("Unit of the files", *(say_unit(e.record) for e in epochs)))
    return Table("The epochs", ("", *name_columns(epochs)), rows)


def name_columns(epochs: Sequence[EpochHistory]) -> tuple[str, str]:
    """Return what the columns of the reference and of the compared epoch are called."""
    first, second = (e.record.date for e in epochs)
    return ("before", "after") if first <= second else ("reference", "compared")


def _instrument(epoch: EpochHistory) -> str:
    """Return the instruments of an epoch, as given and as the files name them."""
    names = dict.fromkeys(n for n in (epoch.record.scanner, *epoch.scanners) if n)
    return ", ".join(names) or "not stated"


def say_unit(record: EpochRecord) -> str:
    """Return for which unit the numbers in the files of an epoch were taken."""
    if record.unit is None:
        return "not recorded"
    return next((name for length, name in UNITS.items() if math.isclose(length, record.unit)), f"{record.unit:.9g} m")


def _measured_as(epoch: EpochHistory) -> str:
    """Return in words what an epoch was made from."""
    if epoch.record.is_mesh:
        return "a finished mesh"
    filtered = [s for s in epoch.steps if kind_of(s) == "scan"]
    if not epoch.record.repeated:
        return _scans(len(filtered) or len(epoch.record.sources))
    averaged = ", each filtered and merged, not averaged" if len(filtered) > 1 else ""
    return f"{_scans(len(epoch.record.sources))}, repeated from one station{averaged}"


def _scans(n: int) -> str:
    """Return a number of scans in words."""
    return f"{n} scan" if n == 1 else f"{n} scans"


def kind_of(step: Step) -> str:
    """Return what a step is: "scan" for scan000 and on, "calibration" and "targets" alike, "comparison" for
    comparison-REFERENCE and "series" for series-REFERENCE, else its product."""
    kind, dash, _ = step.product.partition("-")
    if dash:
        return kind
    numbered = (kind for kind in ("scan", "calibration", "targets") if step.product.startswith(kind))
    return next(numbered, step.product)


def points_table(epochs: Sequence[EpochHistory]) -> Table:
    """Return what became of the points of each epoch, from the files to the surface."""
    flows = [_flow(e) for e in epochs]
    order = _in_order(name for flow in flows for name in flow)
    rows = tuple((words, *(count(flow[(phase, words)]) if (phase, words) in flow else "–" for flow in flows))
                 for phase, words in order)  # fmt: skip
    return Table("From the scanner to the surface", ("points", *name_columns(epochs)), rows)


def point_flow(epoch: EpochHistory) -> list[tuple[str, int]]:
    """Return what became of the points of one epoch: words and number, in the order of the chain."""
    flow = _flow(epoch)
    return [(name[1], flow[name]) for name in _in_order(flow)]


def _in_order(names: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return each name (phase, words) once, in the order of the chain."""
    return sorted(dict.fromkeys(names), key=lambda name: (_PHASES.index(name[0]), _rank(name)))


_PHASES = ("files", "scan", "filtered", "surface")
_LAST = ("measured points in the files", "left after filtering each scan", "left after merging")
_ORDER = (*FILTERING.values(), *MERGING.values(), "vertices of the surface", "triangles of the surface",
          "triangles of them that close holes, invented", "holes that could not be closed")  # fmt: skip


def _rank(name: tuple[str, str]) -> tuple[bool, int]:
    """Return the place of a row in its phase: what is left comes last, what has no name of its own just before."""
    return name[1] in _LAST, _ORDER.index(name[1]) if name[1] in _ORDER else len(_ORDER)


def _flow(epoch: EpochHistory) -> dict[tuple[str, str], int]:
    """Return the counts of one epoch by phase and in words."""
    flow: dict[tuple[str, str], int] = {}
    for step in epoch.steps:
        kind, counts = kind_of(step), step.counts
        if kind == "raw":
            for reason, n in (counts.get("dropped") or {}).items():
                flow[("files", f"dropped on reading: {reason}")] = int(n)
            flow[("files", "measured points in the files")] = int(counts.get("n_points", 0))
        elif kind == "scan":
            _add(flow, kind, counts, FILTERING)
        elif kind == "filtered":
            _add(flow, kind, counts, MERGING)
            n = counts.get("borne_out", 0)  # of what each scan dropped for outliers
            _add(flow, "scan", {"outlier": -n, "out": n} if n else {}, FILTERING)
        elif kind == "surface":
            names = {"vertices": "vertices of the surface", "faces": "triangles of the surface",
                     "faces_invented": "triangles of them that close holes, invented",
                     "holes_left_open": "holes that could not be closed",
                     "faces_outside_extent": "triangles of the mesh outside of the extent, left out"}  # fmt: skip
            flow |= {("surface", words): int(counts[key]) for key, words in names.items() if key in counts}
    return flow


def tell_open_holes(surface: Step) -> str:
    """Return in words how many holes of a surface stay open that were to be closed, "" where none does."""
    n = int(surface.counts.get("holes_left_open", 0))
    if not n:
        return ""
    wanted = "watertight" if surface.parameters.get("surface", {}).get("watertight") else "closed as asked"
    stay, them = ("holes stay", "them") if n > 1 else ("hole stays", "it")
    return f"not {wanted}: {n} {stay} open, since faces over {them} would meet others"


def tell_uncovered(surface: Step) -> str:
    """Return in words how much of the area between its points has no surface, or else the largest piece of it; "" up
    to `UNCOVERED` of the area, in pieces whose points stand for less than a square of `BARE_CELLS`: lines and rims."""
    found = surface.automatic
    share = float(found.get("uncovered_share", 0.0))
    why = "perhaps its points lie too far apart for its cells, or two sheets too near each other"
    if share > UNCOVERED:
        return f"{percent(share)} of the area between its points has no surface: {why.replace('its points', 'they')}"
    n, cell = int(found.get("bare_piece_points", 0)), float(found.get("cell_size_m", math.inf))
    if n * float(found.get("spacing_m", 0.0)) ** 2 < (BARE_CELLS * cell) ** 2:
        return ""
    long, wide = found["bare_piece_size_m"]
    place = coordinates(found["bare_piece_place_m"], cell)
    return (
        f"a piece of {height(long)} by {height(wide)} about the point {place} m ({count(n)} points) has no surface, "
        f"and no change of it can be told: {why}"
    )


def tell_turned(surface: Step) -> str:
    """Return in words which faces of a finished mesh were turned round, or that all of it looks inward; "" of none."""
    n, n_faces = (int(surface.counts.get(name, 0)) for name in ("faces_turned", "faces"))
    if surface.automatic.get("looks_inward"):
        return (
            "the mesh looks inward, as a room does that was scanned from within; if it is none, the file is inside "
            "out, and what is called lost was gained: turn its faces round and add it again"
        )
    if n == n_faces > 0:
        return "the mesh was inside out; its faces were turned outward"
    return f"{count(n)} of {count(n_faces)} faces looked against those around them; they were turned" if n else ""


def tell_outside(surface: Step) -> str:
    """Return in words how much of a finished mesh lies outside of the object's extent; "" of none."""
    share = float(surface.automatic.get("share_outside_extent", 0.0))
    if share == 1.0:
        return (
            "all of the mesh lies outside of the object's extent: it stands in a frame of its own, or in another unit, "
            "and nothing of it was left out"
        )
    return f"{percent(share)} of the mesh lies outside of the object's extent and was left out" if share else ""


def tell_alone(network: Step) -> str:
    """Return in words which scans of an epoch nothing ties to the others, "" where all hang together."""
    alone = [str(int(k) + 1) for k in network.automatic.get("alone", ())]
    if not alone:
        return ""
    which = f"scan {alone[0]}" if len(alone) == 1 else f"scans {listed(alone)}"
    whose = "its pose is" if len(alone) == 1 else "their poses are"
    return f"no surface of {which} was found again in another scan: nothing shows whether {whose} right"


def tell_blind(n_blind: int, n_scans: int) -> str:
    """Return in words of how many scans nobody says where the scanner stood, and what is not known then; "" of none."""
    if not n_blind:
        return ""
    which = "" if n_blind == n_scans else f"of {n_blind} of {n_scans} scans "
    merged = ", nor by how much scans that were merged in it disagree" if n_scans == 1 else ""
    return (
        f"{which}nobody says where the scanner stood: it is not known whether what is missing is gone or was not "
        f"seen{merged}"
    )


def count_blind(steps: Sequence[Step]) -> tuple[int, int]:
    """Return of how many of the scans of an epoch it is not known where the scanner stood, and how many there are."""
    scans = [s for s in steps if kind_of(s) == "scan"]
    return sum("silhouettes_left_out" in s.automatic for s in scans), len(scans)


def _add(flow: dict[tuple[str, str], int], phase: str, counts: Mapping[str, Any], names: Mapping[str, str]) -> None:
    """Add what became of the points of one step; every reason it counts appears, so that the column adds up."""
    for key, n in counts.items():
        if key in NOT_DROPPED or key.startswith(ON_READING):
            continue
        words = names.get(key, key.replace("_", " "))
        flow[(phase, words)] = flow.get((phase, words), 0) + int(n)


def record_steps(epochs: Sequence[EpochHistory]) -> tuple[StepFacts, ...]:
    """Return each step of the chain once, with its settings and what it found in each epoch."""
    facts = []
    for kind, title in STEP_TITLES.items():
        own = [[step for step in e.steps if kind_of(step) == kind] for e in epochs]
        if any(own):
            facts.append(_record_step(title, list(zip(name_columns(epochs), own, strict=True))))
    return tuple(facts)


def _record_step(title: str, named: list[tuple[str, list[Step]]]) -> StepFacts:
    """Return one kind of step: one table for both epochs, or one each where an epoch has several such steps."""
    asked = [pair for _, steps in named for step in steps for pair in _settings(step.parameters)]
    if max(len(steps) for _, steps in named) == 1:
        tables = [_found_table("", [(name, step) for name, steps in named for step in steps])]
    else:
        tables = [_found_table(name, [(step.product, step) for step in steps]) for name, steps in named if steps]
    inner = [table for name, steps in named for step in steps for table in _inner_tables(name, step.automatic)]
    return StepFacts(title, tuple(dict.fromkeys(asked)), (*tables, *inner))


def _settings(parameters: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the settings of a step without what only tells one scan from another."""
    asked = {name: value for name, value in parameters.items() if name not in ("scan", "name")}
    given = [(name, "not given") for name, value in asked.items() if value is None]
    return flatten({name: value for name, value in asked.items() if value is not None}) + given


def _found_table(title: str, own: list[tuple[str, Step]]) -> Table:
    """Return the automatic values of steps, one row a value, one column a step, with its id and when it was made."""
    found = []
    for _, step in own:
        whole = {} if _is_table(step.automatic) else step.automatic
        single = {name: value for name, value in whole.items() if not _is_table(value)}
        found.append({"step": step.step_id, "made": _made(step), **dict(flatten(single, unknown=NOT_KNOWN))})
    names = dict.fromkeys(key for values in found for key in values)
    rows = tuple((key, *(values.get(key, "–") for values in found)) for key in names)
    return Table(title, ("", *(name for name, _ in own)), rows)


def _is_table(value: Any) -> bool:
    """Whether a value is a list, or a mapping, of mappings."""
    inner = list(value.values()) if isinstance(value, Mapping) else value
    return isinstance(inner, list | tuple) and bool(inner) and all(isinstance(v, Mapping) for v in inner)


def _inner_tables(epoch: str, automatic: Mapping[str, Any]) -> list[Table]:
    """Return what a step found that is a table itself: all of it, or single values."""
    if _is_table(automatic):
        return [_inner_table(epoch, list(automatic.items()))]
    tables = {name: value for name, value in automatic.items() if _is_table(value)}
    return [
        _inner_table(f"{epoch}: {name}", list(value.items() if isinstance(value, Mapping) else enumerate(value)))
        for name, value in tables.items()
    ]


def _inner_table(title: str, rows: Sequence[tuple[Any, Mapping[str, Any]]]) -> Table:
    """Return one row for each mapping, one column for each of its names."""
    flat = [(str(name), dict(flatten(values, unknown=NOT_KNOWN))) for name, values in rows]
    names = dict.fromkeys(key for _, values in flat for key in values)
    return Table(title, ("", *names), tuple((name, *(v.get(key, "–") for key in names)) for name, v in flat))


def _made(step: Step) -> str:
    """Return when a step was made, to the minute."""
    return f"{step.created[:16].replace('T', ' ')} UTC" if step.created else NOT_KNOWN


def flatten(values: Any, prefix: str = "", unknown: str = "auto") -> list[tuple[str, str]]:
    """Return nested values as pairs of dotted name and text; None is `unknown`."""
    if isinstance(values, Mapping):
        names = {key: f"{prefix}.{key}" if prefix else key for key in values}
        return [pair for key, value in values.items() for pair in flatten(value, names[key], unknown)]
    return [(prefix, print_value(values, unknown))]


def print_value(value: Any, unknown: str = "auto") -> str:
    """Return a recorded value as text: numbers with four digits, from 1000 on to the tenth of a millimetre, as
    coordinates are; None as `unknown`."""
    if value is None:
        return unknown
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        is_large = abs(value) >= 1000.0 and math.isfinite(value)
        return NOT_KNOWN if value != value else f"{value:.4f}".rstrip("0").rstrip(".") if is_large else f"{value:.4g}"
    if isinstance(value, list | tuple):
        return " ".join(print_value(v, unknown) for v in value) or "–"
    return str(value) if str(value) else "–"


def versions_table(step: Step | None) -> Table:
    """Return the programs that made the comparison."""
    return Table("", ("program", "version"), tuple((step.versions if step else {}).items()))


def inputs_table(epochs: Sequence[EpochHistory]) -> Table:
    """Return every input file with its points and its SHA-256."""
    rows = tuple(
        (str(s.get("scan") or s.get("file", "")), name, _points(s), str(s.get("sha256", "")))
        for name, e in zip(name_columns(epochs), epochs, strict=True)
        for s in e.record.sources
    )
    return Table("", ("file", "epoch", "points", "SHA-256"), rows)


def _points(source: Mapping[str, Any]) -> str:
    """Return how many points a source held, a dash where that is not recorded."""
    return count(source["n_points"]) if source.get("n_points") is not None else "–"
