"""The drift of an instrument between repeated scans of one station: in range, azimuth and elevation (paper 003).

In: ranges of k scans over cells in the order of neighbours; out: by how much each scan is off the common mean, how sure
that is, and the correction. What all scans share cannot be seen from their differences and stays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from monitor.filtering.drift_beside import offsets_beside
from monitor.filtering.medians import median_known
from monitor.filtering.runs import RUN, Runs, choose_cells, fit_runs, without_strangers
from monitor.robust import nmad
from projects.model import Floats

FEWEST_RUNS = 30  # that a scan must have measured
N_ROUNDS = 2  # first guesses at the ranges, so that a cell that some scans lack has the mean of all of them
CUT = 4.0  # robust sigmas beyond which a run says nothing of drift


@dataclass(frozen=True)
class Drift:
    """By how much each of k scans is off the mean of all: positive range reads longer [m, rad].

    Sigmas are of what is told, the difference from a mean that each scan has a part in: these sum to nothing. They are
    NaN, and what they belong to 0, where a scan has measured too little to tell, and of angles where no slope does.
    `azimuth` and `elevation` are true minus recorded. `p_range` and `p_angles`: how often chance alone gives as much.
    `rate` [m per scan] is the trend of the range. What was not significant is not removed.
    """

    range: Floats
    sigma_range: Floats
    azimuth: Floats
    elevation: Floats
    sigma_azimuth: Floats
    sigma_elevation: Floats
    p_range: float
    p_angles: float
    rate: float
    sigma_rate: float
    removes_range: bool
    removes_angles: bool

    def as_mapping(self) -> dict[str, Any]:
        """Return plain values, as they are recorded."""
        return {
            "range_m": self.range.tolist(), "sigma_range_m": self.sigma_range.tolist(), "p_range": self.p_range,
            "azimuth_rad": self.azimuth.tolist(), "elevation_rad": self.elevation.tolist(),
            "sigma_azimuth_rad": self.sigma_azimuth.tolist(), "sigma_elevation_rad": self.sigma_elevation.tolist(),
            "p_angles": self.p_angles, "rate_m_per_scan": self.rate, "sigma_rate_m_per_scan": self.sigma_rate,
            "n_not_told": int(np.isnan(self.sigma_range).sum()), "range_removed": self.removes_range,
            "angles_removed": self.removes_angles,
        }  # fmt: skip


def estimate_drift(ranges: Floats, directions: Floats, significance: float) -> Drift:
    """Find the drift of each scan against the common mean.

    The difference from the mean range in a run of neighbouring cells is o + g_az a + g_el e with the slopes g of the
    mean range over azimuth and elevation: an angle that is off moves the beam over the surface. Slopes have errors of
    their own, whose expectation is taken off the normal equations. Runs over a jump have no slope and are left out; the
    rest are weighted alike, outliers cut at four robust sigmas. Where hardly any run is smooth, a coarse scan of an
    ornament, all of them tell the offsets, and nothing the angles. What some scans lack, or saw something else in front
    of, is told by the others. A scan that measured less than half of nearly all runs, coarser than the others, is told
    by the cells that it shares with these, in range alone.

    Parameters
    ----------
    ranges : (k, m) m. directions : (m, 3) unit vectors, z the axis of the azimuth, in the order of neighbours.
    significance : chance below which a drift is called one.
    """
    drift = _estimate_together(ranges, directions, significance)
    is_untold = np.isnan(drift.sigma_range) & np.isfinite(ranges).any(axis=1)
    return _with_coarser(drift, ranges, significance) if len(ranges) > 1 and is_untold.any() else drift


def _with_coarser(drift: Drift, ranges: Floats, significance: float) -> Drift:
    """Return the drift with the offsets of the scans that it does not tell, by the cells they share with others."""
    is_told = np.isfinite(drift.sigma_range)
    offsets, covariance = offsets_beside(ranges, np.where(is_told, drift.range, np.nan))
    told = np.flatnonzero(np.isfinite(offsets))
    is_new = covariance.diagonal() > 0.0
    if not is_new.any():
        return drift
    n_before = int(is_told.sum())
    apart2 = float(offsets[is_new] @ np.linalg.solve(covariance[np.ix_(is_new, is_new)], offsets[is_new]))
    if n_before:
        covariance[is_told, is_told] = _of_one_scan(drift.sigma_range[is_told] ** 2)
        apart2 += float(chi2.isf(drift.p_range, n_before - 1))
    p_range = float(chi2.sf(apart2, len(told) - 1))
    from_mean = np.eye(len(told)) - 1.0 / len(told)
    variance = (from_mean @ covariance[np.ix_(told, told)] @ from_mean).diagonal()
    values, sigma = np.zeros(len(ranges)), np.full(len(ranges), np.nan)
    values[told], sigma[told] = offsets[told] - offsets[told].mean(), np.sqrt(variance)
    rate, sigma_rate = _trend(values[told], variance, told.astype(float))
    return replace(
        drift, range=values, sigma_range=sigma, p_range=p_range, rate=rate, sigma_rate=sigma_rate,
        removes_range=p_range < significance or drift.removes_angles,
    )  # fmt: skip


def _estimate_together(ranges: Floats, directions: Floats, significance: float) -> Drift:
    """Return the drift of the scans that measured most cells of enough runs."""
    n_scans = len(ranges)
    nothing, unknown = np.zeros(n_scans), np.full(n_scans, np.nan)
    none = Drift(nothing, unknown, nothing, nothing, unknown, unknown, 1.0, 1.0, np.nan, np.nan, False, False)
    cells = choose_cells(ranges.shape[1])
    if not len(cells):  # not one whole run
        return none
    ranges, directions = without_strangers(ranges[:, cells]), directions[cells]
    told = np.flatnonzero(fit_runs(ranges, directions).n_known() >= FEWEST_RUNS)
    if len(told) < 2:
        return none
    alone, full = _fit_offsets(ranges[told], directions)
    p_range, p_angles = _chance(alone[0], alone[1]), _chance(full[0][:, 1:], full[1][:, 1:, 1:])
    removes_angles = p_angles < significance
    found, covariance = full if removes_angles else alone
    values = np.column_stack([found[:, 0], full[0][:, 1:]])
    sigmas = np.sqrt(np.column_stack([covariance[:, 0, 0], full[1][:, 1, 1], full[1][:, 2, 2]]))
    drift, sigma = np.zeros((3, n_scans)), np.full((3, n_scans), np.nan)
    drift[:, told], sigma[:, told] = values.T, sigmas.T
    rate, sigma_rate = _trend(found[:, 0], covariance[:, 0, 0], told.astype(float))
    return Drift(
        drift[0], sigma[0], drift[1], drift[2], sigma[1], sigma[2], p_range, p_angles, rate, sigma_rate,
        p_range < significance or removes_angles, removes_angles,
    )  # fmt: skip


def _fit_offsets(ranges: Floats, directions: Floats) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
    """Return what (k, p) scans are off by, with covariances (k, p, p): in range alone, and in range and both angles.

    The angles are 0 and not known where hardly any run is smooth.
    """
    guess = _guess_offsets(ranges, directions)
    runs = fit_runs(ranges - guess[:, None], directions)
    smooth = runs.take(runs.is_smooth)
    is_sloped = bool(smooth.n_known().min() >= FEWEST_RUNS)
    alone = _fit_all(smooth if is_sloped else runs, 0)
    none = np.zeros((len(ranges), 3)), np.full((len(ranges), 3, 3), np.nan)
    full = _fit_all(smooth, 2) if is_sloped else none
    for found, _ in (alone, full):
        found[:, 0] += guess
    return alone, full


def _guess_offsets(ranges: Floats, directions: Floats) -> Floats:
    """Return about how far (k,) [m] the scans are off the mean of all, whichever cells each of them lacks."""
    guess = np.zeros(len(ranges))
    for _ in range(N_ROUNDS if np.isnan(ranges).any() else 0):
        guess += np.nan_to_num(median_known(fit_runs(ranges - guess[:, None], directions).excess, axis=1))
        guess -= guess.mean()
    return guess


def drift_at(drift: Drift, directions: Floats, ranges: Floats) -> Floats:
    """Return by how much each range (k, m) [m] is too long; cells without a slope get the offset of their scan only.

    Ranges are brought to the median of the scans, which one that was knocked against does not move.
    """
    if not drift.removes_range:
        return np.zeros(ranges.shape)
    is_told = np.isfinite(drift.sigma_range)
    offset, azimuth, elevation = (
        np.where(is_told, v - np.median(v[is_told]), 0.0) for v in (drift.range, drift.azimuth, drift.elevation)
    )
    shift = np.tile(offset[:, None], (1, ranges.shape[1]))
    n_runs = ranges.shape[1] // RUN
    if drift.removes_angles and n_runs:
        runs = fit_runs(without_strangers(ranges[:, : n_runs * RUN] - offset[:, None]), directions[: n_runs * RUN])
        at_cell = np.zeros((ranges.shape[1], 2))
        at_cell[: n_runs * RUN] = np.repeat(np.where(runs.is_smooth[:, None], runs.slopes, 0.0), RUN, axis=0)
        shift += np.outer(azimuth, at_cell[:, 0]) + np.outer(elevation, at_cell[:, 1])
    return shift


def _fit_all(runs: Runs, n_slopes: int) -> tuple[Floats, Floats]:
    """Return offset and, of two slopes, azimuth and elevation (k, p) of the scans, and the covariance (k, p, p)."""
    found = []
    for excess in runs.excess:
        known = np.isfinite(excess)
        slopes, error = runs.slopes[known, :n_slopes], runs.slope_covariance[known, :n_slopes, :n_slopes]
        found.append(_fit(excess[known], slopes, error))
    return np.array([f for f, _ in found]), np.array([c for _, c in found])


def _fit(excess: Floats, slopes: Floats, error: Floats) -> tuple[Floats, Floats]:
    """Return offset, azimuth and elevation (p,) of one scan, 1 + number of slopes, and their covariance (p, p)."""
    design = np.column_stack([np.ones(len(excess)), slopes])
    keep = np.ones(len(excess), dtype=bool)
    found = np.r_[np.median(excess), np.zeros(slopes.shape[1])]
    for _ in range(4):
        a = design[keep]
        gram = a.T @ a
        bias = np.zeros_like(gram)
        bias[1:, 1:] = error[keep].sum(axis=0)
        inverse = np.linalg.pinv(gram - bias)
        found = inverse @ (a.T @ excess[keep])
        left = excess - design @ found
        scale = max(nmad(left), 1e-12)
        keep = np.abs(left) <= CUT * scale
    return found, scale**2 * (inverse @ gram @ inverse)


def _of_one_scan(covariance: Floats) -> Floats:
    """Return the covariance (k, p, p) of k scans themselves from that of their differences from the mean of all.

    Of k independent values of variance s2 the differences from their mean have s2 (1 - 1 / k), and -s2 / k together.
    """
    n_scans = len(covariance)
    return covariance * n_scans / (n_scans - 1.0)


def _chance(found: Floats, covariance: Floats) -> float:
    """Return how often chance alone gives k scans that lie as far (k, p) apart as found: chi-square of p (k - 1).

    The weighted squares about the weighted mean, which are those of the scans themselves: what all share drops out.
    """
    n_scans, n_each = found.shape
    if not np.isfinite(found).all() or not np.isfinite(covariance).all():
        return 1.0
    weights = np.linalg.pinv(_of_one_scan(covariance), hermitian=True)
    mean = np.linalg.pinv(weights.sum(axis=0), hermitian=True) @ np.einsum("kij,kj->i", weights, found)
    apart2 = float(np.einsum("ki,kij,kj->", found - mean, weights, found - mean))
    return float(chi2.sf(apart2, n_each * (n_scans - 1)))


def _trend(shift: Floats, covariance: Floats, time: Floats) -> tuple[float, float]:
    """Return the trend of the offset (k,) over time (k,), in scans, and its sigma.

    That comes from the scatter about the line where this is larger than chance explains once in a hundred.
    """
    n_scans, time = len(shift), time - time.mean()
    time2 = float((time**2).sum())
    rate = float((time * shift).sum() / time2)
    one2 = _of_one_scan(covariance)
    sigma_rate = float(np.sqrt((time**2 * one2).sum())) / time2
    left2 = float(((shift - shift.mean() - rate * time) ** 2 / one2).sum())
    if n_scans > 2 and chi2.sf(left2, n_scans - 2) < 0.01:
        sigma_rate *= float(np.sqrt(left2 / (n_scans - 2)))
    return rate, sigma_rate
