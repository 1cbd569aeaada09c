"""Robust local fit of a plane or curved patch to the points around a vertex.

In: points in the vertex's frame (u, v along the surface, z along its normal). Out: height of the patch over the
vertex, its slope, its standard error and the scatter of the points. The patch is
z = c0 + c1 u + c2 v + Q + Q |grad Q|^2 / 4 with Q its quadratic part: it follows spheres and cylinders to fourth
order without a further unknown. Noise along the normals of a curved surface thins out the points that lie outside of
it, by 1 - 2 e / R on a sphere, so that a regression of heights is low by sigma^2 (k1 + k2); this is taken off.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

from projects.model import Floats

N_ITERATIONS = 3
TUKEY = 6.0  # in sigmas; wide, so that clean noise loses under 2 % and only outliers are left out


@jit(nopython=True, cache=True)
def solve_spd(matrix: Floats, rhs: Floats, m: int) -> bool:
    """Solve in place by Cholesky for two right-hand sides (m, 2); False where the system is singular."""
    for i in range(m):
        for j in range(i + 1):
            s = matrix[i, j]
            for k in range(j):
                s -= matrix[i, k] * matrix[j, k]
            if i == j:
                if s <= 1e-10:
                    return False
                matrix[i, i] = np.sqrt(s)
            else:
                matrix[i, j] = s / matrix[j, j]
    for r in range(rhs.shape[1]):
        for i in range(m):
            for k in range(i):
                rhs[i, r] -= matrix[i, k] * rhs[k, r]
            rhs[i, r] /= matrix[i, i]
        for i in range(m - 1, -1, -1):
            for k in range(i + 1, m):
                rhs[i, r] -= matrix[k, i] * rhs[k, r]
            rhs[i, r] /= matrix[i, i]
    return True


@jit(nopython=True, cache=True)
def fill_row(row: Floats, u: float, v: float) -> None:
    """Derivatives of the height by the six coefficients."""
    row[0], row[1], row[2], row[3], row[4], row[5] = 1.0, u, v, u * u, u * v, v * v


@jit(nopython=True, cache=True)
def fourth_order(c: Floats, u: float, v: float) -> Any:
    """Q |grad Q|^2 / 4, which no coefficient of its own carries, and the squared slope of the whole patch."""
    slope_u, slope_v = 2.0 * c[3] * u + c[4] * v, c[4] * u + 2.0 * c[5] * v
    quadratic = c[3] * u * u + c[4] * u * v + c[5] * v * v
    slope2 = (c[1] + slope_u) ** 2 + (c[2] + slope_v) ** 2
    return 0.25 * quadratic * (slope_u * slope_u + slope_v * slope_v), slope2


@jit(nopython=True, cache=True)
def fit_patch(patch: Floats, n: int, radius: float, degree: int, work: Any, out: Floats, influence: Floats) -> bool:
    """Fit a plane (`degree` 1) or curved patch (2) to `patch[:n]` (u, v, z); False where it cannot be.

    Weights are (1 - t^2) times Tukey's biweight. `out` receives height, slope along u, slope along v, standard error
    per unit sigma, sigma, effective number, and the sum of the slopes that both curvatures make at `radius`.
    `influence[i]` is how far the height moves with point i: the heights of two fits to the same points differ by
    sigma * |influence - influence'|. `work` is as of `fit_room`.
    """
    c, a, rhs, row, buffer = work
    m = 3 if degree == 1 else 6
    c[:] = 0.0
    scale, total, squares, squares_weighted = np.inf, 0.0, 0.0, 0.0
    for iteration in range(N_ITERATIONS):
        a[:], rhs[:] = 0.0, 0.0
        total, squares, squares_weighted, used = 0.0, 0.0, 0.0, 0
        for i in range(n):
            u, v = patch[i, 0] / radius, patch[i, 1] / radius
            t2 = u * u + v * v
            influence[i] = 0.0
            if t2 >= 1.0:
                continue
            fill_row(row, u, v)
            higher, slope2 = fourth_order(c, u, v)
            height = patch[i, 2] / radius - higher
            residual = height
            for p in range(m):
                residual -= c[p] * row[p]
            residual /= np.sqrt(1.0 + slope2)
            buffer[used] = abs(residual)
            used += 1
            ratio2 = (residual / (TUKEY * scale)) ** 2
            if ratio2 >= 1.0:
                continue
            w = (1.0 - t2) * (1.0 - ratio2) ** 2
            influence[i] = w
            total += w
            squares += w * residual * residual
            squares_weighted += w * w
            for p in range(m):
                weighted = w * row[p]
                rhs[p, 0] += weighted * height
                for q in range(p + 1):
                    a[p, q] += weighted * row[q]
        if used < m + 4 or total <= 0.0:
            return False
        rhs[0, 1] = 1.0
        if degree == 2 and iteration == N_ITERATIONS - 1:
            rhs[3, 1] = rhs[5, 1] = -2.0 * scale * scale
        if not solve_spd(a, rhs, m):
            return False
        if iteration < N_ITERATIONS - 1:
            if iteration > 0:
                scale = max(1.4826 * np.median(buffer[:used]) * np.sqrt(used / (used - m)), 1e-9)
            c[:m] = rhs[:m, 0]
    thinned = 2.0 * scale * scale * (rhs[3, 0] + rhs[5, 0]) if degree == 2 else 0.0
    return finish_fit(patch, n, radius, m, work, (total, squares, squares_weighted, thinned), out, influence)


@jit(nopython=True, cache=True)
def finish_fit(
    patch: Floats, n: int, radius: float, m: int, work: Any, sums: Any, out: Floats, influence: Floats
) -> bool:
    """Turn weights into influences, and report height, slopes, standard error and scatter."""
    _, _, rhs, row, _ = work
    total, squares, squares_weighted, thinned = sums
    variance = 0.0
    for i in range(n):
        if influence[i] > 0.0:
            fill_row(row, patch[i, 0] / radius, patch[i, 1] / radius)
            along = 0.0
            for p in range(m):
                along += row[p] * rhs[p, 1]
            influence[i] *= along
            variance += influence[i] ** 2
    effective = total * total / squares_weighted
    sigma2 = squares / total * effective / max(effective - m, 1.0)
    out[0], out[1], out[2] = (rhs[0, 0] - thinned) * radius, rhs[1, 0], rhs[2, 0]
    out[3], out[4], out[5] = np.sqrt(variance), np.sqrt(sigma2) * radius, effective
    out[6] = 2.0 * (rhs[3, 0] + rhs[5, 0]) if m == 6 else 0.0
    return True


@jit(nopython=True, cache=True)
def fit_room(n: int) -> Any:
    """Room for `fit_patch` with up to n points: coefficients, normal matrix, its right-hand sides, row, buffer."""
    return np.empty(6), np.empty((6, 6)), np.empty((6, 2)), np.empty(6), np.empty(n)
