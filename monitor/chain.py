"""What happens to an epoch, in order: the table of contents of the method.

In come a project, an object and an epoch; out come products in the store, each identified by the hash of what was
asked of which inputs, so that a second run does only what is missing and an interrupted one goes on.
Steps are numbered as in docs/method.md, and follow the papers named there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from monitor.adjusted import adjusted_clouds, adjusted_doubtful
from monitor.compared_pair import Pair, compare_registered, register_pair, with_second_opinion
from monitor.engine import Engine
from monitor.filtered_scans import FilteredScans, filter_scans
from monitor.filtering import estimate_normals, merge_scans
from monitor.measured import raw_scans
from monitor.mesh_extent import cut_to_extent
from monitor.quality import (
    assess_rounding,
    assess_scans,
    describe_distances,
    distances_to_surface,
    join_shared,
    placement_of,
)
from monitor.range_calibration import calibrate_scans, calibration_of
from monitor.reconstruction import reconstruct_with_record
from monitor.record import Asked, Made, Place, latest_step, once_step
from monitor.registration.network.placement import placement_sigma
from monitor.repeats import is_averaged
from monitor.same_survey import require_own_scans
from monitor.scan_network import adjust_epoch
from monitor.settings import Settings, as_mapping
from monitor.strays import share_of_strays
from monitor.target_search import search_targets
from monitor.winding import wind_outward
from projects.control_held import control_holds_whole
from projects.errors import ParameterError
from projects.extent import Extent
from projects.identifiers import comparison_product, scan_product
from projects.model import Floats, PointCloud, Step, Surface
from projects.store import Project

Notify = Callable[[str], None]
SLACK_SIGMAS = 3.0  # of the misfit of the scans: nearly all points lie no farther off those of another scan


def process_epoch(place: Place, settings: Settings, engine: Engine, notify: Notify) -> list[Step]:
    """Bring one epoch up to date (steps 1 to 10) and return its steps in order."""
    if place.project.epoch(place.object_id, place.epoch_id).is_mesh:
        return [_adopt_mesh(place, notify)]
    calibrations = calibrate_scans(place, settings.filter.calibration, engine, notify)
    filtered_scans = filter_scans(place, settings, calibrations, engine, notify)
    scans, doubtful = filtered_scans
    targets = search_targets(place, settings.targets, calibrations, engine, notify)
    network = adjust_epoch(place, settings.adjust, scans, targets, notify)
    filtered = _merge(place, settings, filtered_scans, network, notify)
    surface = _reconstruct(place, settings, (*scans, network), filtered, calibrations, notify)
    quality = _assess_quality(place, (*scans, network), surface, notify)
    return [*scans, *doubtful, *targets, network, filtered, surface, quality]


def compare_epochs(
    place: Place, reference_id: str, settings: Settings, notify: Notify, mode: str | None = None,
    stable: Extent | None = None,
) -> Step:  # fmt: skip
    """Compare an epoch with an earlier one (steps 11 to 13); the result is kept with the compared epoch.

    `stable` is where the user says that nothing moved, in the reference's coordinates; found where left out.
    """
    compared_id = place.epoch_id
    if reference_id == compared_id:
        raise ParameterError(f"epoch {reference_id} was given twice; a comparison needs two different epochs")
    earlier = replace(place, epoch_id=reference_id)
    require_own_scans(earlier, place)
    before, after = latest_step(earlier, "surface"), latest_step(place, "surface")
    mode = mode or default_mode(place.project, place.object_id, reference_id, compared_id)
    tolerance = place.project.object(place.object_id).tolerance
    parameters = {
        "mode": mode,
        "tolerance": tolerance,
        "icp": as_mapping(settings.icp),
        "compare": as_mapping(settings.compare),
        "parts": as_mapping(settings.parts),
        **({} if stable is None else {"stable": stable.to_mapping()}),
    }

    pair = Pair(earlier, place, before, after)

    def make() -> Made:
        """Register, compare, and tell which parts moved; with the second opinion where both epochs have points."""
        notify(f"{compared_id}: registering to {reference_id}")
        registered = register_pair(pair, settings, mode, stable)
        notify(f"{compared_id}: comparing with {reference_id}")
        found = compare_registered(pair, registered, settings, mode, tolerance, stable_is_given=stable is not None)
        return with_second_opinion(pair, found, registered.start)

    asked = Asked(comparison_product(reference_id), "comparison", parameters, (before, after))
    return once_step(place, asked, make)


def default_mode(project: Project, object_id: str, reference_id: str, compared_id: str) -> str:
    """Return "absolute" where control points hold both epochs, "relative" otherwise (step 11)."""
    both = all(is_held_by_control(project, object_id, e) for e in (reference_id, compared_id))
    return "absolute" if both else "relative"


def is_held_by_control(project: Project, object_id: str, epoch_id: str) -> bool:
    """Return whether an epoch has control points that hold all of it: a finished mesh has none, and a network says what
    those it found hold; where there was no network, the scans are taken to stand as their control says."""
    record = project.epoch(object_id, epoch_id)
    network = project.latest(object_id, epoch_id, "network")
    return bool(record.control) and not record.is_mesh and (network is None or control_holds_whole(network.automatic))


def pairs_to_compare(epoch_ids: list[str]) -> list[tuple[str, str]]:
    """Return each epoch with the first and with the one before it, (reference, compared), without repeats."""
    pairs: list[tuple[str, str]] = []
    for k in range(1, len(epoch_ids)):
        for reference in (epoch_ids[0], epoch_ids[k - 1]):
            if (reference, epoch_ids[k]) not in pairs:
                pairs.append((reference, epoch_ids[k]))
    return pairs


def _merge(place: Place, settings: Settings, filtered_scans: FilteredScans, network: Step, notify: Notify) -> Step:
    """Merge the scans and filter the merged cloud once more (step 8; Dorninger & Nothegger 2009)."""
    scans, doubtful = filtered_scans

    def make() -> Made:
        """Merge the clouds of the set-ups where the adjustment put them, with what they bear out of each other's."""
        notify(f"{place.epoch_id}: merging {len(scans)} scan{'s' if len(scans) > 1 else ''}")
        clouds, beside = adjusted_clouds(place, scans, network), adjusted_doubtful(place, filtered_scans, network)
        result = merge_scans(clouds, settings.filter, _slack(network), beside)
        return Made(result.cloud, result.automatic, result.counts)

    asked = Asked("filtered", "filtered", {"filter": as_mapping(settings.filter)}, (*scans, *doubtful, network))
    return once_step(place, asked, make)


