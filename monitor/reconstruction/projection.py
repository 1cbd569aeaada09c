"""Vertices brought onto a robust local fit of the raw points, each with its own standard error.

In: vertices and normals of a raw surface, the cloud's points and normals, and how far each fit may reach. Out:
`Projection`: moved vertices, fitted normals, sigma, support. A Poisson surface smooths and is biased where it smooths
(Nothegger, `001`, table 1); the fit is neither, and what remains uncertain is stated per vertex.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit, prange

from monitor.reconstruction.moments import (
    BUCKETS_PER_RADIUS,
    CELLS_PER_RADIUS,
    COS_ONE_WAY,
    Level,
    build_levels,
    find_rows,
    level_of_points,
    sort_by_cell,
)
from monitor.reconstruction.quadric import (
    COUNT,
    EFFECTIVE,
    HEIGHT,
    SIGMA,
    SLOPE_U,
    SLOPE_V,
    SPREAD_UU,
    SPREAD_UV,
    SPREAD_UZ,
    SPREAD_VV,
    SPREAD_VZ,
    SPREAD_ZZ,
    UNIT_ERROR,
    U,
    V,
    Z,
    fit_patch,
    fit_room,
)
from projects.model import Bools, Floats, Ints

MOST_EXTRAPOLATED = 4.0  # standard error against that of a mean; a curved patch at the rim of its points exceeds it
GATE_SIGMAS, GATE_SAG = 4.5, 0.4  # height of points that belong to a fit: in sigmas of noise, and for its curvature
N_WIDENED = 3  # radii of the ladder for a plane: its own and the next wider, where too few points lie within it
MOST_TURNS, UPRIGHT = 2, 0.1  # a frame is turned once to the fitted slope, unless that is within 6 degrees
OVER_THE_RIM = 1.0 + 0.6 / CELLS_PER_RADIUS  # of the radius: groups that reach into it lie nearer
BLOCKS_PER_TASK = 16  # blocks of vertices a thread takes at a time
PLACE, NORMAL, OUT_SIGMA, OUT_SCATTER, OUT_SUPPORT = slice(0, 3), slice(3, 6), 6, 7, 8


class Reach(NamedTuple):
    """How the points around each vertex are fitted, one value a vertex.

    `curved` and `flat` are the rungs of the ladder for a curved patch and for a plane, `is_flat` says which to take
    where the points allow both, and `misfit` (m) is what the surface was seen to depart from such a fit at its middle.
    """

    curved: Ints
    flat: Ints
    is_flat: Bools
    misfit: Floats


class Projection(NamedTuple):
    """Vertices on the local fit; where no fit was possible the vertex stays and its sigma is NaN."""

    vertices: Floats  # (n, 3)
    normals: Floats  # (n, 3)
    sigma: Floats  # (n,)
    scatter: Floats  # (n,) one-sigma of the points about the patch
    n_support: Ints  # (n,)
    is_fitted: Bools  # (n,)

    def take(self, which: Bools | Ints) -> Projection:
        """Return the vertices selected."""
        return Projection(*(getattr(self, name)[which] for name in self._fields))


class Samples(NamedTuple):
    """The cloud as fits take it: a `Level` for each radius (m, ascending), and the noise of its points (m)."""

    levels: list[Level]
    radii: Floats
    noise: float


class Sites(NamedTuple):
    """Vertices sorted into blocks, each of them near enough to share one search for points."""

    vertices: Floats  # (n, 3)
    normals: Floats  # (n, 3)
    which: Ints  # (k,) those to work on, sorted by block
    starts: Ints  # (b + 1,)


def sum_up_samples(points: Floats, normals: Floats, radii: Floats, noise: float) -> Samples:
    """Return points (n, 3) m with unit normals, summed up in cells for fits within each of `radii`."""
    return Samples(build_levels(points, normals, radii), radii, float(noise))


def samples_at(points: Floats, normals: Floats, radius: float, noise: float) -> Samples:
    """Return the points for fits within one radius (m), none summed up."""
    return Samples([level_of_points(points, normals, radius)], np.array([radius]), float(noise))


def block_sites(vertices: Floats, normals: Floats, which: Ints, radius: float) -> Sites:
    """Return the vertices `which`, blocked for fits within `radius` (m)."""
    order, _, starts, _, _ = sort_by_cell(vertices[which], radius / BUCKETS_PER_RADIUS)
    return Sites(vertices, normals, which[order], starts)


def project_vertices(vertices: Floats, normals: Floats, samples: Samples, reach: Reach, max_shift: float) -> Projection:
    """Move each vertex along its normal onto the patch fitted to the points of its sheet around it.

    Points that look another way, or lie farther along the normal than noise and curvature explain, belong to another
    sheet. Where a curved patch would extrapolate a plane is taken. A move beyond `max_shift` (m) means that the fit
    is not about this vertex: it is refused.
    """
    out = np.zeros((len(vertices), 9))
    _project_all(vertices, normals, samples, 2, reach.curved, np.flatnonzero(~reach.is_flat), max_shift, out)
    last = len(samples.radii) - 1
    for wider in range(N_WIDENED):
        waiting = np.flatnonzero(out[:, OUT_SUPPORT] == 0.0)
        _project_all(vertices, normals, samples, 1, np.minimum(reach.flat + wider, last), waiting, max_shift, out)
    is_fitted = out[:, OUT_SUPPORT] > 0.0
    return Projection(
        vertices=np.where(is_fitted[:, None], out[:, PLACE], vertices),
        normals=np.where(is_fitted[:, None], out[:, NORMAL], normals),
        sigma=np.where(is_fitted, np.hypot(out[:, OUT_SIGMA], reach.misfit), np.nan),
        scatter=np.where(is_fitted, out[:, OUT_SCATTER], np.nan),
        n_support=np.abs(out[:, OUT_SUPPORT]).astype(np.int32),
        is_fitted=is_fitted,
    )


def _project_all(
    vertices: Floats, normals: Floats, samples: Samples, degree: int, rungs: Ints, which: Ints, max_shift: float,
    out: Floats,
) -> None:  # fmt: skip
    """Project the vertices `which`, each at its rung."""
    for rung, radius in enumerate(samples.radii):
        at_rung = which[rungs[which] == rung]
        if len(at_rung):
            sites = block_sites(vertices, normals, at_rung, radius)
            _project(sites, samples.levels[rung], radius, samples.noise, degree, max_shift, out)


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
def find_near(level: Any, sites: Any, block: int, reach: float, rows: Ints, near: Ints) -> Any:
    """Rows of the groups within `reach` of the box around the vertices of a block: how many, and room for them."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for k in range(sites.starts[block], sites.starts[block + 1]):
        for a in range(3):
            low[a] = min(low[a], sites.vertices[sites.which[k], a])
            high[a] = max(high[a], sites.vertices[sites.which[k], a])
    n_rows = find_rows(level, low - reach, high + reach, rows)
    most = 0
    for k in range(n_rows):
        most += rows[k, 1] - rows[k, 0]
    if most > len(near):
        near = np.empty(2 * most, np.int64)
    n, reach2 = 0, reach * reach
    for k in range(n_rows):
        for p in range(rows[k, 0], rows[k, 1]):
            away2 = 0.0
            for a in range(3):
                x = level.places[p, a]
                d = max(max(low[a] - x, x - high[a]), 0.0)
                away2 += d * d
            if away2 <= reach2:
                near[n] = p
                n += 1
    return n, near


