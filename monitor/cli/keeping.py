"""Commands that keep: init, add-object, set-front, remove-epoch, verify, status."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from monitor.cli.units import bearing_from_direction, metres_from_millimetres
from projects.bags import is_bag, verify_bag
from projects.errors import StoreError
from projects.extent import read_extent
from projects.identifiers import comparison_product, series_product
from projects.index_file import INDEX_NAME
from projects.model import EpochRecord, ObjectRecord
from projects.products import GIVEN
from projects.reference_systems import require_projected_metres
from projects.store import Project
from projects.verify import verify_project
from reports.kept import outdated_epochs
from reports.quantities import tell_bearing

LOST = "file missing"
UNCUT = 1000  # characters a line
COMPARISON, SERIES = comparison_product(""), series_product("")  # and the epoch that it goes out from


def init_project(path: Path, name: str, crs: str, description: str) -> None:
    """Start a project."""
    if crs:
        require_projected_metres(crs)
    project = Project.create(path, name=name, crs=crs, description=description)
    typer.echo(f"project {project.name or path.name} started in {path}")


def add_object_to_project(
    path: Path, object_id: str, texts: dict[str, str], extent: Path | None, tolerance: float | None,
    front: str | None = None,
) -> None:  # fmt: skip
    """Add an object with its texts, extent, the client's tolerance [mm] and the side to which its front faces."""
    project = Project.open(path)
    stored = None if extent is None else read_extent(extent).to_mapping()
    limit = None if tolerance is None else metres_from_millimetres(tolerance, "--tolerance")
    faces = None if front is None else bearing_from_direction(front, "--front")
    project.add_object(ObjectRecord(object_id=object_id, extent=stored, tolerance=limit, front=faces, **texts))
    typer.echo(f"object {object_id} added to {path}")


def set_front_of_object(path: Path, object_id: str, direction: str) -> None:
    """Take over to which side the front of an object that is kept faces."""
    turn_to_front(Project.open(path), object_id, bearing_from_direction(direction, "DIRECTION"))
    typer.echo(f"monitor report {shlex.quote(str(path))} {object_id} draws its reports so")


def turn_to_front(project: Project, object_id: str, front: float | None) -> None:
    """Take over another front [rad], which decides nothing but how the object is shown, and say so; None: it stays."""
    kept = project.object(object_id).front
    if front is not None and front != kept:
        project.set_front(object_id, front)
        before = "was found from its surface" if kept is None else f"faced {tell_bearing(kept)}"
        typer.echo(f"the front of object {object_id} faces {tell_bearing(front)} from now on; it {before}")


def remove_epoch_from_project(path: Path, object_id: str, epoch_id: str, purge: bool) -> None:
    """Take an epoch out of the index."""
    project = Project.open(path)
    before = _made_of_epochs(project, object_id)
    project.remove_epoch(object_id, epoch_id, purge=purge)
    kept = "and its files are deleted" if purge else "its files stay on disk until --purge"
    typer.echo(f"epoch {epoch_id} of object {object_id} is out of the project; {kept}")
    if gone := [made for made in before if made not in _made_of_epochs(project, object_id)]:
        typer.echo(f"with it went {', '.join(gone)}; monitor compare makes anew what can be made of the other epochs")


def _made_of_epochs(project: Project, object_id: str) -> list[str]:
    """Return in words the comparisons and the series that an object has."""
    comparisons, series = [], []
    for epoch in project.epochs(object_id):
        products = sorted({step.product for step in project.steps(object_id, epoch.epoch_id)})
        comparisons += [f"the comparison {p.removeprefix(COMPARISON)} to {epoch.epoch_id}"
                        for p in products if p.startswith(COMPARISON)]  # fmt: skip
        series += [f"the series from {p.removeprefix(SERIES)} on" for p in products if p.startswith(SERIES)]
    return comparisons + series


def verify_folder(path: Path, as_json: bool) -> None:
    """Check every file of a project or an archive against its record; one with errors ends with exit code 2."""
    what = "archive" if is_bag(path) else "project"
    if what == "project" and not (path / INDEX_NAME).exists():
        _require_something(path)
    report = verify_bag(path) if what == "archive" else verify_project(path)
    errors = [f for f in report.findings if f.severity == "error"]
    if as_json:
        findings = [{"severity": f.severity, "path": str(f.path), "message": f.message} for f in report.findings]
        typer.echo(json.dumps({what: str(path), "n_files": report.n_files, "findings": findings}, indent=2))
    else:
        for finding in report.findings:
            typer.echo(f"{finding.severity}: {finding.path}: {finding.message}")
    if errors:
        n = len(errors)
        raise StoreError(f"{path}: {n} {'thing is' if n == 1 else 'things are'} not as recorded; the first: "
                         f"{errors[0].message}")  # fmt: skip
    if not as_json:
        typer.echo(f"{path}: {report.n_files} files, all as recorded")


