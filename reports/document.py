"""Gather what the report of one comparison says, as texts ready to print; nothing here computes a change.

In: a project and the ids of an object and two epochs, or the nouns themselves. Out: `ReportFacts`.
"""

from __future__ import annotations

import datetime
import math
from dataclasses import replace

import pandas as pd

from projects.control_held import control_holds_whole
from projects.extent import Extent
from projects.identifiers import comparison_product
from projects.model import Comparison, EpochRecord, ObjectRecord, Step
from projects.store import Project
from reports.answer import MOVED_OR_WHOLE, holds_whole, state_answer
from reports.certainty import state_certainty
from reports.courses import tell_series
from reports.facts import EpochFacts, RegionFacts, ReportFacts
from reports.followed import place_courses
from reports.history import (
    EpochHistory,
    count_blind,
    describe_object,
    epochs_table,
    inputs_table,
    kind_of,
    name_columns,
    points_table,
    record_steps,
    tell_alone,
    tell_blind,
    tell_open_holes,
    tell_outside,
    tell_turned,
    tell_uncovered,
    versions_table,
)
from reports.kept import require_comparison, series_resting_on, tell_no_series
from reports.opinion import opinion_tables
from reports.quantities import MM, Measures, choose_measures, day, estimate, estimate_size, listed, percent
from reports.ranging import gather_calibrations
from reports.whereabouts import Setting, locate, setting_of
from reports.wholemotion import parts_table

MEANINGS = {
    "lost": "material lost", "added": "material added", "moved": "part moved",
    "cleaned": "thin, even layer lost or, if flat, piece moved inwards (not told which)",
    "coated": "thin, even layer added or, if flat, piece moved outwards (not told which)",
    "unclear": "changed, neither clearly lost nor added",
}  # fmt: skip
COLOURED = {"lost": "lost", "cleaned": "lost", "added": "gained", "coated": "gained"}
FALSE_DISCOVERY_RATE = 0.05  # where the record does not say


def gather_facts(project: Project, object_id: str, reference_id: str, compared_id: str) -> ReportFacts:
    """Return the facts of the comparison that a project holds of two epochs of an object.

    Raises
    ------
    StoreError
        If there is no such object, epoch or comparison, or a file is damaged.
    """
    record = project.object(object_id)
    before, after = (gather_history(project, object_id, e, reference_id) for e in (reference_id, compared_id))
    step = require_comparison(project, object_id, reference_id, compared_id)
    comparison = project.get(object_id, compared_id, step.product, step.step_id)
    facts = make_facts(comparison, record, before, after, project_name=project.name, crs=project.crs)
    calibrations = [c for epoch in (before, after) for c in gather_calibrations(project, object_id, epoch)]
    facts = replace(facts, calibrations=tuple(calibrations))
    followed = series_resting_on(project, object_id, (reference_id, compared_id), step)
    if followed is None:
        return replace(facts, remarks=(*facts.remarks, *tell_no_series(project, object_id)))
    series = project.get(object_id, compared_id, followed.product, followed.step_id)
    return replace(facts, series=place_courses(tell_series(series), comparison, record.front))


def gather_history(project: Project, object_id: str, epoch_id: str, reference_id: str) -> EpochHistory:
    """Return an epoch with its steps, without its comparisons with other epochs than the reference."""
    wanted = comparison_product(reference_id)
    of_pair = ("comparison", "series")
    steps = [s for s in project.steps(object_id, epoch_id) if kind_of(s) not in of_pair or s.product == wanted]
    headers = project.scan_headers(object_id, epoch_id)
    scanners = tuple(dict.fromkeys(h.scanner for h in headers if h.scanner))
    return EpochHistory(project.epoch(object_id, epoch_id), tuple(steps), scanners)


