"""The raw mesh brought onto the points, and what no point supports taken off it.

In: vertices and faces of the raw surface and the points summed up. Out: vertices that lie on the points, as surely as
their sigma says, and the faces of a two-manifold with boundary that joins no two sheets and cuts itself nowhere.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from monitor.reconstruction.corners import find_corners
from monitor.reconstruction.crests import snap, split_along
from monitor.reconstruction.faces import least_cosines
from monitor.reconstruction.furrows import choose_fits
from monitor.reconstruction.gathering import GATE_SIGMAS
from monitor.reconstruction.mesh import (
    compact,
    is_degenerate,
    keep_faces,
    normals_by_angle,
    piece_areas,
    short_edges,
    untie,
    weld,
)
from monitor.reconstruction.projection import Projection, Samples, project_vertices
from monitor.reconstruction.reach import Ladder, Stated, choose_reach, for_edges
from monitor.reconstruction.roof_evidence import GAIN
from monitor.reconstruction.roofs import Roofs, bring_onto, find_roofs, no_roofs
from monitor.reconstruction.sides import Raw, fit_own_sides
from monitor.reconstruction.surface_settings import SurfaceSettings
from monitor.reconstruction.tool_marks import keep_tool_marks
from monitor.reconstruction.untangle import drop_intersecting, untangle
from projects.errors import ReconstructionError
from projects.model import Bools, Floats, Ints

SLIVER = 1e-3  # of a cell: edges and heights below it are welded or dropped
FINEST = 1e-4  # of a cell: no vertex is claimed to be known better
COS_OPPOSITE = -0.7  # corners of a face whose normals are farther apart (135 degrees) lie on two sheets


class Settled(NamedTuple):
    """Vertices on the points and their faces; which vertices (n,) lie beside faces that were left out between two near
    sheets, and which on the line where two sides of an edge meet."""

    projection: Projection
    faces: Ints
    beside: Bools
    is_crest: Bools


def settle(
    vertices: Floats, faces: Ints, measured: tuple[Samples, Ladder, Stated | None], cell: float, spacing: float,
    settings: SurfaceSettings, near: Callable[[Floats, Ints], Ints], counts: dict[str, int], automatic: dict[str, Any],
) -> Settled:  # fmt: skip
    """Bring the vertices onto the points, then drop what no point supports, slivers, crumbs and bow ties.

    `near` returns the faces that end near enough to the samples, which vertices may leave on their way.
    """
    faces = weld(vertices, faces, SLIVER * cell)
    require_faces(faces, cell)
    used, faces = compact(len(vertices), faces)
    vertices = vertices.take(used, axis=0)
    projection, roofs = fit_vertices(vertices, faces, measured, cell, settings, automatic)
    keep = all_corners(projection.is_fitted, faces)
    counts["faces_without_support"] = int(np.count_nonzero(~keep))
    faces = keep_faces(faces, keep)
    between = joins_two_sheets(projection.normals, faces)
    counts["faces_between_near_sheets"] = int(np.count_nonzero(between))
    beside = np.zeros(len(used), bool)
    beside[faces[between]] = True
    faces = keep_faces(faces, ~between)
    counts["vertices_held_back"] = 0
    projection, doubtful = hold_back(vertices, projection, faces, counts)
    if settings.tool_marks:
        smooth = projection.vertices
        projection, roofs = ride_on_waves(projection, roofs, measured[0], (spacing, cell), automatic)
        if not np.array_equal(projection.vertices, smooth):
            projection, moved = hold_back(smooth, projection, faces, counts)
            doubtful |= moved
    before = len(faces)
    faces = near(projection.vertices, faces)
    counts["faces_untouched_by_samples"] += before - len(faces)
    doubtful[short_edges(projection.vertices, faces, SLIVER * cell)] = True  # faces that welding changes
    before = len(faces)
    faces = clean(projection.vertices, faces, cell, settings.crumb_cells)
    counts["faces_crumbs_and_slivers"] = before - len(faces)
    before = len(faces)
    faces = drop_intersecting(projection.vertices, faces, ~all_corners(~doubtful, faces))
    counts["faces_intersecting"] = before - len(faces)
    crested = split_along(projection, faces, roofs, cell)
    counts["edges_split"] = len(crested.projection.vertices) - len(projection.vertices)
    beside = np.r_[beside, np.zeros(counts["edges_split"], bool)]
    used, faces = compact(len(crested.projection.vertices), crested.faces)
    return Settled(crested.projection.take(used), faces, beside[used], crested.is_crest[used])


def fit_vertices(
    vertices: Floats, faces: Ints, measured: tuple[Samples, Ladder, Stated | None], cell: float,
    settings: SurfaceSettings, automatic: dict[str, Any],
) -> tuple[Projection, Roofs]:  # fmt: skip
    """Bring the vertices onto smooth fits to the points, beside edges onto both their sides; also these edges."""
    samples, ladder, stated = measured
    outward = normals_by_angle(vertices, faces)
    choose = choose_fits if settings.along_furrows else choose_reach
    reach = choose(vertices, outward, samples, ladder, stated)
    reach = reach._replace(misfit=np.hypot(reach.misfit, FINEST * cell))
    max_shift = cell + GATE_SIGMAS * samples.noise
    projection = project_vertices(vertices, outward, samples, reach, max_shift)
    roofs = no_roofs()
    if settings.sharp_edges:
        noise = np.maximum(np.fmin(reach.noise, samples.noise), FINEST * cell)
        wide = for_edges(samples)
        roofs, rows = find_roofs(vertices, projection, faces, wide, noise, cell, max_shift)
        onto = vertices[roofs.which], roofs, rows, noise[roofs.which]
        brought = bring_onto(projection, *onto)
        is_smooth = projection.is_fitted & (brought.vertices == projection.vertices).all(axis=1)
        if reach.furrows is not None:
            is_smooth[reach.furrows.which] = False
        raw = Raw(vertices, outward, is_smooth)
        projection = fit_own_sides(raw, brought, reach, roofs, rows[:, GAIN], measured, noise, cell, max_shift)
        projection = bring_onto(projection, *onto)  # where that is better known
        projection, roofs = find_corners(vertices, projection, faces, roofs, wide, noise, cell, max_shift)
        projection = snap(projection, faces, roofs, cell)
        projection = projection._replace(sigma=np.maximum(projection.sigma, FINEST * cell))
    automatic["roof_share"] = len(roofs.which) / len(vertices)
    automatic["fit_radius_m"] = float(np.median(ladder.radii[np.where(reach.is_flat, reach.flat, reach.curved)]))
    automatic["flat_share"] = float(np.mean(reach.is_flat))
    automatic["stretched_share"] = 0.0 if reach.furrows is None else len(reach.furrows.which) / len(vertices)
    return projection, roofs


def ride_on_waves(
    projection: Projection, roofs: Roofs, samples: Samples, sizes: tuple[float, float], automatic: dict[str, Any]
) -> tuple[Projection, Roofs]:
    """Bring vertices onto what repeats of the relief; `sizes` are how far points and vertices lie apart (m).

    Also the roofs that are left: what lies on waves is no edge.
    """
    held = np.zeros(len(projection.vertices), bool)
    held[roofs.which] = True
    fitted = np.flatnonzero(projection.is_fitted)
    kept = keep_tool_marks(projection.take(fitted), held[fitted], samples, *sizes)
    automatic["waved_share"] = float(np.count_nonzero(kept.is_waved)) / max(len(held), 1)
    automatic["cell_for_waves_m"] = kept.cell
    least = FINEST * sizes[1]
    ridden = kept.projection._replace(sigma=np.maximum(kept.projection.sigma, least))
    is_waved = put(np.zeros(len(held), bool), fitted, kept.is_waved)
    left = Roofs(*(values[~is_waved[roofs.which]] for values in roofs))
    return Projection(*(put(before, fitted, after) for before, after in zip(projection, ridden, strict=True))), left


def put(values: Any, which: Ints, others: Any) -> Any:
    """Return a copy of values (n, ...) with `others` at `which`."""
    out = values.copy()
    out[which] = others
    return out


def all_corners(is_so: Bools, faces: Ints) -> Bools:
    """Return which faces (m,) have three corners that are so, of vertices (n,)."""
    a, b, c = (is_so.take(corner) for corner in faces.T)
    out: Bools = a & b & c
    return out


def joins_two_sheets(normals: Floats, faces: Ints) -> Bools:
    """Return which faces (m,) have corners whose points look opposite ways, within a cell: bridges between two sheets.

    `normals` (n, 3) are those of the points that each vertex was fitted to.
    """
    out: Bools = least_cosines(normals, faces) < COS_OPPOSITE
    return out


def hold_back(raw: Floats, projection: Projection, faces: Ints, counts: dict[str, int]) -> tuple[Projection, Bools]:
    """Return the projection with vertices stopped on their way where the mesh would fold or cut itself.

    What such a vertex is short of its place on the points is part of its sigma. Also which vertices (n,) have faces
    that may still meet others.
    """
    vertices, share, suspects = untangle(raw, projection.vertices, faces)
    counts["vertices_held_back"] += int(np.count_nonzero(share < 1.0))
    short = np.linalg.norm(projection.vertices - vertices, axis=1)
    doubtful = np.zeros(len(vertices), bool)
    doubtful[faces[suspects]] = True
    return projection._replace(vertices=vertices, sigma=np.hypot(projection.sigma, short)), doubtful


def require_faces(faces: Ints, cell: float) -> None:
    """Raise `ReconstructionError` where there are no faces."""
    if not len(faces):
        raise ReconstructionError(
            f"no surface came of cells of {cell:.4g} m: the points lie on no surface at that spacing (on one line, or "
            "rounded to coarse steps); give points that do, or another cell_size"
        )


def clean(vertices: Floats, faces: Ints, cell: float, crumb_cells: float) -> Ints:
    """Return faces that make a two-manifold with boundary, without slivers and crumbs."""
    faces = weld(vertices, faces, SLIVER * cell)
    faces = keep_faces(faces, ~is_degenerate(vertices, faces, SLIVER**2 * cell))
    faces = untie(faces)
    require_faces(faces, cell)
    areas = piece_areas(vertices, faces)
    faces = keep_faces(faces, areas >= np.pi * (crumb_cells * cell) ** 2)
    if not len(faces):
        largest = np.sqrt(areas.max() / np.pi)
        raise ReconstructionError(
            f"crumb_cells = {crumb_cells:g} drops pieces smaller than a disc of {crumb_cells * cell:.4g} m radius "
            f"(cells of {cell:.4g} m), and the largest piece of surface is as a disc of {largest:.4g} m; "
            f"set crumb_cells below {largest / cell:.2g}, or cell_size nearer to the spacing of the points"
        )
    return faces
