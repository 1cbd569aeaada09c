"""Coordinates that a file holds rounded: the step of their rounding, and what to do about it.

In: points (n, 3) m in the frame in which they were rounded. Out: the step; points spread over what each stands for; the
error that averaging does not remove. On a face along the axes most points of one place have the very same coordinate:
they would show no noise at all, and those one step away would pass for outliers.
"""

from __future__ import annotations

import numpy as np

from projects.model import Bools, Floats, Ints

FINEST = 1e-5  # m: finer steps are lost in the noise of any scanner
AXES = np.array([1, 2_097_169, 4_398_117_519_377], dtype=np.int64)  # what a cell's number grows by along each axis
BLOCK = 1 << 18  # points at a time
N_TOLD = 20_000  # points that tell the step
WHOLE = 0.01  # of a step, by which a multiple of it may be off
MOST_DIVISIONS = 40  # of Euclid's algorithm
AS_A_GRID = 0.9  # of the points have a neighbour at just one step: a model's grid, or voxels, and no rounding
LEAST_LEVELS = 3  # along an axis that tells the step


def find_step(points: Floats) -> float:
    """Return the step [m] of which all coordinates are multiples; 0 where there is none, or one below `FINEST`.

    Points of which no two are at one place and nearly all have a neighbour at just one step lie on a grid of their own.
    """
    some = points[:: max(len(points) // N_TOLD, 1)]
    levels = [np.unique(some[:, axis]) for axis in range(3)]
    told = [np.diff(level) for level in levels if len(level) >= LEAST_LEVELS]
    if len(told) < 2 or not all(_has_step(level) for level in levels):
        return 0.0
    step = _common_measure(np.unique(np.concatenate(told)))
    step = float(f"{step:.9g}")  # whichever points told it
    return 0.0 if step == 0.0 or _is_grid(points, step) else step


def _has_step(levels: Floats) -> bool:
    """Return whether the levels of an axis are multiples of a step, or too few to tell."""
    return len(levels) < LEAST_LEVELS or _common_measure(np.unique(np.diff(levels))) > 0.0


def _common_measure(gaps: Floats) -> float:
    """Return the largest length [m] of which gaps (k,), ascending and above 0, are multiples; 0 below `FINEST`."""
    step = float(gaps[0])
    for _ in range(MOST_DIVISIONS):
        if step < FINEST:
            return 0.0
        left = np.abs(gaps - np.rint(gaps / step) * step)
        over = left[left > WHOLE * step]
        if not len(over):
            return float(gaps.sum() / np.rint(gaps / step).sum())
        step = float(over.min())
    return 0.0


def _is_grid(points: Floats, step: float) -> bool:
    """Return whether the points are those of a grid whose spacing is the step, wherever that begins: counted from 0,
    two that lie on halves of the step may get one number."""
    codes = cell_codes(points - points[0], step)
    if len(np.unique(codes)) < len(codes):
        return False
    some = codes[:: max(len(codes) // N_TOLD, 1)]
    beside = np.zeros(len(some), dtype=np.bool_)
    for way in np.vstack([np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)]):
        beside |= np.isin(some + way @ AXES, codes)
    return bool(beside.mean() > AS_A_GRID)


def cell_codes(points: Floats, step: float) -> Ints:
    """Return one number for the cell of edge `step` [m] of each point (n, 3), of which `AXES` lead to the next.

    Coordinates are whole steps, or whole and a half where a file counts from there: neither lies on a cell's border.
    """
    return np.asarray(np.floor(points / step + 0.25).astype(np.int64) @ AXES)


def find_repeats(points: Floats) -> Bools:
    """Return which points (n, 3) in canonical order are at exactly the place of the one before."""
    again = np.zeros(len(points), dtype=np.bool_)
    for first in range(1, len(points), BLOCK):
        block = slice(first, first + BLOCK)
        again[block] = (points[block] == points[first - 1 : first - 1 + len(again[block])]).all(axis=1)
    return again


def spread_rounded(points: Floats, step: float) -> Floats:
    """Return points (n, 3) in canonical order spread evenly over the cubes of edge `step` [m] that they stand for.

    The places follow from the coordinates, and of points at one place from their order, so that the same points are
    always spread alike.
    """
    place = np.arange(len(points))
    nth = place - np.maximum.accumulate(np.where(find_repeats(points), 0, place))
    codes = cell_codes(points, step).astype(np.uint64)
    with np.errstate(over="ignore"):
        state = codes + nth.astype(np.uint64) * np.uint64(0xD1B54A32D192ED03)
        draws = np.stack([_to_unit(state + np.uint64(k) * np.uint64(0x9E3779B97F4A7C15)) for k in (1, 2, 3)], axis=1)
    return points + step * (draws - 0.5)


def _to_unit(state: Ints) -> Floats:
    """Return numbers (n,) of 0 to 1 from 64 bits each (SplitMix64: Steele, Lea and Flood 2014)."""
    with np.errstate(over="ignore"):
        state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(((state ^ (state >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53)


def error_of_rounding(normals: Floats, noise: Floats | float, radius: Floats | float, step: float) -> Floats:
    """Return one sigma (n,) [m] of what rounding leaves in the mean over a disc, however many points it holds.

    Parameters
    ----------
    normals : (n, 3) unit vectors in the frame in which coordinates were rounded.
    noise : (n,) or one, m, of a point whose coordinates were spread over the step (`spread_rounded`).
    radius : (n,) or one, m, of the disc over which a place is averaged.
    step : m.

    Notes
    -----
    Along an axis with the component c of the normal, coordinates vary by s^2 = (c noise)^2 + (1 - c^2) radius^2 / 4.
    The mean error of rounding is a wave over the true place whose first harmonic falls by exp(-2 pi^2 s^2 / step^2)
    (Widrow and Kollár 2008, Quantization Noise, section 4); it begins at that of a single point, step / sqrt(12).
    """
    share2 = np.asarray(normals) ** 2
    own2 = np.maximum(np.asarray(noise) ** 2 - step**2 / 6.0, 0.0)  # without rounding, and without spreading
    spread2 = share2 * own2[..., None] + (1.0 - share2) * np.asarray(radius)[..., None] ** 2 / 4.0
    of_axes = share2 * step**2 / 12.0 * np.exp(-4.0 * np.pi**2 * spread2 / step**2)
    return np.asarray(np.sqrt(of_axes.sum(axis=1)))
