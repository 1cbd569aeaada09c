"""Scans on their way: from files to the store with their poses, and from the store to the chain within the extent.

In come paths and options of `monitor add-epoch`, or a project and a scan's number; out come streams or one scan.
"""

from __future__ import annotations

import filecmp
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from monitor.filtering.drawing_order import hash_points
from monitor.registration.network.placing import place_scans
from monitor.registration.targets.finding import find_targets
from monitor.scan_assembly import assemble_streams
from monitor.unit_check import UnitCheck
from monitor.unregistered import UNEVEN, forget_common_place, unevenness
from monitor.vantage import could_be_measured_from, some_points
from projects.errors import FormatError, ParameterError
from projects.extent import Extent, inside
from projects.formats import PoseLine, ScanStream, doubt_places, read_scans, require_known_names
from projects.model import ControlPoint, Floats, PointCloud, Scan
from projects.store import Project
from projects.transforms import apply

MOST_SEARCHED = 12_000_000  # points of one scan: every other row and column of a larger one is searched; two gigabytes
BY_TARGETS = "survey targets"
BY_SHAPE = "shape alone"


def open_scans(
    files: Iterable[Path], poses: Mapping[str, PoseLine], unit: UnitCheck, repeated: bool = False,
    control: Sequence[ControlPoint] = (),
) -> list[ScanStream]:  # fmt: skip
    """Return the scans of the files, each with a pose, ready to be streamed into the store.

    A pose comes from the poses file, else from the scan's own file, else, where there are several scans, from the
    survey targets in them and the control points, else, without control, from their shapes alone, in the frame of the
    scans whose poses are known or of the first; a scan that stands alone (or repeated scans from one station) may do
    without and then stands in the project's frame. Where all poses are the identity and no line says where its scanner
    stood (`doubt_places`), it stood at 0 0 0 if the points can have been measured from there (`monitor.vantage`), else
    nobody knows; repeated scans are taken at their word. So it is asked of a scan whose file has a pose that is not the
    identity and no grid that would say the same (an E57 of thinned scans), and of a PTX whose header leaves the
    scanner's place at its default. Where the files put several scans at one
    place and they cannot have been measured from one, their poses count as unknown (`forget_common_place`).

    Raises
    ------
    ParameterError
        For a missing file, a file given twice, a pose line that names none of the files, repeated scans that do not
        say where the scanner stood.
    FormatError
        For several scans without poses that neither targets nor shapes place.
    """
    streams: list[ScanStream] = []
    paths = _require_files(files)
    require_known_names(poses, paths)
    lines = poses if repeated else doubt_places(poses)
    for path in paths:
        found = read_scans(path, unit=unit.metres, pose_lines=lines)
        streams.extend(_believe(s) if _is_doubted(s, lines) or _brings_pose(s) else s for s in found)
    if repeated:
        _require_origins(streams)
    elif not lines:
        streams = forget_common_place(streams)
    without = [s.name for s in streams if s.pose is None]
    if without and len(streams) > 1 and not repeated:
        streams = _place(streams, control)
    return [_complete(s) for s in streams]


def _is_doubted(stream: ScanStream, lines: Mapping[str, PoseLine]) -> bool:
    """Return whether a pose line or the default of a format alone says where the scanner stood, and is doubted."""
    if stream.is_doubted:
        return True
    own = [line for name, line in lines.items() if name == stream.path.name or name.startswith(f"{stream.path.name}#")]
    return stream.pose is not None and not stream.is_origin_stated and any(line.is_doubted for line in own)


def _brings_pose(stream: ScanStream) -> bool:
    """Return whether the scan's own pose, which is not the identity, alone says where the scanner stood."""
    return stream.pose is not None and not stream.is_origin_stated and bool((stream.pose != np.eye(4)).any())


def _believe(stream: ScanStream) -> ScanStream:
    """Return the stream with its origin stated where its points bear it out: by the even steps of their grid about
    0 0 0 where they have one, else by what can be seen from there."""
    spread = unevenness(next(iter(stream.chunks()))) if stream.is_grid and not stream.origin.any() else np.nan
    if np.isfinite(spread):
        return replace(stream, is_origin_stated=spread <= UNEVEN)
    return replace(stream, is_origin_stated=could_be_measured_from(some_points(stream), stream.origin))


def _require_origins(streams: Sequence[ScanStream]) -> None:
    """Raise where repeated scans cannot be averaged: their ranges are known from where the scanner stood only."""
    unknown = [s.name for s in streams if not s.is_origin_stated]
    if unknown and len(streams) > 1:
        names = ", ".join(unknown[:3]) + (", ..." if len(unknown) > 3 else "")
        raise ParameterError(
            f"--repeated: {len(unknown)} of {len(streams)} scans do not say where the scanner stood ({names}), without "
            "which they cannot be averaged; give --poses FILE with a line for each (1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 "
            "where it stood at 0 0 0), or leave --repeated out and have them merged as scans of their own"
        )


def _complete(stream: ScanStream) -> ScanStream:
    """Return the stream with a pose, and with NaN as its origin where nothing says where the scanner stood."""
    pose = np.eye(4) if stream.pose is None else stream.pose
    origin = stream.origin if stream.is_origin_stated else np.full(3, np.nan)
    return replace(stream, pose=pose, origin=origin)


