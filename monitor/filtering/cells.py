"""Repeated scans of one station brought together: which of their points measured in the same direction.

In: scans of one station; out: `Cells`, one for each direction, with the range that each scan measured there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from monitor.filtering.medians import median_known
from monitor.filtering.nearest import canonical_order
from monitor.filtering.one_direction import bring_to_cells
from monitor.filtering.soundness import require_scan
from projects.errors import ParameterError
from projects.model import Floats, Ints, PointCloud, Scan
from projects.transforms import apply, invert

SINGLE = 0.9  # share of the points of a grid that have its places for themselves
ONE_STATION = 0.005  # m between the stated positions of the scanner: more is not one station
N_BESIDE = 4  # nearest directions of a grid, one on each side
WIDER = 1.05  # than half the diagonal, so that what lies between four directions belongs to one of them
BEYOND = 5.0  # half diagonals of a direction's rectangle: that far from all directions of a scan it did not look
GAP_SHARE = 0.1  # of what has no direction near: from so much beyond on, the rest lies along the rim of a gap
SAME = 1e-5  # m, between a range and itself in another format; no instrument repeats a whole scan to it
N_COMPARED, FEW, ALL = 10_000, 7, 0.999  # cells that tell a copy, the fewest, and the share of them that must be same


@dataclass(frozen=True)
class Cells:
    """Directions in the order of neighbours and what k scans measured there.

    Attributes
    ----------
    ranges : (k, m) m along the directions, NaN where a scan has nothing.
    directions : (m, 3) unit vectors from the scanner, mean over the scans, in the frame of the first.
    rows, columns : (m,) place in the grid, -1 where the scans are none.
    cloud : intensity and colours, means over the scans.
    n_looked : (m,) scans whose window of rows and columns holds the cell, 1 where these are not known.
    n_unmatched : points of no cell.
    is_grid : whether cells are those of rows and columns, else of nearest directions.
    """

    ranges: Floats
    directions: Floats
    rows: Ints
    columns: Ints
    cloud: PointCloud
    n_looked: Ints
    n_unmatched: int
    is_grid: bool


def gather_cells(scans: Sequence[Scan]) -> Cells:
    """Bring repeated scans together, by row and column where these name the same directions, else by direction."""
    beams = _beams_of(scans)
    cells = _by_grid(scans, beams)
    if cells is None:
        cells = _by_direction(beams)
    cell_of, n_cells, rows, columns = cells
    ranges = np.full((len(scans), n_cells), np.nan)
    directions, n_unmatched = np.zeros((n_cells, 3)), 0
    extras = _Sums(scans, n_cells)
    for k, (scan, beam, cell) in enumerate(zip(scans, beams, cell_of, strict=True)):
        found = np.flatnonzero(cell >= 0)
        n_unmatched += len(cell) - len(found)
        length = np.linalg.norm(beam[found], axis=1)
        ranges[k, cell[found]] = length
        directions[cell[found]] += beam[found] / length[:, None]
        extras.add(scan, cell, found)
    _require_no_copies(scans, ranges)
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-300)
    ranges = bring_to_cells(ranges, beams, cell_of, directions)
    order = canonical_order(directions)
    is_grid = rows is not None
    none = np.full(n_cells, -1, dtype=np.int32)
    rows, columns = (none, none) if rows is None or columns is None else (rows[order], columns[order])
    cloud, n_looked = (
        extras.cloud().take(order),
        _count_looks(scans, rows, columns) if is_grid else np.ones(n_cells, int),
    )
    return Cells(ranges[:, order], directions[order], rows, columns, cloud, n_looked, n_unmatched, is_grid)


def _count_looks(scans: Sequence[Scan], rows: Ints, columns: Ints) -> Ints:
    """Return how many scans of a grid have the cells (m,) in their window, whether they measured something or not."""
    n_looked = np.zeros(len(rows), dtype=np.int64)
    for scan in scans:
        if len(scan.cloud) and scan.rows is not None and scan.columns is not None:
            is_inside = (rows >= scan.rows.min()) & (rows <= scan.rows.max())
            n_looked += is_inside & (columns >= scan.columns.min()) & (columns <= scan.columns.max())
    return n_looked


class _Sums:
    """Sums of the intensity of the cells, of the scans that have it, and of colours, where all have them."""

    def __init__(self, scans: Sequence[Scan], n_cells: int) -> None:
        self._n, self._n_intensity = np.zeros(n_cells), np.zeros(n_cells)
        self._intensity = None if all(s.cloud.intensity is None for s in scans) else np.zeros(n_cells)
        self._colors = None if any(s.cloud.colors is None for s in scans) else np.zeros((n_cells, 3))

    def add(self, scan: Scan, cell: Ints, found: Ints) -> None:
        """Add the points `found` of a scan to their cells, no two of them to one."""
        self._n[cell[found]] += 1
        if self._intensity is not None and scan.cloud.intensity is not None:
            known = np.isfinite(scan.cloud.intensity[found])
            self._n_intensity[cell[found]] += known
            self._intensity[cell[found]] += np.where(known, scan.cloud.intensity[found], 0.0)
        if self._colors is not None and scan.cloud.colors is not None:
            self._colors[cell[found]] += scan.cloud.colors[found]

    def cloud(self) -> PointCloud:
        """Return the means; the points themselves are not known yet."""
        n = np.maximum(self._n, 1.0)
        with np.errstate(invalid="ignore"):  # NaN where no scan knows it
            intensity = None if self._intensity is None else (self._intensity / self._n_intensity).astype(np.float32)
        return PointCloud(
            np.zeros((len(n), 3)),
            intensity=intensity,
            colors=None if self._colors is None else np.rint(self._colors / n[:, None]).astype(np.uint8),
        )


def _beams_of(scans: Sequence[Scan]) -> list[Floats]:
    """Return the vectors (n, 3) from the scanner to the points of each scan, all in the frame of the first."""
    if not any(len(s.cloud) for s in scans):
        raise ParameterError("no scan with a point was given to average; at least one is needed")
    for scan in scans:
        require_scan(scan)
        if not np.isfinite(scan.origin).all():
            raise ParameterError(f"scan {scan.name!r}: where the scanner stood is not known; repeated scans need it")
    first = scans[0]
    beams: list[Floats] = []
    for scan in scans:
        apart = float(np.linalg.norm(apply(scan.pose, scan.origin[None]) - apply(first.pose, first.origin[None])))
        if apart > ONE_STATION:
            raise ParameterError(
                f"scan {scan.name!r} stands {1e3 * apart:.1f} mm from {first.name!r}; repeated scans come from one "
                f"station (at most {1e3 * ONE_STATION:g} mm): add them without --repeated"
            )
        same = np.array_equal(scan.pose, first.pose)
        points = scan.cloud.points if same else apply(invert(first.pose) @ scan.pose, scan.cloud.points)
        beams.append(points - first.origin)
    return beams


def _require_no_copies(scans: Sequence[Scan], ranges: Floats) -> None:
    """Raise `ParameterError` where a scan measured the very ranges (k, m) of an earlier one: no noise would show.

    Whatever their order, their format, or how much of one was cut off.
    """
    some = ranges[:, :: max(ranges.shape[1] // N_COMPARED, 1)]
    for k, scan in enumerate(scans):
        for j, other in enumerate(scans[:k]):
            apart = np.abs(some[k] - some[j])
            apart = apart[np.isfinite(apart)]
            if len(apart) > FEW and np.mean(apart <= SAME) > ALL:
                raise ParameterError(f"scan {scan.name!r} is a copy of {other.name!r}; give each scan once")


def _by_grid(scans: Sequence[Scan], beams: list[Floats]) -> tuple[list[Ints], int, Ints | None, Ints | None] | None:
    """Return the cells of the points by row and column, or None where these do not name the same directions."""
    if any(s.rows is None or s.columns is None or (s.rows < 0).any() or (s.columns < 0).any() for s in scans):
        return None
    keys = [s.rows.astype(np.int64) << 32 | s.columns for s in scans if s.rows is not None and s.columns is not None]
    known = np.unique(np.concatenate(keys))
    if not len(known) or any(len(np.unique(key)) < SINGLE * len(key) for key in keys):
        return None
    cell_of = [
        _only_nearest(np.searchsorted(known, key), (b**2).sum(axis=1)) for key, b in zip(keys, beams, strict=True)
    ]
    if not _names_same_directions(cell_of, beams, known):
        return None
    return cell_of, len(known), (known >> 32).astype(np.int32), (known & 0xFFFFFFFF).astype(np.int32)


def _only_nearest(cell: Ints, distance2: Floats) -> Ints:
    """Return the cells (n,) with -1 for all points of a cell but that of least `distance2` (n,)."""
    order = np.lexsort((distance2, cell))
    again = np.zeros(len(cell), dtype=bool)
    again[order[1:]] = np.diff(cell[order]) == 0
    return np.where(again, -1, cell)


def _names_same_directions(cell_of: list[Ints], beams: list[Floats], known: Ints) -> bool:
    """Return whether the directions of a cell differ from scan to scan by less than half a step of the grid."""
    table = np.full((len(known), 3), np.nan)
    table[cell_of[0][cell_of[0] >= 0]] = _unit(beams[0][cell_of[0] >= 0])
    beside = np.diff(known) == 1
    if not beside.any():
        return True
    step = median_known(np.linalg.norm(np.diff(table, axis=0)[beside], axis=1))
    for cell, beam in zip(cell_of[1:], beams[1:], strict=True):
        found = cell >= 0
        apart = np.linalg.norm(table[cell[found]] - _unit(beam[found]), axis=1)
        if len(apart) and not median_known(apart) < 0.5 * step:
            return False
    return True


def _unit(vectors: Floats) -> Floats:
    """Return vectors (n, 3) of length one."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)


