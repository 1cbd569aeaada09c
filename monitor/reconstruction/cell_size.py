"""The one cell size of an epoch's surface, from how dense and how noisy its points are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from monitor.reconstruction.moments import Level, level_of_points
from monitor.reconstruction.projection import Samples
from monitor.reconstruction.reach import NARROWEST_SIGMAS, measure_noise
from monitor.robust import MAD_TO_SIGMA
from projects.errors import ParameterError
from projects.model import Floats, PointCloud

SPACINGS_PER_CELL = 1.5  # finer cells hold single points: nothing to gain (measured on the clouds of the paper)
NARROWEST_CELL = 0.25  # spacings; in finer cells less than half of a surface hangs together
NOISES_PER_CELL = 0.7  # the band must be thicker than the noise
N_PROBES = 5_000
FEWEST_NEIGHBOURS = 48
MOST_NEIGHBOURS = 1500
NARROWEST_SPACINGS = 3.0  # radius of the patches about which points scatter by their noise
LEAF = 32


class Sampling(NamedTuple):
    """How a cloud samples its surface: `spacing` (m) between points, `noise` (m) one sigma along the normal; `turn`
    (rad), by how much the normals within about four spacings differ from their mean, rms."""

    spacing: float
    noise: float
    turn: float


def tree_of_points(points: Floats) -> cKDTree:
    """Return the tree in which the points nearest to a place are looked for."""
    return cKDTree(points, leafsize=LEAF, balanced_tree=False, compact_nodes=False)  # built in a third of the time


def measure_and_sort(cloud: PointCloud, tree: cKDTree) -> tuple[Sampling, Level]:
    """Return how a cloud samples its surface, from probes spread evenly over its points, and these sorted for fits.

    Spacing is that of a square grid with as many points of the same sheet in the disc of the k-th neighbour; the
    neighbourhood grows until it is four times as wide as the scatter in it, since noise fills a narrower ball. Noise is
    the scatter about curved patches three spacings wide, or the points' own sigma where that is larger.
    """
    assert cloud.normals is not None
    n = len(cloud)
    probes = np.unique(np.linspace(0, n - 1, min(n, N_PROBES)).astype(int))
    k = min(FEWEST_NEIGHBOURS, n - 1)
    while True:
        distance, index = tree.query(cloud.points[probes], k=k + 1, workers=2)
        reach = float(np.median(distance[:, -1]))
        n_around, turn = _look_around(cloud.normals[index], cloud.normals[probes])
        scatter = _scatter_along(cloud.points[index], cloud.normals[probes])
        if reach >= 4.0 * scatter or k >= min(MOST_NEIGHBOURS, n - 1):
            break
        k, probes = min(2 * k, n - 1), probes[:: 2 if len(probes) > 2000 else 1]
    spacing = float(np.median(distance[:, -1] * np.sqrt(np.pi / n_around)))
    level = level_of_points(cloud.points, cloud.normals, NARROWEST_SPACINGS * (spacing or 1.0))
    noise = _noise_about_patches(cloud.take(probes), level, spacing, scatter)
    stated = np.nanmedian(cloud.sigma) if cloud.sigma is not None and np.isfinite(cloud.sigma).any() else 0.0
    return Sampling(spacing, float(max(noise if np.isfinite(noise) else scatter, stated)), turn), level


def _look_around(neighbours: Floats, normals: Floats) -> tuple[Floats, float]:
    """Return how many of the normals (n, k + 1, 3) look the probe's way (n, 3), the probe itself not counted, and by
    how much (rad) these differ from their mean, rms over all."""
    same = np.einsum("ijk,ik->ij", neighbours, normals) > 0.0
    n_same = same.sum(axis=1)
    mean = np.einsum("ijk,ij->ik", neighbours, same) / np.maximum(n_same, 1)[:, None]
    return np.maximum(n_same - 1.0, 1.0), float(np.sqrt(np.mean(np.maximum(1.0 - np.sum(mean**2, axis=1), 0.0))))


def _noise_about_patches(probes: PointCloud, level: Level, spacing: float, scatter: float) -> float:
    """Return the scatter about curved patches three spacings wide, or wider where noise would fill those.

    Relief does not fill a narrow window across, noise does: only the latter makes the window grow, up to the `scatter`
    that both of them leave about planes.
    """
    assert probes.normals is not None
    noise, radius, wider = scatter, 0.0, NARROWEST_SPACINGS * spacing
    while wider > 1.1 * radius:
        radius = wider
        noise = measure_noise(probes.points, probes.normals, Samples([level], np.array([radius]), scatter))
        if not np.isfinite(noise):
            return scatter
        wider = NARROWEST_SIGMAS * min(noise, scatter)
    return noise


def _scatter_along(neighbours: Floats, normals: Floats) -> float:
    """Return the median robust scatter of neighbourhoods (n, k, 3) along the normals (n, 3)."""
    offset = np.einsum("ijk,ik->ij", neighbours - neighbours.mean(axis=1, keepdims=True), normals)
    return float(np.median(MAD_TO_SIGMA * np.median(np.abs(offset - np.median(offset, axis=1, keepdims=True)), axis=1)))


def choose_cell_size(sampling: Sampling) -> float:
    """Return the cell size in metres: 1.5 spacings, or 0.7 sigma of the noise where that is larger."""
    return max(SPACINGS_PER_CELL * sampling.spacing, NOISES_PER_CELL * sampling.noise)


def require_cells_wide_enough(cell: float, sampling: Sampling) -> None:
    """Raise `ParameterError` where cells are so much finer than the points that most of these would stand alone."""
    if cell < NARROWEST_CELL * sampling.spacing:
        raise ParameterError(
            f"cell_size = {cell:.4g} m: the points lie {sampling.spacing:.4g} m apart; allowed is at least "
            f"{NARROWEST_CELL * sampling.spacing:.4g} m, usual {choose_cell_size(sampling):.4g} m: set a larger "
            "cell_size, or leave it out"
        )