def _require_something(path: Path) -> None:
    """Raise for a path that is neither a project nor an archive: whoever checks one wants no new one."""
    try:
        path.stat()
    except FileNotFoundError:
        raise StoreError(f"{path}: there is nothing there; give the folder of a project or of an archive") from None
    except (OSError, ValueError):
        Project.open(path)  # says why it cannot be reached
    if not path.is_dir():
        raise StoreError(f"{path} is a file, and no folder of a project or of an archive")
    raise StoreError(
        f"{path} holds no {INDEX_NAME} of a project and is no archive; give the folder of a project or of an archive"
    )


def show_status(path: Path, as_json: bool) -> None:
    """Show what the project holds and what was done."""
    project = Project.open(path)
    facts = [_object_status(project, record) for record in project.objects()]
    if as_json:
        typer.echo(json.dumps({"project": str(path), "name": project.name, "objects": facts}, indent=2))
        return
    if not facts:
        typer.echo(f"{path}: no object yet; add one: monitor add-object {shlex.quote(str(path))} OBJECT")
    console = Console()
    if not console.is_terminal:
        console.width = UNCUT  # a program or a file has no width to cut ids for
    for fact in facts:
        title = f"{fact['object']}  {fact['name']}" if fact["name"] else fact["object"]
        console.print(Text(title, style="bold"))  # not markup: brackets are the user's own
        console.print(_status_table(fact["epochs"]))
    if any(epoch["without_file"] for fact in facts for epoch in fact["epochs"]):
        typer.echo(f"mind: files are missing or cut off; monitor verify {shlex.quote(str(path))} names them", err=True)


def _object_status(project: Project, record: ObjectRecord) -> dict[str, Any]:
    """Return one object's state as plain values."""
    epochs = [_epoch_status(project, epoch) for epoch in project.epochs(record.object_id)]
    return {"object": record.object_id, "name": record.name, "epochs": epochs}


def _epoch_status(project: Project, epoch: EpochRecord) -> dict[str, Any]:
    """Return one epoch's state as plain values."""
    headers = project.scan_headers(epoch.object_id, epoch.epoch_id)
    products = {step.product for step in project.steps(epoch.object_id, epoch.epoch_id)}
    lost = sorted(p for p in products if project.latest(epoch.object_id, epoch.epoch_id, p) is None)
    others = [e.epoch_id for e in project.epochs(epoch.object_id) if comparison_product(e.epoch_id) in products]
    return {
        "epoch": epoch.epoch_id,
        "date": epoch.date.isoformat(),
        "label": epoch.label,
        "n_scans": len(headers),
        "n_points": sum(header.n_points for header in headers),
        "is_mesh": epoch.is_mesh,
        "processed": project.latest(epoch.object_id, epoch.epoch_id, "surface") is not None,
        "compared_with": others,
        "outdated": [other for other in others if _is_outdated(project, epoch, other)],
        "without_file": lost,  # made, or given, but the file is missing or cut off
    }


def _is_outdated(project: Project, epoch: EpochRecord, other: str) -> bool:
    """Return whether an epoch, or the other that it is compared with, was processed again since."""
    step = project.latest(epoch.object_id, epoch.epoch_id, comparison_product(other))
    return step is not None and bool(outdated_epochs(project, epoch.object_id, (other, epoch.epoch_id), step))


def _status_table(epochs: list[dict[str, Any]]) -> Table:
    """Return one object's epochs as a table."""
    table = Table()
    for heading in ("epoch", "date", "label"):
        table.add_column(heading, overflow="fold")
    table.add_column("scans", justify="right")
    table.add_column("points", justify="right")
    table.add_column("surface")
    table.add_column("compared with", overflow="fold")
    for e in epochs:
        scans = "mesh" if e["is_mesh"] else str(e["n_scans"])
        points = "" if e["is_mesh"] else f"{e['n_points']:,}".replace(",", " ")
        surface = "made" if e["processed"] else LOST if "surface" in e["without_file"] else "to do"
        points = LOST if set(e["without_file"]) & set(GIVEN) else points
        compared = [f"{other} (out of date)" if other in e["outdated"] else other for other in e["compared_with"]]
        cells = e["epoch"], e["date"], e["label"], scans, points, surface, ", ".join(compared)
        table.add_row(*map(Text, cells))
    return table