def _slack(network: Step) -> float:
    """Return by how much [m] the scans may still lie off each other; NaN where no two of them overlap."""
    stands = "misfit_after_m" if network.automatic["applied"] else "misfit_before_m"
    return SLACK_SIGMAS * float(network.automatic[stands])


def _reconstruct(
    place: Place, settings: Settings, parts: tuple[Step, ...], filtered: Step, calibrations: list[Step | None],
    notify: Notify,
) -> Step:  # fmt: skip
    """Make the surface of the merged cloud (step 9), with what its scans disagree by and leave off it."""

    def make() -> Made:
        """Make the surface, then learn from the scans what its vertices share in error and what lies off it."""
        notify(f"{place.epoch_id}: reconstructing the surface")
        result = reconstruct_with_record(place.get(filtered), settings.surface)
        notify(f"{place.epoch_id}: comparing its scans with each other")
        clouds = adjusted_clouds(place, parts[:-1], parts[-1])
        agreement = assess_scans(result.surface, clouds)
        sigma_placed = placement_sigma(result.surface.vertices, placement_of(clouds, place.get(parts[-1])))
        fits = result.automatic["fit_radius_m"], result.automatic["noise_m"]
        sigma_rounded = assess_rounding(result.surface, _roundings(place, parts), fits)
        averaged = is_averaged(place, settings.filter)  # whose raw points drift from the mean of them all
        strays = None if averaged else _strays(place, result.surface, parts, calibrations, agreement.sigma_scan)
        shared = join_shared(agreement.sigma, sigma_placed, sigma_rounded)
        surface = replace(result.surface, sigma_shared=shared, stray_share=strays)
        found = {
            "scan_disagreement_m": agreement.sigma_scan,
            "scan_disagreement_by_incidence_m": agreement.sigma_by_incidence.tolist(),
            "scan_placement_m": float(np.median(sigma_placed)) if sigma_placed.any() else float("nan"),
            **({"rounding_m": float(np.median(sigma_rounded))} if sigma_rounded.any() else {}),
            "scan_patch_m": agreement.patch_size,
            "scan_patches": agreement.n_patches,
            "scan_patches_overlapping": agreement.n_overlapping,
            "stray_share": float("nan") if strays is None else float(np.nanmean(strays)),
        }
        return Made(surface, {**result.automatic, **found}, result.counts)

    asked = Asked("surface", "surface", {"surface": as_mapping(settings.surface)}, (filtered, *parts))
    return once_step(place, asked, make)


