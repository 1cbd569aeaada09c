"""The command demo: the whole job on an example that the project makes itself, through the commands a user has."""

from __future__ import annotations

from pathlib import Path

import typer

from monitor.cli.adding import EpochRequest, add_epoch_to_project
from monitor.cli.keeping import add_object_to_project, init_project
from monitor.cli.progress import show_progress
from monitor.cli.results import export_results, make_folder, write_reports
from monitor.cli.working import compare_object, process_project
from monitor.simulation import DemoCampaign, write_demo_campaign
from projects.errors import ParameterError
from projects.store import Project

OBJECT, EPOCHS = "figure", ("before", "after")


def run_demo(out: Path) -> Path:
    """Scan the carved figure twice, run everything on it and name the report; return the report's path.

    A demo that was interrupted goes on where it stopped; one that is complete is only reported again.
    """
    _require_own_folder(out)
    make_folder(out)
    with show_progress() as notify:
        notify("scanning a carved figure in two epochs (simulated)")
        try:
            campaign = write_demo_campaign(out / "scans")
        except OSError as error:
            raise ParameterError(f"--out {out}: the scans cannot be written ({error.strerror})") from error
    project = out / "project"
    _fill_project(project, campaign)
    process_project(project)
    compare_object(project, OBJECT, EPOCHS)
    export_results(project, OBJECT, EPOCHS, out / "export", "ply")
    report, _ = write_reports(project, OBJECT, EPOCHS, out / "report")
    typer.echo(f"\nThe truth, which no survey knows, is in {out / 'scans' / 'truth.json'}")
    typer.echo(f"The report: {report.resolve()}")
    return report


def _require_own_folder(out: Path) -> None:
    """Refuse a folder that holds anything but an earlier demo."""
    if out.exists() and not out.is_dir():
        raise ParameterError(f"--out {out}: is a file; give a folder")
    if out.is_dir() and any(out.iterdir()) and not (out / "scans" / "truth.json").exists():
        raise ParameterError(f"--out {out}: holds something else; give a new folder")


def _fill_project(path: Path, campaign: DemoCampaign) -> None:
    """Start the project and add the object and its two epochs, as far as they are not there yet."""
    if not path.exists():
        init_project(path, "Demo: a carved figure", "", "Made by monitor demo: simulated scans with known truth.")
    project = Project.open(path)
    texts = {k: campaign.texts[k] for k in ("name", "inventory", "place", "material", "description")}
    if OBJECT not in [o.object_id for o in project.objects()]:
        add_object_to_project(path, OBJECT, texts, campaign.extent, None)
    known = [e.epoch_id for e in project.epochs(OBJECT)]
    for k, epoch in enumerate(EPOCHS):
        if epoch not in known:
            add_epoch_to_project(path, _request(campaign, k), False)


def _request(campaign: DemoCampaign, k: int) -> EpochRequest:
    """Return what `add-epoch` is asked for one epoch of the demo."""
    return EpochRequest(
        object_id=OBJECT, epoch_id=EPOCHS[k], date=campaign.dates[k].isoformat(), label=campaign.labels[k],
        scanner=campaign.scanner, operator=campaign.texts["operator"], poses=None, control=None, repeated=False,
        mesh=False, unit=None, files=(campaign.epochs[k],),
    )  # fmt: skip
