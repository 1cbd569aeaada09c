"""The voxel median with rejection by distance (paper 004, section 3): fewer points, each of them really measured.

In: points with tangent planes or normals; out: of each voxel the point whose distance is the median of those that the
accuracy of the scanner explains.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from monitor.declare import check_settings, given_or_default, setting
from monitor.filtering.drawing_order import hash_points
from monitor.filtering.nearest import canonical_order
from monitor.filtering.normals import NormalSettings, estimate_normals
from monitor.filtering.soundness import require_points
from monitor.filtering.thinning import ThinnedPoints
from projects.errors import ParameterError
from projects.model import Floats, Ints, PointCloud

VOXEL_IN_SPACINGS = 2.5  # paper 004: "two or three times those of the adopted scanning rate"
CUT = 3.0  # sigmas of a distance: "smaller differences than the laser scanner accuracy"
MEDIAN_SPREAD = math.sqrt(0.5 * math.pi)  # standard error of the median over that of the mean, normal errors
CELL_BITS = 29  # of a voxel's number along each axis
PRIOR = 10.0  # few members say little of their spread: the noise around counts as the spread of ten more


@dataclass(frozen=True, kw_only=True)
class VoxelMedianSettings:
    """The voxel median. Lengths in metres."""

    voxel_size: float | None = setting(
        None, unit="m", meaning="edge of a voxel; auto: 2.5 times the spacing of the points", low=1e-6, high=10.0
    )
    noise: float | None = setting(
        None,
        unit="m",
        meaning="one sigma of a distance, three of which reject; auto: from the cloud",
        low=1e-9,
        high=1.0,
    )

    def __post_init__(self) -> None:
        check_settings(self)


def voxel_median(cloud: PointCloud, settings: VoxelMedianSettings | None = None) -> PointCloud:
    """Thin a cloud to the points of median distance of its voxels.

    Distances are taken along the mean normal of the voxel, where the slope of the surface has no part in them (the
    paper's, from the scanner, hold it). Points of a voxel that look different ways (the two sides of a thin plate, of
    an edge) stand for themselves.

    Parameters
    ----------
    cloud : points; without `normals`, `sigma` (spread about the tangent plane) or `spacing` these are estimated.
    settings : found from the cloud where not given.

    Returns
    -------
    PointCloud
        Points of the cloud, unmoved, with `n_merged` (kept measurements), `spread` and `sigma` [m]; the order does not
        depend on that of the cloud.

    Raises
    ------
    ParameterError
        If there are fewer than 8 points, a coordinate is not finite, most points coincide, or the voxels are too many
        to number.
    """
    settings = given_or_default(settings, VoxelMedianSettings)
    require_points(cloud.points)
    if cloud.normals is None or cloud.spacing is None or cloud.sigma is None or not np.isfinite(cloud.normals).all():
        cloud = estimate_normals(cloud, NormalSettings())
    cloud = cloud.take(canonical_order(cloud.points))
    assert cloud.normals is not None
    assert cloud.spacing is not None
    assert cloud.sigma is not None
    size = settings.voxel_size or VOXEL_IN_SPACINGS * float(np.median(cloud.spacing))
    if not size > 0.0:
        raise ParameterError(
            f"half of the {len(cloud)} points have no spacing, their neighbours lie where they do; drop copies or give "
            "voxel_size"
        )
    noise = cloud.sigma if settings.noise is None else np.full(len(cloud), settings.noise)
    merged = np.ones(len(cloud), dtype=np.int32) if cloud.n_merged is None else cloud.n_merged
    found = take_medians(cloud.points, cloud.normals, noise, merged, size)
    chosen = cloud.take(found.nearest)
    return dataclasses.replace(chosen, n_merged=found.n_merged, spread=found.spread, sigma=found.sigma)


def take_medians(points: Floats, normals: Floats, noise: Floats, merged: Ints, size: float) -> ThinnedPoints:
    """Return of each voxel of edge `size` [m] the member of median height along the mean normal.

    Parameters
    ----------
    points, normals : (n, 3). noise : (n,) m, one sigma of a point. merged : (n,) measurements a point stands for.

    Returns
    -------
    ThinnedPoints, whose points are points that were given; members that are farther than three sigmas from the median
    are left out of `members` and of `n_merged`.
    """
    voxel, n_voxels = _voxels(points, normals, size)
    heights, axes = _heights(points, normals, voxel, n_voxels)
    ties = hash_points(points, 0)
    order = np.lexsort((ties, heights, voxel))
    middle = heights[_middle(order, voxel, n_voxels)]
    keep = np.abs(heights - middle[voxel]) <= CUT * noise
    order = order[keep[order]]
    alive = np.unique(voxel[order])  # a voxel of two points that disagree keeps neither
    nearest = _middle(order, voxel, n_voxels)[alive]
    counts = np.bincount(voxel[order], minlength=n_voxels)[alive]
    spread, sigma, total = _spreads(order, voxel, heights, noise, merged, n_voxels)
    return ThinnedPoints(
        points=points[nearest], normals=axes[alive], nearest=nearest, members=order,
        starts=np.concatenate([[0], np.cumsum(counts)]), n_merged=total[alive].astype(np.int32), spread=spread[alive],
        sigma=sigma[alive],
    )  # fmt: skip


def _voxels(points: Floats, normals: Floats, size: float) -> tuple[Ints, int]:
    """Return the number (n,) of each point's voxel, and how many voxels there are.

    Voxels are columns along the axis that the normal is nearest to, one set for each of the six ways that a surface
    may look, on multiples of `size` across it. Along it one ends where the next point is farther than `size`: a fixed
    border there would cut the noise of a surface that happens to lie on it in two.
    """
    row = np.arange(len(points))
    axis = np.argmax(np.abs(normals), axis=1)
    way = 2 * axis + (normals[row, axis] < 0.0)
    cell = np.floor(points / size).astype(np.int64)
    cell -= cell.min(axis=0)
    if cell.max() >= 1 << CELL_BITS:
        raise ParameterError(
            f"voxels of {size:g} m are more than {1 << CELL_BITS} along {np.ptp(points, axis=0).max():g} m; give "
            "larger ones, or the points within an extent"
        )
    key = (way << CELL_BITS | cell[row, (axis + 1) % 3]) << CELL_BITS | cell[row, (axis + 2) % 3]
    depth = points[row, axis]
    order = np.lexsort((depth, key))
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = (np.diff(key[order]) != 0) | (np.diff(depth[order]) > size)
    voxel = np.empty(len(order), dtype=np.int64)
    voxel[order] = np.cumsum(is_first) - 1
    return voxel, int(is_first.sum())


def _heights(points: Floats, normals: Floats, voxel: Ints, n_voxels: int) -> tuple[Floats, Floats]:
    """Return the height (n,) [m] of each point in its voxel along the voxel's mean normal, and these (v, 3)."""
    n = np.bincount(voxel, minlength=n_voxels).astype(float)
    axes: Floats = np.column_stack([np.bincount(voxel, normals[:, k], n_voxels) for k in range(3)])
    axes = axes / np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-300)
    origin = points.mean(axis=0)
    centres: Floats = (
        np.column_stack([np.bincount(voxel, points[:, k] - origin[k], n_voxels) for k in range(3)]) / n[:, None]
    )
    heights: Floats = ((points - origin - centres[voxel]) * axes[voxel]).sum(axis=1)
    return heights, axes


