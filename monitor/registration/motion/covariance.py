"""How well a motion is known: its 6 x 6 covariance, honest about neighbouring residuals that err together.

The covariance of independent residuals is too good by orders of magnitude. Here the residuals of the stable areas
themselves tell how they correlate with distance, and the covariance is that of the M-estimate under this correlation:
C = H^-1 B H^-1 with H the information of the shape and B = sum_ij J_i J_j' c(d_ij) (after Huber 1967, Conley 1999).
All covariances are of (w, t) in x -> c + exp([w]) (x - c) + t, radians and metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from monitor.registration.motion.correlation import find_ranges, fit_correlation
from monitor.registration.motion.matching import Matches
from monitor.registration.motion.patch_field import lay_field, sum_by
from monitor.registration.motion.patches import cut_patches
from monitor.registration.motion.sampling import Beside, parameter_rows
from monitor.robust import robust_scale, tukey_slope, tukey_weights
from projects.model import Floats, Ints
from projects.transforms import cross_matrix

N_PATCHES = 250  # enough to tell a range of a twentieth of the object; 0.1 s
LIGHT, FEWEST_BEARING = 0.1, 50  # of the usual weight: no witness of how others err; patches that tell a range
FEWEST_SHARING = 200  # products of scores that tell a correlation to 7 %
LEAST_SCATTER = 1e-6  # of standardized residuals squared: two epochs of the same numbers have none


def about(covariance: Floats, offset: Floats) -> Floats:
    """Return the covariance (6, 6) of a motion about a point as one about the point that lies `offset` (3,) [m] off.

    With x -> c + exp([w]) (x - c) + t the part t about c + o is t + w x o.
    """
    J = moved_by(offset)
    return np.asarray(J @ covariance @ J.T)


def moved_by(offset: Floats) -> Floats:
    """Return J (6, 6) that turns (w, t) of a motion about a point into that about the point `offset` (3,) [m] off."""
    J = np.eye(6)
    J[3:, :3] = -cross_matrix(offset)
    return J


def shape_information(matches: Matches, centre: Floats, weights: Floats, beside: Beside = "nothing") -> Floats:
    """Return the information (6, 6), `beside` a layer or a scale (7, 7), that the shape holds on the motion, free of
    the noise of the normals.

    Noise of a normal looks like relief that holds the surface in place. Source and target normals err independently,
    so the product of their rows has the shape alone in it.
    """
    a = parameter_rows(matches.points, matches.normals_source, centre, beside)
    b = parameter_rows(matches.points, matches.normals_target, centre, beside)
    cross = (a * weights[:, None]).T @ b
    return 0.5 * (cross + cross.T)


@dataclass(frozen=True)
class Adjusted:
    """The pairs that a motion rests on, standardized: scores psi (n,), rows (n, k) over sigma, weights [1 / m2] (n,),
    mean slope of psi; `partner` (n,) is the number of each pair's target point."""

    points: Floats
    normals: Floats
    psi: Floats
    rows: Floats
    weights: Floats
    slope: float
    information: Floats
    partner: Ints


def estimate_covariance(
    matches: Matches,
    sigma: Floats,
    centre: Floats,
    basis: Floats | None = None,
    shared: Floats | None = None,
    beside: Beside = "nothing",
) -> Floats:
    """Return the covariance (6, 6) of the motion that stable pairs give; never below that of independent residuals.

    `sigma` (n,) [m] is of each residual; `centre` (3,) [m] is what the rotation is about. With a `basis` (6, k) of the
    motions that were estimated, the others held, it is the covariance of those alone. `shared` (n,) is the factor by
    which weights are less than 1 / sigma^2 (`align`). `beside` a layer all over or a scale it is (7, 7), the last
    that of its thickness [m] or of the scale.
    """
    adjusted = standardize(matches, sigma, centre, shared, beside)
    if basis is not None:
        adjusted = replace(adjusted, rows=adjusted.rows @ basis, information=basis.T @ adjusted.information @ basis)
        found = _covariance_of(adjusted)
        return np.asarray(basis @ found @ basis.T)
    return _covariance_of(adjusted)


def _covariance_of(adjusted: Adjusted) -> Floats:
    """Return the covariance (k, k) of the k motions whose rows are given."""
    bread = np.linalg.pinv(adjusted.information, hermitian=True)
    covariance = bread @ score_covariance(adjusted) @ bread
    return at_least(0.5 * (covariance + covariance.T), naive_covariance(adjusted))


