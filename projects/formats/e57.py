"""E57 (ASTM E2807) scans in: several a file, poses, grid, invalid flags, spherical coordinates, limits of intensity.

Runs in the child process. Checksums of every page are verified by libE57; what it then decodes is checked against the
number of points that the file promises.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from pye57 import libe57

from projects.errors import FormatError
from projects.formats.rawscan import CHUNK, Columns, ScanHeader, as_bytes_of_colour, within_unit_range
from projects.reference_systems import read_wkt

CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
COLOURS = ("colorRed", "colorGreen", "colorBlue")
NORMALS = ("nor:normalX", "nor:normalY", "nor:normalZ")
GRID = ("rowIndex", "columnIndex")
STATES = ("cartesianInvalidState", "sphericalInvalidState")
WANTED = (*CARTESIAN, *SPHERICAL, *COLOURS, *NORMALS, *GRID, *STATES, "intensity", "isIntensityInvalid")


def list_scans(path: str) -> list[ScanHeader]:
    """Return the headers of every scan of the file."""
    image = _open(path)
    root = image.root()
    n_scans = len(root["data3D"]) if root.isDefined("data3D") else 0
    if not n_scans:
        raise FormatError("holds no scans (an E57 file may hold images alone); export the scans with their points")
    system = _system(root)
    return [replace(_header(root["data3D"][k], k, n_scans), system=system) for k in range(n_scans)]


def read_scan(path: str, header: ScanHeader) -> Iterator[Columns]:
    """Yield the points of one scan, raw: in the scan's frame, with invalid ones flagged."""
    image = _open(path)
    scan = image.root()["data3D"][header.place["index"]]
    kinds = _point_kinds(scan)
    names = [name for name in WANTED if name in kinds]
    limits = _limits(image, scan, kinds)
    for fields in _blocks(image, scan, names):
        yield _columns(fields, limits)


def _system(root: Any) -> dict[str, Any] | None:
    """Return the reference system that the file names, where it is understood."""
    words = str(root["coordinateMetadata"].value()) if root.isDefined("coordinateMetadata") else ""
    system = read_wkt(words)
    return None if system is None else asdict(system)


def _open(path: str) -> Any:
    """Open the file; libE57's reason in one line where it will not."""
    try:
        return libe57.ImageFile(path, "r")
    except libe57.E57Exception as problem:
        raise FormatError(f"is not a sound E57 file: {_reason(problem)}") from problem


def _reason(problem: Exception) -> str:
    """Return the first line of an error of libE57."""
    return str(problem).strip().splitlines()[0]


def _header(scan: Any, index: int, n_scans: int) -> ScanHeader:
    """Return the header of one scan of the file."""
    kinds = _point_kinds(scan)
    which = f"scan {index + 1} of {n_scans}: " if n_scans > 1 else ""
    if not (set(CARTESIAN) <= set(kinds) or set(SPHERICAL) <= set(kinds)):
        raise FormatError(f"{which}its points have neither cartesianX, Y, Z nor sphericalRange, Azimuth, Elevation")
    is_grid = set(GRID) <= set(kinds)
    sensor = [_text(scan, name) for name in ("sensorVendor", "sensorModel", "sensorSerialNumber")]
    return ScanHeader(
        label=_text(scan, "name"),
        pose=_pose(scan, which),
        n_declared=scan["points"].childCount(),
        scanner=" ".join(filter(None, sensor)) or None,
        is_grid=is_grid,
        is_centred=is_grid or set(SPHERICAL) <= set(kinds),
        place={"index": index},
    )


def _point_kinds(scan: Any) -> dict[str, Any]:
    """Return the point fields, name -> node that says how the field is stored."""
    prototype = libe57.StructureNode(scan["points"].prototype())
    return {prototype.get(k).elementName(): prototype[prototype.get(k).elementName()] for k in range(len(prototype))}


def _text(node: Any, name: str) -> str:
    """Return the text of a node, empty where there is none."""
    return str(node[name].value()).strip() if node.isDefined(name) else ""


def _number(node: Any, name: str, default: float) -> float:
    """Return a number of the header, whichever of E57's three kinds it has."""
    if not node.isDefined(name):
        return default
    child = node[name]
    return float(child.scaledValue() if hasattr(child, "scaledValue") else child.value())


def _pose(scan: Any, which: str) -> list[list[float]] | None:
    """Return T_project_scanner, or None without one; a translation alone does not turn."""
    if not scan.isDefined("pose"):
        return None
    pose = scan["pose"]
    q, t = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    if pose.isDefined("rotation"):
        q = np.array([_number(pose["rotation"], name, np.nan) for name in "wxyz"])
    if pose.isDefined("translation"):
        t = np.array([_number(pose["translation"], name, np.nan) for name in "xyz"])
    length = float(np.linalg.norm(q))
    if not (np.isfinite(t).all() and abs(length - 1.0) < 1e-3):
        raise FormatError(f"{which}its pose is no rotation and translation (quaternion of length {length:.4g})")
    T_project_scanner = np.eye(4)
    T_project_scanner[:3, :3] = _rotation(q / length)
    T_project_scanner[:3, 3] = t
    return T_project_scanner.tolist()


