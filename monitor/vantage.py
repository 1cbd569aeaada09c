"""Could points have been measured from a place? Asked where it is said by default and by nobody.

In: points and a place in one frame. Out: yes or no. From where a scanner stood each direction meets one surface, not
nearer nor farther than instruments measure; a cloud that was merged from several stations shows front and back at once.
"""

from __future__ import annotations

import numpy as np

from projects.formats import ScanStream
from projects.model import Floats, Ints

NEAREST, FARTHEST = 0.2, 10_000.0  # m, that terrestrial instruments measure
IN_A_CELL = 8.0  # points, in the mean, of a cell of directions
MOST_CELLS = 4096  # along an edge of the cube of directions
BEHIND = 5.0  # widths of a cell between two sheets: more than what slant leaves, up to 79 degrees
MOST_DOUBLE = 0.25  # of the points, in cells that show two sheets: silhouettes have some
SAMPLE = 200_000  # points that tell it


def could_be_measured_from(points: Floats, place: Floats) -> bool:
    """Return whether points (n, 3) [m] could be one scan of an instrument at a place (3,) [m] of their frame."""
    beams = (points - place)[:: max(len(points) // SAMPLE, 1)]
    ranges = np.linalg.norm(beams, axis=1)
    if not len(ranges) or ranges.min() < NEAREST or ranges.max() > FARTHEST:
        return False
    cells, width = cells_of(beams)
    return share_of_double(cells, ranges, width) <= MOST_DOUBLE


def some_points(stream: ScanStream) -> Floats:
    """Return points (n, 3) [m] of all of a scan, `SAMPLE` to twice as many where there are so many, evenly taken."""
    every, kept = 1, np.empty((0, 3))
    for chunk in stream.chunks():
        kept = np.concatenate([kept, chunk.cloud.points[::every]])
        while len(kept) > 2 * SAMPLE:
            every, kept = 2 * every, kept[::2]
    return kept


def cells_of(beams: Floats) -> tuple[Ints, float]:
    """Return the cell of directions (n,) of each beam (n, 3), on the faces of a cube, and a cell's width [rad].

    The cells are as wide as leaves `IN_A_CELL` points in those that hold any.
    """
    axis = np.abs(beams).argmax(axis=1)
    longest = np.take_along_axis(beams, axis[:, None], axis=1)[:, 0]
    others = np.array([[1, 2], [2, 0], [0, 1]])[axis]
    across = np.take_along_axis(beams, others, axis=1) / np.abs(longest)[:, None]  # -1 to 1
    face = 2 * axis + (longest > 0.0)
    edge = MOST_CELLS
    while True:
        place = np.minimum(((across + 1.0) * (0.5 * edge)).astype(np.int64), edge - 1)
        cells = (face * edge + place[:, 0]) * edge + place[:, 1]
        if len(beams) >= IN_A_CELL * len(np.unique(cells)) or edge == 1:
            return cells, 2.0 / edge
        edge //= 2


def share_of_double(cells: Ints, ranges: Floats, width: float) -> float:
    """Return the share of points in cells whose ranges fall into two groups, one `BEHIND` widths behind the other."""
    order = np.lexsort((ranges, cells))
    cells, ranges = cells[order], ranges[order]
    gap = np.where(cells[1:] == cells[:-1], np.diff(ranges), 0.0)
    is_double = np.isin(cells, cells[1:][gap > BEHIND * width * ranges[1:]])
    return float(is_double.mean())
