"""What happens to one scan, in order: robust normals, outliers, silhouettes, roughness, thinning to the mode.

In: a `Scan` in its own frame; out: a `PointCloud` in the project's frame and a record of what each step did.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monitor.declare import given_or_default
from monitor.filtering.averaging import AveragingSettings
from monitor.filtering.calibration import Calibration, CalibrationSettings, correct_range
from monitor.filtering.copies import find_copies
from monitor.filtering.diffusion import DiffusionSettings
from monitor.filtering.fringes import find_fringes
from monitor.filtering.nearest import PointIndex, build_index, canonical_order
from monitor.filtering.normals import NormalSettings, TangentPlanes, fit_planes
from monitor.filtering.roughness import classify_roughness
from monitor.filtering.rounding import error_of_rounding, find_step, spread_rounded
from monitor.filtering.silhouettes import (
    SilhouetteSettings,
    find_grazing,
    find_mixed,
    find_rims,
)
from monitor.filtering.soundness import MIN_POINTS, require_scan, without_zero_ranges
from monitor.filtering.specks import find_isolated, find_specks
from monitor.filtering.thinning import ThinnedPoints, ThinningSettings, target_spacings, thin
from monitor.filtering.voxel_median import take_medians
from projects.model import Bools, Floats, Ints, PointCloud, Roughness, Scan, require_noun
from projects.transforms import apply, rotate

USUAL_INCIDENCE = SilhouetteSettings().max_incidence
FAR_OFF = 5.0  # sigma off the plane: an outlier nearer to it may be noise of that surface


@dataclass(frozen=True, kw_only=True)
class FilterSettings:
    """The filtering chain: one part for each step."""

    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    averaging: AveragingSettings = field(default_factory=AveragingSettings)
    normals: NormalSettings = field(default_factory=NormalSettings)
    silhouettes: SilhouetteSettings = field(default_factory=SilhouetteSettings)
    thinning: ThinningSettings = field(default_factory=ThinningSettings)
    diffusion: DiffusionSettings = field(default_factory=DiffusionSettings)


@dataclass(frozen=True)
class FilterResult:
    """A filtered cloud with what each step did.

    `counts`: points in, dropped by reason, merged, out; each point that came in is counted once (`borne_out` of a merge
    is a part of those that came in). `automatic`: the values found from the data, lengths in metres. `doubtful`, of one
    scan, in the frame of `cloud`: single points that it dropped as outliers, far off the plane of their neighbours,
    whose normal they have; another station may bear them out (`merge_scans`).
    """

    cloud: PointCloud
    counts: Mapping[str, int]
    automatic: Mapping[str, Any]
    doubtful: PointCloud | None = None


def filter_scan(scan: Scan, settings: FilterSettings | None = None) -> PointCloud:
    """Filter and thin one scan; see `filter_scan_with_record`, of which this is the cloud."""
    return filter_scan_with_record(scan, settings).cloud


def filter_scan_with_record(
    scan: Scan, settings: FilterSettings | None = None, calibration: Calibration | None = None
) -> FilterResult:
    """Filter and thin one scan (Nothegger and Dorninger, sections 2.1 to 2.4).

    Parameters
    ----------
    scan : points in the scanner's frame, where the scanner stood (`origin`), and the pose; not modified.
    settings : found from the data where not given.
    calibration : of the whole scan (`calibrate_range`); None: ranges are taken as they are. What lies within an
        object's extent is rarely enough to find it from.

    Returns
    -------
    FilterResult
        Its cloud is in the **project's** frame, in an order that does not depend on that of the scan, with normals
        (towards the scanner, or outward where its place is not known), origins (3,), sigma, n_merged, spread,
        surface_variation, roughness, spacing, and intensity and colors where the scan has them.

    Raises
    ------
    ParameterError
        If a coordinate is not finite, or the pose is no rigid motion.
    """
    require_noun(scan, "what is filtered", Scan)
    settings = given_or_default(settings, FilterSettings)
    require_scan(scan)
    is_known = bool(np.isfinite(scan.origin).all())
    origin = scan.origin if is_known else np.full(3, np.nan)
    measured = without_zero_ranges(dataclasses.replace(scan, origin=origin))
    given = {"in": len(scan.cloud)}
    if len(measured.cloud) < len(scan.cloud):
        given["at_scanner"] = len(scan.cloud) - len(measured.cloud)
    found = _thin_scan(measured, settings, calibration)
    cloud = _placed(found.cloud, scan.pose, origin)
    doubtful = None if found.doubtful is None else _placed(found.doubtful, scan.pose, origin)
    return dataclasses.replace(found, cloud=cloud, counts={**given, **found.counts}, doubtful=doubtful)


def _placed(cloud: PointCloud, pose: Floats, origin: Floats) -> PointCloud:
    """Return a cloud in the scanner's frame in the project's, with where the scanner stood."""
    normals = None if cloud.normals is None else rotate(pose, cloud.normals)
    return dataclasses.replace(cloud, points=apply(pose, cloud.points), normals=normals, origins=apply(pose, origin))


def _thin_scan(scan: Scan, settings: FilterSettings, calibration: Calibration | None) -> FilterResult:
    """Filter and thin one scan in its own frame; what is as long as the scan goes when this returns."""
    n_given, step = len(scan.cloud), find_step(scan.cloud.points)
    scan = _in_order(scan, step)
    if step > 0.0:
        scan = _moved(scan, spread_rounded(scan.cloud.points, step))
    if calibration is not None:
        scan = correct_range(scan, calibration)
    if step > 0.0 or calibration is not None:
        scan = scan.take(canonical_order(scan.cloud.points))
    counts = {"copy": n_given - len(scan.cloud)} if len(scan.cloud) < n_given else {}
    if len(scan.cloud) < MIN_POINTS:
        return _nothing_left(scan, counts)
    index = build_index(scan.cloud.points)
    planes = fit_planes(index, scan.origin if np.isfinite(scan.origin).all() else None, settings.normals)
    is_far = planes.is_outlier & (np.abs(planes.heights) > FAR_OFF * np.maximum(planes.sigma, planes.noise))
    planes = planes.without("lambda3", "heights", "sigma_normal")
    mixed = _mixed(scan, planes, settings.silhouettes)
    scan = dataclasses.replace(scan, rows=None, columns=None)  # the rims need much memory of their own
    dropped, keep, only_outlier = _sort_out(scan, planes, mixed, settings.silhouettes)
    planes = planes.without("reach", "is_outlier")
    doubtful = _single_points(scan.cloud, planes, np.flatnonzero(only_outlier & is_far))
    cloud, thinned, automatic = thin_cloud(scan.cloud, index, planes, keep, settings.thinning)
    if step > 0.0:
        cloud, automatic = _as_rounded(cloud, step), {**automatic, "coordinate_step": step}
    if not np.isfinite(scan.origin).all():
        automatic = {**automatic, "silhouettes_left_out": "it is not known where the scanner stood"}
    return FilterResult(cloud, {**counts, **dropped, **count_thinned(int(keep.sum()), thinned)}, automatic, doubtful)


def _in_order(scan: Scan, step: float) -> Scan:
    """Return the scan in canonical order without copies; `step` [m] of its coordinates."""
    scan = scan.take(canonical_order(scan.cloud.points))
    copies = find_copies(scan.cloud.points, step)
    return scan.take(~copies) if copies.any() else scan


def _moved(scan: Scan, points: Floats) -> Scan:
    """Return the scan with its points at other places."""
    return dataclasses.replace(scan, cloud=dataclasses.replace(scan.cloud, points=points))


def _as_rounded(cloud: PointCloud, step: float) -> PointCloud:
    """Return representatives, in their scan's frame, whose sigma holds what the rounding of coordinates leaves."""
    n_merged, spacing = cloud.n_merged, cloud.spacing
    if cloud.normals is None or cloud.spread is None or cloud.sigma is None or n_merged is None or spacing is None:
        return cloud
    radius = np.sqrt(n_merged / np.pi) * spacing
    left = error_of_rounding(cloud.normals, cloud.spread, radius, step)
    return dataclasses.replace(cloud, sigma=np.hypot(cloud.sigma, left))


