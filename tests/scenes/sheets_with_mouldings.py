"""Two sheets with mouldings, along which surfaces guess between their points, and what changed on them."""

from __future__ import annotations

import numpy as np

from monitor.comparison import compare
from projects.model import Bools, Comparison, Floats, Registration, Roughness, Surface

N, EDGE, NOISE, GUESSED = 121, 2e-3, 5e-5, 5e-4  # of the sheets; m
MOULDINGS = (10, 35, 60, 85, 110)  # rows of vertices where one begins, along all of the sheet
WIDE, LONG = 5, 40  # vertices: across a moulding, and along it what errs alike


def mouldings() -> Bools:
    """Return which vertices (N, N) lie on a moulding."""
    out = np.zeros((N, N), dtype=bool)
    for row in MOULDINGS:
        out[row : row + WIDE] = True
    return out


def sheet(heights: Floats, to_samples: float | None = None) -> Surface:
    """Return a sheet of these heights (N, N) [m], each vertex `to_samples` [m] away from a sample, where it says so."""
    i = np.arange((N - 1) * N).reshape(N - 1, N)[:, :-1].ravel()
    faces = np.vstack([np.c_[i, i + N, i + 1], np.c_[i + 1, i + N, i + N + 1]])
    x, y = np.divmod(np.arange(N * N), N)
    unsure = mouldings().ravel()
    return Surface(np.c_[EDGE * x, EDGE * y, heights.ravel()], faces, sigma=np.where(unsure, GUESSED, NOISE),
                   roughness=np.where(unsure, Roughness.ROUGH, Roughness.SMOOTH).astype(np.uint8),
                   sample_distance=None if to_samples is None else np.full(N * N, to_samples))  # fmt: skip


def compared(
    rng: np.random.Generator, change: Floats, to_samples: float | None = None, points: bool = False
) -> Comparison:
    """Compare two sheets that differ by noise and a change (N, N) [m]; their vertices are the points, if any are
    asked."""
    fixed = Registration(np.eye(4), np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                         is_stable=np.ones(N * N, dtype=bool))  # fmt: skip
    first, second = (sheet(rng.normal(scale=NOISE, size=(N, N)) + c, to_samples) for c in (np.zeros((N, N)), change))
    return compare(first, second, fixed, points=(lambda: (first.vertices, second.vertices)) if points else None)


def along_one(depth: float) -> Floats:
    """Return a change (N, N) [m] of so much over a part of one moulding."""
    out = np.zeros((N, N))
    out[MOULDINGS[2] : MOULDINGS[2] + WIDE, 30 : 30 + LONG] = depth
    return out
