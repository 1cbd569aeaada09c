"""The solver of a tile's field: conjugate gradients, preconditioned by a modified incomplete factor.

The operator is A = L + S: the graph Laplacian of the band's nodes, and the screening, of which each cell with points
adds pull w w' over the weights w of its eight corners. The factor (D + E) D^-1 (D + E') has the strictly lower part E
of L, and a diagonal D that takes up what it fills in (Gustafsson, "A class of first order factorization methods", BIT
18, 1978), from L and the row sums of S: what varies slowly along the surface is solved for nearly at once. In the
form of Eisenstat, "Efficient implementation of a class of preconditioned conjugate gradient methods", SIAM J. Sci.
Stat. Comput. 2, 1981: A is the factor's two triangles and a diagonal, so that two substitutions stand for the
product too. Vectors hold one node more than there are, always zero: what a missing link points to.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

MODIFIED = np.float32(0.97)  # share of what the factor fills in that its diagonal takes up
LEAST_PIVOT = np.float32(0.1)  # of a node's own diagonal


@jit(nopython=True, cache=True, nogil=True, fastmath=True)  # no NaN inside; the order is fixed by the compiled code
def solve_field(x: Any, rhs: Any, links: Any, screening: Any, is_fixed: Any, tolerance: float, most: int) -> int:
    """Solve A x = rhs in place, from `x` on; fixed nodes keep their values. Return the number of iterations.

    Parameters
    ----------
    x, rhs : (n,) float32; the first field, in cells.
    links : (2, 3, n) uint32, neighbours up and down along each axis; n where there is none (`band.link_nodes`).
    screening : corners (k, 8) of cells, weights (k, 8) that sum to 1, pull (k,).
    is_fixed : (n,) bool.
    tolerance : rms residual in cells, by the factor's inverse, at which to stop; after `most` iterations in any case.
    """
    n: Any = np.uint64(x.shape[0])  # unsigned, as of `link_nodes`
    up, down = links[0], links[1]
    screening = (screening[0].astype(np.uint32), screening[1], screening[2])
    degree, held = row_sums(links, screening)
    diagonal, inverse = factor(degree, held, links, is_fixed)
    p, q = np.zeros(n, np.float32), held
    y, z = np.zeros(n + 1, np.float32), np.zeros(n + 1, np.float32)
    y[:n] = x
    r = rhs.copy()
    subtract_product(y, r, degree, links, screening)
    rr = 0.0
    for i in range(n):
        z[i] = inverse[i] * ((r[i] + z[down[0, i]]) + (z[down[1, i]] + z[down[2, i]]))
        r[i] = z[i]  # from here on the residual behind the first substitution
        rr += diagonal[i] * r[i] * r[i]
    y[:] = np.float32(0.0)
    turn, n_iterations = np.float32(0.0), 0
    while n_iterations < most and rr > tolerance * tolerance * n:
        for k in range(n):
            i = n - np.uint64(1) - k
            v = r[i] + turn * p[i]
            p[i] = v
            w = v + inverse[i] * ((y[up[0, i]] + y[up[1, i]]) + y[up[2, i]])
            y[i] = w
            q[i] = diagonal[i] * (v - np.float32(2.0) * w) + degree[i] * w
        add_screening(y, q, screening, np.float32(1.0))
        for i in range(n):
            z[i] = inverse[i] * ((q[i] + z[down[0, i]]) + (z[down[1, i]] + z[down[2, i]]))
        pq = 0.0
        for i in range(n):
            q[i] = y[i] + z[i]
            pq += p[i] * diagonal[i] * q[i]
        step, last, rr = np.float32(rr / pq), rr, 0.0
        for i in range(n):
            x[i] += step * y[i]
            r[i] -= step * q[i]
            rr += diagonal[i] * r[i] * r[i]
        turn = np.float32(rr / last)
        n_iterations += 1
    return n_iterations


@jit(nopython=True, cache=True, nogil=True)
def row_sums(links: Any, screening: Any) -> Any:
    """Diagonal (n,) of the Laplacian and row sums (n,) of the screening."""
    corners, weights, pull = screening
    n = np.uint64(links.shape[2])
    degree, held = np.zeros(n, np.float32), np.zeros(n, np.float32)
    for side in range(2):
        for axis in range(3):
            for i in range(n):
                degree[i] += np.float32(links[side, axis, i] < n)
    for c in range(np.uint64(corners.shape[0])):
        for k in range(8):
            held[corners[c, k]] += pull[c] * weights[c, k]
    return degree, held


@jit(nopython=True, cache=True, nogil=True)
def factor(degree: Any, held: Any, links: Any, is_fixed: Any) -> Any:
    """Diagonal (n,) of the factor, and its inverse; both zero at fixed nodes, which thus stay out of all sums."""
    n = np.uint64(degree.shape[0])
    down = links[1]
    fill = np.zeros(n + 1, np.float32)
    diagonal, inverse = np.zeros(n, np.float32), np.zeros(n, np.float32)
    for i in range(n):
        if is_fixed[i]:
            continue
        own = degree[i] + held[i]
        left = own - ((fill[down[0, i]] + fill[down[1, i]]) + fill[down[2, i]])
        diagonal[i] = max(left, LEAST_PIVOT * own + np.float32(1e-6))
        inverse[i] = np.float32(1.0) / diagonal[i]
        n_up = 0
        for axis in range(3):
            n_up += links[0, axis, i] < n
        fill[i] = inverse[i] * (np.float32(1.0) + MODIFIED * np.float32(n_up - 1))
    return diagonal, inverse


@jit(nopython=True, cache=True, nogil=True, fastmath=True)
def subtract_product(y: Any, out: Any, degree: Any, links: Any, screening: Any) -> None:
    """Take A y off `out` (n,); `y` (n + 1,) ends with zero."""
    up, down = links[0], links[1]
    for i in range(np.uint64(out.shape[0])):
        out[i] -= degree[i] * y[i] - (
            (y[up[0, i]] + y[up[1, i]]) + (y[up[2, i]] + y[down[0, i]]) + (y[down[1, i]] + y[down[2, i]])
        )
    add_screening(y, out, screening, np.float32(-1.0))


@jit(nopython=True, cache=True, nogil=True, fastmath=True)
def add_screening(y: Any, out: Any, screening: Any, times: Any) -> None:
    """Add `times` S y to `out`."""
    corners, weights, pull = screening
    for c in range(np.uint64(corners.shape[0])):
        v = np.float32(0.0)
        for k in range(8):
            v += weights[c, k] * y[corners[c, k]]
        v *= times * pull[c]
        for k in range(8):
            out[corners[c, k]] += v * weights[c, k]
