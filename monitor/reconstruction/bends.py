"""A patch of fourth degree over a window, and what it leaves of the points: nothing, where a surface only bends.

In: points (u, v, z) of a window in units of its radius. Out: what the patch leaves of each. Half a wave or one over a
window is hardly another thing than a bend, which smooth fits follow by themselves.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

from monitor.reconstruction.quadric import factorise, substitute
from projects.model import Floats

N_FOURTH = 15  # coefficients of a patch of fourth degree
POWERS = np.array([(d - k, k) for d in range(5) for k in range(d + 1)])  # of u and v


@jit(nopython=True, cache=True)
def write_powers(u: float, v: float, row: Floats) -> None:
    """Write the 15 terms at a place."""
    uu, uv, vv = u * u, u * v, v * v
    row[0], row[1], row[2], row[3], row[4], row[5] = 1.0, u, v, uu, uv, vv
    row[6], row[7], row[8], row[9] = uu * u, uu * v, u * vv, vv * v
    row[10], row[11], row[12], row[13], row[14] = uu * uu, uu * uv, uu * vv, uv * vv, vv * vv


@jit(nopython=True, cache=True)
def sum_moments(w: Any, n: int, moments: Floats, rhs: Floats) -> None:
    """Add up u^i v^j over the points, all that products of two terms need, and the terms times the heights."""
    row = np.empty(N_FOURTH)
    for i in range(n):
        u, v, z = w.u[i], w.v[i], w.z[i]
        power_u = 1.0
        for a in range(9):
            power = power_u
            for b in range(9 - a):
                moments[a, b] += power
                power *= v
            power_u *= u
        write_powers(u, v, row)
        for a in range(N_FOURTH):
            rhs[a] += row[a] * z


@jit(nopython=True, cache=True, error_model="numpy")
def leave_of_bend(w: Any, n: int) -> float:
    """Write what a patch of fourth degree leaves of the heights of n points into `left`; its mean square for each that
    is free, NaN where there is none."""
    moments, rhs, matrix = np.zeros((9, 9)), np.zeros(N_FOURTH), np.empty((N_FOURTH, N_FOURTH))
    sum_moments(w, n, moments, rhs)
    for a in range(N_FOURTH):
        for b in range(a + 1):
            matrix[a, b] = moments[POWERS[a, 0] + POWERS[b, 0], POWERS[a, 1] + POWERS[b, 1]]
    if n <= 2 * N_FOURTH or not factorise(matrix, N_FOURTH):
        return np.nan
    substitute(matrix, rhs, N_FOURTH)
    row, squares = np.empty(N_FOURTH), 0.0
    for i in range(n):
        write_powers(w.u[i], w.v[i], row)
        height = 0.0
        for a in range(N_FOURTH):
            height += rhs[a] * row[a]
        w.left[i] = w.z[i] - height
        squares += w.left[i] ** 2
    return squares / (n - N_FOURTH)