def _place(streams: list[ScanStream], control: Sequence[ControlPoint]) -> list[ScanStream]:
    """Return the scans with the poses that their survey targets give, else their shapes, or raise."""
    targets = [find_targets(join_thinned(stream.chunks(), stream.n_declared or 0)) for stream in streams]
    placed = place_scans(targets, [stream.pose for stream in streams], control)
    poses, lost, found_by = placed.poses, _without_pose(placed.poses), BY_TARGETS
    if lost and not control:
        poses, found_by = assemble_streams(streams), BY_SHAPE
        lost = _without_pose(poses)
    if lost:
        by_shape = "" if control else " nor do their shapes"
        names = ", ".join(streams[k].name for k in lost[:3]) + (", ..." if len(lost) > 3 else "")
        why = "; ".join(filter(None, (f"{len(targets[lost[0]])} found", placed.reasons[lost[0]])))
        raise FormatError(
            f"{len(lost)} of {len(streams)} scans have no pose ({names}), and targets do not give it "
            f"({why}){by_shape}; give --poses FILE with a line for each"
        )
    return [replace(s, pose=pose, placed_by=found_by if s.pose is None else "")
            for s, pose in zip(streams, poses, strict=True)]  # fmt: skip


def _without_pose(poses: Floats) -> list[int]:
    """Return which of the poses (n, 4, 4) are not known."""
    return [k for k, pose in enumerate(poses) if not np.isfinite(pose).all()]


def _require_files(files: Iterable[Path]) -> list[Path]:
    """Return the paths, each an existing file and none twice."""
    paths = [Path(f) for f in files]
    for path in paths:
        if not path.is_file():
            raise ParameterError(f"{path}: {'is a folder' if path.is_dir() else 'no such file'}; give scan files")
    seen: dict[Path, Path] = {}
    for path in paths:
        if path.resolve() in seen:
            raise ParameterError(f"{path}: given twice; each file belongs to an epoch once")
        seen[path.resolve()] = path
    _require_different(paths)
    return paths


def _require_different(paths: Sequence[Path]) -> None:
    """Raise where two files hold the same: what is measured once would count as two scans that agree perfectly."""
    by_size: dict[int, list[Path]] = {}
    for path in paths:
        alike = by_size.setdefault(path.stat().st_size, [])
        for other in alike:
            if filecmp.cmp(path, other, shallow=False):
                raise ParameterError(f"{path}: the same content as {other}; give each scan once")
        alike.append(path)


def read_within(project: Project, object_id: str, epoch_id: str, index: int) -> tuple[Scan, dict[str, int]]:
    """Return one stored scan within the object's extent, and the counts of what lay outside (step 0 of the chain)."""
    kept: list[Scan] = []
    n_read = 0
    for n_stored, chunk in iterate_within(project, object_id, epoch_id, index):
        n_read += n_stored
        kept.append(chunk)
    scan = join_chunks(kept)
    counts = {"read": n_read, "outside_extent": n_read - len(scan.cloud)}
    return scan, counts | {f"not_measured_{reason}": n for reason, n in scan.dropped.items()}


def iterate_within(project: Project, object_id: str, epoch_id: str, index: int) -> Iterator[tuple[int, Scan]]:
    """Yield a stored scan in pieces: how many points each holds, and those of them within the object's extent."""
    stored = project.object(object_id).extent
    extent = None if stored is None else Extent.from_mapping(stored)
    for chunk in project.iterate_scan(object_id, epoch_id, index):
        n_stored = len(chunk.cloud)
        if extent is not None:
            chunk = chunk.take(inside(extent, apply(chunk.pose, chunk.cloud.points)))
        yield n_stored, chunk


def sample_stored(project: Project, object_id: str, epoch_id: str, index: int, n_points: int) -> Scan:
    """Return about `n_points` points of a whole stored scan, extent or not, drawn evenly whatever their order."""
    header = project.scan_headers(object_id, epoch_id)[index]
    share = min(1.0, n_points / max(header.n_points, 1))
    chunks = project.iterate_scan(object_id, epoch_id, index)
    return join_chunks([c.take(hash_points(c.cloud.points, 0) <= share * float(2**64 - 1)) for c in chunks])


def join_thinned(chunks: Iterable[Scan], n_points: int) -> Scan:
    """Return a scan of `n_points` from its chunks, of one that is too large to be searched whole every n-th row and
    column; all of it where it is no grid."""
    every = math.ceil(math.sqrt(n_points / MOST_SEARCHED)) if n_points > MOST_SEARCHED else 1

    def thinned(chunk: Scan) -> Scan:
        """Return every so many rows and columns of a chunk; all of it where it is no grid."""
        if every == 1 or chunk.rows is None or chunk.columns is None:
            return chunk
        return chunk.take((chunk.rows % every == 0) & (chunk.columns % every == 0))

    scan = join_chunks([thinned(chunk) for chunk in chunks])
    if every == 1 or scan.rows is None or scan.columns is None:
        return scan
    return replace(scan, rows=scan.rows // every, columns=scan.columns // every)


def join_chunks(chunks: list[Scan]) -> Scan:
    """Return one scan from its consecutive chunks."""

    def joined(parts: list[Any]) -> Any:
        """Return the values of all chunks one after the other; None where one has none."""
        return None if any(p is None for p in parts) else np.concatenate(parts)

    cloud = PointCloud(
        points=np.concatenate([c.cloud.points for c in chunks]),
        intensity=joined([c.cloud.intensity for c in chunks]),
        colors=joined([c.cloud.colors for c in chunks]),
    )
    rows, columns = joined([c.rows for c in chunks]), joined([c.columns for c in chunks])
    return replace(chunks[0], cloud=cloud, rows=rows, columns=columns)
