"""A documentation archive: a project, or one object of it, as files that need no program of ours to be read.

In: an open project. Out: a folder that is a BagIt bag (RFC 8493) and holds an RO-Crate: of each epoch the scans as
measured (E57), poses, the thinned cloud (text), the mesh (OBJ, PLY) and metadata; of each comparison its difference
models, tables and report; and of everything how it came to be.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from projects.bags import PAYLOAD, write_bag
from projects.errors import ParameterError, StoreError
from projects.formats.complete_file import complete_folder
from projects.provenance import versions
from projects.store import Project
from reports.crate import write_crate
from reports.deposit import Deposit
from reports.deposit_comparison import add_comparison, add_series_actions
from reports.deposit_epoch import add_epoch
from reports.kept import kept_comparisons, lost_error, lost_results
from reports.quantities import listed


@dataclass(frozen=True)
class ArchiveFacts:
    """What was written: number of files and bytes of the payload, and what its reader should mind."""

    n_files: int
    n_bytes: int
    minds: tuple[str, ...]


def write_archive(
    out: Path, project: Project, object_ids: Sequence[str], notify: Callable[[str], None]
) -> ArchiveFacts:
    """Write the archive of some objects of a project; the folder appears when all of it is there.

    Parameters
    ----------
    out : a folder that is new or empty, outside of the project.
    object_ids : at least one, each with at least one epoch.
    notify : is told what is being written.

    Raises
    ------
    ParameterError
        If `out` holds anything, lies within the project or cannot be written.
    StoreError
        If an object has no epoch, or a file of the project is missing or damaged.
    """
    if out.resolve().is_relative_to(project.path.resolve()):
        raise ParameterError(f"{out}: lies within the project; give a folder outside of {project.path}")
    for object_id in object_ids:
        if not project.epochs(object_id):
            raise StoreError(f"object {object_id} has no epoch yet, so there is nothing to archive; add one first")
        _require_none_lost(project, object_id)
    title = _title(project, object_ids)
    with complete_folder(out) as folder:
        deposit = Deposit(folder / PAYLOAD)
        deposit.payload.mkdir()
        for object_id in object_ids:
            _add_object(deposit, project, object_id, notify)
        notify("writing what the archive holds, with the hash of each file")
        _write_readme(deposit, project, object_ids, title)
        subjects = [project.object(object_id) for object_id in object_ids]
        write_crate(deposit.payload, title, subjects, deposit.contents, deposit.actions)
        n_files, n_bytes = write_bag(folder, _about(object_ids, title))
    return ArchiveFacts(n_files, n_bytes, tuple(deposit.minds))


def _require_none_lost(project: Project, object_id: str) -> None:
    """Raise `StoreError` where an archive would leave out what the index lists."""
    lost = lost_results(project, object_id)
    if lost:
        raise lost_error(lost[0], project, object_id)


def _add_object(deposit: Deposit, project: Project, object_id: str, notify: Callable[[str], None]) -> None:
    """Add an object's epochs and comparisons."""
    for epoch in project.epochs(object_id):
        notify(f"{object_id} {epoch.epoch_id}: writing what was measured and made")
        add_epoch(deposit, project, epoch)
    for pair in kept_comparisons(project, object_id):
        notify(f"{object_id} {pair[1]}: writing the comparison with {pair[0]} and its report")
        add_comparison(deposit, project, object_id, pair)
    add_series_actions(deposit, project, object_id)


def _write_readme(deposit: Deposit, project: Project, object_ids: Sequence[str], title: str) -> None:
    """Write what a reader without any of our programs must know, first of all."""
    template = files("reports").joinpath("templates/archive.txt").read_text(encoding="utf-8")
    objects = [(project.object(o), project.epochs(o), kept_comparisons(project, o)) for o in object_ids]
    page = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, autoescape=False, keep_trailing_newline=True
    )
    told = page.from_string(template).render(
        title=title, project=project, objects=objects, minds=deposit.minds, today=_today(), version=_version(),
        **_standing(project, object_ids),
    )  # fmt: skip
    path = deposit.payload / "README.txt"
    path.write_text(told, encoding="utf-8", newline="\n")
    deposit.add(path, "What is in this archive, in words")


def _standing(project: Project, object_ids: Sequence[str]) -> dict[str, str]:
    """Return in words whether the poses of scans are `standing` as registered or as given, and of which epochs they are
    `as_given`, "" where of none."""
    epochs = [e for object_id in object_ids for e in project.epochs(object_id) if not e.is_mesh]
    names = [f"{e.object_id} {e.epoch_id}" for e in epochs
             if project.latest(e.object_id, e.epoch_id, "network") is None]  # fmt: skip
    known = "as given, not registered" if len(names) == len(epochs) else "as registered or as given (below)"
    return {"standing": known if names else "as registered", "as_given": listed(names)}


def _title(project: Project, object_ids: Sequence[str]) -> str:
    """Return the archive's title."""
    names = [" ".join((project.object(o).name or o).split()) for o in object_ids]
    of_objects = ", ".join(names) if len(names) <= 3 else f"{len(names)} objects"
    return f"{' '.join(project.name.split())}: {of_objects}" if project.name.strip() else of_objects


def _about(object_ids: Sequence[str], title: str) -> dict[str, str]:
    """Return what stands in `bag-info.txt`."""
    return {
        "External-Description": f"Documentation archive of {title}",
        "External-Identifier": " ".join(object_ids),
        "Bagging-Date": _today(),
        "Bag-Software-Agent": f"heritage-monitor {_version()}",
    }


def _version() -> str:
    """Return the version of this program."""
    return versions()["heritage-monitor"]


def _today() -> str:
    """Return the date of today (UTC), ISO 8601."""
    return datetime.datetime.now(datetime.UTC).date().isoformat()
