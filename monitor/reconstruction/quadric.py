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

N_ITERATIONS = 4  # least squares, with the fourth order, then twice without outliers
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
def fourth_order(c: Floats, u: float, v: float) -> Any:
    """Q |grad Q|^2 / 4, which no coefficient of its own carries, and the squared slope of the whole patch."""
    slope_u, slope_v = 2.0 * c[3] * u + c[4] * v, c[4] * u + 2.0 * c[5] * v
    quadratic = c[3] * u * u + c[4] * u * v + c[5] * v * v
    slope2 = (c[1] + slope_u) ** 2 + (c[2] + slope_v) ** 2
    return 0.25 * quadratic * (slope_u * slope_u + slope_v * slope_v), slope2


@jit(nopython=True, cache=True)
def normal_equations(patch: Floats, n: int, radius: float, scale: float, work: Any, influence: Floats) -> Any:
    """Fill the normal matrix and right-hand side from the moments of the points; residuals are about `work`'s patch.

    Weights go to `influence`, absolute residuals to the buffer. Returns how many residuals there are, the sum of the
    weights, of weight * residual^2 and of weight^2. Moments are kept in plain variables: this is the innermost loop.
    """
    c, a, rhs, buffer = work
    used, total, squares, weights2 = 0, 0.0, 0.0, 0.0
    m10 = m01 = m20 = m11 = m02 = m30 = m21 = m12 = m03 = m40 = m31 = m22 = m13 = m04 = 0.0
    h00 = h10 = h01 = h20 = h11 = h02 = 0.0
    for i in range(n):
        u, v = patch[i, 0] / radius, patch[i, 1] / radius
        uu, uv, vv = u * u, u * v, v * v
        influence[i] = 0.0
        if uu + vv >= 1.0:
            continue
        higher, slope2 = fourth_order(c, u, v)
        height = patch[i, 2] / radius - higher
        residual = height - (c[0] + c[1] * u + c[2] * v + c[3] * uu + c[4] * uv + c[5] * vv)
        residual2 = residual * residual / (1.0 + slope2)
        buffer[used] = np.sqrt(residual2)
        used += 1
        ratio2 = residual2 / (TUKEY * TUKEY * scale * scale)
        if ratio2 >= 1.0:
            continue
        w = (1.0 - uu - vv) * (1.0 - ratio2) ** 2
        influence[i] = w
        total += w
        squares += w * residual2
        weights2 += w * w
        wu, wv, wh = w * u, w * v, w * height
        wuu, wuv, wvv = wu * u, wu * v, wv * v
        m10 += wu
        m01 += wv
        m20 += wuu
        m11 += wuv
        m02 += wvv
        m30 += wuu * u
        m21 += wuu * v
        m12 += wvv * u
        m03 += wvv * v
        m40 += wuu * uu
        m31 += wuu * uv
        m22 += wuu * vv
        m13 += wvv * uv
        m04 += wvv * vv
        h00 += wh
        h10 += wh * u
        h01 += wh * v
        h20 += wh * uu
        h11 += wh * uv
        h02 += wh * vv
    a[0, 0] = total
    a[1, 0], a[1, 1] = m10, m20
    a[2, 0], a[2, 1], a[2, 2] = m01, m11, m02
    a[3, 0], a[3, 1], a[3, 2], a[3, 3] = m20, m30, m21, m40
    a[4, 0], a[4, 1], a[4, 2], a[4, 3], a[4, 4] = m11, m21, m12, m31, m22
    a[5, 0], a[5, 1], a[5, 2], a[5, 3], a[5, 4], a[5, 5] = m02, m12, m03, m22, m13, m04
    rhs[0, 0], rhs[1, 0], rhs[2, 0], rhs[3, 0], rhs[4, 0], rhs[5, 0] = h00, h10, h01, h20, h11, h02
    return used, total, squares, weights2


@jit(nopython=True, cache=True)
def fit_patch(patch: Floats, n: int, radius: float, degree: int, work: Any, out: Floats, influence: Floats) -> bool:
    """Fit a plane (`degree` 1) or curved patch (2) to `patch[:n]` (u, v, z); False where it cannot be.

    Weights are (1 - t^2) times Tukey's biweight. `out` receives height, slope along u, slope along v, standard error
    per unit sigma, sigma, effective number, and the sum of the slopes that both curvatures make at `radius`.
    `influence[i]` is how far the height moves with point i: the heights of two fits to the same points differ by
    sigma * |influence - influence'|. `work` is as of `fit_room`.
    """
    c, a, rhs, buffer = work
    m = 3 if degree == 1 else 6
    c[:] = 0.0
    scale, sums = np.inf, (0, 0.0, 0.0, 0.0)
    for iteration in range(N_ITERATIONS):
        sums = normal_equations(patch, n, radius, scale, work, influence)
        used = sums[0]
        if used < m + 4 or sums[1] <= 0.0:
            return False
        rhs[:, 1] = 0.0
        rhs[0, 1] = 1.0
        if degree == 2 and iteration == N_ITERATIONS - 1:
            rhs[3, 1] = rhs[5, 1] = -2.0 * scale * scale
        if not solve_spd(a, rhs, m):
            return False
        if 0 < iteration < N_ITERATIONS - 1:
            scale = max(1.4826 * np.median(buffer[:used]) * np.sqrt(used / (used - m)), 1e-9)
        if iteration < N_ITERATIONS - 1:
            c[:m] = rhs[:m, 0]
    thinned = 2.0 * scale * scale * (rhs[3, 0] + rhs[5, 0]) if degree == 2 else 0.0
    variance = influence_variance(patch, n, radius, rhs, m, influence)
    effective = sums[1] * sums[1] / sums[3]
    sigma2 = sums[2] / sums[1] * effective / max(effective - m, 1.0)
    out[0], out[1], out[2] = (rhs[0, 0] - thinned) * radius, rhs[1, 0], rhs[2, 0]
    out[3], out[4], out[5] = np.sqrt(variance), np.sqrt(sigma2) * radius, effective
    out[6] = 2.0 * (rhs[3, 0] + rhs[5, 0]) if m == 6 else 0.0
    return True


@jit(nopython=True, cache=True)
def influence_variance(patch: Floats, n: int, radius: float, rhs: Floats, m: int, influence: Floats) -> float:
    """Turn weights into influences and return the sum of their squares."""
    variance = 0.0
    g0, g1, g2 = rhs[0, 1], rhs[1, 1], rhs[2, 1]
    g3, g4, g5 = (rhs[3, 1], rhs[4, 1], rhs[5, 1]) if m == 6 else (0.0, 0.0, 0.0)
    for i in range(n):
        if influence[i] > 0.0:
            u, v = patch[i, 0] / radius, patch[i, 1] / radius
            influence[i] *= g0 + g1 * u + g2 * v + g3 * u * u + g4 * u * v + g5 * v * v
            variance += influence[i] ** 2
    return variance


@jit(nopython=True, cache=True)
def fit_room(n: int) -> Any:
    """Room for `fit_patch` with up to n points: coefficients, normal matrix, its right-hand sides, buffer."""
    return np.empty(6), np.empty((6, 6)), np.empty((6, 2)), np.empty(n)
