"""Ranges that repeated scans measured in directions beside each other, brought to the one direction of their cell.

In: where each scan measured in each cell, and the directions of the cells; out: the ranges there. Along a surface aside
to the beam a direction half a step off is another range: that is no drift of the instrument, for directions are known.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial import cKDTree

from monitor.across import frames_across
from monitor.blocks import blocks
from projects.model import Floats, Ints

N_AROUND = 25  # cells whose ranges tell the slope: five by five of a grid
FEWEST_AROUND = 9
BLOCK = 32_768  # cells at a time
TOO_ROUGH = 3.0  # times what most cells lie off the plane around them: over a jump there is no slope
MOST = 0.2  # of a range, by which a slope moves it at most
ALIKE, ASIDE = 0.002, 0.05  # spacings: scans whose directions differ by less, in the mean and each, have the same ones


def bring_to_cells(ranges: Floats, beams: Sequence[Floats], cell_of: Sequence[Ints], directions: Floats) -> Floats:
    """Return ranges (k, m) [m] of k scans in the directions (m, 3) of their cells, by the slope of what is around.

    On a plane the inverse of the range is linear in the direction. Its slope is fitted to the cells around; where these
    lie on no plane, a range stays as it is, and so do all where scans measured in the same directions.

    Parameters
    ----------
    beams : of each scan (n, 3) m, from the scanner. cell_of : of each scan (n,), -1 for points of no cell.
    """
    aside = [_aside(beam, cell, directions) for beam, cell in zip(beams, cell_of, strict=True)]
    if not directions.size or not _differ(aside, directions):
        return ranges
    slopes = _slopes(*_of_most(ranges, beams, cell_of))
    moved = ranges.copy()
    for k, (off, cell) in enumerate(zip(aside, cell_of, strict=True)):
        found = cell[cell >= 0]
        by = ranges[k, found] * (slopes[found] * off).sum(axis=1)
        moved[k, found] = ranges[k, found] / (1.0 - np.where(np.abs(by) <= MOST, by, 0.0))
    return moved


def _aside(beam: Floats, cell: Ints, directions: Floats) -> Floats:
    """Return how far (n, 3) the directions of the points of a cell lie from the direction of that."""
    found = np.flatnonzero(cell >= 0)
    length = np.linalg.norm(beam[found], axis=1, keepdims=True)
    return beam[found] / length - directions[cell[found]]


def _differ(aside: Sequence[Floats], directions: Floats) -> bool:
    """Return whether scans measured in other directions than those of the cells (m, 3)."""
    known = [off for off in aside if len(off)]
    if len(directions) < FEWEST_AROUND or not any(off.any() for off in known):
        return False
    apart = cKDTree(directions).query(directions[:: max(len(directions) // BLOCK, 1)], 2)[0][:, 1]
    spacing = float(np.median(apart))
    off_each = max(float(np.linalg.norm(off, axis=1).mean()) for off in known)
    off_mean = max(float(np.linalg.norm(off.mean(axis=0))) for off in known)
    return off_each > ASIDE * spacing or off_mean > ALIKE * spacing


def _of_most(ranges: Floats, beams: Sequence[Floats], cell_of: Sequence[Ints]) -> tuple[Floats, Floats]:
    """Return direction (m, 3) and range (m,) of each cell as that scan measured them which has most points there is."""
    told, length = np.zeros((ranges.shape[1], 3)), np.full(ranges.shape[1], np.nan)
    for k in sorted(range(len(beams)), key=lambda k: int((cell_of[k] >= 0).sum())):  # the largest comes last
        found = np.flatnonzero(cell_of[k] >= 0)
        at = cell_of[k][found]
        length[at] = ranges[k, at]
        told[at] = beams[k][found] / ranges[k, at, None]
    return told, length


def _slopes(directions: Floats, ranges: Floats) -> Floats:
    """Return the slope (m, 3) [1/m] of the inverse range over the direction, across it; 0 where there is none."""
    slopes, left = np.zeros(directions.shape), np.full(len(directions), np.inf)
    for block, near in _around(directions):
        off = directions[near] - directions[block][:, None]
        axes = frames_across(directions[block])
        across = np.stack([np.einsum("nki,ni->nk", off, axis) for axis in axes], axis=2)
        across -= across.mean(axis=1, keepdims=True)
        inverse = 1.0 / ranges[near]
        inverse -= inverse.mean(axis=1, keepdims=True)
        normal = np.einsum("nki,nkj->nij", across, across)
        spread = np.linalg.eigvalsh(normal)
        is_flat = spread[:, 0] > 1e-3 * spread[:, 1]
        turned = np.linalg.inv(np.where(is_flat[:, None, None], normal, np.eye(2)))
        found = np.einsum("nij,nkj,nk->ni", turned, across, inverse)
        off_plane2 = (inverse - np.einsum("nki,ni->nk", across, found)) ** 2
        slopes[block] = found[:, :1] * axes[0] + found[:, 1:] * axes[1]
        left[block] = np.where(is_flat, np.sqrt(off_plane2.mean(axis=1)) * ranges[block] ** 2, np.inf)
    is_smooth = left <= TOO_ROUGH * np.median(left)
    return np.where(is_smooth[:, None] & np.isfinite(left)[:, None], slopes, 0.0)


def _around(directions: Floats) -> Iterator[tuple[slice, Ints]]:
    """Yield runs of the directions (m, 3) with the nearest of each, itself among them."""
    tree = cKDTree(directions)
    for block in blocks(len(directions), BLOCK):
        yield block, tree.query(directions[block], min(N_AROUND, len(directions)))[1]
