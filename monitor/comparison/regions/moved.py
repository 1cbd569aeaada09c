"""Parts that moved: what was lost on one side and gained on the other, explained by one rigid motion.

In: the regions of a comparison. Out: which of them are two sides of a part that moved. A part of which only one side
was seen cannot be told from material lost or added, and stays so.

This asks the regions alone, in every comparison, and so names also small or plain parts whose shape holds no six
parameters; it measures nothing. Parts that can be laid back onto the reference are found with their six parameters and
covariance by `registration.parts`, and `moved_parts` then calls their regions moved too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from monitor.comparison.distances.side import Side
from monitor.comparison.regions.shapes import principal_axes
from projects.model import Bools, Floats, Ints

EXPLAINED = 0.9  # of the squared change of each of both regions, and of all together, by one rigid motion
FEWEST_VERTICES = 12  # twice the parameters


class Sample(NamedTuple):
    """Vertices of both sides: points (n, 3) [m], normals (n, 3) and changes (n,) [m]."""

    points: Floats
    normals: Floats
    change: Floats


def name_moved(table: pd.DataFrame, sides: tuple[Side, Side], regions: tuple[Ints, Ints]) -> list[str]:
    """Return the kind of each region (r,) in the table's order, "moved" where a loss and a gain make one motion.

    Only a loss and a gain that lie no farther apart than they are long can be sides of one part.
    """
    kinds = [str(kind) for kind in table["kind"]]
    samples = [_sample(sides, (regions[0] == number, regions[1] == number)) for number in table["region"]]
    trees = [cKDTree(sample.points) if len(sample.points) else None for sample in samples]
    means = [float(np.sum(sample.change)) for sample in samples]
    for i, j in _close_pairs(table, samples):
        is_pair = means[i] * means[j] < 0.0 and trees[i] is not None and trees[j] is not None
        if is_pair and is_explained((samples[i], samples[j]), _between(samples[i], samples[j], sides, regions)):
            kinds[i] = kinds[j] = "moved"
    return kinds


def _close_pairs(table: pd.DataFrame, samples: list[Sample]) -> list[tuple[int, int]]:
    """Return the pairs of regions whose centres lie no farther apart than both are long together."""
    length = np.array([float(np.linalg.norm(np.ptp(s.points, axis=0))) if len(s.points) else 0.0
                       for s in samples])  # fmt: skip
    centres = table[["x", "y", "z"]].to_numpy(dtype=float)
    if len(centres) < 2 or not np.isfinite(centres).all():
        return []
    pairs = cKDTree(centres).query_pairs(2.0 * float(length.max()), output_type="ndarray")
    apart = np.linalg.norm(centres[pairs[:, 0]] - centres[pairs[:, 1]], axis=1)
    return [(int(i), int(j)) for i, j in pairs[apart <= length[pairs[:, 0]] + length[pairs[:, 1]]]]


def _sample(sides: tuple[Side, Side], which: tuple[Bools, Bools]) -> Sample:
    """Return the assessed vertices among those in `which` (n,) of both sides."""
    masks = [mask & side.is_assessed for mask, side in zip(which, sides, strict=True)]
    return Sample(
        np.vstack([s.surface.vertices[m] for s, m in zip(sides, masks, strict=True)]),
        np.vstack([s.normals[m] for s, m in zip(sides, masks, strict=True)]),
        np.concatenate([s.distances[m] for s, m in zip(sides, masks, strict=True)]),
    )


def _between(first: Sample, second: Sample, sides: tuple[Side, Side], regions: tuple[Ints, Ints]) -> Sample:
    """Return what did not change in the box around two regions, laid along their principal directions."""
    points = np.vstack([first.points, second.points])
    axes, _ = principal_axes(points, np.ones(len(points)))
    low, high = (points @ axes.T).min(axis=0), (points @ axes.T).max(axis=0)

    def inside(side: Side, region: Ints) -> Bools:
        """Return which vertices (n,) outside of regions lie within the box along the axes."""
        along = side.surface.vertices @ axes.T
        return np.asarray((region == 0) & (along >= low).all(axis=1) & (along <= high).all(axis=1))

    return _sample(sides, (inside(sides[0], regions[0]), inside(sides[1], regions[1])))


def is_explained(parts: tuple[Sample, Sample], between: Sample) -> bool:
    """Whether one rigid motion explains nearly all of the change of both parts, n' (t + w x (x - c)) by least squares
    over them and what lies between.

    Each of both by itself: beside a deep loss all is explained that leaves the loss. And what did not change `between`
    them must not have to: any two layers can be laid on one motion, but a part moves with what lies within it. There
    counts by how much the motion leaves more than no motion does. It is fitted there too: the two sides of a part that
    slid hardly tell how little it turned.
    """
    points, _, change = (np.concatenate(both) for both in zip(*parts, strict=True))
    if len(change) < FEWEST_VERTICES:
        return False
    centre = points.mean(axis=0)
    scale = max(float(np.sqrt(np.mean((points - centre) ** 2))), 1e-300)

    def rows(sample: Sample) -> Floats:
        """Return how the distances (n,) change with a small motion: rows (n, 6) of turn, scaled, and shift."""
        return np.hstack([np.cross((sample.points - centre) / scale, sample.normals), sample.normals])

    every = np.vstack([rows(sample) for sample in (*parts, between)])
    motion, *_ = np.linalg.lstsq(every, np.append(change, between.change), rcond=1e-6)
    left = [float(np.sum((part.change - rows(part) @ motion) ** 2)) for part in parts]
    whole = [float(part.change @ part.change) for part in parts]
    told = rows(between) @ motion
    beside = max(float(told @ (told - 2.0 * between.change)), 0.0)
    each = all(rest <= (1.0 - EXPLAINED) * size for rest, size in zip(left, whole, strict=True))
    return each and sum(left) + beside <= (1.0 - EXPLAINED) * sum(whole)
