"""Scans out as E57 (ASTM E2807), the way instrument software writes it: several scans, poses, grid, limits.

Coordinates are scaled integers of one micrometre in the scanner's frame, intensity is 0 to 1, colours are 0 to 255,
row and column are the grid's, and cells without a return can be kept as points flagged invalid.
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import re
import uuid
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from projects.errors import FormatError, ParameterError
from projects.formats.complete_file import complete_file
from projects.formats.e57_bounds import Extremes, header_bounds
from projects.formats.scan_blocks import ScanSource, in_blocks
from projects.model import Scan
from projects.reference_systems import wkt_of
from projects.transforms import apply, require_rigid

CHUNK = 1_000_000
STEP = 1e-6  # m, the coordinate grid of the file
GPS_EPOCH = datetime.datetime(1980, 1, 6, tzinfo=datetime.UTC)
NOT_XML = re.compile(
    "[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"
)  # XML 1.0, section 2.2: one makes a file unreadable
GRID = ("rowIndex", "columnIndex")
NO_RETURN = 2  # cartesianInvalidState: no part of the coordinate is meaningful


def write_e57(
    path: Path,
    scans: Iterable[ScanSource],
    *,
    fill_grid: bool = False,
    acquired: datetime.datetime | None = None,
    description: str = "",
    crs: str = "",
) -> tuple[str, ...]:
    """Write scans, each in its own frame with its pose, to one E57 file; return those whose grid could not be kept.

    E57 has no row or column for a point that has no place in the grid (`rows` or `columns` of -1). A scan with such
    points beside others keeps all its points and loses its grid; its name is returned.

    Parameters
    ----------
    path : where to write; an existing file is replaced when the new one is complete.
    scans : at least one; `cloud.points` [m] in the scan's frame, intensity 0 to 1. Points must be finite. A scan whose
        `origin` is known and not 0 0 0 is written in the frame about its scanner, with the pose to match. A scan may
        come block by block, as an iterable of `Scan` that share name, pose and grid: memory then holds one block, and
        disk all.
    fill_grid : write the cells of the grid that have no point too, flagged invalid, in column order; needs whole
        scans with `rows` and `columns` that name every cell at most once.
    acquired : when the scans were made, with a time zone; left out where unknown.
    description : free text of every scan.
    crs : reference system that the poses lead to, as EPSG:n.

    Raises
    ------
    FormatError
        No scans, an empty scan, points that are not finite, a grid that cannot be filled, or blocks that differ in
        what they state of a point or in where they were scanned from.
    ParameterError
        A time without a time zone.
    """
    path, n_scans, without_grid = Path(path), 0, list[str]()
    _require_zone(acquired)
    about = {"acquired": acquired, "description": description}
    with complete_file(path) as unfinished, _new_image(unfinished, acquired, wkt_of(crs)) as image:
        for source in scans:
            if fill_grid and not isinstance(source, Scan):
                raise FormatError(f"{path}: fill_grid needs whole scans; this one comes in blocks")
            with in_blocks(source, path) as blocks:
                without_grid += _write_scan(image, _Blocks(blocks, path, fill_grid), about)
            n_scans += 1
        if not n_scans:
            raise FormatError(f"{path}: no scans were given; an E57 file needs at least one")
    return tuple(without_grid)


def _require_zone(acquired: datetime.datetime | None) -> None:
    """Raise `ParameterError` where a time has no zone, so that nobody knows which instant it is."""
    if acquired is not None and acquired.utcoffset() is None:
        raise ParameterError(
            f"acquired {acquired.isoformat()} has no time zone, and E57 counts seconds of UTC; give it one, such as "
            "tzinfo=datetime.UTC"
        )


@dataclass(frozen=True)
class _Blocks:
    """The blocks of one scan, as E57 point fields."""

    scans: Iterable[Scan]
    path: Path
    fill_grid: bool

    def header(self) -> Scan:
        """Return the scan that names all of them."""
        return _centred(next(iter(self.scans)))

    def fields(self) -> Iterator[dict[str, Any]]:
        """Yield the point fields of each block, name -> array."""
        for scan in map(_centred, self.scans):
            yield _fields_of(scan, self.path, self.fill_grid)


@contextlib.contextmanager
def _new_image(path: Path, acquired: datetime.datetime | None, system: str) -> Iterator[Any]:
    """Yield a new file with its header, to be closed afterwards; created when acquired, not told where unknown."""
    from pye57 import libe57

    image = libe57.ImageFile(str(path), "w")
    try:
        image.extensionsAdd("", libe57.E57_V1_0_URI)
        root = image.root()
        root.set("formatName", libe57.StringNode(image, "ASTM E57 3D Imaging Data File"))
        root.set("guid", libe57.StringNode(image, "{" + str(uuid.uuid4()) + "}"))
        root.set("versionMajor", libe57.IntegerNode(image, libe57.E57_FORMAT_MAJOR))
        root.set("versionMinor", libe57.IntegerNode(image, libe57.E57_FORMAT_MINOR))
        root.set("e57LibraryVersion", libe57.StringNode(image, libe57.E57_LIBRARY_ID))
        root.set("coordinateMetadata", libe57.StringNode(image, system))
        if acquired is not None:
            root.set("creationDateTime", _structure(image, _moment(acquired)))
        root.set("data3D", libe57.VectorNode(image, True))
        root.set("images2D", libe57.VectorNode(image, True))
        yield image
    finally:
        image.close()


def _moment(time: datetime.datetime) -> dict[str, Any]:
    """Return a time as E57 tells it: seconds since the GPS epoch."""
    return {"dateTimeValue": (time - GPS_EPOCH).total_seconds(), "isAtomicClockReferenced": 0}


def _centred(scan: Scan) -> Scan:
    """Return the scan in the frame whose origin is the scanner, as E57 defines it; the same place in the project.
    One of which nobody knows where the scanner stood stays in its own frame."""
    if not scan.origin.any() or not np.isfinite(scan.origin).all():
        return scan
    pose = scan.pose.copy()
    pose[:3, 3] = apply(scan.pose, scan.origin)
    cloud = dataclasses.replace(scan.cloud, points=scan.cloud.points - scan.origin, origins=None)
    return dataclasses.replace(scan, cloud=cloud, pose=pose, origin=np.zeros(3))


def _fields_of(scan: Scan, path: Path, fill_grid: bool) -> dict[str, Any]:
    """Return the E57 point fields of a scan, name -> array."""
    if not np.isfinite(scan.cloud.points).all():
        raise FormatError(f"{path}: scan {scan.name} holds points that are not finite; drop them first")
    fields: dict[str, Any] = {f"cartesian{axis}": scan.cloud.points[:, k] for k, axis in enumerate("XYZ")}
    if scan.cloud.intensity is not None:
        unknown = np.isnan(scan.cloud.intensity)
        fields["intensity"] = np.clip(np.where(unknown, 0.0, scan.cloud.intensity), 0.0, 1.0)
        if unknown.any():
            fields["isIntensityInvalid"] = unknown.astype(np.uint8)
    if scan.cloud.colors is not None:
        fields |= {f"color{c}": scan.cloud.colors[:, k] for k, c in enumerate(("Red", "Green", "Blue"))}
    if scan.rows is not None and scan.columns is not None:
        fields |= dict(zip(GRID, (scan.rows, scan.columns), strict=True))
    return _with_empty_cells(fields, scan.name, path) if fill_grid else fields


def _with_empty_cells(fields: dict[str, Any], name: str, path: Path) -> dict[str, Any]:
    """Return the fields over every cell of the grid, column by column; cells without a point are flagged."""
    if "rowIndex" not in fields:
        raise FormatError(f"{path}: scan {name} has no rows and columns; it cannot be written with fill_grid")
    if min(fields[name].min() for name in GRID) < 0:
        raise FormatError(
            f"{path}: scan {name} has points without a place in its grid (a row or column of -1), which fill_grid "
            "cannot fill; leave them out"
        )
    n_rows = int(fields["rowIndex"].max()) + 1
    n_columns = int(fields["columnIndex"].max()) + 1
    cell = fields["columnIndex"].astype(np.int64) * n_rows + fields["rowIndex"]
    if len(np.unique(cell)) != len(cell):
        raise FormatError(f"{path}: scan {name} has several points in one cell of its grid; fill_grid needs one")
    full = {}
    for field, values in fields.items():
        full[field] = np.zeros(n_rows * n_columns, values.dtype)
        full[field][cell] = values
    full["rowIndex"] = np.tile(np.arange(n_rows), n_columns)
    full["columnIndex"] = np.repeat(np.arange(n_columns), n_rows)
    full["cartesianInvalidState"] = np.full(n_rows * n_columns, NO_RETURN, np.int8)
    full["cartesianInvalidState"][cell] = 0
    return full


def _survey(blocks: _Blocks) -> tuple[list[str], Extremes]:
    """Go through a scan for the fields that its points have, and for its extremes."""
    extremes, names = Extremes(), list[str]()
    for fields in blocks.fields():
        extremes.add(fields)
        differing = (fields.keys() ^ names) - {"isIntensityInvalid"} if names else None
        if differing:
            raise FormatError(
                f"{blocks.path}: scan {blocks.header().name} has {', '.join(sorted(differing))} in some of its blocks "
                "only; give all of them the same fields"
            )
        names += [name for name in fields if name not in names]
    return names, extremes


def _without_grid(names: list[str], extremes: Extremes) -> tuple[list[str], Extremes]:
    """Return fields and extremes without those of the grid."""
    low, high = ({k: v for k, v in ends.items() if k not in GRID} for ends in (extremes.low, extremes.high))
    return [name for name in names if name not in GRID], dataclasses.replace(extremes, low=low, high=high)


def _write_scan(image: Any, blocks: _Blocks, about: dict[str, Any]) -> list[str]:
    """Append one scan with its header and points; return its name where its grid could not be kept."""
    from pye57 import libe57

    scan = blocks.header()
    names, extremes = _survey(blocks)
    lost: list[str] = []
    if "rowIndex" in names and min(extremes.low[name] for name in GRID) < 0:
        lost = [scan.name] if min(extremes.high[name] for name in GRID) >= 0 else []  # there was no grid at all
        names, extremes = _without_grid(names, extremes)
    node = _structure(image, {"guid": "{" + str(uuid.uuid4()) + "}", "name": scan.name, **_instrument(scan, about)})
    for name, content in header_bounds(extremes).items():
        node.set(name, _structure(image, content))
    node.set("pose", _pose(image, scan))
    prototype = _prototype(image, names, extremes)
    points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
    node.set("points", points)
    libe57.VectorNode(image.root().get("data3D")).append(node)
    _write_points(image, points, names, blocks.fields())
    return lost


def _instrument(scan: Scan, about: dict[str, Any]) -> dict[str, Any]:
    """Return the header entries on the instrument and the time."""
    entries: dict[str, Any] = {"description": about["description"]}
    if scan.scanner:
        entries["sensorModel"] = scan.scanner
    if about["acquired"] is not None:
        entries["acquisitionStart"] = _moment(about["acquired"])
    return entries


def _pose(image: Any, scan: Scan) -> Any:
    """Return the pose node: unit quaternion and translation of T_project_scanner."""
    T_project_scanner = require_rigid(scan.pose, f"pose of scan {scan.name}")
    w, x, y, z = Rotation.from_matrix(T_project_scanner[:3, :3]).as_quat(canonical=True, scalar_first=True)
    t = apply(T_project_scanner, np.zeros(3))
    rotation = {"w": float(w), "x": float(x), "y": float(y), "z": float(z)}
    return _structure(image, {"rotation": rotation, "translation": dict(zip("xyz", map(float, t), strict=True))})


def _structure(image: Any, content: Mapping[str, Any]) -> Any:
    """Return a structure node of strings, integers, floats and structures."""
    from pye57 import libe57

    node = libe57.StructureNode(image)
    for name, value in content.items():
        if isinstance(value, Mapping):
            node.set(name, _structure(image, value))
        elif isinstance(value, str):
            node.set(name, libe57.StringNode(image, NOT_XML.sub("\ufffd", value)))
        elif isinstance(value, int):
            node.set(name, libe57.IntegerNode(image, value))
        else:
            node.set(name, libe57.FloatNode(image, value))
    return node


def _prototype(image: Any, names: Iterable[str], extremes: Extremes) -> Any:
    """Return the node that says how each point field is stored."""
    from pye57 import libe57

    prototype = libe57.StructureNode(image)
    for name in names:
        low, high = extremes.low[name], extremes.high[name]
        if name.startswith("cartesian") and len(name) == len("cartesianX"):
            # one step of room on either side, so that rounding cannot leave the bounds
            first, last = int(np.floor(low / STEP)) - 1, int(np.ceil(high / STEP)) + 1
            node = libe57.ScaledIntegerNode(image, first, first, last, STEP, 0.0)
        elif name == "intensity":
            node = libe57.FloatNode(image, 0.0, libe57.E57_SINGLE, 0.0, 1.0)
        elif name.startswith("color"):
            node = libe57.IntegerNode(image, 0, 0, 255)
        elif name == "isIntensityInvalid":
            node = libe57.IntegerNode(image, 0, 0, 1)
        else:
            node = libe57.IntegerNode(image, int(low), int(low), int(high))
        prototype.set(name, node)
    return prototype


BUFFER_KINDS = {"cartesianX": "d", "cartesianY": "d", "cartesianZ": "d", "intensity": "f", "rowIndex": "q",
                "columnIndex": "q", "cartesianInvalidState": "b"}  # fmt: skip


def _write_points(image: Any, points: Any, names: Iterable[str], blocks: Iterable[Mapping[str, Any]]) -> None:
    """Write the fields of all blocks to the compressed vector, chunk by chunk; a field that a block lacks is 0."""
    from pye57 import libe57

    arrays = {name: np.empty(CHUNK, BUFFER_KINDS.get(name, "B")) for name in names}
    buffers = libe57.VectorSourceDestBuffer()
    for name, array in arrays.items():
        buffers.append(libe57.SourceDestBuffer(image, name, array, len(array), True, True))
    with contextlib.closing(points.writer(buffers)) as writer:  # one left open crashes Python when it is collected
        for fields in blocks:
            n = len(fields["cartesianX"])
            for start in range(0, n, CHUNK):
                stop = min(start + CHUNK, n)
                for name, array in arrays.items():
                    array[: stop - start] = fields[name][start:stop] if name in fields else 0
                writer.write(stop - start)
