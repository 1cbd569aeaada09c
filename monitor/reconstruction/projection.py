"""Vertices brought onto a robust local fit of the raw points, each with its own standard error.

In: vertices and normals of a raw surface, the cloud's points and normals, and how far each fit may reach. Out:
`Projection`: moved vertices, fitted normals, sigma, support. A Poisson surface smooths and is biased where it smooths
(Nothegger, `001`, table 1); the fit is neither, and what remains uncertain is stated per vertex.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit, prange

from monitor.reconstruction.grid import build_grid, cell_span, count_candidates, row_points
from monitor.reconstruction.quadric import fit_patch, fit_room
from projects.model import Bools, Floats, Ints

COS_SAME_SHEET = 0.5  # points whose normal is within 60 degrees of the vertex's belong to its sheet
MOST_EXTRAPOLATED = 4.0  # standard error against that of a mean; a curved patch at the rim of its points exceeds it
GATE_SIGMAS, GATE_SAG = 4.5, 0.4  # height of points that belong to a fit: in sigmas of noise, and for its curvature
WIDENED = (1.0, 1.4, 2.0)  # times the radius of a plane, where too few points lie within it
MOST_TURNS, UPRIGHT = 2, 0.1  # a frame is turned once to the fitted slope, unless that is within 6 degrees
CHUNK = 256  # vertices a thread takes at a time; one buffer serves them all
HEIGHT, SLOPE_U, SLOPE_V, UNIT_ERROR, SIGMA, EFFECTIVE, BEND = range(7)


class Reach(NamedTuple):
    """How the points around each vertex are fitted, one value a vertex.

    `curved` and `flat` (m) are the radii for a curved patch and for a plane, `is_flat` says which to take where the
    points allow both, and `misfit` (m) is what the surface was seen to depart from such a fit at its middle.
    """

    curved: Floats
    flat: Floats
    is_flat: Bools
    misfit: Floats


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


class Samples(NamedTuple):
    """The cloud as the kernels take it: a `PointGrid` (its fields, flat), the normals in its order, the noise (m)."""

    points: Floats
    order: Ints
    keys: Ints
    starts: Ints
    low: Floats
    shape: Ints
    cell: float
    normals: Floats
    noise: float


def grid_samples(points: Floats, normals: Floats, cell: float, noise: float) -> Samples:
    """Bucket points (n, 3) with their normals into cells of edge `cell` (m)."""
    grid = build_grid(points, cell)
    return Samples(*grid, np.ascontiguousarray(normals[grid.order]), float(noise))


def project_vertices(vertices: Floats, normals: Floats, samples: Samples, reach: Reach, max_shift: float) -> Projection:
    """Move each vertex along its normal onto the patch fitted to the points of its sheet around it.

    Points that look another way, or lie farther along the normal than noise and curvature explain, belong to another
    sheet. A move beyond `max_shift` (m) means that the fit is not about this vertex: it is refused.
    """
    out = np.zeros((len(vertices), 9))
    _project(vertices, normals, samples, reach, max_shift, out)
    is_fitted = out[:, 8] > 0.0
    return Projection(
        vertices=np.where(is_fitted[:, None], out[:, 0:3], vertices),
        normals=np.where(is_fitted[:, None], out[:, 3:6], normals),
        sigma=np.where(is_fitted, np.hypot(out[:, 6], reach.misfit), np.nan),
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
def gate_height(radius: float, noise: float) -> float:
    """How far from the tangent plane a point of the same sheet may lie within `radius`."""
    return GATE_SIGMAS * noise + GATE_SAG * radius


@jit(nopython=True, cache=True)
def room_needed(samples: Any, vertex: Floats, radius: float) -> int:
    """Upper bound of the points that `gather_patch` finds."""
    reach = np.hypot(radius, gate_height(radius, samples.noise))
    return count_candidates(samples, vertex[0], vertex[1], vertex[2], reach)


@jit(nopython=True, cache=True)
def gather_patch(samples: Any, vertex: Floats, normal: Floats, radius: float, patch: Floats, mean: Floats) -> int:
    """Collect the points of the vertex's sheet as (u, v, z); their mean normal goes to `mean`."""
    (tx, ty, tz), (bx, by, bz) = tangent_frame(normal)
    gate = gate_height(radius, samples.noise)
    reach = np.hypot(radius, gate)
    i0, i1 = cell_span(vertex[0], reach, samples.low[0], samples.cell, samples.shape[0])
    j0, j1 = cell_span(vertex[1], reach, samples.low[1], samples.cell, samples.shape[1])
    k0, k1 = cell_span(vertex[2], reach, samples.low[2], samples.cell, samples.shape[2])
    n = 0
    mean[:] = 0.0
    if k1 < k0:
        return 0
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            first, last = row_points(samples, i, j, k0, k1)
            for p in range(first, last):
                dx = samples.points[p, 0] - vertex[0]
                dy = samples.points[p, 1] - vertex[1]
                dz = samples.points[p, 2] - vertex[2]
                z = dx * normal[0] + dy * normal[1] + dz * normal[2]
                if abs(z) > gate or dx * dx + dy * dy + dz * dz - z * z > radius * radius:
                    continue
                nx, ny, nz = samples.normals[p, 0], samples.normals[p, 1], samples.normals[p, 2]
                if not nx * normal[0] + ny * normal[1] + nz * normal[2] > COS_SAME_SHEET:
                    continue
                patch[n, 0] = dx * tx + dy * ty + dz * tz
                patch[n, 1] = dx * bx + dy * by + dz * bz
                patch[n, 2] = z
                mean[0] += nx
                mean[1] += ny
                mean[2] += nz
                n += 1
    return n


