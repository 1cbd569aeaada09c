"""How steeply a place was seen: by the station that saw it best, in the epoch that saw it worse.

In: both measured sides and what the stations of both epochs saw. Out: the sides with the class of view of each vertex.
Where no station is known the view is not known either, and nothing is said of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from monitor.blocks import blocks
from monitor.comparison.distances.side import Side
from monitor.comparison.sight.limbs import set_limbs_apart
from monitor.comparison.sight.stations import StationSight, is_measured
from projects.model import Floats, Ints
from projects.transforms import apply, rotate

Stations = Sequence[StationSight]
VIEW_STEPS = np.sin(np.radians([10.0, 15.0, 20.0]))  # of the beam above the surface, where one class ends


def look_from(
    sides: tuple[Side, Side],
    sights: tuple[Stations, Stations],
    T_compared_reference: Floats,
) -> tuple[Side, Side]:
    """Return the sides with the view of each vertex, the worse of its own epoch's and of the other's at its foot, and
    from how many places the epoch of fewer was seen."""
    if not (sights[0] and sights[1]):
        return sides
    poses = (np.eye(4), T_compared_reference)
    own = [view_of(side, seen, pose) for side, seen, pose in zip(sides, sights, poses, strict=True)]
    worse = [np.maximum(own[k], np.append(own[1 - k], np.uint8(0))[s.foot_vertices]) for k, s in enumerate(sides)]
    n_scans = min(len(sights[0]), len(sights[1]))
    seen = [replace(side, view=view, n_scans=n_scans) for side, view in zip(sides, worse, strict=True)]
    return set_limbs_apart((seen[0], seen[1]))


def view_of(side: Side, sights: Stations, T_sights_side: Floats) -> Ints:
    """Return the class of view (n,) uint8 of a surface's vertices by its own stations: 0 is the steepest.

    A vertex that none of them measured lies between what they did, where beams graze: the last class.
    """
    out = np.empty(len(side.areas), dtype=np.uint8)
    for block in blocks(len(out)):
        points, normals = apply(T_sights_side, side.surface.vertices[block]), rotate(T_sights_side, side.normals[block])
        best = np.zeros(len(points))
        for sight in sights:
            way = sight.origin - points
            sine = np.einsum("ij,ij->i", way, normals) / np.maximum(np.linalg.norm(way, axis=1), 1e-300)
            best = np.maximum(best, np.where(is_measured(sight, points, sine), sine, 0.0))
        out[block] = len(VIEW_STEPS) - np.searchsorted(VIEW_STEPS, best, side="right")
    return out
