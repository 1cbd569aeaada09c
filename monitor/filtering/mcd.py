"""Kernels of the minimum covariance determinant of one neighbourhood (Rousseeuw and van Driessen 1999).

Scalars and short arrays in, tuples out; nothing here knows of scans. A neighbourhood is given by its coordinates x, y,
z [m] relative to the point that it surrounds; a covariance by its six elements (xx, xy, xz, yy, yz, zz).
"""

from __future__ import annotations

import math
from typing import Any

from numba import njit

# Sums over a neighbourhood may be taken in vector order: it is fixed when compiling, hence the same for any threads.
ORDER_FREE = {"reassoc", "contract", "nsz"}
RIDGE = 1e-11  # of the trace: keeps the determinant of points that lie exactly in a plane above rounding
FLOOR2 = 1e-18  # m2, a nanometre: the same for points that coincide
N_STARTS = 9
N_SURVIVORS = 2


@njit(cache=True, fastmath=ORDER_FREE, error_model="numpy")
def moments(x: Any, y: Any, z: Any, w: Any, n: int) -> Any:
    """Return the sum of the weights, the mean and the covariance of the points under weights `w`."""
    s = sx = sy = sz = xx = xy = xz = yy = yz = zz = 0.0
    for i in range(n):
        wx, wy, wz = w[i] * x[i], w[i] * y[i], w[i] * z[i]
        s += w[i]
        sx += wx
        sy += wy
        sz += wz
        xx += wx * x[i]
        xy += wx * y[i]
        xz += wx * z[i]
        yy += wy * y[i]
        yz += wy * z[i]
        zz += wz * z[i]
    mx, my, mz = sx / s, sy / s, sz / s
    cxx, cyy, czz = xx / s - mx * mx, yy / s - my * my, zz / s - mz * mz
    ridge = RIDGE * (cxx + cyy + czz) + FLOOR2
    return (
        s,
        (mx, my, mz),
        (cxx + ridge, xy / s - mx * my, xz / s - mx * mz, cyy + ridge, yz / s - my * mz, czz + ridge),
    )


@njit(cache=True, error_model="numpy")
def determinant(c: Any) -> float:
    """Return the determinant of a covariance."""
    return c[0] * (c[3] * c[5] - c[4] * c[4]) - c[1] * (c[1] * c[5] - c[4] * c[2]) + c[2] * (c[1] * c[4] - c[3] * c[2])


@njit(cache=True, error_model="numpy")
def eigenvalues(c: Any) -> Any:
    """Return the eigenvalues of a symmetric 3 x 3 matrix, largest first (trigonometric solution of the cubic)."""
    q = (c[0] + c[3] + c[5]) / 3.0
    a, b, d = c[0] - q, c[3] - q, c[5] - q
    p2 = (a * a + b * b + d * d + 2.0 * (c[1] * c[1] + c[2] * c[2] + c[4] * c[4])) / 6.0
    if p2 <= 0.0:
        return q, q, q
    p = math.sqrt(p2)
    r = determinant((a, c[1], c[2], b, c[4], d)) / (2.0 * p * p2)
    phi = math.acos(min(1.0, max(-1.0, r))) / 3.0
    largest = q + 2.0 * p * math.cos(phi)
    least = q + 2.0 * p * math.cos(phi + 2.0 * math.pi / 3.0)
    return largest, 3.0 * q - largest - least, least


@njit(cache=True, error_model="numpy")
def eigenvector(c: Any, value: float) -> Any:
    """Return the unit eigenvector of `value`: the longest cross product of two rows of C - value I."""
    a, b, d = c[0] - value, c[3] - value, c[5] - value
    x1, y1, z1 = c[1] * c[4] - c[2] * b, c[2] * c[1] - a * c[4], a * b - c[1] * c[1]
    x2, y2, z2 = c[1] * d - c[2] * c[4], c[2] * c[2] - a * d, a * c[4] - c[1] * c[2]
    x3, y3, z3 = b * d - c[4] * c[4], c[4] * c[2] - c[1] * d, c[1] * c[4] - b * c[2]
    n1, n2, n3 = x1 * x1 + y1 * y1 + z1 * z1, x2 * x2 + y2 * y2 + z2 * z2, x3 * x3 + y3 * y3 + z3 * z3
    if n2 > n1 and n2 >= n3:
        x1, y1, z1, n1 = x2, y2, z2, n2
    elif n3 > n1:
        x1, y1, z1, n1 = x3, y3, z3, n3
    if n1 <= 0.0:
        return 0.0, 0.0, 1.0
    f = 1.0 / math.sqrt(n1)
    return x1 * f, y1 * f, z1 * f


@njit(cache=True, fastmath=ORDER_FREE, error_model="numpy")
def mahalanobis2(x: Any, y: Any, z: Any, n: int, m: Any, c: Any, d2: Any) -> None:
    """Write the squared Mahalanobis distance of every point to (m, c) into `d2`."""
    ixx, ixy, ixz = c[3] * c[5] - c[4] * c[4], c[2] * c[4] - c[1] * c[5], c[1] * c[4] - c[2] * c[3]
    f = 1.0 / (c[0] * ixx + c[1] * ixy + c[2] * ixz)
    ixx, ixy, ixz = ixx * f, ixy * f, ixz * f
    iyy, iyz = (c[0] * c[5] - c[2] * c[2]) * f, (c[1] * c[2] - c[0] * c[4]) * f
    izz = (c[0] * c[3] - c[1] * c[1]) * f
    for i in range(n):
        a, b, d = x[i] - m[0], y[i] - m[1], z[i] - m[2]
        d2[i] = a * (ixx * a + 2.0 * (ixy * b + ixz * d)) + b * (iyy * b + 2.0 * iyz * d) + izz * d * d


