"""Clouds of two planes that meet along the y axis, sharp or round, seen from above, and how far places are off them."""

from __future__ import annotations

import numpy as np

from projects.model import Floats, PointCloud

SPACING, LENGTH, NOISE = 0.001, 0.03, 0.0004


def edge_cloud(rng: np.random.Generator, turn: float, radius: float = 0.0, *, is_fold: bool = False) -> PointCloud:
    """Return two planes of 30 x 50 mm whose normals are `turn` (rad) apart, a round edge of `radius` (m) between them.

    Points 1 mm apart, jittered, with 0.4 mm of noise. A fold is the same seen from below.
    """
    arc = radius * turn
    s, y = np.meshgrid(np.arange(-LENGTH - 0.5 * arc, LENGTH + 0.5 * arc, SPACING), np.arange(-0.025, 0.025, SPACING))
    s, y = (values.ravel() + rng.uniform(-3e-4, 3e-4, values.size) for values in (s, y))
    way = np.clip(s / radius, -0.5 * turn, 0.5 * turn) if radius else 0.5 * turn * np.sign(s)
    rest = np.sign(s) * np.maximum(np.abs(s) - 0.5 * arc, 0.0)
    points = np.column_stack([radius * np.sin(way) + rest * np.cos(way), y,
                              radius * (np.cos(way) - 1.0) - rest * np.sin(way)])  # fmt: skip
    normals = np.column_stack([np.sin(way), 0.0 * way, np.cos(way)])
    if is_fold:
        points[:, 2], normals[:, 0] = -points[:, 2], -normals[:, 0]
    points += NOISE * rng.normal(size=(len(points), 1)) * normals
    return PointCloud(points, origins=np.tile([0.0, 0.0, 2.0], (len(points), 1)))


def off_edge(places: Floats, turn: float, radius: float = 0.0, *, is_fold: bool = False) -> Floats:
    """Return how far (n,) [m] places lie outside of that surface."""
    sign = -1.0 if is_fold else 1.0
    x, z = np.abs(places[:, 0]), sign * places[:, 2] + radius
    off = x * np.sin(0.5 * turn) + z * np.cos(0.5 * turn) - radius
    if radius:
        off = np.where(np.arctan2(x, z) < 0.5 * turn, np.hypot(x, z) - radius, off)
    return sign * np.asarray(off)