def make_facts(
    comparison: Comparison, record: ObjectRecord, before: EpochHistory, after: EpochHistory, *, project_name: str = "",
    crs: str = "",
) -> ReportFacts:  # fmt: skip
    """Return the facts of a comparison from the nouns.

    Parameters
    ----------
    comparison : of `after` (compared) with `before` (reference).
    record : the object.
    before, after : the epochs with the steps that made their surfaces; `after` also with the comparison's.
    project_name, crs : as the object block names the project and its reference system.
    """
    made = after.step(comparison_product(before.record.epoch_id))
    if _without_control(before) or _without_control(after):
        comparison = without_significance(comparison)
    first, second = name_epochs(before.record, after.record)
    computed = datetime.date.fromisoformat(made.created[:10]) if made and made.created else None
    setting = setting_of(comparison.on_reference.surface, record.front)
    measures = choose_measures(comparison.regions["area_m2"])
    regions = tuple(describe_region(comparison, row, setting, measures) for _, row in comparison.regions.iterrows())
    heads = name_columns((before, after))
    columns = {f"{heads[0]} ({first.date})": before.steps, f"{heads[1]} ({second.date})": after.steps}
    return ReportFacts(
        title=record.name or record.object_id,
        subtitle=f"What changed between {first.caption} and {second.caption}",
        made="" if computed is None else day(computed),
        computed=computed,
        remarks=(*_remarks(made, before, after), *_doubts(comparison, (before, after))),
        before=first,
        after=second,
        answer=state_answer(comparison, regions, first, second, setting),
        regions=regions,
        measures=measures,
        certainty=(
            *state_certainty(comparison, columns, _false_discovery_rate(made), (first, second)),
            *opinion_tables(made),
        ),
        object_rows=describe_object(record, project_name, crs),
        history=tuple(t for t in (epochs_table((before, after)), points_table((before, after))) if t.rows),
        record=record_steps((before, with_statistics(after, made, comparison))),
        versions=versions_table(made),
        inputs=inputs_table((before, after)),
        crs=crs,
        mode=comparison.mode,
        comparison=comparison,
        parts=parts_table(comparison, first, second),
        stable=_given_stable(made),
        is_room=setting.is_room,
        is_flat=setting.plan is not None,
        front=record.front,
    )


def without_significance(comparison: Comparison) -> Comparison:
    """Return a comparison that does not say how surely the object moved: older programs did without control, too."""
    unknown = {"motion_significance": math.nan, "motion_is_significant": None}
    return replace(comparison, statistics={**comparison.statistics, **unknown})


def describe_region(comparison: Comparison, row: pd.Series, setting: Setting, measures: Measures) -> RegionFacts:
    """Return one row of the table of regions as texts: area, volume and mm, each with its 95 % margin."""
    place = row[["x", "y", "z"]].to_numpy(dtype=float)
    number, kind = int(row["region"]), str(row["kind"])
    return RegionFacts(
        number=number,
        kind=kind,
        meaning=MOVED_OR_WHOLE if kind == "moved" and holds_whole(comparison) else MEANINGS.get(kind, kind),
        side=COLOURED.get(kind, "other"),
        where=locate(comparison, number, place, setting),
        area=estimate_size(float(row["area_m2"]), float(row["sigma_area_m2"]), measures.per_m2, measures.area),
        volume=estimate(
            float(row["volume_m3"]), float(row["sigma_volume_m3"]), measures.per_m3, measures.volume, signed=True
        ),
        extreme=estimate(float(row["extreme_m"]), float(row["sigma_extreme_m"]), MM, "mm", signed=True),
        mean=estimate(float(row["mean_m"]), float(row["sigma_mean_m"]), MM, "mm", signed=True),
    )


def with_statistics(epoch: EpochHistory, made: Step | None, comparison: Comparison) -> EpochHistory:
    """Return the history with the comparison's statistics among what its step found."""
    single = {name: value for name, value in comparison.statistics.items() if name != "parts"}  # these have a table
    steps = [replace(s, automatic={**s.automatic, **single}) if s is made else s for s in epoch.steps]
    return replace(epoch, steps=tuple(steps))


def name_epochs(before: EpochRecord, after: EpochRecord) -> tuple[EpochFacts, EpochFacts]:
    """Return the reference and the compared epoch as captions name them, each with its order in time."""
    if before.date == after.date:
        orders, dates = ("first", "second"), [f"{day(r.date)} (epoch {r.epoch_id})" for r in (before, after)]
    else:
        orders = ("earlier", "later") if before.date < after.date else ("later", "earlier")
        dates = [day(before.date), day(after.date)]
    first, second = (
        EpochFacts(r.epoch_id, date, r.label, order)
        for r, date, order in zip((before, after), dates, orders, strict=True)
    )
    return first, second


def _false_discovery_rate(made: Step | None) -> float:
    """Return the rate that was asked for, the usual one where the record does not say."""
    asked = (made.parameters.get("compare") or {}) if made else {}
    rate = asked.get("false_discovery_rate")
    return FALSE_DISCOVERY_RATE if rate is None or not math.isfinite(rate) else float(rate)


def _given_stable(made: Step | None) -> Extent | None:
    """Return where the user says that nothing moved, None where it was found."""
    given = made.parameters.get("stable") if made else None
    return None if given is None else Extent.from_mapping(given)


