"""Points around a vertex, as a fit takes them: found for a block of vertices at once, then each vertex's own patch.

In: vertices sorted into blocks, a `Level` of groups of points. Out: the groups around a block, copied side by side so
that each vertex of it passes over them in vector order; of these the mean normal and, in a frame on it, the patch.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit

from monitor.reconstruction.moments import (
    BUCKETS_PER_RADIUS,
    CELLS_PER_RADIUS,
    COS_ONE_WAY,
    find_rows,
    sort_by_cell,
)
from monitor.reconstruction.quadric import (
    COUNT,
    SPREAD_UU,
    SPREAD_UV,
    SPREAD_UZ,
    SPREAD_VV,
    SPREAD_VZ,
    SPREAD_ZZ,
    U,
    V,
    Z,
    fit_room,
)
from projects.model import Floats, Ints

GATE_SIGMAS, GATE_SAG = 4.5, 0.4  # height of points that belong to a fit: in sigmas of noise, and for its curvature
MIXED = 1.0  # of the edge of columns, whose groups are made of smaller ones
OVER_THE_RIM = 1.0 + 0.6 / CELLS_PER_RADIUS  # of the radius: groups that reach into it lie nearer
EDGE, AWAY, ACROSS, CARRIED = slice(0, 3), slice(3, 6), slice(6, 9), 9  # of a cut
NO_CUTS = np.empty((0, 2, 10))
NO_CUT = np.r_[np.zeros(9), -np.inf]  # leaves out nothing
ROOM = np.int64(1064)  # groups around a block at first; rows 2^k apart would share few lines of the cache
PLACE_X, PLACE_Y, PLACE_Z, NORMAL_X, NORMAL_Y, NORMAL_Z, N_POINTS, EXCESS, OWN_U, OWN_V, OWN_Z = range(
    11
)  # rows of what is near


class Sites(NamedTuple):
    """Vertices sorted into blocks, each of them near enough to share one search for points."""

    vertices: Floats  # (n, 3)
    normals: Floats  # (n, 3)
    which: Ints  # (k,) those to work on, sorted by block
    starts: Ints  # (b + 1,)
    alongs: Floats  # (k, 3) the direction in which the window of each of these is stretched; zero for discs
    cuts: Floats  # (k, 2, 10) beyond which points are not of its side; none (0, 2, 10) where all are: `keep_own_side`


class Near(NamedTuple):
    """Groups around a block: their rows in the level; (11, n) place, normal, count, and room for `lay_out`."""

    groups: Ints
    values: Floats


class Room(NamedTuple):
    """Room for one patch of up to n groups and its fit."""

    patch: Floats  # (10, n)
    work: Any
    influence: Floats  # (n,)
    fit: Floats
    place: Floats
    picked: Ints  # (n,)
    wider: Floats  # (n,) influences of a second fit


@jit(nopython=True, cache=True)
def block_edge(radius: float) -> float:
    """Edge (m) of a block of vertices with fits within `radius`."""
    return radius / BUCKETS_PER_RADIUS


def block_sites(
    vertices: Floats, normals: Floats, which: Ints, radius: float, alongs: Floats | None = None,
    cuts: Floats | None = None,
) -> Sites:  # fmt: skip
    """Return the vertices `which`, blocked for fits within `radius` (m): in cubes of `block_edge`.

    Windows are stretched along `alongs` (n, 3) and end at `cuts` (n, 2, 10) of all vertices, where given.
    """
    order, _, starts, _, _ = sort_by_cell(vertices.take(which, axis=0), block_edge(radius))
    which = which.take(order)
    along = np.zeros((len(which), 3)) if alongs is None else alongs.take(which, axis=0)
    return Sites(vertices, normals, which, starts, along, NO_CUTS if cuts is None else cuts.take(which, axis=0))


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
def frame_along(normal: Floats, along: Floats) -> Any:
    """Two unit vectors that make a right-handed frame with `normal`, the first of them as near to `along` as can be.

    Any two where `along` is zero, or along the normal.
    """
    nx, ny, nz = normal[0], normal[1], normal[2]
    up = along[0] * nx + along[1] * ny + along[2] * nz
    tx, ty, tz = along[0] - up * nx, along[1] - up * ny, along[2] - up * nz
    length = np.sqrt(tx * tx + ty * ty + tz * tz)
    if length < 0.1:
        return tangent_frame(normal)
    tx, ty, tz = tx / length, ty / length, tz / length
    return (tx, ty, tz), (ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx)


@jit(nopython=True, cache=True)
def gate_height(radius: float, noise: float) -> float:
    """How far from the tangent plane a point of the same sheet may lie within `radius`."""
    return GATE_SIGMAS * noise + GATE_SAG * radius


@jit(nopython=True, cache=True)
def near_room(n: int) -> Any:
    """Room for n groups."""
    return Near(np.empty(n, np.int64), np.empty((OWN_Z + 1, n)))


@jit(nopython=True, cache=True)
def patch_room(n: int) -> Any:
    """Room for a patch of up to n groups and its fit; without spreads at first."""
    return Room(
        np.zeros((10, n)), fit_room(n), np.empty(n), np.empty(7), np.empty(3), np.empty(n, np.int64), np.empty(n)
    )


@jit(nopython=True, cache=True)
def rows_room(reach: float, block: float, bucket: float) -> Ints:
    """Room for the ranges that `find_rows` finds within `reach` of a block of edge `block`, in buckets of theirs."""
    return np.empty((int((block + 2.0 * reach) / bucket + 2.0) ** 2, 2), np.int64)


@jit(nopython=True, cache=True)
def find_near(level: Any, sites: Any, block: int, reach: float, rows: Ints, near: Any) -> Any:
    """Groups within `reach` of the box around the vertices of a block: how many, and where they were copied to."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for k in range(sites.starts[block], sites.starts[block + 1]):
        for a in range(3):
            low[a] = min(low[a], sites.vertices[sites.which[k], a])
            high[a] = max(high[a], sites.vertices[sites.which[k], a])
    n_rows = find_rows(level, low - reach, high + reach, rows)
    most = 0
    for k in range(n_rows):
        most += rows[k, 1] - rows[k, 0]
    if most > len(near.groups):
        near = near_room(2 * most)
    n, reach2 = np.uint64(0), reach * reach
    (x0, y0, z0), (x1, y1, z1) = (low[0], low[1], low[2]), (high[0], high[1], high[2])
    for k in range(n_rows):
        for p in range(np.uint64(rows[k, 0]), np.uint64(rows[k, 1])):
            x, y, z = level.places[p, 0], level.places[p, 1], level.places[p, 2]
            dx, dy, dz = max(x0 - x, x - x1, 0.0), max(y0 - y, y - y1, 0.0), max(z0 - z, z - z1, 0.0)
            near.groups[n] = p
            near.values[PLACE_X, n], near.values[PLACE_Y, n], near.values[PLACE_Z, n] = x, y, z
            n += np.uint64(dx * dx + dy * dy + dz * dz <= reach2)
    for q in range(n):
        group = np.uint64(near.groups[q])
        near.values[NORMAL_X, q], near.values[NORMAL_Y, q] = level.normals[group, 0], level.normals[group, 1]
        near.values[NORMAL_Z, q], near.values[N_POINTS, q] = level.normals[group, 2], level.counts[group]
    return np.int64(n), near


