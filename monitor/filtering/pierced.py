"""Whether beams went through what was measured, or only past it on both sides.

In: points that the nearest beams of another scan all passed, and these beams; out: a mask of points. Of a finger or a
railing few of its steps wide a scan has mixed pixels alone. They were dropped, so that its nearest beams are those
beside it; a beam that went through has the points on all sides of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from monitor.filtering.silhouettes import axes_across
from projects.model import Bools, Floats, Ints

N_SIDES = 8  # of a beam on which the points must be, or of a point on which beams must have passed
N_NEXT = 4  # nearest, the last of which is a spacing away
AMONG, DENSER = 2, 0.5  # nearest point, and a beam's step over the way to it
BESIDE = 3  # nearest of a beam beside those that are missing, the last of which is a step away
REACH, GAP = 2.0, 1.5  # spacings from the beam at which points must be, and by which they may be missed there
RINGS, WHOLE = (0.4, 0.7, 1.0), 0.8  # steps from a point, and within which of there a beam passes unless one is missing
N_LINKS, LINK = 6, 2.0  # nearest points, and spacings to them, that make one part
PART = 0.25  # share of a part that goes as a whole


def find_pierced(points: Floats, seen_from: Floats, beams: cKDTree, near: Ints, slack: float) -> Bools:
    """Return which points (n, 3) [m] the beams of a scanner `seen_from` (3,) went through, part by part.

    A quarter of the points of a part must have a beam among their nearest that went through them, or the next beams
    on all sides as near as where none is missing; the rims of the part go with it.

    Parameters
    ----------
    beams : directions of the beams. near : (n, k) those nearest to each point.
    slack : m, by which the scans may lie off each other.
    """
    ranges = np.linalg.norm(points - seen_from, axis=1)
    towards = (points - seen_from) / np.maximum(ranges, 1e-12)[:, None]
    off = slack / np.maximum(ranges, 1e-12)
    through = _beam_within(towards, off, beams, near) | _none_missing(towards, off, beams, near[:, :N_NEXT])
    return _as_parts(points, through) if through.any() else through


def _beam_within(towards: Floats, off: Floats, beams: cKDTree, near: Ints) -> Bools:
    """Return for which points (n, 3) one of the beams `near` (n, k) has points on all sides, `off` [rad] and more."""
    if len(towards) <= N_NEXT:
        return np.zeros(len(towards), dtype=bool)
    points = cKDTree(towards)
    asked, back = np.unique(near, return_inverse=True)
    beam = beams.data[asked]
    nearest = points.query(beam)[1]
    spacing = _to_next(points, towards[nearest], N_NEXT)
    within = np.ones(len(asked), dtype=bool)
    for beside in _sides(beam, off[nearest] + REACH * spacing):
        within &= points.query(beside)[0] <= GAP * spacing
    return np.asarray(within[back.reshape(near.shape)].any(axis=1))


def _none_missing(towards: Floats, off: Floats, beams: cKDTree, near: Ints) -> Bools:
    """Return which points (n, 3), up to a step and `off` [rad] beside them too, have a beam as near as a grid has.

    Only where beams are so much denser than the points that of whatever one of these lies on one would be missing.
    """
    if len(towards) <= AMONG:
        return np.zeros(len(towards), dtype=bool)
    step = np.median(_to_next(beams, beams.data[near], BESIDE), axis=1)
    whole = step <= DENSER * _to_next(cKDTree(towards), towards, AMONG)
    whole[whole] = beams.query(towards[whole])[0] <= WHOLE * step[whole]
    for ring in RINGS:
        for beside in _sides(towards, off + ring * step):
            whole[whole] = beams.query(beside[whole])[0] <= WHOLE * step[whole]
    return np.asarray(whole)


def _to_next(tree: cKDTree, directions: Floats, n_next: int) -> Floats:
    """Return how far [rad] it is from each of the tree's own directions (..., 3) to the next ones."""
    return np.asarray(tree.query(directions, [n_next + 1])[0][..., 0])


def _sides(directions: Floats, aside: Floats) -> Iterator[Floats]:
    """Yield directions (n, 3) `aside` (n,) [rad] on all sides of each."""
    across, upward = axes_across(directions)
    for angle in np.linspace(0.0, 2.0 * math.pi, N_SIDES, endpoint=False):
        yield directions + aside[:, None] * (math.cos(angle) * across + math.sin(angle) * upward)


def _as_parts(points: Floats, through: Bools) -> Bools:
    """Return the points (n,) of parts, what lies together, of which `PART` is `through` (n,)."""
    apart, near = cKDTree(points).query(points, min(N_LINKS + 1, len(points)))
    apart, near = apart.reshape(len(points), -1), near.reshape(len(points), -1)
    spacing = apart[:, min(N_NEXT, apart.shape[1] - 1)]
    together = apart <= LINK * np.minimum(spacing[:, None], spacing[near])
    row = np.repeat(np.arange(len(points)), together.sum(axis=1))
    links = coo_array((np.ones(len(row), dtype=bool), (row, near[together])), shape=(len(points),) * 2)
    part = connected_components(links, directed=False)[1]
    share = np.bincount(part, through) / np.bincount(part)
    return np.asarray(share[part] >= PART)
