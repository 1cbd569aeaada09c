"""Tells regions of change that are a part's motion from those that are wear.

In: a comparison and the parts that moved rigidly (`registration.parts`). Out: the comparison with these regions called
"moved", and the parts with their six parameters among its statistics. Regions that `moved` named before, from their
distances alone, keep that name: such a part may be too small or too plain to be laid back.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from monitor.comparison.distances.stars import make_mesh, vertex_areas
from monitor.comparison.regions.moved import EXPLAINED
from monitor.comparison.regions.part_placement import placement_of
from monitor.reconstruction.mesh import normals_by_angle
from monitor.registration.motion.sampling import motion_rows
from monitor.registration.parts import MovedParts
from projects.model import Comparison, Floats, Ints, NotAssessed, Surface
from projects.transforms import apply

MOST = 0.5  # of a region's vertices, so many belong to a part: the region is its motion
BESIDE = 0.15  # of a part's length: what a groove sets apart from it lies no farther off
LAYER = 0.5  # of what an even layer leaves of a region's change, the motion of its part leaves less
BESIDE_SPACINGS = 3.0  # a vertex of the reference is of a part that lay so near to it
WIDE = 0.1  # of what is assessed: what moved is so much that it may as well be the rest that did


def tell_moved(comparison: Comparison, found: MovedParts, compared: Floats) -> Comparison:
    """Return the comparison in which regions that a part's motion explains are of the kind "moved".

    Parameters
    ----------
    found : of the compared epoch against the reference, with the comparison's registration.
    compared : (n, 3) m, the vertices of the compared surface as it was given, before any motion.

    Returns
    -------
    Comparison
        `statistics["parts"]`: for each part that explains a region `T_target_source` (4, 4), `motion` (6,) (w, t)
        [rad, m] about `centre` (3,) in the reference's frame, its `covariance` (6, 6), `n_points` and the numbers of
        its `regions`.
    """
    if not found.parts:
        return comparison
    part_of = found.part_of, part_on_reference(comparison, found, compared)
    regions = comparison.on_compared.changed_region, comparison.on_reference.changed_region
    belongs = count_vertices(regions, part_of, len(comparison.regions), len(found.parts))
    table = comparison.regions.copy()
    is_most = belongs[:, 1:].sum(axis=1) >= MOST * np.maximum(belongs.sum(axis=1), 1)
    of_part = np.where(is_most, belongs[:, 1:].argmax(axis=1) + 1, 0)
    of_part = np.where(is_most, of_part, goes_along(comparison, found, part_of))
    is_moved = of_part[table["region"].to_numpy(dtype=int) - 1] > 0
    table["kind"] = np.where(is_moved, "moved", table["kind"].to_numpy(dtype=object))
    parts = [{**describe_part(comparison, found, part_of, k),
              "regions": [int(r) + 1 for r in np.flatnonzero(of_part == k)]}
             for k in range(1, len(found.parts) + 1) if (of_part == k).any()]  # fmt: skip
    return dataclasses.replace(comparison, regions=table, statistics={**comparison.statistics, "parts": parts})


def doubt_which_stood(comparison: Comparison) -> Comparison:
    """Return the comparison, of which nobody said what stood still, with the doubt whether it was the rest that did,
    where much of the surface moved against it: two surfaces tell of a motion, not which of both made it."""
    side = comparison.on_compared
    is_assessed = side.reasons == NotAssessed.ASSESSED
    moved = comparison.regions["region"][comparison.regions["kind"] == "moved"]
    areas = vertex_areas(make_mesh(side.surface.vertices, side.surface.faces))
    share = float(areas[is_assessed & np.isin(side.region, moved)].sum()) / max(float(areas[is_assessed].sum()), 1e-300)
    if share < WIDE:
        return comparison
    doubt = (
        f"{100 * share:.0f} % of the surface moved against the rest, which is taken to have stood still: whether it "
        "was the other way round two epochs alone cannot tell; say where nothing moved, or give control points"
    )
    registration = comparison.registration
    told = "; ".join(filter(None, (registration.doubt, doubt)))
    return dataclasses.replace(comparison, registration=dataclasses.replace(registration, doubt=told))


def describe_part(comparison: Comparison, found: MovedParts, part_of: tuple[Ints, Ints], number: int) -> dict[str, Any]:
    """Return one part as plain values; `part_of` are the parts of the vertices of the compared surface and of the
    reference. Its covariance has what the scans' own placement adds."""
    part = found.parts[number - 1]
    by_scans = placement_of(comparison, part_of[0] == number, part_of[1] == number, part.centre)
    return {
        "T_target_source": part.T_target_source.tolist(),
        "motion": part.motion.tolist(),
        "covariance": (part.covariance + by_scans).tolist(),
        "centre": part.centre.tolist(),
        "n_points": part.n_points,
    }


