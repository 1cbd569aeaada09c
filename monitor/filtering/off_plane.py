"""Kernels that tell what a point off the plane of its neighbours belongs to: another surface, a relief, or none.

In: the neighbours of a point at the origin, their robust plane and the noise that judges it; out: the second plane that
it has with others off the first, and whether it is of a relief finer than the points resolve (Nothegger and Dorninger,
fig. 8 a: an ornament seen by few points must not vanish).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from monitor.filtering.covariance import eigenvalues, eigenvector, moments, smallest
from monitor.filtering.silhouettes import RIM_GAP

MIN_COMPANIONS = 6
MAX_COMPANIONS = 16
CUT2 = 9.348403604496148  # chi-square, 3 degrees of freedom, 0.975 (Rousseeuw and van Driessen, reweighting step)
NARROW = 0.25  # of the greater variance of a plane or a line, at most, is the lesser
STEEPEST2 = 0.75  # squared sine of 60 degrees: a relief that rises more from the plane beside it may stand before air
NEXT, MIN_BESIDE = 8, 4  # nearest points; of so many of them a relief is where no line shows it, and rarely strays


@njit(cache=True, error_model="numpy")
def plane_of(m: Any, c: Any) -> Any:
    """Return eigenvalues and normal of a covariance, and the height of the origin above the plane through its mean."""
    largest, middle, least = eigenvalues(c)
    v = eigenvector(c, least)
    return (largest, middle, max(least, 0.0)), v, -(m[0] * v[0] + m[1] * v[1] + m[2] * v[2])


@njit(cache=True, error_model="numpy")
def find_companions(x: Any, y: Any, z: Any, n: int, radius: float, w: Any, d2: Any, work: Any) -> bool:
    """Give weight 1 to those nearest to the origin among the points of weight 0, outside of the plane, and 0 to others.

    False where they are too few, or not as near as the points of a surface within the neighbourhood's `radius` are.
    """
    n_out = 0
    for i in range(n):
        if w[i] == 0.0:
            work[n_out] = x[i] * x[i] + y[i] * y[i] + z[i] * z[i]
            n_out += 1
    if n_out < MIN_COMPANIONS:
        return False
    for i in range(n_out):
        d2[i] = work[i]
    reach2 = smallest(d2, n_out, min(n_out, MAX_COMPANIONS), work)
    near2 = smallest(d2, n_out, MIN_COMPANIONS, work)
    for i in range(n):
        w[i] = 1.0 if w[i] == 0.0 and x[i] * x[i] + y[i] * y[i] + z[i] * z[i] <= reach2 else 0.0
    return math.sqrt(near2) <= 3.0 * radius * math.sqrt(MIN_COMPANIONS / n)


@njit(cache=True, error_model="numpy")
def second_plane(x: Any, y: Any, z: Any, n: int, radius: float, scale: float, w: Any, d2: Any, work: Any) -> Any:
    """Return (found, mean, covariance, lambda3) of a surface that the origin has with points outside of the plane `w`.

    The other side of an edge, an ornament seen by few points: enough of them, as near as the points of a surface are,
    no thicker than the main plane's noise explains, and the origin among them.
    """
    if not find_companions(x, y, z, n, radius, w, d2, work):
        return False, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0), 0.0
    s, m, c = moments(x, y, z, w, n)
    lambdas, _, height = plane_of(m, c)
    least, limit = lambdas[2] * s / (s - 3.0), CUT2 * scale * scale
    return height * height <= limit and least <= limit and least <= NARROW * lambdas[1], m, c, least


@njit(cache=True, error_model="numpy")
def is_on_line(
    x: Any, y: Any, z: Any, n: int, plane: Any, radius: float, scale: float, w: Any, d2: Any, work: Any
) -> bool:
    """Tell whether the origin lies on a line with points as far off the plane (mean, covariance) as itself, within half
    of that: one of a scan, on a ridge or in a furrow. `w` is overwritten.

    A line of a scan lies in a plane with the scanner, and tells nothing of how its surface tilts.
    """
    m, (_, v, own) = plane[0], plane_of(plane[0], plane[1])
    for i in range(n):
        height = v[0] * (x[i] - m[0]) + v[1] * (y[i] - m[1]) + v[2] * (z[i] - m[2])
        w[i] = 0.0 if abs(height - own) <= 0.5 * abs(own) else 1.0  # 0: outside of the plane
    if not find_companions(x, y, z, n, radius, w, d2, work):
        return False
    s, m, c = moments(x, y, z, w, n)
    largest, middle, _ = eigenvalues(c)
    u, limit = eigenvector(c, largest), CUT2 * scale * scale
    along = m[0] * u[0] + m[1] * u[1] + m[2] * u[2]
    aside2 = m[0] * m[0] + m[1] * m[1] + m[2] * m[2] - along * along
    return middle * s / (s - 2.0) <= limit and middle <= NARROW * largest and aside2 <= limit


@njit(cache=True, error_model="numpy")
def take_plane(x: Any, y: Any, z: Any, n: int, plane: Any, scale: float, w: Any) -> None:
    """Write weights 1 for the points as near to the plane (mean, covariance) as noise explains, 0 for the others."""
    m, v = plane[0], plane_of(plane[0], plane[1])[1]
    for i in range(n):
        height = v[0] * (x[i] - m[0]) + v[1] * (y[i] - m[1]) + v[2] * (z[i] - m[2])
        w[i] = 1.0 if height * height <= CUT2 * scale * scale else 0.0


@njit(cache=True, error_model="numpy")
def is_relief(x: Any, y: Any, z: Any, n: int, plane: Any, scale: float, is_line: bool, d2: Any, work: Any) -> bool:
    """Tell whether the origin, off the plane (mean, covariance), is of a relief on it finer than the points resolve.

    It is on a line of points, or half of the nearest lie off the plane on its side; it rises no more steeply than
    `STEEPEST2` from the nearest point of the plane; and the plane is all around it: beside a silhouette, where mixed
    pixels are, it lies on one side.
    """
    m, (_, v, own) = plane[0], plane_of(plane[0], plane[1])
    for i in range(n):
        d2[i] = x[i] * x[i] + y[i] * y[i] + z[i] * z[i]
    next2, nearest2 = smallest(d2, n, min(n, NEXT + 1), work), math.inf
    n_beside, n_around, limit = -1, 0, math.sqrt(CUT2) * scale  # the origin is beside itself
    a, b, c = across(v)
    e, f, g = v[1] * c - v[2] * b, v[2] * a - v[0] * c, v[0] * b - v[1] * a
    for i in range(n):
        height = v[0] * (x[i] - m[0]) + v[1] * (y[i] - m[1]) + v[2] * (z[i] - m[2])
        if abs(height) > limit:
            n_beside += 1 if d2[i] <= next2 and height * own > 0.0 else 0
            continue
        nearest2 = min(nearest2, d2[i])
        work[n_around] = math.atan2(e * x[i] + f * y[i] + g * z[i], a * x[i] + b * y[i] + c * z[i])
        n_around += 1
    is_low = own * own <= STEEPEST2 * nearest2
    return is_low and (is_line or n_beside >= MIN_BESIDE) and widest_turn(work[:n_around]) < RIM_GAP


@njit(cache=True, error_model="numpy")
def across(v: Any) -> Any:
    """Return a unit vector across the unit vector v."""
    if abs(v[0]) <= abs(v[1]) and abs(v[0]) <= abs(v[2]):
        x, y, z = 0.0, v[2], -v[1]
    elif abs(v[1]) <= abs(v[2]):
        x, y, z = -v[2], 0.0, v[0]
    else:
        x, y, z = v[1], -v[0], 0.0
    f = 1.0 / math.sqrt(x * x + y * y + z * z)
    return x * f, y * f, z * f


@njit(cache=True, error_model="numpy")
def widest_turn(angles: Any) -> float:
    """Return the widest gap [rad] between directions (k,) [rad] around a place; all of a turn where there is none."""
    if len(angles) == 0:
        return 2.0 * math.pi
    turns = np.sort(angles)
    gap = turns[0] + 2.0 * math.pi - turns[-1]
    for i in range(1, len(turns)):
        gap = max(gap, turns[i] - turns[i - 1])
    return float(gap)
