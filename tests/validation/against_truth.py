"""A comparison of two epochs judged by what truly changed: what was found, how deep, and what was called changed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rows import Row, in_percent, in_words, judge

from monitor.simulation import Scene, TrueChange
from projects.model import Assessment, Bools, Comparison, Floats

MARGIN = 0.010  # m about a change's box
UNCHANGED = 2e-5  # m: below this the surface did not change


def true_change(points: Floats, before: Scene, after: Scene) -> Floats:
    """Return the true change (n,) [m] at points near the surface before, positive where material was gained."""
    assert before.truth is not None
    assert after.truth is not None
    return before.truth.signed_distance(points) - after.truth.signed_distance(points)


def rows_of_changes(
    comparison: Comparison, changes: Sequence[TrueChange], scenes: tuple[Scene, Scene], footprint: float
) -> list[Row]:
    """Return a row for each implanted change, and what was called changed elsewhere."""
    side = comparison.on_reference
    vertices = side.surface.vertices
    true = true_change(vertices, *scenes)
    rows = [_row_of_change(comparison, change, true, footprint) for change in changes]
    elsewhere = np.ones(len(vertices), bool)
    for change in changes:
        elsewhere &= ~_inside(vertices, change.box)
    elsewhere &= np.abs(true) < UNCHANGED
    known = side.assessment != Assessment.NOT_ASSESSABLE
    called = float(np.mean(side.assessment[elsewhere & known] == Assessment.CHANGED))
    centres = comparison.regions[["x", "y", "z"]].to_numpy()
    near = np.zeros(len(centres), bool)
    for change in changes:
        near |= _inside(centres, change.box)
    return [
        *rows,
        Row("unchanged, assessed surface called changed", in_percent(called, 2), judge(called <= 0.01), "", "1 %",
            value=called),
        Row("regions where nothing changed", str(int((~near).sum())), judge(bool(near.all())), "", "none"),
        Row("unchanged surface assessed", in_percent(float(known[elsewhere].mean()), 1)),
        Row("median lod95, mm", in_words(1e3 * float(np.nanmedian(side.lod95)), 2)),
    ]  # fmt: skip


def _row_of_change(comparison: Comparison, change: TrueChange, true: Floats, footprint: float) -> Row:
    """Found: a region of its sign about it; depth: the 95 % quantile of the distance over what truly changed."""
    side = comparison.on_reference
    own = _inside(side.surface.vertices, change.box) & (np.abs(true) > change.threshold)
    known = own & (side.assessment != Assessment.NOT_ASSESSABLE)
    centres = comparison.regions[["x", "y", "z"]].to_numpy()
    found = bool(
        (_inside(centres, change.box) & (np.sign(comparison.regions["mean_m"]) == np.sign(change.extreme))).any()
    )
    width = 2.0 * float(np.sqrt(change.area / np.pi))
    what = f"{change.name}, {1e3 * width:.0f} mm wide, {in_words(1e3 * change.extreme, 1, signed=True)} mm"
    is_large = width > 3.0 * footprint
    if np.count_nonzero(known) < 10:
        verdict = judge(found) if is_large else "stated"
        return Row(what, "not assessable" if not found else "found", verdict, "", "found" if is_large else "")
    sign = np.sign(change.extreme)
    depth = sign * 1e3 * float(np.quantile(np.abs(side.distances[known]), 0.95))
    truth = sign * 1e3 * float(np.quantile(np.abs(true[known]), 0.95))
    text = f"{'found' if found else 'missed'}, depth {in_words(depth, 2, signed=True)} mm"
    return Row(
        what, text, judge(found and abs(depth - truth) <= 0.3) if is_large else "stated", "",
        "found, depth within 0.3 mm" if is_large else "", {"true depth": f"{in_words(truth, 2, signed=True)} mm"},
        depth - truth,
    )  # fmt: skip


def _inside(points: Floats, box: Floats) -> Bools:
    return ((points > box[0] - MARGIN) & (points < box[1] + MARGIN)).all(axis=1)
