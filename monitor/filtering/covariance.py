"""Kernels of the covariance of a few points in space, and of the order of a few values.

Scalars and short arrays in, tuples out; nothing here knows of scans. Points are given by their coordinates x, y, z [m],
a covariance by its six elements (xx, xy, xz, yy, yz, zz). Sums are taken in the type of the arrays, float32 or float64.
"""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from monitor.filtering.selection import select

# Sums over a neighbourhood may be taken in vector order: it is fixed when compiling, hence the same for any threads.
ORDER_FREE = {"reassoc", "contract", "nsz"}
RIDGE = 1e-11  # of the trace: keeps the determinant of points that lie exactly in a plane above rounding
RIDGE_NARROW = 2e-7  # the same in float32
FLOOR2 = 1e-18  # m2, a nanometre: the same for points that coincide


@njit(cache=True, fastmath=ORDER_FREE, error_model="numpy")
def moments(x: Any, y: Any, z: Any, w: Any, n: int) -> Any:
    """Return the sum of the weights, the mean and the covariance of the points under weights `w`."""
    s = sx = sy = sz = xx = xy = xz = yy = yz = zz = x.dtype.type(0.0)
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
    f = 1.0 / s
    mx, my, mz = sx * f, sy * f, sz * f
    cxx, cyy, czz = xx * f - mx * mx, yy * f - my * my, zz * f - mz * mz
    ridge = (RIDGE if x.itemsize == 8 else RIDGE_NARROW) * (cxx + cyy + czz) + FLOOR2
    return (
        float(s),
        (mx, my, mz),
        (cxx + ridge, xy * f - mx * my, xz * f - mx * mz, cyy + ridge, yz * f - my * mz, czz + ridge),
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


@njit(cache=True, error_model="numpy")
def inverse(c: Any) -> Any:
    """Return the inverse of a covariance, as its six elements."""
    xx, xy, xz = c[3] * c[5] - c[4] * c[4], c[2] * c[4] - c[1] * c[5], c[1] * c[4] - c[2] * c[3]
    f = 1.0 / (c[0] * xx + c[1] * xy + c[2] * xz)
    yy, yz, zz = c[0] * c[5] - c[2] * c[2], c[1] * c[2] - c[0] * c[4], c[0] * c[3] - c[1] * c[1]
    return xx * f, xy * f, xz * f, yy * f, yz * f, zz * f


@njit(cache=True, fastmath=ORDER_FREE, error_model="numpy")
def mahalanobis2(x: Any, y: Any, z: Any, n: int, m: Any, c: Any, d2: Any) -> None:
    """Write the squared Mahalanobis distance of every point to (m, c) into `d2`."""
    kind = x.dtype.type
    xx, xy, xz, yy, yz, zz = inverse(c)
    xx, xy, xz, yy, yz, zz = kind(xx), kind(2.0 * xy), kind(2.0 * xz), kind(yy), kind(2.0 * yz), kind(zz)
    mx, my, mz, zero = kind(m[0]), kind(m[1]), kind(m[2]), kind(0.0)
    for i in range(n):
        a, b, d = x[i] - mx, y[i] - my, z[i] - mz
        d2[i] = max(a * (xx * a + xy * b + xz * d) + b * (yy * b + yz * d) + zz * d * d, zero)


@njit(cache=True, error_model="numpy")
def smallest(values: Any, n: int, h: int, work: Any) -> float:
    """Return the h-th smallest of `values` (1 is the least), which are left as they are; `work` is overwritten."""
    for i in range(n):
        work[i] = values[i]
    return select(work, n, h - 1)


@njit(cache=True, fastmath=ORDER_FREE, error_model="numpy")
def keep_smallest(values: Any, n: int, h: int, guess: float, w: Any, work: Any) -> float:
    """Give weight 1 to the h smallest of values that are not negative, 0 to the others; of equal ones the first win.

    The limit between them is found from `guess` by false position on the count, in loops without branches; selection
    comes in where values are equal. Return the limit.
    """
    kind = values.dtype.type
    one, zero = kind(1.0), kind(0.0)
    low, n_low, high, n_high, limit = 0.0, 0.0, math.inf, float(n), guess
    for _ in range(40):
        bound, counted = kind(limit), zero
        for i in range(n):
            counted += one if values[i] <= bound else zero
        if counted == h:
            for i in range(n):
                w[i] = one if values[i] <= bound else zero
            return limit
        if counted < h:
            low, n_low = limit, float(counted)
        else:
            high, n_high = limit, float(counted)
        if high == math.inf:
            limit = 3.0 * limit
        else:
            share = (h + 0.5 - n_low) / (n_high - n_low)
            limit = low + (high - low) * min(0.9, max(0.1, share))
    return _select_smallest(values, n, h, w, work)


@njit(cache=True, error_model="numpy")
def _select_smallest(values: Any, n: int, h: int, w: Any, work: Any) -> float:
    """Do the same as `keep_smallest` where the h-th value is shared."""
    limit = smallest(values, n, h, work)
    n_kept = 0
    for i in range(n):
        w[i] = 1.0 if values[i] < limit else 0.0
        n_kept += values[i] < limit
    for i in range(n):
        if n_kept < h and values[i] == limit:
            w[i] = 1.0
            n_kept += 1
    return limit
