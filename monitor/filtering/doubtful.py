"""Points that one scan takes for strays and another station bears out: what is too small for one scan alone to show.

In: the filtered clouds of an epoch, registered, and beside each the points that its scan left out because they lie off
their neighbours' plane; out: a mask of those that belong to a surface. A pit of a few points is a few strays to each
scan. Strays of two stations, on beams that cross, do not lie on one surface.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial import cKDTree

from monitor.filtering.silhouettes import RIM_GAP, widest_gap
from monitor.filtering.tangents import CUT2, MAX_COMPANIONS, MIN_COMPANIONS
from projects.model import Bools, Floats, Ints, PointCloud

N_NEAR = 128  # points looked at around each: about those of the neighbourhoods of two scans
N_PLANE, N_AROUND = 8, 96  # nearest points that its own scan kept: the plane that it lies off, what is on all sides
REACH = 4.1  # spacings, within which six points of a surface lie even beside its border (`tangents.second_plane`)
MIN_OTHERS = 2  # companions that another station saw
CROSSING = np.sin(np.radians(5.0))  # beams from one place, or nearly, have their strays in common
BLOCK = 4096  # points at a time


def find_borne_out(clouds: Sequence[PointCloud], doubtful: Sequence[PointCloud], slack: float) -> list[Bools]:
    """Return for each cloud which of its doubtful points (n,) lie on a surface that another station saw too.

    Such a point lies behind the plane that its scan shows on all sides of it: beyond an edge, and before it, every
    station measures the same fringe, where its spot reaches over. Around it are at least `MIN_COMPANIONS` points behind
    that plane, itself among them; those nearest to it lie in a plane or a bowl, as near as noise and `slack` explain,
    and `MIN_OTHERS` of them were seen from elsewhere.

    Parameters
    ----------
    clouds, doubtful : in one frame, with normals, sigma, spacing and origins (3,); of unknown origin, no point is kept.
    slack : m, three sigma of what the clouds may lie off each other by. NaN, where that is not known: nothing is kept.
    """
    none = [np.zeros(len(d), dtype=bool) for d in doubtful]
    if np.isnan(slack) or not any(map(len, doubtful)):
        return none
    witnesses = _Witnesses(clouds, doubtful)
    for k, (cloud, those) in enumerate(zip(clouds, doubtful, strict=True)):
        if len(cloud) >= N_PLANE and len(those) and _is_described(those) and witnesses.is_placed(k):
            tree = cKDTree(cloud.points)
            for block in _blocks(len(those)):
                none[k][block] = _borne_out(those.take(block), (cloud, tree), witnesses, k, slack)
    return none


class _Witnesses:
    """All points of an epoch, kept or doubtful: where they are, and where their scanner stood."""

    def __init__(self, clouds: Sequence[PointCloud], doubtful: Sequence[PointCloud]) -> None:
        parts = [*clouds, *doubtful]
        self.points = np.concatenate([c.points for c in parts])
        self.cloud = np.concatenate([np.full(len(c), i % len(clouds)) for i, c in enumerate(parts)])
        self.origins = np.array([_origin_of(c) for c in clouds])
        self.tree = cKDTree(self.points)

    def is_placed(self, k: int) -> bool:
        """Return whether it is known where the scanner of a cloud stood."""
        return bool(np.isfinite(self.origins[k]).all())

    def crosses(self, points: Floats, k: int) -> Bools:
        """Return whether the beams of cloud k to points (n, 3) cross those of each cloud: (n, clouds)."""
        towards = self.origins[None] - points[:, None]
        towards /= np.linalg.norm(towards, axis=2, keepdims=True)
        return np.linalg.norm(np.cross(towards, towards[:, k : k + 1]), axis=2) > CROSSING  # NaN crosses nothing


def _origin_of(cloud: PointCloud) -> Floats:
    """Return where the scanner of a cloud stood (3,), NaN where that is not known, or not one place."""
    return cloud.origins if cloud.origins is not None and cloud.origins.ndim == 1 else np.full(3, np.nan)


def _is_described(cloud: PointCloud) -> bool:
    """Return whether a cloud's points have what they are judged by."""
    return cloud.normals is not None and cloud.sigma is not None and cloud.spacing is not None


def _blocks(n_points: int) -> Iterator[Ints]:
    """Yield the numbers of so many points, block by block."""
    for first in range(0, n_points, BLOCK):
        yield np.arange(first, min(first + BLOCK, n_points))


