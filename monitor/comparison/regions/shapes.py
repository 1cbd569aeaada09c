"""How long and wide each region is, along which directions, and what one calls it.

In: the table of regions and the region of each vertex. Out: one record a region for the summary.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from monitor.comparison.distances.side import Side
from monitor.comparison.regions.figures import CHOICE
from monitor.lengths import in_millimetres
from projects.model import Bools, Floats, Ints


def describe_shapes(table: pd.DataFrame, sides: tuple[Side, Side], regions: tuple[Ints, Ints],
                    are_hollows: Bools) -> list[dict[str, Any]]:  # fmt: skip
    """Return for each region its length and width [m], the unit vectors along and across it, its name, whether it is a
    hollow too narrow for a surface (`are_hollows` (r,)), and what noise alone had added to its mean [m].

    Along and across are the principal directions of its surface, in the reference epoch's coordinates; lengths are
    those of the region's whole extent along them.
    """
    out = []
    for number, kind, choice, is_hollow in zip(table["region"], table["kind"], table[CHOICE], are_hollows, strict=True):
        masks = [r == number for r in regions]
        points = np.vstack([s.surface.vertices[m] for s, m in zip(sides, masks, strict=True)])
        weights = np.concatenate([s.areas[m] for s, m in zip(sides, masks, strict=True)])
        axes, extents = principal_axes(points, weights)
        out.append({
            "region": int(number), "length_m": float(extents[0]), "width_m": float(extents[1]),
            "along": axes[0].tolist(), "across": axes[1].tolist(), "name": name_region(str(kind), extents),
            "is_hollow": bool(is_hollow), CHOICE: float(choice),
        })  # fmt: skip
    return out


def principal_axes(points: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return the unit vectors (3, 3) along which weighted points (n, 3) spread most, first to last, and extents (3,).

    The largest component of each vector is positive.
    """
    arm = points - np.average(points, axis=0, weights=weights)
    _, vectors = np.linalg.eigh((arm * weights[:, None]).T @ arm)
    axes = vectors.T[::-1]
    axes = axes * np.sign(axes[np.arange(3), np.abs(axes).argmax(axis=1)])[:, None]
    return axes, np.ptp(points @ axes.T, axis=0)


def name_region(kind: str, extents: Floats) -> str:
    """Return a region's name: its kind and size, in millimetres."""
    return f"{kind}, {in_millimetres(float(extents[0]))} by {in_millimetres(float(extents[1]))}"
