"""A campaign's file against what the project holds already: what contradicts it, before anything is done.

In: a campaign and its project. Out: an error where the file says otherwise than the project on anything that figures
rest on; what differs in words alone, to be told.
"""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from monitor.cli.adding import EpochRequest, read_request
from monitor.cli.campaign_file import TEXTS, Campaign, ObjectRequest
from projects.errors import StoreError
from projects.formats import PoseLine, find_pose_line
from projects.model import ControlPoint, EpochRecord, ObjectRecord
from projects.provenance import hash_file
from projects.raw import ScanHeader
from projects.store import Project

NANOMETRE = 1e-9  # m: as files write a figure, it comes back nearer than this


def require_as_declared(project: Project, campaign: Campaign) -> None:
    """Refuse, before anything is done, a file that says otherwise than the project of what that holds already."""
    if campaign.crs and project.crs != campaign.crs:
        raise StoreError(f"{project.path} has the reference system {project.crs or 'none'}, not {campaign.crs}")
    known = {record.object_id: record for record in project.objects()}
    for wanted in campaign.objects:
        present = known.get(wanted.record.object_id)
        if present is not None:
            _require_same_object(present, wanted.record)
            kept = {e.epoch_id: e for e in project.epochs(wanted.record.object_id)}
            for request in wanted.epochs:
                if request.epoch_id in kept:
                    _require_same_epoch(project, kept[request.epoch_id], request)


def words_not_taken(project: Project, campaign: Campaign) -> list[str]:
    """Return what the file says in words otherwise than the project, where all stays as it was added."""
    told = _other_words(f"{project.path} keeps", project, campaign, ("name", "description"))
    known = {record.object_id: record for record in project.objects()}
    for wanted in (o for o in campaign.objects if o.record.object_id in known):
        object_id = wanted.record.object_id
        told += _other_words(f"object {object_id} keeps", known[object_id], wanted.record, TEXTS)
        kept = {e.epoch_id: e for e in project.epochs(object_id)}
        for request in (r for r in wanted.epochs if r.epoch_id in kept):
            keeps = f"epoch {request.epoch_id} of object {object_id} keeps"
            told += _other_words(keeps, kept[request.epoch_id], request, ("label", "operator"))
    return told


def _other_words(keeps: str, kept: object, wanted: object, names: Sequence[str]) -> list[str]:
    """Return what differs in words; what the file leaves out does not."""
    pairs = [(name, getattr(kept, name), getattr(wanted, name)) for name in names]
    return [f"{keeps} the {name} {before!r} of when it was added; {now!r} is not taken over"
            for name, before, now in pairs if now and now != before]  # fmt: skip


def require_epochs_of_pairs(wanted: ObjectRequest, project: Project | None) -> None:
    """Refuse a comparison with an epoch that neither the file declares nor the project holds."""
    object_id = wanted.record.object_id
    is_kept = project is not None and object_id in {record.object_id for record in project.objects()}
    kept = project.epochs(object_id) if project is not None and is_kept else []
    known = {e.epoch_id for e in kept} | {e.epoch_id for e in wanted.epochs}
    for pair in wanted.pairs:
        for epoch_id in (pair.reference, pair.compared):
            if epoch_id not in known:
                near = difflib.get_close_matches(epoch_id, sorted(known), 1)
                hint = f"; is {near[0]} meant?" if near else f"; known are {', '.join(sorted(known)) or 'none'}"
                raise StoreError(f"object {object_id} is to be compared at epoch {epoch_id}, which there is not{hint}")


def _require_same_object(present: ObjectRecord, wanted: ObjectRecord) -> None:
    """Refuse an object that is kept with another extent or tolerance, on which its figures rest."""
    for name, unit in (("extent", ""), ("tolerance", " m")):
        kept, asked = getattr(present, name), getattr(wanted, name)
        if kept != asked:
            raise StoreError(
                f"object {present.object_id} is in the project with the {name} {kept}{unit}, not {asked}{unit}; a "
                "project's object stays as it was added: correct the file, or take another id"
            )


def _require_same_epoch(project: Project, kept: EpochRecord, request: EpochRequest) -> None:
    """Refuse an epoch that is kept otherwise than the file says, in anything that its figures rest on."""
    wanted, lines = read_request(request)
    differing = (
        ("other files", {str(s["sha256"]) for s in kept.sources} != {hash_file(f) for f in request.files}),
        (f"the date {kept.date.isoformat()}, not {wanted.date.isoformat()}", kept.date != wanted.date),
        (f"the scanner {kept.scanner or 'not named'}, not {wanted.scanner or 'not named'}",
         kept.scanner != wanted.scanner),
        (f"a unit of {kept.unit} m, not {wanted.unit} m", kept.unit is not None and kept.unit != wanted.unit),
        ("other control points", not _are_same_points(kept.control, wanted.control)),
        ("other poses", not _are_same_poses(project.scan_headers(request.object_id, request.epoch_id), lines)),
        (_as(kept.repeated, "repeated scans"), kept.repeated != wanted.repeated),
        (_as(kept.is_mesh, "a finished mesh"), kept.is_mesh != wanted.is_mesh),
    )  # fmt: skip
    for what, differs in differing:
        if differs:
            raise StoreError(
                f"epoch {kept.epoch_id} of object {kept.object_id} is in the project with {what}; take another id or "
                f"remove it first: monitor remove-epoch {project.quoted} {kept.object_id} {kept.epoch_id}"
            )


def _as(is_kept_so: bool, what: str) -> str:
    """Return as what an epoch was added."""
    return f"its files as {what}, which the file no longer says" if is_kept_so else f"its files not as {what}"


def _are_same_points(kept: Sequence[ControlPoint], wanted: Sequence[ControlPoint]) -> bool:
    """Return whether control points are the same, to a nanometre."""
    if [c.name for c in kept] != [c.name for c in wanted]:
        return False
    before, now = (np.array([[*c.position, c.sigma] for c in points]) for points in (kept, wanted))
    return np.allclose(before, now, rtol=0.0, atol=NANOMETRE, equal_nan=True)


def _are_same_poses(headers: Sequence[ScanHeader], lines: Mapping[str, PoseLine]) -> bool:
    """Return whether the scans stand where the lines of a poses file put them, as far as these name them."""
    n_of_file = Counter(header.source for header in headers)
    for header in headers:
        line = find_pose_line(lines, header.source, header.source_index, n_of_file[header.source])
        if line is None:
            continue
        if not np.allclose(line.T_project_scanner, header.pose, rtol=0.0, atol=NANOMETRE):
            return False
        if line.is_origin_stated and not np.allclose(line.origin, header.origin, rtol=0.0, atol=NANOMETRE):
            return False
    return True
