"""A comparison small enough for tests, with its truth: a ball of radius 0.1 m that gained at its front, lost at its
right and cannot be assessed at its left.

A patch is a bump of 5 mm (cosine bowl, 30 mm radius along the surface); the ball has 5 mm undulations of its own.
"""

import numpy as np
import pandas as pd

from projects.model import REGION_COLUMNS, Assessment, ComparedSurface, Comparison, Registration, Surface

RADIUS, DEPTH, PATCH, LEVEL = 0.1, 0.005, 0.03, 0.0004
FRONT, RIGHT, LEFT = np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0])


def make_ball(n: int = 100) -> tuple[np.ndarray, np.ndarray]:
    """Return unit directions (v, 3) and faces of a ball of about 2 n^2 triangles, counter-clockwise from outside."""
    polar, turn = np.linspace(0, np.pi, n + 1)[1:-1], np.arange(n) * 2 * np.pi / n
    rings = np.stack([np.outer(np.sin(polar), np.cos(turn)), np.outer(np.sin(polar), np.sin(turn)),
                      np.outer(np.cos(polar), np.ones(n))], axis=-1).reshape(-1, 3)  # fmt: skip
    vertices = np.concatenate([rings, [[0, 0, 1], [0, 0, -1]]])
    k, j = np.meshgrid(np.arange(n - 2), np.arange(n), indexing="ij")
    a, b = (k * n + j).ravel(), (k * n + (j + 1) % n).ravel()
    faces = np.concatenate([np.stack([a, a + n, b], axis=1), np.stack([b, a + n, b + n], axis=1)])
    turn_on, last = np.arange(n), (n - 2) * n
    top = np.stack([np.full(n, len(rings)), turn_on, (turn_on + 1) % n], axis=1)
    foot = np.stack([np.full(n, len(rings) + 1), last + (turn_on + 1) % n, last + turn_on], axis=1)
    return vertices, np.concatenate([faces, top, foot])


def bowl(directions: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Return the height [m] of a patch about a direction."""
    away = RADIUS * np.arccos(np.clip(directions @ towards, -1, 1))
    return np.where(away < PATCH, DEPTH * 0.5 * (1 + np.cos(np.pi * away / PATCH)), 0.0)


def make_comparison(n: int = 100) -> Comparison:
    """Return the comparison; region 1 is the gain in front, region 2 the loss at the right."""
    directions, faces = make_ball(n)
    change = bowl(directions, FRONT) - bowl(directions, RIGHT)
    radius = RADIUS + 0.001 * np.sin(9 * directions[:, 2]) * np.cos(7 * directions[:, 0])
    state = np.where(np.abs(change) > LEVEL, Assessment.CHANGED, Assessment.UNCHANGED).astype(np.uint8)
    state[directions @ LEFT > 0.5] = Assessment.NOT_ASSESSABLE
    known = state != Assessment.NOT_ASSESSABLE
    region = np.where(state == Assessment.CHANGED, np.where(change > 0, 1, 2), 0).astype(np.int32)
    distances, lod95 = np.where(known, change, np.nan), np.where(known, LEVEL, np.nan)
    sides = [
        ComparedSurface(Surface(directions * r[:, None], faces), distances, lod95, state, region,
                        np.where(known, 0, 1).astype(np.uint8))
        for r in (radius + change, radius)
    ]  # fmt: skip
    places = np.stack([FRONT, RIGHT]) * RADIUS
    rows = [[k + 1, kind, 0.002, 1e-5, s * 4e-6, 1e-7, s * DEPTH, 2e-4, s * 0.002, 1e-4, *places[k]]
            for k, (kind, s) in enumerate((("gain", 1), ("loss", -1)))]  # fmt: skip
    registration = Registration(np.eye(4), 1e-12 * np.eye(6), np.zeros(3), converged=True)
    table = pd.DataFrame(rows, columns=list(REGION_COLUMNS))
    return Comparison(sides[0], sides[1], table, registration, "relative", {"lod95_median_m": LEVEL})
