"""Cuts a surface into patches: cubes in space, split by the way that the surface looks.

In: points and normals. Out: `PatchGrid`, which numbers the patch of any point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit

from projects.model import Floats, Ints


@dataclass(frozen=True)
class PatchGrid:
    """Cuts a source into patches: cubes of edge `cell` [m] from `corner`, split by the way that the surface looks."""

    corner: Floats
    cell: float
    sizes: Ints
    by_direction: bool

    def numbers(self, points: Floats, normals: Floats | None) -> Ints:
        """Return the patch number (n,) of each point of the source."""
        if not self.by_direction or normals is None:
            normals = np.empty((0, 3))
        return np.asarray(_number_patches(points, normals, self.corner, self.cell, self.sizes))

    def halved(self) -> PatchGrid:
        """Return the grid with cubes of half the edge: each of its patches lies in one of these."""
        return replace(self, cell=0.5 * self.cell, sizes=2 * self.sizes)


@njit(cache=True, error_model="numpy")
def _number_patches(points: Any, normals: Any, corner: Any, cell: float, sizes: Any) -> Any:
    """Number the cubes along x, y, z and, where there are normals, each cube's six directions within it."""
    numbers = np.empty(len(points), dtype=np.int64)
    for i in range(len(points)):
        number = 0
        for axis in range(3):
            step = int(np.floor((points[i, axis] - corner[axis]) / cell))
            number = number * sizes[axis] + min(max(step, 0), sizes[axis] - 1)
        if len(normals):
            most = 0
            for axis in range(1, 3):
                if abs(normals[i, axis]) > abs(normals[i, most]):
                    most = axis
            number = 6 * number + 2 * most + (1 if normals[i, most] < 0.0 else 0)
        numbers[i] = number
    return numbers


def cut_patches(points: Floats, normals: Floats | None, n_per_patch: float) -> PatchGrid:
    """Return the grid whose patches hold about `n_per_patch` of the points; by cubes alone without normals."""
    corner, extent = points.min(axis=0), np.ptp(points, axis=0)
    cell = float(extent.max()) / max(np.sqrt(len(points) / n_per_patch), 1.0) + 1e-12
    for _ in range(4):  # the number of points in a cube of a surface goes with the square of its edge
        grid = PatchGrid(corner, cell, np.floor(extent / cell).astype(np.int64) + 1, normals is not None)
        mean = len(points) / len(np.unique(grid.numbers(points, normals)))
        cell *= float(np.sqrt(n_per_patch / mean))
    return grid
