"""Points that another station looked through (Nothegger and Dorninger 2007, fig. 8 b: what a mirror-like patch gives).

In: the filtered clouds of an epoch in the project's frame, registered, with their scanners' positions; out: a mask for
each cloud. Where a beam of another scan went on to a surface behind, there is nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from monitor.filtering.silhouettes import RIM_GAP, widest_gap
from projects.model import Bools, Floats, Ints, PointCloud

N_AROUND = 16  # beams of the other scan that must have passed, the nearest ones, on all sides
N_BEAMS = 4  # of them, none farther aside than twice their own spacing
N_AGREE = 6  # nearest points of the same scan, of which half must be contradicted as well
SIGMAS = 5.0
STEEPEST = math.radians(80.0)  # a surface that the beams pass beside may lie as steep as this


def find_seen_through(clouds: Sequence[PointCloud], slack: float = 0.0) -> list[Bools]:
    """Return for each cloud the points (n,) that the beams of another cloud passed through.

    A point is contradicted where the beams of another scan that pass nearest to it, none of the four nearest farther
    aside than twice that scan's own spacing, all went on behind it by more than a steep surface, the noise of both and
    `slack` explain. They must pass on all sides of it: at the silhouette of a body whose rim was dropped, the nearest
    beams that are left may all pass beside the body. At least half of the points next to it must be contradicted too; a
    wire between the beams stays. What another scan measured as well stays: a scan may lack the whole of a thin part
    that it sees edge-on, an ear, and have beams on all sides of where it is.

    Parameters
    ----------
    clouds : with one origin (3,) each, in one frame; those of unknown origin, or with fewer than 8 points, say nothing.
    slack : m, by which the clouds may lie off each other. NaN, where that is not known: then nothing is contradicted.
    """
    masks = [np.zeros(len(c), dtype=bool) for c in clouds]
    for j, other in enumerate(clouds):
        if not _is_usable(other):
            continue
        assert other.origins is not None
        ranges, directions = _look(other.points - other.origins)
        tree = cKDTree(directions)
        for k, cloud in enumerate(clouds):
            if k != j and len(cloud):
                masks[k] |= _passed(cloud, other, (tree, ranges), slack)
    masks = [mask & _agreed(cloud, mask) for cloud, mask in zip(clouds, masks, strict=True)]
    return [mask & ~_measured_again(k, clouds, mask, slack) for k, mask in enumerate(masks)]


def _is_usable(cloud: PointCloud) -> bool:
    """Whether it is known where the beams of a cloud come from."""
    known = cloud.origins is not None and cloud.origins.ndim == 1 and bool(np.isfinite(cloud.origins).all())
    return known and len(cloud) > 2 * N_BEAMS


def _passed(cloud: PointCloud, other: PointCloud, seen: tuple[cKDTree, Floats], slack: float) -> Bools:
    """Return the points (n,) of a cloud that all of the nearest beams of the other passed."""
    tree, ranges = seen
    assert other.origins is not None
    here, towards = _look(cloud.points - other.origins)
    aside, beam = tree.query(towards)
    passed = _all_behind(cloud, other, here, aside[:, None], (beam[:, None], ranges), slack)
    which = np.flatnonzero(passed)  # most points end here
    if len(which):
        aside, beam = tree.query(towards[which], min(N_AROUND, len(other)))
        passed[which] = _all_behind(cloud.take(which), other, here[which], aside, (beam, ranges), slack)
        steps = tree.query(tree.data[beam[:, :N_BEAMS]], N_BEAMS + 1)[0][:, :, -1]
        passed[which] &= aside[:, N_BEAMS - 1] <= 2.0 * np.median(steps, axis=1)
        passed[which] &= widest_gap(towards[which], tree.data[beam] - towards[which][:, None]) < RIM_GAP
    return passed


def _look(vectors: Floats) -> tuple[Floats, Floats]:
    """Return the lengths (n,) [m] of vectors (n, 3) and their directions."""
    lengths = np.linalg.norm(vectors, axis=1)
    return lengths, vectors / np.maximum(lengths, 1e-12)[:, None]


def _all_behind(
    cloud: PointCloud, other: PointCloud, here: Floats, aside: Floats, beams: tuple[Ints, Floats], slack: float
) -> Bools:
    """Return the points (n,) at range `here` [m] behind which all the beams (n, k) `aside` by so many rad ended."""
    beam, ranges = beams
    sigma = np.hypot(_sigma(cloud)[:, None], _sigma(other)[beam])
    limit = here[:, None] * aside * math.tan(STEEPEST) + SIGMAS * sigma + slack
    return np.asarray((ranges[beam] - here[:, None] > limit).all(axis=1))


def _sigma(cloud: PointCloud) -> Floats:
    """Return one sigma (n,) [m] of the measurements behind each point, 0 where unknown."""
    sigma = cloud.spread if cloud.spread is not None else cloud.sigma
    return np.zeros(len(cloud)) if sigma is None else np.nan_to_num(sigma)


def _agreed(cloud: PointCloud, mask: Bools) -> Bools:
    """Return the points of a mask (n,) of which half of the nearest points are in it too."""
    agreed = np.zeros(len(mask), dtype=bool)
    if not mask.any():
        return agreed
    near = cKDTree(cloud.points).query(cloud.points[mask], min(N_AGREE + 1, len(cloud)))[1]
    agreed[mask] = mask[near.reshape(int(mask.sum()), -1)].mean(axis=1) >= 0.5
    return agreed


def _measured_again(k: int, clouds: Sequence[PointCloud], mask: Bools, slack: float) -> Bools:
    """Return the points of a mask (n,) of cloud k that lie no farther from another cloud than twice its spacing."""
    again = np.zeros(len(mask), dtype=bool)
    which = np.flatnonzero(mask)
    for j, other in enumerate(clouds):
        if j == k or len(other) <= N_BEAMS or not len(which):
            continue
        tree = cKDTree(other.points)
        apart, near = tree.query(clouds[k].points[which])
        spacing = tree.query(other.points[near], N_BEAMS + 1)[0][:, -1]
        again[which] |= apart <= 2.0 * spacing + slack
    return again
