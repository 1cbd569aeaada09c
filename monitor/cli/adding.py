"""The command add-epoch: checks what was asked, then streams the scans into the store."""

from __future__ import annotations

import dataclasses
import datetime
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import typer

from monitor.beside_extent import lie_beside_extent
from monitor.cli.progress import show_progress
from monitor.record import Place
from monitor.same_survey import describe_copies, describe_doubles
from monitor.scans import open_scans
from monitor.unit_check import UnitCheck, with_questioned_unit
from projects.errors import ParameterError, StoreError
from projects.formats import (
    PoseLine,
    ScanStream,
    metres_per_unit,
    question_unit,
    read_control,
    read_counted_mesh,
    read_poses,
    require_known_names,
    sniff_format,
)
from projects.identifiers import require_epoch_id
from projects.model import ControlPoint, EpochRecord
from projects.provenance import hash_file
from projects.raw import ScanHeader
from projects.reference_systems import name_of_plane
from projects.store import Project
from projects.visible_text import require_visible
from reports.history import tell_blind

FIRST_YEAR = 1850  # of photogrammetry; clouds of old plates are surveys too


@dataclasses.dataclass(frozen=True, kw_only=True)
class EpochRequest:
    """What `add-epoch` was asked, as it was typed; what each means is said by the command's help."""

    object_id: str
    epoch_id: str
    date: str
    label: str
    scanner: str | None
    operator: str
    poses: Path | None
    control: Path | None
    repeated: bool
    mesh: bool
    unit: str | None
    files: tuple[Path, ...]


def add_epoch_to_project(path: Path, request: EpochRequest, as_json: bool) -> None:
    """Add an epoch; on any error the project stays as it was."""
    project = Project.open(path)
    _require_new(project, request)
    unit = UnitCheck(metres_per_unit(request.unit or "m"), request.unit is not None)
    record = _record(request, unit)
    with show_progress() as notify:
        notify(f"{request.epoch_id}: reading {len(request.files)} file{'s' if len(request.files) > 1 else ''}")
        streams = [] if request.mesh else _open_scans(record, request, unit)
        stored, dropped = (
            _add_mesh(project, record, request, unit)
            if request.mesh
            else (project.add_epoch(record, with_questioned_unit(streams, unit)), {})
        )
    _warn_of_meshes(project, stored, [stream.name for stream in streams if stream.has_faces])
    _warn_of_systems(project, stored, streams)
    _warn_of_unread(project, stored, streams)
    _tell(project, stored, (count_placed(streams), dropped), as_json)


def _require_new(project: Project, request: EpochRequest) -> None:
    """Refuse a bad id and an epoch that exists, before anything is read."""
    require_epoch_id(request.epoch_id)
    known = [e.epoch_id for e in project.epochs(project.object(request.object_id).object_id)]
    if request.epoch_id in known:
        raise StoreError(
            f"object {request.object_id} has an epoch {request.epoch_id} already; take another id or remove it first: "
            f"monitor remove-epoch {project.quoted} {request.object_id} {request.epoch_id}"
        )


def read_request(request: EpochRequest) -> tuple[EpochRecord, Mapping[str, PoseLine]]:
    """Return the record and the pose lines of a request; refuse what is wrong in it whatever the project holds: ids,
    date, preset, unit, control, poses, also of none of its files, and what does not go with a finished mesh."""
    require_epoch_id(request.epoch_id)
    unit = UnitCheck(metres_per_unit(request.unit or "m"), request.unit is not None)
    if request.mesh:
        _require_mesh_alone(request)
    lines = _poses(request, unit)
    require_known_names(lines, request.files)
    return _record(request, unit), lines


def _record(request: EpochRequest, unit: UnitCheck) -> EpochRecord:
    """Return the epoch's record, everything checked."""
    record = EpochRecord(
        object_id=request.object_id,
        epoch_id=request.epoch_id,
        date=_date(request.date),
        label=request.label,
        scanner=_scanner(request.scanner),
        repeated=request.repeated,
        is_mesh=request.mesh,
        operator=request.operator,
        control=_control(request, unit),
        unit=unit.metres,
    )
    require_visible(record, f"epoch {record.epoch_id}")
    return record


def _date(text: str) -> datetime.date:
    """Return the date of a survey."""
    try:
        if re.fullmatch(r"[1-9]\d{3}-\d{2}-\d{2}", text, re.ASCII):
            return datetime.date.fromisoformat(text)
    except ValueError:
        pass
    raise ParameterError(f"--date {text}: a date like 2026-05-31 is needed")