def _mixed(scan: Scan, planes: TangentPlanes, settings: SilhouetteSettings) -> dict[str, Bools]:
    """Return the mask of mixed pixels, by its reason, where the scan is a grid whose scanner's place is known.

    Where less incidence than usual is asked for, the range along a steep face jumps from beam to beam: that goes as
    grazing.
    """
    if scan.rows is None or scan.columns is None or not np.isfinite(scan.origin).all():
        return {}
    given = (scan.cloud.points, scan.origin, scan.rows, scan.columns, planes.noise)
    mixed = find_mixed(*given, settings.max_incidence)
    if settings.max_incidence < USUAL_INCIDENCE:
        grazing = find_grazing(scan.cloud.points, scan.origin, planes.normals, settings.max_incidence)
        mixed &= ~grazing | find_mixed(*given, USUAL_INCIDENCE)
    return {"mixed_pixel": mixed}


def _sort_out(
    scan: Scan, planes: TangentPlanes, mixed: Mapping[str, Bools], settings: SilhouetteSettings
) -> tuple[dict[str, int], Bools, Bools]:
    """Return how many points go for each reason, the mask of those that stay, and of those that are only outliers."""
    reasons = _reasons(scan, planes, mixed, settings)
    others = np.any([holds for reason, holds in reasons.items() if reason != "outlier"], axis=0)
    return _count_first(reasons), ~(others | planes.is_outlier), planes.is_outlier & ~others