def _by_direction(beams: list[Floats]) -> tuple[list[Ints], int, None, None]:
    """Return the cells of the points by nearest direction of the scan with most points.

    A point belongs to a cell within half the diagonal of the rectangle that its direction has to itself. Where that
    scan did not look, farther than `BEYOND` of these from its directions, the directions of the others are cells
    likewise, along the rim of the gap too.
    """
    units = [_unit(beam) for beam in beams]
    cell_of: list[Ints] = [np.full(len(unit), -1, dtype=np.int64) for unit in units]
    left = [np.arange(len(unit)) for unit in units]  # points that no scan looked near to so far
    n_cells, reach = 0, float("nan")
    while any(map(len, left)):
        reference = max((unit[rest] for unit, rest in zip(units, left, strict=True)), key=len)
        tree = cKDTree(reference)
        reach = _reach_of(tree, reference) if np.isnan(reach) else reach
        for k, (unit, rest) in enumerate(zip(units, left, strict=True)):
            distance, cell = tree.query(unit[rest], distance_upper_bound=max(reach, 1e-12) * (1.0 + 1e-9))
            cell = np.where(np.isfinite(distance), cell, -1)
            inside, outside = np.flatnonzero(cell >= 0), np.flatnonzero(cell < 0)
            cell[inside] = _only_nearest(cell[inside], distance[inside])
            cell_of[k][rest] = np.where(cell >= 0, cell + n_cells, -1)
            apart, _ = tree.query(unit[rest[outside]], distance_upper_bound=BEYOND * max(reach, 1e-12))
            is_beyond = ~np.isfinite(apart)
            is_left = is_beyond | (is_beyond.mean() > GAP_SHARE if len(outside) else False)
            left[k] = rest[outside[is_left]]
        n_cells += len(reference)
    return cell_of, n_cells, None, None


def _reach_of(tree: cKDTree, directions: Floats) -> float:
    """Return half the diagonal of the rectangle that each of the directions (n, 3) of a tree has to itself."""
    apart = tree.query(directions, N_BESIDE + 1)[0][:, [1, N_BESIDE]]
    short, long = (of_side[np.isfinite(of_side) & (of_side > 0.0)] for of_side in apart.T)
    sides = [float(np.median(of_side)) if len(of_side) else 0.0 for of_side in (short, long)]
    return WIDER * 0.5 * float(np.hypot(sides[0], sides[1]))
