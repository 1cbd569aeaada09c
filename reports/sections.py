"""A section through a change region: where it is cut, and the lines in which a plane cuts a surface.

The plane holds the region's mean normal and its longest direction along the surface; both epochs are cut in the
reference epoch's coordinates, triangle by triangle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from projects.errors import ParameterError
from projects.model import Bools, ComparedSurface, Comparison, Floats, Surface
from projects.triangles import face_areas, face_normals

WINDOW = 1.6  # a section shows this many times the region's length


@dataclass(frozen=True)
class SectionPlane:
    """Where a region is cut: `origin` (3,) m; `along` to the reader's right and `outward` up, unit vectors (3,).

    `low`, `high` [m] are the region's ends along the section; `reach` [m] is how far the section is shown either side
    of the middle between them.
    """

    origin: Floats
    along: Floats
    outward: Floats
    low: float
    high: float
    reach: float

    @property
    def across(self) -> Floats:
        """The normal of the plane (3,)."""
        return np.cross(self.along, self.outward)


@dataclass(frozen=True)
class SectionLine:
    """The line in which a plane cuts one side: n segments, ends (n, 2, 2) as position along and height outward [m].

    `distances`, `lod95` (n, 2) are the change and its level of detection at the ends [m], NaN where unknown;
    `in_region` (n,).
    """

    ends: Floats
    distances: Floats
    lod95: Floats
    in_region: Bools

    def take(self, which: Bools) -> SectionLine:
        """Return the segments of a mask."""
        return SectionLine(self.ends[which], self.distances[which], self.lod95[which], self.in_region[which])


def region_normal(side: ComparedSurface, number: int) -> Floats:
    """Return the sum of area-weighted normals (3,) of the faces with two corners or more in a region, 0 for none."""
    inside = (side.region == number)[side.surface.faces].sum(axis=1) >= 2
    return face_normals(Surface(side.surface.vertices, side.surface.faces[inside])).sum(axis=0)


def region_areas(side: ComparedSurface) -> Floats:
    """Return the area [m2] of each region on one side by its number (highest number + 1,); 0 outside of regions."""
    third = face_areas(side.surface.vertices[side.surface.faces]) / 3.0
    areas: Floats = np.bincount(side.region[side.surface.faces].ravel(), np.repeat(third, 3), minlength=1).astype(float)
    areas[0] = 0.0
    return areas


def main_side(comparison: Comparison, number: int) -> ComparedSurface:
    """Return the side that shows more of a region: the compared epoch, or the reference where a piece is gone.

    Raises
    ------
    ParameterError
        Where the comparison has no such region.
    """
    sides = [s for s in (comparison.on_compared, comparison.on_reference) if (s.region == number).any()]
    if not sides:
        raise ParameterError(
            f"region {number} is not in the comparison; it has regions 1 to {len(comparison.regions)}: name one of them"
        )
    return max(sides, key=lambda s: float(np.linalg.norm(region_normal(s, number))))


def choose_plane(comparison: Comparison, number: int) -> SectionPlane:
    """Return the plane through a region's middle that holds its mean normal and its longest direction along it.

    The section runs to the right as seen from outside, or upwards where the region is upright.
    """
    side = main_side(comparison, number)
    normal = region_normal(side, number)
    outward = normal / max(float(np.linalg.norm(normal)), 1e-300)
    points = side.surface.vertices[side.region == number]
    origin = points.mean(axis=0)
    flat = points - origin - np.outer((points - origin) @ outward, outward)
    along = np.linalg.svd(flat.T @ flat)[0][:, 0]
    along -= (along @ outward) * outward
    along /= np.linalg.norm(along)
    right = np.cross([0.0, 0.0, 1.0], outward)
    if (along[2] if abs(along[2]) > 0.8 else along @ right) < 0:
        along = -along
    plane = SectionPlane(origin, along, outward, 0.0, 0.0, np.inf)
    own = cut_side(side, plane, number)
    reached = own.ends[own.in_region, :, 0] if own.in_region.any() else (points - origin) @ along
    low, high = float(reached.min()), float(reached.max())
    detail = float(np.sqrt(np.linalg.norm(face_normals(side.surface), axis=1).mean()))
    return SectionPlane(origin, along, outward, low, high, max(WINDOW * (high - low) / 2, 8 * detail))


def cut_side(side: ComparedSurface, plane: SectionPlane, number: int) -> SectionLine:
    """Return the line in which the plane cuts one side, with the change along it; what only touches is not cut."""
    offset = side.surface.vertices - plane.origin
    height = offset @ plane.across
    faces = side.surface.faces
    above = height[faces] > 0
    crossed = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
    corners, up = faces[crossed], above[crossed]
    lone = np.where(up.sum(axis=1) == 1, up.argmax(axis=1), (~up).argmax(axis=1))
    rows = np.arange(len(crossed))
    apex = corners[rows, lone]
    values = np.column_stack([offset @ plane.along, offset @ plane.outward, side.distances, side.lod95])
    ends = []
    for step in (1, 2):
        other = corners[rows, (lone + step) % 3]
        share = (height[apex] / (height[apex] - height[other]))[:, None]
        ends.append((1 - share) * values[apex] + share * values[other])
    both = np.stack(ends, axis=1)
    in_region = (side.region[corners] == number).sum(axis=1) >= 2
    return SectionLine(both[..., :2], both[..., 2], both[..., 3], in_region)


def cut_comparison(comparison: Comparison, number: int, plane: SectionPlane) -> tuple[SectionLine, SectionLine]:
    """Return the section lines (reference, compared) about a region, without other parts of the object behind it."""
    lines = [cut_side(s, plane, number) for s in (comparison.on_reference, comparison.on_compared)]
    middle = (plane.low + plane.high) / 2
    lines = [line.take((np.abs(line.ends[..., 0] - middle) <= plane.reach).all(axis=1)) for line in lines]
    seeds = np.concatenate([line.ends[line.in_region].reshape(-1, 2) for line in lines])
    row = comparison.regions[comparison.regions["region"] == number]
    size = float(np.abs(row["extreme_m"]).max()) if len(row) else 0.0
    near = max(1.5 * size, 0.02 * plane.reach)
    reference, compared = (line.take(_connected_to(line, seeds, near)) for line in lines)
    return reference, compared


def _connected_to(line: SectionLine, seeds: Floats, near: float) -> Bools:
    """Return which segments hang together with one that comes within `near` [m] of a seed point (n, 2)."""
    ends = line.ends.reshape(-1, 2)
    if not len(ends) or not len(seeds):
        return np.zeros(len(line.ends), dtype=bool)
    scale = 1e-9 + 1e-7 * float(np.ptp(ends, axis=0).max())
    _, place = np.unique(np.rint(ends / scale).astype(np.int64), axis=0, return_inverse=True)
    pairs = place.reshape(-1, 2)
    n = int(place.max()) + 1
    _, part = connected_components(coo_matrix((np.ones(len(pairs)), pairs.T), shape=(n, n)), directed=False)
    part = part[pairs[:, 0]]
    close = cKDTree(seeds).query(line.ends.mean(axis=1))[0] <= near
    return np.isin(part, np.unique(part[close]))