def standardize(matches: Matches, sigma: Floats, centre: Floats, shared: Floats | None = None,
                beside: Beside = "nothing") -> Adjusted:  # fmt: skip
    """Return what the sums of the covariance are made of: residuals over sigma are held by Tukey's psi, and both, they
    and the rows, are less by the root of `shared`, so that psi scatters alike in all patches."""
    u = matches.residuals / sigma
    u = u / max(robust_scale(u), 1e-12)
    root = np.ones(len(u)) if shared is None else np.sqrt(shared)
    rows = parameter_rows(matches.points, matches.normals, centre, beside) / (sigma * root)[:, None]
    weights = 1.0 / (sigma * root) ** 2
    information = shape_information(matches, centre, weights, beside)
    slope = float(np.mean(tukey_slope(u)))
    psi = u * tukey_weights(u) / root
    return Adjusted(matches.points, matches.normals, psi, rows, weights, slope, information, matches.target)


def naive_covariance(adjusted: Adjusted) -> Floats:
    """Return the covariance of the M-estimate as if all residuals were independent, as large as the information."""
    factor = max(float(np.mean(adjusted.psi**2)), LEAST_SCATTER) / adjusted.slope**2  # a copy of itself fits exactly
    return factor * np.linalg.pinv(adjusted.information, hermitian=True)


def score_covariance(adjusted: Adjusted) -> Floats:
    """Return B = sum over all pairs of J_i J_j' c(d_ij), as large as the information, averaged over the models of
    correlation."""
    grid = cut_patches(adjusted.points, adjusted.normals, len(adjusted.points) / N_PATCHES)
    field = lay_field(adjusted.points, adjusted.normals, grid)
    member, rows = field.member, sum_by(field.part, adjusted.rows)
    scores = adjusted.psi / adjusted.slope
    own, common = share_partners(adjusted, scores, member)
    tell = bearing_patches(adjusted, member)
    block = np.ix_(tell, tell)
    found = {r: field.correlate(r, rows) for r in find_ranges(grid.cell, float(field.distances.max()))}
    means = np.bincount(member, scores) / field.counts
    mean_rows = sum_by(field.patch, rows) / field.counts[:, None]
    correlations = {reach: between[block] for reach, (between, _) in found.items()}
    models = fit_correlation(means[tell], mean_rows[tell], field.counts[tell], correlations, common[tell])
    return np.asarray(sum(m.probability * (m.noise2 * own + m.field2 * found[m.range][1]) for m in models))


def share_partners(adjusted: Adjusted, scores: Floats, member: Ints) -> tuple[Floats, Floats]:
    """Return the sum (k, k) of J_i J_j' over what pairs have of noise in common, and by what factor (p,) it raises the
    variance of the mean of each patch.

    A target point that is the nearest of several points of the source errs in all of these pairs: its part of the
    variance counts 2.3 times where both sides are equally dense.
    """
    point = np.unique(adjusted.partner, return_inverse=True)[1]
    common = partner_share(scores, point)
    of_point = sum_by(point, adjusted.rows)
    own = (1.0 - common) * adjusted.rows.T @ adjusted.rows + common * of_point.T @ of_point
    both, n_both = np.unique(member * (int(point.max()) + 1) + point, return_counts=True)
    together = np.bincount(both // (int(point.max()) + 1), n_both.astype(float) ** 2) / np.bincount(member)
    return own, 1.0 - common + common * together


def partner_share(scores: Floats, point: Ints) -> float:
    """Return the correlation, 0 to 1, of the scores (n,) of pairs that have one target `point` (n,) in common."""
    n_pairs = float(np.sum(np.bincount(point) ** 2)) - len(point)
    if n_pairs < FEWEST_SHARING:
        return 0.0
    squares = float(np.sum(scores**2))
    products = float(np.sum(np.bincount(point, scores) ** 2)) - squares
    return float(np.clip(products / n_pairs * len(point) / max(squares, 1e-300), 0.0, 1.0))


def bearing_patches(adjusted: Adjusted, member: Ints) -> Ints:
    """Return the numbers of the patches that the motion rests on, whose points weigh a tenth of the usual or more.

    What hardly takes part, rough or seen steeply, would tell how other places err together. The usual weight is the
    mean over all points, each counted by its weight.
    """
    weight = adjusted.weights
    mean = np.bincount(member, weight) / np.bincount(member)
    bearing = np.flatnonzero(mean >= LIGHT * np.sum(weight**2) / np.sum(weight))
    return bearing if len(bearing) >= FEWEST_BEARING else np.arange(len(mean))


def at_least(covariance: Floats, naive: Floats) -> Floats:
    """Return the covariance raised, in every direction of motion, to at least the naive one."""
    root = np.linalg.cholesky(naive + 1e-12 * np.diag(np.diag(naive)))
    whitened = np.linalg.solve(root, np.linalg.solve(root, covariance).T)
    values, vectors = np.linalg.eigh(0.5 * (whitened + whitened.T))
    raised = (vectors * np.maximum(values, 1.0)) @ vectors.T
    return root @ raised @ root.T
