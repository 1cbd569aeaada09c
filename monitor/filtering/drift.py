"""The drift of an instrument between repeated scans of one station: in range, azimuth and elevation (paper 003).

In: ranges of k scans over cells in the order of neighbours; out: by how much each scan is off the common mean, how sure
that is, and the correction. What all scans share cannot be seen from their differences and stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from projects.model import Bools, Floats

RUN = 16  # neighbouring cells to which a plane is fitted: slope of the range over both angles
MOST_RUNS = 20_000
FEWEST_RUNS = 30
TOO_ROUGH = 3.0  # times the noise of the mean: a run over a jump or a crest has no slope
CUT = 4.0  # robust sigmas beyond which a run says nothing of drift


@dataclass(frozen=True)
class Drift:
    """By how much each of k scans is off the mean of all: positive range reads longer [m, rad].

    Sigmas are of what is told, the difference from a mean that each scan has a part in: these sum to nothing.
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
            "range_removed": self.removes_range, "angles_removed": self.removes_angles,
        }  # fmt: skip


def estimate_drift(ranges: Floats, directions: Floats, significance: float) -> Drift:
    """Find the drift of each scan against the common mean.

    Where all scans measured, the difference from the mean range in a run of neighbouring cells is
    o + g_az a + g_el e with the slopes g of the mean range over azimuth and elevation: an angle that is off moves the
    beam over the surface. Slopes have errors of their own, whose expectation is taken off the normal equations. Runs
    over a jump have no slope and are left out; the rest are weighted alike, outliers cut at four robust sigmas.

    Parameters
    ----------
    ranges : (k, m) m. directions : (m, 3) unit vectors, z the axis of the azimuth, in the order of neighbours.
    significance : chance below which a drift is called one.
    """
    n_scans = len(ranges)
    nothing, unknown = np.zeros(n_scans), np.full(n_scans, np.nan)
    runs = _slopes(ranges, directions, MOST_RUNS)
    usable = np.flatnonzero(runs.is_smooth)
    if n_scans < 2 or len(usable) < FEWEST_RUNS:
        return Drift(nothing, unknown, nothing, nothing, unknown, unknown, 1.0, 1.0, np.nan, np.nan, False, False)
    excess, slopes, error = runs.excess[:, usable], runs.slopes[usable], runs.slope_covariance[usable]
    alone, full = (_fit_all(excess, slopes[:, :n], error[:, :n, :n]) for n in (0, 2))
    p_range = _chance(alone[0], alone[1])
    p_angles = _chance(full[0][:, 1:], full[1][:, 1:, 1:])
    removes_angles = p_angles < significance
    found, covariance = full if removes_angles else alone
    shift, sigma = found[:, 0], np.sqrt(covariance[:, 0, 0])
    azimuth, elevation = full[0][:, 1], full[0][:, 2]
    sigma_azimuth, sigma_elevation = (np.sqrt(full[1][:, axis, axis]) for axis in (1, 2))
    rate, sigma_rate = _trend(shift, sigma**2)
    return Drift(
        shift, sigma, azimuth, elevation, sigma_azimuth, sigma_elevation, p_range, p_angles, rate, sigma_rate,
        p_range < significance or removes_angles, removes_angles,
    )  # fmt: skip


def drift_at(drift: Drift, directions: Floats, ranges: Floats) -> Floats:
    """Return by how much each range (k, m) [m] is too long; cells without a slope get the offset of their scan only."""
    shift = np.zeros(ranges.shape) if not drift.removes_range else np.tile(drift.range[:, None], (1, ranges.shape[1]))
    if drift.removes_angles:
        runs = _slopes(ranges, directions, None)
        slopes = np.where(runs.is_smooth[:, None], runs.slopes, 0.0)
        at_cell = np.zeros((ranges.shape[1], 2))
        at_cell[: len(slopes) * RUN] = np.repeat(slopes, RUN, axis=0)
        shift += np.outer(drift.azimuth, at_cell[:, 0]) + np.outer(drift.elevation, at_cell[:, 1])
    return shift


@dataclass(frozen=True)
class _Runs:
    """Runs of neighbouring cells: excess (k, r) over the mean range, its slopes (r, 2) and their covariance."""

    excess: Floats
    slopes: Floats
    slope_covariance: Floats
    is_smooth: Bools


def _slopes(ranges: Floats, directions: Floats, most: int | None) -> _Runs:
    """Fit a plane over azimuth and elevation to the mean ranges of each run, of at most `most` runs evenly spread."""
    n_runs = ranges.shape[1] // RUN
    chosen = np.arange(n_runs)
    if most is not None and n_runs > most:
        chosen = np.unique(np.linspace(0, n_runs - 1, most).astype(np.int64))
    cell = (chosen[:, None] * RUN + np.arange(RUN)).ravel()
    r = ranges[:, cell].reshape(len(ranges), len(chosen), RUN)
    mean = r.mean(axis=0)  # NaN where a scan has nothing: such runs are left out
    noise2 = ((r - mean) ** 2).sum(axis=0).mean(axis=1) / max(len(r) - 1, 1) / len(r)
    d = directions[cell].reshape(len(chosen), RUN, 3)
    azimuth = np.arctan2(d[..., 1], d[..., 0])
    azimuth = np.angle(np.exp(1j * (azimuth - azimuth[:, :1])))
    angles = np.stack([azimuth, np.arcsin(np.clip(d[..., 2], -1.0, 1.0))], axis=2)
    angles = angles - angles.mean(axis=1, keepdims=True)
    normal = np.einsum("rci,rcj->rij", angles, angles)
    spread = np.linalg.eigvalsh(normal)
    is_flat = spread[:, 0] > 1e-3 * spread[:, 1]
    inverse = np.linalg.inv(np.where(is_flat[:, None, None], normal, np.eye(2)))
    height = mean - mean.mean(axis=1, keepdims=True)
    slopes = np.einsum("rij,rcj,rc->ri", inverse, angles, height)
    left2 = ((height - np.einsum("rci,ri->rc", angles, slopes)) ** 2).sum(axis=1) / (RUN - 3)
    with np.errstate(invalid="ignore"):
        is_smooth = is_flat & (left2 <= TOO_ROUGH**2 * np.maximum(noise2, 1e-18))
    return _Runs(np.median(r - mean, axis=2), slopes, inverse * noise2[:, None, None], is_smooth)


def _fit_all(excess: Floats, slopes: Floats, error: Floats) -> tuple[Floats, Floats]:
    """Return offset, azimuth and elevation (k, p) of the scans, and the covariance (k, p, p) of each."""
    found = [_fit(y, slopes, error) for y in excess]
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
        scale = max(1.4826 * float(np.median(np.abs(left - np.median(left)))), 1e-12)
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


def _trend(shift: Floats, covariance: Floats) -> tuple[float, float]:
    """Return the trend of the offset (k,) from scan to scan and its sigma.

    That comes from the scatter about the line where this is larger than chance explains once in a hundred.
    """
    n_scans = len(shift)
    time = np.arange(n_scans) - 0.5 * (n_scans - 1)
    time2 = float((time**2).sum())
    rate = float((time * shift).sum() / time2)
    one2 = _of_one_scan(covariance)
    sigma_rate = float(np.sqrt((time**2 * one2).sum())) / time2
    left2 = float(((shift - shift.mean() - rate * time) ** 2 / one2).sum())
    if n_scans > 2 and chi2.sf(left2, n_scans - 2) < 0.01:
        sigma_rate *= float(np.sqrt(left2 / (n_scans - 2)))
    return rate, sigma_rate
