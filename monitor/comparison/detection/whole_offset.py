"""Does all that is held unchanged lie off to one side: a layer nearly everywhere, or instruments that differ?

In: a measured side, what is unchanged of it, its units, how errors agree. Out: the mean and its sigma. What is the same
all over cannot be told from errors that are: no region stands out of it, and it raises the level of detection. A
registration takes a shift off, but no closed shape can be shifted into a smaller one; the mean is left and can be told.
In absolute mode a motion of the whole stays in the differences, and in the mean of them: it is of what a reader sees.
A mesh whose corners lie on a body and whose faces cut through it lies off from one side only, and that is no offset.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monitor.comparison.detection.units import Units
from monitor.comparison.distances.side import Side
from monitor.comparison.noise.correlation import Correlation
from monitor.registration.motion.propagation import motion_variance
from projects.model import Bools, Floats

SURE = 3.0  # sigmas
BACK = 0.5  # of the larger of the means on both surfaces, that the other one's must be at least
TELLING = 0.25  # of the median level of detection: less is no large part of what the level holds
FEWEST = 4.0  # independent parts of the surface, whose scatter tells how sure their mean is


@dataclass(frozen=True)
class WholeOffset:
    """The mean distance [m] of what is unchanged, positive = gained, one `sigma` [m] of it, NaN where it is not known,
    and whether it is told: significant, and a large part of the level of detection. A motion that is left in the
    distances is in their mean."""

    mean: float
    sigma: float
    is_told: bool

    def borne_out(self, back: WholeOffset) -> bool:
        """Return whether it is told, and that of the other surface does not contradict it (`back`, NaN where it is not
        known)."""
        less, more = sorted((abs(self.mean), back.mean * float(np.sign(self.mean))))
        return self.is_told and not less < BACK * more


def measure_offset(side: Side, unchanged: Bools, units: Units, correlation: Correlation, covariance: Floats,
                   level: float) -> WholeOffset:  # fmt: skip
    """Return by how much the unchanged vertices (n,) of a side lie off, weighted by area.

    Parameters
    ----------
    side : measured, as its distances are told.
    covariance : (6, 6) rad and m, of the motion that the distances are measured at: the registration's where that is
        taken off, the frames' where it is left in; about the centre that the units' rows are about.
    level : m, the median level of detection.

    Notes
    -----
    sigma^2 = s^2 / (A / a - 1) + shared^2 + J C J'. s is the scatter of the means of units, A the area of them all, a
    the area over which errors agree. What the scans of both epochs disagree by counts as common to all, as if placed by
    one hand; J is the mean of n' J over the surface, near zero where it is closed.
    """
    number, weights = units.number[unchanged], side.areas[unchanged]
    n_units = len(units.areas)
    areas = np.bincount(number, weights, n_units)
    held = areas > 0.0
    whole = float(areas.sum())
    alike = max(correlation.area, whole / max(int(held.sum()), 1))
    witnesses = whole / alike if whole > 0.0 else 0.0
    if witnesses < FEWEST:
        return WholeOffset(float("nan"), float("nan"), False)
    means = np.bincount(number, weights * side.distances[unchanged], n_units)[held] / areas[held]
    share = areas[held] / whole
    mean = float(share @ means)
    scatter2 = float(share @ (means - mean) ** 2) / (witnesses - 1.0)
    shared = float(weights @ side.sigma_shared[unchanged]) / whole
    motion2 = float(motion_variance(covariance, (share @ units.motion_rows[held])[None])[0])
    sigma = float(np.sqrt(scatter2 + shared**2 + motion2))
    return WholeOffset(mean, sigma, bool(abs(mean) > SURE * sigma and abs(mean) > TELLING * level))