@jit(nopython=True, cache=True, error_model="numpy")
def keep_own_side(near: Any, n_near: int, cuts: Floats, mixed: float, own: Any) -> int:
    """Copy the groups on the vertex's side of one or two edges from `near` to `own`; how many they are.

    A cut is a point of the edge, the unit vectors in the plane of the side and away from the edge, and between both
    sides towards the own one, and how near to the edge (m) noise carries points over; `mixed` (m) is how near groups
    may hold points of both sides.
    """
    n = 0
    for k in range(n_near):
        if is_within(near.values, k, cuts[0], mixed) and is_within(near.values, k, cuts[1], mixed):
            own.groups[n] = near.groups[k]
            for row in range(N_POINTS + 1):
                own.values[row, n] = near.values[row, k]
            n += 1
    return n


@jit(nopython=True, cache=True, error_model="numpy")
def is_within(values: Floats, k: int, cut: Floats, mixed: float) -> bool:
    """Whether a group lies on the own side of a cut."""
    if cut[CARRIED] < 0.0:
        return True
    edge, away, across = cut[EDGE], cut[AWAY], cut[ACROSS]
    x, y, z = values[PLACE_X, k] - edge[0], values[PLACE_Y, k] - edge[1], values[PLACE_Z, k] - edge[2]
    is_own = x * across[0] + y * across[1] + z * across[2] > 0.0
    return bool(is_own and x * away[0] + y * away[1] + z * away[2] >= max(cut[CARRIED], mixed))


@jit(nopython=True, cache=True)
def edge_of_groups(level: Any, radius: float) -> float:
    """How near to an edge (m) most groups for fits within `radius` end that hold points of both sides; 0 of points."""
    return MIXED * radius / CELLS_PER_RADIUS if len(level.spreads) > 0 else 0.0


