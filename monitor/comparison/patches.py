"""Patches of every size, tested all at once: a change is found at the size at which it stands out most.

Testing vertex by vertex at 95 % calls 5 % of an unchanged surface changed. Here each patch has one mean, one sigma
that knows how errors agree within it, and one p value; Benjamini and Hochberg (1995) hold the share of false
discoveries over all patches of all sizes of both sides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr, stdtr
from scipy.stats import norm
from scipy.stats import t as student

from monitor.comparison.correlation import Correlation, kept_variance
from monitor.comparison.reaches import Reaches, gather_reaches, sum_over
from monitor.comparison.side import Side
from monitor.comparison.units import Units, cut_units, summarize_units
from monitor.registration.propagation import motion_variance
from projects.model import Bools, Floats, Ints, Registration

REACHES = (
    0.0,
    1.2,
    1.7,
    2.4,
    3.4,
    4.8,
)  # of a unit's edge: radius around a unit within which its patch takes others in
LARGEST_SHARE = 0.05  # of the surface's area, for a patch: what is larger cannot be told from what is common to all
SMALLEST_SHARE = 0.25  # of the median patch of its size: smaller ones are scraps at borders and not tested
FEWEST_PATCHES = 20  # that a scatter is learned from
AT_ONCE = 1 << 14  # patches whose figures are held at once: 8 MiB
FIRST_DOF = 4.0  # of Student's t in the first look
FEWEST_IN_TAIL = 200  # patches of a size, that tails are learned from
N_IN_TAIL = 2  # sizes, the smallest
RATIO_SCATTER = 0.72  # of the mean ratio of two quantiles, over the root of how many patches a size has
FREEDOMS = np.concatenate([np.arange(3.0, 30.0), np.geomspace(30.0, 300.0, 20)])
USUAL = norm.ppf(0.95)  # sigmas within which nine tenths of normal errors lie
NORMAL = 1e9  # degrees of freedom at which Student's t is the normal distribution


@dataclass(frozen=True)
class Patches:
    """Patches of every size around each unit of one side, (p, s) each: `means`, `sigmas` [m], `is_whole` (not a scrap),
    `is_calm`."""

    means: Floats
    sigmas: Floats
    is_whole: Bools
    is_calm: Bools


@dataclass(frozen=True)
class PatchErrors:
    """How the means of calm patches really scatter: by Student's t of `dof`, nine tenths of them within `scale` times
    1.645 of their sigmas, as of a normal distribution with `scale` times their sigma."""

    scale: float
    dof: float

    def p_values(self, z: Floats) -> Floats:
        """Return two-sided p values of standardized means."""
        away = -np.abs(z) / self.scale
        if self.dof >= NORMAL:
            return np.asarray(2.0 * ndtr(away))
        return np.asarray(2.0 * stdtr(self.dof, away * (student.ppf(0.95, self.dof) / USUAL)))


@dataclass(frozen=True)
class Outlines:
    """What is known of the patches of one side before the noise is, (p, s) each: `areas` [m2], `n_vertices`, `means`
    [m] of the change, variance `common2` [m2] of what no averaging removes, `is_whole` (not a scrap)."""

    areas: Floats
    n_vertices: Ints
    means: Floats
    common2: Floats
    is_whole: Bools


@dataclass(frozen=True)
class Layout:
    """Units of edge `size` [m] on both sides, around each the `reaches` of its patches, and the `outlines` of these."""

    size: float
    units: tuple[Units, Units]
    reaches: tuple[Reaches, Reaches]
    outlines: tuple[Outlines, Outlines]


def lay_out_patches(sides: tuple[Side, Side], size: float, registration: Registration) -> Layout:
    """Cut both sides into units of edge `size` [m] and gather what makes the patches of every size around each."""
    radii = patch_radii(size, 0.5 * sum(float(s.areas[s.is_assessed].sum()) for s in sides))
    units = [summarize_units(s, cut_units(s, size), registration) for s in sides]
    reaches = [gather_reaches(u.centres, u.motion_rows[:, 3:], radii) for u in units]
    outlines = [outline_patches(u, r, len(radii), registration) for u, r in zip(units, reaches, strict=True)]
    return Layout(size, (units[0], units[1]), (reaches[0], reaches[1]), (outlines[0], outlines[1]))


def lay_out_again(layout: Layout, sides: tuple[Side, Side], registration: Registration) -> Layout:
    """Return the same patches of the same surfaces with other distances, which no fit to them has made smaller."""
    units = [summarize_units(s, u.number, registration) for s, u in zip(sides, layout.units, strict=True)]
    n_sizes = layout.outlines[0].areas.shape[1]
    units = [replace(u, stable_shares=np.zeros_like(u.stable_shares)) for u in units]
    outlines = [outline_patches(u, r, n_sizes, registration) for u, r in zip(units, layout.reaches, strict=True)]
    return replace(layout, units=(units[0], units[1]), outlines=(outlines[0], outlines[1]))


def outline_patches(units: Units, reaches: Reaches, n_sizes: int, registration: Registration) -> Outlines:
    """Return what is known of the patches of every size (0: the units alone) without the noise.

    The registration's part counts where it does not rest on the surface around, within the largest patch: of a fit's
    own data an unchanged place shows less than its noise, not more.
    """
    weighted = units.areas[:, None] * np.column_stack(
        [units.means, units.shared, units.stable_shares, units.motion_rows])  # fmt: skip
    figures, shape = np.column_stack([units.areas, units.n_vertices, weighted]), (len(weighted), n_sizes)
    areas, n_vertices, means, common2 = np.empty(shape), np.empty(shape, np.int64), np.empty(shape), np.empty(shape)
    for first in range(0, len(weighted), AT_ONCE):
        block = slice(first, min(first + AT_ONCE, len(weighted)))
        sums = sum_over(reaches, n_sizes, figures, block)
        areas[block], n_vertices[block] = sums[..., 0], sums[..., 1]
        averages = sums[..., 2:] / sums[..., :1]
        motion2 = motion_variance(registration.covariance, averages[..., 3:].reshape(-1, 6)).reshape(-1, n_sizes)
        means[block] = averages[..., 0]
        elsewhere = 1.0 - averages[:, -1:, 2]
        common2[block] = elsewhere * motion2 + averages[..., 1] ** 2  # what its scans disagree by is common to a patch
    is_whole = areas >= SMALLEST_SHARE * np.median(areas, axis=0) if len(areas) else np.zeros(areas.shape, dtype=bool)
    return Outlines(areas, n_vertices, means, common2, is_whole)


def measure_patches(outlines: Outlines, units: Units, reaches: Reaches, correlation: Correlation) -> Patches:
    """Return the patches of every size, with their means and what limits them."""
    weighted = units.areas[:, None] * np.column_stack([units.variances, units.calm_shares])
    sums = sum_over(reaches, outlines.areas.shape[1], weighted, slice(0, len(weighted)))
    averages = sums / outlines.areas[..., None]
    kept = np.column_stack([kept_variance(*of_size, correlation)
                            for of_size in zip(outlines.areas.T, outlines.n_vertices.T, strict=True)])  # fmt: skip
    sigmas = np.sqrt(np.maximum(averages[..., 0] * kept + outlines.common2, 1e-300))
    return Patches(outlines.means, sigmas, outlines.is_whole, averages[..., 1] > 0.5)


def patch_radii(size: float, area: float) -> list[float]:
    """Return the radii [m] of the patches tested, for units of edge `size` [m] on a surface of `area` [m2]."""
    return [r * size for r in REACHES if np.pi * (r * size) ** 2 <= LARGEST_SHARE * area or r == 0.0]


def benjamini_hochberg(p: Floats, level: float) -> float:
    """Return the p value up to which rejecting makes an expected share of false discoveries of at most `level`.

    0 where nothing is to be rejected.

    References
    ----------
    Benjamini and Hochberg (1995), Controlling the false discovery rate; valid under positive dependence
    (Benjamini and Yekutieli 2001), which is what overlapping patches and the two sides have.
    """
    n = len(p)
    rising = np.sort(p)
    below = np.flatnonzero(rising <= level * np.arange(1, n + 1) / max(n, 1))
    return float(rising[below[-1]]) if len(below) else 0.0


def first_errors(z: list[Floats]) -> tuple[PatchErrors, ...]:
    """Return the scatter of standardized means, `z` (p,) of each size, for a first look: that of the median, and a
    heavy tail.

    Errors of real surfaces have such tails; only what stands out of them is kept from teaching the noise.
    """
    usual, outer = student.ppf(0.75, FIRST_DOF), student.ppf(0.95, FIRST_DOF) / USUAL
    return tuple(PatchErrors(outer * max(float(np.median(np.abs(v)) / usual) if len(v) >= FEWEST_PATCHES else 1.0, 1.0),
                             FIRST_DOF) for v in z)  # fmt: skip


def calm_errors(z: list[Floats]) -> tuple[PatchErrors, ...]:
    """Return the scatter of standardized means of patches free of gross change, `z` (p,) of each size.

    As wide as nine tenths of them ask for (an empirical null, Efron 2004, that looks outwards of the middle), and never
    narrower than what the noise model says; with tails as heavy as those of the smallest surely are (`tail_freedom`).
    """
    dof = tail_freedom(z)
    return tuple(PatchErrors(max(float(np.quantile(np.abs(v), 0.9) / USUAL) if len(v) >= FEWEST_PATCHES else 1.0, 1.0),
                             dof) for v in z)  # fmt: skip


def tail_freedom(z: list[Floats]) -> float:
    """Return the degrees of freedom of Student's t whose tails calm patches, `z` (p,) of each size, have for sure.

    Told by how far their 95 % quantile lies beyond that of 90 %: farther out what has changed a little would pass for
    noise, and what is suspect has been left out. Of the smallest patches only, since larger ones reach over what has
    changed beside them. The mean ratio of these sizes scatters by 0.72 over the root of how many patches each has (31
    unchanged pairs of a bumpy sheet, whose errors are normal: `BENCHMARKS.md`); what chance makes of it in one of
    twenty is taken off. Points too sparse for the relief they lie on, which a surface can only guess, leave such tails.
    """
    z = [np.abs(v) for v in z[:N_IN_TAIL] if len(v) >= FEWEST_IN_TAIL]
    if not z:
        return NORMAL
    near, far = np.transpose([np.quantile(v, (0.9, 0.95)) for v in z])
    sure = float(np.mean(far / near)) - USUAL * RATIO_SCATTER / np.sqrt(np.mean([len(v) for v in z]))
    ratios = student.ppf(0.975, FREEDOMS) / student.ppf(0.95, FREEDOMS)  # falling
    return float(np.interp(-sure, -ratios, FREEDOMS)) if sure > ratios[-1] else NORMAL
