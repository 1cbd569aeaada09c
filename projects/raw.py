"""Raw scans of an epoch: streamed into one HDF5 file and out of it again, chunk by chunk, in the scanner's frame."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Protocol

import h5py
import numpy as np

from projects import hdf5
from projects.deflated import N_THREADS, ColumnWriter
from projects.elements import mark, read_mark
from projects.errors import ParameterError, StoreError
from projects.model import EpochRecord, Floats, PointCloud, Scan, Step, Surface
from projects.provenance import hash_file, step_id
from projects.transforms import require_rigid

Progress = Callable[[str, int], None]  # name of the scan, number of points just written
CLOUD_FIELDS = tuple(f.name for f in fields(PointCloud))


class ScanStream(Protocol):
    """One scan of a file, as `projects.formats` streams it: chunks in the scan's frame, metres."""

    @property
    def name(self) -> str: ...
    @property
    def index(self) -> int: ...
    @property
    def path(self) -> Path: ...
    @property
    def pose(self) -> Floats | None: ...
    @property
    def origin(self) -> Floats: ...
    @property
    def scanner(self) -> str | None: ...
    @property
    def is_grid(self) -> bool: ...
    def chunks(self) -> Iterator[Scan]: ...


@dataclass(frozen=True)
class ScanHeader:
    """What is known of a stored scan without reading its points.

    `pose` is T_project_scanner (4, 4), `origin` (3,) and `bounds` (2, 3) [m] are in the scan's frame; `dropped` counts
    what was no measurement, by reason; `source` is the file's name, `source_index` the scan's number in it.
    """

    index: int
    name: str
    pose: Floats
    origin: Floats
    n_points: int
    dropped: dict[str, int]
    scanner: str | None
    source: str
    source_sha256: str
    source_index: int
    is_grid: bool
    bounds: Floats


def write_scans(file: h5py.File, epoch: EpochRecord, scans: Iterable[ScanStream], progress: Progress | None) -> Step:
    """Stream scans into `content` of a product's file and return the step: which files, poses, how many points."""
    group = file.create_group("content")
    mark(group, "scans")
    hashes: dict[Path, str] = {}
    headers = []
    for k, scan in enumerate(scans):
        if scan.path not in hashes:
            hashes[scan.path] = hash_file(scan.path)
        headers.append(_write_scan(group.create_group(f"{k:04d}"), k, scan, hashes[scan.path], progress))
    if not headers:
        raise StoreError(f"epoch {epoch.epoch_id!r} has no scans; name at least one file with measured points")
    return _step_of(epoch, headers)


def _step_of(epoch: EpochRecord, headers: list[ScanHeader]) -> Step:
    """Return the step of raw scans; its counts hold every header, so that the index alone answers what was scanned."""
    asked = {
        "repeated": epoch.repeated,
        "scanner": epoch.scanner,
        "scans": [{"source": h.source_sha256, "index": h.source_index, "pose": h.pose, "origin": h.origin,
                   "n_points": h.n_points} for h in headers],
    }  # fmt: skip
    inputs = tuple(dict.fromkeys(h.source_sha256 for h in headers))
    counts = {"n_scans": len(headers), "n_points": sum(h.n_points for h in headers), "dropped": _sum_of(headers),
              "scans": headers}  # fmt: skip
    parameters = {"repeated": epoch.repeated, "scanner": epoch.scanner}
    return Step(step_id("raw", asked, inputs), "raw", parameters=parameters, inputs=inputs, counts=counts)


def _sum_of(headers: list[ScanHeader]) -> dict[str, int]:
    """Return how many entries all scans dropped, by reason."""
    reasons = sorted({reason for h in headers for reason in h.dropped})
    return {reason: sum(h.dropped.get(reason, 0) for h in headers) for reason in reasons}


def headers_of(step: Step) -> list[ScanHeader]:
    """Return the headers that the step of raw scans holds."""
    shapes = {"pose": (4, 4), "origin": (3,), "bounds": (2, 3)}
    known = {f.name for f in fields(ScanHeader)}
    records = [{k: v for k, v in record.items() if k in known} for record in step.counts["scans"]]
    for record in records:
        record |= {name: np.array(record[name], dtype=np.float64).reshape(shape) for name, shape in shapes.items()}
    return [ScanHeader(**record) for record in records]


def sources_of(step: Step) -> tuple[dict[str, Any], ...]:
    """Return the source files of raw scans as the record of their epoch names them."""
    return tuple(
        {"file": h.source, "sha256": h.source_sha256, "index": h.source_index, "scan": h.name, "n_points": h.n_points}
        for h in headers_of(step)
    )


def mesh_step(epoch: EpochRecord, mesh: Surface) -> Step:
    """Return the step of a finished mesh: identified by its files where the record names them, else by its arrays.

    Raises `ParameterError` where a corner of a face is not finite.
    """
    if not np.isfinite(mesh.vertices[np.unique(mesh.faces)]).all():
        raise ParameterError(
            f"mesh of epoch {epoch.epoch_id!r}: faces have corners that are not finite; leave them out"
        )
    hashes = [str(s["sha256"]) for s in epoch.sources if "sha256" in s]
    arrays = hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes()).hexdigest()
    inputs = tuple(hashes) or (arrays,)
    counts = {"n_vertices": len(mesh.vertices), "n_faces": len(mesh.faces)}
    return Step(step_id("mesh", {"arrays": arrays}, inputs), "mesh", inputs=inputs, counts=counts)


