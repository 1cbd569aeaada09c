"""How the object stands against its earlier self as a whole: the inverse of the registration, with its 95 % margins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from projects.model import Floats, Registration
from projects.transforms import apply, invert
from reports.quantities import DEGREES, MM, Estimate, estimate


@dataclass(frozen=True)
class WholeMotion:
    """From the reference epoch to the compared one; metres and radians, one sigma, about the registration's centre."""

    translation: Floats
    sigma_translation: Floats
    rotation: Floats
    sigma_rotation: Floats
    displacement: Estimate
    angle: Estimate


def describe_motion(registration: Registration) -> WholeMotion:
    """Return the motion that the registration undoes; to first order it has the registration's covariance."""
    T_source_target = invert(registration.T_target_source)
    translation = apply(T_source_target, registration.centre) - registration.centre
    rotation = Rotation.from_matrix(T_source_target[:3, :3]).as_rotvec()
    of_rotation, of_translation = registration.covariance[:3, :3], registration.covariance[3:, 3:]
    return WholeMotion(
        translation, np.sqrt(np.diag(of_translation)), rotation, np.sqrt(np.diag(of_rotation)),
        _length(translation, of_translation, MM, "mm"), _length(rotation, of_rotation, DEGREES, "°"),
    )  # fmt: skip


def _length(vector: Floats, covariance: Floats, scale: float, unit: str) -> Estimate:
    """Return the length of a vector with its sigma along it; along its most uncertain axis where it is zero."""
    length = float(np.linalg.norm(vector))
    if not np.isfinite(covariance).all():
        return estimate(length, float("nan"), scale, unit)
    along = vector / length if length > 0.0 else np.linalg.eigh(covariance)[1][:, -1]
    return estimate(length, float(np.sqrt(along @ covariance @ along)), scale, unit)