def _borne_out(
    those: PointCloud, kept: tuple[PointCloud, cKDTree], witnesses: _Witnesses, k: int, slack: float
) -> Bools:
    """Return which of the doubtful points (n,) of cloud k others bear out."""
    cloud, tree = kept
    normals, sigma, spacing = those.normals, those.sigma, those.spacing
    assert normals is not None
    assert sigma is not None
    assert spacing is not None
    own = cloud.points[tree.query(those.points, min(N_AROUND, len(cloud)))[1]] - those.points[:, None]
    plane = np.median(_along(own[:, :N_PLANE], normals), axis=1)  # of the surface, from the point
    apart, near = witnesses.tree.query(those.points, min(N_NEAR, len(witnesses.points)))
    offsets = witnesses.points[near] - those.points[:, None]
    heights = _along(offsets, normals) - plane[:, None]  # over the surface
    limit2 = CUT2 * (sigma**2 + (slack / 3.0) ** 2)
    in_plane = (_along(own, normals) - plane[:, None]) ** 2 <= limit2[:, None]
    is_in_pit = (plane > 0.0) & (widest_gap(normals, np.where(in_plane[:, :, None], own, 0.0)) < RIM_GAP)
    off = (heights < -np.sqrt(limit2)[:, None]) & (apart <= REACH * spacing[:, None])
    off &= np.cumsum(off, axis=1) <= MAX_COMPANIONS
    others = off & np.take_along_axis(witnesses.crosses(those.points, k), witnesses.cloud[near], axis=1)
    is_many = is_in_pit & (off.sum(axis=1) >= MIN_COMPANIONS) & (others.sum(axis=1) >= MIN_OTHERS)
    out = np.zeros(len(those), dtype=bool)
    offsets, off, limit2, normals = offsets[is_many], off[is_many], limit2[is_many], normals[is_many]
    out[is_many] = _is_plane(offsets, off, limit2) | _is_bowl(offsets, off, limit2, normals)
    return out


def _along(offsets: Floats, normals: Floats) -> Floats:
    """Return the products (n, k) of offsets (n, k, 3) with the normal (n, 3) of each row."""
    return np.einsum("nki,ni->nk", offsets, normals)


def _is_plane(offsets: Floats, chosen: Bools, limit2: Floats) -> Bools:
    """Return where the chosen offsets (n, k, 3) lie in a plane as thin as `limit2` (n,) [m2], the origin in it."""
    weights = chosen / chosen.sum(axis=1, keepdims=True)
    means = np.einsum("nk,nki->ni", weights, offsets)
    about = (offsets - means[:, None]) * np.sqrt(weights)[:, :, None]
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", about, about))
    n_points = chosen.sum(axis=1)
    least = np.maximum(values[:, 0], 0.0) * n_points / (n_points - 3.0)
    height = np.einsum("ni,ni->n", means, vectors[:, :, 0])
    return np.asarray((least <= limit2) & (least <= 0.25 * values[:, 1]) & (height**2 <= limit2))


def _is_bowl(offsets: Floats, chosen: Bools, limit2: Floats, normals: Floats) -> Bools:
    """Return where the chosen offsets (n, k, 3) lie as near to a bowl over the plane of `normals` (n, 3), the origin
    among them: a height that is linear but for its square distance."""
    weights = chosen.astype(float)
    across = _along(offsets, normals)
    along = offsets - across[:, :, None] * normals[:, None]
    size = np.sqrt((weights * np.einsum("nki,nki->nk", along, along)).sum(axis=1) / weights.sum(axis=1))
    u, v = (_along(along, axis) / size[:, None] for axis in _tangents(normals))
    terms = np.stack([np.ones_like(u), u, v, u * u + v * v], axis=2)
    inverse = np.linalg.pinv(np.einsum("nk,nki,nkj->nij", weights, terms, terms), hermitian=True)
    found = np.einsum("nij,nkj,nk,nk->ni", inverse, terms, weights, across)
    residuals2 = (across - np.einsum("nki,ni->nk", terms, found)) ** 2
    spread2 = (weights * residuals2).sum(axis=1) / np.maximum(weights.sum(axis=1) - 4.0, 1.0)
    return np.asarray((spread2 <= limit2) & (found[:, 0] ** 2 <= limit2))


def _tangents(normals: Floats) -> tuple[Floats, Floats]:
    """Return two directions (n, 3) across each normal (n, 3) and each other."""
    least = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)
