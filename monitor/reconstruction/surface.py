"""One surface from the points of an epoch: raw mesh, trimmed to what was measured, brought onto the points.

In: a `PointCloud` in the project's frame. Out: a `Surface` that ends where the samples end, with the uncertainty of
each vertex. After Nothegger, "Improving completeness of geometric models from terrestrial laser scanning data".
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from monitor.boxes import box_of
from monitor.declare import given_or_default
from monitor.reconstruction.cell_size import (
    Sampling,
    choose_cell_size,
    measure_and_sort,
    require_cells_wide_enough,
    tree_of_points,
)
from monitor.reconstruction.coverage import find_uncovered, largest_piece, share_uncovered
from monitor.reconstruction.gathering import GATE_SIGMAS
from monitor.reconstruction.holes import close_holes
from monitor.reconstruction.localized import localized_mesh
from monitor.reconstruction.mesh import compact, keep_faces, normals_by_angle
from monitor.reconstruction.moments import Level
from monitor.reconstruction.nearness import has_near
from monitor.reconstruction.open3d_poisson import poisson_mesh
from monitor.reconstruction.openings import leave_openings
from monitor.reconstruction.poisson import screening_by_turn, screening_length
from monitor.reconstruction.projection import Projection, sum_up_samples
from monitor.reconstruction.reach import Stated, make_ladder
from monitor.reconstruction.settling import Settled, all_corners, settle
from monitor.reconstruction.surface_settings import SurfaceSettings
from monitor.reconstruction.usable import take_usable
from projects.errors import ReconstructionError
from projects.model import Floats, Ints, PointCloud, Surface, require_noun
from projects.triangles import rest_on_nothing

LEAST_SHOWN = 0.1  # of the noise stated: points that scatter less tell nothing of it, as those in one plane by rounding
OF_FIT = 4.8  # variance in the middle of a quadratic fit of weights 1 - t^2, times its points over that of one
ALONG_HOLES = 1.5  # cells: the longest edge of an invented face
FINER = 0.9  # of the cell: relief that repeats too finely for it asks for a smaller one
FINEST_CELL = 0.75  # of the spacing, for such relief
N_TINT = 4  # samples that give a vertex its colour, intensity and roughness


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
    settings = given_or_default(settings, SurfaceSettings)
    return make_with_cells(cloud, settings, settings.cell_size)


def make_with_cells(given: PointCloud, settings: SurfaceSettings, cell_size: float | None) -> ReconstructionResult:
    """Make the surface on cells of such an edge (m); None: of one that the points ask for, or else their waves."""
    cloud, counts = take_usable(given)
    low, high = box_of(cloud.points)
    shift = np.round(0.5 * (low + high), 3)
    cloud = replace(cloud, points=cloud.points - shift)
    samples = tree_of_points(cloud.points)
    sampling, finest = measure_and_sort(cloud, samples)
    cell = take_cell_size(cell_size, sampling, len(cloud))
    screening = screening_length(cell, *sampling)
    ladder = make_ladder(
        cell, sampling.noise, settings.narrowest_fit_cells, settings.widest_fit_cells, settings.noise_share
    )
    with ThreadPoolExecutor(1) as aside:  # neither knows of the other, and each has steps that keep one thread
        summed = aside.submit(sum_up_samples, finest, ladder.radii, sampling.noise)
        vertices, faces, cell_used = raw_mesh(cloud, cell, sampling, screening, settings.method)
        summed_up = summed.result()
    automatic = tell_sampling(settings.method, cell_used, sampling, screening)
    counts["faces_raw"] = len(faces)
    near = partial(trim, samples=finest, farthest=settings.trim_cells * cell_used)
    faces = near(vertices, faces)
    counts["faces_untouched_by_samples"] = counts["faces_raw"] - len(faces)
    stated = None if cloud.sigma is None else Stated(samples, cloud.sigma)
    measured = summed_up, ladder, stated
    settled = settle(vertices, faces, measured, cell_used, sampling.spacing, settings, near, counts, automatic)
    finer = automatic.pop("cell_for_waves_m", np.nan)
    if cell_size is None and finer < FINER * cell_used:
        return make_with_cells(given, settings, max(finer, FINEST_CELL * sampling.spacing))
    settled = leave_openings(settled, finest, samples, sampling, settings.crumb_cells * cell_used, counts)
    settled = invent(settled, ALONG_HOLES * cell_used, settings, counts)
    surface = finish(settled.projection, settled.faces, samples, cloud)
    surface = mark(surface, settled, counts.get("faces_invented", 0))
    farthest = cell_used + GATE_SIGMAS * sampling.noise
    uncovered = find_uncovered(surface, cloud, farthest, finest)
    counts |= uncovered.counts
    automatic |= largest_piece(uncovered.places + shift, farthest)
    share_used = counts["points_used"] / (counts["points_used"] + counts["points_without_normal"])
    automatic["uncovered_share"] = 1.0 - share_used * (
        1.0 - share_uncovered(surface, cloud, samples, sampling, farthest)
    )
    counts |= {"vertices": len(surface.vertices), "faces": len(surface.faces)}
    return ReconstructionResult(replace(surface, vertices=surface.vertices + shift), automatic, counts)


def take_cell_size(given: float | None, sampling: Sampling, n_points: int) -> float:
    """Return the edge of a cell [m] that is given or that the points ask for; refuse points that allow none."""
    if not sampling.spacing > 0.0:
        raise ReconstructionError(
            f"most of the {n_points} points share their place with others; a surface needs points beside each other"
        )
    cell = given or choose_cell_size(sampling)
    require_cells_wide_enough(cell, sampling)
    return cell


def tell_sampling(method: str, cell: float, sampling: Sampling, screening: float) -> dict[str, Any]:
    """Return what is recorded of how the points lie and of the cells made of them, lengths in metres."""
    told = {"method": method, "cell_size_m": cell, "spacing_m": sampling.spacing, "noise_m": sampling.noise,
            "turn_rad": sampling.turn}  # fmt: skip
    return {**told, "screening_cells": screening} if method == "localized" else told


def raw_mesh(
    cloud: PointCloud, cell: float, sampling: Sampling, screening: float, method: str
) -> tuple[Floats, Ints, float]:
    """Return vertices (n, 3) [m], faces (m, 3) and the edge of a cell [m] used, of the engine `method`.

    The cloud has normals; `cell` is in metres, `screening` in cells.
    """
    assert cloud.normals is not None
    if method == "open3d":
        return poisson_mesh(cloud.points, cloud.normals, cell)
    by_turn = screening_by_turn(cell, sampling.spacing, sampling.noise)
    vertices, faces = localized_mesh(cloud.points, cloud.normals, cell, sampling.spacing, screening, by_turn=by_turn)
    return vertices, faces, cell


def trim(vertices: Floats, faces: Ints, samples: Level, farthest: float) -> Ints:
    """Return the faces whose corners all lie within `farthest` (m) of a sample."""
    return keep_faces(faces, all_corners(has_near(samples, vertices, vertices, farthest), faces))


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
        normals=np.r_[projection.normals, normals_by_angle(closed.vertices, closed.faces)[n_old:]],
        sigma=np.r_[projection.sigma, unknown],
        scatter=np.r_[projection.scatter, unknown],
        n_support=np.r_[projection.n_support, np.zeros(n_new, projection.n_support.dtype)],
        is_fitted=np.r_[projection.is_fitted, no],
        unit=np.r_[projection.unit, unknown],
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


def mark(surface: Surface, settled: Settled, n_invented: int) -> Surface:
    """Return the surface with what holds of some vertices, and of the last `n_invented` faces; None where of none.

    What rests on these alone sent no light back: its intensity is not known.
    """
    n_faces = len(surface.faces)
    marked = replace(
        surface,
        is_unresolved=settled.beside if settled.beside.any() else None,
        is_crest=settled.is_crest if settled.is_crest.any() else None,
        face_invented=np.arange(n_faces) >= n_faces - n_invented if n_invented else None,
    )
    if marked.intensity is None or not n_invented:
        return marked
    return replace(marked, intensity=np.where(rest_on_nothing(marked), np.nan, marked.intensity))


def vertex_sigma(projection: Projection, cloud: PointCloud, index: Ints) -> Floats:
    """Return the standard error of each vertex (m): the scatter seen, or the noise stated where that is larger.

    What is stated is the mean over the samples around that state anything; around others it is the scatter alone.
    """
    if cloud.sigma is None:
        return projection.sigma
    around2 = cloud.sigma[index] ** 2
    n_known = np.isfinite(around2).sum(axis=1)
    stated = np.sqrt(np.nansum(around2, axis=1) / np.maximum(n_known, 1))
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