@jit(nopython=True, cache=True)
def mean_normal(samples: Any, vertex: Floats, normal: Floats, radius: float, patch: Floats, out: Floats) -> bool:
    """Unit mean normal of the points of the vertex's sheet, in `out`; False where there are too few."""
    n = gather_patch(samples, vertex, normal, radius, patch, out)
    length = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    if n < 4 or length < 1e-9:
        return False
    out /= length
    return True


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
def fit_vertex(samples: Any, vertex: Floats, normal: Floats, radii: Any, is_flat: bool, room: Any, fit: Floats) -> int:
    """Fit what the reach asks for in the frame of `normal`; a plane too where the curved patch would extrapolate."""
    patch, influence, work, mean = room
    if not is_flat:
        n = gather_patch(samples, vertex, normal, radii[0], patch, mean)
        has_fit = fit_patch(patch, n, radii[0], 2, work, fit, influence)
        if has_fit and fit[UNIT_ERROR] * np.sqrt(fit[EFFECTIVE]) <= MOST_EXTRAPOLATED:
            return n
    for widened in WIDENED:
        n = gather_patch(samples, vertex, normal, widened * radii[1], patch, mean)
        if fit_patch(patch, n, widened * radii[1], 1, work, fit, influence):
            return n
    return 0


@jit(nopython=True, cache=True)
def project_one(
    samples: Any, vertex: Floats, normal: Floats, radii: Any, is_flat: bool, max_shift: float, room: Any, row: Floats
) -> None:
    """Project one vertex: frame from the mean normal of its points, then once more from the fitted slope."""
    fit, own = np.empty(7), row[3:6]
    if not mean_normal(samples, vertex, normal, radii[1], room[0], own) and not mean_normal(
        samples, vertex, normal, WIDENED[-1] * radii[1], room[0], own
    ):
        return
    height, n = 0.0, 0
    for _ in range(MOST_TURNS):
        n = fit_vertex(samples, vertex, own, radii, is_flat, room, fit)
        row[8] = -float(n)
        slope2 = fit[SLOPE_U] ** 2 + fit[SLOPE_V] ** 2
        if n == 0 or slope2 > 1.0:
            return
        height = fit[HEIGHT] / np.sqrt(1.0 + slope2)
        tilt(own, fit[SLOPE_U], fit[SLOPE_V])
        if slope2 < UPRIGHT**2:
            break
    if abs(height) > max_shift:
        return
    row[0:3] = vertex + height * own
    row[6], row[7], row[8] = fit[UNIT_ERROR] * fit[SIGMA], fit[SIGMA], float(n)


@jit(nopython=True, cache=True, parallel=True)
def _project(vertices: Floats, normals: Floats, samples: Samples, reach: Reach, max_shift: float, out: Floats) -> None:
    n = len(vertices)
    for chunk in prange((n + CHUNK - 1) // CHUNK):
        first, last = chunk * CHUNK, min((chunk + 1) * CHUNK, n)
        most = 1
        for i in range(first, last):
            radius = max(WIDENED[-1] * reach.flat[i], 0.0 if reach.is_flat[i] else reach.curved[i])
            most = max(most, room_needed(samples, vertices[i], radius))
        room = (np.empty((most, 3)), np.empty(most), fit_room(most), np.empty(3))
        for i in range(first, last):
            radii = (reach.curved[i], reach.flat[i])
            project_one(samples, vertices[i], normals[i], radii, reach.is_flat[i], max_shift, room, out[i])
