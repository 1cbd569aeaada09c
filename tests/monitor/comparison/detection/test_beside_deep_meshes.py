"""A deep change between two finished meshes moves nothing beside it: no noise is stated, and the meshes tell it.

What is faint is told as without it, though half of its vertices are as deep as no error is and its flanks are not; and
what two meshes of one edge differ by stays an error.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from monitor.comparison import compare
from projects.model import Comparison, Floats, Registration, Surface

Height = Callable[[Floats, Floats], Floats]

STILL = Registration(np.eye(4), np.zeros((6, 6)), np.zeros(3), True)
FAINT = ((0.04, 0.0, 0.04, -1e-3), (0.0, 0.09, 0.03, 0.67e-3))  # m: middle, radius and depth of bowls
DEEP = (-0.05, 0.0, 0.03, -0.02)  # m: of a hole with steep walls
PERIOD, BEVEL, HIGH = 0.07, 0.004, 0.008  # m, of panels


def sheet(height: Height, half: float, step: float, noise: float, rng: np.random.Generator) -> Surface:
    """Return a mesh over a square, vertices a `step` [m] apart, with noise in each coordinate."""
    n = round(2.0 * half / step) + 1
    axis = np.linspace(-half, half, n)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis, indexing="ij"))
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    vertices = np.column_stack([x, y, height(x, y)]) + rng.normal(0.0, noise, (n * n, 3))
    return Surface(vertices, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]).astype(np.int32))


def relief(x: Floats, y: Floats) -> Floats:
    """Return the heights [m] of gentle waves."""
    return np.asarray(0.03 * np.sin(15.0 * x) * np.cos(12.0 * y))


def panels(x: Floats, y: Floats) -> Floats:
    """Return the heights [m] of square panels with bevels all around."""
    into = [np.clip((0.35 * PERIOD - np.abs((u + 0.5 * PERIOD) % PERIOD - 0.5 * PERIOD)) / BEVEL + 0.5, 0.0, 1.0)
            for u in (x, y)]  # fmt: skip
    return np.asarray(HIGH * np.prod([t * t * (3.0 - 2.0 * t) for t in into], axis=0))


def bowl(x: Floats, y: Floats, at: tuple[float, float, float, float]) -> Floats:
    """Return the heights [m] of a bowl, or a boss."""
    away = np.minimum(np.hypot(x - at[0], y - at[1]) / at[2], 1.0)
    return np.asarray(0.5 * at[3] * (1.0 + np.cos(np.pi * away)))


def hole(x: Floats, y: Floats) -> Floats:
    """Return the heights [m] of the hole."""
    return np.where(np.hypot(x - DEEP[0], y - DEEP[1]) < DEEP[2], DEEP[3], 0.0)


def compared(before: Height, after: Height, steps: tuple[float, float], half: float, noise: float) -> Comparison:
    rng = np.random.default_rng(0)
    first, second = (sheet(f, half, step, noise, rng) for f, step in zip((before, after), steps, strict=True))
    return compare(first, second, STILL)


def test_faint_changes_of_finished_meshes_are_told_beside_a_deep_one() -> None:
    found = compared(relief, lambda x, y: relief(x, y) + hole(x, y) + sum(bowl(x, y, b) for b in FAINT),
                     (0.0025, 0.0025), 0.15, 5e-5).regions  # fmt: skip
    assert len(found) == 3
    for x, y, _, depth in FAINT:
        told = found.iloc[np.argmin(np.hypot(found["x"] - x, found["y"] - y))]
        assert told["extreme_m"] == pytest.approx(depth, rel=0.1)


def test_what_meshes_differ_by_along_edges_is_no_change_beside_a_true_one() -> None:
    true = (0.03, 0.03, 0.05, 0.012)
    found = compared(panels, lambda x, y: panels(x, y) + bowl(x, y, true), (0.0027, 0.004), 0.1, 0.0).regions
    assert len(found) == 1
    assert found["extreme_m"][0] == pytest.approx(true[3], rel=0.05)