def _single_points(cloud: PointCloud, planes: TangentPlanes, which: Ints) -> PointCloud:
    """Return points of a scan, each for itself, with what a thinned cloud tells: of the plane of their neighbours."""
    noise = planes.noise[which]
    return dataclasses.replace(
        cloud.take(which), normals=planes.normals[which], sigma=noise, spread=noise,
        n_merged=np.ones(len(which), dtype=np.int32), surface_variation=planes.surface_variation[which],
        roughness=classify_roughness(planes.relief2[which], noise, planes.n_neighbours[which]),
        spacing=planes.spacing[which],
    )  # fmt: skip


def _nothing_left(scan: Scan, counts: Mapping[str, int]) -> FilterResult:
    """Return the result of a scan with too few points to have a surface."""
    return FilterResult(PointCloud(np.empty((0, 3))), {**counts, "too_few": len(scan.cloud), "merged": 0, "out": 0}, {})


def _reasons(
    scan: Scan, planes: TangentPlanes, mixed: Mapping[str, Bools], settings: SilhouetteSettings
) -> dict[str, Bools]:
    """Return for each reason to drop points the mask of those that it holds for; the first that holds is counted.

    What needs the place of the scanner is left out where that is not known.
    """
    points, origin = scan.cloud.points, scan.origin
    if not np.isfinite(origin).all():
        return {"speck": find_isolated(planes.reach, planes.spacing, settings.isolation), "outlier": planes.is_outlier}
    specks = find_specks(points, origin, planes.reach, settings.isolation)
    reasons = {"speck": specks, "outlier": planes.is_outlier, **mixed}
    if settings.drop_rims:
        known = ~(reasons["speck"] | reasons["outlier"])
        reasons["rim"] = find_rims(points, origin, planes.noise, settings.max_incidence, known, settings.drop_border)
    if settings.drop_limbs:
        known = ~np.any(list(reasons.values()), axis=0)
        reasons["fringe"] = find_fringes(points, origin, planes.normals, planes.noise, known, settings.max_incidence)
    reasons["grazing"] = find_grazing(points, origin, planes.normals, settings.max_incidence)
    return reasons


def _count_first(reasons: Mapping[str, Bools]) -> dict[str, int]:
    """Count each point under the first of its reasons."""
    counts, seen = {}, np.zeros(len(next(iter(reasons.values()))), dtype=bool)
    for reason, holds in reasons.items():
        counts[reason] = int((holds & ~seen).sum())
        seen |= holds
    return counts


