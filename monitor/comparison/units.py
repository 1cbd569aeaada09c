"""Independent witnesses: the surface cut into patches as large as errors agree, each tested once.

Testing vertex by vertex at 95 % calls 5 % of an unchanged surface changed. Here each patch has one mean, one sigma
and one p value, and Benjamini and Hochberg (1995) hold the share of false discoveries over all patches of both sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.stats import t as student

from monitor.comparison.correlation import Correlation, kept_variance
from monitor.comparison.noise import Noise
from monitor.comparison.side import Side
from projects.model import Bools, Floats, Ints, Registration

SMALLEST_UNIT = 0.25  # of the median unit's area: smaller ones are scraps at borders and not tested
FEWEST_UNITS = 20  # that a scatter is learned from
LARGEST_DOF = 200.0  # of Student's t, beyond which it is the normal distribution


@dataclass(frozen=True)
class Units:
    """Patches of one side. `number` (n,) is the unit of each vertex, -1 where not assessable; the rest is per unit:
    `mean`, `sigma` [m], `is_whole` (not a scrap at a border), `is_stable`."""

    number: Ints
    mean: Floats
    sigma: Floats
    is_whole: Bools
    is_stable: Bools


def unit_size(correlation: Correlation, areas: Floats) -> float:
    """Return the edge [m] of a unit: that of one witness's area, at least four vertices, at least 50 units in all."""
    spacing = float(np.sqrt(np.median(areas)))
    largest = float(np.sqrt(areas.sum() / 50.0))
    return max(min(float(np.sqrt(correlation.area)), largest), 4.0 * spacing)


def cut_units(side: Side, size: float) -> Ints:
    """Return the unit of each vertex (n,), -1 where not assessable: connected parts of cubes of edge `size` [m]."""
    assessed = np.flatnonzero(side.is_assessed)
    number = np.full(len(side.areas), -1, dtype=np.int64)
    cell = np.floor((side.surface.vertices - side.surface.vertices.min(axis=0)) / size).astype(np.int64)
    edges = side.edges
    joined = (cell[edges[:, 0]] == cell[edges[:, 1]]).all(axis=1) & side.is_assessed[edges].all(axis=1)
    n = len(number)
    graph = coo_matrix((np.ones(joined.sum(), dtype=np.int8), edges[joined].T), shape=(n, n))
    _, part = connected_components(graph, directed=False)
    _, number[assessed] = np.unique(part[assessed], return_inverse=True)
    across = edges[~joined & side.is_assessed[edges].all(axis=1)]
    return merge_slivers(number, across, side.areas, 0.25 * size**2)


def merge_slivers(number: Ints, across: Ints, areas: Floats, least: float) -> Ints:
    """Return the units with those smaller than `least` [m2] given to the neighbour they share most edges with.

    `across` (e, 2) are the edges between units. A sliver without neighbour stays alone (and is too small to be tested).
    """
    n_units = int(number.max(initial=-1)) + 1
    area = np.bincount(number[number >= 0], areas[number >= 0], minlength=n_units)
    pairs = number[np.vstack([across, across[:, ::-1]])]
    pairs = pairs[(pairs[:, 0] != pairs[:, 1]) & (area[pairs[:, 0]] < least) & (area[pairs[:, 1]] >= least)]
    key, count = np.unique(pairs[:, 0] * max(n_units, 1) + pairs[:, 1], return_counts=True)
    small, big = np.divmod(key, max(n_units, 1))
    target = np.arange(n_units)
    rising = np.argsort(count, kind="stable")
    target[small[rising]] = big[rising]  # the last one written shares most edges
    merged = number.copy()
    merged[number >= 0] = target[number[number >= 0]]
    _, merged[number >= 0] = np.unique(merged[number >= 0], return_inverse=True)
    return merged


