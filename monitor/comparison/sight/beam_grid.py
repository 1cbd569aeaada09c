"""Where the beams of a scan went that met nothing: a grid of rows and columns has a place for each of them.

In: the rows, columns and beams of what a scan measured. Out: at which angles its rows and columns lie, and near which
directions the scan holds nothing where beams of it went. What stood there is gone, or it or something before it does
not reflect, or it was cut out of the file. Between the first and the last row and column that hold anything beams are
taken to have gone everywhere; not in scans that were thinned (`FULL`). Scans over the zenith in both faces, and those
whose points a compensator turned by more than half a step, are not known as grids.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monitor.bearings import angles_of, directions_of
from projects.model import Bools, Floats, Ints

STEEPEST = 1.2  # rad: beams higher or lower tell the turn of their columns badly
MOST_OFF = 0.5  # steps: beams that lie farther off the angles of their rows and columns make no grid
DRIFT = 0.01  # of a step, by which steps without any beam may differ in the mean from others
FEWEST = 8  # rows and columns
FULL = 0.5  # of the beams that met something have all four beside them, at least: else the scan was thinned
SPARSEST = 30  # places of a grid for each that was fired, at most


@dataclass(frozen=True)
class BeamGrid:
    """The turns [rad] of the columns (c,) of a scan, rising or falling, the heights [rad] of its rows (r,), which beams
    met something, eight columns to a byte (r, c / 8), and the rotation (3, 3) that puts the frame of the scan into that
    of the epoch."""

    turns: Floats
    heights: Floats
    has_met: NDArray[np.uint8]
    rotation: Floats

    def empty_near(self, directions: Floats, reach: float) -> Floats:
        """Return the unit vectors (k, 3) of the beams within `reach` [rad] of directions (n, 3) that met nothing, and
        some around, in the epoch's frame."""
        turn, height = angles_of(directions @ self.rotation)
        turn += 2.0 * math.pi * np.round((self.turns.mean() - turn) / (2.0 * math.pi))
        row, row_is_in = place_among(self.heights, height, reach)
        found = []
        for shift in (-2.0 * math.pi, 0.0, 2.0 * math.pi):  # a scan all around has each direction but once
            column, column_is_in = place_among(self.turns, turn + shift, reach)
            at = row_is_in & column_is_in & (np.abs(height) < STEEPEST)
            if at.any():
                slant = math.cos(float(np.abs(height[at]).max()))
                found.append(self._empty_around(row[at], column[at], reach, slant))
        if not found:
            return np.zeros((0, 3))
        row, column = np.divmod(np.unique(np.concatenate(found)), len(self.turns))
        return directions_of(self.turns[column], self.heights[row]) @ self.rotation.T

    def _empty_around(self, row: Ints, column: Ints, reach: float, slant: float) -> Ints:
        """Return the numbers (k,), row by row, of the beams without any return within `reach` [rad] of some (n,), of
        which none is steeper than `slant`, the cosine of its height, tells."""
        up, aside = (math.ceil(reach / step) for step in (step_of(self.heights), slant * step_of(self.turns)))
        low = max(int(row.min()) - up, 0), max(int(column.min()) - aside, 0)
        high = min(int(row.max()) + up + 1, len(self.heights)), min(int(column.max()) + aside + 1, len(self.turns))
        met = np.unpackbits(self.has_met[low[0] : high[0]], axis=1, count=len(self.turns))[:, low[1] : high[1]]
        asked = np.zeros(met.shape, dtype=np.bool_)
        places = np.stack(np.divmod(np.unique(row * len(self.turns) + column), len(self.turns))) - np.array([low]).T
        for i, j in itertools.product(range(-up, up + 1), range(-aside, aside + 1)):
            near = places + np.array([[i], [j]])
            is_in = ((near >= 0) & (near < np.array([met.shape]).T)).all(axis=0)
            asked[near[0, is_in], near[1, is_in]] = True
        found = np.nonzero(asked & (met == 0))
        return np.asarray((found[0] + low[0]) * len(self.turns) + found[1] + low[1])


