"""What lies between two epochs: the motion, as it is stated and as the differences hold it, and a layer all over.

In: the registration of the compared epoch onto the reference. Out: where surfaces and points stand to be compared.
"""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np

from monitor.comparison.distances.scratch import keep_on_disk
from monitor.comparison.regions.beside_layer import peel, peel_points, thickness_of
from monitor.comparison.regions.borne_out import Points
from projects.model import Floats, Registration, Surface
from projects.transforms import apply

SAME = 1e-9  # of a covariance: what is that of the frames but for rounding


@dataclass(frozen=True)
class Between:
    """The motion of the compared epoch onto the reference.

    `stated` says how well it is known against the frames of both epochs, `held` how well what is taken off, or left in
    the differences, is; `left` is the motion, as well as it was fitted, that stays in them, None where it is taken off.
    """

    stated: Registration
    held: Registration
    left: Registration | None

    @property
    def T_reference_compared(self) -> Floats | None:
        """What puts the compared epoch (4, 4) where it is compared, None where it stays as it is."""
        return self.stated.T_target_source if self.left is None else None

    @property
    def T_compared_reference(self) -> Floats:
        """What puts coordinates (4, 4) of the comparison into those of the compared epoch."""
        return np.asarray(np.linalg.inv(self.stated.T_target_source)) if self.left is None else np.eye(4)

    @property
    def layer(self) -> float:
        """The thickness [m] by which the compared surface lies outside of the reference all over; 0 if none does."""
        return thickness_of(self.stated)

    def judged(self, compared: Surface) -> Surface:
        """Return the compared surface as it is judged: without a layer all over."""
        return peel(compared, self.layer) if self.layer else compared

    def judged_points(self, points: Points, compared: Surface) -> Points:
        """Return what returns the points of both epochs as they are judged, in the reference's coordinates; asked for
        at most once and kept on disk."""

        def bring() -> tuple[Floats | None, Floats | None]:
            """Return the points (n, 3) [m] of both epochs, None where they are not known."""
            before, after = points()
            after = peel_points(after, compared, self.layer) if self.layer else after
            T = self.T_reference_compared
            return _kept(before), _kept(after if after is None or T is None else apply(T, after))

        return functools.cache(bring)


def stand_between(registration: Registration, frames: Floats | None, mode: str) -> Between:
    """Return what lies between two epochs; `frames` (6, 6) where control holds both.

    What is left in the differences is as sure as the frames, what is taken off as sure as the shapes tell.
    A motion that the frames alone hold is stated as sure as they are: they are in its covariance once.
    """
    left = registration if mode == "absolute" else None
    if frames is None or np.allclose(registration.covariance, frames, rtol=SAME, atol=0.0):
        return Between(registration, registration, left)
    stated = dataclasses.replace(registration, covariance=registration.covariance + frames)
    held = registration if left is None else dataclasses.replace(registration, covariance=frames)
    return Between(stated, held, left)


def _kept(points: Floats | None) -> Floats | None:
    """Return points, where known, kept on disk."""
    return None if points is None else keep_on_disk(points)
