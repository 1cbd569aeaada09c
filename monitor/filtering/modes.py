"""The mode of the measurements in a cylinder about the mean normal (Nothegger and Dorninger, section 2.4).

In: the points of each cylinder and its axis; out: its representative, with how many it stands for and how well it is
known.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from monitor.filtering.covariance import smallest
from monitor.robust import MAD_TO_SIGMA

MODE_WIDTH = 4.0  # half width of the kernel in sigmas of the noise
MODE_SPREAD = 1.05  # standard error of that mode over that of the mean, normal errors (simulated: test_thinning.py)
SLOPE_SHARE = 0.9  # of members over neighbourhood size: what the errors of their normals add; see `_represent`
CARRY = 0.5  # of its own slope, along which a height is carried where the surface is not smooth: `_represent`


@njit(cache=True, error_model="numpy")
def density_mode(heights: Any, weights: Any, n: int, width: float) -> float:
    """Return the mode of the density of `heights` under the triweight kernel (1 - u^2)^3 of half width `width`.

    Its stationary points are those of Tukey's biweight location estimate; the one of greatest density is taken, found
    from the best of the heights by fixed-point iteration.
    """
    best, mode = -1.0, 0.0
    for i in range(n):
        density = 0.0
        for j in range(n):
            u = (heights[j] - heights[i]) / width
            if abs(u) < 1.0:
                density += weights[j] * (1.0 - u * u) ** 3
        if density > best:
            best, mode = density, heights[i]
    for _ in range(30):
        total = moved = 0.0
        for j in range(n):
            u = (heights[j] - mode) / width
            if abs(u) < 1.0:
                w = weights[j] * (1.0 - u * u) ** 2
                total += w
                moved += w * heights[j]
        step = moved / total - mode
        mode += step
        if abs(step) < 1e-6 * width:
            break
    return mode


@njit(cache=True, error_model="numpy")
def _represent(
    points: Any,
    normals: Any,
    noise: Any,
    is_bent: Any,
    sizes: Any,
    merged: Any,
    found: Any,
    n: int,
    axis: Any,
    heights: Any,
    weights: Any,
) -> Any:
    """Return of a representative its point, the member nearest to the mode, measurements, spread and sigma.

    Where the surface `is_bent`, not smooth, a member's height is carried to the axis along half of its own slope,
    which is exact on surfaces of second order, so that curvature neither shifts nor widens the distribution. The
    normals' own errors then add to those of the mode as `SLOPE_SHARE` times members over neighbourhood size (measured
    on planes).
    """
    cx = cy = cz = noise2 = total = total2 = 0.0
    for j in range(n):
        q = found[j]
        weights[j] = merged[q]
        total += merged[q]
        total2 += merged[q] * merged[q]
        cx += merged[q] * points[q, 0]
        cy += merged[q] * points[q, 1]
        cz += merged[q] * points[q, 2]
        noise2 += merged[q] * noise[q] * noise[q]
    cx, cy, cz, sigma = cx / total, cy / total, cz / total, math.sqrt(noise2 / total)
    for j in range(n):
        q = found[j]
        dx, dy, dz = points[q, 0] - cx, points[q, 1] - cy, points[q, 2] - cz
        height = dx * axis[0] + dy * axis[1] + dz * axis[2]
        along = normals[q, 0] * axis[0] + normals[q, 1] * axis[1] + normals[q, 2] * axis[2]
        aside = normals[q, 0] * dx + normals[q, 1] * dy + normals[q, 2] * dz - along * height
        heights[j] = height + (CARRY * aside / along if is_bent[q] else 0.0)
    mode = density_mode(heights, weights, n, MODE_WIDTH * max(sigma, 1e-9)) if n > 1 else 0.0
    nearest, gap = found[0], math.inf
    for j in range(n):
        if abs(heights[j] - mode) < gap:
            nearest, gap = found[j], abs(heights[j] - mode)
        weights[j] = abs(heights[j] - mode)
    # The factor n / (n - 0.8) is that of Croux and Rousseeuw (1992) for few values. Few members say little of their
    # spread: the noise around counts as the spread of ten more.
    own = MAD_TO_SIGMA * n / (n - 0.8) * smallest(weights, n, n // 2 + 1, heights) if n > 4 else sigma
    spread = math.sqrt((max(n - 1, 0) * own * own + 10.0 * sigma * sigma) / (max(n - 1, 0) + 10.0))
    spread2 = 1.0
    if n > 1:
        spread2 = MODE_SPREAD**2 + (2.0 * CARRY * SLOPE_SHARE * n / sizes[nearest] if is_bent[nearest] else 0.0)
    point = (cx + mode * axis[0], cy + mode * axis[1], cz + mode * axis[2])
    return point, nearest, total, spread, spread * math.sqrt(spread2 * total2) / total


@njit(cache=True, error_model="numpy")
def represent_all(
    points: Any,
    normals: Any,
    noise: Any,
    is_bent: Any,
    sizes: Any,
    merged: Any,
    members: Any,
    starts: Any,
    order: Any,
    axes: Any,
) -> Any:
    """Return points, nearest members, measurements, spreads and sigmas of all representatives, whose axes are given.

    They are made in an order by which neighbours follow another.
    """
    n_all, n_most = len(axes), 1
    for i in range(n_all):
        n_most = max(n_most, starts[i + 1] - starts[i])
    heights, weights = np.empty(n_most), np.empty(n_most)
    places, nearest, n_merged = np.empty((n_all, 3)), np.empty(n_all, dtype=np.int32), np.empty(n_all, dtype=np.int32)
    spread, sigma = np.empty(n_all), np.empty(n_all)
    about = (normals, noise, is_bent, sizes, merged)
    for i in order:
        found = members[starts[i] : starts[i + 1]]
        axis = (axes[i, 0], axes[i, 1], axes[i, 2])
        point, nearest[i], total, spread[i], sigma[i] = _represent(
            points, *about, found, len(found), axis, heights, weights
        )
        places[i, 0], places[i, 1], places[i, 2] = point
        n_merged[i] = total
    return places, nearest, n_merged, spread, sigma
