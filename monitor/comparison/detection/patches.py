"""Patches of every size, tested all at once: a change is found at the size at which it stands out most.

Testing vertex by vertex at 95 % calls 5 % of an unchanged surface changed. Here each patch has one mean, one sigma
that knows how errors agree within it, and one p value; Benjamini and Hochberg (1995) hold the share of false
discoveries over all patches of all sizes of both sides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from monitor.comparison.detection.reaches import Reaches, gather_reaches, sum_over
from monitor.comparison.detection.units import Units, cut_units, summarize_units
from monitor.comparison.distances.side import Side, larger_of, map_sides
from monitor.comparison.noise.correlation import Correlation, kept_variance
from monitor.comparison.noise.scan_errors import ScanErrors
from monitor.registration.motion.propagation import motion_variance
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
CALM, STILL = 0.5, 0.95  # of a patch's area: what changed in the rest moves its mean by half of that, or hardly
AT_ONCE = 1 << 14  # patches whose figures are held at once: 8 MiB


@dataclass(frozen=True)
class Patches:
    """Patches of every size around each unit of one side, (p, s) each: `means` [m]; the variance `own2` [m2] of all but
    what scans disagree by, `stated` [m] of these; `is_whole` (not a scrap), `is_calm` (most of it), `is_still` (nearly
    all of it); the `kinds` (p,) of the units that they lie around; and what the `scans` really err by."""

    means: Floats
    own2: Floats
    stated: Floats
    is_whole: Bools
    is_calm: Bools
    is_still: Bools
    kinds: Ints
    scans: ScanErrors

    @cached_property
    def sigmas(self) -> Floats:
        """One sigma (p, s) [m] of the means; what the scans of a patch disagree by is common to it."""
        return np.asarray(np.sqrt(np.maximum(self.own2 + self.scans.sigma_of(self.stated) ** 2, 1e-300)))

    @cached_property
    def dofs(self) -> Floats:
        """Degrees of freedom (p, s) of the sigmas."""
        return self.scans.dof_of(self.sigmas**2, self.stated)


@dataclass(frozen=True)
class Outlines:
    """What is known of the patches of one side before the noise is, (p, s) each: `areas` [m2], `n_vertices`, `means`
    [m] of the change, variance `motion2` [m2] of what counts as stated, the registration and limbs, `stated` [m] of
    what scans disagree by, `is_whole` (not a scrap)."""

    areas: Floats
    n_vertices: Ints
    means: Floats
    motion2: Floats
    stated: Floats
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

    def lay_out(k: int) -> tuple[Units, Reaches, Outlines]:
        """Return the units of side k, which of them each patch holds, and the outlines of the patches."""
        units = summarize_units(sides[k], cut_units(sides[k], size), registration)
        reaches = gather_reaches(units.centres, units.motion_rows[:, 3:], radii)
        return units, reaches, outline_patches(units, reaches, len(radii), registration)

    a, b = map_sides(lay_out, larger_of(sides))
    return Layout(size, (a[0], b[0]), (a[1], b[1]), (a[2], b[2]))


def lay_out_again(layout: Layout, sides: tuple[Side, Side], registration: Registration) -> Layout:
    """Return the same patches of the same surfaces with other distances."""
    return lay_out_without(layout, sides, (np.zeros(0, dtype=np.bool_),) * 2, registration)


def lay_out_without(layout: Layout, sides: tuple[Side, Side], left_out: tuple[Bools, Bools],
                    registration: Registration) -> Layout:  # fmt: skip
    """Return the same patches without the vertices in `left_out` (n,) of each side; empty: none."""
    numbers = [np.where(out, np.int32(-1), u.number) if len(out) else u.number
               for u, out in zip(layout.units, left_out, strict=True)]  # fmt: skip
    units = [summarize_units(s, number, registration, len(u.areas))
             for s, number, u in zip(sides, numbers, layout.units, strict=True)]  # fmt: skip
    n_sizes = layout.outlines[0].areas.shape[1]
    outlines = [outline_patches(u, r, n_sizes, registration) for u, r in zip(units, layout.reaches, strict=True)]
    return replace(layout, units=(units[0], units[1]), outlines=(outlines[0], outlines[1]))


def outline_patches(units: Units, reaches: Reaches, n_sizes: int, registration: Registration) -> Outlines:
    """Return what is known of the patches of every size (0: the units alone) without the noise."""
    weighted = units.areas[:, None] * np.column_stack([units.means, units.shared, units.limbs, units.motion_rows])
    figures, shape = np.column_stack([units.areas, units.n_vertices, weighted]), (len(weighted), n_sizes)
    areas, means, motion2, stated = (np.empty(shape) for _ in range(4))
    n_vertices = np.empty(shape, np.int64)
    for first in range(0, len(weighted), AT_ONCE):
        block = slice(first, min(first + AT_ONCE, len(weighted)))
        sums = sum_over(reaches, n_sizes, figures, block)
        areas[block], n_vertices[block] = sums[..., 0], sums[..., 1]
        averages = sums[..., 2:] / sums[..., :1]
        means[block], stated[block] = averages[..., 0], averages[..., 1]
        rows = averages[..., 3:].reshape(-1, 6)
        moved2 = motion_variance(registration.covariance, rows).reshape(-1, n_sizes)
        motion2[block] = moved2 + averages[..., 2] ** 2
    is_whole = areas >= SMALLEST_SHARE * np.median(areas, axis=0) if len(areas) else np.zeros(areas.shape, dtype=bool)
    return Outlines(areas, n_vertices, means, motion2, stated, is_whole)


def measure_patches(outlines: Outlines, units: Units, reaches: Reaches, correlation: Correlation,
                    scans: ScanErrors) -> Patches:  # fmt: skip
    """Return the patches of every size, with their means and what limits them."""
    weighted = units.areas[:, None] * np.column_stack([units.variances, units.calm_shares, units.agreeing])
    sums = sum_over(reaches, outlines.areas.shape[1], weighted, slice(0, len(weighted)))
    averages = sums / outlines.areas[..., None]
    stretch2 = np.where(averages[..., 0] > 0.0, averages[..., 2] / np.maximum(averages[..., 0], 1e-300), 1.0)
    kept = np.column_stack([kept_variance(areas, n_vertices, correlation, of_size) for areas, n_vertices, of_size
                            in zip(outlines.areas.T, outlines.n_vertices.T, stretch2.T, strict=True)])  # fmt: skip
    own2, calm = averages[..., 0] * kept + outlines.motion2, averages[..., 1]
    return Patches(outlines.means, own2, outlines.stated, outlines.is_whole, calm > CALM, calm > STILL, units.kinds,
                   scans)  # fmt: skip


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
    rising = np.sort(p[p <= level])  # the others are in no way rejected
    below = np.flatnonzero(rising <= level * np.arange(1, len(rising) + 1) / max(n, 1))
    return float(rising[below[-1]]) if len(below) else 0.0
