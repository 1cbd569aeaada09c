"""The minimum covariance determinant of one neighbourhood (Rousseeuw and van Driessen 1999), as kernels.

In: coordinates x, y, z [m] of n points relative to the one that they surround; out: weights 1 for the h of them whose
covariance has the least determinant. That subset is the same in any coordinates that are an affine map of these: the
search runs in float32 along the axes of the whole and in units of its spread; what it finds is finished in float64.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from monitor.filtering.covariance import (
    ORDER_FREE,
    determinant,
    eigenvalues,
    eigenvector,
    inverse,
    keep_smallest,
    mahalanobis2,
    moments,
)

N_SHAPED = 9  # starts built from the shape of the whole
N_RANDOM = 100  # more at most, of four points each
N_MET = 6  # times that random starts meet the best before it is believed to be the best there is
NEAR = 1.3  # times the best so far: subsets that exchanges of two points may bring below it
SAME = 1e-3  # relative difference of determinants of one subset in float32, and of subsets that are as good
N_POOL = 8  # subsets kept
N_SURVIVORS = 2  # of these, finished in float64
GUESS = 5.0  # squared distance that about h of n points keep within
NARROW_ROWS = 7 + N_POOL  # of the float32 scratch


@njit(cache=True, fastmath=ORDER_FREE, error_model="numpy")
def _favour_leaving(d2: Any, w: Any, n: int, h: int) -> None:
    """Turn squared distances into what decides of an exchange: a / (1 - a) inside the subset, a outside of it.

    Taking out i and in j multiplies the determinant of the scatter by (1 - a_i)(1 + a_j) + a_ij^2, a = (1 + d2) / h
    (Hawkins 1994): without the last term the exchange pays where a_j < a_i / (1 - a_i).
    """
    one, share = d2.dtype.type(1.0), d2.dtype.type(1.0 / h)
    for i in range(n):
        a = (one + d2[i]) * share
        d2[i] = a / (one - a * w[i])


@njit(cache=True, error_model="numpy")
def descend(x: Any, y: Any, z: Any, n: int, h: int, w: Any, d2: Any, work: Any, last: Any) -> float:
    """Improve the subset `w` step by step as long as its determinant falls, and return that.

    The first is the concentration step of Rousseeuw and van Driessen (theorem 1: the h points nearest in Mahalanobis
    distance define the next subset); the following ones count how much farther a point is from a subset without it,
    which of h = 26 points is much: they end in optima that are two to four times as often the best.
    """
    _, m, c = moments(x, y, z, w, n)
    mahalanobis2(x, y, z, n, m, c, d2)
    keep_smallest(d2, n, h, GUESS, w, work)
    _, m, c = moments(x, y, z, w, n)
    det, limit = determinant(c), (1.0 + GUESS) / h
    for _ in range(60):
        for i in range(n):
            last[i] = w[i]
        mahalanobis2(x, y, z, n, m, c, d2)
        _favour_leaving(d2, w, n, h)
        limit = keep_smallest(d2, n, h, limit, w, work)
        _, m, c = moments(x, y, z, w, n)
        new = determinant(c)
        if not new < det * (1.0 - 1e-6):
            for i in range(n):
                w[i] = last[i]
            break
        det = new
    return det


@njit(cache=True, fastmath=ORDER_FREE | {"nnan"}, error_model="numpy")
def _margin(d2: Any, w: Any, n: int) -> Any:
    """Return the largest squared distance inside the subset and the least outside of it."""
    far = d2.dtype.type(1e30)
    farthest, nearest = d2.dtype.type(0.0), far
    for i in range(n):
        inside, outside = d2[i] * w[i], d2[i] + far * w[i]
        farthest = inside if inside > farthest else farthest
        nearest = outside if outside < nearest else nearest
    return float(farthest), float(nearest)


@njit(cache=True, error_model="numpy")
def exchange(x: Any, y: Any, z: Any, n: int, h: int, w: Any, d2: Any, pairs: Any) -> float:
    """Exchange one point of the subset `w` for one outside as long as that lowers the determinant; return it.

    Taking out i and in j multiplies the determinant of the scatter by (1 - a_ii)(1 + a_jj) + a_ij^2 with
    a_kl = (1 + (x_k - m)' C^-1 (x_l - m)) / h (Hawkins 1994). Only pairs for which the first term is below 1 can help.
    `pairs` (2, n) is scratch for their indices.
    """
    for _ in range(4 * n):
        _, m, c = moments(x, y, z, w, n)
        p = inverse(c)
        mahalanobis2(x, y, z, n, m, c, d2)
        farthest, nearest = _margin(d2, w, n)
        a_in, a_out = (1.0 + farthest) / h, (1.0 + nearest) / h
        least_in, most_out = h * a_out / (1.0 + a_out) - 1.0, h * a_in / (1.0 - a_in) - 1.0
        n_in = n_out = 0
        for i in range(n):
            pairs[0, n_in] = i
            n_in += w[i] > 0.0 and d2[i] > least_in
            pairs[1, n_out] = i
            n_out += w[i] == 0.0 and d2[i] < most_out
        best, leave, enter = 1.0 - 1e-9, -1, -1
        for k in range(n_in):
            i = pairs[0, k]
            a, b, d = x[i] - m[0], y[i] - m[1], z[i] - m[2]
            u, v, t = p[0] * a + p[1] * b + p[2] * d, p[1] * a + p[3] * b + p[4] * d, p[2] * a + p[4] * b + p[5] * d
            stay = 1.0 - (1.0 + d2[i]) / h
            for q in range(n_out):
                j = pairs[1, q]
                factor = stay * (1.0 + (1.0 + d2[j]) / h)
                factor += ((1.0 + u * (x[j] - m[0]) + v * (y[j] - m[1]) + t * (z[j] - m[2])) / h) ** 2
                if factor < best:
                    best, leave, enter = factor, i, j
        if leave < 0:
            break
        w[leave], w[enter] = 0.0, 1.0
    return determinant(c)


@njit(cache=True, error_model="numpy")
def _narrow(x: Any, y: Any, z: Any, n: int, m: Any, c: Any, u: Any, v: Any, t: Any) -> None:
    """Write coordinates in float32 along the axes of the covariance, the widest first, each in units of its spread."""
    largest, middle, least = eigenvalues(c)
    a, b = eigenvector(c, largest), eigenvector(c, least)
    fu, fv, ft = 1.0 / math.sqrt(largest), 1.0 / math.sqrt(max(middle, 1e-30)), 1.0 / math.sqrt(max(least, 1e-30))
    e0, e1, e2 = b[1] * a[2] - b[2] * a[1], b[2] * a[0] - b[0] * a[2], b[0] * a[1] - b[1] * a[0]
    for i in range(n):
        dx, dy, dz = x[i] - m[0], y[i] - m[1], z[i] - m[2]
        u[i] = fu * (a[0] * dx + a[1] * dy + a[2] * dz)
        v[i] = fv * (e0 * dx + e1 * dy + e2 * dz)
        t[i] = ft * (b[0] * dx + b[1] * dy + b[2] * dz)


@njit(cache=True, error_model="numpy")
def _write_start(start: int, x: Any, y: Any, z: Any, n: int, h: int, narrow: Any) -> None:
    """Write the weights of one start into row 3.

    0 the classical ellipsoid; 1 the points nearest to the centre; 2 the nearest quarter; 3-8 the upper and the lower
    share along each axis (a sheet behind a sheet, the two sides of an edge); then four points drawn by xorshift64
    (Marsaglia 2003), the same for the same number and n.
    """
    w, d2, work = narrow[3], narrow[4], narrow[5]
    if start >= N_SHAPED:
        _write_random_start(start, n, w)
        return
    n_kept = h
    if start == 0:
        for i in range(n):
            d2[i] = narrow[0, i] ** 2 + narrow[1, i] ** 2 + narrow[2, i] ** 2
    elif start <= 2:
        n_kept = h if start == 1 else max(5, n // 4)
        scale = 0.0
        for i in range(n):
            scale = max(scale, x[i] * x[i] + y[i] * y[i] + z[i] * z[i])
        scale = 10.0 / max(scale, 1e-30)
        for i in range(n):
            d2[i] = scale * (x[i] * x[i] + y[i] * y[i] + z[i] * z[i])
    else:
        axis, sign = narrow[(start - 3) // 2], 1.0 if start % 2 else -1.0
        least = math.inf
        for i in range(n):
            d2[i] = sign * axis[i]
            least = min(least, d2[i])
        for i in range(n):
            d2[i] -= least
    keep_smallest(d2, n, n_kept, GUESS, w, work)


@njit(cache=True, error_model="numpy")
def _write_random_start(number: int, n: int, w: Any) -> None:
    """Write weights 1 for four points drawn by their number."""
    state = np.uint64(88172645463325252) + np.uint64(number) * np.uint64(0x9E3779B97F4A7C15)
    for i in range(n):
        w[i] = 0.0
    n_drawn = 0
    while n_drawn < min(4, n):
        state ^= state << np.uint64(13)
        state ^= state >> np.uint64(7)
        state ^= state << np.uint64(17)
        drawn = (state >> np.uint64(33)) % np.uint64(n)
        if w[drawn] == 0.0:
            w[drawn] = 1.0
            n_drawn += 1


@njit(cache=True, error_model="numpy")
def _pool_place(dets: Any, det: float) -> int:
    """Return which row of the pool a subset of this determinant replaces: its like or the worst, -1 for none."""
    worst = 0
    for k in range(N_POOL):
        if abs(dets[k] - det) <= SAME * det:
            return k if det < dets[k] else -1
        if dets[k] > dets[worst]:
            worst = k
    return worst if det < dets[worst] else -1


@njit(cache=True, error_model="numpy")
def _search(x: Any, y: Any, z: Any, n: int, h: int, narrow: Any, pairs: Any, dets: Any) -> None:
    """Fill the pool (rows 7 on) with the best subsets; random starts follow until the best was met often enough."""
    u, v, t, w, d2, work, last = narrow[0], narrow[1], narrow[2], narrow[3], narrow[4], narrow[5], narrow[6]
    best, n_met = math.inf, 0
    for start in range(N_SHAPED + N_RANDOM):
        _write_start(start, x, y, z, n, h, narrow)
        det = descend(u, v, t, n, h, w, d2, work, last)
        if det < NEAR * best:
            det = exchange(u, v, t, n, h, w, d2, pairs)
        if det < best * (1.0 - SAME):
            best, n_met = det, 0
        if det <= best * (1.0 + SAME) and start >= N_SHAPED:
            n_met += 1
        place = _pool_place(dets, det)
        if place >= 0:
            dets[place] = det
            for i in range(n):
                narrow[7 + place, i] = w[i]
        if n_met >= N_MET:
            break


@njit(cache=True, error_model="numpy")
def minimum_covariance_determinant(
    x: Any, y: Any, z: Any, n: int, h: int, w: Any, d2: Any, work: Any, narrow: Any, pairs: Any
) -> float:
    """Write weights 1 for the h of n points whose covariance has the least determinant, and return it [m6].

    Scratch: `d2`, `work` (n,) float64, `narrow` (`NARROW_ROWS`, n) float32, `pairs` (2, n) int64.
    """
    for i in range(n):
        w[i] = 1.0
    _, m, c = moments(x, y, z, w, n)
    _narrow(x, y, z, n, m, c, narrow[0], narrow[1], narrow[2])
    dets = np.full(N_POOL, math.inf)
    _search(x, y, z, n, h, narrow, pairs, dets)
    best = math.inf
    for _ in range(N_SURVIVORS):
        k = int(np.argmin(dets))
        if dets[k] == math.inf:
            break
        dets[k] = math.inf
        for i in range(n):
            work[i] = narrow[7 + k, i]
        det = exchange(x, y, z, n, h, work, d2, pairs)
        if det < best:
            best = det
            for i in range(n):
                w[i] = work[i]
    return best
