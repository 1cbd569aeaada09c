"""Plane patches of a scan, found by growing over robust normals: what a range calibration in situ rests on.

In: points seen from the scanner at the origin; out: `PlanePatches`. A wall gives several patches, sectors about the
foot of its perpendicular: the range changes along each, and each has a vote of its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from monitor.filtering.covariance import eigenvalues, eigenvector
from monitor.filtering.nearest import build_index, canonical_order, find_nearest
from monitor.filtering.normals import NormalSettings, fit_planes
from monitor.filtering.soundness import MIN_POINTS
from projects.model import Bools, Floats, Ints

N_LINKS = 12  # neighbours that a region may grow to
MIN_PATCH = 300  # points of a patch: thirty for each of what is estimated from it
MAX_TURN = math.radians(15.0)  # between the normal of a point and that of its wall: what cyclic errors may do to it
MAX_INCIDENCE = math.radians(75.0)  # beyond, the spot is 4 times as long as wide and ranges are those of its middle
SECTORS = (8, 4, 2, 1)


@dataclass(frozen=True)
class PlanePatches:
    """Points of plane patches.

    Attributes
    ----------
    points : (n, 3) m, from the scanner.
    patch : (n,) number of the patch of each point.
    wall : (p,) number of the wall that each patch belongs to.
    """

    points: Floats
    patch: Ints
    wall: Ints


def find_plane_patches(points: Floats, span: float, thickness: float) -> PlanePatches:
    """Find plane patches whose points differ in range by at least `span` [m].

    Parameters
    ----------
    points : (n, 3) m, from the scanner, in any order; a few ten thousand are enough.
    span : m, difference in range between the nearest and the farthest twentieth of a patch.
    thickness : m, farthest that a systematic error may bring a point off its plane.
    """
    if len(points) < max(MIN_POINTS, MIN_PATCH):
        return PlanePatches(np.empty((0, 3)), np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))
    points = points[canonical_order(points)]
    index = build_index(points)
    planes = fit_planes(index, np.zeros(3), NormalSettings(n_neighbours=16, n_samples=150))
    near = find_nearest(index, 0, len(points), np.full(len(points), min(N_LINKS, len(points))))
    slopes = np.abs((planes.normals * points).sum(axis=1)) / np.linalg.norm(points, axis=1)
    usable = ~planes.is_outlier & (slopes > math.cos(MAX_INCIDENCE))
    limit = thickness + 3.0 * float(np.median(planes.noise))
    order = np.argsort(planes.surface_variation, kind="stable")
    walls = _grow(points, planes.normals, near, order[usable[order]], usable, limit, math.cos(MAX_TURN))
    return _split_walls(points, walls, span)


def _split_walls(points: Floats, walls: Ints, span: float) -> PlanePatches:
    """Return the patches of walls (n,), -1 where a point has none."""
    chosen: list[Ints] = []
    patches: list[Ints] = []
    wall_of: list[int] = []
    for wall in range(int(walls.max()) + 1):
        members = np.flatnonzero(walls == wall)
        sector = _best_sectors(points[members], span)
        for number in np.unique(sector[sector >= 0]):
            in_patch = members[sector == number]
            chosen.append(in_patch)
            patches.append(np.full(len(in_patch), len(wall_of)))
            wall_of.append(wall)
    if not chosen:
        return PlanePatches(np.empty((0, 3)), np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))
    return PlanePatches(points[np.concatenate(chosen)], np.concatenate(patches), np.array(wall_of))


def _best_sectors(points: Floats, span: float) -> Ints:
    """Return the sector (n,) of each point of a wall, -1 where its sector is too small: the most that hold together."""
    centre = points.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((points - centre).T))
    foot = (centre @ axes[:, 0]) * axes[:, 0]
    turn = np.arctan2((points - foot) @ axes[:, 1], (points - foot) @ axes[:, 2]) / (2.0 * math.pi) + 0.5
    ranges = np.linalg.norm(points, axis=1)
    for n_sectors in SECTORS:
        sector = np.minimum((turn * n_sectors).astype(np.int64), n_sectors - 1)
        holds = np.array([_is_patch(ranges[sector == s], span) for s in range(n_sectors)])
        if holds[sector].mean() >= 0.9 or n_sectors == SECTORS[-1]:
            return np.where(holds[sector], sector, -1)
    raise AssertionError


def _is_patch(ranges: Floats, span: float) -> bool:
    """Return whether points at these ranges are enough and span enough."""
    if len(ranges) < MIN_PATCH:
        return False
    low, high = np.quantile(ranges, (0.05, 0.95))
    return bool(high - low >= span)


@njit(cache=True, error_model="numpy")
def _plane_of_sums(sums: Any) -> Any:
    """Return the normal and the offset of the plane through points given by their sums of powers."""
    s = sums[0]
    mx, my, mz = sums[1] / s, sums[2] / s, sums[3] / s
    c = (
        sums[4] / s - mx * mx, sums[5] / s - mx * my, sums[6] / s - mx * mz,
        sums[7] / s - my * my, sums[8] / s - my * mz, sums[9] / s - mz * mz,
    )  # fmt: skip
    v = eigenvector(c, eigenvalues(c)[2])
    return v, v[0] * mx + v[1] * my + v[2] * mz


@njit(cache=True, error_model="numpy")
def _add_sums(sums: Any, x: float, y: float, z: float) -> None:
    """Add a point to the sums of powers."""
    sums[0] += 1.0
    sums[1] += x
    sums[2] += y
    sums[3] += z
    sums[4] += x * x
    sums[5] += x * y
    sums[6] += x * z
    sums[7] += y * y
    sums[8] += y * z
    sums[9] += z * z


@njit(cache=True, error_model="numpy")
def _grow(points: Any, normals: Any, near: Any, order: Any, usable: Bools, limit: float, cosine: float) -> Any:
    """Return the wall (n,) of each point, -1 where it has none.

    From the flattest points on, a region takes in neighbours within `limit` of its plane that look its way; the plane
    is fitted again whenever the region has doubled.
    """
    walls, queue = np.full(len(points), -1, dtype=np.int64), np.empty(len(points), dtype=np.int64)
    tried = np.full(len(points), -1, dtype=np.int64)
    n_walls = 0
    for seed in order:
        if tried[seed] >= 0:
            continue
        v = (normals[seed, 0], normals[seed, 1], normals[seed, 2])
        offset = v[0] * points[seed, 0] + v[1] * points[seed, 1] + v[2] * points[seed, 2]
        sums, refit = np.zeros(10), 2 * N_LINKS
        queue[0], n_queue, head = seed, 1, 0
        tried[seed] = seed
        while head < n_queue:
            i = queue[head]
            head += 1
            _add_sums(sums, points[i, 0], points[i, 1], points[i, 2])
            if sums[0] >= refit:
                v, offset = _plane_of_sums(sums)
                refit *= 2
            for j in near[i]:
                if tried[j] == seed or walls[j] >= 0 or not usable[j]:
                    continue
                away = v[0] * points[j, 0] + v[1] * points[j, 1] + v[2] * points[j, 2] - offset
                turn = v[0] * normals[j, 0] + v[1] * normals[j, 1] + v[2] * normals[j, 2]
                if abs(away) <= limit and abs(turn) >= cosine:
                    tried[j] = seed
                    queue[n_queue] = j
                    n_queue += 1
        if n_queue >= MIN_PATCH:
            walls[queue[:n_queue]] = n_walls
            n_walls += 1
    return walls
