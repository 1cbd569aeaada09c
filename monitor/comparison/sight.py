"""What the stations of an epoch saw of a place: looked through it, measured something there, or did not see it.

In: the scans of an epoch and where they stood, in the epoch's frame, chunk by chunk. Out: for each point whether the
way from a station passed through it to something farther: what stood there is gone, or had not come yet. Memory grows
with the number of directions, not of points.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from scipy.spatial import cKDTree

from projects.model import Bools, Floats, Ints

CELL_STEPS = 2.0  # angular steps of a scan along the edge of a cell of directions: four measurements each
CLEAR_CELLS = 3  # cells along the edge of the window that must be clear; a window is as wide as it must be deep
LEAST_SINE = 0.1  # of a beam above a surface, as far as the range within a cell is looked for
N_SAMPLES = 2000  # directions that show a scan's angular step
SIDE_BITS = 24


class Sighted(IntEnum):
    """What was seen of a place, the strongest over all stations."""

    NOT_SEEN = 0  # no station measured in that direction, or something nearer stood in the way
    MEASURED = 1  # something was measured at that range
    LOOKED_THROUGH = 2  # the way goes on, all around, to something farther


@dataclass(frozen=True)
class StationSight:
    """The nearest range in each direction that a station measured in.

    `origin` (3,) [m]; `cell` [rad]; `keys` (k,) of the cells, rising; `nearest` (k,) [m].
    """

    origin: Floats
    cell: float
    keys: Ints
    nearest: Floats


def gather_sight(origin: Floats, chunks: Iterable[Floats]) -> StationSight | None:
    """Return what a station at `origin` (3,) saw from the chunks (n, 3) [m] of its points; None without points."""
    cell = 0.0
    keys: Ints = np.zeros(0, dtype=np.int64)
    nearest: Floats = np.zeros(0)
    for points in chunks:
        beams = np.asarray(points, dtype=np.float64) - origin
        ranges = np.linalg.norm(beams, axis=1)
        beams, ranges = beams[ranges > 0.0], ranges[ranges > 0.0]
        if len(ranges) < 2:
            continue
        cell = cell or CELL_STEPS * angular_step(beams / ranges[:, None])
        keys, nearest = _nearest_each(np.concatenate([keys, direction_keys(beams, cell)[0]]),
                                      np.concatenate([nearest, ranges]))  # fmt: skip
    return StationSight(np.asarray(origin, dtype=np.float64), cell, keys, nearest) if len(keys) else None


def angular_step(directions: Floats) -> float:
    """Return the median angle [rad] between a direction (n, 3) and the one next to it, of a sample."""
    some = directions[:: max(len(directions) // N_SAMPLES, 1)]
    chord = cKDTree(directions).query(some, k=2)[0][:, 1]
    return float(np.median(chord[chord > 0.0])) if (chord > 0.0).any() else 1e-3


def _nearest_each(keys: Ints, ranges: Floats) -> tuple[Ints, Floats]:
    """Return the keys, each once and rising, with the smallest range of each."""
    order = np.argsort(keys, kind="stable")
    keys, ranges = keys[order], ranges[order]
    first = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    return keys[first], np.minimum.reduceat(ranges, first)


def direction_keys(beams: Floats, cell: float) -> tuple[Ints, Ints, Ints]:
    """Return the key (n,) of the cell of directions that each beam lies in, its row and column on its cube's face."""
    axis = np.abs(beams).argmax(axis=1)
    along = beams[np.arange(len(beams)), axis]
    face = 2 * axis + (along > 0.0)
    u = beams[np.arange(len(beams)), (axis + 1) % 3] / np.abs(along)
    v = beams[np.arange(len(beams)), (axis + 2) % 3] / np.abs(along)
    row, column = (np.floor((np.arctan(w) + 0.8) / cell).astype(np.int64) for w in (u, v))
    return _key(face, row, column), row, column


def _key(face: Ints, row: Ints, column: Ints) -> Ints:
    return (face << (2 * SIDE_BITS)) | (row << SIDE_BITS) | column


def look_at(sights: Iterable[StationSight], points: Floats, least: float) -> Ints:
    """Return `Sighted` (n,) of points (n, 3) in the frame of the stations.

    Looked through is what lies nearer, by a window's width and `least` [m], than everything measured in a window of
    three by three cells about its direction, each of which has a measurement: edges, mixed pixels and thin parts do not
    pass.
    """
    out = np.full(len(points), Sighted.NOT_SEEN, dtype=np.int64)
    for sight in sights:
        beams = points - sight.origin
        ranges = np.linalg.norm(beams, axis=1)
        key, row, column = direction_keys(beams, sight.cell)
        face = key >> (2 * SIDE_BITS)
        margin = np.maximum(CLEAR_CELLS * sight.cell * ranges, least)
        in_window = np.stack([_ranges_at(sight, _key(face, row + i, column + j)) for i in (-1, 0, 1)
                              for j in (-1, 0, 1)])  # fmt: skip
        clear = (in_window > ranges + margin).all(axis=0)  # NaN, no measurement, is not clear
        there = np.abs(in_window[4] - ranges) <= margin
        out = np.maximum(out, np.where(clear, Sighted.LOOKED_THROUGH, np.where(there, Sighted.MEASURED, 0)))
    return out


def _ranges_at(sight: StationSight, keys: Ints) -> Floats:
    """Return the nearest range in the cells (n,) [m]; NaN where nothing was measured."""
    at = np.minimum(np.searchsorted(sight.keys, keys), len(sight.keys) - 1)
    return np.where(sight.keys[at] == keys, sight.nearest[at], np.nan)


def is_measured(sight: StationSight, points: Floats, sines: Floats) -> Bools:
    """Return whether the station measured a surface at each point (n, 3): at its range, within a window's width along
    the surface, of which `sines` (n,) are of the beam's angle above it."""
    beams = points - sight.origin
    ranges = np.linalg.norm(beams, axis=1)
    nearest = _ranges_at(sight, direction_keys(beams, sight.cell)[0])
    return np.abs(nearest - ranges) <= CLEAR_CELLS * sight.cell * ranges / np.maximum(sines, LEAST_SINE)
