"""What the stations of an epoch saw of a place: looked through it, measured something there, or did not see it.

In: the scans of an epoch and where they stood, in the epoch's frame, chunk by chunk. Out: for each point whether the
way from a station passed through it to something farther: what stood there is gone, or had not come yet. Memory grows
with the number of directions, not of points: a cell of some four beams knows its nearest range and where they went.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from scipy.spatial import cKDTree

from monitor.comparison.distances.mesh_tree import MeshTree, build_tree
from monitor.comparison.sight.beam_grid import BeamGrid
from monitor.comparison.sight.directions import Bits, direction_keys, face_of_key, join_key, part_bits
from monitor.comparison.sight.pierced import find_pierced
from projects.model import Bools, Floats, Ints, Surface

Cells = tuple[Ints, Floats, Bits]

CELL_STEPS = 2.0  # angular steps of a scan along the edge of a cell of directions: four measurements each
CLEAR_CELLS = 3  # cells along the edge of the window that must be clear; a window is as wide as it must be deep
LEAST_SINE = 0.1  # of a beam above a surface, as far as the range within a cell is looked for
N_SAMPLES = 2000  # directions that show a scan's angular step


class Sighted(IntEnum):
    """What was seen of a place, the strongest over all stations."""

    NOT_SEEN = 0  # no station measured in that direction, or something nearer stood in the way
    MET_NOTHING = 1  # nothing is measured nearer all around, and mostly nothing at all, where a grid's beams went
    MEASURED = 2  # something was measured at that range
    LOOKED_THROUGH = 3  # the way goes on, all around, to something farther


@dataclass(frozen=True)
class StationSight:
    """The nearest range in each direction that a station measured in, and where in it the beams went.

    `origin` (3,) [m]; `cell` [rad]; `keys` (k,) of the cells, rising; `nearest` (k,) [m]; `beams` (k,) where in
    them something was measured (`part_bits`). `grid` tells of beams that met nothing, None where it is not known.
    """

    origin: Floats
    cell: float
    keys: Ints
    nearest: Floats
    beams: Bits
    grid: BeamGrid | None = None

    def with_empty(self, points: Floats) -> StationSight:
        """Return the sight with the beams of its grid near the directions of points (n, 3) that met nothing, infinitely
        far."""
        assert self.grid is not None
        beams = self.grid.empty_near(unit(points - self.origin), CLEAR_CELLS * self.cell)
        empty = direction_keys(beams, self.cell)[0], np.full(len(beams), np.inf), part_bits(beams, self.cell)
        cells = (np.concatenate(both) for both in zip((self.keys, self.nearest, self.beams), empty, strict=True))
        keys, nearest, bits = _join_cells(*cells)
        return replace(self, keys=keys, nearest=nearest, beams=bits, grid=None)


def gather_sight(origin: Floats, chunks: Iterable[Floats]) -> StationSight | None:
    """Return what a station at `origin` (3,) saw from the chunks (n, 3) [m] of its points; None without points."""
    cell = 0.0
    cells = _no_cells()
    for points in chunks:
        beams = np.asarray(points, dtype=np.float64) - origin
        ranges = np.linalg.norm(beams, axis=1)
        beams, ranges = beams[ranges > 0.0], ranges[ranges > 0.0]
        if len(ranges) < 2:
            continue
        cell = cell or CELL_STEPS * angular_step(beams / ranges[:, None])
        found = direction_keys(beams, cell)[0], ranges, part_bits(beams, cell)
        cells = _join_cells(*(np.concatenate(both) for both in zip(cells, found, strict=True)))
    return StationSight(np.asarray(origin, dtype=np.float64), cell, *cells) if len(cells[0]) else None


def angular_step(directions: Floats) -> float:
    """Return the median angle [rad] between a direction (n, 3) and the one next to it, of a sample."""
    some = directions[:: max(len(directions) // N_SAMPLES, 1)]
    chord = cKDTree(directions).query(some, k=2)[0][:, 1]
    return float(np.median(chord[chord > 0.0])) if (chord > 0.0).any() else 1e-3


def _no_cells() -> Cells:
    return np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0, dtype=np.uint64)


def _join_cells(keys: Ints, ranges: Floats, bits: Bits) -> Cells:
    """Return the keys, each once and rising, with the smallest range and all the bits of each."""
    order = np.argsort(keys, kind="stable")
    keys, ranges, bits = keys[order], ranges[order], bits[order]
    first = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    return keys[first], np.minimum.reduceat(ranges, first), np.bitwise_or.reduceat(bits, first)


def unit(beams: Floats) -> Floats:
    """Return the directions (n, 3) of beams (n, 3)."""
    return np.asarray(beams / np.maximum(np.linalg.norm(beams, axis=1), 1e-300)[:, None])


def look_at(sights: Sequence[StationSight], points: Floats, least: float, surface: Surface | None = None) -> Ints:
    """Return `Sighted` (n,) of points (n, 3) in the frame of the stations.

    Looked through is what lies nearer, by a window's width and `least` [m], than everything measured in a window of
    three by three cells about its direction, each of which has a measurement: edges, mixed pixels and thin parts that a
    beam met do not pass. Of thinner ones that stand between the beams nothing would be nearer either: where the
    `surface` that the points are of is given, a beam must have gone through it beside the point (`find_pierced`).
    Where all that is so but that most of the window, its middle among it, holds nothing of a scan whose beams went
    there, the way may have been free, or what stood in it did not come back.
    """
    tree = None if surface is None else build_tree(surface, surface.vertices[0], math.pi)
    out = _look(sights, points, least, tree)
    unseen = np.flatnonzero(out == Sighted.NOT_SEEN)
    if len(unseen):
        fuller = (sight.with_empty(points[unseen]) for sight in sights if sight.grid is not None)
        is_free = _look(fuller, points[unseen], least, tree) == Sighted.MET_NOTHING
        out[unseen[is_free]] = Sighted.MET_NOTHING
    return out


def _look(sights: Iterable[StationSight], points: Floats, least: float, tree: MeshTree | None) -> Ints:
    """Return `Sighted` (n,) of points (n, 3), of the `tree`'s surface where it is given, by what was measured and by
    beams that met nothing, infinitely far."""
    out = np.full(len(points), Sighted.NOT_SEEN, dtype=np.int64)
    for sight in sights:
        ranges = np.linalg.norm(points - sight.origin, axis=1)
        margin = np.maximum(window_width(sight, points), least)
        window = cells_around(sight, points)
        in_window = np.where(window >= 0, sight.nearest[window], np.nan)
        clear = (in_window > ranges + margin).all(axis=0)  # NaN, no measurement, is not clear
        if tree is not None:
            which = np.flatnonzero(clear)
            clear[which] = find_pierced(
                sight.origin, sight.cell, tree, points[which], margin[which], sight.beams[window[:, which]]
            )  # fmt: skip
        there = np.abs(in_window[4] - ranges) <= margin
        empty = np.isinf(in_window)
        is_empty = empty[4] & (empty.sum(axis=0) > len(empty) / 2)
        free = np.where(is_empty, Sighted.MET_NOTHING, np.where(empty.any(axis=0), 0, Sighted.LOOKED_THROUGH))
        out = np.maximum(out, np.where(clear, free, np.where(there, Sighted.MEASURED, 0)))
    return out


def window_width(sight: StationSight, points: Floats) -> Floats:
    """Return how wide [m] a window of directions is at points (n, 3)."""
    return np.asarray(CLEAR_CELLS * sight.cell * np.linalg.norm(points - sight.origin, axis=1))


def cells_around(sight: StationSight, points: Floats) -> Ints:
    """Return which cell of the station lies in each place (9, n) of the window about each point (n, 3), row by row; -1
    where nothing was measured in it."""
    key, row, column = direction_keys(points - sight.origin, sight.cell)
    face = face_of_key(key)
    return np.stack([_find_cells(sight, join_key(face, row + i, column + j)) for i in (-1, 0, 1) for j in (-1, 0, 1)])


def _find_cells(sight: StationSight, keys: Ints) -> Ints:
    """Return which cell (n,) has each key; -1 where nothing was measured in it."""
    at = np.minimum(np.searchsorted(sight.keys, keys), len(sight.keys) - 1)
    return np.where(sight.keys[at] == keys, at, -1)


def goes_on(sight: StationSight, points: Floats, depths: Floats) -> tuple[Bools, Bools]:
    """Return of which points (n, 3) a station can tell whether its way goes on for `depths` (n,) [m] behind them, and
    whether it does: it measured in their direction, and they are deeper than a window is wide."""
    nearest, ranges = _nearest_at(sight, points)
    margin = window_width(sight, points)
    return np.isfinite(nearest) & (depths > margin), nearest > ranges + margin


def _nearest_at(sight: StationSight, points: Floats) -> tuple[Floats, Floats]:
    """Return the nearest range [m] in the cell of each point (n, 3), NaN where nothing was measured, and its own."""
    beams = points - sight.origin
    at = _find_cells(sight, direction_keys(beams, sight.cell)[0])
    return np.where(at >= 0, sight.nearest[at], np.nan), np.linalg.norm(beams, axis=1)


def is_measured(sight: StationSight, points: Floats, sines: Floats) -> Bools:
    """Return whether the station measured a surface at each point (n, 3): at its range, within a window's width along
    the surface, of which `sines` (n,) are of the beam's angle above it."""
    nearest, ranges = _nearest_at(sight, points)
    return np.abs(nearest - ranges) <= CLEAR_CELLS * sight.cell * ranges / np.maximum(sines, LEAST_SINE)
