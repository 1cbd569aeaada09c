"""What the uncertainty of a motion makes of distances along normals: `registration.covariance.propagate`, in threads.

In: the motion's covariance; points and normals, or rows of J. Out: one sigma of each point, or variances.
"""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.comparison.triangles import cross
from monitor.threads import run_tasks
from projects.model import Floats, Registration


def motion_sigma(registration: Registration, points: Floats, normals: Floats) -> Floats:
    """Return one sigma (n,) [m] along the unit normals (n, 3) that the uncertainty of the motion causes at points
    (n, 3) [m]: sqrt(n' J C J' n), J (w, t) = w x (x - c) + t."""
    out = np.empty(len(points))
    run_tasks(_propagate, len(out), np.asarray(registration.covariance, dtype=float),
              np.asarray(registration.centre, dtype=float), points, normals, out)  # fmt: skip
    return out


@jit(nopython=True, cache=True, nogil=True)
def _propagate(first, last, covariance, centre, points, normals, out):  # type: ignore[no-untyped-def]
    row = np.empty(6)
    for p in range(first, last):
        normal = (normals[p, 0], normals[p, 1], normals[p, 2])
        arm = (points[p, 0] - centre[0], points[p, 1] - centre[1], points[p, 2] - centre[2])
        row[:3], row[3:] = cross(arm, normal), normal
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
