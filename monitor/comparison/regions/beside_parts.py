"""What changed beside a part that moved, and hangs together with it: worn, lost or filled where it joins the rest.

In: a comparison and the parts that moved rigidly. Out: masks of vertices that another comparison of the same surfaces
tells apart (`compare`, `apart`). As one region with the part it would be called moved, and nobody would hear of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from monitor.comparison.distances.connected import connect_like
from monitor.comparison.distances.stars import gather_neighbours, make_mesh, vertex_areas
from monitor.comparison.regions.chips import HANDFUL
from monitor.comparison.regions.moved_parts import BESIDE_SPACINGS, MOST, count_vertices, normals_of, part_on_reference
from monitor.registration.motion.sampling import motion_rows
from monitor.registration.parts import MovedParts
from projects.model import Bools, ComparedSurface, Comparison, Floats, Ints, NotAssessed

LEFT = 0.5  # of a squared change: what parts' motions leave of their own is 0.01 to 0.4, of wear beside them 1 to 4
LOST = 0.05  # of a region: the skirts of a piece, beside the step to another, are none of it

Apart = tuple[Bools, Bools]  # of the vertices of the reference and of the compared surface


def tell_apart(comparison: Comparison, found: MovedParts, compared: Floats,
               ask: Callable[[Apart], Comparison]) -> Comparison:  # fmt: skip
    """Return the comparison with what changed beside its parts told apart from them.

    Parameters
    ----------
    found, compared : as in `tell_moved`.
    ask : returns the same comparison with some vertices told apart. Where more than `LOST` of a region's vertices would
        no longer be changed then, as a piece does not stand by itself, the region stays one.
    """
    apart, sides, n = changed_beside(comparison, found, compared), sides_of(comparison), len(comparison.regions) + 1
    whole = sum(np.bincount(side.changed_region, minlength=n) for side in sides)
    while apart is not None:
        again = ask(apart)
        lost = sum(np.bincount(one.changed_region[~other.is_changed], minlength=n)
                   for one, other in zip(sides, sides_of(again), strict=True))  # fmt: skip
        falls = (lost > LOST * whole) & (np.arange(n) > 0)
        if not falls.any():
            return again
        kept = [which & ~falls[side.region] for side, which in zip(sides, apart, strict=True)]
        is_less = any((own != left).any() for own, left in zip(apart, kept, strict=True))
        apart = (kept[0], kept[1]) if is_less and any(left.any() for left in kept) else None
    return comparison


def sides_of(comparison: Comparison) -> tuple[ComparedSurface, ComparedSurface]:
    """Return the sides of a comparison, the reference first."""
    return comparison.on_reference, comparison.on_compared


def changed_beside(comparison: Comparison, found: MovedParts, compared: Floats) -> Apart | None:
    """Return which vertices (n,) of the reference and (m,) of the compared surface lie in a region with a part, and
    changed beside the part; None where none did.

    They and their feet lie away from where a part is and from where it was, they hang together over a handful of
    vertices and more, and the part's motion explains less than half of their squared change. Of the region without
    them, most is of the part.

    Parameters
    ----------
    found, compared : as in `tell_moved`.
    """
    if not found.parts:
        return None
    sides, n = (comparison.on_compared, comparison.on_reference), len(comparison.regions)
    part_of = found.part_of, part_on_reference(comparison, found, compared)
    of_parts = count_vertices((sides[0].changed_region, sides[1].changed_region), part_of, n, len(found.parts))[:, 1:]
    part = np.append(0, np.where(of_parts.any(axis=1), of_parts.argmax(axis=1) + 1, 0))
    places = cKDTree(np.concatenate([s.surface.vertices[own > 0] for s, own in zip(sides, part_of, strict=True)]))
    beside = [_beside(side, np.where(own > 0, 0, part[side.region]), found, places, sign)
              for side, own, sign in zip(sides, part_of, (-1.0, 1.0), strict=True)]  # fmt: skip
    rest = sum(np.bincount(side.changed_region[~is_beside], minlength=n + 1)
               for side, is_beside in zip(sides, beside, strict=True))  # fmt: skip
    is_mostly_part = np.append(0, of_parts.sum(axis=1)) >= MOST * np.maximum(rest, 1)
    on_compared, on_reference = (which & is_mostly_part[s.region] for which, s in zip(beside, sides, strict=True))
    return (on_reference, on_compared) if on_reference.any() or on_compared.any() else None


def _beside(side: ComparedSurface, part: Ints, found: MovedParts, places: cKDTree, to_foot: float) -> Bools:
    """Return which vertices (n,) of a side, each in a region of a `part` (n,) that it is not of itself, 0 for none,
    changed beside it; feet lie the change times `to_foot` along the normals."""
    kinds = np.full(len(part), -1, dtype=np.int8)
    at = np.flatnonzero((part > 0) & side.is_changed & (side.reasons == NotAssessed.ASSESSED))
    mesh = make_mesh(side.surface.vertices, side.surface.faces)
    areas = vertex_areas(mesh)
    spacing = float(np.sqrt(np.median(areas)))
    feet = side.surface.vertices[at] + to_foot * side.distances[at, None] * normals_of(side.surface)[at]
    nearest = np.minimum(places.query(side.surface.vertices[at])[0], places.query(feet)[0])
    at = at[nearest > BESIDE_SPACINGS * spacing]
    points, normals, change = side.surface.vertices[at], normals_of(side.surface)[at], side.distances[at]
    kinds[at] = change > 0.0
    together = connect_like(kinds, [gather_neighbours(mesh)])[at]
    along = np.zeros(len(at))
    for k, moved in enumerate(found.parts, start=1):
        own = part[at] == k
        along[own] = motion_rows(points[own], normals[own], moved.centre) @ moved.motion
    size, whole, left = (np.bincount(together, v) for v in (areas[at], change**2, (change - along) ** 2))
    is_beside = (size >= HANDFUL * spacing**2) & (left > LEFT * whole)
    return np.isin(np.arange(len(part)), at[is_beside[together]])