@jit(nopython=True, cache=True)
def mean_normal(level: Any, near: Ints, n_near: int, vertex: Floats, normal: Floats, radius: float, gate: float,
                out: Floats) -> bool:  # fmt: skip
    """Unit mean normal of the points of the vertex's sheet, in `out`; False where there are too few."""
    n, sx, sy, sz = 0.0, 0.0, 0.0, 0.0
    for k in range(n_near):
        p = near[k]
        dx, dy, dz = (level.places[p, 0] - vertex[0], level.places[p, 1] - vertex[1],
                      level.places[p, 2] - vertex[2])  # fmt: skip
        z = dx * normal[0] + dy * normal[1] + dz * normal[2]
        if abs(z) > gate or dx * dx + dy * dy + dz * dz - z * z > radius * radius:
            continue
        nx, ny, nz, count = level.normals[p, 0], level.normals[p, 1], level.normals[p, 2], level.counts[p]
        if nx * normal[0] + ny * normal[1] + nz * normal[2] > COS_ONE_WAY:
            n += count
            sx += count * nx
            sy += count * ny
            sz += count * nz
    length = np.sqrt(sx * sx + sy * sy + sz * sz)
    if n < 4 or length < 1e-9:
        return False
    out[0], out[1], out[2] = sx / length, sy / length, sz / length
    return True


