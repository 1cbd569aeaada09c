"""Clouds of three planes that meet at the origin in every way they can, and of a cube's corner with round edges."""

from __future__ import annotations

import numpy as np

from monitor.reconstruction.three_planes import Around, frame_across, height_over, plane_under
from projects.model import Floats, PointCloud

SPACING, LENGTH, NOISE = 0.001, 0.025, 0.0004
CUBE = np.eye(3)


def unit(rows: list[list[float]]) -> Floats:
    """Return rows of unit length."""
    values = np.array(rows)
    return values / np.linalg.norm(values, axis=1)[:, None]


def points_on(rng: np.random.Generator, normals: Floats, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return places (n, 3) m of the surface that is that shape of planes with these normals (3, 3), and their normals.

    They lie 1 mm apart, jittered by 0.3 mm, within 25 mm of the origin.
    """
    grid = np.arange(-LENGTH, LENGTH, SPACING)
    places, looks = [], []
    for a, normal in enumerate(normals):
        u, v = (values.ravel() + rng.uniform(-3e-4, 3e-4, values.size) for values in np.meshgrid(grid, grid))
        on = np.column_stack([u, v])[np.hypot(u, v) < LENGTH] @ frame_across(normal)
        heights = on @ normals.T
        heights[:, a] = 0.0
        is_surface = (height_over(heights, shape) == 0.0) & (plane_under(heights, shape) == a)
        places.append(on[is_surface])
        looks.append(np.tile(normal, (np.count_nonzero(is_surface), 1)))
    return np.concatenate(places), np.concatenate(looks)


def corner_cloud(rng: np.random.Generator, normals: Floats, shape: tuple[int, int]) -> PointCloud:
    """Return such places with 0.4 mm of noise along their normals, seen from 0.5 m over each."""
    places, looks = points_on(rng, normals, shape)
    return PointCloud(places + NOISE * rng.normal(size=(len(places), 1)) * looks, origins=places + 0.5 * looks)


def points_around(rng: np.random.Generator, normals: Floats, shape: tuple[int, int], radius: float,
                  noise: float) -> Around:  # fmt: skip
    """Return the points of that surface within `radius` (m) of the origin, with `noise` (m) along their normals."""
    places, looks = points_on(rng, normals, shape)
    places = places + noise * rng.normal(size=(len(places), 1)) * looks
    off2 = np.sum(places**2, axis=1) / radius**2
    return Around(places[off2 < 1.0], 1.0 - off2[off2 < 1.0], max(noise, 1e-6))


def round_corner_cloud(rng: np.random.Generator, radius: float, *, is_fold: bool = False) -> PointCloud:
    """Return the corner of a cube at the origin whose edges have a `radius` (m), 0.4 mm of noise; a fold is the same
    seen from within."""
    places, looks = [], []
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        n = rng.poisson((LENGTH - radius) ** 2 / SPACING**2)
        flat, up = np.zeros((n, 3)), np.zeros((n, 3))
        flat[:, b], flat[:, c] = -rng.uniform(radius, LENGTH, (2, n))
        up[:, a] = 1.0
        n = rng.poisson(0.5 * np.pi * radius * (LENGTH - radius) / SPACING**2)
        angle, out = rng.uniform(0.0, 0.5 * np.pi, n), np.zeros((n, 3))
        out[:, b], out[:, c] = np.cos(angle), np.sin(angle)
        edge = radius * (out - 1.0)
        edge[:, a] = -rng.uniform(radius, LENGTH, n)
        places += [flat, edge]
        looks += [up, out]
    out = np.abs(rng.normal(size=(rng.poisson(0.5 * np.pi * radius**2 / SPACING**2), 3)))
    out /= np.linalg.norm(out, axis=1)[:, None]
    on, along = np.concatenate([*places, radius * (out - 1.0)]), np.concatenate([*looks, out])
    noisy = on + NOISE * rng.normal(size=(len(on), 1)) * along
    return PointCloud(noisy, origins=noisy + (-0.7 if is_fold else 0.7) * along)


def off_round_corner(places: Floats, radius: float) -> Floats:
    """Return how far (n,) [m] places lie outside of that corner."""
    over = places + radius
    return np.linalg.norm(np.maximum(over, 0.0), axis=1) + np.minimum(over.max(axis=1), 0.0) - radius