def part_on_reference(comparison: Comparison, found: MovedParts, compared: Floats) -> Ints:
    """Return the part (m,) that each changed vertex of the reference belongs to: the one that lay there before."""
    side = comparison.on_reference
    changed = np.flatnonzero(side.is_changed)
    part_of = np.zeros(len(side.region), dtype=np.int32)
    nearest = np.full(len(changed), np.inf)
    for number, part in enumerate(found.parts, start=1):
        tree = cKDTree(apply(part.T_target_source, compared[found.part_of == number]))
        spacing = float(np.median(tree.query(tree.data, k=2)[0][:, 1]))
        distance, _ = tree.query(side.surface.vertices[changed], distance_upper_bound=BESIDE_SPACINGS * spacing)
        nearer = distance < nearest
        part_of[changed[nearer]], nearest[nearer] = number, distance[nearer]
    return part_of


def goes_along(comparison: Comparison, found: MovedParts, part_of: tuple[Ints, Ints]) -> Ints:
    """Return the part (r,) whose motion explains nearly all of a region's change, 0 for none: what a joint or a groove
    sets apart from the rest of it. Such a region is no larger than the part and lies beside it, and an even layer, as
    of a coating, explains it much less well: where the motion is as even there, nothing tells which of both it was.
    """
    sides, n = (comparison.on_compared, comparison.on_reference), len(comparison.regions)
    rows = [np.flatnonzero(side.is_changed & (side.reasons == NotAssessed.ASSESSED)) for side in sides]
    both = list(zip(sides, rows, strict=True))
    number = np.concatenate([side.region[which] for side, which in both]) - 1
    change = np.concatenate([side.distances[which] for side, which in both])
    points = np.concatenate([side.surface.vertices[which] for side, which in both])
    normals = np.concatenate([normals_of(side.surface)[which] for side, which in both])
    size, whole = np.bincount(number, minlength=n), np.bincount(number, change**2, n)
    uneven = whole - np.bincount(number, change, n) ** 2 / np.maximum(size, 1)
    out, least = np.zeros(n, dtype=np.int64), np.minimum((1.0 - EXPLAINED) * whole, LAYER * uneven)
    for k, part in enumerate(found.parts, start=1):
        of = np.concatenate([s.surface.vertices[which == k] for s, which in zip(sides, part_of, strict=True)])
        away, reach = np.full(n, np.inf), BESIDE * np.linalg.norm(np.ptp(of, axis=0))
        np.minimum.at(away, number, cKDTree(of).query(points)[0])
        along = motion_rows(points, normals, part.centre) @ part.motion
        left = np.bincount(number, (change - along) ** 2, n)
        better = (size > 0) & (size <= len(of)) & (away <= reach) & (left < least)
        out[better], least[better] = k, left[better]
    return out


def normals_of(surface: Surface) -> Floats:
    """Return the normals (n, 3) of a surface's vertices."""
    return normals_by_angle(surface.vertices, surface.faces) if surface.normals is None else surface.normals


def count_vertices(regions: tuple[Ints, Ints], part_of: tuple[Ints, Ints], n_regions: int, n_parts: int) -> Ints:
    """Return how many vertices of each region belong to each part (r, 1 + p), the first column to none."""
    count = np.zeros((n_regions, n_parts + 1), dtype=np.int64)
    for region, part in zip(regions, part_of, strict=True):
        inside = region > 0
        np.add.at(count, (region[inside] - 1, part[inside]), 1)
    return count
