"""Regions that the measured points bear out: between its points a surface is a guess, and a guess is no change.

In: regions found on two surfaces, and the points that these were made of. Out: the regions whose change the points of
both epochs show. Where points are sparse and hold relief between them, fits carry a surface past it that no vertex
knows to be wrong; the points around the gap lie on the other epoch's surface all the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from monitor.boxes import middle_of
from monitor.comparison.distances.perpendicular import distances_to_shell
from monitor.comparison.distances.shell import make_shell
from monitor.comparison.distances.side import Side
from monitor.comparison.distances.stars import Neighbours
from monitor.comparison.regions.beyond import SIGNS
from monitor.comparison.regions.finding import Regions
from monitor.comparison.regions.moved import name_moved
from monitor.reconstruction.bow import bow_at
from monitor.registration.motion.weights import draw_in
from projects.model import Bools, Floats, Ints, NotAssessed, Surface

Points = Callable[[], tuple[Floats | None, Floats | None]]  # (n, 3) m of each epoch, in its own coordinates
LEAST_SHOWN = 0.5  # of the change told of the vertices: points that show less lie nearer to no change at all
SURE = 3.0  # standard errors of what they show, by their scatter: few points on rough stone show something by chance
MOVED = "moved"
RINGS = 3  # of vertices around those that are asked for, so that no foot lies at the end of what was cut out
FARTHEST_BESIDE = 2.0  # spacings of the vertices: a point farther along the surface from its vertex is beside it


def keep_borne_out(
    regions: Regions, sides: tuple[Side, Side], points: tuple[Floats | None, Floats | None],
    limits: tuple[float, float], is_gone: Bools,
) -> tuple[Regions, tuple[Side, Side]]:  # fmt: skip
    """Return the regions that the points of both epochs bear out, and the sides without the vertices of the others.

    Where surfaces change by c, and the points of both lie b off their own (pits, grains and joints are not even about
    a surface), those of the one epoch show 1 + b / c of it, those of the other 1 - b / c. The sum of both shares, less
    1, is the change from points to points: at least `LEAST_SHOWN` of what is told, and `SURE` times its standard error.

    Parameters
    ----------
    regions : r of them, as `find_regions` returns them.
    points : (n, 3) m of the reference and of the compared epoch, in the reference's coordinates. An epoch that has
        none, as a finished mesh, is not asked; chips (`Regions.is_chip`) need both: surfaces alone differ as much
        beside steps, where fits swing, and along edges that two meshes hold in other places.
    limits : m and rad, the search limit and the largest angle between normals.
    is_gone : (r,) what was looked through, which needs no surface to be told.
    """
    is_borne_out = are_borne_out(sides, regions.seen, len(regions.table), points, limits) | is_gone
    if any(own is None for own in points) and len(regions.is_chip):
        is_borne_out &= ~regions.is_chip
    return keep_known(regions, sides, is_borne_out)


def are_borne_out(
    sides: tuple[Side, Side], regions: tuple[Ints, Ints], n: int, points: tuple[Floats | None, Floats | None],
    limits: tuple[float, float], left: tuple[Floats, Floats] | None = None, each_must: bool = False,
) -> Bools:  # fmt: skip
    """Return which of the regions 1 to `n` (n,) the points of both epochs bear out; see `keep_borne_out`.

    `left` (n,) [m] of each side is what a motion of the whole makes of its distances, where those of the sides are told
    without it. `each_must`: an epoch of which no point says anything bears nothing out.
    """
    shown, variance = np.ones(n + 1), np.zeros(n + 1)
    for k, own in enumerate(points):
        if own is not None:
            share, error2 = shares_shown(sides, regions, k, own, limits, n, None if left is None else left[k])
            shown, variance = shown + share - 1.0, variance + error2
            shown[(error2 == 0.0) & each_must] = -np.inf
    return np.asarray(shown >= np.maximum(LEAST_SHOWN, SURE * np.sqrt(variance)))[1:]


def drop_guessed(regions: Regions, sides: tuple[Side, Side]) -> tuple[Regions, tuple[Side, Side]]:
    """Return the regions without those that the surfaces may have made up (`Regions.is_guess`), and the sides without
    their vertices: what happened there is not known."""
    return keep_known(regions, sides, ~regions.is_guess) if len(regions.is_guess) else (regions, sides)


def keep_known(regions: Regions, sides: tuple[Side, Side], is_known: Bools) -> tuple[Regions, tuple[Side, Side]]:
    """Return the regions that are known (r,), and the sides without the vertices of the others."""
    if is_known.all():
        return regions, sides
    in_known = np.append(True, is_known)
    a, b = (s.without(s.is_assessed & ~in_known[r], NotAssessed.TOO_UNCERTAIN)
            for s, r in zip(sides, regions.seen, strict=True))  # fmt: skip
    regions = regions.keep(np.flatnonzero(is_known))
    return replace(regions, table=name_anew(regions.table, (a, b), regions.seen)), (a, b)


def name_anew(table: pd.DataFrame, sides: tuple[Side, Side], regions: tuple[Ints, Ints]) -> pd.DataFrame:
    """Return the table in which what was named moved is lost or added where its counterpart is gone."""
    if not (table["kind"] == MOVED).any():
        return table
    by_sign = np.where(table["mean_m"] < 0.0, "lost", "added")
    table = table.assign(kind=np.where(table["kind"] == MOVED, by_sign, table["kind"]))
    return table.assign(kind=name_moved(table, sides, regions))


def shares_shown(
    sides: tuple[Side, Side], regions: tuple[Ints, Ints], k: int, points: Floats, limits: tuple[float, float], n: int,
    left: Floats | None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return which share (n + 1,) of the change told of the regions 1 to `n` the points (m, 3) m of side `k` show, and
    its variance (n + 1,).

    Each point's own change m, its perpendicular distance to the other side, is held against the change c told of the
    vertex next to it. What the points of a vertex show is the mean of theirs, all of them: where they lie on several
    sheets, a surface follows one, and the points on it alone would always bear it out. The share is the sum of m over
    that of c, over vertices with points, weighted by area: where points are dense does not move it, and strays are
    drawn in. 0 where a region holds no point of this epoch; 1 where it has no vertex or no foot here, and for entry 0,
    of no region: this epoch says nothing then. `left` (n,) [m] is taken off what the points show at each vertex.
    """
    side, other = sides[k], sides[1 - k]
    label, claim = told_at(side, other, regions[k], regions[1 - k])
    out, variance, told = np.ones(n + 1), np.zeros(n + 1), np.flatnonzero(label > 0)
    which, vertex = points_next_to(side, label, points, limits[0])
    has_points = np.bincount(label[vertex], minlength=n + 1) > 0
    out[label[told][~has_points[label[told]]]] = 0.0
    if not len(which):
        return out, variance
    around = spread_rings(other.neighbours, _asked_of(side, label, regions[1 - k]), RINGS)
    change = SIGNS[k] * distances_to_part(points[which], side.normals[vertex], other.surface, around, limits)
    change = change if left is None else change - left[vertex]
    known = np.flatnonzero(np.isfinite(change) & (claim[vertex] != 0.0))
    vertex, change = vertex[known], change[known]
    rising = np.argsort(label[vertex], kind="stable")
    for own in np.split(rising, np.flatnonzero(np.diff(label[vertex[rising]])) + 1) if len(rising) else ():
        number = label[vertex[own[0]]]
        out[number], variance[number] = _share_of(vertex[own], change[own], claim, side.areas)
    return out, variance


