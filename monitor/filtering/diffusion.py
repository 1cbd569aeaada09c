"""Edge-preserving smoothing of an unorganized cloud by anisotropic diffusion (Perona and Malik 1990; paper 003).

In: points with normals; out: the same points moved along their normals. Paper 003 has it over a raster, with strength
and number of steps chosen by eye, and names both as its weakness: here it runs over the graph of neighbours in space,
the strength is the noise itself, and the steps end by a rule.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit

from monitor.declare import check_settings, given_or_default, setting
from monitor.filtering.nearest import build_index, canonical_order, find_nearest
from monitor.filtering.normals import NormalSettings, fit_planes, known_directions
from monitor.filtering.soundness import require_points
from monitor.robust import robust_scale
from projects.model import Floats, Ints, PointCloud

N_NEIGHBOURS = 8  # of a grid's pixel
LOCAL = 25  # neighbours of a normal: as many as two steps reach, a point, its eight neighbours and theirs
COMPATIBLE = 0.5  # cosine: only what looks the same way within 60 degrees exchanges heat
RATE = 0.5  # share of its difference that a point exchanges in one step; stable below 1
WHITE = 2.33  # sigmas: neighbours in what was removed agree more often than noise lets them once in a hundred
REMOVED = N_NEIGHBOURS / (N_NEIGHBOURS + 1.0)  # of the noise's variance, by the mean of a point and its neighbours
BLOCK = 65_536  # points whose neighbours are found at once; a multiple of the index's leaf


@dataclass(frozen=True, kw_only=True)
class DiffusionSettings:
    """Anisotropic diffusion of the merged cloud (paper 003, in three dimensions)."""

    enabled: bool = setting(
        False,
        unit="",
        meaning="smooth the merged cloud by anisotropic diffusion, edges kept; the surface gains nothing",
    )
    edge_height: float | None = setting(
        None, unit="m", meaning="height between neighbours from which on it counts as an edge; auto: of the noise",
        low=1e-9, high=1.0,
    )  # fmt: skip
    n_steps: int | None = setting(
        None, unit="steps", meaning="number of steps; auto: until as much as the noise is gone, or more than noise",
        low=1, high=10_000,
    )  # fmt: skip
    max_steps: int = setting(200, unit="steps", meaning="most automatic steps", low=1, high=10_000)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class DiffusionResult:
    """A diffused cloud and what was found: `edge_height_m`, `noise_m`, `n_steps`, `ended_by`, `removed_m` (rms)."""

    cloud: PointCloud
    automatic: Mapping[str, Any]


@dataclass(frozen=True)
class _Graph:
    """Neighbours (e, 2) that exchange heat, the height [m] of the second over the first along their mean normal, the
    cosine of each normal with that mean, and the share of the height exchanged in a step."""

    pairs: Ints
    heights: Floats
    cosines: Floats
    shares: Floats


def diffuse(cloud: PointCloud, settings: DiffusionSettings | None = None) -> PointCloud:
    """Smooth a cloud, edges kept; see `diffuse_with_record`, of which this is the cloud."""
    return diffuse_with_record(cloud, settings).cloud


def diffuse_with_record(cloud: PointCloud, settings: DiffusionSettings | None = None) -> DiffusionResult:
    """Smooth a cloud by anisotropic diffusion along its normals.

    Parameters
    ----------
    cloud : points; origins or normals orient the robust normals that they are moved along. Where it has `sigma`, the
        height of an edge follows it.
    settings : found from the cloud where not given.

    Returns
    -------
    DiffusionResult
        The same points in the same order, each moved along its normal. `sigma` is left as it was: what is left of the
        noise is smaller, but shared by neighbours.

    Notes
    -----
    Neighbours i, j exchange c(h) h with h the height of j over i along the mean of their normals, which on a sphere
    is none, so that curved surfaces do not shrink. c(h) = 1 / (1 + (h / K)^2) (Perona and Malik, Eq. of their section
    V; paper 003, Eq. 5), K = 1.4826 MAD(h): the flow is greatest where noise is, and falls for what is higher (Black,
    Sapiro, Marimont and Heeger 1998, section IV). Steps end when the mean square of what was removed reaches 8/9 of
    the variance of the noise, K^2 / 2, which is what the mean of a point and its eight neighbours removes of it (the
    discrepancy principle of Morozov, with the noise that stays), or earlier, when neighbours in it agree: noise is
    white and what is shared is surface.

    Raises
    ------
    ParameterError
        If there are fewer than 8 points, or a coordinate is not finite.
    """
    settings = given_or_default(settings, DiffusionSettings)
    require_points(cloud.points)
    order = canonical_order(cloud.points)
    ordered = cloud.take(order)
    towards = known_directions(ordered)
    local, facing = NormalSettings(max_neighbours=LOCAL), _facing(ordered.normals, towards)
    planes = fit_planes(build_index(ordered.points), towards, local, facing)
    foot = ordered.points - planes.heights[:, None] * planes.normals
    graph = _link(ordered.points, foot, planes.normals)
    noise = robust_scale(graph.heights) if len(graph.heights) else 0.0
    edge = settings.edge_height or noise
    edges = np.full(len(graph.pairs), edge) * _relative(ordered.sigma, graph.pairs)
    moved, n_steps, ended_by = _run(graph, len(order), np.maximum(edges, 1e-12), 0.5 * REMOVED * noise**2, settings)
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    points = (ordered.points + moved[:, None] * planes.normals)[back]
    return DiffusionResult(replace(cloud, points=points), {
        "edge_height_m": edge, "noise_m": noise / math.sqrt(2.0), "n_steps": n_steps, "ended_by": ended_by,
        "removed_m": float(np.sqrt(np.mean(moved**2))),
    })  # fmt: skip


def _facing(normals: Floats | None, towards: Floats | None) -> Floats | None:
    """Return given normals (n, 3) turned to the side that points were seen from, None where either is not known.

    By them the two sides of a thin part are told apart: a plane of both would move points aside and leave their noise.
    """
    if normals is None or towards is None or not np.isfinite(normals).all():
        return None
    return np.where((normals * towards).sum(axis=1, keepdims=True) < 0.0, -normals, normals)


def _link(points: Floats, foot: Floats, normals: Floats) -> _Graph:
    """Return the graph of points (n, 3): each with its eight nearest that look the same way.

    Nearest are the feet (n, 3) on the points' tangent planes: in space, points with the like error would be nearest.
    """
    order, n = canonical_order(foot), len(points)
    index = build_index(foot[order])
    k = min(N_NEIGHBOURS + 1, n)
    found = []
    for first in range(0, n, BLOCK):
        last = min(first + BLOCK, n)
        near = find_nearest(index, first, last, np.full(last - first, k, dtype=np.int64)).astype(np.int64)
        here, there = np.repeat(order[first:last], near.shape[1]), order[near.ravel()]
        proper = (near.ravel() >= 0) & (there != here)
        found.append(np.minimum(here, there)[proper] * n + np.maximum(here, there)[proper])
    keys = np.unique(np.concatenate(found))
    pairs = np.column_stack([keys // n, keys % n])
    i, j = pairs.T
    turn = (normals[i] * normals[j]).sum(axis=1)
    pairs, turn = pairs[turn >= COMPATIBLE], turn[turn >= COMPATIBLE]
    i, j = pairs.T
    cosines = np.sqrt(0.5 * (1.0 + turn))  # of half the angle between the normals
    mean = (normals[i] + normals[j]) / (2.0 * cosines[:, None])
    heights = ((points[j] - points[i]) * mean).sum(axis=1)
    degree = np.bincount(pairs.ravel(), minlength=n)
    return _Graph(pairs, heights, cosines, RATE / np.maximum(degree[i], degree[j]))


def _relative(sigma: Floats | None, pairs: Ints) -> Floats:
    """Return the noise (e,) of pairs of points relative to that of all; 1 where it is not known."""
    if sigma is None or not np.isfinite(sigma).all() or not (sigma > 0.0).all():
        return np.ones(len(pairs))
    return np.sqrt(0.5 * (sigma[pairs[:, 0]] ** 2 + sigma[pairs[:, 1]] ** 2)) / float(np.median(sigma))


def _run(graph: _Graph, n: int, edges: Floats, variance: float, settings: DiffusionSettings) -> tuple[Floats, int, str]:
    """Return how far each point (n,) was moved [m], after how many steps, and by which rule these ended."""
    moved = np.zeros(n)
    wanted = settings.n_steps or settings.max_steps
    for step in range(1, wanted + 1):
        before, moved = moved, _step(moved, graph.pairs, graph.heights, graph.cosines, graph.shares, edges)
        if settings.n_steps is not None:
            continue
        if step > 1 and _agreement(moved, graph.pairs) > WHITE:
            return before, step - 1, "more than noise would be removed"
        if np.mean(moved**2) >= variance:
            return moved, step, "as much as the noise was removed"
    return moved, wanted, "the number of steps"


@njit(cache=True, error_model="numpy")
def _step(moved: Any, pairs: Any, heights: Any, cosines: Any, shares: Any, edges: Any) -> Any:
    """Return how far the points are moved after one more step."""
    after = moved.copy()
    for e in range(pairs.shape[0]):
        i, j = pairs[e, 0], pairs[e, 1]
        h = heights[e] + cosines[e] * (moved[j] - moved[i])
        flow = shares[e] * h / (1.0 + (h / edges[e]) ** 2)
        after[i] += flow
        after[j] -= flow
    return after


def _agreement(moved: Floats, pairs: Ints) -> float:
    """Return by how many sigmas the correlation of neighbours in what was removed exceeds none."""
    first, second = moved[pairs[:, 0]], moved[pairs[:, 1]]
    scale2 = float(np.mean(moved**2))
    return float(np.sum(first * second) / (max(scale2, 1e-300) * math.sqrt(max(len(pairs), 1))))
