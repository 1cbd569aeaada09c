"""Thinning to the mode (Nothegger and Dorninger, section 2.4).

In: points in canonical order with their tangent planes; out: fewer points, each at the mode of the measurements in a
cylinder about the mean normal, with how many it stands for and how well it is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from monitor.declare import check_settings, setting
from monitor.filtering.drawing_order import draw_order
from monitor.filtering.modes import MODE_SPREAD, MODE_WIDTH, represent_all
from monitor.filtering.nearest import PointIndex, gather_ball
from monitor.filtering.normals import TangentPlanes
from monitor.filtering.roughness import classify_roughness
from projects.model import Bools, Floats, Ints, Roughness

DISC_PACKING = 1.2  # mean spacing over radius of points thrown at random, none nearer than the radius to another
FREE, DROPPED = -1, -2  # owner of a point
COMPATIBLE = 0.5  # cosine: members of a cylinder look the same way within 60 degrees


@dataclass(frozen=True, kw_only=True)
class ThinningSettings:
    """Thinning to the mode. Lengths in metres."""

    method: str = setting(
        "mode", unit="", choices=("mode", "voxel_median"),
        meaning="mode: of cylinders (paper 000); voxel_median: measured points alone, others rejected (004)",
    )  # fmt: skip
    target_spacing: float | None = setting(
        None,
        unit="m",
        meaning="spacing of the thinned points; auto: from noise, spacing and footprint",
        low=1e-6,
        high=10.0,
    )
    footprint: float | None = setting(
        None,
        unit="m",
        meaning="diameter of the laser's spot on the object; auto: unknown, noise alone decides",
        low=0.0,
        high=1.0,
    )
    facet_noise: float = setting(
        0.3,
        unit="rad",
        meaning="tilt that noise may give to a facet between neighbouring points, one sigma",
        low=0.01,
        high=2.0,
    )
    rough_share: float = setting(
        0.7,
        unit="",
        meaning="target spacing where the surface is rough, relative to where it is smooth",
        low=0.1,
        high=1.0,
    )
    seed: int = setting(0, unit="", meaning="seed of the order in which points are drawn", low=0, high=2**31)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class ThinnedPoints:
    """Representatives and what they stand for.

    Attributes
    ----------
    points : (m, 3) m, at the mode of the members along the mean normal.
    normals : (m, 3) mean normal of the members.
    nearest : (m,) index of the member nearest to the mode, in the points that were given.
    members, starts : indices of the members of representative i are members[starts[i]:starts[i + 1]].
    n_merged : (m,) number of measurements that it stands for.
    spread : (m,) m, robust one-sigma spread of the members along the normal.
    sigma : (m,) m, standard error of the mode.
    """

    points: Floats
    normals: Floats
    nearest: Ints
    members: Ints
    starts: Ints
    n_merged: Ints
    spread: Floats
    sigma: Floats


def target_spacings(spacing: Floats, noise: Floats, roughness: Ints, settings: ThinningSettings) -> Floats:
    """Return the target spacing (n,) [m] of each point; at most its own spacing where the data are not redundant.

    With N = (d / s)^2 measurements in a square of side d, the mode is known to 1.05 noise / sqrt(N), and a facet
    between two such points tilts by sqrt(2) 1.05 noise s / d^2. The automatic d is where this is `facet_noise`: closer
    points would show noise, farther ones lose detail. Where the footprint is known, half of it is the least d, for
    what is finer was not resolved.
    """
    if settings.target_spacing is not None:
        target = np.full(len(spacing), settings.target_spacing)
    else:
        target = np.sqrt(math.sqrt(2.0) * MODE_SPREAD * noise * spacing / settings.facet_noise)
        if settings.footprint is not None:
            target = np.maximum(target, 0.5 * settings.footprint)
    return np.where(roughness == Roughness.ROUGH, settings.rough_share * target, target)


def thin(
    index: PointIndex, planes: TangentPlanes, merged: Ints, targets: Floats, seed: int, keep: Bools | None = None
) -> ThinnedPoints:
    """Thin points to the modes of cylinders drawn at random until every point is in one.

    A point in several belongs to that whose axis is nearest: were it the first one drawn, the last would get what the
    others left, a single point one time in eight, and the noise left would be a quarter larger.

    Parameters
    ----------
    index : of the points.
    planes : their tangent planes, of which normals, noise, spacing and size are used.
    merged : (n,) measurements that each point stands for already.
    targets : (n,) m, target spacing.
    keep : (n,) points to be thinned; the others stand in no representative. None: all.
    """
    owner = np.full(len(targets), FREE, dtype=np.int32)
    if keep is not None:
        owner[~keep] = DROPPED
    axes, seeds = _draw_all(index, planes, targets, draw_order(index.points, seed), owner)
    members, starts = list_members(owner, len(seeds))
    del owner  # as long as the points, as all that goes before the representatives are made
    is_smooth = classify_roughness(planes.relief2, planes.noise, planes.n_neighbours) == Roughness.SMOOTH
    about = (planes.normals, planes.noise, ~is_smooth, planes.n_neighbours, merged)
    found = represent_all(index.points, *about, members, starts, np.argsort(seeds), axes)
    points, nearest, n_merged, spread, sigma = found
    return ThinnedPoints(points, axes, nearest, members, starts, n_merged, spread, sigma)


def _draw_all(
    index: PointIndex, planes: TangentPlanes, targets: Floats, order: Ints, owner: Ints
) -> tuple[Floats, Ints]:
    """Draw cylinders in the given order; return axis (m, 3) and seed (m,) of each, and write the owner of each point.

    Both grow in place: there are up to as many as points, and mostly far fewer.
    """
    radii = np.where(targets > planes.spacing, targets / DISC_PACKING, 0.0).astype(targets.dtype)
    about = (planes.normals, planes.noise, radii)
    n_room, n_begun, n_drawn = max(1, len(order) // 8), 0, 0
    axes, seeds = np.empty((n_room, 3)), np.empty(n_room, dtype=order.dtype)
    nearest2 = np.zeros(len(order), dtype=np.float32)
    while True:
        n_begun, n_drawn = _draw(
            index.points, index.low, index.high, *about, order, n_drawn, owner, nearest2, axes, seeds, n_begun
        )
        n_room = n_begun if n_drawn == len(order) else n_begun + n_begun // 2 + 1
        axes.resize((n_room, 3), refcheck=False)
        seeds.resize(n_room, refcheck=False)
        if n_drawn == len(order):
            return axes, seeds


@njit(cache=True, error_model="numpy")
def list_members(owner: Any, n_owners: int) -> Any:
    """Return the points (k,) that have an owner, by owner and then as they come, and where those of each start.

    Counted into place: neither is as long as the points sorted as whole numbers of 64 bits.
    """
    starts = np.zeros(n_owners + 1, dtype=np.int64)
    for q in range(len(owner)):
        if owner[q] >= 0:
            starts[owner[q] + 1] += 1
    for i in range(n_owners):
        starts[i + 1] += starts[i]
    members, n_written = np.empty(starts[n_owners], dtype=np.int32), np.zeros(n_owners, dtype=np.int32)
    for q in range(len(owner)):
        i = owner[q]
        if i >= 0:
            members[starts[i] + n_written[i]] = q
            n_written[i] += 1
    return members, starts


@njit(cache=True, error_model="numpy")
def _mean_axis(
    points: Any, normals: Any, owner: Any, found: Any, n: int, seed: int, axis: Any, radius: float, length: float
) -> Any:
    """Return the unit mean of the normals of the points in the cylinder, kept in `found`, and their number."""
    ax = ay = az = 0.0
    n_kept = 0
    for j in range(n):
        q = found[j]
        if owner[q] != DROPPED and aside_in_cylinder(points, normals, q, seed, axis, length) <= radius * radius:
            ax, ay, az = ax + normals[q, 0], ay + normals[q, 1], az + normals[q, 2]
            found[n_kept] = q
            n_kept += 1
    f = 1.0 / math.sqrt(ax * ax + ay * ay + az * az)
    return (ax * f, ay * f, az * f), n_kept


@njit(cache=True, error_model="numpy", inline="always")
def aside_in_cylinder(points: Any, normals: Any, q: int, seed: int, axis: Any, length: float) -> float:
    """Return the squared distance of a point from the axis through the seed; infinite beyond `length` along it, or
    where the point looks another way."""
    turn = normals[q, 0] * axis[0] + normals[q, 1] * axis[1] + normals[q, 2] * axis[2]
    dx, dy, dz = points[q, 0] - points[seed, 0], points[q, 1] - points[seed, 1], points[q, 2] - points[seed, 2]
    height = dx * axis[0] + dy * axis[1] + dz * axis[2]
    if turn < COMPATIBLE or abs(height) > length:
        return math.inf
    return max(dx * dx + dy * dy + dz * dz - height * height, 0.0)


@njit(cache=True, error_model="numpy")
def _draw(
    points: Any,
    low: Any,
    high: Any,
    normals: Any,
    noise: Any,
    radii: Any,
    order: Any,
    n_drawn: int,
    owner: Any,
    nearest2: Any,
    axes: Any,
    seeds: Any,
    n_begun: int,
) -> Any:
    """Go on drawing cylinders until there is no room; return how many are begun and the points of the order passed.

    `nearest2` is how far each point lies from the axis of its owner, squared, in radii.
    """
    stack, found = np.empty(128, dtype=np.int64), np.empty(4096, dtype=np.int32)
    for place in range(n_drawn, len(order)):
        seed = order[place]
        if owner[seed] != FREE:
            continue
        if n_begun == len(seeds):
            return n_begun, place
        owner[seed], nearest2[seed] = n_begun, 0.0
        axis, radius = (normals[seed, 0], normals[seed, 1], normals[seed, 2]), radii[seed]
        if radius > 0.0:
            length = radius + MODE_WIDTH * noise[seed]
            reach2 = radius * radius + length * length
            n = gather_ball(points, low, high, points[seed], reach2, stack, found)
            if n > found.shape[0]:
                found = np.empty(2 * n, dtype=np.int32)
                n = gather_ball(points, low, high, points[seed], reach2, stack, found)
            axis, n = _mean_axis(points, normals, owner, found, n, seed, axis, 2.0 * radius, length)
            for j in range(n):
                q = found[j]
                share = aside_in_cylinder(points, normals, q, seed, axis, length) / (radius * radius)
                if share <= 1.0 and (owner[q] == FREE or (owner[q] != DROPPED and share < nearest2[q])):
                    owner[q], nearest2[q] = n_begun, share
        axes[n_begun, 0], axes[n_begun, 1], axes[n_begun, 2] = axis
        seeds[n_begun] = seed
        n_begun += 1
    return n_begun, len(order)
