"""The extent of an object in the project's frame: a box, or a polygon with heights, read from a small JSON file.

{"box": {"min": [x, y, z], "max": [x, y, z]}} or {"polygon": [[x, y], ...], "bottom": z, "top": z}; either height may
be left out. What lies outside is counted by the chain and not processed (docs/method.md, step 0).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from projects.errors import FormatError, ParameterError, ShapeError
from projects.model import Bools, Floats

MAX_BYTES = 10_000_000
N_WAYS = 16  # directions tried, to find one in which few edges of a polygon lie beside each other
SHAPES = '{"box": {"min": [x, y, z], "max": [x, y, z]}} or {"polygon": [[x, y], ...], "bottom": z, "top": z}'


@dataclass(frozen=True)
class Extent:
    """A prism over a polygon, `corners` (n, 2) [m] in their order, from `bottom` to `top` [m], infinite where open."""

    corners: Floats
    bottom: float = -math.inf
    top: float = math.inf

    @classmethod
    def from_mapping(cls, content: Any, unit: float = 1.0) -> Extent:
        """Return the extent that a mapping of the file's form states; raise `ParameterError` where it states none."""
        if not isinstance(content, Mapping) or len(content.keys() & {"box", "polygon"}) != 1:
            raise ParameterError(f"an extent is {SHAPES}")
        allowed = {"box"} if "box" in content else {"polygon", "bottom", "top"}
        if unknown := sorted(str(k) for k in content.keys() - allowed):
            raise ParameterError(f"unknown entry {unknown[0]!r}; an extent is {SHAPES}")
        return _box(content["box"], unit) if "box" in content else _prism(content, unit)

    def to_mapping(self) -> dict[str, Any]:
        """Return the mapping that says the extent, in metres; the form in which `ObjectRecord.extent` keeps it."""
        mapping: dict[str, Any] = {"polygon": self.corners.tolist()}
        heights = {"bottom": self.bottom, "top": self.top}
        return mapping | {name: value for name, value in heights.items() if math.isfinite(value)}


def read_extent(path: Path | str, unit: float = 1.0) -> Extent:
    """Return the extent of a JSON file; `unit` is the metres of one unit of the file.

    Raises
    ------
    FormatError
        Where the file cannot be read or is no extent, with what is allowed.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise FormatError(f"{path} is too large to be an extent")
        content = json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror})") from error
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path} is not JSON ({error}); an extent is {SHAPES}") from error
    try:
        return Extent.from_mapping(content, unit)
    except ParameterError as error:
        raise FormatError(f"{path}: {error}") from error


def inside(extent: Extent | Mapping[str, Any], points: Floats) -> Bools:
    """Return which points lie in the extent, its border included for boxes.

    Parameters
    ----------
    extent : the extent, or the mapping of an object's record.
    points : (n, 3) m, project frame.

    Returns
    -------
    (n,) bool; a point with NaN lies outside.

    Notes
    -----
    Even-odd rule: a point is inside where a ray to +x crosses the polygon's edges an odd number of times.
    """
    extent = extent if isinstance(extent, Extent) else Extent.from_mapping(extent)
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ShapeError(f"points has shape {points.shape}; (n, 3) is needed")
    x, y, z = points.T
    within = (z >= extent.bottom) & (z <= extent.top)
    low, high = extent.corners.min(axis=0), extent.corners.max(axis=0)
    within &= (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
    if not _is_rectangle(extent.corners):
        within[within] = _in_polygon(extent.corners, x[within], y[within])
    return within


def require_part(extent: Extent, earlier: Floats, later: Floats) -> None:
    """Raise `ParameterError` where an area that is to be stable holds none of the earlier epoch's points (n, 3) [m], or
    all of these and of the later one's (m, 3): it may be in another unit, or in other coordinates."""
    held = inside(extent, earlier)
    is_all = held.all() and inside(extent, later).all()
    if held.any() and not is_all:
        return
    (x0, y0), (x1, y1) = extent.corners.min(axis=0), extent.corners.max(axis=0)
    area = _in_words((x0, y0, extent.bottom), (x1, y1, extent.top))
    raise ParameterError(
        f"the stable area, within {area}, holds {'all of both epochs' if is_all else 'nothing of the earlier epoch'}; "
        f"that lies within {_in_words(earlier.min(axis=0), earlier.max(axis=0))}; give the part where nothing moved, "
        "in metres and in its coordinates, or leave it out"
    )


def _in_words(low: Sequence[float] | Floats, high: Sequence[float] | Floats) -> str:
    """Return a box as text, in metres to the millimetre."""
    return ", ".join(f"{name} {a:.3f} to {b:.3f}" for name, a, b in zip("xyz", low, high, strict=True)) + " m"


