"""Commands that give results: export and report."""

from __future__ import annotations

import os
from pathlib import Path

import typer

from monitor.cli.pairs import Pair, named_pair
from monitor.cli.progress import show_progress
from monitor.reconstruction.screen import decimate_for_screen
from monitor.record import Place, latest_step
from projects.errors import ParameterError, StoreError
from projects.formats import write_screen_glb
from projects.model import Comparison, Step, Surface
from projects.store import Project
from reports.document import gather_facts
from reports.exports import FORMATS, export_comparison, export_series, export_surface
from reports.kept import (
    end_of_longest_series,
    kept_comparisons,
    lost_results,
    outdated_epochs,
    require_comparison,
    series_resting_on,
    tell_old_series,
)
from reports.report import is_current, write_report

SCREEN = "screen"  # a GLB for viewers: few faces and a normal map
SCREEN_FACES = 100_000


def export_results(path: Path, object_id: str, pair: Pair, out: Path, formats: str) -> list[Path]:
    """Write surfaces and comparisons with their fixed names and name every file written."""
    project = Project.open(path)
    wanted = parse_formats(formats)
    epochs, comparisons = _what_to_export(project, object_id, pair)
    if SCREEN in wanted and not epochs:
        raise ParameterError(
            f"--format {formats}: {SCREEN} is the light model of one epoch; of a comparison take {', '.join(FORMATS)}"
        )
    surfaces = [latest_step(Place(project, object_id, epoch_id), "surface") for epoch_id in epochs]
    _make_folder_outside(project, out)
    written: list[Path] = []
    with show_progress() as notify:
        for epoch_id, made in zip(epochs, surfaces, strict=True):
            notify(f"{epoch_id}: writing the surface")
            surface = project.get(object_id, epoch_id, "surface", made.step_id)
            plain = tuple(f for f in wanted if f != SCREEN)
            written += export_surface(out, object_id, epoch_id, surface, plain, crs=project.crs)
            if SCREEN in wanted:
                notify(f"{epoch_id}: making a light model for the screen")
                written.append(_export_screen(out / f"{object_id}_{epoch_id}_screen.glb", surface))
        for reference_id, compared_id in comparisons:
            notify(f"{compared_id}: writing the comparison with {reference_id}")
            step = require_comparison(project, object_id, reference_id, compared_id)
            _mind_outdated(project, object_id, (reference_id, compared_id), step)
            _mind_old_series(project, object_id, (reference_id, compared_id), step)
            if pair[1]:
                _mind_shorter_series(project, object_id, (reference_id, compared_id), step)
            comparison = project.get(object_id, compared_id, step.product, step.step_id)
            ids = (object_id, reference_id, compared_id)
            plain = tuple(f for f in wanted if f != SCREEN)
            written += export_comparison(out, ids, comparison, step, plain, crs=project.crs)
            written += _export_series(project, out, ids, (step, comparison), plain)
    for file in written:
        typer.echo(str(file))
    return written


def _mind_outdated(project: Project, object_id: str, pair: tuple[str, str], step: Step) -> None:
    """Say so where an epoch was processed again after a comparison of it."""
    for epoch_id in outdated_epochs(project, object_id, pair, step):
        typer.echo(
            f"mind: {epoch_id} was processed again after {pair[0]} and {pair[1]} were compared, and the files of the "
            f"comparison are of before; bring it up to date: monitor compare {project.quoted} {object_id} {pair[0]} "
            f"{pair[1]}", err=True,
        )  # fmt: skip


def _export_screen(path: Path, surface: Surface) -> Path:
    """Write a surface as a light mesh with a normal map."""
    model = decimate_for_screen(surface, SCREEN_FACES)
    write_screen_glb(path, model.surface, model.uv, model.tangents, model.normal_map)
    return path


def _export_series(
    project: Project, out: Path, ids: tuple[str, str, str], made: tuple[Step, Comparison], formats: tuple[str, ...]
) -> list[Path]:
    """Write the series that the compared epoch ends, where it is current and none from the reference is longer: all
    have the same names."""
    object_id, reference_id, compared_id = ids
    step = series_resting_on(project, object_id, (reference_id, compared_id), made[0])
    if step is None or end_of_longest_series(project, object_id, reference_id) != compared_id:
        return []
    series = project.get(object_id, compared_id, step.product, step.step_id)
    front = project.object(object_id).front
    return export_series(out, object_id, series, made[1], formats, bearing=front, crs=project.crs)


def _mind_old_series(project: Project, object_id: str, pair: tuple[str, str], step: Step) -> None:
    """Say so where the series that the compared epoch ends does not rest on the present comparisons."""
    if told := tell_old_series(project, object_id, pair, step):
        typer.echo(f"mind: {told}; bring it up to date: monitor compare {project.quoted} {object_id}", err=True)


def _mind_shorter_series(project: Project, object_id: str, pair: tuple[str, str], step: Step) -> None:
    """Say so where the series that the compared epoch ends gives way to a longer one."""
    longest = end_of_longest_series(project, object_id, pair[0])
    if series_resting_on(project, object_id, pair, step) is not None and longest != pair[1]:
        typer.echo(
            f"mind: the series from {pair[0]} to {pair[1]} is left out, since change is followed to {longest}; that "
            f"series is written with {pair[0]} {longest}", err=True,
        )  # fmt: skip


