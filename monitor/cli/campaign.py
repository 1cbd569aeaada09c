"""The command run: a whole campaign as its file declares it, through the commands that a user has.

What the project holds already stays, so that the same command goes on where it was interrupted, and a file that grew by
an epoch adds only that. An object that fails does not keep the others from it, nor an epoch or a comparison the others
of its object.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import typer

from monitor.cli.adding import add_epoch_to_project
from monitor.cli.archiving import archive_project
from monitor.cli.campaign_file import Campaign, ObjectRequest, read_campaign
from monitor.cli.declared import require_as_declared, require_epochs_of_pairs, words_not_taken
from monitor.cli.keeping import init_project, turn_to_front
from monitor.cli.results import export_results, update_reports
from monitor.cli.working import HERE, Where, compare_object, process_project
from monitor.settings import read_settings
from projects.errors import MonitorError, StoreError
from projects.index_file import INDEX_NAME
from projects.store import Project
from reports.kept import kept_comparisons


def run_campaign(path: Path, settings_file: Path | None = None, where: Where = HERE) -> None:
    """Do all that a campaign's file declares; end with an error that names the objects that failed."""
    campaign = read_campaign(path)
    settings = settings_file or campaign.settings
    read_settings(settings)  # before anything is done
    present = Project.open(campaign.project) if (campaign.project / INDEX_NAME).exists() else None
    for wanted in campaign.objects:
        require_epochs_of_pairs(wanted, present)
    if present is None:
        init_project(campaign.project, campaign.name, campaign.crs, campaign.description)
    else:
        require_as_declared(present, campaign)
        for told in words_not_taken(present, campaign):
            typer.echo(f"mind: {told}", err=True)
    failed = [o.record.object_id for o in campaign.objects if not _try_object(campaign, o, settings, where)]
    if campaign.archive is not None and not failed:
        _archive(campaign, campaign.archive)
    if failed:
        others = "" if len(failed) == len(campaign.objects) else "the others are done, "
        them = failed[0] if len(failed) == 1 else "them"
        raise StoreError(
            f"{len(failed)} of {len(campaign.objects)} objects failed ({', '.join(failed)}), for what is said above; "
            f"{others}what else could be done of {them} is, and the same command goes on"
        )


def _try_object(campaign: Campaign, wanted: ObjectRequest, settings: Path | None, where: Where) -> bool:
    """Do one object, each piece of the work whatever became of the others; return whether all of it was done."""
    object_id, done = wanted.record.object_id, [True]

    def try_pieces() -> None:
        """Do each piece of the work."""
        done.extend(_try(object_id, piece) for piece in _work_on(campaign, wanted, settings, where))

    return _try(object_id, try_pieces) and all(done)


def _try(object_id: str, piece: Callable[[], object]) -> bool:
    """Do a piece of the work on an object; say what kept it from being done, and return whether it was."""
    try:
        piece()
    except MonitorError as error:
        typer.echo(f"monitor: {object_id}: {error}", err=True)
        return False
    return True


def _work_on(
    campaign: Campaign, wanted: ObjectRequest, settings: Path | None, where: Where
) -> Iterator[Callable[[], object]]:
    """Give one by one, each chosen by what those before have done: add what is missing of one object, process, compare,
    and write what is to be handed out. What an epoch that could not be added would bring is not asked for."""
    path, object_id = campaign.project, wanted.record.object_id
    project = Project.open(path)
    if object_id not in {record.object_id for record in project.objects()}:
        project.add_object(wanted.record)
        typer.echo(f"object {object_id} added to {path}")
    yield partial(turn_to_front, project, object_id, wanted.record.front)
    kept = {e.epoch_id for e in project.epochs(object_id)}
    for request in wanted.epochs:
        if request.epoch_id not in kept:
            yield partial(add_epoch_to_project, path, request, False)
    kept = {e.epoch_id for e in project.epochs(object_id)}
    if not kept and wanted.epochs:
        return
    given: dict[str, Any] = {"settings_file": settings, "where": where}
    yield partial(process_project, path, object_id, **given)
    for pair in wanted.pairs:
        if {pair.reference, pair.compared} <= kept:
            named = pair.reference, pair.compared
            yield partial(compare_object, path, object_id, named, mode=pair.mode, stable_file=pair.stable, **given)
    if not wanted.pairs and len(kept) > 1:
        yield partial(compare_object, path, object_id, (None, None), **given)
    if campaign.report is not None and kept_comparisons(project, object_id):
        yield partial(update_reports, path, object_id, campaign.report)
    if campaign.export is not None:
        yield partial(export_results, path, object_id, (None, None), campaign.export, campaign.formats)


def _archive(campaign: Campaign, out: Path) -> None:
    """Write the archive; one that is there already stays."""
    if out.is_dir() and any(out.iterdir()):
        typer.echo(f"mind: {out} is there already and stays as it was; name another folder for a new archive", err=True)
        return
    archive_project(campaign.project, None, out)
