"""Kernels of the minimum covariance determinant of one neighbourhood (Rousseeuw and van Driessen 1999).

Scalars and short arrays in, tuples out; nothing here knows of scans. A neighbourhood is given by its coordinates x, y,
z [m] relative to the point that it surrounds; a covariance by its six elements (xx, xy, xz, yy, yz, zz).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

# Sums over a neighbourhood may be taken in vector order: it is fixed when compiling, hence the same for any threads.
ORDER_FREE = {"reassoc", "contract", "nsz"}
RIDGE = 1e-11  # of the trace: keeps the determinant of points that lie exactly in a plane above rounding
FLOOR2 = 1e-18  # m2, a nanometre: the same for points that coincide
N_STARTS = 9
N_STEPS = 3  # concentration steps of each start
N_SURVIVORS = 4  # starts that are brought to their optimum
WIDTH = 8  # points on either side that are tried for an exchange


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
    xx, xy, xz, yy, yz, zz = inverse(c)
    for i in range(n):
        a, b, d = x[i] - m[0], y[i] - m[1], z[i] - m[2]
        d2[i] = max(a * (xx * a + 2.0 * (xy * b + xz * d)) + b * (yy * b + 2.0 * yz * d) + zz * d * d, 0.0)


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


@njit(cache=True, fastmath=ORDER_FREE, error_model="numpy")
def keep_smallest(values: Any, n: int, h: int, w: Any, work: Any) -> None:
    """Give weight 1 to the h smallest of values that are not negative, 0 to the others; of equal ones the first win.

    The limit between them is found by false position on the count, a loop without branches; selection comes in where
    values are equal.
    """
    low, n_low, high, n_high = 0.0, 0.0, 0.0, float(n)
    for i in range(n):
        high = max(high, values[i])
    limit = high * h / n
    for _ in range(40):
        count = 0.0
        for i in range(n):
            w[i] = 1.0 if values[i] <= limit else 0.0
            count += w[i]
        if count == h:
            return
        if count < h:
            low, n_low = limit, count
        else:
            high, n_high = limit, count
        share = (h - n_low) / (n_high - n_low)
        limit = low + (high - low) * min(0.9, max(0.1, share))
    _select_smallest(values, n, h, w, work)


@njit(cache=True, error_model="numpy")
def _select_smallest(values: Any, n: int, h: int, w: Any, work: Any) -> None:
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


@njit(cache=True, error_model="numpy")
def concentrate(x: Any, y: Any, z: Any, n: int, h: int, n_steps: int, w: Any, d2: Any, work: Any) -> float:
    """Take up to `n_steps` concentration steps from the subset `w` and return the determinant of the last.

    The h points nearest in Mahalanobis distance define the next subset (Rousseeuw and van Driessen, theorem 1).
    """
    _, m, c = moments(x, y, z, w, n)
    det = math.inf
    for _ in range(n_steps):
        mahalanobis2(x, y, z, n, m, c, d2)
        keep_smallest(d2, n, h, w, work)
        _, m, c = moments(x, y, z, w, n)
        new = determinant(c)
        if new >= det * (1.0 - 1e-12):
            break
        det = new
    return det


@njit(cache=True, error_model="numpy")
def _insert(order: Any, n_order: int, d2: Any, i: int, sign: float) -> int:
    """Insert i into the first `WIDTH` of `order`, kept by falling sign * d2; return how many there are."""
    if n_order == WIDTH and sign * d2[i] <= sign * d2[order[WIDTH - 1]]:
        return n_order
    place = min(n_order, WIDTH - 1)
    while place > 0 and sign * d2[order[place - 1]] < sign * d2[i]:
        order[place] = order[place - 1]
        place -= 1
    order[place] = i
    return min(n_order + 1, WIDTH)


@njit(cache=True, error_model="numpy")
def exchange(x: Any, y: Any, z: Any, n: int, h: int, w: Any, d2: Any, inside: Any, outside: Any) -> float:
    """Exchange one point of the subset `w` for one outside as long as that lowers the determinant; return it.

    A concentration step cannot see that pair: taking out i and in j multiplies the determinant of the scatter by
    (1 - a_ii)(1 + a_jj) + a_ij^2 with a_kl = (1 + (x_k - m)' C^-1 (x_l - m)) / h (Hawkins 1994), which may be below 1
    although a_jj > a_ii. The `WIDTH` farthest inside and nearest outside are tried.
    """
    for _ in range(4 * n):
        _, m, c = moments(x, y, z, w, n)
        p = inverse(c)
        mahalanobis2(x, y, z, n, m, c, d2)
        n_in = n_out = 0
        for i in range(n):
            if w[i] > 0.0:
                n_in = _insert(inside, n_in, d2, i, 1.0)
            else:
                n_out = _insert(outside, n_out, d2, i, -1.0)
        best, leave, enter = 1.0 - 1e-9, -1, -1
        for i in inside[:n_in]:
            a, b, d = x[i] - m[0], y[i] - m[1], z[i] - m[2]
            u, v, t = p[0] * a + p[1] * b + p[2] * d, p[1] * a + p[3] * b + p[4] * d, p[2] * a + p[4] * b + p[5] * d
            for j in outside[:n_out]:
                factor = (1.0 - (1.0 + d2[i]) / h) * (1.0 + (1.0 + d2[j]) / h)
                if factor >= best:
                    break
                factor += ((1.0 + u * (x[j] - m[0]) + v * (y[j] - m[1]) + t * (z[j] - m[2])) / h) ** 2
                if factor < best:
                    best, leave, enter = factor, i, j
        if leave < 0:
            break
        w[leave], w[enter] = 0.0, 1.0
    return determinant(c)


@njit(cache=True, fastmath=ORDER_FREE, error_model="numpy")
def _heights(x: Any, y: Any, z: Any, n: int, axis: Any, out: Any) -> None:
    """Write how far every point lies along `axis` from the least of them into `out`."""
    least = math.inf
    for i in range(n):
        out[i] = axis[0] * x[i] + axis[1] * y[i] + axis[2] * z[i]
        least = min(least, out[i])
    for i in range(n):
        out[i] -= least


@njit(cache=True, error_model="numpy")
def write_start(
    start: int, x: Any, y: Any, z: Any, n: int, h: int, m: Any, c: Any, v: Any, w: Any, d2: Any, work: Any
) -> None:
    """Write the weights of one deterministic start; `m`, `c`, `v` are the classical mean, covariance and axes.

    0 the classical ellipsoid; 1 the points nearest to the centre; 2 the nearest quarter; 3-8 the lower and the upper
    share along each axis (a sheet behind a sheet, the two sides of an edge).
    """
    n_kept = h
    if start == 0:
        mahalanobis2(x, y, z, n, m, c, d2)
    elif start <= 2:
        n_kept = h if start == 1 else max(5, n // 4)
        for i in range(n):
            d2[i] = x[i] * x[i] + y[i] * y[i] + z[i] * z[i]
    else:
        sign = 1.0 if start % 2 else -1.0
        axis = v[(start - 3) // 2]
        _heights(x, y, z, n, (sign * axis[0], sign * axis[1], sign * axis[2]), d2)
    keep_smallest(d2, n, n_kept, w, work)


@njit(cache=True, error_model="numpy")
def minimum_covariance_determinant(
    x: Any, y: Any, z: Any, n: int, h: int, w: Any, d2: Any, work: Any, subsets: Any
) -> float:
    """Write weights 1 for the h of n points whose covariance has the least determinant, and return it [m6].

    Deterministic starts take a few concentration steps each (Rousseeuw and van Driessen 1999, section 3.3); the best
    are brought to where no exchange of a pair helps. `d2`, `work` (n,) and `subsets` (`N_STARTS` + 2, n) are scratch.
    """
    for i in range(n):
        w[i] = 1.0
    _, m, c = moments(x, y, z, w, n)
    largest, _, least = eigenvalues(c)
    v1, v3 = eigenvector(c, largest), eigenvector(c, least)
    v2 = (v3[1] * v1[2] - v3[2] * v1[1], v3[2] * v1[0] - v3[0] * v1[2], v3[0] * v1[1] - v3[1] * v1[0])
    dets, inside, outside = np.empty(N_STARTS), np.empty(WIDTH, dtype=np.int64), np.empty(WIDTH, dtype=np.int64)
    for start in range(N_STARTS):
        subset = subsets[start]
        write_start(start, x, y, z, n, h, m, c, (v3, v1, v2), subset, d2, work)
        dets[start] = concentrate(x, y, z, n, h, N_STEPS, subset, d2, work)
    best = math.inf
    for _ in range(N_SURVIVORS):
        start = int(np.argmin(dets))
        if dets[start] == math.inf:
            break
        same = dets[start] * (1.0 + 1e-9)
        for other in range(N_STARTS):  # starts that met are one
            if dets[other] <= same:
                dets[other] = math.inf
        det = exchange(x, y, z, n, h, subsets[start], d2, inside, outside)
        if det < best:
            best = det
            for i in range(n):
                w[i] = subsets[start, i]
    return best
