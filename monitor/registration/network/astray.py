"""Scans that lie off all that they overlap while the others fit each other: given far from where they belong.

In: how the pairs of scans of an epoch fit after their adjustment. Out: which scans that is said of, in words. From so
far off no partner is the right one; robust weights leave such a scan where it is, and its surface stands beside the
true one, where it would be told as change.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from monitor.registration.motion.sides import Side
from monitor.registration.network.overlaps import PairFit
from projects.model import Floats, Ints

TIMES = 10.0  # what the other scans fit to: noise, range and steepness make a scan fit worse by a few times
NOISES = 4.0  # of a point of the scan itself: a far, coarse one fits no better than it measures
FEWEST = 3  # scans: of two that do not fit nothing tells how well scans of this survey do


def find_astray(pairs: Sequence[PairFit], n_scans: int, spacing: float, noise: Floats) -> Ints:
    """Return the scans whose best pair is off by more than the `spacing` [m] of the points, `TIMES` what others fit to
    and `NOISES` of their own `noise` (n,) [m] of a point, 0 where it is not known; what a scan fits to is bias and
    scatter of the pair that fits best."""
    fits = best_fits(pairs, n_scans)
    if np.isfinite(fits).sum() < FEWEST:
        return np.empty(0, dtype=np.int64)
    return np.flatnonzero(fits > np.maximum(max(spacing, TIMES * float(np.nanmedian(fits))), NOISES * noise))


def best_fits(pairs: Sequence[PairFit], n_scans: int) -> Floats:
    """Return what each scan (n,) fits to [m], NaN where it overlaps none after the adjustment."""
    fits = np.full(n_scans, np.nan)
    for pair in pairs:
        misfit = float(np.hypot(pair.bias_after, pair.sigma_after))
        for k in (pair.first, pair.second):
            fits[k] = np.fmin(fits[k], misfit)
    return fits


def noise_of(sides: Sequence[Side]) -> Floats:
    """Return the median noise (n,) [m] that the points of each scan state, 0 where they state none."""
    stated = [np.empty(0) if s.sigma is None else s.sigma for s in sides]
    known = [sigma[np.isfinite(sigma)] for sigma in stated]
    return np.array([float(np.median(sigma)) if len(sigma) else 0.0 for sigma in known])


def say_astray(pairs: Sequence[PairFit], n_scans: int, spacing: float, noise: Floats) -> str:
    """Return which scans are astray in words, "" where none is."""
    fits, astray = best_fits(pairs, n_scans), find_astray(pairs, n_scans, spacing, noise)
    typical = 1e3 * float(np.nanmedian(np.delete(fits, astray))) if len(astray) else 0.0
    return "; ".join(
        f"scan {k + 1} fits none that it overlaps better than to {1e3 * fits[k]:.3g} mm, the others fit to "
        f"{typical:.2g} mm"
        for k in astray
    )