def _scanner(preset: str | None) -> str | None:
    """Return the preset if it is known."""
    from monitor.simulation import INSTRUMENTS

    if preset is not None and preset not in INSTRUMENTS:
        raise ParameterError(
            f"--scanner {preset}: known presets are {', '.join(sorted(INSTRUMENTS))}; leave it out otherwise"
        )
    return preset


def _control(request: EpochRequest, unit: UnitCheck) -> tuple[ControlPoint, ...]:
    """Return the control points, kept until the registration uses them."""
    return () if request.control is None else read_control(request.control, unit=unit.metres)


def _poses(request: EpochRequest, unit: UnitCheck) -> Mapping[str, PoseLine]:
    """Return the pose lines by file name."""
    return {} if request.poses is None else read_poses(request.poses, unit=unit.metres)


def _open_scans(record: EpochRecord, request: EpochRequest, unit: UnitCheck) -> list[ScanStream]:
    """Return the scans, ready to be streamed into the store."""
    return open_scans(request.files, _poses(request, unit), unit, repeated=request.repeated, control=record.control)


def count_placed(streams: Sequence[ScanStream]) -> dict[str, int]:
    """Return of how many scans nobody stated the pose, by what it was found by."""
    return dict(Counter(stream.placed_by for stream in streams if stream.placed_by))


def _require_mesh_alone(request: EpochRequest) -> None:
    """Refuse what does not go with a finished mesh: scans' options, and more than one file."""
    given = [name for name in ("poses", "repeated") if getattr(request, name)]
    if given:
        raise ParameterError(f"--mesh and --{given[0]} exclude each other: a mesh has no scans")
    if len(request.files) != 1:
        raise ParameterError(f"--mesh takes one file, {len(request.files)} were given")
    if not request.files[0].is_file():
        raise ParameterError(f"{request.files[0]}: no such file; give a mesh as PLY, OBJ, STL or GLB")


def _add_mesh(
    project: Project, record: EpochRecord, request: EpochRequest, unit: UnitCheck
) -> tuple[EpochRecord, dict[str, int]]:
    """Keep a finished mesh as an epoch, and return it with how many of what the file holds were left out."""
    _require_mesh_alone(request)
    read = read_counted_mesh(request.files[0], unit=unit.metres)
    mesh = read.surface
    bounds = np.array([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])
    question_unit(bounds, unit.was_stated, sniff_format(request.files[0]), request.files[0].name)
    source = {"file": request.files[0].name, "sha256": hash_file(request.files[0])}
    return project.add_epoch(dataclasses.replace(record, sources=(source,)), (), mesh=mesh), read.dropped


def _copies(project: Project, record: EpochRecord) -> list[str]:
    """Return what says that the epoch holds another one's scans; that it cannot be told undoes nothing."""
    try:
        return describe_copies(Place(project, record.object_id, record.epoch_id))
    except StoreError as error:
        typer.echo(f"mind: whether another epoch holds the same scans is not known: {error}", err=True)
        return []


def _doubt_date(date: datetime.date) -> str:
    """Return what makes the date of a survey doubtful, nothing where nothing does."""
    if date > datetime.date.today():
        return "has not come yet"
    return "lies before anything was measured point by point" if date.year < FIRST_YEAR else ""


def _name_some(names: Sequence[str]) -> str:
    """Return the first three names, and how many more there are."""
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _warn_of_meshes(project: Project, record: EpochRecord, names: Sequence[str]) -> None:
    """Say of which files the vertices of a mesh were taken for the points of a scan."""
    if names:
        typer.echo(
            f"mind: {_name_some(names)}: a mesh, of which the vertices were taken as the points of a scan; a "
            f"finished surface is taken as it is with --mesh: monitor remove-epoch {project.quoted} {record.object_id} "
            f"{record.epoch_id}, then add it again with that",
            err=True,
        )


