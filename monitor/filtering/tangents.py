"""Kernels that fit a robust tangent plane to the neighbours of every point (Nothegger and Dorninger, section 2.2).

In: points, the indices of each point's neighbours, and the noise there where it is known; out: one row of `COLUMNS`
per point. A neighbourhood is a disc of surface with noise across it, so the factors that make the determinant's
covariance consistent are those of that distribution (simulated; `tests/monitor/filtering/test_mcd.py` repeats it), not
those of a normal one.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit, prange

from monitor.filtering.covariance import (
    FLOOR2,
    ORDER_FREE,
    eigenvalues,
    keep_smallest,
    mahalanobis2,
    moments,
    smallest,
)
from monitor.filtering.mcd import GUESS, NARROW_ROWS, minimum_covariance_determinant
from monitor.filtering.off_plane import CUT2, MIN_COMPANIONS, is_on_line, is_relief, plane_of, second_plane, take_plane

# Columns of the result: unit normal (sign arbitrary), eigenvalues of the consistent covariance [m2], height of the
# point above the plane [m] (0 on a relief, whose plane is that around it), noise used to judge it [m], state, points
# that define the plane, radius of the neighbourhood [m], determinant reached by the h-subset (NaN where none was
# needed), distance to the sixth nearest [m], mean square height of all neighbours over the plane, far ones cut short
# [m2].
COLUMNS = (
    "nx",
    "ny",
    "nz",
    "lambda1",
    "lambda2",
    "lambda3",
    "height",
    "scale",
    "state",
    "n_inliers",
    "radius",
    "det",
    "near",
    "relief2",
)
N_COLUMNS = len(COLUMNS)
CLEAN, INLIER, SECOND, OUTLIER = 0, 1, 2, 3  # state of a point
FAR = 5.0
MOST = 0.7  # share of the neighbours
CHUNK = 256


@njit(cache=True, error_model="numpy")
def raw_factors(n: int) -> Any:
    """Return true over raw variance across and along a flat disc, for the h-subset with h = 0.55 n."""
    return 3.95 * (1.0 + 3.2 / n), 1.27 * (1.0 + 2.0 / n)


@njit(cache=True, error_model="numpy")
def reweighted_factor(n: int) -> float:
    """Return true over reweighted variance across a flat disc with nothing else known, after the n - 3 correction."""
    return 1.0 + 22.0 / (n + 14.0)


@njit(cache=True, error_model="numpy")
def final_factor(n: int) -> float:
    """Return the same after the second reweighting, for the median of lambda3.

    Of an odd number of points the subset of least determinant is a smaller share; from 17 on that is within 8 %.
    """
    odd = 1.23 * (9.0 / n) ** 3.5 if n % 2 == 1 and n < 17 else 0.0
    return (1.0 + 9.3 / n + 60.0 / n**2) * (1.0 + odd)


@njit(cache=True, fastmath=ORDER_FREE, error_model="numpy")
def weigh(x: Any, y: Any, z: Any, n: int, m: Any, c: Any, along: float, across2: float, w: Any, d2: Any) -> float:
    """Write weights 1 inside the ellipsoid of `CUT2` and 0 outside, and return the robust distance^2 of the origin.

    `along` scales the covariance in the plane; `across2` [m2] is the variance across it.
    """
    lambdas, v, height = plane_of(m, c)
    mahalanobis2(x, y, z, n, m, c, d2)
    least = max(lambdas[2], 1e-30)
    for i in range(n):
        h = v[0] * (x[i] - m[0]) + v[1] * (y[i] - m[1]) + v[2] * (z[i] - m[2])
        inside = (d2[i] - h * h / least) / along + h * h / across2
        w[i] = 1.0 if inside <= CUT2 else 0.0
    return height * height / across2


@njit(cache=True, error_model="numpy")
def clean_plane(x: Any, y: Any, z: Any, n: int, noise: float, limit: float, m: Any, c: Any) -> bool:
    """Tell whether the classical covariance will do: no wider across than noise makes it, and nobody far off."""
    lambdas, v, _ = plane_of(m, c)
    if not lambdas[2] * n / max(n - 3.0, 1.0) <= limit * noise * noise:
        return False
    worst = 0.0
    for i in range(n):
        h = v[0] * (x[i] - m[0]) + v[1] * (y[i] - m[1]) + v[2] * (z[i] - m[2])
        worst = max(worst, h * h)
    return worst <= 12.0 * noise * noise


@njit(cache=True, error_model="numpy")
def plane_of_most(
    x: Any, y: Any, z: Any, n: int, h: int, noise: float, limit: float, w: Any, d2: Any, work: Any
) -> Any:
    """Return (found, mean, covariance, lambda3) of a plane that `MOST` of the points keep to as noise alone makes them.

    No other plane then has h of them: what the minimum covariance determinant would end in, found in two concentration
    steps from the classical ellipsoid.
    """
    for i in range(n):
        w[i] = 1.0
    s, m, c = moments(x, y, z, w, n)
    for _ in range(3):
        mahalanobis2(x, y, z, n, m, c, d2)
        keep_smallest(d2, n, h, GUESS, w, work)
        _, m, c = moments(x, y, z, w, n)
    least = 0.0
    for _ in range(2):
        _, v, _ = plane_of(m, c)
        for i in range(n):
            height = v[0] * (x[i] - m[0]) + v[1] * (y[i] - m[1]) + v[2] * (z[i] - m[2])
            w[i] = 1.0 if height * height <= CUT2 * noise * noise else 0.0
        s, m, c = moments(x, y, z, w, n)
        least = eigenvalues(c)[2] * s / max(s - 3.0, 1.0)
        if not (s >= MOST * n and least <= limit * noise * noise):
            return False, m, c, least
    return True, m, c, least


@njit(cache=True, error_model="numpy")
def robust_plane(x: Any, y: Any, z: Any, n: int, h: int, noise: float, wide: Any, narrow: Any, pairs: Any) -> Any:
    """Return (mean, covariance, lambda3 free of bias, determinant); `w` holds 1 for the points of the plane.

    The covariance of least determinant is made consistent and used to weigh all points; what that gives weighs them
    once more (with few points the first is too uncertain). No point within the noise is cast out.
    """
    w, d2, work = wide[0], wide[1], wide[2]
    det = minimum_covariance_determinant(x, y, z, n, h, w, d2, work, narrow, pairs)
    _, m, c = moments(x, y, z, w, n)
    across, along = raw_factors(n)
    across2 = max(eigenvalues(c)[2] * across, noise * noise, FLOOR2)
    for _ in range(2):
        weigh(x, y, z, n, m, c, along, across2, w, d2)
        s, m, c = moments(x, y, z, w, n)
        least = eigenvalues(c)[2] * s / max(s - 3.0, 1.0)
        along, across2 = 1.0, max(least * reweighted_factor(n), noise * noise, FLOOR2)
    return m, c, least if noise > 0.0 else least * final_factor(n), det


@njit(cache=True, fastmath=ORDER_FREE, error_model="numpy")
def relief(x: Any, y: Any, z: Any, n: int, m: Any, v: Any, scale: float) -> float:
    """Return the mean square height [m2] of all neighbours, none counted for more than `FAR` times the scale."""
    total, limit = 0.0, (FAR * scale) ** 2
    for i in range(n):
        h = v[0] * (x[i] - m[0]) + v[1] * (y[i] - m[1]) + v[2] * (z[i] - m[2])
        total += min(h * h, limit)
    return total / n


@njit(cache=True, error_model="numpy")
def fit_tangent(
    x: Any, y: Any, z: Any, n: int, h: int, noise: float, limit: float, wide: Any, narrow: Any, pairs: Any
) -> Any:
    """Return the row of `COLUMNS` of the point at the origin, whose n neighbours (itself among them) are given."""
    w, d2, work = wide[0], wide[1], wide[2]
    radius2 = 0.0
    for i in range(n):
        w[i], d2[i] = 1.0, x[i] * x[i] + y[i] * y[i] + z[i] * z[i]
        radius2 = max(radius2, d2[i])
    radius, near = math.sqrt(radius2), math.sqrt(smallest(d2, n, min(n, MIN_COMPANIONS + 1), work))
    s, m, c = moments(x, y, z, w, n)
    state, scale, det = CLEAN, noise, math.nan
    least = eigenvalues(c)[2] * n / max(n - 3.0, 1.0)
    if not clean_plane(x, y, z, n, noise, limit, m, c):
        found, m, c, least = plane_of_most(x, y, z, n, h, noise, limit, w, d2, work)
        if not found:
            m, c, least, det = robust_plane(x, y, z, n, h, noise, wide, narrow, pairs)
        scale = math.sqrt(max(least, noise * noise))
        height = plane_of(m, c)[2]
        state = INLIER if height * height <= CUT2 * scale * scale else OUTLIER
    is_on_relief = False
    if state == OUTLIER:
        found, m2, c2, least2 = second_plane(x, y, z, n, radius, scale, w, d2, work)
        is_line = is_on_line(x, y, z, n, (m, c), radius, scale, narrow[0], d2, work)
        if is_line or not found:
            is_on_relief = is_relief(x, y, z, n, (m, c), scale, is_line, d2, work)
        if is_on_relief:  # nobody saw how its surface tilts: the plane around it stands
            state = SECOND
            take_plane(x, y, z, n, (m, c), scale, w)
        elif found:
            state, m, c, least = SECOND, m2, c2, least2
    s = 0.0
    for i in range(n):
        s += w[i]
    lambdas, v, height = plane_of(m, c)
    height = 0.0 if is_on_relief else height
    least = max(least, 0.0)
    relief2 = least if state == CLEAN else relief(x, y, z, n, m, v, scale) * n / max(n - 3.0, 1.0)
    return (v[0], v[1], v[2], lambdas[0], lambdas[1], least, height, scale, float(state), s, radius, det, near, relief2)


@njit(cache=True, parallel=True, error_model="numpy")
def fit_tangents(points: Any, which: Any, neighbours: Any, n_use: Any, noise: Any, limits: Any, share: float) -> Any:
    """Return (m, 14) rows of `COLUMNS` for the points `which`, each from its first `n_use` of `neighbours` (m, k)."""
    n_rows, k = neighbours.shape
    out = np.empty((n_rows, N_COLUMNS))
    for chunk in prange((n_rows + CHUNK - 1) // CHUNK):
        xyz, wide = np.empty((3, k)), np.empty((3, k))
        narrow, pairs = np.empty((NARROW_ROWS, k), dtype=np.float32), np.empty((2, k), dtype=np.int64)
        for r in range(chunk * CHUNK, min(n_rows, (chunk + 1) * CHUNK)):
            i, n = which[r], n_use[r]
            for j in range(n):
                q = neighbours[r, j]
                for axis in range(3):
                    xyz[axis, j] = points[q, axis] - points[i, axis]
            h = max((n + 4) // 2, int(share * n))
            row = fit_tangent(xyz[0], xyz[1], xyz[2], n, h, noise[r], limits[n], wide, narrow, pairs)
            for column in range(N_COLUMNS):
                out[r, column] = row[column]
    return out
