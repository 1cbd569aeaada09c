"""What the shape does not hold, held by the frame: an extruded staircase can slide along itself, its control cannot.

In: the pairs of the stable areas, the motions that the shape leaves free, and how well the frames of both epochs are
known. Out: the motion whose free part is as the frames say, and its covariance. The part that the shape holds is
measured by the shape alone: a settlement is told against the frame, not drawn towards it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monitor.registration.motion.covariance import about, estimate_covariance, standardize
from monitor.registration.motion.matching import Matches
from projects.model import Floats
from projects.transforms import invert, motion_about, perturb

N_ROUNDS = 3  # a turn and a shift do not add up exactly


@dataclass(frozen=True)
class Frames:
    """How far the frames of two epochs may differ: `covariance` (6, 6) of (w, t) about `centre` (3,), rad and m."""

    covariance: Floats
    centre: Floats

    def shifted(self, shift: Floats) -> Frames:
        """Return the same in coordinates less `shift` (3,) [m]."""
        return Frames(self.covariance, self.centre - shift)

    def about(self, centre: Floats) -> Floats:
        """Return the covariance (6, 6) about another centre."""
        return about(self.covariance, centre - self.centre)


@dataclass(frozen=True)
class FreeMotions:
    """Motions that the shape leaves free, `basis` (6, k), in rad and m about `centre`, orthonormal once rotations are
    lengths at the `lever` [m]; in `words`."""

    basis: Floats
    centre: Floats
    lever: float
    words: str

    @property
    def scale(self) -> Floats:
        """What turns a motion with rotations as lengths into one of rad and m, (6,)."""
        return np.repeat([1.0 / self.lever, 1.0], 3)

    def basis_about(self, centre: Floats) -> Floats:
        """Return the same motions (6, k) about another centre, rad and m."""
        moved = self.basis.copy()
        moved[3:] += np.cross(self.basis[:3].T, centre - self.centre).T
        return moved

    def complement(self, centre: Floats) -> Floats:
        """Return motions (6, 6 - k) about a centre, rad and m, that hold no part of the free ones."""
        free = self.basis_about(centre) / self.scale[:, None]
        full = np.linalg.svd(free, full_matrices=True)[0]
        return full[:, free.shape[1] :] * self.scale[:, None]


def without_free_part(T: Floats, T_frames: Floats, free: FreeMotions) -> Floats:
    """Return T (4, 4) with its free part, counted from `T_frames`, taken off."""
    for _ in range(N_ROUNDS):
        gone = motion_about(T @ invert(T_frames), free.centre)
        part = (free.basis / free.scale[:, None]).T @ (gone / free.scale)
        T = perturb(T, free.centre, -free.basis @ part)
    return T


def held_covariance(
    stable: Matches, sigma: Floats, centre: Floats, free: FreeMotions, frames: Frames, shared: Floats | None = None
) -> Floats:
    """Return the covariance (6, 6) about `centre` of a motion whose free part f is the frames', the rest the shape's.

    With Q the motions that the shape holds, L the free ones and I its information, an error of f moves the rest by
    -(Q' I Q)^-1 Q' I L f; so C = Q C_h Q' + G C_f G' with G = L - Q (Q' I Q)^-1 Q' I L.
    """
    Q, L = free.complement(centre), free.basis_about(centre)
    of_shape = estimate_covariance(stable, sigma, centre, Q, shared)
    information = standardize(stable, sigma, centre, shared).information
    G = L - Q @ np.linalg.solve(Q.T @ information @ Q, Q.T @ information @ L)
    coordinates = np.linalg.pinv(L / free.scale[:, None]) / free.scale
    covariance = of_shape + G @ (coordinates @ frames.about(centre) @ coordinates.T) @ G.T
    return np.asarray(0.5 * (covariance + covariance.T))
