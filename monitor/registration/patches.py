"""Cuts a surface into patches: cubes in space, split by the way that the surface looks.

In: points and normals. Out: `PatchGrid`, which numbers the patch of any point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
        steps = np.clip(np.floor((points - self.corner) / self.cell).astype(np.int64), 0, self.sizes - 1)
        cube = (steps[:, 0] * self.sizes[1] + steps[:, 1]) * self.sizes[2] + steps[:, 2]
        if not self.by_direction or normals is None:
            return cube
        axis = np.argmax(np.abs(normals), axis=1)
        return 6 * cube + 2 * axis + (normals[np.arange(len(normals)), axis] < 0)


def cut_patches(points: Floats, normals: Floats | None, n_per_patch: float) -> PatchGrid:
    """Return the grid whose patches hold about `n_per_patch` of the points; by cubes alone without normals."""
    corner, extent = points.min(axis=0), np.ptp(points, axis=0)
    cell = float(extent.max()) / max(np.sqrt(len(points) / n_per_patch), 1.0) + 1e-12
    for _ in range(4):  # the number of points in a cube of a surface goes with the square of its edge
        grid = PatchGrid(corner, cell, np.floor(extent / cell).astype(np.int64) + 1, normals is not None)
        mean = len(points) / len(np.unique(grid.numbers(points, normals)))
        cell *= float(np.sqrt(n_per_patch / mean))
    return grid