def _middle(order: Ints, voxel: Ints, n_voxels: int) -> Ints:
    """Return the middle member (v,) of each voxel, `order` being by voxel and height; of two, either for every other.

    Voxels without a member get member 0 of all, which nobody asks for.
    """
    counts = np.bincount(voxel[order], minlength=n_voxels)
    starts = np.cumsum(counts) - counts
    upper = np.arange(n_voxels) % 2
    place = np.where(counts > 0, starts + np.where(upper, counts // 2, np.maximum(counts - 1, 0) // 2), 0)
    return order[place]


def _spreads(
    order: Ints, voxel: Ints, heights: Floats, noise: Floats, merged: Ints, n_voxels: int
) -> tuple[Floats, Floats, Floats]:
    """Return spread and sigma (v,) [m] and the measurements (v,) of the voxels' kept members."""
    own, weight = voxel[order], merged[order].astype(float)
    n = np.maximum(np.bincount(own, minlength=n_voxels), 1)
    mean = np.bincount(own, heights[order], n_voxels) / n
    left2 = np.bincount(own, (heights[order] - mean[own]) ** 2, n_voxels)
    around2 = np.bincount(own, noise[order] ** 2, n_voxels) / n
    spread = np.sqrt((left2 + PRIOR * around2) / (np.maximum(n - 1, 0) + PRIOR))
    total = np.bincount(own, weight, n_voxels).astype(float)
    total2 = np.bincount(own, weight**2, n_voxels).astype(float)
    efficiency = np.where(n > 2, MEDIAN_SPREAD, 1.0)
    sigma = spread * np.where(n == 2, 1.0, efficiency * np.sqrt(total2) / np.maximum(total, 1.0))
    return spread, sigma, total
