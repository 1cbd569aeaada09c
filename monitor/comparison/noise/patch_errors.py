"""How the means of unchanged patches scatter, over what is stated of them: their width, and their tails.

In: standardized means of patches of one size. Out: `PatchErrors`, which give p values. Where the points of both epochs
are known what is told of a region is held against them, and a normal distribution does. Of a finished mesh there are
none, and it was smoothed and triangulated in its own way: along sharp edges two surfaces of an unchanged object, one of
them a mesh, lie a good part of a cell off each other, here and there. Their tails are learned then, of smooth and of
rough places apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, stdtr, stdtrit
from scipy.stats import norm
from scipy.stats import t as student

from projects.model import Floats, Ints

N_KINDS = 2  # of units: smooth, rough
FEWEST_PATCHES = 20  # that a width is learned from
FEWEST_OF_TAILS = 500  # that the tails of a kind are learned from: five of them lie beyond what is asked
FIRST_DOF = 4.0  # of Student's t in the first look
LEAST_DOF = 3.0  # tails heavier than these have hardly a width
NORMAL = 1e9  # degrees of freedom at which Student's t is the normal distribution
HARDLY_T = 1e6  # from which on its p values are those of the normal distribution
UNDECIDED = 1.9  # sigmas, within which no p value decides anything, and Student's t takes thirty times as long
MOST_DOF = 200.0  # hardly another than it
INNER, OUTER = 0.9, 0.99  # shares of the patches within the width, and within where tails show


@dataclass(frozen=True)
class PatchErrors:
    """How the means of calm patches of each kind really scatter: `scales` (`N_KINDS`,) times their sigma, by Student's
    t of `dofs` (`N_KINDS`,) degrees of freedom."""

    scales: Floats
    dofs: Floats

    @property
    def width(self) -> float:
        """The largest of all kinds: one sigma of the normal distribution of which as many (`INNER`) lie within."""
        return float(max(self._reaches(INNER)) / quantile_of(NORMAL, INNER))

    def _reaches(self, share: float) -> Floats:
        """Return within what a share of the means of each kind (`N_KINDS`,) lies, over their sigma."""
        return self.scales * [quantile_of(dof, share) for dof in self.dofs]

    def or_wider(self, other: PatchErrors) -> PatchErrors:
        """Return of each kind the errors, these or the other ones, that reach farther where tails show (`OUTER`)."""
        is_other = other._reaches(OUTER) > self._reaches(OUTER)
        return PatchErrors(np.where(is_other, other.scales, self.scales), np.where(is_other, other.dofs, self.dofs))

    def needed(self, kinds: Ints, dofs: Floats, p: float, power: float) -> Floats:
        """Return how many of its sigmas, known to `dofs` (p,), the mean of patches of these kinds (p,) must lie off
        zero for a p value of `p` where its error is `power` sigmas towards zero."""
        reach = -stdtrit(np.minimum(self.dofs[kinds], dofs), 0.5 * p)
        return np.asarray((reach + power) * self.scales[kinds])

    def p_values(self, z: Floats, kinds: Ints, dofs: Floats) -> Floats:
        """Return two-sided p values (p,) of standardized means of patches of these kinds (p,), whose sigmas are known
        to `dofs` (p,) degrees of freedom; of a normal distribution within `UNDECIDED` sigmas."""
        away, dofs = -np.abs(z) / self.scales[kinds], np.minimum(self.dofs[kinds], dofs)
        p_values, is_t = ndtr(away), (dofs < HARDLY_T) & (away < -UNDECIDED)
        p_values[is_t] = stdtr(dofs[is_t], away[is_t])
        return np.asarray(2.0 * p_values)


def first_errors(z: Floats, _kinds: Ints) -> PatchErrors:
    """Return the scatter of standardized means z (p,) for a first look: width of the median, and a heavy tail.

    Errors of real surfaces have such tails; only what stands out of them is kept from teaching the noise.
    """
    if len(z) < FEWEST_PATCHES:
        return alike(1.0, FIRST_DOF)
    return alike(max(float(np.median(np.abs(z)) / student.ppf(0.75, FIRST_DOF)), 1.0), FIRST_DOF)


def calm_errors(z: Floats, _kinds: Ints) -> PatchErrors:
    """Return the scatter of standardized means z (p,) of patches free of gross change.

    A normal distribution as wide as nine tenths of them ask for (an empirical null, Efron 2004, that looks outwards of
    the middle), and never narrower than what the noise model says.
    """
    if len(z) < FEWEST_PATCHES:
        return alike(1.0, NORMAL)
    return alike(max(float(np.quantile(np.abs(z), INNER)) / quantile_of(NORMAL, INNER), 1.0), NORMAL)


def tailed_errors(z: Floats, kinds: Ints) -> PatchErrors:
    """Return the scatter of standardized means z (p,) of patches free of gross change, with its tails, of each kind.

    Student's t of as many degrees of freedom as what 99 % of them lie within over what 90 % do. Of a kind with too few
    patches all of both kinds tell, and where these are too few there is no tail.
    """
    errors = calm_errors(z, kinds)
    scales, dofs = errors.scales.copy(), errors.dofs.copy()
    for kind in range(N_KINDS):
        own = np.abs(z[kinds == kind])
        telling = own if len(own) >= FEWEST_OF_TAILS else np.abs(z)
        if len(telling) >= FEWEST_OF_TAILS:
            inner, outer = np.quantile(telling, [INNER, OUTER])
            dofs[kind] = dof_of(outer / max(inner, 1e-300))
            scales[kind] = max(inner / quantile_of(dofs[kind], INNER), 1.0)
    return PatchErrors(scales, dofs)


def alike(scale: float, dof: float) -> PatchErrors:
    """Return errors that are the same in all kinds of places."""
    return PatchErrors(np.full(N_KINDS, scale), np.full(N_KINDS, dof))


def dof_of(ratio: float) -> float:
    """Return the degrees of freedom of Student's t of which the `OUTER` share over the `INNER` one is so far out."""

    def excess(dof: float) -> float:
        """Return what the distribution's ratio exceeds the one asked for by."""
        return quantile_of(dof, OUTER) / quantile_of(dof, INNER) - ratio

    if excess(MOST_DOF) >= 0.0:
        return NORMAL
    return LEAST_DOF if excess(LEAST_DOF) <= 0.0 else float(brentq(excess, LEAST_DOF, MOST_DOF))


def quantile_of(dof: float, share: float) -> float:
    """Return within what a share of Student's t lies, on either side of zero."""
    return float(norm.ppf(0.5 + 0.5 * share) if dof >= NORMAL else student.ppf(0.5 + 0.5 * share, dof))
