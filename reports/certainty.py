"""How sure: the motion and its margins, the level of detection, what could not be assessed, how well scans agree.

In: a comparison and the steps of both epochs. Out: tables of texts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from projects.model import Assessment, Comparison, Step
from projects.triangles import rest_on_nothing, vertex_areas
from reports.answer import (
    AGREEMENT_UNKNOWN,
    NOT_ASSESSABLE,
    WHY_NOT,
    print_significance,
    shares_by_assessment,
)
from reports.control import control_table
from reports.facts import EpochFacts, Table
from reports.quantities import DEGREES, MM, NAN, NOT_KNOWN, coordinates, count, estimate, millimetres, percent
from reports.smallest import is_beside_layer, level_beside, told_by_width, tolerance_in_words
from reports.wholemotion import describe_motion, knows_motion, object_size

NOTE_OF_VERTICES = "Of the vertices of each."
ROUNDING = 1e-9  # of shares that add up to one


def state_certainty(
    comparison: Comparison, steps: Mapping[str, Sequence[Step]], false_discovery_rate: float,
    epochs: tuple[EpochFacts, EpochFacts],
) -> tuple[Table, ...]:  # fmt: skip
    """Return the tables of the section "How sure"; `steps` by the epoch's name as it heads a column, `epochs` the
    reference and the compared."""
    tables = [
        registration_table(comparison),
        motion_table(comparison, *epochs),
        detection_table(comparison, false_discovery_rate),
        not_assessed_table(comparison, *epochs),
        agreement_table(steps),
        control_table(steps),
    ]
    return tuple(t for t in tables if t.rows)


def registration_table(comparison: Comparison) -> Table:
    """Return how well the two epochs were brought onto each other."""
    registration, statistics = comparison.registration, comparison.statistics
    motion, known = describe_motion(registration), knows_motion(comparison)
    sure = print_significance(statistics["motion_significance"]) if known else f"{NOT_ASSESSABLE}: {AGREEMENT_UNKNOWN}"
    what = "Object as a whole displaced by" if known else "Coordinates of the object differ by"
    rows: tuple[tuple[str, str], ...] = (
        (what, motion.displacement.text),
        ("turned by", motion.angle.text),
        ("confidence that it moved (1 − p)", sure),
        (
            "in the differences",
            "taken out (relative mode)" if comparison.mode == "relative" else "kept (absolute mode)",
        ),
        ("of the surface matched, held to be stable", percent(registration.stable_share)),
        ("overlap of the epochs", percent(registration.overlap)),
        ("correspondences used", f"{count(registration.n_inliers)} of {count(registration.n_correspondences)}"),
        ("scatter of the stable surface (one sigma)", millimetres(registration.sigma)),
    )
    if np.isfinite(registration.layer):
        layer = estimate(registration.layer, registration.sigma_layer, MM, "mm", signed=True).text
        rows = (*rows, ("beside it the whole surface lies further out (+) or in (−) by", layer))
    if registration.held_by_frames:
        rows = (*rows, ("known by the control points alone, not by the shape", registration.held_by_frames))
    if registration.doubt:
        rows = (*rows, ("doubt about this motion", registration.doubt))
    of_fit = "" if known else ", of the fit of the two surfaces alone"
    note = f"± is the half-width of the 95\u00a0% interval{of_fit}."
    return Table("Registration of the epochs", ("", ""), rows, note)


def motion_table(comparison: Comparison, first: EpochFacts, second: EpochFacts) -> Table:
    """Return the motion, or by how much coordinates differ, axis by axis, with margins from the covariance."""
    motion = describe_motion(comparison.registration)
    rows = []
    for axis, t, st, r, sr in zip("xyz", motion.translation, motion.sigma_translation, motion.rotation,
                                  motion.sigma_rotation, strict=True):  # fmt: skip
        shift = estimate(float(t), float(st), MM, "", signed=True).text
        rows.append((axis, shift, estimate(float(r), float(sr), DEGREES, "", signed=True).text))
    where = coordinates(comparison.registration.centre, object_size(comparison) / 1000.0)
    title, doubt = "The motion, axis by axis", ""
    if not knows_motion(comparison):
        title = "By how much the coordinates differ, axis by axis"
        doubt = f" As a motion this is {NOT_ASSESSABLE}: {AGREEMENT_UNKNOWN}."
    return Table(
        title, ("axis", "shift (mm)", "turn (°)"), tuple(rows),
        f"From the {first.order} to the {second.order} epoch, about the point {where} m in the coordinates of the "
        f"{first.order} epoch.{doubt}",
    )  # fmt: skip


def _offset(statistics: Mapping[str, Any]) -> str:
    """Return by how much the unchanged surface lies off on average, with its margin."""
    mean, sigma = (float(statistics.get(name, NAN)) for name in ("offset_m", "sigma_offset_m"))
    return estimate(mean, sigma, MM, "mm", signed=True).text


def detection_table(comparison: Comparison, false_discovery_rate: float) -> Table:
    """Return what change can be seen, and how well unchanged surface agrees."""
    statistics = comparison.statistics
    levels = comparison.on_compared.lod95[comparison.on_compared.assessment != Assessment.NOT_ASSESSABLE]
    levels = levels[np.isfinite(levels)]
    low, high = np.quantile(levels, [0.05, 0.95]) if len(levels) else (NAN, NAN)
    words = "of what stands out of the rest, which lies off all over"
    beside = ((words, level_beside(comparison)),) if is_beside_layer(comparison) else ()
    against = " against the rest" if beside else ""
    rows = [
        *[
            (f"A change {millimetres(w)} wide is told{against} from about (19 of 20 such, median)", millimetres(d))
            for w, d in told_by_width(comparison)
        ],
        ("Level of detection of single places (95\u00a0%), median", millimetres(statistics.get("lod95_median_m", NAN))),
        ("nine tenths of these between", f"{millimetres(float(low))} and {millimetres(float(high))}"),
        *beside,
        *_coarse_rows(statistics),
        ("mean difference where nothing changed (bias)", millimetres(statistics.get("bias_m", NAN), signed=True)),
        ("the same by area", _offset(statistics)),
        ("scatter there (robust sigma, NMAD)", millimetres(statistics.get("nmad_m", NAN))),
        ("root mean square there", millimetres(statistics.get("rmse_m", NAN))),
        (
            "single vertices beyond their own limit, changed ones included",
            percent(statistics.get("share_above_lod95", NAN)),
        ),
    ]
    rows += _error_rows(statistics)
    if "tolerance_m" in statistics:
        rows.append(("the client’s tolerance", tolerance_in_words(statistics["tolerance_m"])))
        differs, changed = (statistics.get(f"share_{n}beyond_tolerance", NAN) for n in ("", "changed_"))
        rows.append(("assessed surface that differs by more, by errors or by change", percent(differs)))
        rows += (
            [("assessed surface that changed by more (significant)", percent(changed))]
            if math.isfinite(changed)
            else []
        )
    note = (
        "Where nothing changed, about 5\u00a0% of single vertices lie beyond their own limit by chance; they are not "
        "called changed. Changed is only what hangs together as a region, is no smaller than the area over which "
        "errors agree, or deeper than any error in both epochs, and is significant as a whole, with the share of false "
        f"discoveries held at {100.0 * false_discovery_rate:g}\u00a0% over the whole surface, and with what the "
        "surfaces are unsure of where the points do not tell the shape."
    )
    return Table("What can be seen", ("", ""), tuple(rows), note)


def _error_rows(statistics: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return how large stable areas show the errors to be that the surfaces state, and over what these agree."""
    rows = []
    if np.isfinite(statistics.get("error_scale", NAN)):  # not where a surface states none
        rows.append(("of the errors that both surfaces state, stable areas show", percent(statistics["error_scale"])))
    if np.isfinite(statistics.get("error_share_discord", NAN)):
        words = "of what neighbouring places of a surface contradict each other by"
        rows.append((words, percent(statistics["error_share_discord"])))
    if np.isfinite(statistics.get("error_scale_shared", NAN)):
        rows.append(("of what the scans of an epoch disagree by", percent(statistics["error_scale_shared"])))
    if statistics.get("error_scales_scans"):
        most_places, beyond = (percent(statistics["error_scales_scans"][k]) for k in (0, -1))
        step = millimetres(statistics["error_steps_scans_m"][-1])
        words = most_places if most_places == beyond else f"{most_places}, and {beyond} of what is beyond {step}"
        rows.append(("of the same, counted in the mean of patches and regions", words))
    if "correlation_length_m" in statistics:
        rows.append(("errors of neighbours agree over", millimetres(statistics["correlation_length_m"])))
    return rows


