"""Robust local fit of a plane or curved patch to the points around a vertex, by orthogonal distance.

In: points in the vertex's frame (u, v along the surface, z along its normal). Out: height of the patch over the
vertex, its slope, its standard error and the scatter of the points. The patch is
z = c0 + c1 u + c2 v + Q + Q |grad Q|^2 / 4 with Q its quadratic part: it follows spheres and cylinders to fourth
order without a further unknown. Distances are taken at the foot point on the patch: a vertical regression would be
off by -2 sigma^2 / R on a sphere.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

from projects.model import Floats

TUKEY = 6.0  # in sigmas; wide, so that clean noise loses under 2 % and only outliers are left out


@jit(nopython=True, cache=True)
def patch_height(c: Floats, degree: int, a: float, b: float) -> Any:
    """Height and slopes (q, dq/da, dq/db) of the patch at (a, b)."""
    q, ga, gb = c[0] + c[1] * a + c[2] * b, c[1], c[2]
    if degree == 2:
        quad = c[3] * a * a + c[4] * a * b + c[5] * b * b
        ha, hb = 2.0 * c[3] * a + c[4] * b, c[4] * a + 2.0 * c[5] * b
        slope2 = ha * ha + hb * hb
        q += quad * (1.0 + 0.25 * slope2)
        ga += ha + 0.25 * (ha * slope2 + quad * 2.0 * (2.0 * c[3] * ha + c[4] * hb))
        gb += hb + 0.25 * (hb * slope2 + quad * 2.0 * (c[4] * ha + 2.0 * c[5] * hb))
    return q, ga, gb


@jit(nopython=True, cache=True)
def orthogonal_distance(c: Floats, degree: int, a: float, b: float, z: float) -> Any:
    """Signed distance of (a, b, z) to the patch, its foot point (a, b) and the length of (ga, gb, 1) there."""
    q, ga, gb = patch_height(c, degree, a, b)
    length = np.sqrt(1.0 + ga * ga + gb * gb)
    distance = (z - q) / length
    foot_a, foot_b = a, b
    for _ in range(2):
        foot_a, foot_b = a + distance * ga / length, b + distance * gb / length
        q, ga, gb = patch_height(c, degree, foot_a, foot_b)
        length = np.sqrt(1.0 + ga * ga + gb * gb)
        distance = ((z - q) - (a - foot_a) * ga - (b - foot_b) * gb) / length
    return distance, foot_a, foot_b, length


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
def fit_patch(points: Floats, n: int, radius: float, degree: int, n_iterations: int, work: Any, out: Floats) -> bool:
    """Fit the patch to `points[:n]` (u, v, z, residual) with weights (1 - t^2) * Tukey; False where it cannot be.

    `out` receives height, slope along u, slope along v, standard error per unit sigma, sigma, effective number.
    `work` is (c (6,), a (6, 6), a2 (6, 6), rhs (6, 2), row (6,), buffer (n,)). The standard error is that of the
    weighted sum with its own weights: sqrt(e0' A^-1 A2 A^-1 e0).
    """
    c, a, a2, rhs, row, buffer = work
    m = 3 if degree == 1 else 6
    c[:] = 0.0
    scale = np.inf
    for _ in range(n_iterations):
        a[:], a2[:], rhs[:] = 0.0, 0.0, 0.0
        total, squares, squares_weighted, used = 0.0, 0.0, 0.0, 0
        for i in range(n):
            u, v, z = points[i, 0] / radius, points[i, 1] / radius, points[i, 2] / radius
            distance, fu, fv, length = orthogonal_distance(c, degree, u, v, z)
            t2 = fu * fu + fv * fv
            if t2 >= 1.0:
                continue
            ratio2 = (distance / (TUKEY * scale)) ** 2
            buffer[used] = abs(distance)
            used += 1
            if ratio2 >= 1.0:
                continue
            w = (1.0 - t2) * (1.0 - ratio2) ** 2
            row[0], row[1], row[2] = 1.0 / length, fu / length, fv / length
            row[3], row[4], row[5] = fu * fu / length, fu * fv / length, fv * fv / length
            total += w
            squares += w * distance * distance
            squares_weighted += w * w
            for p in range(m):
                rhs[p, 0] += w * row[p] * distance
                for q in range(p + 1):
                    a[p, q] += w * row[p] * row[q]
                    a2[p, q] += w * w * row[p] * row[q]
        if used < m + 4 or total <= 0.0:
            return False
        rhs[0, 1] = 1.0
        if not solve_spd(a, rhs, m):
            return False
        for p in range(m):
            c[p] += rhs[p, 0]
        scale = max(1.4826 * np.median(buffer[:used]) * np.sqrt(used / (used - m)), 1e-9)
    variance = 0.0
    for p in range(m):
        for q in range(m):
            variance += rhs[p, 1] * rhs[q, 1] * a2[max(p, q), min(p, q)]
    effective = total * total / squares_weighted
    sigma2 = squares / total * effective / max(effective - m, 1.0)
    out[0], out[1], out[2] = c[0] * radius, c[1], c[2]
    out[3], out[4], out[5] = np.sqrt(variance), np.sqrt(sigma2) * radius, effective
    return True
