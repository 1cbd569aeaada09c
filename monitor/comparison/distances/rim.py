"""How far places on a surface are from its free edges: there it goes on beyond its samples, or was not seen."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from monitor.blocks import blocks
from monitor.comparison.distances.quantile import median
from monitor.comparison.distances.stars import Survey, first_sides, free_edges, make_mesh, survey_vertices
from projects.model import Bools, Floats, Surface
from projects.triangles import measured_faces

FAR_EDGES = 40.0  # a free edge farther than this many edges has no influence
MOST_CELLS = 100  # of the coarse grid that tells which points have a free edge near, along its longest side


class Rim(NamedTuple):
    """The free edges of a surface: `points` (k, 3) [m] along them, less `shift` (3,), their `tree`, and how far away
    [m] they are looked for."""

    points: Floats
    shift: Floats
    tree: cKDTree
    farthest: float


class Ends(NamedTuple):
    """Where a surface ends: its `rim`, None where it is closed, which of its vertices (n,) lie on it, and the area
    (n,) [m2] each stands for; of those that rest on nothing the median, so that they say nothing of the spacing."""

    rim: Rim | None
    is_border: Bools
    areas: Floats


def ends_of(surface: Surface, mesh: Any, survey: Survey, limit: float) -> Ends:
    """Return where what was measured of a surface ends; `mesh` and `survey` are of all its faces.

    At a hole that invented faces close it ends as at one that is open. See `outline` for `limit` [m].
    """
    if surface.face_invented is None:
        return Ends(outline(mesh, survey.is_border, limit), survey.is_border, survey.areas)
    measured = make_mesh(mesh.vertices, measured_faces(surface), mesh.shift)
    own = survey_vertices(measured)
    is_measured = own.n_neighbours > 0
    areas = np.where(is_measured, own.areas, median(own.areas[is_measured])) if is_measured.any() else survey.areas
    return Ends(outline(measured, own.is_border, limit), own.is_border, areas)


def outline(mesh: Any, is_border: Bools, limit: float) -> Rim | None:
    """Return the free edges of a mesh, None where it has none; `is_border` (n,) of its vertices.

    Long ones are taken in steps of half the median edge. They are looked for up to `limit` [m], or `FAR_EDGES` median
    edges where that is more.
    """
    edges = free_edges(mesh, is_border)
    if not len(edges):
        return None
    step = 0.5 * median(first_sides(mesh))
    points = _points_along(mesh.vertices[edges[:, 0]] - mesh.shift, mesh.vertices[edges[:, 1]] - mesh.shift, step)
    return Rim(points, mesh.shift, cKDTree(points), max(limit, 2.0 * FAR_EDGES * step))


def distance_to_rim(rim: Rim | None, points: Floats) -> Floats:
    """Return the distance (n,) [m] of points to the free edges of a surface, to a quarter edge.

    It is inf beyond what is looked at, and where there is no free edge; NaN for a point that is NaN. Points are in
    global coordinates.
    """
    out = np.where(np.isnan(points[:, 0]), np.nan, np.inf)
    if rim is None:
        return out
    for block in blocks(len(points)):
        known = np.flatnonzero(~np.isnan(out[block]))
        local = points[block][known] - rim.shift
        near = _is_near(rim.points, local, rim.farthest)
        out[block][known[near]] = rim.tree.query(local[near], distance_upper_bound=rim.farthest, workers=-1)[0]
    return out


def _points_along(start: Floats, end: Floats, step: float) -> Floats:
    """Return points (k, 3) along edges, their starts first, no farther apart than `step` [m]."""
    n_steps = np.clip(np.ceil(np.linalg.norm(end - start, axis=1) / max(step, 1e-300)), 1, 1000).astype(np.int64)
    which = np.repeat(np.arange(len(start)), n_steps)
    t = (np.arange(len(which)) - np.repeat(np.cumsum(n_steps) - n_steps, n_steps)) / n_steps[which]
    return start[which] + t[:, None] * (end - start)[which]


def _is_near(rim: Floats, points: Floats, farthest: float) -> Bools:
    """Return whether each point (n,) lies in a cell of a coarse grid that has `rim` in it or beside it.

    Cells are no smaller than `farthest` [m]: what is nearer than that is not passed over.
    """
    low = rim.min(axis=0)
    size = np.ptp(rim, axis=0)
    cell = max(farthest, float(size.max()) / MOST_CELLS)
    n = np.floor(size / cell).astype(np.int64) + 3  # a cell more on either side
    marked = np.zeros(n, dtype=np.bool_)
    i, j, k = (np.floor((rim - low) / cell).astype(np.int64) + 1).T
    for di in (-1, 0, 1):
        for dj in (-1, 0, 1):
            for dk in (-1, 0, 1):
                marked[i + di, j + dj, k + dk] = True
    at = np.floor((points - low) / cell).astype(np.int64) + 1
    inside = ((at >= 0) & (at < n)).all(axis=1)
    i, j, k = np.where(inside[:, None], at, 0).T
    return inside & marked[i, j, k]
