"""Points that one scan takes for strays and another station bears out: what is too small for one scan alone to show.

In: the filtered clouds of an epoch, registered, and beside each the points that its scan left out because they lie off
their neighbours' plane; out: a mask of those that belong to a surface. A pit of a few points is a few strays to each
scan; but strays of two stations, on beams that cross, rarely lie on one surface.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import chi2

from monitor.across import frames_across
from monitor.filtering.off_plane import CUT2, MAX_COMPANIONS, MIN_COMPANIONS
from monitor.filtering.silhouettes import RIM_GAP, widest_gap
from projects.model import Bools, Floats, Ints, PointCloud

N_NEAR = 128  # points looked at around each: about those of the neighbourhoods of two scans
N_PLANE, N_AROUND = 24, 96  # nearest points that its own scan kept: most are of the plane, and what is on all sides
REACH = 4.1  # spacings, within which six points of a surface lie even beside its border (`off_plane.find_companions`)
MIN_OTHERS = 2  # companions that another station saw
MIN_OF_BOWL = 8  # companions: a bowl has four coefficients
FLAT = 0.25  # of the lesser variance along a surface, at most, is that across it
SURE = 0.99  # of bowls fit as near to their points
CROSSING = np.sin(np.radians(5.0))  # beams from one place, or nearly, have their strays in common
BLOCK = 4096  # points at a time


def find_borne_out(clouds: Sequence[PointCloud], doubtful: Sequence[PointCloud], slack: float) -> list[Bools]:
    """Return for each cloud which of its doubtful points (n,) lie on a surface that another station saw too.

    Such a point lies behind the plane that its scan shows on all sides of it: beyond an edge, and before it, every
    station measures the same fringe, where its spot reaches over. Around it are at least `MIN_COMPANIONS` points behind
    that plane, itself among them; those nearest to it lie in a plane or a bowl, as near as noise and `slack` explain,
    and `MIN_OTHERS` of them were seen by a station elsewhere before that plane.

    Parameters
    ----------
    clouds, doubtful : in one frame, with normals, sigma, spacing and origins (3,); of unknown origin, no point is kept.
    slack : m, three sigma of what the clouds may lie off each other by. NaN, where that is not known: nothing is kept.
    """
    borne_out = [np.zeros(len(d), dtype=bool) for d in doubtful]
    origins = np.array([_origin_of(c) for c in clouds])
    is_placed = np.isfinite(origins).all(axis=1)
    if np.isnan(slack) or is_placed.sum() < 2 or not any(map(len, doubtful)):
        return borne_out
    witnesses = _Witnesses(clouds, doubtful, origins)
    for k, (cloud, those) in enumerate(zip(clouds, doubtful, strict=True)):
        if is_placed[k] and len(cloud) >= N_PLANE:
            tree = cKDTree(cloud.points)
            for block in _blocks(len(those)):
                pits = _find_pits(those.take(block), cloud, tree, slack)
                borne_out[k][block[pits.which]] = _borne_out(pits, witnesses, k)
    return borne_out


class _Witnesses:
    """All points of an epoch, kept or doubtful: where they are, and where their scanner stood."""

    def __init__(self, clouds: Sequence[PointCloud], doubtful: Sequence[PointCloud], origins: Floats) -> None:
        parts = [*clouds, *doubtful]
        self.points = np.concatenate([c.points for c in parts])
        self.cloud = np.concatenate([np.full(len(c), i % len(clouds)) for i, c in enumerate(parts)])
        self.origins = origins
        self.tree = cKDTree(self.points)

    def are_other(self, points: Floats, normals: Floats, k: int) -> Bools:
        """Return which clouds are witnesses to points (n, 3) of cloud k: seen from before their plane, on beams that
        cross those of k (n, clouds)."""
        towards = self.origins[None] - points[:, None]
        towards /= np.linalg.norm(towards, axis=2, keepdims=True)
        crosses = np.linalg.norm(np.cross(towards, towards[:, k : k + 1]), axis=2) > CROSSING
        return np.asarray(crosses & (_along(towards, normals) > 0.0))  # NaN, of an unknown place, is none


class _Pits(NamedTuple):
    """Doubtful points behind the plane that their scan shows on all sides of them.

    `which` (m,) of those given; `points`, `normals` (m, 3); m: `depths` (m,) behind the plane, `limits` (m,) of what
    noise and slack explain, `reaches` (m,) of what is near.
    """

    which: Ints
    points: Floats
    normals: Floats
    depths: Floats
    limits: Floats
    reaches: Floats


def _find_pits(those: PointCloud, cloud: PointCloud, tree: cKDTree, slack: float) -> _Pits:
    """Return which of some doubtful points lie in pits of the cloud that their scan kept."""
    normals, sigma, spacing = those.normals, those.sigma, those.spacing
    assert normals is not None
    assert sigma is not None
    assert spacing is not None
    limits = np.sqrt(CUT2 * (sigma**2 + (slack / 3.0) ** 2))
    nearest = tree.query(those.points, N_PLANE, workers=2)[1]
    depths = np.median(_along(cloud.points[nearest] - those.points[:, None], normals), axis=1)
    which = np.flatnonzero(depths > limits)  # most points end here
    around = tree.query(those.points[which], min(N_AROUND, len(cloud)), workers=2)[1]
    own = cloud.points[around] - those.points[which, None]
    in_plane = np.abs(_along(own, normals[which]) - depths[which, None]) <= limits[which, None]
    gap = widest_gap(normals[which], np.where(in_plane[:, :, None], own, 0.0)) if len(which) else np.zeros(0)
    which = which[gap < RIM_GAP]
    return _Pits(which, those.points[which], normals[which], depths[which], limits[which], REACH * spacing[which])


def _origin_of(cloud: PointCloud) -> Floats:
    """Return where the scanner of a cloud stood (3,), NaN where that is not known, or not one place."""
    return cloud.origins if cloud.origins is not None and cloud.origins.ndim == 1 else np.full(3, np.nan)


def _blocks(n_points: int) -> Iterator[Ints]:
    """Yield the numbers of so many points, block by block."""
    for first in range(0, n_points, BLOCK):
        yield np.arange(first, min(first + BLOCK, n_points))


def _borne_out(pits: _Pits, witnesses: _Witnesses, k: int) -> Bools:
    """Return which points (m,) of cloud k, behind its plane, others bear out."""
    apart, near = witnesses.tree.query(pits.points, min(N_NEAR, len(witnesses.points)), workers=2)
    offsets = witnesses.points[near] - pits.points[:, None]
    behind = pits.depths[:, None] - _along(offsets, pits.normals)
    chosen = (behind > pits.limits[:, None]) & (apart <= pits.reaches[:, None])
    chosen &= np.cumsum(chosen, axis=1) <= MAX_COMPANIONS
    are_other = witnesses.are_other(pits.points, pits.normals, k)
    others = chosen & np.take_along_axis(are_other, witnesses.cloud[near], axis=1)
    out = (chosen.sum(axis=1) >= MIN_COMPANIONS) & (others.sum(axis=1) >= MIN_OTHERS)
    offsets, chosen, limit2, normals = offsets[out], chosen[out], pits.limits[out] ** 2, pits.normals[out]
    out[out] = _is_plane(offsets, chosen, limit2) | _is_bowl(offsets, chosen, limit2, normals)
    return out


def _along(offsets: Floats, normals: Floats) -> Floats:
    """Return the products (n, k) of offsets (n, k, 3) with the normal (n, 3) of each row."""
    return np.einsum("nki,ni->nk", offsets, normals)


def _is_plane(offsets: Floats, chosen: Bools, limit2: Floats) -> Bools:
    """Return where the chosen offsets (n, k, 3) from a point lie in a plane as thin as `limit2` (n,) [m2], it in it."""
    weights = chosen / chosen.sum(axis=1, keepdims=True)
    means = np.einsum("nk,nki->ni", weights, offsets)
    about = (offsets - means[:, None]) * np.sqrt(weights)[:, :, None]
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", about, about))
    n_points = chosen.sum(axis=1)
    least = np.maximum(values[:, 0], 0.0) * n_points / (n_points - 3.0)
    height = np.einsum("ni,ni->n", means, vectors[:, :, 0])
    return np.asarray((least <= limit2) & (least <= FLAT * values[:, 1]) & (height**2 <= limit2))


def _is_bowl(offsets: Floats, chosen: Bools, limit2: Floats, normals: Floats) -> Bools:
    """Return where the chosen offsets (n, k, 3) from a point lie as near to a bowl over the plane of `normals` (n, 3),
    the point in it: a height that is linear but for its square distance."""
    weights, n_points = chosen.astype(float), chosen.sum(axis=1)
    across = _along(offsets, normals)
    along = offsets - across[:, :, None] * normals[:, None]
    size2 = (weights * np.einsum("nki,nki->nk", along, along)).sum(axis=1) / n_points
    u, v = (_along(along, axis) / np.sqrt(size2)[:, None] for axis in frames_across(normals))
    terms = np.stack([np.ones_like(u), u, v, u * u + v * v], axis=2)
    inverse = np.linalg.pinv(np.einsum("nk,nki,nkj->nij", weights, terms, terms), hermitian=True)
    found = np.einsum("nij,nkj,nk,nk->ni", inverse, terms, weights, across)
    residuals2 = weights * (across - np.einsum("nki,ni->nk", terms, found)) ** 2
    freedom = np.maximum(n_points - 4.0, 1.0)
    sigma2 = limit2 / CUT2
    is_near = residuals2.sum(axis=1) <= sigma2 * chi2.ppf(SURE, freedom)
    is_flat = residuals2.sum(axis=1) <= FLAT * 0.5 * size2 * freedom
    return np.asarray((n_points >= MIN_OF_BOWL) & is_near & is_flat & (found[:, 0] ** 2 <= limit2))
