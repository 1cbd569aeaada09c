"""By how much scans are off that measured too few cells together with all others: coarser ones beside a finer.

In: ranges of k scans over cells, and of which scans it is known by how much they are off; out: what each other one is
off these, by the cells that it shares with them, wherever these lie, and how sure that is.
"""

from __future__ import annotations

import numpy as np

from monitor.filtering.medians import median_known
from monitor.filtering.runs import RUN, without_strangers
from monitor.robust import nmad
from projects.model import Bools, Floats, Ints

FEWEST_RUNS = 30  # of shared cells, one after the other, that tell an offset
CUT = 4.0  # robust sigmas beyond which a run says nothing
N_ROUNDS = 4


def offsets_beside(ranges: Floats, offsets: Floats) -> tuple[Floats, Floats]:
    """Return the offsets (k,) [m] of scans, those given and those found, and the covariance (k, k) of the latter.

    Parameters
    ----------
    ranges : (k, m) m, in the order of neighbours, NaN where a scan has none.
    offsets : (k,) m, NaN where it is not known. Of no scan: that which shares most cells with the others is 0.

    Notes
    -----
    Each run of shared cells tells the median of the differences; an offset is the mean of the runs without outliers,
    its variance from their scatter. Two scans beside one third have the noise of the cells of that in common.
    """
    known = np.isfinite(ranges)
    shared = known.sum(axis=0) >= 2
    if shared.sum() < RUN * FEWEST_RUNS:
        return offsets, np.zeros((len(ranges),) * 2)
    ranges, known = without_strangers(ranges[:, shared]), known[:, shared]
    given = np.isfinite(offsets)
    is_base = given if given.any() else _most_shared(known)
    found, covariance = np.where(given, offsets, np.where(is_base, 0.0, np.nan)), np.zeros((len(ranges),) * 2)
    base = ranges[is_base] - found[is_base, None]
    level = np.nansum(base, axis=0) / np.maximum(np.isfinite(base).sum(axis=0), 1)
    level[~np.isfinite(base).any(axis=0)] = np.nan
    cells: dict[int, Ints] = {}
    for k in np.flatnonzero(~is_base).tolist():
        off = ranges[k] - level
        together = np.flatnonzero(np.isfinite(off))
        if len(together) >= RUN * FEWEST_RUNS:
            cells[k] = together
            found[k], covariance[k, k] = _mean_of_runs(off[together])
    for k, own in cells.items():
        for j in (j for j in cells if j < k and is_base.sum() == 1):
            n_both = np.isin(own, cells[j]).sum()
            both = 0.5 * np.sqrt(covariance[k, k] * covariance[j, j] / (len(own) * len(cells[j]))) * n_both
            covariance[k, j] = covariance[j, k] = both
    return found, covariance


def _most_shared(known: Bools) -> Bools:
    """Return which one of k scans (k,) measured most cells that another has, too; of `known` (k, m) all have two."""
    is_most = np.zeros(len(known), dtype=np.bool_)
    is_most[np.argmax(known.sum(axis=1))] = True
    return is_most


def _mean_of_runs(off: Floats) -> tuple[float, float]:
    """Return the mean [m] of the medians of runs without outliers, and its variance."""
    medians = median_known(off[: len(off) // RUN * RUN].reshape(-1, RUN), axis=1)
    keep = np.ones(len(medians), dtype=np.bool_)
    mean, scale = float(np.median(medians)), 0.0
    for _ in range(N_ROUNDS):
        mean = float(medians[keep].mean())
        scale = max(float(nmad(medians - mean)), 1e-12)
        keep = np.abs(medians - mean) <= CUT * scale
    return mean, scale**2 / int(keep.sum())
