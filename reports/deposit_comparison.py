"""A comparison in an archive: difference models, tables, summary, series, report, and how they came to be."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from projects.identifiers import series_product
from projects.store import Project
from reports.crate import Action
from reports.deposit import Deposit
from reports.document import gather_facts
from reports.exports import export_comparison, export_series
from reports.kept import (
    kept_comparisons,
    outdated_epochs,
    require_comparison,
    series_resting_on,
    tell_old_series,
)
from reports.report import write_report

MEANINGS = {
    ".ply": "Difference model: signed normal distance, level of detection and state of each vertex; reference frame",
    ".csv": "Regions of change: kind, area, volume, extreme and mean, each with one sigma; metres",
    ".json": "Summary: motion between the epochs with its covariance, statistics, settings, versions",
}


def add_comparison(deposit: Deposit, project: Project, object_id: str, pair: tuple[str, str]) -> None:
    """Put the comparison of two epochs (reference, compared) into a deposit that holds these epochs already."""
    step = require_comparison(project, object_id, *pair)
    comparison = project.get(object_id, pair[1], step.product, step.step_id)
    stem = deposit.folder_of(object_id, pair[1]).parent / "_".join(pair) / "_".join((object_id, *pair))
    stem.parent.mkdir()
    made: tuple[str, ...] = ()
    for path in export_comparison(stem.parent, (object_id, *pair), comparison, step, ("ply",), crs=project.crs):
        made += deposit.add(path, MEANINGS[path.suffix])
    deposit.made_by[step.step_id] = made
    steps, followed = [step], series_resting_on(project, object_id, pair, step)
    if followed is not None:
        steps.append(followed)
        series = project.get(object_id, pair[1], followed.product, followed.step_id)
        front = project.object(object_id).front
        written = export_series(stem.parent, object_id, series, comparison, ("ply",), bearing=front, crs=project.crs)
        told = "Change over all epochs: rates on the reference surface, regions and their course"
        deposit.made_by[followed.step_id] = deposit.add(written, told)
    written = write_report(stem.with_name(f"{stem.name}_report"), gather_facts(project, object_id, *pair))
    made += deposit.add(written, "Report: what changed, where, how much and how sure")
    deposit.add_provenance(stem.with_name(f"{stem.name}_provenance.json"), steps)
    if told := tell_old_series(project, object_id, pair, step):
        deposit.minds.append(told)
    outdated = outdated_epochs(project, object_id, pair, step)
    for epoch_id in outdated:
        deposit.minds.append(
            f"epoch {epoch_id} of {object_id} was processed again after it was compared ({pair[0]} and {pair[1]}): the "
            "comparison is of the surface of before"
        )
    name = f"Comparison of epochs {pair[0]} and {pair[1]} of {object_id}"
    compared = _surfaces(deposit, object_id, [e for e in pair if e not in outdated])
    deposit.actions.append(Action(name, step.created, compared, made, step.versions))


def add_series_actions(deposit: Deposit, project: Project, object_id: str) -> None:
    """Enter of which comparisons each series came; the deposit holds all comparisons of the object already."""
    for reference_id, compared_id in kept_comparisons(project, object_id):
        followed = project.latest(object_id, compared_id, series_product(reference_id))
        if followed is None or followed.step_id not in deposit.made_by:
            continue
        of = tuple(name for step_id in followed.inputs for name in deposit.made_by.get(step_id, ()))
        name = f"Change of {object_id} followed from epoch {reference_id} to {compared_id}"
        results = deposit.made_by[followed.step_id]
        deposit.actions.append(Action(name, followed.created, of, results, followed.versions))


def _surfaces(deposit: Deposit, object_id: str, epoch_ids: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the epochs' surfaces, as far as the deposit holds them."""
    paths = [deposit.folder_of(object_id, e) / f"{object_id}_{e}_surface.ply" for e in epoch_ids]
    names = [Path(path).relative_to(deposit.payload).as_posix() for path in paths]
    return tuple(name for name in names if name in deposit.contents)
