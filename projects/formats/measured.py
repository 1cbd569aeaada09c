"""Keeps measurements and counts what is not one: not finite, flagged invalid, classified as noise, no return.

Runs in the child process between a reader and the pipe. In a scanner's own frame a point at exactly 0 0 0 has no
range. In other frames (LAS, PLY, XYZ ... in project coordinates) one point may well lie there, and is kept; several
at exactly the same place are the mark of a program that wrote its no-returns, and all are dropped and counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

import numpy as np

from projects.errors import FormatError
from projects.formats.rawscan import CHUNK, Columns

FARTHEST = 1e12  # file units; nothing on Earth is farther, in any unit
Block = tuple[Columns, dict[str, int]]


def keep_measurements(blocks: Iterable[Columns], is_centred: bool) -> Iterator[Block]:
    """Yield columns of at most `CHUNK` measured points with the counts of what was dropped since the last.

    Parameters
    ----------
    blocks : columns of a scan in order: `points` (n, 3), optionally `invalid` and `noise` (n,) bool, what the file
        itself says is none, and `surplus` (n,) bool for what stands in it after the number of points that it promises.
    is_centred : the scanner stands at 0 0 0 of the frame.

    Raises
    ------
    FormatError
        The scan holds no points, none that is a measurement, or all at one place.
    """
    dropped: Counter[str] = Counter()
    total: Counter[str] = Counter()
    n_kept = 0
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    held: Columns | None = None  # so that what is dropped after the last point is counted with it
    for columns in _fill_up(_sifted(blocks, is_centred, dropped)):
        if held is not None:
            yield held, _take(dropped, total)
        held = columns
        n_kept += len(columns["points"])
        low, high = np.minimum(low, columns["points"].min(axis=0)), np.maximum(high, columns["points"].max(axis=0))
    counts = _take(dropped, total)
    _require_points(n_kept, total, bool((low == high).all()))
    if held is not None:
        yield held, counts


def _take(dropped: Counter[str], total: Counter[str]) -> dict[str, int]:
    """Return the counts so far, add them to the total and begin anew."""
    counts = dict(dropped)
    total.update(counts)
    dropped.clear()
    return counts


def _sifted(blocks: Iterable[Columns], is_centred: bool, dropped: Counter[str]) -> Iterator[Columns]:
    """Yield the measured points of each block, counting the others; a lone point at 0 0 0 comes last."""
    lone: Columns | None = None
    n_zero = 0
    for columns in blocks:
        points = columns["points"]
        x, y, z = points.T
        finite = (np.abs(x) <= FARTHEST) & (np.abs(y) <= FARTHEST) & (np.abs(z) <= FARTHEST)
        none = np.zeros(len(points), bool)
        surplus = columns.pop("surplus", none)
        flagged, noise = columns.pop("invalid", none), columns.pop("noise", none)
        valid = finite & ~flagged & ~noise & ~surplus
        zero = valid & (x == 0.0) & (y == 0.0) & (z == 0.0)
        reasons = {
            "not finite": ~finite & ~surplus,
            "flagged invalid": finite & flagged & ~surplus,
            "classified as noise": finite & noise & ~flagged & ~surplus,
            "no return": zero & is_centred,
            "after the number promised": surplus,
        }
        dropped.update({reason: int(mask.sum()) for reason, mask in reasons.items() if mask.any()})
        if not is_centred and zero.any():
            n_zero += int(zero.sum())
            lone = lone or {name: values[np.flatnonzero(zero)[:1]] for name, values in columns.items()}
        keep = valid & ~zero
        if keep.any():
            yield columns if keep.all() else {name: values[keep] for name, values in columns.items()}
    if n_zero == 1 and lone is not None:
        yield lone
    elif n_zero:
        dropped["at exactly 0 0 0"] += n_zero


def _fill_up(blocks: Iterable[Columns]) -> Iterator[Columns]:
    """Yield the same points in blocks that are as large as `CHUNK` allows."""
    waiting: list[Columns] = []
    n = 0
    for columns in blocks:
        while n + len(columns["points"]) >= CHUNK:
            room = CHUNK - n
            waiting.append({name: values[:room] for name, values in columns.items()})
            yield _joined(waiting)
            columns = {name: values[room:] for name, values in columns.items()}
            waiting, n = [], 0
        if len(columns["points"]):
            waiting.append(columns)
            n += len(columns["points"])
    if waiting:
        yield _joined(waiting)


def _joined(blocks: list[Columns]) -> Columns:
    """Return the blocks as one."""
    if len(blocks) == 1:
        return blocks[0]
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


def _require_points(n_kept: int, total: Counter[str], at_one_place: bool) -> None:
    """Raise where a scan came out empty or collapsed."""
    if not n_kept and not total:
        raise FormatError("holds no points")
    if not n_kept:
        reasons = ", ".join(f"{reason}: {n}" for reason, n in total.items())
        raise FormatError(f"none of its {sum(total.values())} points is a measurement ({reasons})")
    if n_kept > 1 and at_one_place:
        raise FormatError(f"all its {n_kept} points lie at one place; the file is broken")
