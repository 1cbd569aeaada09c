"""Which share of what was measured around a vertex lies off the surface: plants, spray, joints, what nothing resolves.

In: a surface, and the raw points of the scans that it came of. Out: that share of each vertex. Where most of them lie
off it the points are of no one surface: which of their sheets stands for the object is a choice, and the points of
another survey make another.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numba import jit
from scipy.spatial import cKDTree

from monitor.boxes import middle_of
from monitor.comparison.distances.around import sum_around
from monitor.comparison.distances.feet import is_on_border
from monitor.comparison.distances.mesh_tree import MeshTree, build_tree
from monitor.comparison.distances.search import ANY, DEPTH, nearest_point
from monitor.comparison.distances.stars import gather_neighbours
from monitor.comparison.distances.triangles import FACE
from monitor.measured import RawScan
from monitor.robust import MAD_TO_SIGMA
from monitor.threads import run_tasks
from monitor.tuples import less
from projects.model import Bools, Floats, Ints, Surface

REACH = 2.5  # spacings of the vertices: points farther from the surface are of something else
OFF_SPACINGS, OFF_SIGMAS = 0.25, 4.0  # a point farther from the surface than both of these is off it
WIDE = 16.0  # spacings: an edge of the blocks, in threes each way, whose points show what is usual there
N_STEPS, FINEST = 60, 1e-3  # of distances, from so many spacings on, among which their median is found
ANY_ANGLE = np.pi / 2  # between normals, which nothing here asks for


def share_of_strays(surface: Surface, scans: Iterable[RawScan]) -> Floats | None:
    """Return the share (n,) float32 of the points around each vertex that lie off the surface; NaN where no point is,
    None where none is anywhere.

    Points count at the vertex next to their foot, and for those one and two edges from it: twice summed over each
    vertex and its neighbours, so that nearer ones count more often. Few points a vertex show little by themselves.
    Points over a free edge are beside the surface, and not off it.

    Off is what is farther than a quarter of the spacing of the vertices (root of the median area of one; finer shapes
    the surface cannot hold), than four sigmas of its scan, and than four sigmas of all points within some 24 spacings,
    by their median distance: dark material, far parts and fine relief scatter more, but over more than a joint. So
    plants that make up most of such a block (wider than some 40 spacings) pass for material, too.
    """
    tree = build_tree(surface, middle_of(surface.vertices), ANY_ANGLE)
    spacing = float(np.sqrt(np.median(tree.areas[tree.areas > 0.0])))
    is_invented = np.zeros(0, dtype=np.bool_) if surface.face_invented is None else surface.face_invented[tree.order]
    pieces: list[tuple[Ints, Floats, float]] = []
    for scan in scans:
        off = max(OFF_SPACINGS * spacing, OFF_SIGMAS * scan.sigma)
        for points in scan.pieces:
            corners, distances = nearest_vertices(tree, points, max(REACH * spacing, 2.0 * off), is_invented)
            known = corners >= 0
            if known.any():
                pieces.append((corners[known], distances[known], off))
    if not pieces:
        return None
    usual = OFF_SIGMAS * usual_sigma(surface.vertices, pieces, spacing)
    n_on, n_off = np.zeros(len(surface.vertices)), np.zeros(len(surface.vertices))
    for corners, distances, off in pieces:
        is_off = distances > np.maximum(off, usual[corners])
        n_on += np.bincount(corners[~is_off], minlength=len(n_on))
        n_off += np.bincount(corners[is_off], minlength=len(n_on))
    neighbours = gather_neighbours(tree)
    total_on, total_off = (sum_around(neighbours, sum_around(neighbours, n)) for n in (n_on, n_off))
    with np.errstate(invalid="ignore"):
        return np.asarray(total_off / (total_on + total_off), dtype=np.float32)


def usual_sigma(vertices: Floats, pieces: Sequence[tuple[Ints, Floats, float]], spacing: float) -> Floats:
    """Return one sigma (n,) [m] of the points around each vertex about the surface, by their median distance from it.

    `pieces` hold the vertex that each point counts at, and its distance [m]. Around is the block of `WIDE` spacings
    that the vertex lies in, and those that touch it.
    """
    blocks, of_vertices = np.unique(np.floor((vertices - vertices.min(axis=0)) / (WIDE * spacing)), axis=0,
                                 return_inverse=True)  # fmt: skip
    block_of = of_vertices.ravel()
    steps = spacing * np.geomspace(FINEST, 2.0 * REACH, N_STEPS)
    counts = np.zeros(len(blocks) * (N_STEPS + 1))
    for corners, distances, _ in pieces:
        at = block_of[corners] * (N_STEPS + 1) + np.searchsorted(steps, distances)
        counts += np.bincount(at, minlength=len(counts))
    by_block = counts.reshape(len(blocks), -1)
    touching = cKDTree(blocks).query_ball_point(blocks, np.sqrt(3.0) + 0.01)
    summed = np.cumsum([by_block[near].sum(axis=0) for near in touching], axis=1)
    median = np.argmax(summed >= 0.5 * summed[:, -1:], axis=1)
    return np.asarray(MAD_TO_SIGMA * steps[np.minimum(median, N_STEPS - 1)][block_of])


def nearest_vertices(tree: MeshTree, points: Floats, reach: float, is_invented: Bools) -> tuple[Ints, Floats]:
    """Return of each point (k, 3) the vertex next to its nearest place on the surface, and its distance [m] from there.

    -1 and NaN where that is farther than `reach` [m], on a free edge, or on a face that is invented (m,), in the tree's
    order; empty: none is.
    """
    corners, distances = np.full(len(points), -1, dtype=np.int32), np.full(len(points), np.nan)
    run_tasks(_find_vertices, len(points), tree, np.ascontiguousarray(points), reach, is_invented,
              corners, distances)  # fmt: skip
    return corners, distances


@jit(nopython=True, cache=True, nogil=True)
def _find_vertices(first, last, tree, points, reach, is_invented, corners, distances):  # type: ignore[no-untyped-def]
    """Write what `nearest_vertices` returns of the points from `first` to `last`."""
    stack, bounds, seed = np.empty(DEPTH, dtype=np.int64), np.empty(DEPTH), -1
    for i in range(first, last):
        p = less(points, i, tree.shift)
        found = nearest_point(tree, p, (0.0, 0.0, 0.0), (reach, -2.0), seed, ANY, stack, bounds)
        f = found[1]
        if f < 0:
            continue
        seed = f
        if found[4] != FACE and is_on_border(tree, f, found[4]):
            continue
        if len(is_invented) > 0 and is_invented[f]:
            continue
        a, b, c = 1.0 - (found[2] + found[3]), found[2], found[3]
        k = (1 if b >= c else 2) if max(b, c) > a else 0
        corners[i], distances[i] = tree.faces[f, k], np.sqrt(found[0])
