"""Parts that moved: what was lost on one side and gained on the other, explained by one rigid motion.

In: the regions of a comparison. Out: which of them are two sides of a part that moved. A part of which only one side
was seen cannot be told from material lost or added, and stays so.

This asks the regions alone, in every comparison, and so names also small or plain parts whose shape holds no six
parameters; it measures nothing. Parts that can be laid back onto the reference are found with their six parameters and
covariance by `registration.parts`, and `moved_parts` then calls their regions moved too.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from monitor.comparison.side import Side
from projects.model import Floats, Ints

EXPLAINED = 0.9  # of the squared change of both regions, by one rigid motion
FEWEST_VERTICES = 12  # twice the parameters


def name_moved(table: pd.DataFrame, sides: tuple[Side, Side], regions: tuple[Ints, Ints]) -> list[str]:
    """Return the kind of each region (r,) in the table's order, "moved" where a loss and a gain make one motion.

    Only a loss and a gain that lie no farther apart than they are long can be sides of one part.
    """
    kinds = [str(kind) for kind in table["kind"]]
    samples = [_sample(int(number), sides, regions) for number in table["region"]]
    trees = [cKDTree(points) if len(points) else None for points, _, _ in samples]
    means = [float(np.sum(change)) for _, _, change in samples]
    for i, j in _close_pairs(table, samples):
        is_pair = means[i] * means[j] < 0.0 and trees[i] is not None and trees[j] is not None
        if is_pair and is_explained(*(np.concatenate(both) for both in zip(samples[i], samples[j], strict=True))):
            kinds[i] = kinds[j] = "moved"
    return kinds


def _close_pairs(table: pd.DataFrame, samples: list[tuple[Floats, Floats, Floats]]) -> list[tuple[int, int]]:
    """Return the pairs of regions whose centres lie no farther apart than both are long together."""
    length = np.array([float(np.linalg.norm(np.ptp(p, axis=0))) if len(p) else 0.0 for p, _, _ in samples])
    centres = table[["x", "y", "z"]].to_numpy(dtype=float)
    if len(centres) < 2 or not np.isfinite(centres).all():
        return []
    pairs = cKDTree(centres).query_pairs(2.0 * float(length.max()), output_type="ndarray")
    apart = np.linalg.norm(centres[pairs[:, 0]] - centres[pairs[:, 1]], axis=1)
    return [(int(i), int(j)) for i, j in pairs[apart <= length[pairs[:, 0]] + length[pairs[:, 1]]]]


def _sample(number: int, sides: tuple[Side, Side], regions: tuple[Ints, Ints]) -> tuple[Floats, Floats, Floats]:
    """Return points (n, 3), normals (n, 3) and changes (n,) [m] of a region's assessed vertices on both sides."""
    masks = [(r == number) & s.is_assessed for s, r in zip(sides, regions, strict=True)]
    points = np.vstack([s.surface.vertices[m] for s, m in zip(sides, masks, strict=True)])
    normals = np.vstack([s.normals[m] for s, m in zip(sides, masks, strict=True)])
    return points, normals, np.concatenate([s.distances[m] for s, m in zip(sides, masks, strict=True)])


def is_explained(points: Floats, normals: Floats, change: Floats) -> bool:
    """Whether one rigid motion explains nearly all of the change (n,) [m]: n' (t + w x (x - c)), by least squares."""
    if len(change) < FEWEST_VERTICES:
        return False
    arm = points - points.mean(axis=0)
    scale = max(float(np.sqrt(np.mean(arm**2))), 1e-300)
    rows = np.hstack([np.cross(arm / scale, normals), normals])
    motion, *_ = np.linalg.lstsq(rows, change, rcond=1e-6)
    left = change - rows @ motion
    return bool(left @ left <= (1.0 - EXPLAINED) * (change @ change))
