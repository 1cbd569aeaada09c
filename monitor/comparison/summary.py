"""The figures of a comparison as a whole: how well the epochs agree where they should, and what was not seen."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from monitor.comparison.detection.tested import Detected
from monitor.comparison.detection.whole_offset import measure_offset
from monitor.comparison.distances.connected import connect_like
from monitor.comparison.distances.quantile import median
from monitor.comparison.distances.side import Side
from monitor.comparison.noise.scan_errors import ScanErrors
from monitor.comparison.regions.evidence import Sights, knows_beams
from monitor.registration.motion.significance import motion_significance
from monitor.robust import MAD_TO_SIGMA
from projects.model import Assessment, Bools, ComparedSurface, Floats, Ints, NotAssessed, Registration


def summarize(on_both: tuple[ComparedSurface, ComparedSurface], sides: tuple[Side, Side], found: Detected,
              registration: Registration, tolerance: float | None, *, held: Floats,
              knows_frames: bool) -> dict[str, Any]:  # fmt: skip
    """Return the statistics of `Comparison`, over the vertices of the compared surface; lengths in metres.

    Bias, NMAD and RMSE are of the unchanged vertices; shares are of the assessable ones, by vertices above their level
    of detection, by area beyond the tolerance: of all that differs so much, and of what of it is called changed. What
    could be assessed is told of the area of both surfaces less their fringes. `held` (6, 6) is the covariance of the
    motion that the differences are measured at; `knows_frames`: that of `registration` holds how far the frames of both
    epochs may differ.
    """
    on_compared, side = on_both[1], sides[1]
    state, areas = on_compared.assessment, side.areas
    differences = _figures_of_differences(on_compared)
    back, offset = (measure_offset(s, told.assessment == Assessment.UNCHANGED, units, found.noise.correlation, held,
                                   differences["lod95_median_m"])
                    for s, told, units in zip(sides, on_both, found.test.units, strict=True))  # fmt: skip
    return {
        "stable_share": float(registration.stable_share),
        **differences,
        **tell_motion(registration, knows_frames),
        "offset_m": offset.mean,
        "sigma_offset_m": offset.sigma,
        "offset_is_told": offset.borne_out(back) and not math.isfinite(registration.scale),  # it is of the scale
        "assessed_area_share": _share_of_area(side.measured_areas, state != Assessment.NOT_ASSESSABLE),
        "assessed_area_share_reference": _share_of_area(sides[0].measured_areas, sides[0].is_assessed),
        "changed_area_m2": float(areas[state == Assessment.CHANGED].sum()),
        "not_assessed": count_reasons(on_compared.reasons[state == Assessment.NOT_ASSESSABLE]),
        **_figures_of_noise(side, found),
        **_shares_beyond(tolerance, on_compared, areas),
    }


def _figures_of_differences(told: ComparedSurface) -> dict[str, Any]:
    """Return what the distances of a compared surface come to: of the unchanged vertices, and how many are what."""
    state, assessed = told.assessment, told.reasons == NotAssessed.ASSESSED
    calm, lod = told.distances[state == Assessment.UNCHANGED], told.lod95[assessed]
    return {
        "bias_m": _or_nan(np.mean, calm),
        "nmad_m": _or_nan(_nmad, calm),
        "rmse_m": _or_nan(lambda v: np.sqrt(np.mean(v**2)), calm),
        "lod95_median_m": _or_nan(median, lod),
        "n_vertices": len(state),
        "n_not_assessable": int((state == Assessment.NOT_ASSESSABLE).sum()),
        "n_unchanged": int((state == Assessment.UNCHANGED).sum()),
        "n_changed": int((state == Assessment.CHANGED).sum()),
        "share_above_lod95": _or_nan(np.mean, np.abs(told.distances[assessed]) > lod),
    }


def _figures_of_noise(side: Side, found: Detected) -> dict[str, Any]:
    """Return what was learned of the errors, of a side as a whole, and of the patches that were tested."""
    noise, states_noise = found.noise, side.states_noise
    return {
        "floor_m": float(np.median(noise.floor_of(side))),
        "error_scale": float(np.median(noise.scale_of(side))) if states_noise else float("nan"),
        "error_share_discord": float(np.median(noise.discord_share_of(side))) if states_noise else float("nan"),
        "error_scale_shared": float(np.median(noise.shared_scale_of(side))) if _is_shared(side) else float("nan"),
        **_scales_of_scans(side, found.test.scans),
        **{f"error_scales_{kind}": scales for kind, scales in noise.scales_by_class(side).items()},
        "correlation_length_m": noise.correlation.length,
        "correlation_stretches": noise.stretch.factors.tolist(),
        "correlation_stretch_sigmas_m": noise.stretch.sigmas.tolist(),
        "unit_size_m": found.test.size,
        "n_patches": found.test.n_tested,
        "patch_error_scales": [e.width for e in found.test.errors],
    }


def _shares_beyond(tolerance: float | None, told: ComparedSurface, areas: Floats) -> dict[str, float]:
    """Return a client's tolerance [m] and which shares of the assessed area differ by more, and are changed too; empty
    where none is given."""
    if tolerance is None:
        return {}
    assessed = told.reasons == NotAssessed.ASSESSED
    is_beyond = np.abs(told.distances[assessed]) > tolerance
    is_changed = told.assessment[assessed] == Assessment.CHANGED
    return {
        "tolerance_m": float(tolerance),
        "share_beyond_tolerance": _share_of_area(areas[assessed], is_beyond),
        "share_changed_beyond_tolerance": _share_of_area(areas[assessed], is_beyond & is_changed),
    }


def tell_motion(registration: Registration, knows_frames: bool) -> dict[str, Any]:
    """Return by how much [m, rad] the coordinates of both epochs put the object elsewhere, and how surely it moved.

    The latter is known only where it is known how far the frames of both epochs may differ (`knows_frames`), else NaN
    and None: by the covariance of the fit alone any difference of the frames would be a sure motion.
    """
    motion = motion_significance(registration)
    significance = float(1.0 - motion.probability_unmoved) if knows_frames else float("nan")
    return {
        "motion_significance": significance,
        "motion_displacement_m": motion.displacement,
        "motion_angle_rad": motion.angle,
        "motion_is_significant": bool(motion.is_significant) if math.isfinite(significance) else None,
    }


def area_figures(told: tuple[ComparedSurface, ComparedSurface], sides: tuple[Side, Side], sights: Sights | None,
                 size: float) -> dict[str, list[Any]]:  # fmt: skip
    """Return which areas [m2] of the reference and of the compared surface are in which state, and which met nothing,
    in places no smaller than a square of `size` [m]."""
    return {
        "areas_by_assessment_m2": [areas_by_assessment(*of) for of in zip(told, sides, strict=True)],
        "met_nothing_area_m2": areas_met_nothing(told, sides, sights, size),
    }


def areas_by_assessment(told: ComparedSurface, side: Side) -> dict[str, float]:
    """Return which area [m2] of a side, less its fringe, is unchanged, changed and not assessable for each reason."""
    areas, state = side.measured_areas, told.assessment
    unknown = state == Assessment.NOT_ASSESSABLE
    masks = {"unchanged": state == Assessment.UNCHANGED, "changed": state == Assessment.CHANGED}
    masks |= {r.name.lower(): unknown & (told.reasons == r) for r in NotAssessed if r}
    return {name: float(areas[mask].sum()) for name, mask in masks.items()}


def areas_met_nothing(told: tuple[ComparedSurface, ComparedSurface], sides: tuple[Side, Side], sights: Sights | None,
                      size: float) -> list[float]:  # fmt: skip
    """Return of the reference and of the compared surface which area [m2] the other epoch's scans hold nothing of, NaN
    where none of its stations knows where its beams went."""
    return [area_met_nothing(told[k], sides[k], size) if knows_beams(sights, 1 - k) else float("nan") for k in range(2)]


def area_met_nothing(told: ComparedSurface, side: Side, size: float) -> float:
    """Return the area [m2] of a side, in connected places no smaller than a square of `size` [m], in the direction of
    which the other epoch's scans hold nothing."""
    is_empty = (told.assessment == Assessment.NOT_ASSESSABLE) & (told.reasons == NotAssessed.MET_NOTHING)
    if not is_empty.any():
        return 0.0
    place = connect_like(np.where(is_empty, 0, -1), [side.neighbours])
    areas = np.bincount(place[is_empty], side.measured_areas[is_empty], minlength=1)
    return float(areas[areas >= size**2].sum())


