"""Scans in, whatever the format: what a file holds, and its points in metres, streamed from a child process.

Comes in: a path, metres per file unit, and the lines of a poses file. Goes out: a `ScanStream` a scan, whose chunks
are `Scan`s of at most a million measured points in the scan's own frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from projects.errors import FormatError, ParameterError
from projects.formats.parsing import ReadLimits, ask_child
from projects.formats.poses import PoseLine, find_pose_line
from projects.formats.precision import require_digits, require_precision
from projects.formats.rawscan import Columns, ScanHeader
from projects.formats.sniffing import sniff_format
from projects.formats.units import require_unit
from projects.model import Floats, PointCloud, Scan
from projects.reference_systems import ReferenceSystem
from projects.transforms import require_rigid

BITS_PER_POINT = 1 / 8  # no honest file packs its points tighter than eight of them to a bit


@dataclass(frozen=True)
class ScanStream:
    """One scan of a file, ready to be read chunk by chunk, as often as needed.

    Attributes
    ----------
    name : the file's name, with `#k` (k from 1) where the file holds several scans.
    index : k - 1.
    path : the file.
    pose : (4, 4) T_project_scanner, m; None where neither the file nor a poses file says.
    origin : (3,) m, the scanner's position in the scan's frame; 0 0 0 where nothing says otherwise.
    is_origin_stated : whether the origin comes from the file, the poses file or the format's definition.
    is_doubted : the origin would be 0 0 0 by the format's definition, but the file left its place for it untouched.
    n_declared : how many points the file promises, no-returns included; None where it does not say.
    scanner : instrument as the file names it.
    is_grid : whether points carry row and column.
    label : the scan's own name inside the file.
    format : of `sniff_format`.
    chunks : called without arguments, yields `Scan`s of at most a million points; `Scan.dropped` counts what was
        dropped since the chunk before. Raises `FormatError` where the file is broken or holds no measurement.
    placed_by : what the pose was found by where nobody stated it, in words; empty where it was stated.
    has_faces : whether the points are the vertices of a mesh.
    system : reference system of the coordinates, where the file names one; its name is empty where it names the unit
        alone.
    unread : which columns of a text file without names could not be told and are left out, in words.
    """

    name: str
    index: int
    path: Path
    pose: Floats | None
    origin: Floats
    is_origin_stated: bool
    n_declared: int | None
    scanner: str | None
    is_grid: bool
    label: str
    format: str
    chunks: Callable[[], Iterator[Scan]]
    placed_by: str = ""
    has_faces: bool = False
    system: ReferenceSystem | None = None
    unread: str = ""
    is_doubted: bool = False


def read_scans(
    path: Path,
    *,
    unit: float = 1.0,
    pose_lines: Mapping[str, PoseLine] | None = None,
    limits: ReadLimits | None = None,
) -> Iterator[ScanStream]:
    """Yield the scans of a file; of several, those without a single point are passed over.

    Parameters
    ----------
    path : E57, PTX, PTS, LAS, LAZ, PLY, PCD, OBJ, STL, GLB, XYZ, TXT or CSV; told by content before name.
    unit : metres per unit of the file, for points, poses and origins.
    pose_lines : of `read_poses`, in metres; a line for a scan takes the place of the file's own pose.
    limits : on the process that parses the file.

    Raises
    ------
    FormatError
        The file is of no known format, broken, or holds no points; a transform that is not rigid, with its scale;
        coordinates in single precision, or of few digits, where that is coarser than a scanner's noise.
    """
    path, limits = Path(path), limits or ReadLimits()
    require_unit(unit)
    format_name = sniff_format(path)
    headers = _list_scans(path, format_name, limits)
    for index, header in enumerate(headers):
        if header.n_declared == 0:
            continue
        require_digits(header.step, unit, str(path))
        name = path.name if len(headers) == 1 else f"{path.name}#{index + 1}"
        line = find_pose_line(pose_lines or {}, path.name, index, len(headers))
        yield _stream(path, format_name, header, (name, index), unit, line, limits)


def _list_scans(path: Path, format_name: str, limits: ReadLimits) -> list[ScanHeader]:
    """Return the headers of the file's scans; a promise that the file's size cannot hold is refused."""
    messages = [message for message, _ in ask_child(path, {"format": format_name, "job": "list"}, limits)]
    try:
        headers = [ScanHeader(**scan) for scan in messages[0]["scans"]]
    except (IndexError, KeyError, TypeError) as problem:
        raise FormatError(f"{path}: cannot be read (the reader's answer is garbled)") from problem
    n_bits = 8 * path.stat().st_size
    for k, header in enumerate(headers):
        if header.n_declared is not None and header.n_declared * BITS_PER_POINT > n_bits:
            raise FormatError(
                f"{path}: scan {k + 1} promises {header.n_declared} points, which {n_bits // 8} bytes cannot hold"
            )
    if all(header.n_declared == 0 for header in headers):
        raise FormatError(f"{path}: holds no points; leave it out")
    return headers


def _stream(
    path: Path,
    format_name: str,
    header: ScanHeader,
    name_and_index: tuple[str, int],
    unit: float,
    line: PoseLine | None,
    limits: ReadLimits,
) -> ScanStream:
    """Return the stream of one scan, with its pose from the poses file or from its own header."""
    name, index = name_and_index
    pose = line.T_project_scanner if line else _own_pose(path, name, header, unit)
    by_format = header.is_centred and not header.is_doubted
    stated = header.origin is not None or by_format or (line is not None and not line.is_doubted)
    origin: Floats = np.zeros(3) if header.origin is None else unit * np.asarray(header.origin, dtype=np.float64)
    if line is not None and line.is_origin_stated:
        origin = line.origin
    frame = {"name": name, "pose": np.eye(4) if pose is None else pose, "origin": origin, "scanner": header.scanner}

    is_centred = header.is_centred or (line is not None and line.is_origin_stated and not origin.any())
    asked = replace(header, is_centred=is_centred)  # a point where the scanner stood was never measured

    def chunks() -> Iterator[Scan]:
        """Yield the scan in pieces, as the child sends them."""
        request = {"format": format_name, "job": "scan", "scan": asked.to_json()}
        for message, columns in ask_child(path, request, limits):
            yield _scan(path, columns, message, unit, frame)

    return ScanStream(
        name, index, path, pose, origin, stated, header.n_declared, header.scanner, header.is_grid, header.label,
        format_name, chunks, has_faces=header.has_faces,
        system=None if header.system is None else ReferenceSystem(**header.system), unread=header.unread,
        is_doubted=header.is_doubted and not stated,
    )  # fmt: skip


def _own_pose(path: Path, name: str, header: ScanHeader, unit: float) -> Floats | None:
    """Return the pose in the file, in metres."""
    if header.pose is None:
        return None
    try:
        pose = require_rigid(np.asarray(header.pose, dtype=np.float64), f"{path}: transform of {name}")
    except ParameterError as problem:
        raise FormatError(str(problem)) from problem
    pose[:3, 3] *= unit
    return pose


def _scan(path: Path, columns: Columns, message: dict[str, Any], unit: float, frame: dict[str, Any]) -> Scan:
    """Return a chunk as a scan in metres; what the child sent is checked once more."""
    points = columns.get("points")
    lengths = {len(values) for values in columns.values()}
    if points is None or len(lengths) != 1 or not np.isfinite(points).all() or "faces" in columns:
        raise FormatError(f"{path}: cannot be read (the reader's answer is garbled)")
    require_precision(points, unit, str(path))
    known = {name: columns[name] for name in ("normals", "intensity", "colors") if name in columns}
    cloud = PointCloud(points=points * unit, origins=frame["origin"], **known)
    dropped = {str(reason): int(n) for reason, n in message["dropped"].items()}
    return Scan(cloud=cloud, rows=columns.get("rows"), columns=columns.get("columns"), dropped=dropped, **frame)