def summarize_units(side: Side, number: Ints, noise: Noise, registration: Registration, calm: Bools) -> Units:
    """Return mean and sigma of each unit; its noise is that of correlated vertices, its motion is common to all.

    A unit is stable where more than half of its area is in `calm`.
    """
    inside = np.flatnonzero(number >= 0)
    order = inside[np.argsort(number[inside], kind="stable")]
    n_units = int(number.max(initial=-1)) + 1
    unit, weight = number[order], side.areas[order]
    area = sum_groups(unit, weight, n_units)
    share = weight / np.maximum(area[unit], 1e-300)
    within2 = sum_groups(unit, share * noise.variance_of(side)[order], n_units)
    starts = np.searchsorted(unit, np.arange(n_units + 1))
    kept = kept_variance(side.surface.vertices[order], starts, noise.correlation)
    common2 = common_variance(side, order, unit, share, registration, n_units)
    return Units(
        number=number,
        mean=sum_groups(unit, share * side.distances[order], n_units),
        sigma=np.sqrt(np.maximum(within2 * kept + common2, 1e-300)),
        is_whole=area >= SMALLEST_UNIT * np.median(area) if n_units else np.zeros(0, dtype=np.bool_),
        is_stable=sum_groups(unit, share * calm[order], n_units) > 0.5,
    )


def sum_groups(group: Ints, values: Floats, n_groups: int) -> Floats:
    """Return the sum of the values of each group (n_groups,)."""
    return np.asarray(np.bincount(group, values, minlength=n_groups), dtype=np.float64)


def common_variance(side: Side, vertices: Ints, group: Ints, share: Floats, registration: Registration,
                    n_groups: int) -> Floats:  # fmt: skip
    """Return the variance [m2] that registration and scans give the weighted mean of each group (fully correlated)."""
    arm = side.surface.vertices[vertices] - registration.centre
    rows = np.hstack([np.cross(arm, side.normals[vertices]), side.normals[vertices]]) * share[:, None]
    mean_rows = np.column_stack([np.bincount(group, rows[:, k], minlength=n_groups) for k in range(6)])
    shared = sum_groups(group, share * side.sigma_shared[vertices], n_groups)
    return np.maximum(np.einsum("ui,ij,uj->u", mean_rows, registration.covariance, mean_rows), 0.0) + shared**2


def benjamini_hochberg(p: Floats, level: float) -> Bools:
    """Return which hypotheses are rejected with an expected share of false discoveries of at most `level`.

    References
    ----------
    Benjamini and Hochberg (1995), Controlling the false discovery rate; valid under positive dependence
    (Benjamini and Yekutieli 2001), which is what neighbouring patches and the two sides have.
    """
    n = len(p)
    if not n:
        return np.zeros(0, dtype=np.bool_)
    order = np.argsort(p, kind="stable")
    below = np.flatnonzero(p[order] <= level * np.arange(1, n + 1) / n)
    rejected = np.zeros(n, dtype=np.bool_)
    if len(below):
        rejected[order[: below[-1] + 1]] = True
    return rejected


@dataclass(frozen=True)
class UnitErrors:
    """How the means of stable units really scatter: `scale` times their sigma, with Student's t of `dof`."""

    scale: float
    dof: float

    def p_values(self, z: Floats) -> Floats:
        """Return two-sided p values of standardized means."""
        return 2.0 * student.sf(np.abs(z) / self.scale, self.dof)


def calibrate_units(z: Floats, with_tail: bool) -> UnitErrors:
    """Learn the scatter of the standardized means z (u,) of stable units: its width, and with which tail.

    Efron's (2004) empirical null. The width is that of the median; the tail, from the ninth decile, only where the
    units are known to be free of change. Never narrower than what the noise model says.
    """
    if len(z) < FEWEST_UNITS:
        return UnitErrors(1.0, LARGEST_DOF)
    middle, outer = np.quantile(np.abs(z), [0.5, 0.9])
    dof = LARGEST_DOF
    if with_tail:
        dofs = np.geomspace(3.0, LARGEST_DOF, 200)
        ratio = student.ppf(0.95, dofs) / student.ppf(0.75, dofs)
        dof = float(dofs[np.argmin(np.abs(ratio - outer / max(middle, 1e-300)))])
    return UnitErrors(max(float(middle / student.ppf(0.75, dof)), 1.0), dof)