def _warn_of_systems(project: Project, record: EpochRecord, streams: Sequence[ScanStream]) -> None:
    """Say of which files the coordinates are in another reference system than the project's, by what they say."""
    own = name_of_plane(project.crs)
    others = [s for s in streams if own and s.system is not None and s.system.name not in ("", own)]
    if others:
        said = sorted({stream.system.name for stream in others if stream.system})
        typer.echo(
            f"mind: {_name_some([s.name for s in others])}: said to be in {', '.join(said)}, the project is in {own}; "
            f"the coordinates were taken as they are. If they are not in {own}: monitor remove-epoch {project.quoted} "
            f"{record.object_id} {record.epoch_id}, transform them, add the epoch again",
            err=True,
        )


def _warn_of_unread(project: Project, record: EpochRecord, streams: Sequence[ScanStream]) -> None:
    """Say of which files columns without names were left out, as nobody could tell what they are."""
    unread = [stream for stream in streams if stream.unread]
    if unread:
        typer.echo(
            f"mind: {_name_some([s.name for s in unread])}: {unread[0].unread} could not be told and left out. If they "
            "are of use, name all columns in a first line, such as x y z red green blue or x y z nx ny nz (any other "
            f"name leaves a column out): monitor remove-epoch {project.quoted} {record.object_id} {record.epoch_id}, "
            "then add it again",
            err=True,
        )


def _warn_of_epoch(
    project: Project, record: EpochRecord, headers: Sequence[ScanHeader], doubles: Sequence[str]
) -> None:
    """Say what is doubtful of an epoch as it was added: a date that can hardly be, scans that are there twice, whose
    station nobody knows, or that lie beside the object's extent."""
    out = f"monitor remove-epoch {project.quoted} {record.object_id} {record.epoch_id}"
    doubt = _doubt_date(record.date)
    if doubt:
        typer.echo(
            f"mind: {record.date} {doubt}; was epoch {record.epoch_id} surveyed then? Rates rest on dates. "
            f"If not: {out}, then add it again",
            err=True,
        )
    if doubles:
        typer.echo(
            f"mind: {', '.join(doubles[:3])}: measured once, it counts as scans that agree perfectly; take the epoch "
            f"out ({out}) and add each scan once",
            err=True,
        )
    n_blind = sum(not np.isfinite(header.origin).all() for header in headers)
    if n_blind:
        typer.echo(
            f"mind: {record.epoch_id}: {tell_blind(n_blind, len(headers))}; a line of --poses FILE tells it by the "
            "scanner's place (x y z in the file's coordinates) after the 16 numbers of the pose",
            err=True,
        )
    beside = lie_beside_extent(Place(project, record.object_id, record.epoch_id))
    if beside:
        typer.echo(
            f"mind: {record.epoch_id}: {beside}: nothing of them is within, and nothing will be processed. If unit or "
            f"poses are wrong: {out}, then add it again; if the extent is: "
            "monitor add-object with another id and the right one",
            err=True,
        )


def _tell(
    project: Project, record: EpochRecord, counted: tuple[Mapping[str, int], Mapping[str, int]], as_json: bool
) -> None:
    """Say what was kept, what was dropped, of how many scans the pose was found by what, what is a copy, and what is
    doubtful; `counted` are the scans by what placed them, and what was left out of a mesh."""
    placed, left_out_of_mesh = counted
    headers = project.scan_headers(record.object_id, record.epoch_id)
    copies = _copies(project, record)
    dropped = dict(left_out_of_mesh)
    for header in headers:
        for reason, n in header.dropped.items():
            dropped[reason] = dropped.get(reason, 0) + int(n)
    n_points = sum(header.n_points for header in headers)
    doubles = describe_doubles(Place(project, record.object_id, record.epoch_id))
    _warn_of_epoch(project, record, headers, doubles)
    if as_json:
        facts = {"object": record.object_id, "epoch": record.epoch_id, "n_scans": len(headers), "n_points": n_points}
        typer.echo(
            json.dumps(
                {**facts, "dropped": dropped, "placed_by": dict(placed), "copies": copies, "doubles": doubles}, indent=2
            )
        )
        return
    what = "a mesh" if record.is_mesh else f"{len(headers)} scan{'s' if len(headers) != 1 else ''}, {n_points} points"
    left_out = "".join(f"; {n} {reason.replace('_', ' ')} left out" for reason, n in dropped.items() if n)
    found = "".join(f"; {n} without a pose placed by {means}" for means, n in placed.items())
    typer.echo(f"epoch {record.epoch_id} added to object {record.object_id}: {what}{left_out}{found}")
    if copies:
        typer.echo(f"mind: {_name_some(copies)}: one survey, not two; these epochs cannot be compared", err=True)
