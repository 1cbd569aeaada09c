"""Commands that work: process and compare."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import typer

from monitor.chain import Notify, compare_epochs, pairs_to_compare, process_epoch
from monitor.cli.pairs import Pair, named_pair
from monitor.cli.progress import show_progress
from monitor.comparison.comparable import MODES
from monitor.engine import open_engine, require_where
from monitor.record import Place
from monitor.scan_network import tell_control
from monitor.settings import Settings, read_settings
from monitor.through_time import epochs_of_one_date, follow_epochs
from projects.errors import MonitorError, ParameterError, StoreError
from projects.extent import Extent, read_extent
from projects.model import Comparison, Step
from projects.store import Project
from reports.answer import differs_as_a_whole, shares_not_assessed
from reports.history import tell_alone, tell_open_holes, tell_outside, tell_turned, tell_uncovered
from reports.kept import compared_by_mode, say_modes
from reports.quantities import NBSP, millimetres, percent, square
from reports.smallest import is_beside_layer, told_by_width
from reports.wholemotion import knows_motion

Facts = dict[str, Any]
Where = tuple[int | None, str | None]  # workers, scheduler
HERE: Where = (None, None)  # in this process
# Of an epoch, where there is cause.
TOLD = ("open_holes", "uncovered", "outside", "turned", "alone", "control", "doubt")
COMPARED = "{object} {reference} -> {compared}: {answer}"  # the line of a comparison


def process_project(
    path: Path, object_id: str | None = None, epoch_id: str | None = None, *, settings_file: Path | None = None,
    where: Where = HERE, as_json: bool = False,
) -> None:  # fmt: skip
    """Process the epochs asked for, all by default, and say what each became; one that fails does not keep the others
    from it."""
    project = Project.open(path)
    settings = read_settings(settings_file)
    places = epochs_to_process(project, object_id, epoch_id)
    with show_progress() as notify, open_engine(*where) as engine:

        def process_place(place: Place) -> Facts:
            """Process one epoch and return what it became."""
            return _processed(place, process_epoch(place, settings, engine, notify))

        facts, failed = _try_each([partial(process_place, place) for place in places])
    _tell(facts, as_json, "{object} {epoch}: {n_vertices} vertices {source}")
    for fact in facts:
        for told in filter(None, (fact[name] for name in TOLD)):
            typer.echo(f"mind: {fact['object']} {fact['epoch']}: {told}", err=True)
    _require_all(len(facts), len(places), failed, "epochs could not be processed")


def _try_each(work: Sequence[Callable[[], Facts]]) -> tuple[list[Facts], list[MonitorError]]:
    """Do all of the work; return what came of it, and the errors. Of a single piece the error is raised."""
    done, failed = [], []
    for piece in work:
        try:
            done.append(piece())
        except MonitorError as error:
            if len(work) == 1:
                raise
            failed.append(error)
    return done, failed


def _require_all(n_done: int, n: int, failed: Sequence[MonitorError], what: str) -> None:
    """Say one by one what failed, and raise that `n` were asked for."""
    for error in failed:
        typer.echo(f"monitor: {error}", err=True)
    if failed:
        others = "the others are done" if n_done else "none is done"
        raise StoreError(f"{n - n_done} of {n} {what}, for what is said above; {others}")


def epochs_to_process(project: Project, object_id: str | None, epoch_id: str | None) -> list[Place]:
    """Return the epochs named, or all; none at all is an error that says what to add."""
    objects = [project.object(object_id)] if object_id else project.objects()
    if not objects:
        raise StoreError(f"{project.path} has no object yet; add one: monitor add-object {project.quoted} OBJECT")
    if object_id and epoch_id:
        return [Place(project, object_id, project.epoch(object_id, epoch_id).epoch_id)]
    places = [Place(project, o.object_id, e.epoch_id) for o in objects for e in project.epochs(o.object_id)]
    if not places:
        name = objects[0].object_id
        raise StoreError(
            f"object {name} has no epoch yet; add one: monitor add-epoch {project.quoted} {name} EPOCH ..."
        )
    return places


def _processed(place: Place, steps: list[Step]) -> Facts:
    """Return what one epoch became as plain values."""
    surface = place.project.get(place.object_id, place.epoch_id, "surface")
    headers = place.project.scan_headers(place.object_id, place.epoch_id)
    n_points = sum(h.n_points for h in headers)
    n_control = len(place.project.epoch(place.object_id, place.epoch_id).control)
    network = [s.automatic for s in steps if s.product == "network"]
    return {
        "object": place.object_id,
        "epoch": place.epoch_id,
        "n_points": n_points,
        "source": f"from {n_points} points" if headers else "of a finished mesh",
        "n_vertices": len(surface.vertices),
        "n_faces": len(surface.faces),
        "open_holes": "".join(tell_open_holes(s) for s in steps if s.product == "surface"),
        "uncovered": "".join(tell_uncovered(s) for s in steps if s.product == "surface").replace(NBSP, " "),
        "alone": "".join(tell_alone(s) for s in steps if s.product == "network").replace(NBSP, " "),
        "control": "".join(tell_control(figures, n_control) for figures in network),
        "doubt": "".join(str(figures.get("doubt") or "") for figures in network),
        "turned": "".join(tell_turned(s) for s in steps if s.product == "surface").replace(NBSP, " "),
        "outside": "".join(tell_outside(s) for s in steps if s.product == "surface").replace(NBSP, " "),
        "steps": {s.product: s.step_id for s in steps},
    }


def compare_object(
    path: Path, object_id: str, pair: Pair, *, mode: str | None = None, stable_file: Path | None = None,
    settings_file: Path | None = None, where: Where = HERE, as_json: bool = False,
) -> None:  # fmt: skip
    """Compare the epochs asked for and say what was found; a file may say where nothing moved."""
    stable = None if stable_file is None else read_extent(stable_file)
    if mode not in (None, *MODES):
        raise ParameterError(f"--mode {mode}: allowed are {', '.join(MODES)}")
    project = Project.open(path)
    settings = read_settings(settings_file)
    require_where(*where)
    pairs = resolve_pairs(project, object_id, pair)
    ready, bare = _without_bare(project, object_id, pairs)
    with show_progress() as notify, open_engine(*(where if len(ready) > 1 else HERE)) as engine:
        if not engine.is_here:
            notify(f"comparing {len(ready)} pairs of epochs on the workers")
        work = [_PairWork(path, object_id, pair, settings, mode, stable) for pair in ready]
        told = list(engine.map(partial(_compare_pair, here=(project, notify) if engine.is_here else None), work))
        facts = [found for found in told if not isinstance(found, MonitorError)]
        failed = [*bare, *(error for error in told if isinstance(error, MonitorError))]
        if len(failed) == 1 and not facts:  # one cause why none is compared is said by itself
            raise failed[0]
        whole = not pair[0] and not failed  # a pair that failed may have an older comparison, made otherwise
        try:
            followed = follow_epochs(project, object_id, notify) if whole else None
        except BaseException:  # what was compared is kept, and told even where this was interrupted
            _tell(facts, as_json, COMPARED)
            raise
        alike = epochs_of_one_date(project, object_id) if whole and len(pairs) > 1 else []
    if facts and followed is None and alike:
        facts[-1]["answer"] += f"; no series: {' and '.join(alike)} are of one date, and leave no order"
    elif facts and followed is None and whole:
        modes = say_modes(compared_by_mode(project, object_id))
        facts[-1]["answer"] += f"; no series: {modes}; --mode relative compares all alike" if modes else ""
    if facts and followed is not None:
        n = int(followed.counts["regions"])
        alone = int(followed.counts.get("regions_by_trend", 0))
        facts[-1]["series"] = {"n_epochs": followed.counts["epochs"], "n_regions": n, "n_regions_by_trend": alone}
        facts[-1]["answer"] += f"; {n} region{'s' if n != 1 else ''} followed over {followed.counts['epochs']} epochs"
        facts[-1]["answer"] += f", {alone} of them found by the trend alone" if alone else ""
    _tell(facts, as_json, COMPARED)
    what = "pairs of epochs could not be compared, and no change was followed over the epochs"
    _require_all(len(facts), len(pairs), failed, what)


@dataclass(frozen=True)
class _PairWork:
    """Two epochs to be compared, the reference first, as a worker process is told of them."""

    path: Path
    object_id: str
    pair: tuple[str, str]
    settings: Settings
    mode: str | None
    stable: Extent | None


def _compare_pair(work: _PairWork, here: tuple[Project, Notify] | None) -> Facts | MonitorError:
    """Compare two epochs and return what was found, or why they could not be: the others are compared all the same.

    `here` is the project and what is told of the work, where that is not sent to a worker process.
    """
    reference, compared = work.pair
    try:
        project, notify = here or (Project.open(work.path), _say_nothing)
        place = Place(project, work.object_id, compared)
        step = compare_epochs(place, reference, work.settings, notify, work.mode, work.stable)
        return _compared(place, reference, step)
    except MonitorError as error:
        return error


def _say_nothing(_text: str) -> None:
    """Say nothing of what is being done: a worker has no terminal."""


def _without_bare(
    project: Project, object_id: str, pairs: list[tuple[str, str]]
) -> tuple[list[tuple[str, str]], list[MonitorError]]:
    """Return the pairs whose epochs have surfaces, and one error that names the epochs without; a single pair says by
    itself what it misses."""
    asked = dict.fromkeys(epoch_id for pair in pairs for epoch_id in pair)
    bare = [e for e in asked if project.latest(object_id, e, "surface") is None]
    if not bare or len(pairs) == 1:
        return pairs, []
    names = f"epoch {bare[0]}" if len(bare) == 1 else f"epochs {', '.join(bare[:-1])} and {bare[-1]}"
    only = f" {bare[0]}" if len(bare) == 1 else ""
    said = f"{names} of object {object_id} {'has' if only else 'have'} no surface yet; "
    error = StoreError(f"{said}run: monitor process {project.quoted} {object_id}{only}")
    return [pair for pair in pairs if not set(pair) & set(bare)], [error]


def resolve_pairs(project: Project, object_id: str, pair: Pair) -> list[tuple[str, str]]:
    """Return the pairs (reference, compared) meant: the one given, or each with the first and the one before."""
    named = named_pair(project, object_id, pair)
    if named is not None:
        return [named]
    epochs = [e.epoch_id for e in project.epochs(object_id)]
    if len(epochs) < 2:
        raise StoreError(
            f"object {object_id} has {len(epochs)} epoch{'s' if len(epochs) != 1 else ''}; a comparison needs two"
        )
    return pairs_to_compare(epochs)


def _compared(place: Place, reference: str, step: Step) -> Facts:
    """Return what one comparison found as plain values."""
    comparison: Comparison = place.get(step)
    n, unknown = comparison.statistics["n_vertices"], comparison.statistics["n_not_assessable"]
    count = len(comparison.regions)
    found = f"{count} region{'s' if count != 1 else ''} of change" if count else _say_none(comparison)
    level = f"level of detection {millimetres(comparison.statistics['lod95_median_m']).replace(NBSP, ' ')}"
    for width, depth in told_by_width(comparison)[:1]:
        against = " against the rest" if is_beside_layer(comparison) else ""
        told = f", changes {millimetres(width)} wide or wider are told{against} from {millimetres(depth)} on"
        level += told.replace(NBSP, " ")
    answer = (
        f"{found}; {level}; {_not_assessable(comparison, reference, place.epoch_id)}"
        if unknown < n or count
        else f"nothing of {place.epoch_id} could be assessed"
    )
    answer += _met_nothing(comparison, reference, place.epoch_id)
    beside = comparison.statistics.get("lod95_beside_layer_median_m") if count else None
    if comparison.statistics.get("offset_is_told") or beside is not None:
        answer += _lies_off(comparison)
    if beside is not None:
        answer += ", regions are told beside that"
    if comparison.mode == "absolute" and not knows_motion(comparison):
        answer += "; the differences are of coordinates, and how well both epochs' agree is not known"
    answer += f"; {comparison.registration.doubt}" if comparison.registration.doubt else ""
    elsewhere = "; as given the epochs do not lie near each other, they were brought together by their shapes alone"
    answer += elsewhere if "coarse_score" in step.automatic else ""
    before, after = (place.project.epoch(place.object_id, e).date for e in (reference, place.epoch_id))
    answer += "; told backwards in time, the reference is the later epoch" if before > after else ""
    return {
        "object": place.object_id,
        "reference": reference,
        "compared": place.epoch_id,
        "mode": comparison.mode,
        "n_regions": count,
        "answer": answer,
    }


def _lies_off(comparison: Comparison) -> str:
    """Return how far in or out the unchanged surface lies on average, in the differences as they are told."""
    off = comparison.statistics["offset_m"]
    told = millimetres(abs(off)).replace(NBSP, " ")
    with_motion = ", a motion of the whole included" if comparison.mode == "absolute" else ""
    way = "out" if off > 0.0 else "in"
    return f"; what is not called changed lies {told} further {way} on average{with_motion}"


def _say_none(comparison: Comparison) -> str:
    """Return that there are no regions."""
    return "no part changed against the rest" if differs_as_a_whole(comparison) else "no change found"


def _not_assessable(comparison: Comparison, reference: str, compared: str) -> str:
    """Return which shares of the areas of both surfaces could not be assessed."""
    before, after = (percent(share).replace(NBSP, " ") for share in shares_not_assessed(comparison))
    told = after if before == after else f"{before} of {reference} and {after} of {compared}"
    return f"{told} not assessable"


def _met_nothing(comparison: Comparison, reference: str, compared: str) -> str:
    """Return how much of each epoch lies in directions in which the scans of the other hold nothing; empty if none."""
    areas = comparison.statistics.get("met_nothing_area_m2", (float("nan"), float("nan")))
    return "".join(
        f"; {square(area).replace(NBSP, ' ')} of {here} lie where the scans of {there} hold nothing"
        for area, here, there in zip(areas, (reference, compared), (compared, reference), strict=True)
        if area > 0.0
    )


def _tell(facts: list[dict[str, Any]], as_json: bool, line: str) -> None:
    """Print the facts as JSON or a line each."""
    if as_json:
        typer.echo(json.dumps(facts, indent=2))
        return
    for fact in facts:
        typer.echo(line.format(**fact))