@njit(cache=True, error_model="numpy")
def smallest(values: Any, n: int, h: int, work: Any) -> float:
    """Return the h-th smallest of `values` (1 is the least); `work` is overwritten (Hoare's selection)."""
    for i in range(n):
        work[i] = values[i]
    low, high, k = 0, n - 1, h - 1
    while low < high:
        pivot = work[(low + high) >> 1]
        i, j = low, high
        while i <= j:
            while work[i] < pivot:
                i += 1
            while work[j] > pivot:
                j -= 1
            if i <= j:
                work[i], work[j] = work[j], work[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    return work[k]


@njit(cache=True, error_model="numpy")
def keep_smallest(values: Any, n: int, h: int, w: Any, work: Any) -> None:
    """Give weight 1 to the h smallest values and 0 to the others; of equal values the first ones win."""
    limit = smallest(values, n, h, work)
    n_below = 0
    for i in range(n):
        w[i] = 1.0 if values[i] < limit else 0.0
        n_below += values[i] < limit
    for i in range(n):
        if n_below < h and values[i] == limit:
            w[i] = 1.0
            n_below += 1


@njit(cache=True, error_model="numpy")
def concentrate(
    x: Any, y: Any, z: Any, n: int, h: int, m: Any, c: Any, n_steps: int, w: Any, d2: Any, work: Any
) -> Any:
    """Take up to `n_steps` concentration steps from (m, c): the h nearest in Mahalanobis distance define the next."""
    det = math.inf
    for _ in range(n_steps):
        mahalanobis2(x, y, z, n, m, c, d2)
        keep_smallest(d2, n, h, w, work)
        _, m, c = moments(x, y, z, w, n)
        new = determinant(c)
        if new >= det * (1.0 - 1e-12):
            det = min(det, new)
            break
        det = new
    return det, m, c


@njit(cache=True, fastmath=ORDER_FREE, error_model="numpy")
def _heights(x: Any, y: Any, z: Any, n: int, axis: Any, out: Any) -> None:
    """Write the coordinate of every point along `axis` into `out`."""
    for i in range(n):
        out[i] = axis[0] * x[i] + axis[1] * y[i] + axis[2] * z[i]


@njit(cache=True, error_model="numpy")
def write_start(
    start: int, x: Any, y: Any, z: Any, n: int, h: int, m: Any, c: Any, v: Any, w: Any, d2: Any, work: Any
) -> None:
    """Write the weights of one deterministic start; `m`, `c`, `v` are the classical mean, covariance and axes.

    0 the classical ellipsoid; 1 the points nearest to the centre; 2 those nearest to a plane through the nearest
    quarter; 3-8 the lower and the upper share along each axis (a sheet behind a sheet, the two sides of an edge).
    """
    if start == 0:
        mahalanobis2(x, y, z, n, m, c, d2)
        keep_smallest(d2, n, h, w, work)
    elif start <= 2:
        for i in range(n):
            d2[i] = x[i] * x[i] + y[i] * y[i] + z[i] * z[i]
        keep_smallest(d2, n, h if start == 1 else max(5, n // 4), w, work)
        if start == 2:
            _, near, spread = moments(x, y, z, w, n)
            mahalanobis2(x, y, z, n, near, spread, d2)
            keep_smallest(d2, n, h, w, work)
    else:
        sign = 1.0 if start % 2 else -1.0
        axis = v[(start - 3) // 2]
        _heights(x, y, z, n, (sign * axis[0], sign * axis[1], sign * axis[2]), d2)
        keep_smallest(d2, n, h, w, work)


@njit(cache=True, error_model="numpy")
def minimum_covariance_determinant(x: Any, y: Any, z: Any, n: int, h: int, w: Any, d2: Any, work: Any) -> Any:
    """Return determinant, mean and covariance of the h of n points whose covariance has the least determinant.

    Deterministic starts take two concentration steps each; the best few are brought to convergence
    (Rousseeuw and van Driessen 1999, section 3.3). `w`, `d2` and `work` are scratch of length n.
    """
    for i in range(n):
        w[i] = 1.0
    _, m, c = moments(x, y, z, w, n)
    largest, _, least = eigenvalues(c)
    v1, v3 = eigenvector(c, largest), eigenvector(c, least)
    v2 = (v3[1] * v1[2] - v3[2] * v1[1], v3[2] * v1[0] - v3[0] * v1[2], v3[0] * v1[1] - v3[1] * v1[0])
    best, bm, bc = math.inf, m, c
    second, sm, sc = math.inf, m, c
    for start in range(N_STARTS):
        write_start(start, x, y, z, n, h, m, c, (v3, v1, v2), w, d2, work)
        _, m0, c0 = moments(x, y, z, w, n)
        det, m0, c0 = concentrate(x, y, z, n, h, m0, c0, 2, w, d2, work)
        if det < best * (1.0 - 1e-9):
            second, sm, sc = best, bm, bc
            best, bm, bc = det, m0, c0
        elif det < second and det > best * (1.0 + 1e-9):
            second, sm, sc = det, m0, c0
    best, bm, bc = concentrate(x, y, z, n, h, bm, bc, 50, w, d2, work)
    if second < math.inf:
        second, sm, sc = concentrate(x, y, z, n, h, sm, sc, 50, w, d2, work)
        if second < best:
            best, bm, bc = second, sm, sc
    return best, bm, bc
