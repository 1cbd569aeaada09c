"""One surface from the points of an epoch: raw mesh, trimmed to what was measured, brought onto the points.

In: a `PointCloud` in the project's frame. Out: a `Surface` that ends where the samples end, with the uncertainty of
each vertex. After Nothegger, "Improving completeness of geometric models from terrestrial laser scanning data".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from monitor.boxes import box_of
from monitor.declare import check_settings, setting
from monitor.reconstruction.cell_size import (
    choose_cell_size,
    measure_and_sort,
    require_cells_wide_enough,
    tree_of_points,
)
from monitor.reconstruction.corners import find_corners
from monitor.reconstruction.coverage import count_uncovered, share_uncovered
from monitor.reconstruction.crests import snap, split_along
from monitor.reconstruction.faces import least_cosines
from monitor.reconstruction.furrows import choose_fits
from monitor.reconstruction.gathering import GATE_SIGMAS
from monitor.reconstruction.holes import close_holes
from monitor.reconstruction.localized import localized_mesh
from monitor.reconstruction.mesh import (
    compact,
    is_degenerate,
    keep_faces,
    piece_areas,
    short_edges,
    untie,
    vertex_normals,
    weld,
)
from monitor.reconstruction.moments import Level
from monitor.reconstruction.nearness import has_near
from monitor.reconstruction.open3d_poisson import poisson_mesh
from monitor.reconstruction.poisson import screening_length
from monitor.reconstruction.projection import Projection, Samples, project_vertices, sum_up_samples
from monitor.reconstruction.reach import Ladder, Stated, choose_reach, make_ladder
from monitor.reconstruction.roof_evidence import GAIN
from monitor.reconstruction.roofs import Roofs, bring_onto, find_roofs, no_roofs
from monitor.reconstruction.sides import Raw, fit_own_sides
from monitor.reconstruction.untangle import drop_intersecting, untangle
from monitor.reconstruction.usable import take_usable
from projects.errors import ParameterError, ReconstructionError
from projects.model import Bools, Floats, Ints, PointCloud, Surface, require_noun

SLIVER = 1e-3  # of a cell: edges and heights below it are welded or dropped
FINEST = 1e-4  # of a cell: no vertex is claimed to be known better
LEAST_SHOWN = 0.1  # of the noise stated: points that scatter less tell nothing of it, as those in one plane by rounding
OF_FIT = 4.8  # variance in the middle of a quadratic fit of weights 1 - t^2, times its points over that of one
COS_OPPOSITE = -0.7  # corners of a face whose normals are farther apart (135 degrees) lie on two sheets
ALONG_HOLES = 1.5  # cells: the longest edge of an invented face
N_TINT = 4  # samples that give a vertex its colour, intensity and roughness


@dataclass(frozen=True, kw_only=True)
class SurfaceSettings:
    """How a surface is made of points. Lengths in metres."""

    method: str = setting(
        "localized",
        unit="",
        meaning="engine of the raw surface; open3d to compare with",
        choices=("localized", "open3d"),
    )
    cell_size: float | None = setting(
        None, unit="m", meaning="edge of a cell; auto: 1.5 spacings, or 0.7 sigma of noise if larger", low=1e-6, high=10
    )  # fmt: skip
    trim_cells: float = setting(
        2.5, unit="cells", meaning="the surface ends at this distance from the samples", low=0.5, high=20
    )  # fmt: skip
    narrowest_fit_cells: float = setting(
        1.5, unit="cells", meaning="smallest radius of the points that a vertex is brought onto", low=1, high=20
    )  # fmt: skip
    widest_fit_cells: float = setting(
        24.0, unit="cells", meaning="largest radius of the points that a vertex is brought onto", low=1, high=100
    )  # fmt: skip
    noise_share: float = setting(
        0.03, unit="", meaning="standard error of a vertex, in sigmas of noise, below which no wider fit is tried",
        low=0.001, high=1
    )  # fmt: skip
    along_furrows: bool = setting(
        False, unit="", meaning="whether fits lie along furrows and edges: less noise, but faint changes smear there"
    )  # fmt: skip
    sharp_edges: bool = setting(
        True, unit="", meaning="whether edges and folds between two sides are kept sharp where the points show them"
    )  # fmt: skip
    close_holes: float = setting(
        0.0, unit="m", meaning="holes up to this width are closed by invented faces; 0: none", low=0, high=1000
    )  # fmt: skip
    watertight: bool = setting(
        False, unit="", meaning="whether all holes are closed by invented faces, the underside of an object too"
    )  # fmt: skip
    crumb_cells: float = setting(
        5.0, unit="cells", meaning="pieces smaller than a disc of this radius are dropped", low=0, high=1000
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_settings(self)
        if self.narrowest_fit_cells > self.widest_fit_cells:
            raise ParameterError(
                f"SurfaceSettings.narrowest_fit_cells = {self.narrowest_fit_cells:g} exceeds "
                f"widest_fit_cells = {self.widest_fit_cells:g}; set a smaller one, or the other larger"
            )


@dataclass(frozen=True)
class ReconstructionResult:
    """A surface, the automatic values it was made with, and what was counted and dropped on the way."""

    surface: Surface
    automatic: Mapping[str, Any] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)


def reconstruct(cloud: PointCloud, settings: SurfaceSettings | None = None) -> Surface:
    """Return the surface of a cloud; see `reconstruct_with_record`."""
    return reconstruct_with_record(cloud, settings).surface


def reconstruct_with_record(cloud: PointCloud, settings: SurfaceSettings | None = None) -> ReconstructionResult:
    """Make a surface of a cloud, open where nothing was measured, with what was found and dropped.

    Parameters
    ----------
    cloud : points (n, 3) in metres in any frame. Normals orient the surface; where they are not given, or NaN or of no
        length for single points, they are estimated.
    settings : see `SurfaceSettings`; the default needs no thought.

    Returns
    -------
    ReconstructionResult
        The surface in the frame of the cloud: normals outwards, `sigma` (m) the standard error of each vertex along
        its normal, `n_support` points within the fit, `sample_distance` (m) to the nearest point, roughness, colour
        and intensity of the nearest points. NaN in `sigma` where too few points lie around the vertex.

    Raises
    ------
    ReconstructionError
        Where the cloud has too few usable points, or no surface comes of them.
    """
    require_noun(cloud, "what a surface is made of", PointCloud)
    settings = settings or SurfaceSettings()
    cloud, counts = take_usable(cloud)
    low, high = box_of(cloud.points)
    shift = np.round(0.5 * (low + high), 3)
    cloud = replace(cloud, points=cloud.points - shift)
    assert cloud.normals is not None
    samples = tree_of_points(cloud.points)
    sampling, finest = measure_and_sort(cloud, samples)
    if not sampling.spacing > 0.0:
        raise ReconstructionError(
            f"most of the {len(cloud)} points share their place with others; a surface needs points beside each other"
        )
    cell = settings.cell_size or choose_cell_size(sampling)
    require_cells_wide_enough(cell, sampling)
    screening = screening_length(cell, *sampling)
    ladder = make_ladder(
        cell, sampling.noise, settings.narrowest_fit_cells, settings.widest_fit_cells, settings.noise_share
    )
    with ThreadPoolExecutor(1) as aside:  # neither knows of the other, and each has steps that keep one thread
        summed = aside.submit(sum_up_samples, finest, ladder.radii, sampling.noise)
        vertices, faces, cell_used = raw_mesh(
            cloud.points, cloud.normals, cell, sampling.spacing, screening, settings.method
        )
        summed_up = summed.result()
    automatic = {
        "method": settings.method,
        "cell_size_m": cell_used,
        "spacing_m": sampling.spacing,
        "noise_m": sampling.noise,
        "turn_rad": sampling.turn,
    }
    if settings.method == "localized":
        automatic["screening_cells"] = screening
    counts["faces_raw"] = len(faces)
    near = partial(trim, samples=finest, farthest=settings.trim_cells * cell_used)
    faces = near(vertices, faces)
    counts["faces_untouched_by_samples"] = counts["faces_raw"] - len(faces)
    stated = None if cloud.sigma is None else Stated(samples, cloud.sigma)
    settled = settle(vertices, faces, (summed_up, ladder, stated), cell_used, settings, near, counts, automatic)
    settled = invent(settled, ALONG_HOLES * cell_used, settings, counts)
    marks: dict[str, Any] = {
        name: is_so
        for name, is_so in (("is_unresolved", settled.beside), ("is_crest", settled.is_crest))
        if is_so.any()
    }
    faces, n_invented = settled.faces, counts.get("faces_invented", 0)
    surface = replace(finish(settled.projection, faces, samples, cloud), **marks)
    if n_invented:
        surface = replace(surface, face_invented=np.arange(len(faces)) >= len(faces) - n_invented)
    farthest = cell_used + GATE_SIGMAS * sampling.noise
    counts |= count_uncovered(surface, cloud, farthest, finest)
    share_used = counts["points_used"] / (counts["points_used"] + counts["points_without_normal"])
    automatic["uncovered_share"] = 1.0 - share_used * (
        1.0 - share_uncovered(surface, cloud, samples, sampling, farthest)
    )
    counts |= {"vertices": len(surface.vertices), "faces": len(surface.faces)}
    return ReconstructionResult(replace(surface, vertices=surface.vertices + shift), automatic, counts)


def raw_mesh(
    points: Floats, normals: Floats, cell: float, spacing: float, screening: float, method: str
) -> tuple[Floats, Ints, float]:
    """Return vertices, faces and the cell size used of the engine asked for."""
    if method == "open3d":
        return poisson_mesh(points, normals, cell)
    vertices, faces = localized_mesh(points, normals, cell, spacing, screening)
    return vertices, faces, cell


def trim(vertices: Floats, faces: Ints, samples: Level, farthest: float) -> Ints:
    """Return the faces whose corners all lie within `farthest` (m) of a sample."""
    return keep_faces(faces, all_corners(has_near(samples, vertices, vertices, farthest), faces))


class Settled(NamedTuple):
    """Vertices on the points and their faces; which vertices (n,) lie beside faces that were left out between two near
    sheets, and which on the line where two sides of an edge meet."""

    projection: Projection
    faces: Ints
    beside: Bools
    is_crest: Bools


def settle(
    vertices: Floats, faces: Ints, measured: tuple[Samples, Ladder, Stated | None], cell: float,
    settings: SurfaceSettings, near: Callable[[Floats, Ints], Ints], counts: dict[str, int], automatic: dict[str, Any],
) -> Settled:  # fmt: skip
    """Bring the vertices onto the points, then drop what no point supports, slivers, crumbs and bow ties.

    `near` returns the faces that end near enough to the samples, which vertices may leave on their way.
    """
    faces = weld(vertices, faces, SLIVER * cell)
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
    projection, doubtful = hold_back(vertices, projection, faces, counts)
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
    outward = vertex_normals(vertices, faces)
    choose = choose_fits if settings.along_furrows else choose_reach
    reach = choose(vertices, outward, samples, ladder, stated)
    reach = reach._replace(misfit=np.hypot(reach.misfit, FINEST * cell))
    max_shift = cell + GATE_SIGMAS * samples.noise
    projection = project_vertices(vertices, outward, samples, reach, max_shift)
    roofs = no_roofs()
    if settings.sharp_edges:
        noise = np.maximum(np.fmin(reach.noise, samples.noise), FINEST * cell)
        roofs, rows = find_roofs(vertices, projection, faces, samples, noise, cell, max_shift)
        onto = vertices[roofs.which], roofs, rows, noise[roofs.which]
        brought = bring_onto(projection, *onto)
        is_smooth = projection.is_fitted & (brought.vertices == projection.vertices).all(axis=1)
        if reach.furrows is not None:
            is_smooth[reach.furrows.which] = False
        raw = Raw(vertices, outward, is_smooth)
        projection = fit_own_sides(raw, brought, reach, roofs, rows[:, GAIN], measured, noise, cell, max_shift)
        projection = bring_onto(projection, *onto)  # where that is better known
        projection, roofs = find_corners(vertices, projection, faces, roofs, samples, noise, cell, max_shift)
        projection = snap(projection, faces, roofs, cell)
        projection = projection._replace(sigma=np.maximum(projection.sigma, FINEST * cell))
    automatic["roof_share"] = len(roofs.which) / len(vertices)
    automatic["fit_radius_m"] = float(np.median(ladder.radii[np.where(reach.is_flat, reach.flat, reach.curved)]))
    automatic["flat_share"] = float(np.mean(reach.is_flat))
    automatic["stretched_share"] = 0.0 if reach.furrows is None else len(reach.furrows.which) / len(vertices)
    return projection, roofs


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
    counts["vertices_held_back"] = int(np.count_nonzero(share < 1.0))
    short = np.linalg.norm(projection.vertices - vertices, axis=1)
    doubtful = np.zeros(len(vertices), bool)
    doubtful[faces[suspects]] = True
    return projection._replace(vertices=vertices, sigma=np.hypot(projection.sigma, short)), doubtful


def clean(vertices: Floats, faces: Ints, cell: float, crumb_cells: float) -> Ints:
    """Return faces that make a two-manifold with boundary, without slivers and crumbs."""
    faces = weld(vertices, faces, SLIVER * cell)
    faces = keep_faces(faces, ~is_degenerate(vertices, faces, SLIVER**2 * cell))
    faces = untie(faces)
    if not len(faces):
        raise ReconstructionError(
            f"no surface came of cells of {cell:.4g} m; leave cell_size out, to have it chosen for the points"
        )
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


def invent(settled: Settled, longest_edge: float, settings: SurfaceSettings, counts: dict[str, int]) -> Settled:
    """Return what was settled with the holes closed that the settings ask for, the invented faces behind the others.

    An invented vertex rests on nothing: its sigma is NaN and its support 0.
    """
    widest = np.inf if settings.watertight else settings.close_holes
    if widest <= 0.0:
        return settled
    projection, n_old = settled.projection, len(settled.projection.vertices)
    closed = close_holes(projection.vertices, settled.faces, widest, longest_edge)
    n_new = len(closed.vertices) - n_old
    counts |= {"faces_invented": len(closed.faces) - closed.n_measured, "holes_closed": closed.n_closed,
               "holes_left_open": closed.n_left_open,
               "faces_given_up_at_holes": len(settled.faces) - closed.n_measured}  # fmt: skip
    unknown, no = np.full(n_new, np.nan), np.zeros(n_new, bool)
    filled = Projection(
        vertices=closed.vertices,
        normals=np.r_[projection.normals, vertex_normals(closed.vertices, closed.faces)[n_old:]],
        sigma=np.r_[projection.sigma, unknown],
        scatter=np.r_[projection.scatter, unknown],
        n_support=np.r_[projection.n_support, np.zeros(n_new, projection.n_support.dtype)],
        is_fitted=np.r_[projection.is_fitted, no],
    )
    used, faces = compact(len(closed.vertices), closed.faces)
    return Settled(filled.take(used), faces, np.r_[settled.beside, no][used], np.r_[settled.is_crest, no][used])


def finish(projection: Projection, faces: Ints, samples: cKDTree, cloud: PointCloud) -> Surface:
    """Return the surface in the cloud's frame with sigma, support and what the samples carry."""
    vertices = projection.vertices
    is_carried = any(values is not None for values in (cloud.sigma, cloud.colors, cloud.intensity))
    distance, index = samples.query(vertices, k=[*range(1, N_TINT + 1 if is_carried else 2)], workers=2)
    weight = 1.0 / np.maximum(distance, 1e-3 * np.median(distance)) ** 2
    weight /= weight.sum(axis=1, keepdims=True)
    return Surface(
        vertices=vertices,
        faces=faces,
        normals=projection.normals,
        sigma=vertex_sigma(projection, cloud, index),
        n_support=projection.n_support,
        sample_distance=distance[:, 0],
        roughness=None if cloud.roughness is None else cloud.roughness[index[:, 0]],
        colors=None if cloud.colors is None else np.round(blend(cloud.colors, index, weight)).astype(np.uint8),
        intensity=None if cloud.intensity is None else blend(cloud.intensity, index, weight),
    )


