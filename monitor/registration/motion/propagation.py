"""What the uncertainty of a motion makes of distances along normals, in threads.

In: the motion's covariance; points and normals, or rows of J. Out: one sigma of each point, or variances.
"""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.threads import run_tasks
from projects.errors import ShapeError
from projects.model import Floats


def propagate(covariance: Floats, centre: Floats, points: Floats, normals: Floats) -> Floats:
    """Return one sigma (n,) [m] along the normal that the uncertainty of a motion causes at each point.

    Parameters
    ----------
    covariance : (6, 6) of (w, t) about `centre`, rad and m.
    centre : (3,), m, target frame.
    points, normals : (n, 3), target frame, m and unit vectors.

    Returns
    -------
    sigma : (n,) m, sqrt(n' J C J' n); NaN where the normal is unknown.

    Notes
    -----
    A point moves by J (w, t) = w x (x - c) + t, so along n by ((x - c) x n) . w + n . t: it grows with the lever arm.
    """
    if np.shape(covariance) != (6, 6) or np.shape(points) != np.shape(normals):
        raise ShapeError(f"covariance {np.shape(covariance)}, points {np.shape(points)}, normals {np.shape(normals)}; "
                         "(6, 6) and twice (n, 3) are needed")  # fmt: skip
    out = np.empty(len(points))
    run_tasks(_propagate, len(out), np.asarray(covariance, dtype=float), np.asarray(centre, dtype=float),
              np.asarray(points, dtype=float), np.asarray(normals, dtype=float), out)  # fmt: skip
    return out


@jit(nopython=True, cache=True, nogil=True)
def _propagate(first, last, covariance, centre, points, normals, out):  # type: ignore[no-untyped-def]
    row = np.empty(6)
    for p in range(first, last):
        x, y, z = points[p, 0] - centre[0], points[p, 1] - centre[1], points[p, 2] - centre[2]
        a, b, c = normals[p, 0], normals[p, 1], normals[p, 2]
        row[0], row[1], row[2] = y * c - z * b, z * a - x * c, x * b - y * a
        row[3], row[4], row[5] = a, b, c
        out[p] = np.sqrt(_variance(covariance, row))


def motion_variance(covariance: Floats, rows: Floats) -> Floats:
    """Return the variance (n,) [m2] of J (w, t) for rows J (n, 6)."""
    out = np.empty(len(rows))
    run_tasks(_square, len(out), np.asarray(covariance, dtype=float), rows, out)
    return out


@jit(nopython=True, cache=True, nogil=True)
def _square(first, last, covariance, rows, out):  # type: ignore[no-untyped-def]
    for p in range(first, last):
        out[p] = _variance(covariance, rows[p])


@jit(nopython=True, cache=True)
def _variance(covariance, row):  # type: ignore[no-untyped-def]
    """Return row C row', not below 0; NaN where the row is."""
    total = 0.0
    for i in range(6):
        for j in range(6):
            total += row[i] * covariance[i, j] * row[j]
    return total if not total < 0.0 else 0.0
