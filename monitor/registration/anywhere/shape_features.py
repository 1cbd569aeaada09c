"""What a shape looks like from each of its places, and which places of two shapes look alike.

In: the points and normals of a side. Out: a few thousand places with fast point feature histograms (Rusu et al. 2009,
computed by Open3D), and pairs of places of two shapes whose histograms are near each other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from monitor.registration.motion.sides import Side
from projects.model import Floats, Ints
from projects.open3d_library import load_open3d

N_PLACES = 2500  # on one shape: a few thousand tell a figure, and a matrix of pairs stays small
FEATURE_CELLS = (3.0, 6.0)  # radii of the histograms: what is near and what is around
MOST_NEIGHBOURS = 150
N_ALIKE = 3  # places of the other shape that may be the same one
MOST_PAIRS = 2500


class Places(NamedTuple):
    """Places on a shape: `points`, unit `normals` (n, 3) and `features` (n, k)."""

    points: Floats
    normals: Floats
    features: Floats


def choose_cell(sides: tuple[Side, Side]) -> float:
    """Return the edge [m] of the cells that cut the smaller shape into about `N_PLACES` pieces."""
    return min(_cell_of(side.points) for side in sides)


def _cell_of(points: Floats) -> float:
    """Return the edge of a cell [m] at which the points fill about `N_PLACES` of them, by halving."""
    high = float(np.linalg.norm(np.ptp(points, axis=0)))
    low = high / 4096.0
    for _ in range(14):
        middle = np.sqrt(low * high)
        n = len(np.unique(np.floor(points / middle).astype(np.int64), axis=0))
        low, high = (low, middle) if n < N_PLACES else (middle, high)
    return float(np.sqrt(low * high))


def find_places(side: Side, cell: float) -> Places:
    """Return one place for each cell of edge `cell` [m] that the side's points fill, with its histograms."""
    normals = side.normals_of(np.arange(len(side)))
    _, member = np.unique(np.floor(side.points / cell).astype(np.int64), axis=0, return_inverse=True)
    count = np.bincount(member).astype(float)
    points = np.column_stack([np.bincount(member, side.points[:, k]) for k in range(3)]) / count[:, None]
    mean = np.column_stack([np.bincount(member, normals[:, k]) for k in range(3)]) / count[:, None]
    length = np.linalg.norm(mean, axis=1)
    whole = length > 0.5  # normals that cancel belong to two sheets
    points, mean = points[whole], mean[whole] / length[whole, None]
    return Places(points, mean, np.hstack([compute_histograms(points, mean, r * cell) for r in FEATURE_CELLS]))


def compute_histograms(points: Floats, normals: Floats, radius: float) -> Floats:
    """Return fast point feature histograms (n, 33), each of unit length, over neighbours within `radius` [m]."""
    o3d = load_open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    search = o3d.geometry.KDTreeSearchParamHybrid(radius=radius, max_nn=MOST_NEIGHBOURS)
    histograms = np.asarray(o3d.pipelines.registration.compute_fpfh_feature(cloud, search).data).T
    return histograms / np.maximum(np.linalg.norm(histograms, axis=1, keepdims=True), 1e-12)


def pair_alike(source: Places, target: Places) -> Ints:
    """Return pairs (k, 2) of places (source, target) that look alike, the likest first, either way found."""
    there, back = cKDTree(target.features), cKDTree(source.features)
    far, near = there.query(source.features, k=N_ALIKE, workers=-1)
    far_back, near_back = back.query(target.features, k=N_ALIKE, workers=-1)
    pairs = np.vstack([
        np.column_stack([np.repeat(np.arange(len(near)), N_ALIKE), near.ravel()]),
        np.column_stack([near_back.ravel(), np.repeat(np.arange(len(near_back)), N_ALIKE)]),
    ])  # fmt: skip
    distance = np.concatenate([far.ravel(), far_back.ravel()])
    _, first, count = np.unique(pairs, axis=0, return_index=True, return_counts=True)
    # pairs that are found both ways come before all others
    order = np.lexsort([first, distance[first], -count])
    return pairs[first[order][:MOST_PAIRS]]
