"""Vertices brought onto a robust local fit of the raw points, each with its own standard error.

In: vertices and normals of a raw surface, the cloud's points and normals. Out: `Projection`: moved vertices, fitted
normals, sigma, support. A Poisson surface smooths and is biased where it smooths (Nothegger, "Improving completeness
of geometric models", table 1); the fit is neither, and what remains uncertain is stated per vertex.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit, prange

from monitor.reconstruction.grid import PointGrid, build_grid, cell_span, count_candidates, row_points
from monitor.reconstruction.quadric import fit_patch
from projects.model import Bools, Floats, Ints

COS_SAME_SHEET = 0.5  # points whose normal is within 60 degrees of the vertex's belong to its sheet
MOST_EXTRAPOLATED = 4.0  # standard error against that of a mean; a quadric at the rim of its points exceeds it
CHUNK = 256  # vertices a thread takes at a time; one buffer serves them all
HEIGHT, SLOPE_U, SLOPE_V, UNIT_ERROR, SIGMA, EFFECTIVE = range(6)


class Projection(NamedTuple):
    """Vertices on the local fit; where no fit was possible the vertex stays and its sigma is NaN."""

    vertices: Floats  # (n, 3)
    normals: Floats  # (n, 3)
    sigma: Floats  # (n,)
    scatter: Floats  # (n,) robust one-sigma of the points about the patch
    n_support: Ints  # (n,)
    is_fitted: Bools  # (n,)

    def take(self, which: Bools | Ints) -> Projection:
        """Return the vertices selected."""
        return Projection(*(getattr(self, name)[which] for name in self._fields))


def project_vertices(
    vertices: Floats,
    normals: Floats,
    points: Floats,
    point_normals: Floats,
    radius: float,
    gate: float,
    max_shift: float,
) -> Projection:
    """Move each vertex along its normal onto the patch fitted to the points within `radius` (m) of that normal.

    Points farther than `gate` (m) along the normal, or that look another way, belong to another sheet. A move beyond
    `max_shift` (m) means that the fit is not about this vertex: it is refused. Curved patches where the points
    surround the vertex, planes where they lie to one side of it.
    """
    n = len(vertices)
    out = np.zeros((n, 9))
    grid = build_grid(points, radius)
    limits = (radius, gate, max_shift)
    _project(vertices, normals, grid, np.ascontiguousarray(point_normals[grid.order]), limits, out)
    is_fitted = out[:, 8] > 0.0
    return Projection(
        vertices=np.where(is_fitted[:, None], out[:, 0:3], vertices),
        normals=np.where(is_fitted[:, None], out[:, 3:6], normals),
        sigma=np.where(is_fitted, out[:, 6], np.nan),
        scatter=np.where(is_fitted, out[:, 7], np.nan),
        n_support=np.abs(out[:, 8]).astype(np.int32),
        is_fitted=is_fitted,
    )


@jit(nopython=True, cache=True)
def tangent_frame(normal: Floats) -> Any:
    """Two unit vectors that make a right-handed frame with `normal`."""
    nx, ny, nz = normal[0], normal[1], normal[2]
    if abs(nx) < 0.6:
        tx, ty, tz = 0.0, nz, -ny
    else:
        tx, ty, tz = -nz, 0.0, nx
    length = np.sqrt(tx * tx + ty * ty + tz * tz)
    tx, ty, tz = tx / length, ty / length, tz / length
    return (tx, ty, tz), (ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx)


@jit(nopython=True, cache=True)
def gather_patch(
    grid: Any, point_normals: Floats, vertex: Floats, normal: Floats, radius: float, gate: float, patch: Floats,
    mean: Floats,
) -> int:  # fmt: skip
    """Collect the points of the vertex's sheet as (u, v, z); their mean normal goes to `mean`."""
    reach = np.sqrt(radius * radius + gate * gate)
    (tx, ty, tz), (bx, by, bz) = tangent_frame(normal)
    i0, i1 = cell_span(vertex[0], reach, grid.low[0], grid.cell, grid.shape[0])
    j0, j1 = cell_span(vertex[1], reach, grid.low[1], grid.cell, grid.shape[1])
    k0, k1 = cell_span(vertex[2], reach, grid.low[2], grid.cell, grid.shape[2])
    n = 0
    mean[:] = 0.0
    if k1 < k0:
        return 0
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            first, last = row_points(grid, i, j, k0, k1)
            for p in range(first, last):
                dx = grid.points[p, 0] - vertex[0]
                dy = grid.points[p, 1] - vertex[1]
                dz = grid.points[p, 2] - vertex[2]
                z = dx * normal[0] + dy * normal[1] + dz * normal[2]
                if abs(z) > gate or dx * dx + dy * dy + dz * dz - z * z > radius * radius:
                    continue
                nx, ny, nz = point_normals[p, 0], point_normals[p, 1], point_normals[p, 2]
                same = nx * normal[0] + ny * normal[1] + nz * normal[2]
                if not same > COS_SAME_SHEET:
                    continue
                patch[n, 0] = dx * tx + dy * ty + dz * tz
                patch[n, 1] = dx * bx + dy * by + dz * bz
                patch[n, 2] = z
                for q in range(3):
                    mean[q] += point_normals[p, q]
                n += 1
    return n


