"""A second opinion of a comparison: what M3C2 says of the points of both epochs.

In come a comparison and the filtered points; out come the figures that the comparison's record keeps beside its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from monitor.comparison.distances.stars import make_mesh, vertex_areas
from monitor.comparison.m3c2 import M3C2Result, m3c2
from monitor.registration.motion.propagation import propagate
from monitor.robust import nmad
from projects.model import Assessment, Comparison, Floats, Ints, NotAssessed, PointCloud
from projects.transforms import apply
from projects.triangles import measured_faces

MOST_CORES = 5000  # core points, evenly drawn: shares are known to 1 %
PER_CYLINDER = 30.0  # points of the sparser cloud: fewer, and a level of detection is not to be trusted (Lague et al.)


def ask_m3c2(comparison: Comparison, reference: PointCloud, compared: PointCloud) -> dict[str, Any]:
    """Return what M3C2 says of the filtered points of both epochs, each in its own coordinates, at some vertices.

    The cylinder holds about 30 points of the sparser cloud (Lague et al. 2013); the registration error is what the
    comparison knows of its own: that of the motion and, in squares, what scans disagree by, in both epochs as in the
    compared one. Where no scans overlap that is not known (NaN) and the error that of the motion alone. Lengths in
    metres.
    """
    side, registration = comparison.on_compared, comparison.registration
    assessed = np.flatnonzero(side.reasons == NotAssessed.ASSESSED)
    cores = assessed[:: max(-(-len(assessed) // MOST_CORES), 1)]
    if not len(cores) or side.surface.normals is None:
        return {"n_core_points": 0}
    fewest = min(len(reference), len(compared))
    area = float(vertex_areas(make_mesh(side.surface.vertices, measured_faces(side.surface))).sum())
    radius = float(np.sqrt(PER_CYLINDER * area / max(fewest, 1) / np.pi))
    points, normals = side.surface.vertices[cores], side.surface.normals[cores]
    motion = propagate(registration.covariance, registration.centre, points, normals)
    shared = _median_shared(side.surface.sigma_shared, cores)
    error = float(np.median(motion))
    error = float(np.hypot(error, np.sqrt(2.0) * shared)) if np.isfinite(shared) else error  # of both epochs' scans
    depth = float(comparison.statistics["search_limit_m"])
    moved = apply(registration.T_target_source, compared.points) if comparison.mode == "relative" else compared.points
    found = m3c2(reference.points, moved, points, normals=normals, cylinder_radius=radius, max_depth=depth,
                 registration_error=error)  # fmt: skip
    figures = _figures(found, side.distances[cores], side.assessment[cores])
    return {"n_core_points": len(cores), "cylinder_radius_m": radius, "max_depth_m": depth,
            "registration_error_m": error, "scan_disagreement_m": shared, **figures}  # fmt: skip


def _median_shared(sigma_shared: Floats | None, cores: Ints) -> float:
    """Return the median of what the scans of an epoch disagree by [m]; NaN where nothing shows it."""
    known = np.empty(0) if sigma_shared is None else sigma_shared[cores]
    known = known[np.isfinite(known)]
    return float(np.median(known)) if len(known) else float("nan")


def _figures(found: M3C2Result, distances: Floats, states: Any) -> dict[str, float]:
    """Return shares of the core points that M3C2 could judge, and how its distances differ from ours."""
    known = np.isfinite(found.distances)
    significant, changed = found.is_significant[known], states[known] == Assessment.CHANGED

    def share(which: Any) -> float:
        """Return the share that is significant of the core points in a mask (n,); NaN without any."""
        return float(np.mean(significant[which])) if which.any() else float("nan")

    off = (found.distances - distances)[known]
    return {
        "known_share": float(known.mean()),
        "share_significant": share(np.ones(len(significant), dtype=np.bool_)),
        "share_significant_of_changed": share(changed),
        "share_significant_of_unchanged": share(~changed),
        "lod95_median_m": float(np.median(found.lod95[known])) if known.any() else float("nan"),
        "difference_median_m": float(np.median(off)) if len(off) else float("nan"),
        "difference_scatter_m": nmad(off),
    }
