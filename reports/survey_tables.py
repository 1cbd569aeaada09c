"""What an archive asks about a survey, as tables: the project, each epoch, its scans, registration, cloud and mesh.

The fields are those of the Archaeology Data Service's and Digital Antiquity's Guide to Good Practice for laser scanning
(Payne and Niven, sections 3.2 to 3.4). In come records of the store, out come rows (part, field, value): numbers in
metres, degrees where a field says so, counts, and "not recorded" where nobody said.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from projects.model import EpochRecord, Floats, ObjectRecord, PointCloud, Step, Surface
from projects.raw import ScanHeader
from projects.transforms import apply
from reports.history import EpochHistory, kind_of, point_flow, say_unit
from reports.quantities import DEGREES

NOT_RECORDED = "not recorded"
COLUMNS = ("part", "field", "value")
Rows = list[tuple[str, str, str]]


def survey_rows(
    project: tuple[str, str, str], record: ObjectRecord, epoch: EpochHistory, headers: Sequence[ScanHeader]
) -> Rows:
    """Return the project level of an epoch (section 3.2); `project` is its name, reference system and description."""
    n_control = len(epoch.record.control)
    control = f"{n_control} point{'s' if n_control > 1 else ''}" if n_control else "none"
    fields = {
        "Project name": project[0],
        "Project description": project[2],
        "Name of monument or object": record.name or record.object_id,
        "Monument or object number": record.inventory,
        "Identifier in the project": record.object_id,
        "Description": record.description,
        "Material": record.material,
        "Survey location": record.place,
        "Coordinate reference system": project[1] or "local",
        "Unit of coordinates": "metre",
        "Unit of the numbers in the original files": say_unit(epoch.record),
        "Survey date": epoch.record.date.isoformat(),
        "Occasion": epoch.record.label,
        "Survey conditions": "",
        "Scanner": ", ".join(dict.fromkeys(n for n in (epoch.record.scanner, *epoch.scanners) if n)),
        "Scanner serial number": "",
        "Company or operator": epoch.record.operator,
        "Control data collected": control,
        "Original file": _originals(epoch.record) if epoch.record.is_mesh else "those in the table of scans",
        "Extent of the object [m]": "none was given" if record.extent is None else json.dumps(record.extent),
        "Tolerance of the client [m]": "none was given" if record.tolerance is None else _number(record.tolerance),
        "Front faces, clockwise from +y [degrees]": "none was given"
        if record.front is None
        else _degrees(record.front),
        "Turntable used": "",
        "Repeated scans of one station": _yes(epoch.record.repeated),
        "Number of scans": "a finished mesh" if epoch.record.is_mesh else str(len(headers)),
        "Number of measured points": "" if epoch.record.is_mesh else str(sum(h.n_points for h in headers)),
    }
    return _rows("survey", fields)


def _originals(record: EpochRecord) -> str:
    """Return the file of a finished mesh with its SHA-256."""
    known = [(str(s.get("file", "")), str(s.get("sha256", ""))) for s in record.sources]
    return "; ".join(f"{name} (SHA-256 {digest or NOT_RECORDED})" for name, digest in known)


def registration_rows(network: Step | None) -> Rows:
    """Return how the scans of an epoch were brought together (section 3.3)."""
    if network is None:
        return _rows("registration", {"Registration method": "none: the poses are as given, not registered"})
    found = network.automatic
    return _rows("registration", {
        "Registration method": "one adjustment of all scans: surfaces, survey targets and control, with covariance",
        "Given poses were corrected": _yes(bool(found["applied"])) if "applied" in found else "",
        "Why": str(found.get("reason") or ""),
        "Doubt": str(found["doubt"] or "none") if "doubt" in found else "",
        "Scans disagree before, one sigma along the normal [m]": _number(found.get("misfit_before_m")),
        "Scans disagree after, one sigma along the normal [m]": _number(found.get("misfit_after_m")),
        "Targets in the adjustment": str(found.get("n_targets", 0)),
        "Control points in the adjustment": str(found.get("n_control", 0)),
        "Residual at targets, rms [m]": _number(found.get("target_rms_m")),
        "Residual at control points, rms [m]": _number(found.get("control_rms_m")),
    })  # fmt: skip


def cloud_rows(cloud: PointCloud, made: Step, epoch: EpochHistory) -> Rows:
    """Return what was done to the registered cloud that the mesh rests on (section 3.4), and to how many points."""
    asked = made.parameters.get("filter") or {}
    is_mode = (asked.get("thinning") or {}).get("method", "mode") == "mode"
    smoothed = "anisotropic diffusion" if (asked.get("diffusion") or {}).get("enabled") else ""
    averaged = "repeated scans averaged" if any(s.counts.get("averaged") for s in epoch.steps) else ""
    done = ", ".join(text for text in (averaged, smoothed) if text)
    fields = {
        "Number of points": str(len(cloud)),
        "Overlap reduction": "yes: the scans are merged, and thinned together",
        "Subsampling": "yes: " + (
            "thinned to the mode along the surface's normal; n_merged tells of how many measurements" if is_mode
            else "to the measurement next to the median of a voxel; n_merged tells of how many measurements"
        ),
        "Smoothing": f"yes: {done}" if done else "no",
        "Ranges corrected": _corrected(epoch),
        "Colour edits": "no",
    }  # fmt: skip
    return _rows("cloud", fields) + _rows("points", {words: str(n) for words, n in point_flow(epoch)})


def _corrected(epoch: EpochHistory) -> str:
    """Return of how many scans the cyclic range error was corrected, which the scans as measured still have."""
    applied = [bool(s.automatic.get("is_applied")) for s in epoch.steps if kind_of(s) == "calibration"]
    return f"yes: cyclic error of {sum(applied)} of {len(applied)} scans, see provenance" if any(applied) else "no"


def mesh_rows(surface: Surface, made: Step) -> Rows:
    """Return what is known of the mesh (section 3.4)."""
    n_invented = 0 if surface.face_invented is None else int(surface.face_invented.sum())
    method = str(made.automatic.get("method") or "")
    own = method == "localized"
    return _rows("mesh", {
        "Number of vertices": str(len(surface.vertices)),
        "Number of triangles": str(len(surface.faces)),
        "Method": f"{method} Poisson surface from the cloud" if method else "finished mesh, as given",
        "Cell size [m]": _number(made.automatic.get("cell_size_m")),
        "Spacing of the points [m]": _number(made.automatic.get("spacing_m")),
        "Sigma of a vertex, median [m]": "" if surface.sigma is None else _number(_median(surface.sigma)),
        "Holes filled": f"yes: {n_invented} triangles, marked" if n_invented else "no" if own else "",
        "Smoothing": "none after the surface: each vertex stands on a robust fit of the points around" if own else "",
        "Colour edits": "no" if method else "",
        "Area between the points without surface, share": _number(made.automatic.get("uncovered_share")),
    })  # fmt: skip


def scans_table(headers: Sequence[ScanHeader], poses: Iterable[Floats]) -> pd.DataFrame:
    """Return one row a scan: the original file with its SHA-256, points, station (m, project frame, as registered; NaN
    where it is not known)."""
    return pd.DataFrame(
        [
            {
                "scan": k,
                "name": h.name,
                "source_file": h.source,
                "source_sha256": h.source_sha256,
                "scan_in_source": h.source_index,
                "scanner": h.scanner or NOT_RECORDED,
                "is_grid": h.is_grid,
                "n_points": h.n_points,
                "n_dropped_on_reading": sum(h.dropped.values()),
                **dict(zip(("station_x", "station_y", "station_z"), pose[:3, 3] + 0.0 * h.origin, strict=True)),
            }
            for k, (h, pose) in enumerate(zip(headers, poses, strict=True), start=1)
        ]
    )


def pose_of(header: ScanHeader, motion: Floats | None) -> Floats:
    """Return T_project_scanner (4, 4) with the scanner in the origin, as E57 has it, moved by what the adjustment
    found; of the scan's own frame where nobody knows where the scanner stood."""
    pose = header.pose.copy()
    if np.isfinite(header.origin).all():
        pose[:3, 3] = apply(header.pose, header.origin)
    return pose if motion is None else motion @ pose


