"""What lies straight under, or over, a region of the other surface, though a nearer part of that decides what it is.

Ground that a panel was put on, next to the panel's side, is nearest to the foot of that side, or to the end of what was
seen there, and has no perpendicular that is assessed. Its way along its normal still meets the panel's face: it is of
the body between the surfaces, which would else be closed aslant, from where the perpendiculars end.
"""

from __future__ import annotations

import numpy as np

from monitor.comparison.distances.ahead import first_met
from monitor.comparison.distances.side import Side
from monitor.comparison.distances.spreading import spread_along
from monitor.comparison.regions.beyond import SIGNS, Beyond
from projects.model import Bools, Floats, Ints, NotAssessed
from projects.triangles import area_vectors, face_areas

FARTHER = 1.25  # times the largest change of regions of a sign, as far as one may cover: what slants is farther off


def take_covered(sides: tuple[Side, Side], regions: tuple[Ints, Ints], signs: Floats,
                 beyond: Beyond) -> tuple[Ints, Ints]:  # fmt: skip
    """Return the regions (n,) of both sides with what they cover of the other one.

    A vertex that is not assessed and of no region is covered where its way along its normal, to the side on which the
    change of the region lies (`signs` (r + 1,)), first meets a face of that region which looks as the vertex does, no
    farther off than such regions changed. It must hang together with the region along its own surface: the wall far
    behind a chest that gained is under it too, but no end of what came.
    """
    out = []
    for k, side in enumerate(sides):
        own = regions[k].copy()
        for sign in SIGNS:
            faces = _faces_of(sides[1 - k], regions[1 - k], signs == sign)
            which = _touching(side, own)
            if len(faces) and len(which):
                deepest = max(_deepest(s, r, c, signs == sign)
                              for s, r, c in zip(sides, regions, beyond.change, strict=True))  # fmt: skip
                way = -sign * SIGNS[k] * FARTHER * deepest
                _take(side, own, _regions_ahead(side, which, sides[1 - k], regions[1 - k], faces, way))
        out.append(own)
    return out[0], out[1]


def _faces_of(side: Side, region: Ints, fitting: Bools) -> Ints:
    """Return the faces (m, 3) of a side, of some area, whose corners are all of one region that fits (r + 1,)."""
    faces = np.asarray(side.surface.faces)
    first = region[faces[:, 0]]
    faces = faces[(first > 0) & fitting[first] & (region[faces[:, 1]] == first) & (region[faces[:, 2]] == first)]
    return faces[face_areas(side.surface.vertices[faces]) > 0.0]


def _touching(side: Side, own: Ints) -> Ints:
    """Return the vertices that may be covered: not assessed, of no region, and that hang together with one."""
    allowed = ~side.is_assessed & (side.reasons != NotAssessed.NO_ONE_SURFACE)
    source = spread_along(side, np.flatnonzero(own > 0), allowed | (own > 0), np.inf)
    return np.flatnonzero(allowed & (own == 0) & (source >= 0))


def _deepest(side: Side, region: Ints, change_beyond: Floats, fitting: Bools) -> float:
    """Return the largest change [m], of whichever sign, of the regions of a side that fit (r + 1,)."""
    at = np.flatnonzero((region > 0) & fitting[region])
    change = np.where(side.is_assessed[at], side.distances[at], change_beyond[at])
    return float(np.nan_to_num(np.abs(change)).max(initial=0.0))


def _regions_ahead(side: Side, which: Ints, other: Side, regions: Ints, faces: Ints, way: float) -> Ints:
    """Return the region (n,) of the face that each of some vertices first meets `way` [m] along its normal, if that
    looks as it does; 0 where none, and of the other vertices."""
    out = np.zeros(len(side.areas), dtype=regions.dtype)
    points, normals = side.surface.vertices[which], side.normals[which]
    met = first_met(other.surface.vertices, faces, points, way * normals)
    face = faces[met]
    looks_alike = np.einsum("ij,ij->i", area_vectors(other.surface.vertices[face]), normals) > 0.0
    out[which] = np.where((met >= 0) & looks_alike, regions[face[:, 0]], 0)
    return out


def _take(side: Side, own: Ints, ahead: Ints) -> None:
    """Give vertices the region `ahead` (n,) of them, where they hang together with it."""
    seeds = np.flatnonzero(own > 0)
    source = spread_along(side, seeds, (own > 0) | (ahead > 0), np.inf)
    taken = (own == 0) & (ahead > 0) & (source >= 0)
    taken[taken] = own[source[taken]] == ahead[taken]
    own[taken] = ahead[taken]
