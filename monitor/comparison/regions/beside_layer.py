"""Change beside a layer all over: what stands out of it is looked for, and its regions' figures are told, without it.

In: a surface all of which lies further in or out by one thickness, as the registration found it. Out: the surface with
that peeled off, which is judged; and the answer with distances and levels as they were measured, with it. Whether an
object was cleaned all over or scanned by an instrument whose ranges differ, nobody knows from two epochs. As an error
the layer would raise the level of detection by its whole thickness, and hide all that lies within it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from scipy.stats import foldnorm, norm

from monitor.comparison.distances.quantile import median
from monitor.comparison.distances.scratch import keep_on_disk
from monitor.comparison.distances.side import Side
from monitor.reconstruction.mesh import face_areas_and_normals
from projects.model import Z95, ComparedSurface, Floats, NotAssessed, Registration, Surface

Found = tuple[ComparedSurface, ComparedSurface]  # on the reference and the compared surface
STEPS = np.linspace(0.0, 4.0, 81)  # of a layer, in sigmas of the errors
QUANTILES = foldnorm.ppf(0.95, STEPS)  # of the size of a distance, in sigmas
ONE_SIDED = float(norm.ppf(0.95))
SHARPEST = 0.5  # least cosine between a vertex's normal and its faces' that is made up for: an edge of 60 degrees


def thickness_of(registration: Registration) -> float:
    """Return the thickness [m] by which the compared surface lies outside of the reference all over; 0 if none does."""
    return float(registration.layer) if np.isfinite(registration.layer) else 0.0


def peel(surface: Surface, thickness: float) -> Surface:
    """Return a surface put inward by a thickness [m], each face as far as it can be: vertices of edges go farther."""
    return replace(surface, vertices=keep_on_disk(surface.vertices - thickness * outward(surface)))


def peel_points(points: Floats | None, surface: Surface, thickness: float) -> Floats | None:
    """Return points (n, 3) [m] put inward as the vertices of their surface next to them are; None without points."""
    if points is None or not len(points):
        return points
    _, nearest = cKDTree(surface.vertices).query(points, workers=2)
    return np.asarray(points - thickness * outward(surface)[nearest])


def outward(surface: Surface) -> Floats:
    """Return the ways (n, 3) that move the faces around each vertex outward by 1 in the mean; 0 without faces.

    Along the mean normal n, weighted by area, faces with normals f move by n f, the mean of which is the length of the
    mean of the f: less than 1 at an edge.
    """
    areas, normals = face_areas_and_normals(surface.vertices, surface.faces)
    at, n = surface.faces.ravel(order="F"), len(surface.vertices)
    area = np.bincount(at, np.tile(areas, 3), n)
    total = np.column_stack([np.bincount(at, np.tile(areas * f, 3), n) for f in normals.T])
    mean = total / np.where(area > 0.0, area, 1.0)[:, None]
    length = np.linalg.norm(mean, axis=1)
    return np.asarray(mean / np.maximum(length, 1e-12)[:, None] / np.maximum(length, SHARPEST)[:, None])


def lay_back(found: Found, measured: tuple[Side, Side], thickness: float) -> tuple[Found, tuple[Side, Side]]:
    """Return both sides as they were `found` beside a layer, with what was `measured` of them with it."""
    first, second = (_lay_back(f, side, thickness) for f, side in zip(found, measured, strict=True))
    return (first[0], second[0]), (first[1], second[1])


def _lay_back(found: ComparedSurface, side: Side, thickness: float) -> tuple[ComparedSurface, Side]:
    """Return one side's answer as it was measured, and the side with it.

    What is changed stays so. Distances are those to the surface as it is; where it has no foot for a vertex, beside an
    edge or where something was looked through, the layer is added to the distance found beside it.
    """
    is_known = np.isfinite(found.distances)
    distances = np.where(side.is_assessed, side.distances, found.distances + thickness)
    laid = replace(found, surface=side.surface, distances=keep_on_disk(np.where(is_known, distances, np.nan)),
                   lod95=keep_on_disk(level_with(found.lod95, thickness)))  # fmt: skip
    return laid, replace(side, distances=laid.distances, reasons=found.reasons)


def level_with(levels: Floats, thickness: float) -> Floats:
    """Return the size (n,) [m] below which 95 % of unchanged distances lie that have a layer besides their errors.

    `levels` (n,) [m] are those of the errors alone, 1.96 sigma; of a normal distribution about the thickness the size
    (folded normal distribution) is wanted. A layer that may be change or error is no change by itself.
    """
    sigma = levels / Z95
    ratio = abs(thickness) / np.maximum(sigma, 1e-300)
    within = np.interp(ratio, STEPS, QUANTILES)
    return np.asarray(np.where(ratio < STEPS[-1], sigma * within, abs(thickness) + sigma * ONE_SIDED))


def name_beside(table: pd.DataFrame, thickness: float) -> pd.DataFrame:
    """Return the table of regions beside a layer, unclear where the layer decides whether it was gained or lost.

    What stands out of a layer taken off, but lies no further out than before it, may have been left out by a cleaning.
    """
    mean = table["mean_m"].to_numpy(dtype=float)
    is_open = (mean + thickness) * mean <= 0.0
    return table.assign(kind=np.where(is_open, "unclear", table["kind"]))


def level_beside(found: ComparedSurface) -> float:
    """Return the median level of detection [m] of what was found beside a layer; NaN where nothing is assessed."""
    known = found.lod95[found.reasons == NotAssessed.ASSESSED]
    return median(known) if len(known) else float("nan")