def _remarks(made: Step | None, before: EpochHistory, after: EpochHistory) -> tuple[str, ...]:
    """Return what the reader must know first: a pose found by shape, a surface made again after the comparison."""
    if made is None:
        return ()
    surfaces = [(e, e.step("surface")) for e in (before, after)]
    stale = [e.record.epoch_id for e, s in surfaces if s is not None and s.step_id not in made.inputs]
    again = tuple(f"Epoch {e} was processed again after this comparison; run “monitor compare” anew." for e in stale)
    times = (*_backwards(before.record, after.record), *_to_come(made, (before.record, after.record)))
    held = tuple(why for e in (before, after) if e.record.control and (why := _without_control(e)))
    holes = tuple(
        f"The surface of epoch {e.record.epoch_id} is {told}."
        for e, s in surfaces
        if s and (told := tell_open_holes(s))
    )
    bare = tuple(
        f"Epoch {e.record.epoch_id}: {told}."
        for e, s in surfaces
        for tell in (tell_uncovered, tell_turned, tell_outside)
        if s and (told := tell(s))
    )
    blind = tuple(
        f"Epoch {e.record.epoch_id}: {told}." for e in (before, after) if (told := tell_blind(*count_blind(e.steps)))
    )
    networks = [(e, e.step("network")) for e in (before, after)]
    alone = tuple(f"Epoch {e.record.epoch_id}: {told}." for e, n in networks if n and (told := tell_alone(n)))
    scans = (*blind, *alone)
    return (*times, *_same_survey(before, after), *_found_by_shape(made), *held, *holes, *bare, *scans, *again)


def _without_control(epoch: EpochHistory) -> str:
    """Return why no control points hold an epoch as a whole, "" where they do, or nobody recorded whether they do."""
    if not epoch.record.control:
        return "no control points are given"
    network, name = epoch.step("network"), f"The control points of epoch {epoch.record.epoch_id}"
    if epoch.record.is_mesh:
        return f"{name} hold nothing: it is a finished mesh."
    if network is None or control_holds_whole(network.automatic):
        return ""
    n_held, n_given = int(network.automatic.get("n_control", 0)), len(epoch.record.control)
    if not n_held:
        return f"{name} hold nothing: none of them was found in its scans."
    return (
        f"{name} do not hold it as a whole: {n_held} of {n_given} hold{'s' if n_held == 1 else ''} a target of its "
        "scans, and it may still turn about them. That takes three that are not on one line."
    )


def _doubts(comparison: Comparison, epochs: tuple[EpochHistory, EpochHistory]) -> tuple[str, ...]:
    """Return what speaks against the motion between the epochs, or against the poses of their scans."""
    networks = [(e.record.epoch_id, e.step("network")) for e in epochs]
    of_scans = [(name, str(step.automatic.get("doubt") or "")) for name, step in networks if step is not None]
    told = [("how the epochs lie on each other", comparison.registration.doubt)]
    told += [(f"how the scans of epoch {name} lie on each other", doubt) for name, doubt in of_scans]
    return tuple(f"In doubt is {what}: {doubt}. See “How sure”." for what, doubt in told if doubt)


def _backwards(before: EpochRecord, after: EpochRecord) -> tuple[str, ...]:
    """Return the remark that the reference is the later epoch, where it is."""
    if before.date <= after.date:
        return ()
    return (
        f"Told backwards in time: epoch {before.epoch_id} of {day(before.date)}, the reference, is the later one. "
        "What is called lost was gained since, and what is called gained was lost.",
    )


def _to_come(made: Step, epochs: tuple[EpochRecord, EpochRecord]) -> tuple[str, ...]:
    """Return the remark that an epoch is dated after the comparison that used it was computed."""
    computed = made.created[:10]
    return tuple(
        f"Epoch {e.epoch_id} is dated {day(e.date)}, after this comparison was computed: one of its dates is wrong."
        for e in epochs
        if computed and e.date > datetime.date.fromisoformat(computed) + datetime.timedelta(days=1)  # time zones
    )


def _same_survey(before: EpochHistory, after: EpochHistory) -> tuple[str, ...]:
    """Return the remark that both epochs hold the same files (in a comparison that an older version made)."""
    read = [next((s for s in e.steps if s.product in ("raw", "mesh")), None) for e in (before, after)]
    both = {sha256 for sha256 in read[0].inputs if sha256 in read[1].inputs} if read[0] and read[1] else set()
    shared = list(dict.fromkeys(str(s["file"]) for s in after.record.sources if s.get("sha256") in both))
    if not shared:
        return ()
    return (
        f"Both epochs hold the same measurements ({listed(shared)}). What was measured once can show no change: where "
        "only these saw the object, nothing below holds, and the level of detection is not known. Add the epoch again "
        "with the scans of its own survey.",
    )


def _found_by_shape(made: Step) -> tuple[str, ...]:
    """Return the remark that the epochs were brought together by their shapes, where they were."""
    if "coarse_score" not in made.automatic:
        return ()
    return (
        "As given, the epochs do not lie near each other. They were brought together by their shapes alone: "
        f"the pose explains {percent(float(made.automatic['coarse_score']))} of the shape, the next best one "
        f"{percent(max(float(made.automatic['coarse_ambiguity']), 0.0))} of that. If the object was not carried "
        "elsewhere between the epochs, check the poses and the unit.",
    )