def _write_scan(group: h5py.Group, index: int, scan: ScanStream, sha256: str, progress: Progress | None) -> ScanHeader:
    """Write one scan as it streams by, then its header."""
    if scan.pose is None:
        raise StoreError(f"scan {scan.name!r} has no pose; state it in the file of --poses")
    pose = require_rigid(scan.pose, f"pose of scan {scan.name!r}")
    tally = _Tally()
    with ThreadPoolExecutor(N_THREADS) as pool:
        writer = ColumnWriter(group, pool)
        for chunk in scan.chunks():
            tally.add(chunk)
            if not len(chunk.cloud):
                continue
            for name, values in _columns(chunk, writer.names, scan.name).items():
                writer.append(name, values)
            if progress is not None:
                progress(scan.name, len(chunk.cloud))
        writer.finish()
    if tally.n_points == 0:
        raise StoreError(f"scan {scan.name!r} holds no points (dropped: {tally.dropped or 'none'}); leave it out")
    header = ScanHeader(
        index=index, name=scan.name, pose=pose, origin=np.asarray(scan.origin, dtype=float), n_points=tally.n_points,
        dropped=tally.dropped, scanner=scan.scanner, source=Path(scan.path).name, source_sha256=sha256,
        source_index=int(scan.index), is_grid=bool(scan.is_grid), bounds=tally.bounds,
    )  # fmt: skip
    _write_header(group, header)
    return header


class _Tally:
    """What is counted while a scan streams by: points, what was dropped, and the bounds (2, 3) [m]."""

    def __init__(self) -> None:
        self.n_points = 0
        self.dropped: dict[str, int] = {}
        self.bounds = np.array([np.full(3, np.inf), np.full(3, -np.inf)])

    def add(self, chunk: Scan) -> None:
        """Count a chunk; refuse points that are not finite."""
        for reason, count in chunk.dropped.items():
            self.dropped[reason] = self.dropped.get(reason, 0) + int(count)
        points = chunk.cloud.points
        if not len(points):
            return
        self.n_points += len(points)
        # NaN stays NaN in these, so that one point that is none shows
        self.bounds = np.array(
            [np.minimum(self.bounds[0], points.min(axis=0)), np.maximum(self.bounds[1], points.max(axis=0))]
        )
        if not np.isfinite(self.bounds).all():
            raise StoreError(
                f"scan {chunk.name!r} holds points that are not finite; the reader must drop and count them"
            )


def _columns(chunk: Scan, expected: set[str], scan: str) -> dict[str, np.ndarray]:
    """Return what the chunk holds of each point, by name; a value shared by all points is repeated."""
    n = len(chunk.cloud)
    named = {name: getattr(chunk.cloud, name) for name in CLOUD_FIELDS} | {"rows": chunk.rows, "columns": chunk.columns}
    found = {name: values for name, values in named.items() if values is not None}
    if expected and found.keys() != expected:
        raise StoreError(f"scan {scan!r}: its chunks do not hold the same values ({sorted(found)}, {sorted(expected)})")
    return {name: np.broadcast_to(v, (n, 3)) if name == "origins" else v for name, v in found.items()}


def _write_header(group: h5py.Group, header: ScanHeader) -> None:
    """Write the header into the group of its scan."""
    mark(group, "scan")
    for f in fields(header):
        value = getattr(header, f.name)
        if isinstance(value, np.ndarray):
            hdf5.write_array(group, f.name, value)
        elif isinstance(value, dict):
            hdf5.write_record(group, f.name, value)
        elif value is not None:
            hdf5.write_attribute(group, f.name, value)


def scan_groups(file: h5py.File) -> list[h5py.Group]:
    """Return the groups of the scans of a raw product, in order."""
    content = hdf5.child(file, "content")
    if read_mark(content)[0] != "scans":
        raise StoreError(f"{file.filename} does not hold scans")
    return [hdf5.child(content, name) for name in sorted(content, key=lambda name: (len(name), name))]  # 9999, 10000


def read_header(group: h5py.Group) -> ScanHeader:
    """Return the header of a stored scan."""
    read_mark(group)
    values: dict[str, Any] = {"scanner": None}
    for f in fields(ScanHeader):
        if f.name in ("pose", "origin", "bounds"):
            values[f.name] = hdf5.read_array(hdf5.child(group, f.name))
        elif f.name == "dropped":
            values[f.name] = hdf5.read_record(hdf5.child(group, f.name))
        elif f.name in group.attrs:
            values[f.name] = hdf5.read_attribute(group, f.name)
    return ScanHeader(**values)


def read_chunks(group: h5py.Group, chunk: int) -> Iterator[Scan]:
    """Yield a stored scan in pieces of at most `chunk` points; the first carries the counts of what was dropped."""
    header = read_header(group)
    present = [name for name in (*CLOUD_FIELDS, "rows", "columns") if name in group]
    columns = {name: hdf5.require_own(hdf5.child(group, name)) for name in present}
    for start in range(0, header.n_points, chunk):
        values = {name: column[start : start + chunk] for name, column in columns.items()}
        rows, cols = values.pop("rows", None), values.pop("columns", None)
        yield Scan(
            header.name, PointCloud(**values), header.pose, header.origin, rows, cols, header.scanner,
            header.dropped if start == 0 else {},
        )  # fmt: skip