def vertex_sigma(projection: Projection, cloud: PointCloud, index: Ints) -> Floats:
    """Return the standard error of each vertex (m): the scatter seen, or the noise stated where that is larger."""
    if cloud.sigma is None:
        return projection.sigma
    stated = np.sqrt(np.nanmean(np.nan_to_num(cloud.sigma)[index] ** 2, axis=1))
    is_shown = projection.scatter > LEAST_SHOWN * stated
    larger = np.maximum(1.0, stated / np.where(is_shown, np.maximum(projection.scatter, 1e-12), np.inf))
    of_fit = stated * np.sqrt(np.minimum(1.0, OF_FIT / np.maximum(projection.n_support, 1)))
    return np.where(is_shown, projection.sigma * larger, np.hypot(projection.sigma, of_fit))


def blend(values: Any, index: Ints, weight: Floats) -> Floats:
    """Return the weighted mean of `values` of the nearest samples of which they are known, (n,) or (n, c)."""
    picked = np.asarray(values, float)[index]
    if np.isfinite(picked).all():
        return np.einsum("ij,ij...->i...", weight, picked)
    known = weight * np.isfinite(picked)  # one value a sample
    with np.errstate(invalid="ignore"):  # NaN where of none
        return np.asarray(np.einsum("ij,ij->i", known, np.nan_to_num(picked)) / known.sum(axis=1))
