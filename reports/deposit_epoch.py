"""An epoch in an archive: what was measured, as it was given, and what was made of it.

In: an epoch of a project and the deposit. Out: its files in the deposit, under the names of `reports.survey_tables`'
guide where it has one (GRE, GRmatrices, origmesh).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from projects.formats import write_e57, write_obj
from projects.model import EpochRecord, Floats, Scan, Step
from projects.raw import ScanHeader
from projects.store import Project
from reports.crate import Action
from reports.deposit import Deposit
from reports.document import gather_history
from reports.exports import export_surface, system_note
from reports.history import EpochHistory
from reports.survey_tables import (
    Rows,
    as_table,
    cloud_rows,
    cloud_table,
    mesh_rows,
    pose_of,
    registration_rows,
    scans_table,
    survey_rows,
)

PRODUCTS = {"network": "registration", "filtered": "cloud"}  # that a surface of scans rests on, in words


@dataclass(frozen=True)
class EpochSource:
    """One epoch of a project with its record, scans and steps."""

    project: Project
    record: EpochRecord
    history: EpochHistory
    headers: Sequence[ScanHeader]

    def get(self, step: Step) -> Any:
        """Return what a step of the epoch made."""
        return self.project.get(self.record.object_id, self.record.epoch_id, step.product, step.step_id)


def add_epoch(deposit: Deposit, project: Project, record: EpochRecord) -> None:
    """Put an epoch into a deposit: scans or mesh as given, registration, cloud, surface, metadata, provenance."""
    object_id, epoch_id = record.object_id, record.epoch_id
    history = gather_history(project, object_id, epoch_id, "")  # without comparisons
    epoch = EpochSource(project, record, history, project.scan_headers(object_id, epoch_id))
    stem = deposit.folder_of(object_id, epoch_id) / f"{object_id}_{epoch_id}"
    about = (project.name, project.crs, project.description)
    rows = survey_rows(about, project.object(object_id), history, epoch.headers)
    given = _add_given(deposit, stem, epoch)
    made, more = _add_made(deposit, stem, epoch)
    deposit.add_table(_named(stem, "metadata.csv"), as_table(rows + more), "Survey, registration, cloud and mesh")
    deposit.add_provenance(_named(stem, "provenance.json"), history.steps)
    surface = history.step("surface")
    if surface is None:
        poses = (
            ", and its scans stand as given, not registered" if epoch.headers and not history.step("network") else ""
        )
        deposit.minds.append(
            f"epoch {epoch_id} of {object_id} is not processed: the archive holds no surface of it{poses}"
        )
        return
    newer = _newer_than(surface, history)
    if newer:
        deposit.minds.append(
            f"epoch {epoch_id} of {object_id} was being processed anew, and that was not finished: its mesh and "
            f"comparisons rest on an earlier {' and '.join(PRODUCTS[p] for p in newer)} than the archive holds"
        )
    name = f"Processing of epoch {epoch_id} of {object_id}"
    results = tuple(file for product, files in made.items() if product not in newer for file in files)
    deposit.actions.append(Action(name, surface.created, given, results, surface.versions))


def _newer_than(surface: Step, history: EpochHistory) -> list[str]:
    """Return the products that were made anew since the surface was, which does not rest on them."""
    made_of = {product: history.step(product) for product in PRODUCTS}
    return [p for p, step in made_of.items() if step is not None and step.step_id not in surface.inputs]


def _named(stem: Path, ending: str) -> Path:
    """Return the path of a file of an epoch."""
    return stem.with_name(f"{stem.name}_{ending}")


def _add_given(deposit: Deposit, stem: Path, epoch: EpochSource) -> tuple[str, ...]:
    """Add what was given: scans as measured or the finished mesh, and control points."""
    record = epoch.record
    held: tuple[str, ...] = ()
    if record.control:
        control = pd.DataFrame([(c.name, *c.position, c.sigma) for c in record.control],
                               columns=["name", "x", "y", "z", "sigma"])  # fmt: skip
        held = deposit.add_table(_named(stem, "control.csv"), control, "Control points; project frame, metres")
    if record.is_mesh:
        path, notes = _named(stem, "origmesh.obj"), ("metres", *system_note(epoch.project.crs))
        write_obj(path, epoch.project.get(record.object_id, record.epoch_id, "mesh"), comments=notes)
        return deposit.add(path, "Finished mesh as it was given; project frame, metres")

    def blocks(k: int) -> Iterator[Scan]:
        yield from epoch.project.iterate_scan(record.object_id, record.epoch_id, k)

    path, about = _named(stem, "scans.e57"), f"epoch {record.epoch_id} of {record.date.isoformat()} {record.label}"
    lost = write_e57(path, (blocks(k) for k in range(len(epoch.headers))), description=about.strip())
    if lost:
        deposit.minds.append(
            f"of the scans of epoch {record.epoch_id} of {record.object_id}, {', '.join(lost)} are archived without "
            "their grid of rows and columns, as some of their points have no place in it; all of their points are there"
        )
    told = "Scans as measured, each in its scanner's frame with the pose that was given; metres"
    return (*deposit.add(path, told), *held)


def _add_made(deposit: Deposit, stem: Path, epoch: EpochSource) -> tuple[dict[str, tuple[str, ...]], Rows]:
    """Add what was made of it: registered poses, cloud, surface; return their names by product, and the metadata."""
    network, filtered, surface = (epoch.history.step(product) for product in ("network", "filtered", "surface"))
    made: dict[str, tuple[str, ...]] = {}
    rows: Rows = []
    if epoch.headers:
        made["network"] = _add_poses(deposit, stem, epoch, network)
        rows += registration_rows(network)
    if filtered is not None:
        cloud = epoch.get(filtered)
        told = "Registered, filtered and thinned cloud that the mesh rests on; text, project frame, metres"
        made["filtered"] = deposit.add_table(_named(stem, "GRE.txt"), cloud_table(cloud), told)
        rows += cloud_rows(cloud, filtered, epoch.history)
    if surface is not None:
        mesh, meshes = epoch.get(surface), tuple[str, ...]()
        if not epoch.record.is_mesh:
            path = _named(stem, "origmesh.obj")
            write_obj(path, mesh, comments=("metres", *system_note(epoch.project.crs)))
            meshes = deposit.add(path, "Mesh of the epoch; project frame, metres")
        ids = epoch.record.object_id, epoch.record.epoch_id
        written = export_surface(stem.parent, *ids, mesh, ("ply",), crs=epoch.project.crs)
        told = "Mesh with sigma and support of each vertex; project frame, metres"
        made["surface"] = (*meshes, *deposit.add(written, told))
        rows += mesh_rows(mesh, surface)
    return made, rows


def _add_poses(deposit: Deposit, stem: Path, epoch: EpochSource, network: Step | None) -> tuple[str, ...]:
    """Add where each scan stood, as registered or else as given: a table of all and a matrix of each,
    T_project_scanner."""
    known = "as registered" if network is not None else "as given, not registered"
    motions: Sequence[Floats | None] = [None] * len(epoch.headers)
    if network is not None:
        motions = list(np.asarray(epoch.get(network)["T_project_given"], dtype=float))
    poses = [pose_of(header, motion) for header, motion in zip(epoch.headers, motions, strict=True)]
    told = f"The scans: original files with their SHA-256, points, stations {known}; project frame, metres"
    made = deposit.add_table(_named(stem, "scans.csv"), scans_table(epoch.headers, poses), told)
    for k, pose in enumerate(poses, start=1):
        path = _named(stem, f"GRmatrices_scan{k}.txt")
        path.write_text("".join(f"{' '.join(map(repr, row))}\n" for row in pose.tolist()), encoding="ascii")
        made += deposit.add(path, f"Pose of scan {k}, {known}: 4 x 4, scanner to project frame, row by row, metres")
    return made