def _roundings(place: Place, parts: tuple[Step, ...]) -> list[tuple[float, Floats]]:
    """Return the step [m] of each scan's coordinates, 0 where they are not rounded, and its pose as adjusted."""
    headers = place.project.scan_headers(place.object_id, place.epoch_id)
    motions = place.get(parts[-1])["T_project_given"]
    steps = [float(step.automatic.get("coordinate_step", 0.0)) for step in parts[:-1]]
    return [(step, T @ header.pose) for step, T, header in zip(steps, motions, headers, strict=False)]


def _strays(
    place: Place, surface: Surface, parts: tuple[Step, ...], calibrations: list[Step | None], disagreement: float
) -> Floats | None:
    """Return the share (n,) of what was measured around each vertex that lies off the surface."""
    motions = place.get(parts[-1])["T_project_given"]
    found = [calibration_of(place, step) for step in calibrations]
    return share_of_strays(surface, raw_scans(place, parts[:-1], motions, found, disagreement))


def _assess_quality(place: Place, parts: tuple[Step, ...], surface: Step, notify: Notify) -> Step:
    """Compare the surface with each scan that it came from (step 10; Nothegger & Dorninger 2007, fig. 8)."""

    def make() -> Made:
        """Return the distances (n,) [m] of the points of each scan from the surface, and their figures."""
        notify(f"{place.epoch_id}: checking the surface against its scans")
        clouds = adjusted_clouds(place, parts[:-1], parts[-1])
        names = [scan_product(int(c.scan_index[0])) for c in clouds if c.scan_index is not None]
        distances = distances_to_surface(place.get(surface), clouds)
        arrays = dict(zip(names, distances, strict=True))
        figures = {name: describe_distances(d) for name, d in arrays.items()}
        figures["all"] = describe_distances(np.concatenate(distances))
        return Made(arrays, figures)

    return once_step(place, Asked("quality", "quality", {}, (*parts, surface)), make)


def _adopt_mesh(place: Place, notify: Notify) -> Step:
    """Take a finished mesh, within the extent, as the surface of its epoch, its faces turned outward where some
    look inward.

    Its noise is not stated: how its vertices scatter about their neighbours is mostly relief, by ten times in a coarse
    mesh, and in other places than the noise. The stable areas of a comparison show it.
    """

    def make() -> Made:
        """Return the mesh within the extent, its faces turned outward, with the roughness of its vertices."""
        notify(f"{place.epoch_id}: taking the mesh as the surface")
        cut = cut_to_extent(place.project.get(place.object_id, place.epoch_id, "mesh"), extent)
        wound = wind_outward(cut.surface)
        mesh = wound.surface
        cloud = estimate_normals(PointCloud(points=mesh.vertices))
        found = {"sigma": "not stated; stable areas show it", "looks_inward": wound.looks_inward,
                 "share_outside_extent": cut.share}  # fmt: skip
        n_copied = len(cut.surface.faces) - len(mesh.faces)
        counts = {"vertices": len(mesh.vertices), "faces": len(mesh.faces), "faces_turned": wound.n_turned,
                  **({"faces_copied": n_copied} if n_copied else {}),
                  **({"faces_outside_extent": cut.n_outside} if cut.n_outside else {})}  # fmt: skip
        return Made(replace(mesh, roughness=cloud.roughness), found, counts)

    extent = place.project.object(place.object_id).extent
    asked = Asked("surface", "mesh", {"source": "mesh", "extent": extent}, (latest_step(place, "mesh"),))
    return once_step(place, asked, make)
