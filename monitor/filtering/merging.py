"""The second pass, on the merged cloud of an epoch (Nothegger and Dorninger 2010: the thinning applied a second time).

In: the filtered clouds of the scans in the project's frame, registered; out: one cloud. The noise of the merged cloud
holds what registration left between the scans.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from monitor.declare import given_or_default
from monitor.filtering.copies import find_copies
from monitor.filtering.diffusion import diffuse_with_record
from monitor.filtering.doubtful import find_borne_out
from monitor.filtering.nearest import build_index, canonical_order
from monitor.filtering.normals import fit_planes, known_directions
from monitor.filtering.scan import FilterResult, FilterSettings, count_thinned, thin_cloud
from monitor.filtering.seen_through import find_seen_through
from monitor.filtering.soundness import MIN_POINTS, require_finite
from projects.errors import ParameterError
from projects.model import Bools, Floats, PointCloud


def merge_scans(
    clouds: Sequence[PointCloud], settings: FilterSettings | None = None, slack: float = 0.0,
    doubtful: Sequence[PointCloud] = (),
) -> FilterResult:  # fmt: skip
    """Merge the filtered clouds of several scans into one: what another bears out or looked through, normals, outliers,
    thinning.

    Parameters
    ----------
    clouds : as of `filter_scan`, in the project's frame and registered; a `scan_index` is kept, else it is their
        place here.
    settings : found from the merged cloud where not given.
    slack : m, by which the scans may still lie off each other (`find_seen_through`).
    doubtful : for each cloud what its scan left out as doubtful (`FilterResult.doubtful`), likewise in the project's
        frame; what another station bears out (`find_borne_out`) is merged with the rest. None of it where left out.

    Returns
    -------
    FilterResult
        Its cloud has origins (n, 3) of the nearest member's scanner; the sigma of a point holds the discrepancy
        between the scans it was merged from.
    """
    settings = given_or_default(settings, FilterSettings)
    _require_mergeable(clouds, slack, doubtful)
    had_doubtful = any(map(len, doubtful))
    clouds, borne_out = _with_borne_out(clouds, doubtful, slack)
    n_before, n_borne_out = sum(map(len, clouds)), sum(int(b.sum()) for b in borne_out)
    if settings.silhouettes.drop_seen_through:
        seen = find_seen_through(clouds, slack)
        clouds = [c.take(~s) for c, s in zip(clouds, seen, strict=True)]
        borne_out = [b[~s] for b, s in zip(borne_out, seen, strict=True)]
    merged, left_out = concatenate_clouds(turn_alike(clouds)), _left_out(clouds, settings, slack, had_doubtful)
    _require_not_thinned_away(n_before, clouds, settings)
    if len(merged) < MIN_POINTS:
        raise ParameterError(
            f"to merge were given {n_before} points, of which {n_before - len(merged)} lie where another scan looked "
            f"through; at least {MIN_POINTS} must be left: check the poses, and what the extent leaves of the scans"
        )
    n_merged, order = len(merged), canonical_order(merged.points)
    order = order[~find_copies(merged.points[order])]
    merged, is_sure = merged.take(order), np.concatenate(borne_out)[order]
    index = build_index(merged.points)
    towards = orientation_of(merged)
    planes = fit_planes(index, towards, settings.normals, towards if towards is merged.normals else None)
    keep = ~planes.is_outlier | is_sure
    cloud, thinned, automatic = thin_cloud(merged, index, planes, keep, settings.thinning)
    _require_not_thinned_away(len(cloud), [cloud], settings)
    automatic |= left_out
    counts = {
        "in": n_before, **({"borne_out": n_borne_out} if had_doubtful else {}), "seen_through": n_before - n_merged,
        **({"copy": n_merged - len(merged)} if len(merged) < n_merged else {}), "outlier": int((~keep).sum()),
        **count_thinned(int(keep.sum()), thinned),
    }  # fmt: skip
    if settings.diffusion.enabled and len(cloud) >= MIN_POINTS:
        diffused = diffuse_with_record(cloud, settings.diffusion)
        return FilterResult(diffused.cloud, counts, {**automatic, "diffusion": diffused.automatic})
    return FilterResult(cloud, counts, automatic)


def _with_borne_out(
    clouds: Sequence[PointCloud], doubtful: Sequence[PointCloud], slack: float
) -> tuple[list[PointCloud], list[Bools]]:
    """Return the clouds with those of their doubtful points that others bear out, and the mask of these in each."""
    beside = doubtful if len(doubtful) else [PointCloud(np.empty((0, 3)))] * len(clouds)
    found = [those.take(kept) for those, kept in zip(beside, find_borne_out(clouds, beside, slack), strict=True)]
    joined = [
        dataclasses.replace(concatenate_clouds([_numbered(c, k) for c in (cloud, own)]), origins=cloud.origins)
        if len(own)
        else cloud
        for k, (cloud, own) in enumerate(zip(clouds, found, strict=True))
    ]
    return joined, [np.arange(len(both)) >= len(cloud) for both, cloud in zip(joined, clouds, strict=True)]


def _require_mergeable(clouds: Sequence[PointCloud], slack: float, doubtful: Sequence[PointCloud]) -> None:
    """Raise `ParameterError` where a cloud, or how far they lie off each other, cannot be."""
    if not any(len(c) for c in clouds):
        raise ParameterError("no points were given to merge; at least one cloud must have some")
    if slack < 0.0:
        raise ParameterError(f"slack = {slack:g} m; by how much scans lie off each other is 0 or more, NaN if unknown")
    if len(doubtful) not in (0, len(clouds)):
        raise ParameterError(
            f"{len(doubtful)} clouds of doubtful points were given with {len(clouds)} clouds; one for each, or none"
        )
    for i, cloud in enumerate((*clouds, *doubtful)):
        require_finite(cloud.points, f"cloud {i}")
        if cloud.n_merged is not None and (cloud.n_merged < 1).any():
            raise ParameterError(f"cloud {i}: a point stands for {cloud.n_merged.min()} measurements; it is 1 or more")


def _require_not_thinned_away(n_left: int, clouds: Sequence[PointCloud], settings: FilterSettings) -> None:
    """Raise `ParameterError` where so wide a target spacing was asked for that next to none of the measurements of the
    thinned clouds are left."""
    spacing = settings.thinning.target_spacing
    n_measured = sum(len(c) if c.n_merged is None else int(c.n_merged.sum()) for c in clouds)
    if spacing is None or n_left >= MIN_POINTS or n_measured < MIN_POINTS:
        return
    raise ParameterError(
        f"filter.thinning.target_spacing = {spacing:g} m thins {n_measured} measurements to {n_left}; at least "
        f"{MIN_POINTS} points must be left: set a smaller one, or leave it out"
    )


def _left_out(
    clouds: Sequence[PointCloud], settings: FilterSettings, slack: float, had_doubtful: bool
) -> dict[str, str]:
    """Return, for the record, what the merged cloud lacks because some of the clouds have none of it, and what was not
    looked for."""
    full = [c for c in clouds if len(c)]
    n_without = sum(c.colors is None for c in full)
    colors = {"colors_left_out": f"{n_without} of {len(full)} scans have none"} if 0 < n_without < len(full) else {}
    n_lost = sum(c.origins is None or not np.isfinite(c.origins).all() for c in full)
    unseen = ""
    if np.isnan(slack):
        unseen = "it is not known how far the scans lie off each other"
    elif n_lost:
        unseen = f"of {n_lost} of {len(full)} scans it is not known where the scanner stood"
    if not unseen or len(full) < 2:
        return colors
    through = {"seen_through_left_out": unseen} if settings.silhouettes.drop_seen_through else {}
    return {**colors, **through, **({"borne_out_left_out": unseen} if had_doubtful else {})}


def turn_alike(clouds: Sequence[PointCloud]) -> Sequence[PointCloud]:
    """Return the clouds with the normals of those whose scanner's place is unknown turned as the others' are.

    Such a cloud looks outward where it is closed; of a wall or a relief that is a guess. It is turned round as a whole
    where the quarter of its points that is nearest to clouds of known place looks against what is nearest there.
    """
    is_known = [c.origins is not None and bool(np.isfinite(c.origins).all()) for c in clouds]
    known = [c for c, is_sure in zip(clouds, is_known, strict=True) if is_sure and len(c) and c.normals is not None]
    if not known or all(is_known):
        return clouds
    normals = np.concatenate([c.normals for c in known if c.normals is not None])
    tree = cKDTree(np.concatenate([c.points for c in known]))

    def turned(cloud: PointCloud) -> PointCloud:
        """Return the cloud with its normals turned, where in its nearest quarter they oppose those of the others."""
        if cloud.normals is None or not len(cloud):
            return cloud
        apart, nearest = tree.query(cloud.points)
        agreement = (cloud.normals * normals[nearest]).sum(axis=1)[apart <= np.quantile(apart, 0.25)]
        return cloud if agreement.sum() >= 0.0 else dataclasses.replace(cloud, normals=-cloud.normals)

    return [c if is_sure else turned(c) for c, is_sure in zip(clouds, is_known, strict=True)]


def orientation_of(cloud: PointCloud) -> Floats | None:
    """Return what the normals of a merged cloud are turned by: those of its scans, None where no scanner is known.

    Without a known scanner each scan's normals were made to agree among themselves only; two scans of one relief may
    look opposite ways, so the merged cloud decides anew. Where normals are not known, the places of the scanners are.
    """
    if cloud.origins is not None and not np.isfinite(cloud.origins).any():
        return None
    is_known = cloud.normals is not None and bool(np.isfinite(cloud.normals).all())
    return cloud.normals if is_known else known_directions(cloud)


def _numbered(cloud: PointCloud, number: int) -> PointCloud:
    """Return a cloud with a number as the scan that its points come from, where it does not say it."""
    if cloud.scan_index is not None:
        return cloud
    return dataclasses.replace(cloud, scan_index=np.full(len(cloud), number, dtype=np.int32))


def concatenate_clouds(clouds: Sequence[PointCloud]) -> PointCloud:
    """Return all points in one cloud, without what one of the clouds lacks; `scan_index` is kept, else their place.

    Intensity that some clouds lack is NaN there.
    """
    numbered = [_numbered(cloud, i) for i, cloud in enumerate(clouds)]
    joined: dict[str, Any] = {}
    for f in dataclasses.fields(PointCloud):
        values = [getattr(c, f.name) for c in numbered if len(c)]
        if f.name == "intensity" and any(v is not None for v in values):
            values = [np.full(len(c), np.nan) if c.intensity is None else c.intensity for c in numbered if len(c)]
        if any(v is None for v in values):
            continue
        if f.name == "origins":
            values = [np.broadcast_to(v, (len(c), 3)) for v, c in zip(values, filter(len, numbered), strict=True)]
        joined[f.name] = np.concatenate(values)
    return PointCloud(**joined)
