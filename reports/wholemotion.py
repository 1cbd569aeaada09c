"""How the object stands against its earlier self as a whole, and parts of it that moved, with their 95 % margins.

The motion of the whole is the inverse of the registration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from projects.model import Z95, Comparison, Floats, Registration
from projects.transforms import undone_motion
from reports.facts import EpochFacts, Table
from reports.quantities import DEGREES, MM, Estimate, coordinates, estimate


@dataclass(frozen=True)
class WholeMotion:
    """From the reference epoch to the compared one; metres and radians, one sigma, about the registration's centre.
    `is_shifted`: the displacement is more than its margin."""

    translation: Floats
    sigma_translation: Floats
    rotation: Floats
    sigma_rotation: Floats
    displacement: Estimate
    angle: Estimate
    is_shifted: bool


@dataclass(frozen=True)
class PartMotion:
    """How far a part moved against the rest: shifted at its middle, and turned about it; `is_shifted` and `is_turned`
    where that is more than its margin. `regions` are the numbers of those that it explains."""

    centre: Floats
    shift: Estimate
    axes: tuple[Estimate, ...]
    turn: Estimate
    is_shifted: bool
    is_turned: bool
    regions: tuple[int, ...]


def describe_parts(comparison: Comparison) -> list[PartMotion]:
    """Return the parts that moved rigidly, those of most points first."""
    out = []
    for part in comparison.statistics.get("parts") or ():
        motion, covariance = np.asarray(part["motion"]), np.asarray(part["covariance"])
        turn2, shift2 = covariance[:3, :3], covariance[3:, 3:]
        axes = (estimate(float(t), float(s), MM, "", signed=True)
                for t, s in zip(motion[3:], np.sqrt(np.diag(covariance)[3:]), strict=True))  # fmt: skip
        out.append(PartMotion(
            np.asarray(part["centre"]), _length(motion[3:], shift2, MM, "mm"), tuple(axes),
            _length(motion[:3], turn2, DEGREES, "°"), _is_told(motion[3:], shift2), _is_told(motion[:3], turn2),
            tuple(int(r) for r in part["regions"]),
        ))  # fmt: skip
    return out


def describe_motion(registration: Registration) -> WholeMotion:
    """Return the motion that the registration undoes, with the covariance carried over to it."""
    motion = undone_motion(registration.T_target_source, registration.covariance, registration.centre)
    rotation, translation = motion.vector[:3], motion.vector[3:]
    of_rotation, of_translation = motion.covariance[:3, :3], motion.covariance[3:, 3:]
    return WholeMotion(
        translation, np.sqrt(np.diag(of_translation)), rotation, np.sqrt(np.diag(of_rotation)),
        _length(translation, of_translation, MM, "mm"), _length(rotation, of_rotation, DEGREES, "°"),
        _is_told(translation, of_translation),
    )  # fmt: skip


def knows_motion(comparison: Comparison) -> bool:
    """Return whether it is known how surely the object moved: only with how well the coordinates of both epochs agree,
    which control points in both tell; else the coordinates differ, and the margins are those of the fit alone."""
    return bool(np.isfinite(comparison.statistics.get("motion_significance", np.nan)))


def _length(vector: Floats, covariance: Floats, scale: float, unit: str) -> Estimate:
    """Return the length of a vector with its sigma along it."""
    return estimate(float(np.linalg.norm(vector)), sigma_along(vector, covariance), scale, unit)


def sigma_along(vector: Floats, covariance: Floats) -> float:
    """Return one sigma of a vector along itself; along its most uncertain axis where it is zero."""
    length = float(np.linalg.norm(vector))
    if not np.isfinite(covariance).all():
        return float("nan")
    along = vector / length if length > 0.0 else np.linalg.eigh(covariance)[1][:, -1]
    return float(np.sqrt(along @ covariance @ along))


def _is_told(vector: Floats, covariance: Floats) -> bool:
    """Return whether a vector is longer than its margin."""
    return bool(np.linalg.norm(vector) > Z95 * sigma_along(vector, covariance))


def object_size(comparison: Comparison) -> float:
    """Return the longest side [m] of the reference surface's box: what places are told to a share of."""
    return float(np.ptp(comparison.on_reference.surface.vertices, axis=0).max(initial=0.0))


def parts_table(comparison: Comparison, first: EpochFacts, second: EpochFacts) -> Table | None:
    """Return the table of the parts that moved rigidly, None where there are none."""
    rows = []
    for number, part in enumerate(describe_parts(comparison), start=1):
        where = coordinates(part.centre, object_size(comparison) / 100.0)
        rows.append((f"Part {number}", where, part.shift.text, *(axis.text for axis in part.axes), part.turn.text,
                     ", ".join(map(str, part.regions)) or "–"))  # fmt: skip
    if not rows:
        return None
    return Table(
        "Parts that moved", ("", "where: x, y, z (m)", "shift", "x (mm)", "y (mm)", "z (mm)", "turn", "regions"),
        tuple(rows), f"Each moved rigidly against the rest of the object, from the {first.order} to the {second.order} "
        "epoch: shifted at its middle, and turned about it. ± is the half-width of the 95\u00a0% interval.",
    )  # fmt: skip