def _share_of(vertex: Ints, change: Floats, claim: Floats, areas: Floats) -> tuple[float, float]:
    """Return the share of one region's change that points (m,) next to the vertices `vertex` show, and its variance.

    The variance is that of points that scatter by themselves about what is told; of a single one it is not known.
    """
    beyond = draw_in(change - claim[vertex])
    at, place, counts = np.unique(vertex, return_inverse=True, return_counts=True)
    mean, weight = np.bincount(place, beyond) / counts, areas[at] * np.sign(claim[at])
    told = float(weight @ claim[at])
    scatter2 = float(np.var(beyond, ddof=1)) if len(beyond) > 1 else np.inf
    return 1.0 + float(weight @ mean) / told, scatter2 * float(np.sum(areas[at] ** 2 / counts)) / told**2


def told_at(side: Side, other: Side, own: Ints, others: Ints) -> tuple[Ints, Floats]:
    """Return the region (n,) that each vertex of a side is told to lie in, 0 for none, and the change (n,) [m] told.

    Of a vertex in no region on its own side it is the mean of what the other side tells, whose feet are next to it.
    """
    label = np.zeros(len(own), dtype=np.int64)
    there = np.flatnonzero((others > 0) & other.is_assessed & (other.foot_vertices >= 0))
    feet = other.foot_vertices[there]
    label[feet] = others[there]
    claim = np.bincount(feet, other.distances[there], len(own)) / np.maximum(np.bincount(feet, minlength=len(own)), 1)
    here = np.flatnonzero((own > 0) & side.is_assessed)
    label[here], claim[here] = own[here], side.distances[here]
    return label, claim