@jit(nopython=True, cache=True)
def gather_patch(level: Any, near: Ints, n_near: int, vertex: Floats, normal: Floats, radius: float, gate: float,
                 patch: Floats) -> Any:  # fmt: skip
    """Collect the groups of the vertex's sheet into `patch`, in units of `radius`; their number, and of points."""
    (tx, ty, tz), (bx, by, bz) = tangent_frame(normal)
    nx, ny, nz = normal[0], normal[1], normal[2]
    n, n_points, has_spread = 0, 0.0, len(level.spreads) > 0
    per, per2 = 1.0 / radius, 1.0 / (radius * radius)
    rim2 = (OVER_THE_RIM * radius) ** 2 if has_spread else radius * radius
    for k in range(n_near):
        p = near[k]
        dx, dy, dz = (level.places[p, 0] - vertex[0], level.places[p, 1] - vertex[1],
                      level.places[p, 2] - vertex[2])  # fmt: skip
        z = dx * nx + dy * ny + dz * nz
        if abs(z) > gate or dx * dx + dy * dy + dz * dz - z * z > rim2:
            continue
        if not level.normals[p, 0] * nx + level.normals[p, 1] * ny + level.normals[p, 2] * nz > COS_ONE_WAY:
            continue
        patch[U, n] = per * (dx * tx + dy * ty + dz * tz)
        patch[V, n] = per * (dx * bx + dy * by + dz * bz)
        patch[Z, n] = per * z
        patch[COUNT, n] = level.counts[p]
        n_points += level.counts[p]
        if has_spread:
            xx, xy, xz = level.spreads[p, 0] * per2, level.spreads[p, 1] * per2, level.spreads[p, 2] * per2
            yy, yz, zz = level.spreads[p, 3] * per2, level.spreads[p, 4] * per2, level.spreads[p, 5] * per2
            ax, ay, az = xx * tx + xy * ty + xz * tz, xy * tx + yy * ty + yz * tz, xz * tx + yz * ty + zz * tz
            cx, cy, cz = xx * bx + xy * by + xz * bz, xy * bx + yy * by + yz * bz, xz * bx + yz * by + zz * bz
            patch[SPREAD_UU, n] = ax * tx + ay * ty + az * tz
            patch[SPREAD_UV, n] = ax * bx + ay * by + az * bz
            patch[SPREAD_UZ, n] = ax * nx + ay * ny + az * nz
            patch[SPREAD_VV, n] = cx * bx + cy * by + cz * bz
            patch[SPREAD_VZ, n] = cx * nx + cy * ny + cz * nz
            patch[SPREAD_ZZ, n] = (xx * nx * nx + yy * ny * ny + zz * nz * nz
                                   + 2.0 * (xy * nx * ny + xz * nx * nz + yz * ny * nz))  # fmt: skip
        else:
            for q in range(SPREAD_UU, SPREAD_ZZ + 1):
                patch[q, n] = 0.0
        n += 1
    return n, n_points


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
def patch_room(n: int) -> Any:
    """Room for a patch of up to n groups and its fit."""
    return np.empty((10, n)), fit_room(n), np.empty(n), np.empty(7)


@jit(nopython=True, cache=True)
def project_one(
    level: Any, near: Ints, n_near: int, vertex: Floats, normal: Floats, sizes: Any, degree: int, room: Any, row: Floats
) -> None:
    """Project one vertex: frame from the mean normal of its points, then once more from the fitted slope."""
    patch, work, influence, fit = room
    radius, gate, max_shift = sizes
    own = row[NORMAL]
    if not mean_normal(level, near, n_near, vertex, normal, radius, gate, own):
        return
    height, n_points = 0.0, 0.0
    for _ in range(MOST_TURNS):
        n, n_points = gather_patch(level, near, n_near, vertex, own, radius, gate, patch)
        if not fit_patch(patch, n, radius, 1.0, degree, work, fit, influence):
            return
        if degree == 2 and not fit[UNIT_ERROR] * np.sqrt(fit[EFFECTIVE]) <= MOST_EXTRAPOLATED:
            return
        slope2 = fit[SLOPE_U] ** 2 + fit[SLOPE_V] ** 2
        if slope2 > 1.0:
            row[OUT_SUPPORT] = -n_points
            return
        height = fit[HEIGHT] / np.sqrt(1.0 + slope2)
        tilt(own, fit[SLOPE_U], fit[SLOPE_V])
        if slope2 < UPRIGHT**2:
            break
    row[OUT_SUPPORT] = -n_points
    if abs(height) <= max_shift:
        row[PLACE] = vertex + height * own
        row[OUT_SIGMA], row[OUT_SCATTER], row[OUT_SUPPORT] = fit[UNIT_ERROR] * fit[SIGMA], fit[SIGMA], n_points


@jit(nopython=True, cache=True)
def rows_room(reach: float, bucket: float) -> Ints:
    """Room for the ranges that `find_rows` finds around a block."""
    return np.empty((int(2.0 * reach / bucket + 3.0) ** 2, 2), np.int64)


@jit(nopython=True, cache=True, parallel=True)
def _project(
    sites: Sites, level: Level, radius: float, noise: float, degree: int, max_shift: float, out: Floats
) -> None:
    gate = gate_height(radius, noise)
    reach = np.hypot(OVER_THE_RIM * radius, gate)
    sizes = (radius, gate, max_shift)
    n_blocks = len(sites.starts) - 1
    for task in prange((n_blocks + BLOCKS_PER_TASK - 1) // BLOCKS_PER_TASK):
        rows, near = rows_room(reach, level.bucket), np.empty(1024, np.int64)
        room = patch_room(1024)
        for block in range(task * BLOCKS_PER_TASK, min((task + 1) * BLOCKS_PER_TASK, n_blocks)):
            n_near, near = find_near(level, sites, block, reach, rows, near)
            if n_near > len(room[2]):
                room = patch_room(2 * n_near)
            for k in range(sites.starts[block], sites.starts[block + 1]):
                i = sites.which[k]
                project_one(level, near, n_near, sites.vertices[i], sites.normals[i], sizes, degree, room, out[i])
