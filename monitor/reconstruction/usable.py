"""Which points a surface can be made of: those with finite coordinates and a normal, given or estimated.

In: a `PointCloud`. Out: its usable points with unit normals, and how many were left out and why.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import jit
from scipy.spatial import cKDTree

from monitor.filtering import estimate_normals
from monitor.filtering.copies import without_copies
from projects.errors import ReconstructionError
from projects.model import Bools, Floats, PointCloud

FEWEST_POINTS = 50
SHORTEST_NORMAL = 1e-6  # a shorter one points nowhere
ROUNDING = 1e-6  # of a length: unit vectors in single precision are off by less
N_WITNESSES = 8  # points with a given normal that say which way a point beside them looks


class Usable(NamedTuple):
    """The points that a surface is made of, with unit normals; `counts` of points used, of those left out for want of
    finite coordinates or of a normal, and of normals that were estimated."""

    cloud: PointCloud
    counts: dict[str, int]


def take_usable(cloud: PointCloud) -> Usable:
    """Return the points with finite coordinates and a normal, no copies; normals that are not given are estimated.

    Raises
    ------
    ReconstructionError
        Where fewer than 50 points can be used.
    """
    n_given, cloud = len(cloud), own_points(cloud)
    completed, n_estimated = with_normals(cloud)
    assert completed.normals is not None
    usable = mark_usable(completed.points, completed.normals)
    n_used = int(np.count_nonzero(usable))
    if n_used < FEWEST_POINTS:
        raise ReconstructionError(
            f"{n_used} of {len(cloud)} points can be used (finite, with a normal); "
            f"a surface needs at least {FEWEST_POINTS}"
        )
    n_finite = n_used if n_used == len(cloud) else int(np.isfinite(cloud.points).all(axis=1).sum())
    counts = {
        "points_used": n_used,
        "points_copied": n_given - len(cloud),
        "points_not_finite": len(cloud) - n_finite,
        "points_without_normal": n_finite - n_used,
        "normals_estimated": n_estimated,
    }
    return Usable(completed if n_used == len(cloud) else completed.take(np.flatnonzero(usable)), counts)


def own_points(cloud: PointCloud) -> PointCloud:
    """Return the cloud without copies of points; `ReconstructionError` where hardly more than copies were given."""
    own = without_copies(cloud)
    if len(own) < FEWEST_POINTS <= len(cloud):
        raise ReconstructionError(
            f"most of the {len(cloud)} points share their place with others; a surface needs points beside each other"
        )
    return own


def with_normals(cloud: PointCloud) -> tuple[PointCloud, int]:
    """Return the cloud with unit normals, and of how many points they were estimated robustly, for want of any."""
    if cloud.normals is None:
        return replace(estimate_normals(cloud), sigma=cloud.sigma), len(cloud)  # it gives points their spread
    if mark_usable(cloud.points, cloud.normals).all():
        return cloud, 0
    normals = unit_vectors(cloud.normals)
    finite = np.isfinite(cloud.points).all(axis=1)
    lacks = finite & np.isnan(normals[:, 0])
    if lacks.any() and np.count_nonzero(finite) >= FEWEST_POINTS:
        seen = replace(cloud, normals=None).take(np.flatnonzero(finite))
        found = estimate_normals(seen).normals
        assert found is not None
        is_seen = seen.origins is not None and bool(np.isfinite(seen.origins).all(axis=-1).any())
        normals[lacks] = turned_alike(seen.points, found, normals[finite], is_seen)[lacks[finite]]
    return replace(cloud, normals=normals), int(np.count_nonzero(lacks & np.isfinite(normals[:, 0])))


def unit_vectors(vectors: Floats) -> Floats:
    """Return vectors (n, 3) brought to length 1; NaN where they are not finite or have no length."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    has_length = np.isfinite(lengths) & (lengths > SHORTEST_NORMAL)
    return np.where(has_length, vectors / np.where(has_length, lengths, 1.0), np.nan)


def turned_alike(points: Floats, found: Floats, given: Floats, is_seen: bool) -> Floats:
    """Return the normals `found` (n, 3), turned where those `given` around (NaN where unknown) look the other way.

    Where the place of the scanner says which way each looks (`is_seen`), nothing is turned.
    """
    known = np.isfinite(given[:, 0])
    if is_seen or not known.any():
        return found
    agreement = np.einsum("ij,ij->i", found[known], given[known])
    k = [*range(1, 1 + min(N_WITNESSES, len(agreement)))]
    near = cKDTree(points[known]).query(points, k=k, workers=2)[1]
    return found * np.where(agreement[near].sum(axis=1) < 0.0, -1.0, 1.0)[:, None]


@jit(nopython=True, cache=True, nogil=True)
def mark_usable(points: Floats, normals: Floats) -> Bools:
    """Which points (n,) have finite coordinates and a normal of length 1."""
    out = np.empty(len(points), np.bool_)
    for i in range(len(points)):
        total, length2 = 0.0, 0.0
        for a in range(3):
            total += abs(points[i, a])
            length2 += normals[i, a] * normals[i, a]
        out[i] = np.isfinite(total) and abs(np.sqrt(length2) - 1.0) < ROUNDING  # NaN is not below
    return out