def _is_rectangle(corners: Floats) -> bool:
    """Return whether the polygon is its own bounding box."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    at_corner = np.all((corners == low) | (corners == high), axis=1).all()
    return len(corners) == 4 and bool(at_corner) and bool((corners[0] != corners[2]).all())


def _in_polygon(corners: Floats, x: Floats, y: Floats) -> Bools:
    """Return which places (n,) lie inside of a polygon (m, 2): an odd number of sides lies to their right."""
    odd = np.zeros(len(x), dtype=bool)
    for (xa, ya), (xb, yb) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if ya == yb:
            continue
        crosses = (ya > y) != (yb > y)
        odd ^= crosses & (x < xa + (y - ya) / (yb - ya) * (xb - xa))
    return odd


def _box(box: Any, unit: float) -> Extent:
    """Return the extent of a box as it was written, `unit` metres a number."""
    if not isinstance(box, Mapping) or box.keys() != {"min", "max"}:
        raise ParameterError('a box is {"min": [x, y, z], "max": [x, y, z]}')
    low, high = _numbers(box["min"], 3, "box/min") * unit, _numbers(box["max"], 3, "box/max") * unit
    if not (low < high).all():
        raise ParameterError(f"the box's min {low.tolist()} is not below its max {high.tolist()} in x, y and z")
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    return Extent(corners, float(low[2]), float(high[2]))


def _prism(content: Mapping[str, Any], unit: float) -> Extent:
    """Return the extent of a polygon with heights as it was written, `unit` metres a number."""
    polygon = content["polygon"]
    if not isinstance(polygon, list | tuple) or len(polygon) < 3:
        raise ParameterError("a polygon has at least three corners [x, y]")
    corners = np.array([_numbers(c, 2, f"polygon/{k}") for k, c in enumerate(polygon)]) * unit
    if (corners[0] == corners[-1]).all():
        corners = corners[:-1]
    if _crosses_itself(corners):
        raise ParameterError("the polygon crosses itself; give its corners in order around the object")
    if len(corners) < 3 or _area(corners) == 0.0:
        raise ParameterError("the polygon encloses no area; at least three corners that are not in one line are needed")
    heights = {
        k: float(_numbers([content[k]], 1, k)[0]) * unit for k in ("bottom", "top") if content.get(k) is not None
    }
    extent = Extent(corners, **heights)
    if not extent.bottom < extent.top:
        raise ParameterError(f"the bottom {extent.bottom:g} m is not below the top {extent.top:g} m")
    return extent


def _area(corners: Floats) -> float:
    """Return the area of a polygon (m, 2)."""
    x, y = (corners - corners.mean(axis=0)).T
    return float(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2.0)


def _crosses_itself(corners: Floats) -> bool:
    """Return whether two edges that are not neighbours cross."""
    n, following = len(corners), np.roll(corners, -1, axis=0)
    across = _way_across(corners)
    low, high = _extents(corners, across)
    order = np.argsort(low, kind="stable")
    ends = np.searchsorted(low[order], high[order], side="right")
    starts, stops = corners[order], following[order]
    low, high = (side[order] for side in _extents(corners, np.array([-across[1], across[0]])))
    for k, i in enumerate(order):
        beside = slice(k + 1, ends[k])  # edges that begin before this one ends, on the way across
        near = k + 1 + np.flatnonzero((low[beside] <= high[k]) & (high[beside] >= low[k]))
        near = near[(order[near] != (i + 1) % n) & ((order[near] + 1) % n != i)]
        if len(near) == 0:
            continue
        a, b, c, d = starts[k], stops[k], starts[near], stops[near]
        apart_ab = _side(a, b, c) * _side(a, b, d) < 0
        apart_cd = _side(c, d, a) * _side(c, d, b) < 0
        if (apart_ab & apart_cd).any():
            return True
    return False


def _way_across(corners: Floats) -> Floats:
    """Return the direction (2,) along which the fewest pairs of edges of a polygon lie beside each other: of many all
    around, and across its long edges, since those of a comb lie beside each other in all directions but that one."""
    edges = np.roll(corners, -1, axis=0) - corners
    long = edges[np.argsort(-np.hypot(*edges.T), kind="stable")[[0, len(edges) // 4]]]
    angles = np.append(np.pi * np.arange(N_WAYS) / N_WAYS, np.arctan2(long[:, 0], -long[:, 1]))
    ways = np.column_stack([np.cos(angles), np.sin(angles)])
    return min(ways, key=lambda way: _n_beside(*_extents(corners, way)))


def _extents(corners: Floats, way: Floats) -> tuple[Floats, Floats]:
    """Return where each edge (m,) of a polygon begins and ends in a direction (2,), no less than rounding may take."""
    along, slack = (corners - corners[0]) @ way, 8.0 * np.finfo(float).eps * np.abs(corners).max()
    following = np.roll(along, -1)
    return np.minimum(along, following) - slack, np.maximum(along, following) + slack


def _n_beside(low: Floats, high: Floats) -> int:
    """Return how many pairs of intervals from `low` to `high` (m,) have a part in common, each counted with itself."""
    begun = np.searchsorted(np.sort(low), high, side="right")
    return int(begun.sum()) - len(low) * (len(low) - 1) // 2


def _side(a: Floats, b: Floats, p: Floats) -> Floats:
    """Return on which side of the line a to b the point p lies, as the sign of an area."""
    ab, ap = b - a, p - a
    return np.sign(ab[..., 0] * ap[..., 1] - ab[..., 1] * ap[..., 0])


def _numbers(values: Any, n: int, where: str) -> Floats:
    """Return n finite numbers of a list; refuse anything else with its place in the file."""
    right = isinstance(values, list | tuple) and len(values) == n
    if not right or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        raise ParameterError(f"{where}: {n} number{'s' if n > 1 else ''} needed, {str(values)[:60]!r} given")
    try:
        array = np.array([float(v) for v in values])
    except OverflowError:
        array = np.full(n, np.inf)
    if not np.isfinite(array).all():
        raise ParameterError(f"{where}: {str(values)[:60]!r} is not finite")
    return array
