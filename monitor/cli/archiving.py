"""The command archive: a project, or one object of it, as a folder of files for the decades."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

import typer

from monitor.cli.progress import show_progress
from projects.errors import StoreError
from projects.store import Project
from reports.archive import write_archive

MEBIBYTE = 2.0**20


def archive_project(path: Path, object_id: str | None, out: Path) -> None:
    """Write the archive and say what it holds, and what is not as its reader would expect."""
    project = Project.open(path)
    known = [record.object_id for record in project.objects()]
    if object_id is not None:
        known = [project.object(object_id).object_id]
    if not known:
        raise StoreError(f"{path}: has no object yet, so there is nothing to archive")
    with show_progress() as notify:
        facts = write_archive(out, project, known, notify)
    for mind in facts.minds:
        typer.echo(f"mind: {mind}", err=True)
    typer.echo(
        f"{out}: {facts.n_files} files of data in a bag, {facts.n_bytes / MEBIBYTE:.1f} MiB; check it with: "
        f"monitor verify {quote(str(out))}"
    )