def points_next_to(side: Side, label: Ints, points: Floats, limit: float) -> tuple[Ints, Ints]:
    """Return which of the points (m, 3) lie over a labelled vertex, nearer to it than to any other, and over which.

    Over it is what lies within `limit` [m] of it, and not beside the surface, which may end there.
    """
    is_told, vertices = label > 0, side.surface.vertices
    low, high = (f(vertices[is_told], axis=0, initial=i) for f, i in ((np.min, np.inf), (np.max, -np.inf)))
    near = np.flatnonzero(is_within(vertices, low - 2.0 * limit, high + 2.0 * limit))
    which = np.flatnonzero(is_within(points, low - limit, high + limit))
    nothing = np.empty(0, dtype=np.int64)
    if not (len(near) and len(which)):
        return nothing, nothing
    _, nearest = cKDTree(vertices[near]).query(points[which], distance_upper_bound=limit, workers=2)
    found = nearest < len(near)
    which, vertex = which[found], near[nearest[found]]
    away, normal = points[which] - vertices[vertex], side.normals[vertex]
    beside = np.linalg.norm(away - np.einsum("ij,ij->i", away, normal)[:, None] * normal, axis=1)
    is_over = is_told[vertex] & (beside < FARTHEST_BESIDE * np.sqrt(np.median(side.areas)))
    return which[is_over], vertex[is_over]


def is_within(points: Floats, low: Floats, high: Floats) -> Bools:
    """Return which points (n, 3) lie in a box."""
    return np.asarray(((points >= low) & (points <= high)).all(axis=1))


def _asked_of(side: Side, label: Ints, others: Ints) -> Bools:
    """Return which vertices of the other side lie in a region or under a vertex that is labelled here."""
    out = others > 0
    feet = side.foot_vertices[label > 0]
    out[feet[feet >= 0]] = True
    return np.asarray(out)


def spread_rings(neighbours: Neighbours, marked: Bools, n_rings: int) -> Bools:
    """Return the marked vertices (n,) and those up to `n_rings` edges away from one."""
    degrees = np.diff(neighbours.starts)
    for _ in range(n_rings):
        beside = np.repeat(marked, degrees)
        marked = marked.copy()
        marked[neighbours.vertices[beside]] = True
    return marked


def distances_to_part(
    points: Floats, normals: Floats, surface: Surface, part: Bools, limits: tuple[float, float]
) -> Floats:
    """Return the perpendicular distance (m,) [m] of points to the part of a surface whose vertices are in `part` (n,);
    NaN where it has no foot there. The surface bends as its normals say, as where sides are measured."""
    cut = cut_out(surface, part)
    if not len(cut.faces):
        return np.full(len(points), np.nan)
    shell = make_shell(cut, middle_of(cut.vertices), limits)
    feet = distances_to_shell(Surface(vertices=points, faces=np.empty((0, 3), dtype=np.int32)), normals, shell)
    distances = feet.distances - bow_at(cut, feet.faces, feet.weights)
    return np.where(feet.reasons == NotAssessed.ASSESSED, distances, np.nan)


def cut_out(surface: Surface, part: Bools) -> Surface:
    """Return the faces of a surface whose three vertices are in `part` (n,), with what their shape is told by."""
    is_in = part[surface.faces].all(axis=1)
    used, faces = np.unique(surface.faces[is_in], return_inverse=True)

    def of(values: Any, which: Any) -> Any:
        return None if values is None else values[which]

    return Surface(
        vertices=surface.vertices[used], faces=faces.reshape(-1, 3), normals=of(surface.normals, used),
        sigma=of(surface.sigma, used), is_crest=of(surface.is_crest, used),
        face_invented=of(surface.face_invented, is_in),
    )  # fmt: skip