def _share_of_area(areas: Floats, which: Bools) -> float:
    """Return the share of the area at the vertices (n,) of a mask, NaN without any area."""
    whole = float(areas.sum())
    return float(areas[which].sum()) / whole if whole > 0.0 else float("nan")


def _is_shared(side: Side) -> bool:
    """Return whether anything is stated of what the scans disagree by."""
    return bool(side.sigma_shared.any())


def _scales_of_scans(side: Side, scans: ScanErrors) -> dict[str, list[float]]:
    """Return the scales of what scans are stated to disagree by, and from how much [m] stated on each holds, as far as
    so much is stated anywhere."""
    most = float(side.sigma_shared[side.is_assessed].max(initial=0.0))
    is_used = (scans.steps <= most) & (most > 0.0)
    return {"error_scales_scans": scans.scales[is_used].tolist(), "error_steps_scans_m": scans.steps[is_used].tolist()}


def count_reasons(reasons: Ints) -> dict[str, int]:
    """Return how many vertices are not assessable for each reason."""
    return {r.name.lower(): int((reasons == r).sum()) for r in NotAssessed if r}


def _nmad(values: Floats) -> float:
    """Return 1.4826 times the median distance from the median."""
    away = values - median(values)
    return MAD_TO_SIGMA * median(np.abs(away, out=away))


def _or_nan(figure: Any, values: np.ndarray) -> float:
    """Return the figure of the values, NaN where there are none."""
    return float(figure(values)) if len(values) else float("nan")
