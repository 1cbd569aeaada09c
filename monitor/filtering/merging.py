"""The second pass, on the merged cloud of an epoch (Nothegger and Dorninger 2010: the thinning applied a second time).

In: the filtered clouds of the scans in the project's frame, registered; out: one cloud. The noise of the merged cloud
holds what registration left between the scans.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from monitor.filtering.diffusion import diffuse_with_record
from monitor.filtering.nearest import build_index, canonical_order
from monitor.filtering.normals import MIN_POINTS, fit_planes, require_points
from monitor.filtering.scan import FilterResult, FilterSettings, count_thinned, thin_cloud
from monitor.filtering.seen_through import find_seen_through
from projects.errors import ParameterError
from projects.model import Floats, PointCloud


def merge_scans(
    clouds: Sequence[PointCloud], settings: FilterSettings | None = None, slack: float = 0.0
) -> FilterResult:
    """Merge the filtered clouds of several scans into one: what another looked through, normals, outliers, thinning.

    Parameters
    ----------
    clouds : as of `filter_scan`, in the project's frame and registered; `scan_index` is set to their place here.
    settings : found from the merged cloud where not given.
    slack : m, by which the scans may still lie off each other (`find_seen_through`).

    Returns
    -------
    FilterResult
        Its cloud has origins (n, 3) of the nearest member's scanner; the sigma of a point holds the discrepancy
        between the scans it was merged from.
    """
    settings = settings or FilterSettings()
    if not any(len(c) for c in clouds):
        raise ParameterError("no points were given to merge; at least one cloud must have some")
    n_before = sum(map(len, clouds))
    if settings.silhouettes.drop_seen_through:
        clouds = [c.take(~seen) for c, seen in zip(clouds, find_seen_through(clouds, slack), strict=True)]
    merged = concatenate_clouds(clouds)
    require_points(merged.points)
    n_merged = len(merged)
    merged = merged.take(canonical_order(merged.points))
    index = build_index(merged.points)
    planes = fit_planes(index, orientation_of(merged), settings.normals)
    keep = ~planes.is_outlier
    cloud, thinned, automatic = thin_cloud(merged, index, planes, keep, settings.thinning)
    counts = {
        "in": n_before, "seen_through": n_before - n_merged, "outlier": int((~keep).sum()),
        **count_thinned(int(keep.sum()), thinned),
    }  # fmt: skip
    if settings.diffusion.enabled and len(cloud) >= MIN_POINTS:
        diffused = diffuse_with_record(cloud, settings.diffusion)
        return FilterResult(diffused.cloud, counts, {**automatic, "diffusion": diffused.automatic})
    return FilterResult(cloud, counts, automatic)


def orientation_of(cloud: PointCloud) -> Floats | None:
    """Return what the normals of a merged cloud are turned by: those of its scans, None where no scanner is known.

    Without a known scanner each scan's normals were made to agree among themselves only; two scans of one relief may
    look opposite ways, so the merged cloud decides anew.
    """
    unknown = cloud.origins is not None and not np.isfinite(cloud.origins).any()
    return None if unknown else cloud.normals


def concatenate_clouds(clouds: Sequence[PointCloud]) -> PointCloud:
    """Return all points in one cloud, without what one of the clouds lacks; `scan_index` is kept, else their place."""
    numbered = [
        c if c.scan_index is not None else dataclasses.replace(c, scan_index=np.full(len(c), i, dtype=np.int32))
        for i, c in enumerate(clouds)
    ]
    joined: dict[str, Any] = {}
    for f in dataclasses.fields(PointCloud):
        values = [getattr(c, f.name) for c in numbered if len(c)]
        if any(v is None for v in values):
            continue
        if f.name == "origins":
            values = [np.broadcast_to(v, (len(c), 3)) for v, c in zip(values, filter(len, numbered), strict=True)]
        joined[f.name] = np.concatenate(values)
    return PointCloud(**joined)