# Sums over what is near may be taken in vector order: it is fixed when compiling, hence the same for any threads.
@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def sum_normals(
    values: Floats, n: int, vertex: Floats, normal: Floats, along: Floats, radius: float, stretch: float, gate: float
) -> Any:
    """Points within a window (see `gather_patch`) that look a vertex's way: how many, and the sum of their normals."""
    (tx, ty, tz), _ = frame_along(normal, along)
    less = 1.0 - 1.0 / (stretch * stretch)
    vx, vy, vz, nx, ny, nz = vertex[0], vertex[1], vertex[2], normal[0], normal[1], normal[2]
    n_points, sx, sy, sz, radius2 = 0.0, 0.0, 0.0, 0.0, radius * radius
    for k in range(np.uint64(n)):
        dx, dy, dz = values[PLACE_X, k] - vx, values[PLACE_Y, k] - vy, values[PLACE_Z, k] - vz
        ax, ay, az, count = values[NORMAL_X, k], values[NORMAL_Y, k], values[NORMAL_Z, k], values[N_POINTS, k]
        z = dx * nx + dy * ny + dz * nz
        u = dx * tx + dy * ty + dz * tz
        excess = max(abs(z) - gate, dx * dx + dy * dy + dz * dz - z * z - less * u * u - radius2)
        weight = count if excess <= 0.0 else 0.0
        weight = weight if ax * nx + ay * ny + az * nz > COS_ONE_WAY else 0.0
        n_points += weight
        sx += weight * ax
        sy += weight * ay
        sz += weight * az
    return n_points, sx, sy, sz


@jit(nopython=True, cache=True)
def mean_normal(near: Any, n_near: int, vertex: Floats, normal: Floats, along: Floats, radius: float, stretch: float,
                gate: float, out: Floats) -> bool:  # fmt: skip
    """Unit mean normal of the points of the vertex's sheet, in `out`; False where there are too few."""
    n_points, sx, sy, sz = sum_normals(near.values, n_near, vertex, normal, along, radius, stretch, gate)
    length = np.sqrt(sx * sx + sy * sy + sz * sz)
    if n_points < 4 or length < 1e-9:
        return False
    out[0], out[1], out[2] = sx / length, sy / length, sz / length
    return True


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def lay_out(values: Floats, n: int, vertex: Floats, normal: Floats, frame: Any, sizes: Any) -> None:
    """Write to the rows `OWN_U` to `OWN_Z` where each group lies in a vertex's frame, in units of its radius.

    And to the row `EXCESS` how far it lies beyond the rim, the gate and the angle: inside if at most 0. `sizes` are
    units to a metre, squared radius of the rim (m2), stretch, gate (m).
    """
    (tx, ty, tz), (bx, by, bz) = frame
    per, rim2, stretch, gate = sizes
    less = 1.0 - 1.0 / (stretch * stretch)
    vx, vy, vz, nx, ny, nz = vertex[0], vertex[1], vertex[2], normal[0], normal[1], normal[2]
    for k in range(np.uint64(n)):
        dx, dy, dz = values[PLACE_X, k] - vx, values[PLACE_Y, k] - vy, values[PLACE_Z, k] - vz
        u, v = dx * tx + dy * ty + dz * tz, dx * bx + dy * by + dz * bz
        z = dx * nx + dy * ny + dz * nz
        cosine = values[NORMAL_X, k] * nx + values[NORMAL_Y, k] * ny + values[NORMAL_Z, k] * nz
        beyond = dx * dx + dy * dy + dz * dz - z * z - less * u * u - rim2
        values[EXCESS, k] = max(beyond, abs(z) - gate, COS_ONE_WAY - cosine)
        values[OWN_U, k], values[OWN_V, k], values[OWN_Z, k] = per * u, per * v, per * z


@jit(nopython=True, cache=True)
def pick(values: Floats, n: int, picked: Ints) -> Any:
    """Numbers of the groups without excess, into `picked`; how many they are."""
    m = np.uint64(0)
    for k in range(np.uint64(n)):
        picked[m] = k
        m += np.uint64(values[EXCESS, k] <= 0.0)
    return np.int64(m)


@jit(nopython=True, cache=True)
def bring_inner_first(values: Floats, n: int, inner2: float, picked: Ints) -> Any:
    """Bring those of the n groups `picked` first that lie within a squared radius, in that of the window: how many."""
    m = np.uint64(0)
    for k in range(np.uint64(n)):
        p, first = np.uint64(picked[k]), picked[m]
        is_inner = values[OWN_U, p] * values[OWN_U, p] + values[OWN_V, p] * values[OWN_V, p] <= inner2
        picked[k] = first if is_inner else picked[k]
        picked[m] = p if is_inner else first
        m += np.uint64(is_inner)
    return np.int64(m)


@jit(nopython=True, cache=True)
def copy_picked(values: Floats, n: int, picked: Ints, patch: Floats) -> None:
    """Copy where the groups picked lie in the vertex's frame, and their counts, to `patch`."""
    for k in range(np.uint64(n)):
        p = np.uint64(picked[k])
        patch[U, k], patch[V, k] = values[OWN_U, p], values[OWN_V, p]
        patch[Z, k], patch[COUNT, k] = values[OWN_Z, p], values[N_POINTS, p]


