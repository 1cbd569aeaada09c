"""LAS and LAZ points in (ASPRS), in project coordinates.

Runs in the child process. The header is checked against the file before laspy sees it: a header can promise points
and records that are not there, and laspy would allocate them. LAZ is decoded by lazrs, whose panics the child reports.
Intensity is 0-65535 by the standard. Colours are 16 bits by the standard and 8 bits in many files; intensity and
colours that are zero throughout are taken as absent. Withheld points count as flagged invalid; what somebody classified
as noise is no measurement either: class 7, and 18 where the point format has it. Other classes are kept.
"""

from __future__ import annotations

import contextlib
import os
import struct
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import laspy
import lazrs
import numpy as np
from pyproj.exceptions import CRSError

from projects.errors import FormatError
from projects.formats.rawscan import CHUNK, Columns, ScanHeader, as_bytes_of_colour, within_unit_range
from projects.reference_systems import describe_system

SHORTEST_HEADER, VLR_HEADER, EVLR_HEADER = 227, 54, 60
NOISE, HIGH_NOISE, FIRST_WITH_HIGH = 7, 18, 6  # classes; 18 is reserved before point format 6
COLOURS = ("red", "green", "blue")
EIGHT_BITS = 255
BROKEN = (laspy.LaspyException, lazrs.LazrsError, struct.error, EOFError, OSError, ValueError)  # what a bad file raises
RECORD_LENGTHS = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)  # of point formats 0 to 10, without extra bytes


def list_scans(path: str) -> list[ScanHeader]:
    """Return the one scan of the file."""
    n, is_compressed = require_sound_header(path)
    if not n:
        return [ScanHeader(n_declared=n)]
    with laspy.open(path, read_evlrs=False) as reader:
        n = reader.header.point_count if is_compressed else n
        step = _uneven_step(reader.header)
        return [ScanHeader(n_declared=n, step=step, system=_system(reader.header), place=_filled(reader))]


def _uneven_step(header: Any) -> float:
    """Return the coarsest step of the coordinates in file units where the header scales one coarser than another; 0
    where all are alike."""
    scales = np.abs(np.asarray(header.scales, dtype=np.float64))
    return float(scales.max()) if np.isfinite(scales).all() and scales.max() > 1.5 * scales.min() else 0.0


def _filled(reader: Any) -> dict[str, Any]:
    """Return whether any point has an intensity, and what turns colours into 0-255, 0 where all are zero; looked for as
    far as the file is whole and no further than needed. That a file is broken is said when it is read."""
    has_intensity, highest = False, 0
    has_colours = set(COLOURS) <= set(reader.header.point_format.dimension_names)
    with contextlib.suppress(*BROKEN):
        for points in reader.chunk_iterator(CHUNK):
            has_intensity = has_intensity or bool(np.asarray(points.intensity).any())
            if has_colours:
                highest = max(highest, *(int(np.asarray(points[name]).max(initial=0)) for name in COLOURS))
            if has_intensity and (not has_colours or highest > EIGHT_BITS):
                break
    factor = 1.0 / 256.0 if highest > EIGHT_BITS else float(highest > 0)
    return {"has_intensity": has_intensity, "colour_factor": factor}


def read_scan(path: str, header: ScanHeader) -> Iterator[Columns]:
    """Yield the points; fewer than promised is an error."""
    require_sound_header(path)
    n_read = 0
    try:
        with laspy.open(path, read_evlrs=False) as reader:
            _require_scales(reader.header)
            for points in reader.chunk_iterator(CHUNK):
                n_read += len(points)
                yield _columns(points, header.place)
    except BROKEN as problem:
        reason = (str(problem).splitlines() or [type(problem).__name__])[0]
        raise FormatError(f"broken after {n_read} of {header.n_declared} points: {reason}") from problem
    if n_read != header.n_declared:
        raise FormatError(f"promises {header.n_declared} points, {n_read} are there; the file is cut off")