def cloud_table(cloud: PointCloud) -> pd.DataFrame:
    """Return a cloud as columns: x y z and what is known of each point, in metres."""
    columns: dict[str, NDArray[Any]] = {axis: cloud.points[:, k] for k, axis in enumerate("xyz")}
    if cloud.normals is not None:
        columns |= {f"n{axis}": cloud.normals[:, k].astype(np.float32) for k, axis in enumerate("xyz")}
    if cloud.colors is not None:
        columns |= {name: cloud.colors[:, k] for k, name in enumerate(("red", "green", "blue"))}
    for name in ("intensity", "sigma", "n_merged"):
        values = getattr(cloud, name)
        if values is not None:
            columns[name] = values.astype(np.float32) if values.dtype == np.float64 else values
    if cloud.scan_index is not None:
        columns["scan"] = cloud.scan_index + 1  # as the table of scans and the files of their poses count
    return pd.DataFrame(columns)


def as_table(rows: Rows) -> pd.DataFrame:
    """Return rows of metadata as a table."""
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _rows(part: str, fields: dict[str, str]) -> Rows:
    """Return the fields of one part; what is empty was not recorded."""
    return [(part, field, " ".join(value.split()) or NOT_RECORDED) for field, value in fields.items()]


def _yes(value: bool) -> str:
    """Return an answer."""
    return "yes" if value else "no"


def _number(value: object) -> str:
    """Return a number as text that reads back the same, empty where it is not known."""
    return repr(float(value)) if isinstance(value, int | float) and np.isfinite(value) else ""


def _degrees(angle: float) -> str:
    """Return an angle [rad] in degrees, as text."""
    return _number(round(DEGREES * angle, 9))


def _median(values: Floats) -> float:
    """Return the median of what is known, NaN where nothing is."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")
