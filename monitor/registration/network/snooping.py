"""Blunders among targets and control points, and the variance components of both.

In: a solution of the network. Out: how each observation fits; which one, if any, contradicts the rest (Baarda 1968,
data snooping); by how much the stated variances are too small (from medians, which blunders do not reach).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from monitor.registration.network.equations import Solution, TieScales, tie_statistics, uncontrolled
from monitor.registration.network.ties import Ties
from projects.model import Floats

ALARM = 0.001  # chance, over all observations together, that a right one is called a blunder
MEDIAN = float(chi2.median(3))
BELIEVED = 4.0  # observations that the stated variances count as
MOST_BLUNDERS = 0.34  # of all observations


@dataclass(frozen=True)
class TieFit:
    """How one target of a scan, or one control point, fits.

    Attributes
    ----------
    name : of the point; scan : which scan saw it, -1 for the control point itself.
    residual : (3,) m, observed less adjusted, in the project's frame.
    statistic : v' Q_vv^-1 v, chi2 of 3 for a right one; NaN for one that was left out.
    redundancy : share of it, 0 to 1, that other observations check.
    is_blunder : left out of the adjustment; is_control : a control point or a target that is one.
    """

    name: str
    scan: int
    residual: Floats
    statistic: float
    redundancy: float
    is_blunder: bool
    is_control: bool


def estimate_components(solution: Solution, present: TieScales) -> TieScales:
    """Return by how much the variances of targets and of control are raised, never below what is stated.

    The median of v' Q_vv^-1 v of right observations is that of a chi2; the stated variances count as four of them.
    """
    statistics, redundancy = tie_statistics(solution)
    checked = ~uncontrolled(redundancy)
    is_tie = np.arange(len(statistics)) < solution.equations.n_ties
    targets = _factor(statistics[checked & is_tie], present.targets)
    return TieScales(targets, _factor(statistics[checked & ~is_tie], present.control))


def _factor(statistics: Floats, present: float) -> float:
    """Return the factor of a variance, given v' Q_vv^-1 v under the present one."""
    n = len(statistics)
    if not n:
        return present
    seen = float(np.median(statistics)) / MEDIAN
    return max(present * (n * seen + BELIEVED / present) / (n + BELIEVED), 1.0)


def find_blunder(solution: Solution, ties: Ties) -> Ties | None:
    """Return the ties without the one that contradicts the rest most, None where none does."""
    statistics, redundancy = tie_statistics(solution)
    if not len(statistics):
        return None
    n_out = int((~ties.kept).sum() + (~ties.control_kept).sum())
    worst = int(np.argmax(np.where(uncontrolled(redundancy), 0.0, statistics)))
    if statistics[worst] <= chi2.isf(ALARM / len(statistics), 3) or n_out >= MOST_BLUNDERS * len(statistics):
        return None
    index = int(solution.equations.index[worst])
    if worst < solution.equations.n_ties:
        return replace(ties, kept=_without(ties.kept, index))
    return replace(ties, control_kept=_without(ties.control_kept, index))


def _without(kept: np.ndarray, index: int) -> np.ndarray:
    less = kept.copy()
    less[index] = False
    return less


def describe_ties(solution: Solution, ties: Ties, given: Ties) -> tuple[TieFit, ...]:
    """Return how every target and control point fits, blunders among them, targets first."""
    if not len(given):
        return ()
    statistics, redundancy = tie_statistics(solution)
    equations, fits = solution.equations, []
    for r, k in enumerate(equations.index.tolist()):
        is_tie = r < equations.n_ties
        point, scan = (int(ties.point[k]), int(ties.scan[k])) if is_tie else (k, -1)
        known = bool(np.isfinite(ties.control[point, 0]))
        residual = equations.misclosures[r] if is_tie else -equations.misclosures[r]
        fits.append(TieFit(ties.names[point], scan, residual, float(statistics[r]), float(redundancy[r]), False, known))
    for k in np.flatnonzero(~ties.kept):
        known = bool(np.isfinite(ties.control[ties.point[k], 0]))
        fits.append(
            TieFit(ties.names[ties.point[k]], int(ties.scan[k]), np.full(3, np.nan), np.nan, np.nan, True, known)
        )
    for k in np.flatnonzero(~ties.control_kept):
        fits.append(TieFit(ties.names[k], -1, np.full(3, np.nan), np.nan, np.nan, True, True))
    return tuple(fits)