def thin_cloud(
    cloud: PointCloud, index: PointIndex, planes: TangentPlanes, keep: Bools, settings: ThinningSettings
) -> tuple[PointCloud, ThinnedPoints, dict[str, Any]]:
    """Thin the points `keep` (n,) of an indexed cloud to their modes; return it, what became of them, and the record.

    Nothing that is as long as the cloud is copied for the points that go.
    """
    roughness = classify_roughness(planes.relief2, planes.noise, planes.n_neighbours)
    targets = target_spacings(planes.spacing, planes.noise, roughness, settings)
    before = describe(planes, roughness, targets, keep)
    merged = np.ones(len(cloud), dtype=np.int32) if cloud.n_merged is None else cloud.n_merged
    if settings.method == "voxel_median" and keep.any():  # of nothing, either method makes nothing
        size, kept = float(np.median(targets[keep])), np.flatnonzero(keep)
        thinned = take_medians(cloud.points[kept], planes.normals[kept], planes.noise[kept], merged[kept], size)
        thinned = dataclasses.replace(thinned, nearest=kept[thinned.nearest], members=kept[thinned.members])
    else:
        thinned = thin(index, planes, merged, targets, settings.seed, keep)
    after = {"noise_after": _median(thinned.sigma), "n_merged_quartiles": _quartiles(thinned.n_merged)}
    return _represented(cloud, planes, roughness, thinned), thinned, {**before, **after}


def _represented(
    cloud: PointCloud, planes: TangentPlanes, roughness: NDArray[np.uint8], thinned: ThinnedPoints
) -> PointCloud:
    """Return the representatives with what the cloud and its planes tell of the members nearest to them."""
    return PointCloud(
        thinned.points, thinned.normals, sigma=thinned.sigma, n_merged=thinned.n_merged, spread=thinned.spread,
        origins=cloud.origins if cloud.origins is None or cloud.origins.ndim == 1 else cloud.origins[thinned.nearest],
        scan_index=None if cloud.scan_index is None else cloud.scan_index[thinned.nearest],
        surface_variation=planes.surface_variation[thinned.nearest], roughness=roughness[thinned.nearest],
        spacing=planes.spacing[thinned.nearest], colors=_mean_of_members(cloud.colors, thinned),
        intensity=_mean_of_members(cloud.intensity, thinned),
    )  # fmt: skip


def count_thinned(n_given: int, thinned: ThinnedPoints) -> dict[str, int]:
    """Return what became of the points given to the thinning; rejected are those that stand in no representative."""
    n_rejected, n_out = n_given - len(thinned.members), len(thinned.points)
    rejected = {"rejected": n_rejected} if n_rejected else {}
    return {**rejected, "merged": len(thinned.members) - n_out, "out": n_out}


def _mean_of_members(values: Any, thinned: ThinnedPoints) -> Any:
    """Return the mean of a property over the members of each representative of which it is known, in its own type."""
    if values is None:
        return None
    of_members = values[thinned.members].astype(np.float64)
    counts: Any = np.diff(thinned.starts)
    known = np.isfinite(of_members)
    if not known.all():  # a float, one value a point
        of_members[~known], counts = 0.0, np.add.reduceat(known, thinned.starts[:-1], dtype=np.int64)
    sums = np.add.reduceat(of_members, thinned.starts[:-1], axis=0)
    with np.errstate(invalid="ignore"):  # NaN where of none
        means = sums / (counts[:, None] if values.ndim == 2 else counts)
    return np.rint(means).astype(values.dtype) if values.dtype.kind in "ui" else means.astype(values.dtype)


def describe(planes: TangentPlanes, roughness: Ints, targets: Floats, keep: Bools) -> dict[str, Any]:
    """Return the values that were found from the points `keep` (n,): quartiles of sizes and lengths [m], noise."""
    n_points = max(int(keep.sum()), 1)
    strides = planes.stride[keep]
    return {
        "n_neighbours_quartiles": _quartiles(planes.n_neighbours[keep]),
        **({"stride_quartiles": _quartiles(strides)} if (strides > 1).any() else {}),
        "spacing_quartiles": _quartiles(planes.spacing[keep]),
        "target_spacing_quartiles": _quartiles(targets[keep]),
        "roughness_shares": {c.name.lower(): float(((roughness == c) & keep).sum() / n_points) for c in Roughness},
        "noise_before": _median(planes.noise[keep]),
    }


def _quartiles(values: Floats | Ints) -> list[float]:
    """Return the quartiles, NaN of nothing."""
    return [float(v) for v in np.quantile(values, (0.25, 0.5, 0.75))] if len(values) else [float("nan")] * 3


def _median(values: Floats) -> float:
    """Return the median, NaN of nothing."""
    return float(np.median(values)) if len(values) else float("nan")
