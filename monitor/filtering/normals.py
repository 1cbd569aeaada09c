"""Robust normals of a cloud, with what comes with them (Nothegger and Dorninger, sections 2.2 and 2.3).

In: points in canonical order and where the scanner stood; out: `TangentPlanes`. The neighbourhood size and the noise
are found from the cloud itself.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from monitor.declare import given_or_default
from monitor.filtering.copies import find_copies
from monitor.filtering.facing import same_facing
from monitor.filtering.nearest import (
    PointIndex,
    build_index,
    canonical_order,
    find_nearest,
    find_nearest_of_every,
)
from monitor.filtering.neighbourhoods import undo_ball
from monitor.filtering.off_plane import MIN_COMPANIONS
from monitor.filtering.orientation import consistent_signs
from monitor.filtering.roughness import classify_roughness
from monitor.filtering.rounding import find_step, spread_rounded
from monitor.filtering.sizes import NormalSettings, fit_rows, sample_neighbourhoods
from monitor.filtering.soundness import MIN_POINTS, require_points
from monitor.filtering.tangents import COLUMNS, OUTLIER
from projects.model import Bools, Floats, Ints, PointCloud, require_noun

BLOCK = 32_768  # points whose neighbours are in memory at once; a multiple of LEAF
NEAR = COLUMNS.index("near")


@dataclass(frozen=True)
class TangentPlanes:
    """The tangent plane of every point, in the order of the points; in float32, of which there are tens of millions.

    Attributes
    ----------
    normals : (n, 3) unit vectors towards the scanner, or outward where its place is not known.
    lambda3, surface_variation : (n,) m2, 1: least eigenvalue (free of the bias of small n) and its share of the sum.
    relief2 : (n,) m2, mean square height of all neighbours over the plane: what roughness is told by.
    noise : (n,) m, noise alone, from the sills of the variograms around.
    heights : (n,) m, height of the point above its plane, along the normal; 0 on a relief finer than the points are,
        which has the normal of the plane around it (`off_plane.is_relief`).
    sigma_normal : (n,) rad, one sigma of the normal about its less certain axis.
    n_neighbours : (n,) neighbourhood size used.
    stride : (n,) 1 where these are the nearest points, more where they are the nearest of every `stride`-th point.
    spacing : (n,) m, side of the square that a point has to itself: radius sqrt(pi / n).
    reach : (n,) m, distance to the sixth nearest point.
    is_outlier : (n,) points that belong neither to the plane of their neighbours nor to a relief on it, nor to a
        surface of their own.
    """

    normals: Floats
    lambda3: Floats
    surface_variation: Floats
    relief2: Floats
    noise: Floats
    heights: Floats
    sigma_normal: Floats
    n_neighbours: Ints
    stride: Ints
    spacing: Floats
    reach: Floats
    is_outlier: Bools

    @property
    def sigma(self) -> Floats:
        """(n,) m, spread of the neighbours across the plane: noise and what roughness the plane cannot follow."""
        return np.sqrt(self.lambda3)

    def without(self, *names: str) -> TangentPlanes:
        """Return the planes without what is named, which becomes empty: of tens of millions of points, its memory."""
        gone: dict[str, Any] = dict.fromkeys(names, np.empty(0, dtype=np.float32))
        return dataclasses.replace(self, **gone)

    def take(self, which: Bools | Ints) -> TangentPlanes:
        """Return the planes of the points selected."""
        return TangentPlanes(**{f.name: getattr(self, f.name)[which] for f in dataclasses.fields(self)})


def fit_planes(
    index: PointIndex, towards: Floats | None, settings: NormalSettings, facing: Floats | None = None
) -> TangentPlanes:
    """Return the robust tangent planes of all points of the index, block by block.

    Parameters
    ----------
    towards : where the scanner stood (3,), or directions (n, 3) that each normal shall have a positive product with:
        to the scanner, or of an earlier normal. None: neighbouring normals are made to agree and to look outward
        (`consistent_signs`).
    facing : (n, 3) oriented normals where they are known: neighbours that look away, on the other side of a thin part,
        have no part in a plane. None: neighbours are taken by position alone.
    """
    model, n_points = sample_neighbourhoods(index, settings, facing), len(index.points)
    some = {int(s): index if s == 1 else build_index(index.points[::s]) for s in np.unique(model.strides)}
    planes = _no_planes(n_points)
    for first in range(0, n_points, BLOCK):
        block = slice(first, min(first + BLOCK, n_points))
        points = index.points[block]
        n, noise, strides = model.at(points)
        n = np.minimum(n, n_points)
        which, near = np.arange(first, block.stop), _find_near(index, some, first, block.stop, n, strides)
        if facing is not None:
            near, n = same_facing(which, near, n, facing)
        rows = fit_rows(index, which, near, n, noise, settings)
        rows[:, NEAR] = _nearness(index, first, rows[:, NEAR], strides)
        ahead = None if towards is None else towards - points if towards.ndim == 1 else towards[block]
        for name, values in vars(_planes(rows, n, noise, strides, ahead)).items():
            getattr(planes, name)[block] = values
    if towards is not None:
        return planes
    signs = consistent_signs(index.points, planes.normals)
    planes.normals[:] *= signs[:, None]
    planes.heights[:] *= signs
    return planes


def _find_near(index: PointIndex, some: dict[int, PointIndex], first: int, last: int, n: Ints, strides: Ints) -> Ints:
    """Return indices (last - first, n.max()) of the n nearest of each point, of every `strides`-th point there."""
    near = np.full((last - first, int(n.max())), -1, dtype=np.int32)
    for stride in np.unique(strides):
        its = strides == stride
        k = np.where(its, n, MIN_COMPANIONS)  # of the others as few as can be
        found = find_nearest_of_every(index, int(stride), some[int(stride)], first, last, k)
        near[its, : found.shape[1]] = found[its]
    return near


def _nearness(index: PointIndex, first: int, near: Floats, strides: Ints) -> Floats:
    """Return the distance [m] to the sixth nearest of all points, given that of those that were looked at."""
    if (strides == 1).all():
        return near
    k = np.full(len(near), min(MIN_COMPANIONS + 1, len(index.points)))
    all_near = find_nearest(index, first, first + len(near), k)
    apart = index.points[all_near] - index.points[first : first + len(near), None]
    return np.where(strides == 1, near, np.sqrt((apart**2).sum(axis=2).max(axis=1)))


def _no_planes(n_points: int) -> TangentPlanes:
    """Return room for the planes of so many points."""
    room: dict[str, Any] = {f.name: np.empty(n_points, dtype=np.float32) for f in dataclasses.fields(TangentPlanes)}
    room["normals"] = np.empty((n_points, 3), dtype=np.float32)
    room["n_neighbours"], room["is_outlier"] = np.empty(n_points, dtype=np.int32), np.empty(n_points, dtype=bool)
    room["stride"] = np.empty(n_points, dtype=np.int16)
    return TangentPlanes(**room)


def _planes(rows: Floats, n: Ints, noise: Floats, strides: Ints, towards: Floats | None) -> TangentPlanes:
    """Return the planes of a block from its rows of `tangents.COLUMNS`."""
    normals, middle, lambda3 = rows[:, :3], rows[:, 4], undo_ball(rows[:, 5], rows[:, 10] ** 2)
    sign = np.ones(len(rows)) if towards is None else np.where((normals * towards).sum(axis=1) < 0, -1.0, 1.0)
    return TangentPlanes(
        normals=normals * sign[:, None],
        lambda3=lambda3,
        surface_variation=lambda3 / np.maximum(rows[:, 3] + middle + lambda3, 1e-300),
        relief2=rows[:, 13],
        noise=noise,
        heights=rows[:, 6] * sign,
        sigma_normal=np.sqrt(lambda3 / np.maximum(rows[:, 9] * middle, 1e-300)),
        n_neighbours=n.astype(np.int32),
        stride=strides.astype(np.int16),
        spacing=rows[:, 10] * np.sqrt(np.pi / (n * strides)),
        reach=rows[:, NEAR],
        is_outlier=rows[:, 8] == OUTLIER,
    )


def estimate_normals(cloud: PointCloud, settings: NormalSettings | None = None) -> PointCloud:
    """Estimate robust normals of a cloud whose points may come in any order, and what they tell of noise and shape.

    Parameters
    ----------
    cloud : points; `origins` orients the normals to the scanner, else `normals` do, else neighbours are made to agree
        and to look outward.
    settings : neighbourhood size and the determinant; found from the cloud where not given.

    Returns
    -------
    PointCloud
        The same points in the same order with `normals`, `sigma` (spread of the neighbours across the tangent plane,
        m; a given sigma is kept), `surface_variation`, `roughness` and `spacing`. Copies (`find_copies`) bear no
        witness, and have what the point has that they are copies of.

    Raises
    ------
    ParameterError
        If there are fewer than 8 points, or a coordinate is not finite.
    """
    require_noun(cloud, "what normals are estimated of", PointCloud)
    settings = given_or_default(settings, NormalSettings)
    require_points(cloud.points)
    order = canonical_order(cloud.points)
    ordered = cloud.points[order]
    step = find_step(ordered)
    is_own = ~find_copies(ordered, step)
    is_own[np.flatnonzero(~is_own)[: max(MIN_POINTS - int(is_own.sum()), 0)]] = True  # a plane needs as many
    own, towards = order[is_own], known_directions(cloud)
    witnesses = ordered[is_own] if step == 0.0 else spread_rounded(ordered[is_own], step)
    planes = fit_planes(build_index(witnesses), None if towards is None else towards[own], settings)
    back = np.empty_like(order)
    back[order] = np.cumsum(is_own) - 1
    return dataclasses.replace(
        cloud,
        normals=planes.normals[back],
        sigma=planes.sigma[back] if cloud.sigma is None else cloud.sigma,
        surface_variation=planes.surface_variation[back],
        roughness=classify_roughness(planes.relief2, planes.noise, planes.n_neighbours)[back],
        spacing=planes.spacing[back] if cloud.spacing is None else cloud.spacing,
    )


def known_directions(cloud: PointCloud) -> Floats | None:
    """Return directions (n, 3) towards the side from which each point was seen, None where that is not known.

    Points of which nobody knows where the scanner stood were seen as the nearest is of which it is known.
    """
    if cloud.origins is not None and np.isfinite(cloud.origins).all(axis=-1).any():
        towards = cloud.origins - cloud.points
        is_known = np.isfinite(towards).all(axis=1)
        if not is_known.all():
            _, nearest = cKDTree(cloud.points[is_known]).query(cloud.points[~is_known])
            towards[~is_known] = towards[is_known][nearest]
        return towards
    return cloud.normals if cloud.normals is not None and np.isfinite(cloud.normals).all() else None