def parse_formats(text: str) -> tuple[str, ...]:
    """Return the formats of `--format`, each known."""
    wanted = tuple(dict.fromkeys(f.strip().lower() for f in text.split(",") if f.strip()))
    unknown = [f for f in wanted if f not in (*FORMATS, SCREEN)]
    if unknown or not wanted:
        raise ParameterError(f"--format {text}: allowed are {', '.join((*FORMATS, SCREEN))}, with commas between them")
    return wanted


def _what_to_export(project: Project, object_id: str, pair: Pair) -> tuple[list[str], list[tuple[str, str]]]:
    """Return the epochs and the comparisons meant: one comparison, one epoch, or everything there is."""
    reference, compared = pair
    if reference and not compared:
        return [project.epoch(object_id, reference).epoch_id], []
    named = named_pair(project, object_id, pair)
    if named is not None:
        return [], [named]
    known = [e.epoch_id for e in project.epochs(object_id)]
    epochs = [e for e in known if "surface" in {step.product for step in project.steps(object_id, e)}]
    if not epochs:
        raise StoreError(
            f"object {object_id} has nothing to export yet; run: monitor process {project.quoted} {object_id}"
        )
    return epochs, _all_comparisons(project, object_id)


def _all_comparisons(project: Project, object_id: str) -> list[tuple[str, str]]:
    """Return the comparisons of an object; say which of them and of its series are left out, lost."""
    for lost in lost_results(project, object_id):
        typer.echo(
            f"mind: {lost} is left out: its file is missing or cut off; monitor verify {project.quoted} names it, and "
            f"monitor compare {project.quoted} {object_id} makes it anew", err=True,
        )  # fmt: skip
    return kept_comparisons(project, object_id)


def write_reports(path: Path, object_id: str, pair: Pair, out: Path) -> list[Path]:
    """Write the report of one comparison, or of all that the project holds, and name the files."""
    project = Project.open(path)
    pairs = _what_to_report(project, object_id, pair)
    _make_folder_outside(project, out)
    written: list[Path] = []
    with show_progress() as notify:
        for reference_id, compared_id in pairs:
            step = require_comparison(project, object_id, reference_id, compared_id)
            _mind_old_series(project, object_id, (reference_id, compared_id), step)
            notify(f"{compared_id}: drawing the report of the comparison with {reference_id}")
            facts = gather_facts(project, object_id, reference_id, compared_id)
            written += write_report(_stem(out, object_id, (reference_id, compared_id)), facts)
    for file in written:
        typer.echo(str(file))
    return written


def update_reports(path: Path, object_id: str, out: Path) -> list[Path]:
    """Write the reports of all comparisons of an object that are not there as the project and this program would make
    them; name the files written, and how many others stay."""
    project = Project.open(path)
    _make_folder_outside(project, out)
    written: list[Path] = []
    n_kept = 0
    with show_progress() as notify:
        for pair in _all_comparisons(project, object_id):
            facts, stem = gather_facts(project, object_id, *pair), _stem(out, object_id, pair)
            if is_current(stem, facts):
                n_kept += 1
                continue
            notify(f"{pair[1]}: drawing the report of the comparison with {pair[0]}")
            written += write_report(stem, facts)
    for file in written:
        typer.echo(str(file))
    if n_kept:
        typer.echo(f"{n_kept} report{'s' if n_kept > 1 else ''} of {object_id} up to date in {out}")
    return written


def _stem(out: Path, object_id: str, pair: tuple[str, str]) -> Path:
    """Return the path of a report, without the endings of its files."""
    return out / f"{'_'.join((object_id, *pair))}_report"


def _what_to_report(project: Project, object_id: str, pair: Pair) -> list[tuple[str, str]]:
    """Return the comparisons meant."""
    named = named_pair(project, object_id, pair)
    if named is not None:
        return [named]
    pairs, epochs = _all_comparisons(project, object_id), project.epochs(object_id)
    if len(epochs) < 2:
        has = f"one epoch, {epochs[0].epoch_id}" if epochs else "no epoch yet"
        raise StoreError(
            f"object {object_id} has {has}, and a report tells what changed between two; add the next survey: "
            f"monitor add-epoch {project.quoted} {object_id} EPOCH --date YYYY-MM-DD FILE..."
        )
    if not pairs:
        raise StoreError(f"object {object_id} has no comparison yet; run: monitor compare {project.quoted} {object_id}")
    return pairs


def _make_folder_outside(project: Project, out: Path) -> None:
    """Make the folder of `--out`; refuse one within the project, which holds nothing but what the index names."""
    if out.resolve().is_relative_to(project.path.resolve()):
        raise ParameterError(f"--out {out}: lies within the project; give a folder outside of {project.path}")
    make_folder(out)


def require_place(out: Path, what: str) -> None:
    """Refuse a folder that cannot be made or written, before any work; it is made when there is something for it."""
    there = next(p for p in (out.absolute(), *out.absolute().parents) if p.exists())
    if not there.is_dir() or not os.access(there, os.W_OK):
        why = "may not be written" if there.is_dir() else "is a file"
        raise ParameterError(f"{what} {out}: {there} {why}; another folder is needed")


def make_folder(out: Path) -> None:
    """Make the folder of `--out`, or say why it cannot be."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ParameterError(f"--out {out}: cannot be made a folder ({error.strerror})") from error