def _coarse_rows(statistics: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return how much of the surface tells only large changes, as far as it is known."""
    share, least, most = (statistics.get(f"coarse_{name}", NAN) for name in ("area_share", "from_m", "told_from_m"))
    if not np.isfinite(share):
        return []
    rows = [(f"assessed surface that tells only changes above {millimetres(least)} (dotted)", percent(share))]
    return [*rows, ("on 95\u00a0% of that, changes are told above", millimetres(most))] if np.isfinite(most) else rows


def not_assessed_table(comparison: Comparison, first: EpochFacts, second: EpochFacts) -> Table:
    """Return how much of both surfaces was assessed, and why the rest was not."""
    words = {"unchanged": "Assessed, unchanged", "changed": "Assessed, changed"}
    words |= {reason.name.lower(): f"Not assessable: {why}" for reason, why in WHY_NOT.items()}
    shares = [shares_by_assessment(comparison, k) for k in range(2)]
    rows = [(words[name], *(percent(share.get(name, NAN)) for share in shares)) for name in words
            if name in ("unchanged", "changed") or any(share.get(name, 0.0) > 0.0 for share in shares)]  # fmt: skip
    other = [1.0 - sum(share.values()) for share in shares]
    if max(other) > ROUNDING:
        rows.append(("Not assessable: reason not recorded", *(percent(max(share, 0.0)) for share in other)))
    by_area = "areas_by_assessment_m2" in comparison.statistics
    closed = " and what closes its holes" if is_closed_over(comparison) else ""
    note = f"Of the area of each surface, less its edge beyond its points{closed}." if by_area else NOTE_OF_VERTICES
    return Table("What could be assessed", ("", f"{first.order} surface", f"{second.order} surface"), tuple(rows), note)


def is_closed_over(comparison: Comparison) -> bool:
    """Return whether faces that nobody measured close holes of either surface."""
    sides = (comparison.on_reference.surface, comparison.on_compared.surface)
    return any(s.face_invented is not None and bool(s.face_invented.any()) for s in sides)


def share_of_edge(comparison: Comparison) -> float:
    """Return the larger share of the area of either surface that lies beyond its points, and is in no share of what
    could be assessed; what closes holes is none of it. NaN where that is not known: shares are of vertices then."""
    areas = comparison.statistics.get("areas_by_assessment_m2")
    if areas is None:
        return NAN
    shares = []
    for k, side in enumerate((comparison.on_reference, comparison.on_compared)):
        is_measured = ~rest_on_nothing(side.surface)
        whole = float(vertex_areas(side.surface.vertices, side.surface.faces)[is_measured].sum())
        shares.append(1.0 - sum(areas[k].values()) / max(whole, 1e-300))
    return max(shares)


def agreement_table(steps: Mapping[str, Sequence[Step]]) -> Table:
    """Return how well the scans of each epoch agree with each other, and its surface with them."""
    found = [{step.product: step.automatic for step in of_epoch} for of_epoch in steps.values()]
    fitted = [_figures(f, "quality", "all") for f in found]
    rows: tuple[tuple[str, ...], ...] = (
        ("Coordinates in the files rounded to", *(_length(_rounding(f), "step") for f in found)),
        ("Scans against each other before adjustment", *_lengths(found, "network", "misfit_before_m")),
        ("after adjustment", *(_adjusted(f.get("network", {})) for f in found)),
        ("Disagreement left between scans (one sigma)", *map(_disagreement, found)),
        ("Placement of the scans by the adjustment (one sigma)", *_lengths(found, "surface", "scan_placement_m")),
        ("Surface against its scans: mean", *(_length(f, "bias_m", signed=True) for f in fitted)),
        ("scatter (robust sigma, NMAD)", *(_length(f, "nmad_m") for f in fitted)),
        ("95\u00a0% of the points within", *(_length(f, "p95_m") for f in fitted)),
        ("points without surface", *(percent(float(f.get("unknown_share", NAN))) for f in fitted)),
        ("Area between the points without surface", *(_share(f, "surface", "uncovered_share") for f in found)),
    )
    doubts = [str(f.get("network", {}).get("doubt", "")) for f in found]
    if any(doubts):
        rows = (
            *rows,
            ("doubt about the poses of scans, which only those as given tell", *(d or "none" for d in doubts)),
        )
    known = tuple(row for row in rows if set(row[1:]) != {NOT_KNOWN})  # a finished mesh has no scans
    return Table("The scans of each epoch", ("", *steps), known)


def _rounding(found: Mapping[str, Mapping[str, Any]]) -> Mapping[str, Any]:
    """Return the coarsest `step` [m] of the coordinates of an epoch's scans, nothing where they are not rounded."""
    steps = [float(values["coordinate_step"]) for values in found.values() if "coordinate_step" in values]
    return {"step": max(steps)} if steps else {}


def _disagreement(found: Mapping[str, Mapping[str, Any]]) -> str:
    """Return what the scans of an epoch disagree by; what is left of it is estimated beside their noise, and never
    below 0."""
    figures = found.get("surface", {})
    return "none found" if figures.get("scan_disagreement_m") == 0.0 else _length(figures, "scan_disagreement_m")


def _adjusted(network: Mapping[str, Any]) -> str:
    """Return what the adjustment left, or that the scans stayed where they were."""
    return "poses kept as given" if network.get("applied") is False else _length(network, "misfit_after_m")


def _figures(found: Mapping[str, Mapping[str, Any]], product: str, name: str) -> Mapping[str, Any]:
    """Return a group of figures of a product, empty where there is none."""
    return found.get(product, {}).get(name) or {}


def _share(found: Mapping[str, Mapping[str, Any]], product: str, name: str) -> str:
    """Return a recorded share in per cent."""
    return percent(float(found.get(product, {}).get(name, NAN)))


def _lengths(found: list[dict[str, Mapping[str, Any]]], product: str, name: str) -> tuple[str, ...]:
    """Return a recorded length of each epoch."""
    return tuple(_length(f.get(product, {}), name) for f in found)


def _length(figures: Mapping[str, Any], name: str, *, signed: bool = False) -> str:
    """Return a recorded length in millimetres, a dash where it is not known."""
    value = figures.get(name)
    return millimetres(NAN if value is None else float(value), signed=signed)