@jit(nopython=True, cache=True)
def fit_best(patch: Floats, n: int, radius: float, work: Any, out: Floats) -> bool:
    """Curved patch where the points surround the vertex, a plane where a curved one would extrapolate.

    Not chosen by a test of curvature at each vertex: a test does not see a bias of one standard error, and all
    vertices of a sphere would keep that bias.
    """
    if fit_patch(patch, n, radius, 2, 4, work, out) and out[UNIT_ERROR] * np.sqrt(out[EFFECTIVE]) <= MOST_EXTRAPOLATED:
        return True
    return fit_patch(patch, n, radius, 1, 4, work, out)


@jit(nopython=True, cache=True)
def tilt(normal: Floats, slope_u: float, slope_v: float) -> None:
    """Turn `normal` in place to that of a patch with these slopes in its frame."""
    (tx, ty, tz), (bx, by, bz) = tangent_frame(normal)
    length = np.sqrt(1.0 + slope_u * slope_u + slope_v * slope_v)
    x = (normal[0] - slope_u * tx - slope_v * bx) / length
    y = (normal[1] - slope_u * ty - slope_v * by) / length
    z = (normal[2] - slope_u * tz - slope_v * bz) / length
    normal[0], normal[1], normal[2] = x, y, z


@jit(nopython=True, cache=True)
def project_one(
    vertex: Floats, normal: Floats, grid: Any, point_normals: Floats, limits: Any, patch: Floats, work: Any,
    fit: Floats, row: Floats,
) -> None:  # fmt: skip
    """Project one vertex: frame from the mean normal of its points, then once more from the fitted slope."""
    radius, gate, max_shift = limits
    mean = fit[6:9]
    n = gather_patch(grid, point_normals, vertex, normal, radius, gate, patch, mean)
    row[8] = -float(n)
    length = np.sqrt(mean[0] ** 2 + mean[1] ** 2 + mean[2] ** 2)
    if n < 7 or length < 1e-9:
        return
    own = row[3:6]
    own[:] = mean / length
    for _ in range(2):
        n = gather_patch(grid, point_normals, vertex, own, radius, gate, patch, mean)
        if n < 7 or not fit_best(patch, n, radius, work, fit):
            return
        slope2 = fit[SLOPE_U] ** 2 + fit[SLOPE_V] ** 2
        if slope2 > 1.0:
            return
        height = fit[HEIGHT] / np.sqrt(1.0 + slope2)
        tilt(own, fit[SLOPE_U], fit[SLOPE_V])
    if abs(height) > max_shift:
        return
    row[0:3] = vertex + height * own
    row[6], row[7], row[8] = fit[UNIT_ERROR] * fit[SIGMA], fit[SIGMA], float(n)


@jit(nopython=True, cache=True, parallel=True)
def _project(
    vertices: Floats, normals: Floats, grid: PointGrid, point_normals: Floats, limits: Any, out: Floats
) -> None:
    n, reach = len(vertices), np.sqrt(limits[0] ** 2 + limits[1] ** 2)
    for chunk in prange((n + CHUNK - 1) // CHUNK):
        first, last = chunk * CHUNK, min((chunk + 1) * CHUNK, n)
        room = 1
        for i in range(first, last):
            room = max(room, count_candidates(grid, vertices[i, 0], vertices[i, 1], vertices[i, 2], reach))
        patch, fit = np.empty((room, 3)), np.empty(9)
        work = (np.empty(6), np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 2)), np.empty(6), np.empty(room))
        for i in range(first, last):
            project_one(vertices[i], normals[i], grid, point_normals, limits, patch, work, fit, out[i])
