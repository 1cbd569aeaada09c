"""Points of one epoch under the surface of the other: which lie deep, and where those that lie on it end."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from monitor.comparison.distances.side import Side
from projects.model import Bools, Floats, Ints

BESIDE = 1.5  # spacings beside a vertex: points farther off belong to none


class Under(NamedTuple):
    """The vertex next to each point (m,), -1 for none, and how far [m] the point lies outside of the surface there, NaN
    without one."""

    vertex: Ints
    height: Floats


class Cubes(NamedTuple):
    """Cubes with vertices of a side in them, by their sorted numbers (c,), whose diagonal [m] is as long as `depth`: a
    point in one lies no deeper. The lower corner [m] of the first, and how many lie along each axis."""

    taken: Ints
    depth: float
    low: Floats
    shape: Ints

    @classmethod
    def about(cls, side: Side, depth: float) -> Cubes:
        """Return the cubes about the vertices of a side."""
        low, high = side.surface.vertices.min(axis=0), side.surface.vertices.max(axis=0)
        shape = np.floor(np.sqrt(3.0) * (high - low) / depth).astype(np.int64) + 2  # one more: rounding
        cubes = cls(np.empty(0, np.int64), depth, low, shape)
        return cubes._replace(taken=np.unique(cubes._number(cubes._steps(side.surface.vertices))))

    def of(self, points: Floats) -> Ints:
        """Return which of the cubes each point (m, 3) m lies in (m,), -1 for none."""
        return self._which(self._number(self._steps(points)))

    def around(self, vertices: Floats) -> Bools:
        """Return which cubes (c,) points may lie in that lie no deeper under some of the vertices (k, 3) m and no
        farther than `BESIDE` beside it."""
        out = np.zeros(len(self.taken), dtype=np.bool_)
        steps = np.unique(self._steps(vertices), axis=0)
        for offset in np.ndindex(5, 5, 5):
            at = self._which(self._number(steps + np.array(offset) - 2))
            out[at[at >= 0]] = True
        return out

    def _steps(self, points: Floats) -> Ints:
        return np.floor((points - self.low) * (np.sqrt(3.0) / self.depth)).astype(np.int64)

    def _number(self, i: Ints) -> Ints:
        inside = ((i >= 0) & (i < self.shape)).all(axis=1)
        return np.where(inside, (i[:, 0] * self.shape[1] + i[:, 1]) * self.shape[2] + i[:, 2], -1)

    def _which(self, numbers: Ints) -> Ints:
        at = np.minimum(np.searchsorted(self.taken, numbers), len(self.taken) - 1)
        return np.where(self.taken[at] == numbers, at, -1)


def place_under(side: Side, tree: cKDTree, points: Floats, which: Ints) -> Under:
    """Return the vertex next to each of the points (m, 3) m that is one of `which` (k,) and lies over or under one."""
    under = Under(np.full(len(points), -1), np.full(len(points), np.nan))
    distance, vertex = tree.query(points[which], workers=2)
    height = np.einsum("ij,ij->i", points[which] - side.surface.vertices[vertex], side.normals[vertex])
    is_beside = np.sqrt(np.maximum(distance**2 - height**2, 0.0)) < BESIDE * side.spacing
    under.vertex[which[is_beside]], under.height[which[is_beside]] = vertex[is_beside], height[is_beside]
    return under


def nearest_along(side: Side, which: Ints, points: Floats, under: Under) -> Floats:
    """Return how far [m] beside each of the vertices `which` (k,) the nearest of the points (m, 3), each brought onto
    the surface along its normal, lies; inf without any."""
    if not len(points):
        return np.full(len(which), np.inf)
    feet = points - under.height[:, None] * side.normals[under.vertex]
    distance, _ = cKDTree(feet).query(side.surface.vertices[which], workers=2)
    return np.asarray(distance)
