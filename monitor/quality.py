"""How well a surface fits its scans, and its scans each other (docs/method.md, step 10).

In come a surface and the filtered clouds of its scans, out come signed distances, statistics, and the scans' agreement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from monitor.filtering.rounding import error_of_rounding
from monitor.reconstruction import surface_to_points
from monitor.registration.motion.sides import prepare_side
from monitor.registration.network.agreement import Agreement, assess_agreement
from monitor.registration.network.placement import Placement, lay_out_placement
from monitor.registration.network.steepness import Views, join_views
from monitor.robust import nmad
from projects.model import Bools, Floats, PointCloud, Surface


def distances_to_surface(surface: Surface, clouds: Sequence[PointCloud]) -> list[Floats]:
    """Return for each cloud the signed distances (k,) [m] of its points to the surface, NaN where unknown."""
    return [surface_to_points(surface, c.points, c.normals) if len(c) else np.empty(0) for c in clouds]


def assess_scans(surface: Surface, clouds: Sequence[PointCloud]) -> Agreement:
    """Return how well the scans agree with each other, over their common surface."""
    distances = distances_to_surface(surface, clouds)
    spacing, points = _typical_spacing(clouds), [c.points for c in clouds]
    views = None if surface.normals is None else _views_of(clouds, surface.normals)
    return assess_agreement(surface.vertices, points, distances, spacing, views)


def _views_of(clouds: Sequence[PointCloud], normals: Floats) -> Views:
    """Return how the points of the clouds were seen, of a surface whose vertices have these normals (n, 3)."""
    return join_views([_beams(c) for c in clouds], [_find_rims(c) for c in clouds], normals)


def _beams(cloud: PointCloud) -> Floats:
    """Return the unit direction (n, 3) from each point to its scanner, NaN where it is not known where that stood."""
    if cloud.origins is None:
        return np.full((len(cloud), 3), np.nan)
    ways = np.atleast_2d(cloud.origins) - cloud.points
    return np.asarray(ways / np.linalg.norm(ways, axis=1, keepdims=True))


def _find_rims(cloud: PointCloud) -> Bools:
    """Return which points (n,) lie at a rim of what was seen, or have no normal."""
    is_rim = np.ones(len(cloud), dtype=bool)
    if len(cloud):
        side = prepare_side(cloud, np.zeros(3))
        is_rim[side.index] = side.frontality_of(np.arange(len(side))) == 0.0
    return is_rim


def placement_of(clouds: Sequence[PointCloud], network: Mapping[str, Floats]) -> Placement | None:
    """Return where the adjustment put the scans of an epoch (named by `scan_index`), and how sure; None: as given."""
    scans = [0 if c.scan_index is None else int(c.scan_index[0]) for c in clouds]
    unknowns = (6 * np.array(scans)[:, None] + np.arange(6)).ravel()
    joint = network["joint_covariance"][np.ix_(unknowns, unknowns)]
    return lay_out_placement(clouds, _typical_spacing(clouds), joint, network["centres"][scans])


def assess_rounding(surface: Surface, scans: Sequence[tuple[float, Floats]], fits: tuple[float, float]) -> Floats:
    """Return one sigma (n,) [m] of the surface by the rounding of its scans' coordinates; 0 where none are rounded.

    Parameters
    ----------
    scans : of each scan the step [m] of its coordinates (0: not rounded) and its pose (4, 4), which tells their axes.
    fits : m, the radius of the median fit, and the noise of a point.
    """
    rounded = [(step, pose) for step, pose in scans if step > 0.0]
    if not rounded or surface.normals is None:
        return np.zeros(len(surface.vertices))
    radius, noise = fits
    of_each = [error_of_rounding(surface.normals @ pose[:3, :3], noise, radius, step) for step, pose in rounded]
    return np.asarray(np.max(of_each, axis=0))


def join_shared(sigma_disagreement: Floats, sigma_placed: Floats, sigma_rounded: Floats | float = 0.0) -> Floats:
    """Return one sigma (n,) [m] of what whole neighbourhoods are off by: what scans disagree by there, how well they
    are placed, and what the rounding of their coordinates leaves.

    Where the first is unknown (NaN: no two scans overlap) the others stand alone: targets place scans that share
    nothing. NaN where none says anything (a placement of 0 says nothing).
    """
    known = np.hypot(sigma_placed, sigma_rounded)
    return np.where(np.isnan(sigma_disagreement) & (known > 0.0), known, np.hypot(sigma_disagreement, known))


def _typical_spacing(clouds: Sequence[PointCloud]) -> float:
    """Return the median distance [m] between neighbouring measurements of all scans."""
    spacings = [c.spacing for c in clouds if c.spacing is not None and len(c)]
    return float(np.nanmedian(np.concatenate(spacings)))


def describe_distances(distances: Floats) -> dict[str, float]:
    """Return the figures of signed distances (n,) [m], NaN where unknown.

    Returns
    -------
    dict
        `bias_m` (mean), `nmad_m` (1.4826 MAD), `rmse_m`, `p95_m` (95 % quantile of the absolute values), all in
        metres and NaN where no distance is known; `unknown_share` of the points.
    """
    known = distances[np.isfinite(distances)]
    share = 1.0 - len(known) / max(1, len(distances))
    if len(known) == 0:
        return {"bias_m": np.nan, "nmad_m": np.nan, "rmse_m": np.nan, "p95_m": np.nan, "unknown_share": share}
    return {
        "bias_m": float(known.mean()),
        "nmad_m": nmad(known),
        "rmse_m": float(np.sqrt(np.mean(known**2))),
        "p95_m": float(np.quantile(np.abs(known), 0.95)),
        "unknown_share": float(share),
    }