class GridBuilder:
    """Gathers from the chunks of a scan of so many fired beams at which angle each of its rows and columns lies, and
    which beams met something. Rows and columns that ask for many more places are given up."""

    def __init__(self, n_fired: int) -> None:
        self.most_places = SPARSEST * n_fired
        self.has_met = np.zeros((0, 0), dtype=np.bool_)
        self.sums: dict[str, Floats] = {}

    def add(self, rows: Ints, columns: Ints, beams: Floats) -> None:
        """Count beams (n, 3) [m], in the scan's frame, of these rows and columns (n,), -1 for none."""
        is_placed = (rows >= 0) & (columns >= 0)
        rows, columns, beams = rows[is_placed], columns[is_placed], beams[is_placed]
        if not len(rows) or not self._has_room(int(rows.max()) + 1, int(columns.max()) + 1):
            return
        self.has_met[rows, columns] = True
        flat = np.hypot(beams[:, 0], beams[:, 1])
        turn = beams[:, :2] / np.maximum(flat, 1e-300)[:, None]
        height = np.column_stack([flat, beams[:, 2]]) / np.maximum(np.hypot(flat, beams[:, 2]), 1e-300)[:, None]
        is_low = np.abs(height[:, 1]) < math.sin(STEEPEST)
        for index, name in ((rows, "row"), (columns, "column")):
            self._sum(f"height of {name}", index, height)
            self._sum(f"turn of {name}", index[is_low], turn[is_low])

    def _has_room(self, n_rows: int, n_columns: int) -> bool:
        """Make the grid as large as asked, or by half larger than it is; return whether that is no more than it may
        be."""
        old = self.has_met.shape
        wanted = max(n_rows, old[0]), max(n_columns, old[1])
        if wanted[0] * wanted[1] > self.most_places:
            self.most_places = 0
            return False
        if wanted != old:
            shape = [n if n == have else max(n, have + have // 2) for n, have in zip(wanted, old, strict=True)]
            larger = np.zeros(shape, dtype=np.bool_)
            larger[: old[0], : old[1]] = self.has_met
            self.has_met = larger
        return True

    def _sum(self, name: str, index: Ints, ways: Floats) -> None:
        """Add the cosines and sines (n, 2) of angles to those of their rows or columns, and count them."""
        if not len(index):
            return
        more = np.stack([np.bincount(index, ways[:, 0]), np.bincount(index, ways[:, 1]), np.bincount(index)])
        known = self.sums.get(name, np.zeros((3, 0)))
        both = np.zeros((3, max(more.shape[1], known.shape[1])))
        both[:, : known.shape[1]] = known
        both[:, : more.shape[1]] += more
        self.sums[name] = both

    def finish(self, rotation: Floats) -> BeamGrid | None:
        """Return the grid, turned into the epoch's frame; None where rows and columns are not of one height and one
        turn each, in either order, or the scan was thinned."""
        for upright, across, has_met in (("row", "column", self.has_met), ("column", "row", self.has_met.T)):
            heights = even_angles(self.sums.get(f"height of {upright}"))
            turns = even_angles(self.sums.get(f"turn of {across}"))
            if heights is not None and turns is not None and self.most_places:
                met = has_met[heights[1], turns[1]]
                return BeamGrid(turns[0], heights[0], np.packbits(met, axis=1), rotation) if is_full(met) else None
        return None


def is_full(has_met: Bools) -> bool:
    """Return whether beams (r, c) that met something mostly have all four beside them that did: in a scan that was
    thinned, those between were fired no more."""
    inner = has_met[1:-1, 1:-1]
    beside = has_met[:-2, 1:-1] & has_met[2:, 1:-1] & has_met[1:-1, :-2] & has_met[1:-1, 2:]
    return bool((inner & beside).sum() >= FULL * has_met.sum())


def even_angles(sums: Floats | None) -> tuple[Floats, slice] | None:
    """Return the angles [rad] of rows or columns from the first to the last that has any beam, of one that has none
    between its neighbours', and which these are. None where they are not as a grid's: each with beams of one angle,
    and one after another.

    `sums` (3, n) are the cosines, sines and numbers of the beams of each.
    """
    if sums is None:
        return None
    at = np.flatnonzero(sums[2] > 0.0)
    if len(at) < FEWEST or not (np.diff(at) == 1).any():
        return None
    length = np.hypot(sums[0, at], sums[1, at]) / sums[2, at]
    angle, n = np.arctan2(sums[1, at], sums[0, at]), np.diff(at)
    step = float(np.median(part_of_turn(np.diff(angle)[n == 1])))
    off = part_of_turn(np.diff(angle) - n * step)
    spread = np.sqrt(np.average(2.0 * np.maximum(1.0 - length, 0.0), weights=sums[2, at]))
    if not step or spread > MOST_OFF * abs(step) or (np.abs(off) > (MOST_OFF + DRIFT * n) * abs(step)).any():
        return None
    every = np.arange(at[0], at[-1] + 1)
    angle = angle[0] + np.concatenate([[0.0], np.cumsum(n * step + off)])
    return np.interp(every, at, angle), slice(int(at[0]), int(at[-1]) + 1)


def part_of_turn(angles: Floats) -> Floats:
    """Return angles [rad] without whole turns: -pi to pi."""
    return np.asarray(angles - 2.0 * math.pi * np.round(angles / (2.0 * math.pi)))


def step_of(angles: Floats) -> float:
    """Return the median step [rad] from one angle (n,) to the next."""
    return float(np.median(np.abs(np.diff(angles))))


def place_among(angles: Floats, asked: Floats, reach: float) -> tuple[Ints, Bools]:
    """Return which of the even angles (m,), rising or falling, is next to each that is asked (n,), and which of these
    lie among them, or no more than `reach` [rad] outside."""
    way = 1.0 if angles[-1] > angles[0] else -1.0
    place = np.interp(way * asked, way * angles, np.arange(len(angles)))
    is_in = (way * asked > way * angles[0] - reach) & (way * asked < way * angles[-1] + reach)
    return np.rint(place).astype(np.int64), is_in