def require_sound_header(path: str) -> tuple[int, bool]:
    """Return how many points the header promises and whether they are compressed; raise where the file is too short."""
    size = os.path.getsize(path)
    with Path(path).open("rb") as file:
        head = file.read(375)
        if len(head) < SHORTEST_HEADER:
            raise FormatError(f"is {size} bytes long; a LAS header alone has {SHORTEST_HEADER}")
        n_header, offset, n_vlrs, kind, length, n = struct.unpack_from("<HIIBHI", head, 94)
        minor, is_followed = head[25], head[25] == 3  # in 1.3 waveforms may follow the points
        if minor >= 4 and len(head) >= 375:
            n = struct.unpack_from("<Q", head, 247)[0] or n
            is_followed = any(head[227:247])  # by waveforms or extended records
            _require_evlrs(file, struct.unpack_from("<QI", head, 235), size)
        if not SHORTEST_HEADER <= n_header <= offset <= size:
            raise FormatError(f"its header says that points begin at byte {offset}; the file has {size}")
        _require_vlrs(file, n_header, n_vlrs, offset)
    is_compressed = bool(kind & 0xC0)
    number = kind & 0x3F
    if number >= len(RECORD_LENGTHS) or length < RECORD_LENGTHS[number]:
        raise FormatError(f"its header gives point format {number} with {length} bytes a point; the file is broken")
    there = (size - offset) // length
    if not is_compressed and (there < n or (there > n > 0 and not is_followed)):
        raise FormatError(f"promises {n} points, {there} are there; the file is cut off or damaged")
    return n, is_compressed


def _require_vlrs(file: Any, at: int, n: int, end: int) -> None:
    """Raise where the variable-length records do not end before the points; too few bytes for the last is tolerated.

    Files whose header counts more records than it has room for exist and are read by laspy: only lengths that reach
    beyond the points are refused.
    """
    if n * VLR_HEADER > end:
        raise FormatError(f"its header counts {n} records before the points, for which there is no room")
    for _ in range(n):
        if at + VLR_HEADER > end:
            return
        file.seek(at + 20)
        (length,) = struct.unpack("<H", file.read(2))
        at += VLR_HEADER + length
        if at > end:
            raise FormatError("has a record before the points that reaches into them; the file is broken")


def _require_evlrs(file: Any, place: tuple[int, int], size: int) -> None:
    """Raise where extended records (their offset and number) reach beyond the end of the file."""
    at, n = place
    for _ in range(n):
        if at + EVLR_HEADER > size:
            raise FormatError("promises records after the points that are not there; the file is cut off")
        file.seek(at + 20)
        (length,) = struct.unpack("<Q", file.read(8))
        at += EVLR_HEADER + length
    if n and at > size:
        raise FormatError("promises records after the points that are not there; the file is cut off")


def _require_scales(header: Any) -> None:
    """Raise where coordinates cannot be made of the stored whole numbers."""
    scales, offsets = np.asarray(header.scales), np.asarray(header.offsets)
    if not (np.isfinite(scales).all() and np.isfinite(offsets).all() and (scales > 0).all()):
        raise FormatError(f"its header scales coordinates by {scales.tolist()}; positive numbers are needed")


def _system(header: Any) -> dict[str, Any] | None:
    """Return the reference system that the file's records name, in words or by keys, where they are understood."""
    with contextlib.suppress(CRSError, ValueError, KeyError, IndexError, struct.error):
        system = header.parse_crs()
        return None if system is None else asdict(describe_system(system))
    return None


def _columns(points: Any, filled: Mapping[str, Any]) -> Columns:
    """Return the points as the columns that every format gives."""
    columns: Columns = {"points": np.column_stack([np.asarray(getattr(points, axis)) for axis in "xyz"])}
    columns["invalid"] = np.asarray(points.withheld).astype(bool)
    classes = np.asarray(points.classification)
    has_high = points.point_format.id >= FIRST_WITH_HIGH
    columns["noise"] = (classes == NOISE) | ((classes == HIGH_NOISE) & has_high)
    if filled["has_intensity"]:
        columns["intensity"] = within_unit_range(np.asarray(points.intensity), 0.0, 65535.0)
    if filled["colour_factor"]:
        colours = np.column_stack([np.asarray(points[name]) for name in COLOURS])
        columns["colors"] = as_bytes_of_colour(colours, filled["colour_factor"])
    return columns
