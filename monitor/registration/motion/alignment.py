"""The iteration of ICP: match, weigh, solve, move, until the motion is settled to a micrometre.

Far off at first: pairs may be aside of each other as far as the search reaches, and Huber's weights keep every pair.
As the steps get shorter the pairs must stand over each other, and Tukey's weights drop what does not fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from monitor.registration.motion.held import FreeMotions
from monitor.registration.motion.matching import Matches, MatchLimits, Samples, compare_relief, match
from monitor.registration.motion.partners import Partners
from monitor.registration.motion.sampling import motion_rows
from monitor.registration.motion.sides import Side
from monitor.registration.motion.weights import huber_weights, residual_sigma, rounding_of
from monitor.robust import tukey_weights
from projects.model import Bools, Floats
from projects.transforms import apply, perturb

SHRINK = 0.5  # at most so much is the sideways limit reduced from one iteration to the next
STEPS_ASIDE = 5.0  # pairs may be aside by so many lengths of the last step
FINE_ANGLE_SHARE = 0.75  # of the angle between normals that is allowed once the pairs stand over each other
TURN_BACK = 0.7  # of the length of steps is kept when a step goes back
MOSTLY_OPPOSITE = 0.5  # of the points: so many see what looks the opposite way, and it is told
SETTLED_SHARE = 0.01  # a step below one hundredth of its own sigma changes nothing that could be known


@dataclass(frozen=True)
class Alignment:
    """Where the iteration ended: pose, pairs there, their weights and sigma, and what became of it."""

    T_target_source: Floats
    matches: Matches
    weights: Floats
    sigma: Floats
    centre: Floats
    converged: bool
    reason: str
    n_iterations: int


@dataclass(frozen=True)
class AlignmentRules:
    """What `align` is bound to: search `distance` [m], `angle` [rad], smallest `n_pairs`, `precision` [m].

    `damping` (Levenberg), in shares of the mean information, leaves motions that the shape hardly holds where they are.
    `locked` motions are not made at all.
    """

    distance: float
    angle: float
    n_pairs: int
    precision: float
    max_iterations: int
    damping: float = 0.0
    locked: FreeMotions | None = None


def weigh(matches: Matches, is_kept: Bools, fine: bool) -> tuple[Floats, Floats]:
    """Return robust weights (n,) and sigma (n,) [m] of the pairs; the scale is that of the pairs kept alone."""
    kept = is_kept[matches.source]
    sigma = residual_sigma(matches.residuals, matches.causes, kept, rounding_of(matches.points))
    u = matches.residuals / sigma
    return np.where(kept, tukey_weights(u) if fine else huber_weights(u), 0.0), sigma


def solve_motion(matches: Matches, weights: Floats, sigma: Floats, centre: Floats, damping: float = 0.0,
                 ) -> tuple[Floats, Floats]:  # fmt: skip
    """Return the motion (6,) [rad, m] about `centre` that lessens the residuals, and its normal matrix (6, 6)."""
    rows = motion_rows(matches.points, matches.normals, centre)
    lever = np.sqrt(np.mean(np.sum((matches.points - centre) ** 2, axis=1))) + 1e-300
    scale = np.repeat([1.0 / lever, 1.0], 3)
    weighted = rows * (weights / sigma**2)[:, None]
    normal_matrix = np.einsum("ni,nj->ij", weighted, rows)
    right = -np.einsum("ni,n->i", weighted, matches.residuals)
    scaled = normal_matrix * np.outer(scale, scale)
    scaled += damping * np.trace(scaled) / 6.0 * np.eye(6)
    # a motion that nothing holds (a plane's slide) is left at zero
    delta = scale * (np.linalg.pinv(scaled, rcond=1e-10, hermitian=True) @ (scale * right))
    return delta, normal_matrix


def solve_within(normal_matrix: Floats, delta: Floats, basis: Floats) -> Floats:
    """Return the motion (6,) of a `basis` (6, k) that lessens the residuals most, where `delta` is that of all six."""
    right = basis.T @ normal_matrix @ delta
    return np.asarray(basis @ np.linalg.solve(basis.T @ normal_matrix @ basis, right))


def small_motion(delta: Floats, points: Floats, centre: Floats) -> Floats:
    """Return the ways (n, 3) [m] that points go under a small motion about `centre`."""
    return delta[3:] + np.cross(delta[:3], points - centre)


def align(samples: Samples, target: Side, T_start: Floats, rules: AlignmentRules, *,
          is_kept: Bools | None = None, fine: bool = False, both_oriented: bool = True,
          partners: Partners | None = None, shared: Floats | None = None) -> Alignment:  # fmt: skip
    """Move the samples onto the target by point-to-plane ICP with robust weights, starting near.

    With `fine` the pairs must stand over each other from the beginning; `is_kept` (n samples) restricts what counts.
    `partners` of these samples are used, where given, once the steps are short. `shared` (n samples) is by what factor
    the variance of a sample's neighbourhood exceeds that of independent noise; it lessens the sample's weight.
    """
    kept = np.ones(len(samples.points), dtype=bool) if is_kept is None else is_kept
    T, pace, step = T_start, 1.0, np.inf
    aside = 0.0 if fine else rules.distance
    last_way: Floats = np.zeros((len(samples.points), 3))
    for iteration in range(1, rules.max_iterations + 1):
        angle = rules.angle * (FINE_ANGLE_SHARE if fine else 1.0)
        matches = match(samples, target, T, MatchLimits(rules.distance, aside, angle), both_oriented,
                        partners if fine else None)  # fmt: skip
        n_pairs = int(kept[matches.source].sum())
        if n_pairs < rules.n_pairs:
            reason = _say_too_few(samples, target, T, MatchLimits(rules.distance, aside, angle), n_pairs)
            return Alignment(T, matches, np.zeros(len(matches)), np.ones(len(matches)), np.zeros(3), False, reason,
                             iteration)  # fmt: skip
        if fine and samples.relief.any():
            matches = compare_relief(matches, samples, target)
        weights, sigma = weigh(matches, kept, fine)
        if shared is not None:
            weights = weights / shared[matches.source]
        centre = np.average(matches.points, axis=0, weights=weights)
        delta, normal_matrix = solve_motion(matches, weights, sigma, centre, rules.damping)
        if rules.locked is not None:
            delta = solve_within(normal_matrix, delta, rules.locked.complement(centre))
        way = small_motion(delta, apply(T, samples.points), centre)
        # where pairs swap to and fro the pose swings about a place without a zero: go there by ever shorter steps
        pace *= TURN_BACK if fine and np.sum(way * last_way) < 0.0 else 1.0
        step, last_way = pace * float(np.sqrt(np.mean(np.sum(way**2, axis=1)))), way
        if fine and step < max(rules.precision, SETTLED_SHARE * typical_sigma(normal_matrix, matches.points, centre)):
            return Alignment(T, matches, weights, sigma, centre, True, "", iteration)
        T = perturb(T, centre, pace * delta)
        aside = min(aside, max(SHRINK * aside, STEPS_ASIDE * step))
        fine = fine or aside < float(np.median(matches.tangential)) or aside < rules.precision
    reason = f"still moving by {1e6 * step:.1f} micrometres after {rules.max_iterations} iterations"
    return Alignment(T, matches, weights, sigma, centre, False, reason, rules.max_iterations)


def _say_too_few(samples: Samples, target: Side, T: Floats, limits: MatchLimits, n_pairs: int) -> str:
    """Return why there are too few pairs: nothing near, or what is near looks the opposite way."""
    n_samples = len(samples.points)
    reason = f"only {n_pairs} of {n_samples} points found a surface that looks the same way nearby"
    n_opposite = len(match(replace(samples, normals=-samples.normals), target, T, limits, both_oriented=True))
    if n_opposite < MOSTLY_OPPOSITE * n_samples:
        return reason
    return f"{reason}, and {n_opposite} one that looks the opposite way: one of the two is inside out, or a back side"


def typical_sigma(normal_matrix: Floats, points: Floats, centre: Floats) -> float:
    """Return the root mean square sigma [m] of the position of the points after the adjustment, noise independent."""
    covariance = np.linalg.pinv(normal_matrix, rcond=1e-12, hermitian=True)
    lever2 = np.mean((points - centre) ** 2, axis=0)
    rotation = np.array([lever2[1] + lever2[2], lever2[0] + lever2[2], lever2[0] + lever2[1]])
    return float(np.sqrt(np.trace(covariance[3:, 3:]) + rotation @ np.diag(covariance[:3, :3])))
