"""Where the beams of a scan went that met nothing: a grid of rows and columns has a place for each of them.

In: the rows, columns and beams of what a scan measured. Out: at which angles its rows and columns lie, and near which
directions beams went and brought nothing back. What stood there is gone, or does not reflect, or was cut out of the
file. Only between the first and the last row and column that brought anything back is it known that beams went.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from projects.model import Bools, Floats, Ints

STEEPEST = 1.2  # rad: beams higher or lower tell the turn of their columns badly
MOST_OFF = 0.5  # steps: beams that lie farther off the angles of their rows and columns make no grid
DRIFT = 0.01  # of a step, by which steps without any beam may differ in the mean from others
FEWEST = 8  # rows and columns


@dataclass(frozen=True)
class BeamGrid:
    """The turns [rad] of the columns (c,) of a scan, rising or falling, the heights [rad] of its rows (r,), which beams
    (r, c) met something, and the rotation (3, 3) that puts the frame of the scan into that of the epoch."""

    turns: Floats
    heights: Floats
    has_met: Bools
    rotation: Floats

    def empty_near(self, directions: Floats, reach: float) -> Floats:
        """Return the unit vectors (k, 3) of all beams within `reach` [rad] of directions (n, 3) that met nothing, and
        some around, in the epoch's frame."""
        turn, height = angles_of(directions @ self.rotation)
        turn += 2.0 * math.pi * np.round((self.turns.mean() - turn) / (2.0 * math.pi))
        asked = np.zeros(self.has_met.shape, dtype=np.bool_)
        for shift in (-2.0 * math.pi, 0.0, 2.0 * math.pi):  # a scan all around has each direction but once
            row, row_is_in = place_among(self.heights, height, reach)
            column, column_is_in = place_among(self.turns, turn + shift, reach)
            at = row_is_in & column_is_in & (np.abs(height) < STEEPEST)
            asked[row[at], column[at]] = True
        if not asked.any():
            return np.zeros((0, 3))
        slant = math.cos(float(np.abs(height[np.abs(height) < STEEPEST]).max()))
        wide = [2 * math.ceil(reach / step) + 1 for step in (step_of(self.heights), slant * step_of(self.turns))]
        row, column = np.nonzero(maximum_filter(asked, size=wide, mode="constant") & ~self.has_met)
        return directions_of(self.turns[column], self.heights[row]) @ self.rotation.T


class GridBuilder:
    """Gathers from the chunks of a scan at which angle each of its rows and columns lies, and which beams met
    something."""

    def __init__(self) -> None:
        self.has_met = np.zeros((0, 0), dtype=np.bool_)
        self.sums: dict[str, Floats] = {}

    def add(self, rows: Ints, columns: Ints, beams: Floats) -> None:
        """Count beams (n, 3) [m], in the scan's frame, of these rows and columns (n,)."""
        if not len(rows) or min(rows.min(), columns.min()) < 0:
            return
        turn, height = angles_of(beams)
        is_low = np.abs(height) < STEEPEST
        self._make_room(int(rows.max()) + 1, int(columns.max()) + 1)
        self.has_met[rows, columns] = True
        for index, name in ((rows, "row"), (columns, "column")):
            self._sum(f"height of {name}", index, height)
            self._sum(f"turn of {name}", index[is_low], turn[is_low])

    def _make_room(self, n_rows: int, n_columns: int) -> None:
        """Make the grid as large as asked, or by half larger than it is."""
        old = self.has_met.shape
        if n_rows <= old[0] and n_columns <= old[1]:
            return
        shape = [n if n <= have else max(n, have + have // 2) for n, have in zip((n_rows, n_columns), old, strict=True)]
        larger = np.zeros([max(s, have) for s, have in zip(shape, old, strict=True)], dtype=np.bool_)
        larger[: old[0], : old[1]] = self.has_met
        self.has_met = larger

    def _sum(self, name: str, index: Ints, angle: Floats) -> None:
        """Add the unit vectors of angles (n,) to those of their rows or columns, and count them."""
        if not len(index):
            return
        more = np.stack([np.bincount(index, w) for w in (np.cos(angle), np.sin(angle), np.ones(len(angle)))])
        known = self.sums.get(name, np.zeros((3, 0)))
        both = np.zeros((3, max(more.shape[1], known.shape[1])))
        both[:, : known.shape[1]] = known
        both[:, : more.shape[1]] += more
        self.sums[name] = both

    def finish(self, rotation: Floats) -> BeamGrid | None:
        """Return the grid, turned into the epoch's frame; None where rows and columns are not of one height and one
        turn each, in either order."""
        for upright, across, has_met in (("row", "column", self.has_met), ("column", "row", self.has_met.T)):
            heights = even_angles(self.sums.get(f"height of {upright}"))
            turns = even_angles(self.sums.get(f"turn of {across}"))
            if heights is not None and turns is not None:
                return BeamGrid(turns[0], heights[0], np.ascontiguousarray(has_met[heights[1], turns[1]]), rotation)
        return None


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
    if spread > MOST_OFF * abs(step) or (np.abs(off) > (MOST_OFF + DRIFT * n) * abs(step)).any():
        return None
    every = np.arange(at[0], at[-1] + 1)
    angle = angle[0] + np.concatenate([[0.0], np.cumsum(n * step + off)])
    return np.interp(every, at, angle), slice(int(at[0]), int(at[-1]) + 1)


def part_of_turn(angles: Floats) -> Floats:
    """Return angles [rad] without whole turns: -pi to pi."""
    return np.asarray(angles - 2.0 * math.pi * np.round(angles / (2.0 * math.pi)))


def angles_of(beams: Floats) -> tuple[Floats, Floats]:
    """Return the turn and the height (n,) [rad] of beams (n, 3) about the vertical of their frame."""
    return np.arctan2(beams[:, 1], beams[:, 0]), np.arctan2(beams[:, 2], np.hypot(beams[:, 0], beams[:, 1]))


def directions_of(turn: Floats, height: Floats) -> Floats:
    """Return the unit vectors (n, 3) of turns and heights (n,) [rad]."""
    flat = np.cos(height)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), np.sin(height)])


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