@jit(nopython=True, cache=True, fastmath=True)
def count_points(patch: Floats, n: int) -> float:
    """Points of the groups of a patch: whole numbers, whose sum is the same in any order."""
    total = 0.0
    for k in range(np.uint64(n)):
        total += patch[COUNT, k]
    return total


@jit(nopython=True, cache=True)
def gather_patch(level: Any, near: Any, n_near: int, vertex: Floats, normal: Floats, along: Floats, radius: float,
                 stretch: float, gate: float, patch: Floats, picked: Ints) -> Any:  # fmt: skip
    """Collect the groups of the vertex's sheet into `patch`, in units of `radius`; their number, and of points.

    The window is a disc of `radius`, or an ellipse, `stretch` times as long in the direction `along`, which is u.
    `picked` receives which of `near` these are. Spreads are left as they are, none, where groups are single points.
    """
    sizes = (radius, stretch, gate, 1.0)
    _, n = gather_inner_first(level, near, n_near, vertex, normal, along, sizes, patch, picked)
    return n, count_points(patch, n)


@jit(nopython=True, cache=True)
def gather_inner_first(level: Any, near: Any, n_near: int, vertex: Floats, normal: Floats, along: Floats, sizes: Any,
                       patch: Floats, picked: Ints) -> Any:  # fmt: skip
    """Collect as `gather_patch`, first the groups for a fit within a share of the radius: how many these are, and all.

    `sizes` are radius, stretch, gate (m), and that share.
    """
    radius, stretch, gate, share = sizes
    has_spread = len(level.spreads) > 0
    per, over = 1.0 / radius, OVER_THE_RIM if has_spread else 1.0
    rim2 = (over * radius) ** 2
    lay_out(near.values, n_near, vertex, normal, frame_along(normal, along), (per, rim2, stretch, gate))
    n = pick(near.values, n_near, picked)
    n_inner = bring_inner_first(near.values, n, (over * share) ** 2, picked) if share < 1.0 else n
    copy_picked(near.values, n, picked, patch)
    if has_spread:
        for k in range(np.uint64(n)):
            p = np.uint64(near.groups[np.uint64(picked[k])])
            for q in range(np.uint64(6)):
                patch[np.uint64(SPREAD_UU) + q, k] = level.spreads[p, q]
        turn_spreads(patch, n, normal, along, per)
    return n_inner, n


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def turn_spreads(patch: Floats, n: int, normal: Floats, along: Floats, per: float) -> None:
    """Turn the spreads of a patch from xx xy xz yy yz zz to its frame and units."""
    (tx, ty, tz), (bx, by, bz) = frame_along(normal, along)
    nx, ny, nz = per * normal[0], per * normal[1], per * normal[2]
    tx, ty, tz, bx, by, bz = per * tx, per * ty, per * tz, per * bx, per * by, per * bz
    for k in range(np.uint64(n)):
        xx, xy, xz = patch[SPREAD_UU, k], patch[SPREAD_UU + 1, k], patch[SPREAD_UU + 2, k]
        yy, yz, zz = patch[SPREAD_UU + 3, k], patch[SPREAD_UU + 4, k], patch[SPREAD_UU + 5, k]
        ax, ay, az = xx * tx + xy * ty + xz * tz, xy * tx + yy * ty + yz * tz, xz * tx + yz * ty + zz * tz
        cx, cy, cz = xx * bx + xy * by + xz * bz, xy * bx + yy * by + yz * bz, xz * bx + yz * by + zz * bz
        patch[SPREAD_UU, k] = ax * tx + ay * ty + az * tz
        patch[SPREAD_UV, k] = ax * bx + ay * by + az * bz
        patch[SPREAD_UZ, k] = ax * nx + ay * ny + az * nz
        patch[SPREAD_VV, k] = cx * bx + cy * by + cz * bz
        patch[SPREAD_VZ, k] = cx * nx + cy * ny + cz * nz
        patch[SPREAD_ZZ, k] = (
            xx * nx * nx + yy * ny * ny + zz * nz * nz + 2.0 * (xy * nx * ny + xz * nx * nz + yz * ny * nz)
        )


@jit(nopython=True, cache=True)
def tilt(normal: Floats, along: Floats, slope_u: float, slope_v: float) -> None:
    """Turn `normal` in place to that of a patch with these slopes in its frame."""
    (tx, ty, tz), (bx, by, bz) = frame_along(normal, along)
    length = np.sqrt(1.0 + slope_u * slope_u + slope_v * slope_v)
    x = (normal[0] - slope_u * tx - slope_v * bx) / length
    y = (normal[1] - slope_u * ty - slope_v * by) / length
    z = (normal[2] - slope_u * tz - slope_v * bz) / length
    normal[0], normal[1], normal[2] = x, y, z
