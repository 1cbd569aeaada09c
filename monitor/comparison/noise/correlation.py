"""How the errors of neighbouring vertices hang together: without this a million vertices are a million witnesses.

In: standardized distances of stable vertices. Out: correlation against distance, nugget + sum of spherical models, the
area over which errors agree, and the share of variance that a mean over a patch keeps.

Spherical models end where fits end that share no point; exponential ones go on beyond, and keep twice the variance of a
wide patch that it really has.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import jit
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from monitor.boxes import box_of_some
from monitor.comparison.distances.quantile import median
from monitor.comparison.noise.pairs import Pairs, draw_evenly, pair_within
from monitor.robust import MAD_TO_SIGMA
from monitor.threads import map_threads
from projects.model import Floats, Ints

N_SAMPLES = 2000  # vertices whose pairs show the correlation at each scale
FEWEST_VERTICES = 50  # that a correlation is learned from
N_TYPICAL = 1 << 16  # of many vertices that show how large errors are
N_NEAR = 24  # of each sample at each scale
N_BINS = 20
LEAF = 32  # points in a leaf of a tree that is asked little
N_RANGES = 8
NODES = np.polynomial.legendre.leggauss(48)  # and their weights


@dataclass(frozen=True)
class Correlation:
    """rho(h) = sum sills (1 - 1.5 u + 0.5 u^3), u = h / ranges up to 1, for h > 0; what is missing to 1 is independent
    from vertex to vertex. Spherical models are valid in up to three dimensions (Matheron 1965)."""

    sills: Floats
    ranges: Floats

    def at(self, distance: Floats) -> Floats:
        """Return the correlation of errors `distance` [m] apart; 1 at zero distance."""
        used = self.sills > 0.0
        rho = spherical(distance[..., None] / self.ranges[used]) @ self.sills[used]
        return np.where(distance > 0.0, rho, 1.0)

    def mean_square(self, points: Floats) -> float:
        """Return the mean squared correlation of pairs of points (n, 3) [m], n > 1."""
        used = self.sills > 0.0
        total = _sum_squares(np.ascontiguousarray(points), self.sills[used], self.ranges[used])
        return float(total) / (0.5 * len(points) * (len(points) - 1))

    @property
    def area(self) -> float:
        """Area [m2] that counts as one witness: the integral of rho over the plane, pi / 5 sum sill r^2."""
        return float(0.2 * np.pi * np.sum(self.sills * self.ranges**2))

    @property
    def length(self) -> float:
        """Correlation length [m]: radius of the disc of that area."""
        return float(np.sqrt(self.area / np.pi))


@jit(nopython=True, cache=True, nogil=True)
def _sum_squares(points, sills, ranges):  # type: ignore[no-untyped-def]
    """Return the sum of the squared correlation over all pairs of points."""
    total = 0.0
    for i in range(len(points)):
        for j in range(i):
            x, y, z = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2]
            distance, rho = np.sqrt(x * x + y * y + z * z), 0.0
            for k in range(len(sills)):
                if distance < ranges[k]:
                    u = distance / ranges[k]
                    rho += sills[k] * (1.0 - u * (1.5 - 0.5 * u * u))
            if distance == 0.0:
                rho = 1.0
            total += rho * rho
    return total


def spherical(u: Floats) -> Floats:
    """Return the spherical model 1 - 1.5 u + 0.5 u^3 at distance over range `u`, 0 beyond 1."""
    inside = np.minimum(u, 1.0)
    return 1.0 - inside * (1.5 - 0.5 * inside * inside)


def estimate_correlation(points: Floats, errors: Floats, areas: Floats, rng: np.random.Generator) -> Correlation:
    """Estimate how standardized errors (n,) correlate with their distance in space; NaN are left out.

    Errors beyond three robust sigmas are left out, so that a change does not speak for the noise. Ranges go from the
    spacing of the vertices to 0.3 of the surface's diagonal: what agrees beyond that is a motion, not noise.
    """
    known = ~np.isnan(errors)
    n = int(known.sum())
    spacing = float(np.sqrt(median(areas[known]))) if n else 1.0
    longest = _longest_lag(points, np.flatnonzero(known), spacing) if n else 6.0 * spacing
    ranges = _ranges_between(spacing, longest)
    scale = MAD_TO_SIGMA * median(np.abs(errors[known])) if n else 0.0
    if n < FEWEST_VERTICES or scale == 0.0:
        return Correlation(np.zeros(N_RANGES), ranges)
    usual = np.flatnonzero(np.abs(errors) <= 3.0 * scale).astype(np.int32)
    errors = errors[usual] / max(scale, 1e-300)
    lag, product = _pair_products((points, usual), errors, spacing, longest, rng)
    return _fit_models(lag, product, float(np.mean(errors**2)), spacing, longest)


def estimate_of_many(points: Floats, places: Ints, areas: Floats, errors_of: Callable[[Ints], Floats],
                     rng: np.random.Generator) -> Correlation:  # fmt: skip
    """Estimate what `estimate_correlation` does from the vertices at `places` (n,), rising, where these are many.

    `errors_of` returns the standardized errors (k,) of the vertices that it is given: only those in pairs are asked.
    """
    some = places[draw_evenly(len(places), min(N_TYPICAL, len(places)), rng)]
    spacing = float(np.sqrt(median(areas[some])))
    longest = _longest_lag(points, places, spacing)
    pairs = draw_pairs(points, places, spacing, longest, rng)
    is_asked = np.zeros(len(points), dtype=np.bool_)
    is_asked[some] = is_asked[pairs.first] = is_asked[pairs.second] = True
    which, errors = np.flatnonzero(is_asked), np.full(len(points), np.nan)
    errors[which] = errors_of(which)
    scale = MAD_TO_SIGMA * median(np.abs(errors[some]))
    if scale == 0.0:
        return Correlation(np.zeros(N_RANGES), _ranges_between(spacing, longest))
    errors[np.abs(errors) > 3.0 * scale] = np.nan  # a change does not speak for the noise
    product = errors[pairs.first] * errors[pairs.second]
    usual = np.isfinite(product)
    return _fit_models(pairs.lags[usual], product[usual], float(np.nanmean(errors[some] ** 2)), spacing, longest)


def longest_lag(points: Floats, places: Ints, areas: Floats) -> tuple[float, float]:
    """Return the spacing of the vertices at `places` and up to which distance their errors are held to agree [m]."""
    spacing = float(np.sqrt(median(areas[places])))
    return spacing, _longest_lag(points, places, spacing)


def _longest_lag(points: Floats, places: Ints, spacing: float) -> float:
    """Return up to which distance [m] errors are held to agree: 0.3 of the diagonal, six spacings at least."""
    low, high = box_of_some(points, places)
    return max(0.3 * float(np.linalg.norm(high - low)), 6.0 * spacing)


def _ranges_between(spacing: float, longest: float) -> Floats:
    """Return the ranges (`N_RANGES`,) [m] of the models."""
    return np.geomspace(3.0 * spacing, longest, N_RANGES)


def _fit_models(lag: Floats, product: Floats, variance: float, spacing: float, longest: float) -> Correlation:
    """Return the models that fit pairs `lag` (p,) [m] apart whose errors, of this `variance`, have a `product` (p,)."""
    ranges, edges = _ranges_between(spacing, longest), np.geomspace(0.5 * spacing, longest, N_BINS + 1)
    where = np.digitize(lag, edges) - 1  # below 0: the vertex itself
    inside = (where >= 0) & (where < N_BINS)
    count = np.bincount(where[inside], minlength=N_BINS)
    used = count >= 30
    total = np.bincount(where[inside], product[inside], minlength=N_BINS)
    mean_lag = np.bincount(where[inside], lag[inside], minlength=N_BINS)[used] / count[used]
    rho = total[used] / count[used] / variance
    sills, _ = nnls(spherical(mean_lag[:, None] / ranges), rho)
    return Correlation(sills / max(float(sills.sum()), 1.0), ranges)


def _pair_products(places: tuple[Floats, Ints], errors: Floats, spacing: float, longest: float,
                   rng: np.random.Generator) -> tuple[Floats, Floats]:  # fmt: skip
    """Return the distances and products of pairs, as many at each scale: every scale looks at `N_NEAR` neighbours among
    a draw of the vertices as dense as its reach asks for, four spacings and then twice as far each.

    `places` are points (m, 3) and which of them (n,) have the `errors` (n,).
    """
    points, which = places
    n = len(which)
    some = rng.choice(n, min(N_SAMPLES, n), replace=False)
    lags, products = [], []
    for reach in _reaches(spacing, longest):
        drawn = np.sort(rng.choice(n, _n_drawn(n, spacing, reach), replace=False))  # near in memory too
        tree = cKDTree(points[which[drawn]], LEAF, compact_nodes=False, balanced_tree=False)  # made faster than asked
        lag, near = tree.query(points[which[some]], k=min(N_NEAR + 1, len(drawn)))
        lags.append(lag.ravel())
        products.append((errors[some][:, None] * errors[drawn[near]]).ravel())
    return np.concatenate(lags), np.concatenate(products)


def draw_pairs(points: Floats, places: Ints, spacing: float, longest: float, rng: np.random.Generator) -> Pairs:
    """Return pairs of vertices at the `places` (n,), as many at each scale as `_pair_products` looks at."""
    n = len(places)
    samples = places[draw_evenly(n, min(N_SAMPLES, n), rng)]
    asked = [(places[draw_evenly(n, _n_drawn(n, spacing, reach), rng)], reach)
             for reach in _reaches(spacing, longest)]  # fmt: skip
    found = map_threads(lambda one: pair_within(points, samples, *one), asked)
    return Pairs(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _reaches(spacing: float, longest: float) -> Floats:
    """Return how far [m] each scale reaches: four spacings and then twice as far each, up to the longest lag."""
    return 4.0 * spacing * 2.0 ** np.arange(np.ceil(np.log2(max(longest / (4.0 * spacing), 1.0))) + 1)


def _n_drawn(n: int, spacing: float, reach: float) -> int:
    """Return how many of n vertices are drawn for `N_NEAR` of them to lie within `reach` [m] of a place."""
    share = min(N_NEAR * spacing**2 / (np.pi * reach**2), 1.0)
    return min(max(int(share * n), N_NEAR + 1), n)


def kept_variance(areas: Floats, n_vertices: Ints, correlation: Correlation, stretch2: Floats | float = 1.0) -> Floats:
    """Return the share (u,) of the variance that the mean over a patch keeps, between 0 and 1.

    `stretch2` is the square (u,) of how much farther errors agree there than as the correlation says (`stretch`).

    A patch of `areas` (u,) [m2] with `n_vertices` (u,) counts as a disc: the mean correlation of two points of a disc,
    over the density of their distance (disc line picking), and 1 / n of what is independent between vertices.
    """
    if not len(areas):
        return np.zeros(0)
    radius = np.sqrt(np.maximum(areas / stretch2, 1e-300) / np.pi)
    table = np.geomspace(0.9 * radius.min(), 1.1 * radius.max(), 200)  # smooth in the radius
    nodes, weights = NODES
    t = 0.5 * (nodes + 1.0)  # distance over diameter
    density = t * (np.arccos(t) - t * np.sqrt(1.0 - t * t)) * weights
    rho = spherical(2.0 * table[:, None, None] * t[None, :, None] / correlation.ranges) @ correlation.sills
    between = np.interp(radius, table, rho @ (density / density.sum()))
    n = np.maximum(n_vertices, 1)
    return 1.0 / n + (1.0 - 1.0 / n) * between
