"""An order of points, and a number for each, that depend on their coordinates alone: the same however they come."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monitor.filtering.nearest import BLOCK
from projects.model import Floats, Ints


def draw_order(points: Floats, seed: int) -> Ints:
    """Return the order (n,) in which points are drawn: by a hash of their coordinates, whatever their place."""
    key = np.empty(len(points), dtype=np.uint64)
    for first in range(0, len(points), BLOCK):
        key[first : first + BLOCK] = hash_points(points[first : first + BLOCK], seed)
    return np.argsort(key, kind="stable").astype(np.int32 if len(points) < 2**31 else np.int64)


def hash_points(points: Floats, seed: int) -> NDArray[np.uint64]:
    """Return a number (n,) for each point, as if at random, that depends on its coordinates and the seed alone."""
    bits = np.ascontiguousarray(points, dtype=np.float64).view(np.uint64).reshape(-1, 3)
    key = np.full(len(bits), np.uint64(seed) + np.uint64(0x9E3779B97F4A7C15), dtype=np.uint64)
    with np.errstate(over="ignore"):
        for axis in range(3):  # the finalizer of splitmix64 (Steele, Lea and Flood 2014), once for each coordinate
            key = key + bits[:, axis]
            key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            key = key ^ (key >> np.uint64(31))
    return key
