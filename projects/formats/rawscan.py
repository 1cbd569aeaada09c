"""What a reader tells of a scan inside the child process: a header of plain numbers and columns of arrays.

No file's own type crosses to the parent: a header is JSON, and a column has one of the kinds listed here.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

CHUNK = 1_000_000  # points handed over at once
Columns = dict[str, NDArray[Any]]

# the only columns that may cross, with little-endian dtype and width (0: one value a point)
KINDS = {
    "points": ("<f8", 3),
    "normals": ("<f8", 3),
    "intensity": ("<f4", 0),
    "colors": ("|u1", 3),
    "rows": ("<i4", 0),
    "columns": ("<i4", 0),
    "faces": ("<i8", 3),
    "invented": ("|u1", 0),
}


@dataclass(frozen=True)
class ScanHeader:
    """One scan of a file, before its points are read.

    `pose` is T_project_scanner in file units and `origin` the scanner's position in the scan's frame, each None where
    the file does not say. `is_centred`: the format puts the scanner at 0 0 0, so a point there has no range;
    `is_doubted`: so it would by the format, whose place for the position was left at its default. `has_faces`: the
    points are the vertices of a mesh. `system`: the fields of a `ReferenceSystem`, where the file names one. `unread`:
    which columns without names could not be told, in words. `step`: of the coarsest coordinate in file units, where
    one is rounded coarser than another, as far as headers and first lines tell, else 0. `place` is whatever the reader
    needs to find the scan again.
    """

    label: str = ""
    pose: list[list[float]] | None = None
    origin: list[float] | None = None
    n_declared: int | None = None
    scanner: str | None = None
    is_grid: bool = False
    is_centred: bool = False
    is_doubted: bool = False
    has_faces: bool = False
    system: Mapping[str, Any] | None = None
    unread: str = ""
    step: float = 0.0
    place: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return the header as JSON types."""
        return asdict(self)


def within_unit_range(values: NDArray[Any], low: float, high: float) -> NDArray[Any]:
    """Return values scaled so that low..high becomes 0..1 (float32); NaN where outside or not finite."""
    if not high > low:
        scaled = np.asarray(values, dtype=np.float64)
    else:
        scaled = (np.asarray(values, dtype=np.float64) - low) / (high - low)
    near = (scaled > -1e-6) & (scaled < 1.0 + 1e-6)
    return np.where(near, np.clip(scaled, 0.0, 1.0), np.nan).astype(np.float32)


def guess_intensity_range(low: float, high: float, has_fractions: bool = False) -> tuple[float, float]:
    """Return the range that instruments use and that intensities from `low` to `high` fit: 0-1, -2048-2047, 0-255,
    0-4095, 0-65535.

    For formats that do not state it (PTS, PTX, text, PLY, PCD). Where none fits, the range of the values themselves: of
    negative values with fractions, too, which are decibels (RIEGL's reflectance, some -25 to 5).
    """
    if low < 0.0 and has_fractions:
        return low, high
    for first, last in ((0.0, 1.0), (0.0, 255.0), (0.0, 4095.0), (-2048.0, 2047.0), (0.0, 65535.0)):
        if low >= first and high <= last:
            return first, last
    return low, high


def guess_colour_factor(highest: float, has_fractions: bool) -> float:
    """Return what turns colours into 0-255: 255 for fractions of one, 1/256 for 16 bits, else 1.

    Which of the three it is follows from the values: all within 0-1 and not all whole, above 255, or neither.
    """
    if highest <= 1.0 and has_fractions:
        return 255.0
    return 1.0 / 256.0 if highest > 255.0 else 1.0


def as_bytes_of_colour(values: NDArray[Any], factor: float) -> NDArray[np.uint8]:
    """Return colours (n, 3) times a factor as whole numbers 0-255.

    16-bit values are cut, not rounded, which undoes both of the ways in which programs make them: times 256 or 257.
    """
    scaled = np.nan_to_num(np.asarray(values, dtype=np.float64)) * factor
    return np.clip(np.floor(scaled) if factor < 1.0 else np.rint(scaled), 0, 255).astype(np.uint8)


def scaled(read: Callable[[], Iterator[Columns]], beside: NDArray[Any] | None = None) -> Iterator[Columns]:
    """Yield the columns of a scan with intensity as 0-1 and colours as 0-255, for formats that do not state ranges.

    `read` gives its columns from the beginning, as the file has them; colours that are bytes already stay as they are,
    those of which no point has one that is not black are left out: a file has them without a camera, too.
    The ranges are those of all its values: its first points may be darker than the rest. So a scan of more than one
    block is read twice, where anything in it needs a range. `beside`: intensities of other scans of the file, whose
    range it shares.
    """
    blocks = read()
    held = list(itertools.islice(blocks, 2))
    ranges = _Ranges()
    if beside is not None:
        ranges.widen({"intensity": beside})
    for columns in held:
        ranges.widen(columns)
    if len(held) == 2 and ranges.are_needed:
        for columns in blocks:
            ranges.widen(columns)
        held, blocks = [], read()
    for columns in itertools.chain(held, blocks):
        yield ranges.scale(columns)


class _Ranges:
    """What the intensities and colours of a scan reach, as far as it was seen."""

    def __init__(self) -> None:
        self.are_needed = False
        self._low, self._high = np.inf, -np.inf
        self._brightest, self._has_fractions, self._has_colours = 0.0, False, False
        self._has_decimals = False

    def widen(self, columns: Columns) -> None:
        """Take in one more block."""
        if "intensity" in columns:
            self.are_needed = True
            values = np.asarray(columns["intensity"], dtype=np.float64)
            finite = values[np.isfinite(values)]
            self._low = min(self._low, float(finite.min(initial=np.inf)))
            self._high = max(self._high, float(finite.max(initial=-np.inf)))
            self._has_decimals |= bool((finite != np.floor(finite)).any())
        if _are_unscaled(columns):
            self.are_needed = True
            colours = np.nan_to_num(np.asarray(columns["colors"], dtype=np.float64))
            self._brightest = max(self._brightest, float(colours.max(initial=0.0)))
            self._has_fractions |= bool((colours != np.floor(colours)).any())
            self._has_colours |= bool((colours > 0.0).any())

    def scale(self, columns: Columns) -> Columns:
        """Return a block with intensity as 0-1, NaN where not finite, and colours as 0-255."""
        scaled = dict(columns)
        if "intensity" in columns:
            limits = guess_intensity_range(self._low, self._high, self._has_decimals)
            scaled["intensity"] = within_unit_range(columns["intensity"], *limits)
        if _are_unscaled(columns) and not self._has_colours:
            del scaled["colors"]
        elif _are_unscaled(columns):
            factor = guess_colour_factor(self._brightest, self._has_fractions)
            scaled["colors"] = as_bytes_of_colour(columns["colors"], factor)
        return scaled


def _are_unscaled(columns: Columns) -> bool:
    """Return whether a block has colours that are not bytes yet."""
    return "colors" in columns and columns["colors"].dtype != np.uint8
