"""A wall of twenty pieces with relief, as of a stove, of which some moved, each its own way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from projects.model import Floats, Ints, PointCloud
from projects.transforms import apply, perturb, rotate

N_ACROSS, N_UP, PIECE = 5, 4, 0.3  # pieces of 30 cm
N = 60_000
NOISE = 3e-4  # m
MOVED = (1, 3, 5, 9, 10, 14, 16, 18)  # eight of twenty


def scan_stove(rng: np.random.Generator) -> tuple[PointCloud, Ints]:
    """Return a wall of pieces with relief 20 mm deep, new points on each call, and the piece of each point."""
    x, y = rng.uniform(0, N_ACROSS * PIECE, N), rng.uniform(0, N_UP * PIECE, N)
    shape = np.random.default_rng(5)
    z, dx, dy = np.zeros(N), np.zeros(N), np.zeros(N)
    for u, v in shape.normal(size=(8, 2)) * 40.0:
        phase = u * x + v * y + shape.uniform(0, 6.28)
        z, dx, dy = z + 0.004 * np.sin(phase), dx + 0.004 * u * np.cos(phase), dy + 0.004 * v * np.cos(phase)
    normals = np.column_stack([-dx, -dy, np.ones(N)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    piece = (x // PIECE).astype(int) + N_ACROSS * (y // PIECE).astype(int)
    return PointCloud(np.column_stack([x, y, z]) + normals * rng.normal(0, NOISE, (N, 1)), normals), piece


def move_pieces(cloud: PointCloud, piece: Ints, moved: Sequence[int] = MOVED) -> tuple[PointCloud, dict[int, Floats]]:
    """Return the cloud with some pieces moved by about 2 mm and 5 mrad, and the motion (4, 4) of each."""
    rng, points, normals, motions = np.random.default_rng(8), cloud.points.copy(), cloud.normals.copy(), {}
    for k in moved:
        which = piece == k
        motions[k] = perturb(np.eye(4), points[which].mean(axis=0), rng.normal(0, [0.005] * 3 + [0.002] * 3))
        points[which], normals[which] = apply(motions[k], points[which]), rotate(motions[k], normals[which])
    return PointCloud(points, normals), motions
