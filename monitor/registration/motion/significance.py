"""Has the object moved as a whole, and how sure is that? A figure that leans, a stair that settles (`papers/002`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from projects.model import Floats, Registration
from projects.transforms import undone_motion


@dataclass(frozen=True)
class MotionSignificance:
    """The motion of the object from the target's epoch to the source's, about the registration's centre.

    Attributes
    ----------
    translation, sigma_translation : (3,) m, of the centre.
    rotation, sigma_rotation : (3,) rad, rotation vector.
    covariance : (6, 6) of (rotation, translation).
    displacement, angle : m and rad, their lengths.
    chi2 : the motion against its covariance, 6 degrees of freedom.
    probability_unmoved : chance of a chi2 at least this large where nothing moved; small means: it moved.
    is_significant : that probability is below 5 %.
    """

    translation: Floats
    sigma_translation: Floats
    rotation: Floats
    sigma_rotation: Floats
    covariance: Floats
    displacement: float
    angle: float
    chi2: float
    probability_unmoved: float
    is_significant: bool


def motion_significance(registration: Registration) -> MotionSignificance:
    """Return how the object moved between the epochs, with its significance.

    The registration undoes the motion: the object's own motion is its inverse, and its covariance is carried over. It
    is one of the object only where that covariance holds how far the frames of both epochs may
    differ, too. NaN, and not significant, where the registration did not converge.
    """
    undone = undone_motion(registration.T_target_source, registration.covariance, registration.centre)
    motion, covariance = undone.vector, undone.covariance
    rotation, translation = motion[:3], motion[3:]
    statistic = probability = float("nan")
    if registration.converged and np.isfinite(covariance).all():
        statistic = float(motion @ np.linalg.pinv(covariance, rcond=1e-15, hermitian=True) @ motion)
        probability = float(chi2.sf(statistic, 6))
    sigma = np.sqrt(np.diag(covariance))
    return MotionSignificance(
        translation=translation, sigma_translation=sigma[3:], rotation=rotation, sigma_rotation=sigma[:3],
        covariance=covariance,
        displacement=float(np.linalg.norm(translation)), angle=float(np.linalg.norm(rotation)),
        chi2=statistic, probability_unmoved=probability, is_significant=probability < 0.05,
    )  # fmt: skip
