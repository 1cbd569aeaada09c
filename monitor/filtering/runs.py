"""Runs of neighbouring cells of repeated scans: how each scan differs from their mean there, and how that slopes.

In: ranges of k scans over cells in the order of neighbours, NaN where a scan has none; out: `Runs`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monitor.filtering.medians import median_known
from monitor.robust import MAD_TO_SIGMA
from projects.model import Bools, Floats, Ints

RUN = 16  # neighbouring cells to which a plane is fitted: slope of the range over both angles
MOST_RUNS = 20_000
FEWEST_CELLS = RUN // 2  # of a run that a scan must have measured
TOO_ROUGH = 3.0  # times the noise of the mean: a run over a jump or a crest has no slope
LARGEST = 0.05  # m: no instrument drifts by more from one scan to the next, nor does a tripod give way
STRANGE = 10.0  # robust sigmas of what a scan differs from the others by: farther, something else stood there
N_LEVELLED = 4  # rounds of bringing scans to one level
FINEST = 1e-5  # m: what scans may differ by, however little most of them do


@dataclass(frozen=True)
class Runs:
    """Runs of neighbouring cells: excess (k, r) over the mean range, its slopes (r, 2) and their covariance.

    The excess is NaN where a scan has measured less than half of a run.
    """

    excess: Floats
    slopes: Floats
    slope_covariance: Floats
    is_smooth: Bools

    def n_known(self) -> Ints:
        """Return how many runs (k,) each scan has measured."""
        return np.isfinite(self.excess).sum(axis=1)

    def take(self, keep: Bools) -> Runs:
        """Return some of the runs."""
        return Runs(self.excess[:, keep], self.slopes[keep], self.slope_covariance[keep], self.is_smooth[keep])


def choose_cells(n_cells: int) -> Ints:
    """Return the cells of at most `MOST_RUNS` whole runs, evenly spread."""
    n_runs = n_cells // RUN
    chosen = np.arange(n_runs)
    if n_runs > MOST_RUNS:
        chosen = np.unique(np.linspace(0, n_runs - 1, MOST_RUNS).astype(np.int64))
    return np.asarray((chosen[:, None] * RUN + np.arange(RUN)).ravel())


def without_strangers(ranges: Floats) -> Floats:
    """Return ranges (k, m) with NaN for those of something that stood there in one scan, and where one scan measured.

    Most of what a scan differs by from the median of all tells how far it may lie off; of two scans that differ by more
    neither tells anything. Scans are brought to one level first: of three of which one lies off, the median is always
    the nearer of the others, which then seem to have hardly any noise.
    """
    level, off = np.zeros((len(ranges), 1)), ranges
    for _ in range(N_LEVELLED):
        near = np.where(np.isfinite(off), ranges, np.nan) - level
        off = near - median_known(near, axis=0)
        with np.errstate(invalid="ignore"):
            off[(np.isfinite(near).sum(axis=0) < 2) | (np.abs(off) > LARGEST)] = np.nan
        shift = np.nan_to_num(median_known(off, axis=1))[:, None]
        level, off = level + shift, off - shift
    scale = np.maximum(MAD_TO_SIGMA * median_known(np.abs(off), axis=1), FINEST)
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(off) <= STRANGE * scale[:, None], ranges, np.nan)


def fit_runs(ranges: Floats, directions: Floats) -> Runs:
    """Fit a plane over azimuth and elevation to the mean ranges of each run of cells that two scans have measured."""
    r = ranges.reshape(len(ranges), -1, RUN)
    n = np.isfinite(r).sum(axis=0)
    is_known = n >= 2
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(is_known, np.nansum(r, axis=0) / n, np.nan)
        noise2 = np.where(is_known, np.nansum((r - mean) ** 2, axis=0) / (n - 1) / n, 0.0)
    n_cells = np.maximum(is_known.sum(axis=1), 1)
    angles = _angles(directions.reshape(-1, RUN, 3), is_known)
    normal = np.einsum("rci,rcj->rij", angles, angles)
    spread = np.linalg.eigvalsh(normal)
    is_flat = spread[:, 0] > 1e-3 * spread[:, 1]
    inverse = np.linalg.inv(np.where(is_flat[:, None, None], normal, np.eye(2)))
    height = np.where(is_known, mean - (np.nansum(mean, axis=1) / n_cells)[:, None], 0.0)
    slopes = np.einsum("rij,rcj,rc->ri", inverse, angles, height)
    off = np.where(is_known, height - np.einsum("rci,ri->rc", angles, slopes), 0.0)
    left2 = (off**2).sum(axis=1) / np.maximum(n_cells - 3, 1)
    of_mean2 = noise2.sum(axis=1) / n_cells
    is_smooth = is_flat & (n_cells >= FEWEST_CELLS) & (left2 <= TOO_ROUGH**2 * np.maximum(of_mean2, 1e-18))
    is_told = (np.isfinite(r) & is_known).sum(axis=2) >= FEWEST_CELLS
    excess = np.where(is_told, median_known(r - mean), np.nan)
    return Runs(excess, slopes, inverse * of_mean2[:, None, None], is_smooth)


def _angles(directions: Floats, is_known: Bools) -> Floats:
    """Return azimuth and elevation (r, c, 2) [rad] about the means of the known cells of each run, 0 of the others."""
    azimuth = np.arctan2(directions[..., 1], directions[..., 0])
    azimuth = np.angle(np.exp(1j * (azimuth - azimuth[:, :1])))
    angles = np.stack([azimuth, np.arcsin(np.clip(directions[..., 2], -1.0, 1.0))], axis=2)
    n_cells = np.maximum(is_known.sum(axis=1), 1)
    middle = np.where(is_known[..., None], angles, 0.0).sum(axis=1) / n_cells[:, None]
    return np.where(is_known[..., None], angles - middle[:, None], 0.0)
