"""Patches of every size, tested all at once: a change is found at the size at which it stands out most.

Testing vertex by vertex at 95 % calls 5 % of an unchanged surface changed. Here each patch has one mean, one sigma
that knows how errors agree within it, and one p value; Benjamini and Hochberg (1995) hold the share of false
discoveries over all patches of all sizes of both sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.spatial import cKDTree
from scipy.stats import norm
from scipy.stats import t as student

from monitor.comparison.correlation import Correlation, kept_variance
from monitor.comparison.side import Side
from monitor.comparison.units import Units, cut_units, place_units
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
FIRST_DOF = 4.0  # of Student's t in the first look
NORMAL = 1e9  # degrees of freedom at which Student's t is the normal distribution


@dataclass(frozen=True)
class Patches:
    """Patches of one size around each unit of one side. `members` (p, u) sparse 0/1; the rest is (p,):
    `means`, `sigmas` [m], `is_whole` (not a scrap), `is_calm`."""

    members: csr_matrix
    means: Floats
    sigmas: Floats
    is_whole: Bools
    is_calm: Bools


@dataclass(frozen=True)
class PatchErrors:
    """How the means of calm patches really scatter: `scale` times their sigma, with Student's t of `dof`."""

    scale: float
    dof: float

    def p_values(self, z: Floats) -> Floats:
        """Return two-sided p values of standardized means."""
        return np.asarray(2.0 * student.sf(np.abs(z) / self.scale, self.dof))


@dataclass(frozen=True)
class Layout:
    """Units of edge `size` [m] on both sides, `numbers` of each vertex, and what makes the patches of each size:
    `members` [size][side], sparse 0/1 (p, u)."""

    size: float
    numbers: tuple[Ints, Ints]
    members: list[list[csr_matrix]]


def lay_out_patches(sides: tuple[Side, Side], size: float) -> Layout:
    """Cut both sides into units of edge `size` [m] and gather the patches of every size around each."""
    numbers = (cut_units(sides[0], size), cut_units(sides[1], size))
    places = [place_units(s, n) for s, n in zip(sides, numbers, strict=True)]
    radii = patch_radii(size, 0.5 * sum(float(s.areas[s.is_assessed].sum()) for s in sides))
    return Layout(size, numbers, [[_members(*place, r) for place in places] for r in radii])


def _members(centres: Floats, normals: Floats, radius: float) -> csr_matrix:
    """Return which units (columns) belong to the patch around each unit (rows): those within `radius` [m] that look the
    same way (within 60 degrees)."""
    n = len(centres)
    pairs = np.zeros((0, 2), dtype=np.int64)
    if radius > 0.0 and n:
        pairs = cKDTree(centres).query_pairs(radius, output_type="ndarray")
        length = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
        cosine = np.einsum("pi,pi->p", normals[pairs[:, 0]], normals[pairs[:, 1]])
        pairs = pairs[cosine >= 0.5 * length[pairs[:, 0]] * length[pairs[:, 1]]]
    rows = np.concatenate([np.arange(n), pairs[:, 0], pairs[:, 1]])
    columns = np.concatenate([np.arange(n), pairs[:, 1], pairs[:, 0]])
    return coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(n, n)).tocsr()


def measure_patches(units: Units, members: csr_matrix, correlation: Correlation, registration: Registration) -> Patches:
    """Return the patches that `members` names, with their means and what limits them."""
    areas = members @ units.areas
    weights = members.multiply(units.areas).multiply(1.0 / areas[:, None]).tocsr()
    within2 = weights @ units.variances
    kept = kept_variance(areas, members @ units.n_vertices, correlation)
    rows = weights @ units.motion_rows
    motion2 = np.maximum(np.einsum("pi,ij,pj->p", rows, registration.covariance, rows), 0.0)
    common2 = motion2 + (weights @ units.shared) ** 2  # what its scans disagree by is common to a patch
    return Patches(
        members=members,
        means=weights @ units.means,
        sigmas=np.sqrt(np.maximum(within2 * kept + common2, 1e-300)),
        is_whole=areas >= SMALLEST_SHARE * np.median(areas) if len(areas) else np.zeros(0, dtype=np.bool_),
        is_calm=weights @ units.calm_shares > 0.5,
    )


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


def first_errors(z: Floats) -> PatchErrors:
    """Return the scatter of standardized means z (p,) for a first look: width of the median, and a heavy tail.

    Errors of real surfaces have such tails; only what stands out of them is kept from teaching the noise.
    """
    if len(z) < FEWEST_PATCHES:
        return PatchErrors(1.0, FIRST_DOF)
    return PatchErrors(max(float(np.median(np.abs(z)) / student.ppf(0.75, FIRST_DOF)), 1.0), FIRST_DOF)


def calm_errors(z: Floats) -> PatchErrors:
    """Return the scatter of standardized means z (p,) of patches free of gross change.

    A normal distribution as wide as nine tenths of them ask for (an empirical null, Efron 2004, that looks outwards of
    the middle), and never narrower than what the noise model says.
    """
    if len(z) < FEWEST_PATCHES:
        return PatchErrors(1.0, NORMAL)
    return PatchErrors(max(float(np.quantile(np.abs(z), 0.9) / norm.ppf(0.95)), 1.0), NORMAL)


def least_p(patches: Patches, p_values: Floats, sign: float) -> Floats:
    """Return for each unit (u,) the smallest p value of the patches it belongs to whose mean has the sign; 1 if none.

    `p_values` (p,) are 1 where the patch is not tested.
    """
    p = np.where(np.sign(patches.means) == sign, p_values, 1.0)
    least = np.ones(len(p))
    patch, unit = patches.members.nonzero()
    np.minimum.at(least, unit, p[patch])
    return least
