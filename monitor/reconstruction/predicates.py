"""On which side of a plane or line a point lies, decided exactly.

Scalar kernels over tuples: the determinant in floating point where its rounding error cannot change the sign, else as
an exact sum of its terms. After Shewchuk, "Adaptive precision floating-point arithmetic and fast robust geometric
predicates" (1997); exact while no product of three coordinates under- or overflows.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

EPSILON = 2.0**-53
BOUND_3D = (7.0 + 56.0 * EPSILON) * EPSILON  # of the determinant's error, in its permanent; Shewchuk, section 4.3
BOUND_2D = (3.0 + 16.0 * EPSILON) * EPSILON
SPLITTER = 2.0**27 + 1.0
NONE = np.int64(0)  # parts yet; kernels are compiled anew for each integer written out in a call
MOST_TERMS = 100  # parts of an exact sum: 24 products of three numbers, each of four parts


@jit(nopython=True, cache=True)
def exact_room() -> Any:
    """Room for the exact sum of one determinant."""
    return np.empty(MOST_TERMS)


@jit(nopython=True, cache=True)
def exact_product(a: float, b: float) -> Any:
    """High and low part of a b, whose sum is exact (Dekker)."""
    high = a * b
    t = SPLITTER * a
    a1 = t - (t - a)
    a2 = a - a1
    t = SPLITTER * b
    b1 = t - (t - b)
    b2 = b - b1
    return high, a2 * b2 - (((high - a1 * b1) - a2 * b1) - a1 * b2)


@jit(nopython=True, cache=True)
def add_exactly(parts: Any, n: int, value: float) -> int:
    """Add a number to the sum of `parts[:n]`, which do not overlap and grow in size; returns how many there are now."""
    m, total = 0, value
    for i in range(n):
        part = parts[i]
        new = total + part
        seen = new - total
        error = (total - (new - seen)) + (part - seen)
        total = new
        if error != 0.0:
            parts[m] = error
            m += 1
    if total != 0.0:
        parts[m] = total
        m += 1
    return m


@jit(nopython=True, cache=True)
def add_product(parts: Any, n: int, a: float, b: float, c: float) -> int:
    """Add a b c to the sum of `parts[:n]` without error."""
    high, low = exact_product(a, b)
    for part in exact_product(high, c):
        n = add_exactly(parts, n, part)
    for part in exact_product(low, c):
        n = add_exactly(parts, n, part)
    return n


@jit(nopython=True, cache=True)
def add_triple(parts: Any, n: int, a: Any, b: Any, c: Any, sign: float) -> int:
    """Add sign a . (b x c) to the sum of `parts[:n]` without error."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        n = add_product(parts, n, sign * a[i], b[j], c[k])
        n = add_product(parts, n, -sign * a[i], b[k], c[j])
    return n


@jit(nopython=True, cache=True)
def side_of_plane(a: Any, b: Any, c: Any, d: Any, parts: Any) -> int:
    """Sign of (a - d) . ((b - d) x (c - d)): 1 where a, b, c turn clockwise seen from d, 0 where all lie in a plane."""
    ax, ay, az = a[0] - d[0], a[1] - d[1], a[2] - d[2]
    bx, by, bz = b[0] - d[0], b[1] - d[1], b[2] - d[2]
    cx, cy, cz = c[0] - d[0], c[1] - d[1], c[2] - d[2]
    determinant = az * (bx * cy - cx * by) + bz * (cx * ay - ax * cy) + cz * (ax * by - bx * ay)
    permanent = (
        abs(az) * (abs(bx * cy) + abs(cx * by))
        + abs(bz) * (abs(cx * ay) + abs(ax * cy))
        + abs(cz) * (abs(ax * by) + abs(bx * ay))
    )
    if abs(determinant) > BOUND_3D * permanent:
        return 1 if determinant > 0.0 else -1
    if permanent == 0.0:
        return 0
    n = add_triple(parts, NONE, a, b, c, 1.0)
    n = add_triple(parts, n, d, b, c, -1.0)
    n = add_triple(parts, n, a, d, c, -1.0)
    n = add_triple(parts, n, a, b, d, -1.0)
    return 0 if n == 0 else (1 if parts[n - 1] > 0.0 else -1)


@jit(nopython=True, cache=True)
def side_of_line(a: Any, b: Any, c: Any, u: int, v: int, parts: Any) -> int:
    """Sign of the area of a, b, c seen along the axis other than u and v: 1 where they turn counter-clockwise."""
    left, right = (a[u] - c[u]) * (b[v] - c[v]), (a[v] - c[v]) * (b[u] - c[u])
    determinant = left - right
    if abs(determinant) > BOUND_2D * (abs(left) + abs(right)):
        return 1 if determinant > 0.0 else -1
    if left == 0.0 and right == 0.0:
        return 0
    n = NONE
    for p, q in ((a, b), (b, c), (c, a)):
        n = add_product(parts, n, p[u], q[v], 1.0)
        n = add_product(parts, n, -p[v], q[u], 1.0)
    return 0 if n == 0 else (1 if parts[n - 1] > 0.0 else -1)
