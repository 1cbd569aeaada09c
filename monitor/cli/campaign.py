"""The command run: a whole campaign as its file declares it, through the commands that a user has.

What the project holds already stays, so that the same command goes on where it was interrupted, and a file that grew by
an epoch adds only that. An object that fails does not keep the others from it.
"""

from __future__ import annotations

from pathlib import Path

import typer

from monitor.cli.adding import EpochRequest, add_epoch_to_project
from monitor.cli.archiving import archive_project
from monitor.cli.campaign_file import Campaign, ObjectRequest, read_campaign
from monitor.cli.keeping import init_project
from monitor.cli.results import export_results, write_reports
from monitor.cli.working import HERE, Where, compare_object, process_project
from monitor.settings import read_settings
from projects.errors import MonitorError, StoreError
from projects.index_file import INDEX_NAME
from projects.model import ObjectRecord
from projects.provenance import hash_file
from projects.store import Project
from reports.document import kept_comparisons


def run_campaign(path: Path, settings_file: Path | None = None, where: Where = HERE) -> None:
    """Do all that a campaign's file declares; end with an error that names the objects that failed."""
    campaign = read_campaign(path)
    settings = settings_file or campaign.settings
    read_settings(settings)  # before anything is done
    if not (campaign.project / INDEX_NAME).exists():
        init_project(campaign.project, campaign.name, campaign.crs, campaign.description)
    project = Project.open(campaign.project)
    _require_as_declared(project, campaign)
    failed = [o.record.object_id for o in campaign.objects if not _try_object(campaign, o, settings, where)]
    if campaign.archive is not None and not failed:
        _archive(campaign, campaign.archive)
    if failed:
        raise StoreError(
            f"{len(failed)} of {len(campaign.objects)} objects failed ({', '.join(failed)}), for what is said above; "
            "the others are done, and the same command goes on"
        )


def _require_as_declared(project: Project, campaign: Campaign) -> None:
    """Refuse, before anything is done, a file that says otherwise than the project of what that holds already."""
    if campaign.crs and project.crs != campaign.crs:
        raise StoreError(f"{project.path} has the reference system {project.crs or 'none'}, not {campaign.crs}")
    known = {record.object_id: record for record in project.objects()}
    for wanted in campaign.objects:
        present = known.get(wanted.record.object_id)
        if present is not None:
            _require_same_object(present, wanted.record)
            for request in wanted.epochs:
                _require_same_epoch(project, request)


def _require_same_object(present: ObjectRecord, wanted: ObjectRecord) -> None:
    """Refuse an object that is kept with another extent or tolerance, on which its figures rest."""
    for name, unit in (("extent", ""), ("tolerance", " m")):
        kept, asked = getattr(present, name), getattr(wanted, name)
        if kept != asked:
            raise StoreError(
                f"object {present.object_id} is in the project with the {name} {kept}{unit}, not {asked}{unit}; a "
                "project's object stays as it was added: correct the file, or take another id"
            )


def _require_same_epoch(project: Project, request: EpochRequest) -> None:
    """Refuse an epoch that is kept with another date or other files."""
    kept = {e.epoch_id: e for e in project.epochs(request.object_id)}.get(request.epoch_id)
    if kept is None:
        return
    same_files = {str(s["sha256"]) for s in kept.sources} == {hash_file(f) for f in request.files}
    if kept.date.isoformat() != request.date or not same_files:
        what = "other files" if not same_files else f"the date {kept.date.isoformat()}, not {request.date}"
        raise StoreError(
            f"epoch {request.epoch_id} of object {request.object_id} is in the project with {what}; take another id or "
            f"remove it first: monitor remove-epoch {project.path} {request.object_id} {request.epoch_id}"
        )


def _try_object(campaign: Campaign, wanted: ObjectRequest, settings: Path | None, where: Where) -> bool:
    """Do one object; say what kept it from being done, and return whether it was."""
    try:
        _run_object(campaign, wanted, settings, where)
    except MonitorError as error:
        typer.echo(f"monitor: {wanted.record.object_id}: {error}", err=True)
        return False
    return True


def _run_object(campaign: Campaign, wanted: ObjectRequest, settings: Path | None, where: Where) -> None:
    """Add what is missing of one object, process, compare, and write what is to be handed out."""
    path, object_id = campaign.project, wanted.record.object_id
    project = Project.open(path)
    if object_id not in {record.object_id for record in project.objects()}:
        project.add_object(wanted.record)
        typer.echo(f"object {object_id} added to {path}")
    kept = {e.epoch_id for e in project.epochs(object_id)}
    for request in wanted.epochs:
        if request.epoch_id not in kept:
            add_epoch_to_project(path, request, False)
    process_project(path, object_id, settings_file=settings, where=where)
    if wanted.pairs:
        for pair in wanted.pairs:
            compare_object(
                path, object_id, (pair.reference, pair.compared), mode=pair.mode, stable_file=pair.stable,
                settings_file=settings, where=where,
            )  # fmt: skip
    elif len(project.epochs(object_id)) > 1:
        compare_object(path, object_id, (None, None), settings_file=settings, where=where)
    if campaign.report is not None and kept_comparisons(project, object_id):
        write_reports(path, object_id, (None, None), campaign.report)
    if campaign.export is not None:
        export_results(path, object_id, (None, None), campaign.export, campaign.formats)


def _archive(campaign: Campaign, out: Path) -> None:
    """Write the archive; one that is there already stays."""
    if out.is_dir() and any(out.iterdir()):
        typer.echo(f"mind: {out} is there already and stays as it was; name another folder for a new archive", err=True)
        return
    archive_project(campaign.project, None, out)