def _rotation(q: Any) -> Any:
    """Return the rotation matrix of a unit quaternion w x y z."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _blocks(image: Any, scan: Any, names: list[str]) -> Iterator[dict[str, Any]]:
    """Yield the fields of the points, block by block, as float64; fewer points than promised is an error."""
    n_declared = scan["points"].childCount()
    if not n_declared:
        return
    arrays = {name: np.zeros(min(n_declared, CHUNK)) for name in names}
    buffers = libe57.VectorSourceDestBuffer()
    for name, array in arrays.items():
        buffers.append(libe57.SourceDestBuffer(image, name, array, len(array), True, True))
    n_read = 0
    try:
        reader = scan["points"].reader(buffers)
        while n := reader.read():
            n_read += n
            yield {name: array[:n].copy() for name, array in arrays.items()}
        reader.close()
    except libe57.E57Exception as problem:
        raise FormatError(f"broken after {n_read} of {n_declared} points: {_reason(problem)}") from problem
    if n_read != n_declared:
        raise FormatError(f"promises {n_declared} points, {n_read} are there; export it again")


def _limits(image: Any, scan: Any, kinds: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Return the range of intensity and colour: as the header states, else of the stored kind, else of the values."""
    limits = {}
    for name, box in (("intensity", "intensityLimits"), *((c, "colorLimits") for c in COLOURS)):
        if name not in kinds:
            continue
        low, high = np.nan, np.nan
        if scan.isDefined(box):
            low, high = (_number(scan[box], f"{name}{end}", np.nan) for end in ("Minimum", "Maximum"))
        if not high > low:
            low, high = _range_of_kind(kinds[name])
        if not high > low:
            low, high = _range_of_values(image, scan, name)
        limits[name] = (low, high)
    return limits


def _range_of_kind(node: Any) -> tuple[float, float]:
    """Return the bounds of a stored field, NaN where it has none (a float's largest value is no bound)."""
    ends = ("scaledMinimum", "scaledMaximum") if hasattr(node, "scaledMinimum") else ("minimum", "maximum")
    low, high = (float(getattr(node, end)()) for end in ends)
    return (low, high) if abs(low) < 1e9 and abs(high) < 1e9 else (np.nan, np.nan)


def _range_of_values(image: Any, scan: Any, name: str) -> tuple[float, float]:
    """Return the least and the greatest value, by a pass over this field alone; 0 to 1 where it holds them all."""
    low, high = np.inf, -np.inf
    for fields in _blocks(image, scan, [name]):
        finite = fields[name][np.isfinite(fields[name])]
        low, high = min(low, finite.min(initial=np.inf)), max(high, finite.max(initial=-np.inf))
    return (0.0, 1.0) if low >= 0.0 and high <= 1.0 else (low, high)


def _columns(fields: dict[str, Any], limits: dict[str, tuple[float, float]]) -> Columns:
    """Return what was read as the columns that every format gives."""
    columns: Columns = {"points": _points(fields), "invalid": _is_invalid(fields)}
    if "intensity" in fields:
        values = fields["intensity"]
        if "isIntensityInvalid" in fields:
            values = np.where(fields["isIntensityInvalid"] != 0, np.nan, values)
        columns["intensity"] = within_unit_range(np.clip(values, *limits["intensity"]), *limits["intensity"])
    if set(COLOURS) <= set(fields):
        columns["colors"] = np.column_stack([_bytes(fields[name], limits[name]) for name in COLOURS])
    if set(NORMALS) <= set(fields):
        columns["normals"] = np.column_stack([fields[name] for name in NORMALS])
    if set(GRID) <= set(fields):
        columns |= {"rows": fields["rowIndex"].astype(np.int32), "columns": fields["columnIndex"].astype(np.int32)}
    return columns


def _bytes(values: Any, limits: tuple[float, float]) -> Any:
    """Return one colour as 0-255; what lies beyond the limits that the file states is as dark or bright as they are."""
    values = np.clip(np.nan_to_num(values), *limits)
    if limits == (0.0, 255.0):
        return values.astype(np.uint8)
    return as_bytes_of_colour(within_unit_range(values, *limits), 255.0)


def _points(fields: dict[str, Any]) -> Any:
    """Return the points (n, 3) [m], given as Cartesian or spherical coordinates."""
    if set(CARTESIAN) <= set(fields):
        return np.column_stack([fields[name] for name in CARTESIAN])
    distance, azimuth, elevation = (fields[name] for name in SPHERICAL)
    flat = distance * np.cos(elevation)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)])


def _is_invalid(fields: dict[str, Any]) -> Any:
    """Return which points are flagged: by the state of the coordinates that are used."""
    used = STATES[0] if set(CARTESIAN) <= set(fields) else STATES[1]
    return fields[used] != 0 if used in fields else np.zeros(len(next(iter(fields.values()))), bool)
