"""Perpendicular distances of a surface's vertices to another surface (docs/method.md, step 12, `papers/002`).

In: two surfaces in one frame. Out: for each vertex the signed distance, its foot on the other surface and, where it
has none, the reason. Sign: positive on the outer side of the *other* surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import jit

from monitor.blocks import blocks
from monitor.boxes import box_of, middle_of
from monitor.comparison.distances.feet import FOOT, NO_FOOT, NOTHING_NEAR, ON_BORDER
from monitor.comparison.distances.portions import search_feet
from monitor.comparison.distances.rim import distance_to_rim
from monitor.comparison.distances.shell import Shell, make_shell
from monitor.comparison.distances.stars import angle_weighted_normals, make_mesh
from monitor.threads import run_tasks
from projects.errors import ParameterError
from projects.model import Bools, Floats, Ints, NotAssessed, Surface


@dataclass(frozen=True)
class Feet:
    """Where the perpendiculars of a surface's vertices meet another surface.

    `distances` (n,) [m] are positive on the other surface's outer side, NaN without a foot; `faces` (n,) is the
    face of the other surface, -1 without; `weights` (n, 3) are those of its corners; `reasons` are
    `NotAssessed`; `to_rim` (n,) [m] is how far the foot lies from the other surface's free edges (inf: it has none).
    """

    distances: Floats
    faces: Ints
    weights: Floats
    reasons: Ints
    to_rim: Floats


def search_limit(reference: Surface, compared: Surface, share: float) -> float:
    """Return the largest distance looked at [m]: a share of the smaller surface's diagonal."""
    boxes = [box_of(s.vertices) for s in (reference, compared)]
    return share * min(float(np.linalg.norm(high - low)) for low, high in boxes)


def unit_normals(surface: Surface, from_faces: Floats | None = None) -> Floats:
    """Return outward unit normals (n, 3): those of the surface, angle-weighted from its faces where it has none.

    `from_faces` (n, 3) are the angle-weighted ones, where they are known already.
    """
    if from_faces is None:
        from_faces = angle_weighted_normals(make_mesh(surface.vertices - surface.vertices.mean(axis=0), surface.faces))
    if surface.normals is None:
        return from_faces
    out = np.empty(from_faces.shape)
    for block in blocks(len(out)):
        length = np.linalg.norm(surface.normals[block], axis=1, keepdims=True)
        known = np.isfinite(length) & (length > 0.5)
        out[block] = np.where(known, surface.normals[block] / np.where(known, length, 1.0), from_faces[block])
    return out


def normal_distances(surface: Surface, other: Surface, limit: float, max_angle: float = np.pi / 3) -> Feet:
    """Measure each vertex of a surface against the other surface along the other's normal.

    The foot is on the nearest of the faces that look the same way (normals within `max_angle` [rad]) and over whose
    interior, edge or vertex star the vertex stands, within `limit` [m]. Where the foot lies nearer to a free edge than
    to the vertex, the other surface ends there and what it would be is not known: FREE_EDGE.

    Returns
    -------
    Feet
        Positive where the vertex lies on the outer side of `other`.

    References
    ----------
    `papers/002`; signs: Baerentzen and Aanaes (2005), Signed distance computation using the angle weighted
    pseudonormal, IEEE TVCG 11(3).
    """
    if not 0.0 < limit < np.inf or not 0.0 < max_angle < 0.5 * np.pi:
        raise ParameterError(
            f"limit = {limit!r} m and max_angle = {max_angle!r} rad: a length above 0 and an angle between 0 and "
            "pi / 2 are needed"
        )
    shift = middle_of(other.vertices)
    shell = make_shell(other, shift, (limit, max_angle))
    return distances_to_shell(surface, unit_normals(surface), shell)


def distances_to_shell(surface: Surface, normals: Floats, shell: Shell) -> Feet:
    """Measure each vertex against a surface made ready; see `normal_distances`.

    `normals` (n, 3) are the vertices' unit normals.
    """
    other = shell.surface
    faces, weights, distances, outcome = search_feet(shell, surface.vertices, normals)
    reasons = np.full(len(faces), NotAssessed.SHEET_BETWEEN, dtype=np.uint8)
    reasons[outcome == FOOT] = NotAssessed.ASSESSED
    reasons[outcome == ON_BORDER] = NotAssessed.FREE_EDGE
    reasons[outcome == NO_FOOT] = NotAssessed.NO_FACE
    reasons[outcome == NOTHING_NEAR] = NotAssessed.BEYOND_SEARCH
    feet = Feet(distances, faces, weights, reasons, np.full(len(faces), np.nan))
    feet.to_rim[:] = _rim_of_feet(feet, shell)
    to_rim = feet.to_rim
    reasons[(reasons == NotAssessed.ASSESSED) & (to_rim < np.abs(distances))] = NotAssessed.FREE_EDGE
    reasons[(reasons == NotAssessed.ASSESSED) & _is_invented(other, faces)] = NotAssessed.NOT_SEEN
    return feet


def _rim_of_feet(feet: Feet, shell: Shell) -> Floats:
    """Return how far (n,) [m] the feet lie from the free edges of the other surface: inf where it has none, NaN without
    a foot."""
    out = np.where(feet.faces >= 0, np.inf, np.nan)
    if shell.rim is not None:
        for block in blocks(len(out)):
            out[block] = distance_to_rim(shell.rim, _at_feet(shell.surface.vertices, shell.surface, feet, block))
    return out


def interpolate_at_feet(values: Floats, other: Surface, feet: Feet) -> Floats:
    """Return a vertex quantity (n_other,) of the other surface at the feet (n,); NaN without a foot."""
    out = np.empty(len(feet.faces))
    run_tasks(_weigh_corners, len(out), values, np.asarray(other.faces), feet.faces, feet.weights, out)
    return out


@jit(nopython=True, cache=True, nogil=True)
def _weigh_corners(first, last, values, faces, at, weights, out):  # type: ignore[no-untyped-def]
    """Write the weighted mean of the values at the corners of the face `at` (n,); NaN without a face."""
    for i in range(first, last):
        f, out[i] = at[i], np.nan
        if f >= 0:
            ends = weights[i, 0] * values[faces[f, 0]] + weights[i, 2] * values[faces[f, 2]]
            out[i] = ends + weights[i, 1] * values[faces[f, 1]]


def _at_feet(values: Floats, other: Surface, feet: Feet, block: slice) -> Floats:
    """Return a vertex quantity of the other surface at the feet in a block; NaN without a foot."""
    out = np.full((len(feet.faces[block]), *values.shape[1:]), np.nan)
    has_foot = np.flatnonzero(feet.faces[block] >= 0)
    corners = values[other.faces[feet.faces[block][has_foot]]]
    out[has_foot] = np.einsum("ij,ij...->i...", feet.weights[block][has_foot], corners)
    return out


def _is_invented(other: Surface, faces: Ints) -> Bools:
    """Whether the foot lies on a face that closes a hole where nothing was measured."""
    if other.face_invented is None:
        return np.zeros(len(faces), dtype=np.bool_)
    return (faces >= 0) & other.face_invented[faces]
