"""Repeated scans of one station averaged to one, robustly and cell by cell of the instrument's grid (paper 003).

In: scans of one station in their own frames; out: one scan whose points know of how many measurements they are and how
far these spread. The instrument's drift between the repeats is found against their common mean, and removed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

from monitor.declare import check_settings, given_or_default, setting
from monitor.filtering.cells import Cells, gather_cells
from monitor.filtering.drift import Drift, drift_at, estimate_drift
from monitor.filtering.medians import median_known
from monitor.filtering.rounding import error_of_rounding, find_step
from monitor.filtering.soundness import without_zero_ranges
from projects.model import Bools, Floats, Ints, Scan

RUN = 32  # neighbouring cells whose noise is looked at together
FEWEST = RUN // 4  # cells of a run with two ranges: the variance of one pair may be next to nothing by chance
BLOCK = 65_536  # cells averaged at once; a multiple of RUN
CUT = 3.0  # sigmas of the noise around: farther from the median is not averaged
_LEFT = 2.0 * norm.cdf(CUT) - 1.0 - 2.0 * CUT * norm.pdf(CUT)  # of the variance of noise that is left within the cut
WITHIN_CUT = float(np.sqrt(_LEFT / (2.0 * norm.cdf(CUT) - 1.0)))  # the spread there, of that of all noise: 0.987
LOST_BY_CUT = float(1.0 / np.sqrt(_LEFT))  # the error of such a mean, of that of all ranges' (Huber 1964): 1.015
SPLIT_SHARE = 0.2  # of the measurements on either side of a gap: a cell that saw two surfaces; fewer are no surface
PRIOR = 10.0  # few measurements say little of their spread: the noise around counts as the spread of ten more
FINEST = 1e-6  # m: no instrument has less noise, and nothing finer is a reason to leave a range out
MOST_ALIKE = 3.0  # times what neighbours' steps tell: by more, scans differ along a whole run, and that is no noise


@dataclass(frozen=True, kw_only=True)
class AveragingSettings:
    """Repeated scans of one station (`--repeated`), averaged to one before filtering."""

    enabled: bool = setting(
        True, unit="", meaning="average repeated scans cell by cell; else they are merged as others"
    )
    significance: float = setting(
        0.01, unit="", meaning="drift between the scans is removed where chance gives it more rarely than this",
        low=1e-9, high=1.0,
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class AveragedScan:
    """One scan from many.

    `scan` has `n_merged`, `spread` [m] of the ranges of a cell and `sigma` [m] of their mean, NaN where no
    two scans measured the same. `counts` holds the
    measurements by what became of them, `automatic` the drift, the noise and the step of rounded coordinates [m, rad].
    """

    scan: Scan
    counts: Mapping[str, int]
    automatic: Mapping[str, Any]
    drift: Drift = field(repr=False)


@dataclass(frozen=True)
class _Averages:
    """What is known of cells (m,): mean range [m], how many ranges, their spread [m], and whether they split in two."""

    ranges: Floats
    n_kept: Floats
    spread: Floats
    is_split: Bools


def average_scans(scans: Sequence[Scan], settings: AveragingSettings | None = None) -> AveragedScan:
    """Average repeated scans of one station.

    Ranges are averaged cell by cell along the mean direction of the cell: by row and column where the scans are grids
    that name the same directions, else by nearest direction. Of a cell's ranges those within three sigmas of their
    median are averaged, sigma being the noise of the cells around. A cell whose ranges fall apart into two groups with
    a gap that noise does not have saw two surfaces (mixed pixel) and is left out, and so is one of whose ranges no
    majority agrees: of two repeats, through one of which somebody walked, neither is believed. Where less than a fifth
    of the scans that looked measured anything, nothing is averaged.

    Parameters
    ----------
    scans : of one station; `origin` must be known. The first one's frame and pose are the result's.
    settings : the significance that a drift must have to be removed.

    Returns
    -------
    AveragedScan
        Its points come in an order that does not depend on that of the scans' points.

    Raises
    ------
    ParameterError
        If no scan has a point, a coordinate is not finite, a scanner's position is unknown, the scans do not stand at
        one station, or one is a copy of another.

    References
    ----------
    Richter (paper 003), sections 1.3, 3 and 4.2.
    """
    settings = given_or_default(settings, AveragingSettings)
    n_given = sum(len(scan.cloud) for scan in scans)
    scans = [without_zero_ranges(scan) for scan in scans]
    n_at_scanner = n_given - sum(len(scan.cloud) for scan in scans)
    steps = np.array([find_step(scan.cloud.points) for scan in scans])
    cells = _spread_rounded(gather_cells(scans), steps)
    drift = estimate_drift(cells.ranges, cells.directions, settings.significance)
    averages = _average_all(cells, drift)
    keep = (averages.n_kept > 0) & ~averages.is_split
    spread, n_kept = averages.spread[keep], averages.n_kept[keep]
    rounding = error_of_rounding(cells.directions[keep], spread, 0.0, steps.max()) if steps.any() else 0.0
    cloud = replace(
        cells.cloud.take(keep),
        points=scans[0].origin + averages.ranges[keep, None] * cells.directions[keep],
        n_merged=n_kept.astype(np.int32), spread=spread, sigma=np.hypot(error_of_mean(spread, n_kept), rounding),
    )  # fmt: skip
    at_cell = (cells.rows[keep], cells.columns[keep]) if cells.is_grid else (None, None)
    scan = replace(scans[0], cloud=cloud, rows=at_cell[0], columns=at_cell[1])
    counts = _count(cells, averages, keep)
    if n_at_scanner:
        counts |= {"in": n_given, "at_scanner": n_at_scanner}
    automatic = _describe(cells, averages, drift, keep)
    if steps.any():
        automatic["coordinate_step"] = float(steps.max())
    return AveragedScan(scan, counts, automatic, drift)


def _spread_rounded(cells: Cells, steps: Floats) -> Cells:
    """Return the cells with ranges spread over the cubes of edge `steps` (k,) [m] that rounded coordinates stand for.

    Rounded alike in most scans, ranges would show no noise at all, and those a step away would pass for outliers.
    """
    if not steps.any():
        return cells
    draws, ranges = np.random.default_rng(0), cells.ranges.copy()
    for axis in range(3):
        ranges += steps[:, None] * (draws.random(ranges.shape) - 0.5) * cells.directions[:, axis]
    return replace(cells, ranges=ranges)


def _average_all(cells: Cells, drift: Drift) -> _Averages:
    """Average all cells block by block."""
    parts, is_levelled = [], bool(np.isfinite(drift.sigma_range).any())
    for first in range(0, cells.ranges.shape[1], BLOCK):
        block = slice(first, first + BLOCK)
        ranges = cells.ranges[:, block] - drift_at(drift, cells.directions[block], cells.ranges[:, block])
        parts.append(average_ranges(ranges, is_levelled, cells.n_looked[block]))
    names = ("ranges", "n_kept", "spread", "is_split")
    return _Averages(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))


def average_ranges(ranges: Floats, is_levelled: bool = True, n_looked: Ints | int = 1) -> _Averages:
    """Average ranges (k, m) [m] of k scans over m cells in the order of neighbours; NaN where a scan has none.

    `is_levelled`: the scans' offsets are known; where not, what they differ by is counted with the noise. `n_looked`:
    how many looked at each cell; what hardly any of them measured, against the sky, was not there for the others.
    """
    noise, is_alike = noise_around(ranges, MOST_ALIKE if is_levelled else np.inf)
    ordered = np.sort(ranges, axis=0)  # NaN last
    n = np.isfinite(ordered).sum(axis=0)
    keep = _near_median(ordered, noise)
    if not is_alike.all():  # what stood there in one scan alone is no part of the noise
        of_kept, _ = noise_around(np.where(_near_median(ranges, noise), ranges, np.nan), MOST_ALIKE)
        noise = np.where(is_alike, noise, np.fmin(of_kept, noise))
        keep = _near_median(ordered, noise)
    keep &= (2 * keep.sum(axis=0) > n) & (n >= SPLIT_SHARE * n_looked)
    n_kept = keep.sum(axis=0)
    middle = median_known(ordered, axis=0)
    mean = np.where(keep, ordered - middle, 0.0).sum(axis=0) / np.maximum(n_kept, 1) + middle
    own2 = np.where(keep, (ordered - mean) ** 2, 0.0).sum(axis=0) / WITHIN_CUT**2
    spread = np.sqrt((own2 + PRIOR * noise**2) / (np.maximum(n_kept - 1, 0) + PRIOR))
    return _Averages(mean, n_kept.astype(float), spread, _splits(ordered, n, noise))


def error_of_mean(spread: Floats, n_kept: Floats) -> Floats:
    """Return sigma (m,) [m] of the means of ranges of such a spread; a mean of one is that range."""
    return spread / np.sqrt(n_kept) * np.where(n_kept > 1, LOST_BY_CUT, 1.0)


def _near_median(ranges: Floats, noise: Floats) -> Bools:
    """Return which ranges (k, m) lie within `CUT` of the noise (m,) of their cell's median.

    Where the noise is not known, what there is does.
    """
    with np.errstate(invalid="ignore"):
        return np.isfinite(ranges) & ~(np.abs(ranges - median_known(ranges, axis=0)) > CUT * noise)


def noise_around(ranges: Floats, most_alike: float) -> tuple[Floats, Bools]:
    """Return the noise (m,) [m] around each cell, and whether scans differ there as noise does.

    The noise is the median of the variances of the cells of a run, and at most `most_alike` times what the steps from
    each cell to the next tell, by how they differ from scan to scan: whoever stands before a wall in one of the scans
    puts all cells of a run off the others', and hardly changes the steps among them. A run with two ranges in hardly
    any cell has the noise of all others, NaN where no cell has two.
    """
    of_cells = _variances(ranges)
    direct2 = _by_run(of_cells)
    steps2 = _by_run(np.append(0.5 * _variances(np.diff(ranges, axis=1)), np.nan))
    with np.errstate(invalid="ignore"):
        is_alike = ~(direct2 > most_alike**2 * steps2)
    variance = np.where(is_alike, direct2, most_alike**2 * steps2)
    usual = median_known(variance)
    variance = np.where(np.isfinite(variance), variance, usual if np.isfinite(usual) else median_known(of_cells))
    return np.sqrt(np.maximum(variance, FINEST**2)), is_alike


def _variances(values: Floats) -> Floats:
    """Return the variance (m,) of the known values (k, m), NaN of one, so that its median is that of the noise.

    The median of variances of n normal values is the noise variance times the median of chi-square over its degrees
    of freedom.
    """
    n = np.isfinite(values).sum(axis=0)
    degrees = np.maximum(n - 1, 1)
    with np.errstate(invalid="ignore"):
        mean = np.nansum(values, axis=0) / np.maximum(n, 1)
        left2 = np.nansum((values - mean) ** 2, axis=0)
    return np.where(n > 1, left2 / chi2.ppf(0.5, degrees), np.nan)


def _by_run(variances: Floats) -> Floats:
    """Return the median (m,) of the known variances (m,) of each cell's run, NaN where these are too few to tell."""
    n_runs = -(-len(variances) // RUN)
    padded = np.full(n_runs * RUN, np.nan)
    padded[: len(variances)] = variances
    of_runs = padded.reshape(n_runs, RUN)
    n_known = np.isfinite(of_runs).sum(axis=1)
    median = np.where(n_known >= FEWEST, median_known(of_runs, axis=1), np.nan)
    return np.repeat(median, RUN)[: len(variances)]


def _splits(ordered: Floats, n: Floats, noise: Floats) -> Bools:
    """Return the cells (m,) whose ranges leave a gap of three sigmas of the noise with a fifth of them on each side."""
    if len(ordered) < 2:
        return np.zeros(len(n), dtype=bool)
    side = np.maximum(np.ceil(SPLIT_SHARE * n), 2)
    below = np.arange(1, len(ordered))[:, None]
    with np.errstate(invalid="ignore"):
        wide = np.diff(ordered, axis=0) > CUT * noise
    return (wide & (below >= side) & (n - below >= side)).any(axis=0)


def _count(cells: Cells, averages: _Averages, keep: Bools) -> dict[str, int]:
    """Return what became of the measurements: read = the others together."""
    n = np.isfinite(cells.ranges).sum(axis=0)
    n_kept = int(averages.n_kept[keep].sum())
    return {
        "in": int(n.sum()) + cells.n_unmatched,
        "no_counterpart": cells.n_unmatched,
        "split": int(n[averages.is_split].sum()),
        "disagreeing": int(n[~averages.is_split].sum()) - n_kept,
        "averaged": n_kept - int(keep.sum()),
        "out": int(keep.sum()),
    }


def _describe(cells: Cells, averages: _Averages, drift: Drift, keep: Bools) -> dict[str, Any]:
    """Return the figures of the record."""
    n_kept, spread = averages.n_kept[keep], averages.spread[keep]
    return {
        "n_scans": len(cells.ranges),
        "by": "row and column" if cells.is_grid else "nearest direction",
        "n_averaged_median": float(np.median(n_kept)) if len(n_kept) else float("nan"),
        "noise_of_one_scan": float(np.median(spread)) if len(n_kept) else float("nan"),
        "noise_of_the_mean": float(np.median(error_of_mean(spread, n_kept))) if len(n_kept) else float("nan"),
        "drift": drift.as_mapping(),
    }
