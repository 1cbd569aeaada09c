"""The normal equations of many scans: point-to-plane pairs, targets and control points as observations of known weight.

In: the scans' present motions, the pairs between them, the ties. Out: the normal matrix and the step that lessens all
residuals at once (hybrid adjustment after Akca & Gruen 2007, as `papers/002` proposes).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2

from monitor.registration.motion.matching import Matches
from monitor.registration.motion.sampling import cell_numbers, motion_rows
from monitor.registration.motion.six_parameters import point_rows
from monitor.registration.motion.weights import huber_weights
from monitor.registration.network.ties import Ties
from monitor.robust import tukey_weights
from projects.model import Bools, Floats, Ints
from projects.transforms import apply

Pairs = dict[tuple[int, int], Matches]


@dataclass(frozen=True)
class Scales:
    """What weights rest on, in metres.

    Attributes
    ----------
    sigma : of the distances of pairs.
    prior : (2,) of each scan's pose as given, turns at the `lever` and ways.
    lever : root mean square distance of the points from the origin.
    patch : edge of the cube within which distances err together; pairs in it are one witness of variance
        `pair_factors` sigma^2.
    fine : pairs that do not fit are dropped (Tukey), no longer only held down (Huber).
    pair_factors : of each pair of scans; 1 where left out.
    pair_sharers : of each pair of scans, how many scans share a patch of theirs; 1 where left out. m scans bear
        m - 1 witnesses, and their m (m - 1) / 2 pairs, matched both ways, would be taken for m times as many.
    in_control : scans that control holds together: of their motion in common it tells alone, the poses as given say
        only how they stand to each other.
    """

    sigma: float
    prior: Floats
    lever: float
    patch: float
    fine: bool
    pair_factors: Mapping[tuple[int, int], float] = field(default_factory=dict)
    pair_sharers: Mapping[tuple[int, int], float] = field(default_factory=dict)
    in_control: tuple[int, ...] = ()

    def witness_share(self, key: tuple[int, int], points: Floats) -> float:
        """Return the weight, in units of 1 / sigma^2, of each of a pair's points (k, 3): its patches are witnesses."""
        n_patches = len(np.unique(cell_numbers(points, self.patch)))
        return n_patches / len(points) / self.pair_factors.get(key, 1.0) / self.pair_sharers.get(key, 1.0)


@dataclass(frozen=True)
class TieScales:
    """Variance components of targets and of control points: by how much their stated variances are raised."""

    targets: float = 1.0
    control: float = 1.0


def pair_equations(matches: Pairs, motions: Sequence[Floats], scales: Scales) -> tuple[Floats, Floats]:
    """Return normal matrix (6 n, 6 n) and right side (6 n,) of the pairs, in units of sigma, rotations at the lever."""
    n = len(motions)
    unit = np.repeat([1.0 / scales.lever, 1.0], 3)
    normal, right = np.zeros((n, 6, n, 6)), np.zeros((n, 6))
    weigh = tukey_weights if scales.fine else huber_weights
    for (i, j), pair in matches.items():
        T = motions[j]
        points, normals = pair.points @ T[:3, :3].T + T[:3, 3], pair.normals @ T[:3, :3].T
        rows = motion_rows(points, normals, np.zeros(3)) * unit
        weights = weigh(pair.residuals / scales.sigma) * scales.witness_share((i, j), points)
        block = (rows * weights[:, None]).T @ rows
        pull = rows.T @ (weights * pair.residuals)
        normal[i, :, i] += block
        normal[j, :, j] += block
        normal[i, :, j] -= block
        normal[j, :, i] -= block
        right[i] -= pull
        right[j] += pull
    return normal.reshape(6 * n, 6 * n), right.ravel()


@dataclass(frozen=True)
class TieEquations:
    """Linearized ties: rows (k, 3, u) over all unknowns, misclosures (k, 3) [m], covariances (k, 3, 3) [m2].

    The first `n_ties` are targets in scans, the rest control points; `index` tells which tie or point.
    """

    rows: Floats
    misclosures: Floats
    covariances: Floats
    n_ties: int
    index: Ints


def tie_equations(ties: Ties, motions: Sequence[Floats], places: Floats, lever: float) -> TieEquations:
    """Return the ties at the present motions and places (m, 3) [m] of the points, without blunders.

    Unknowns: six of each scan (rotations as metres at the lever), then three of each point.
    """
    n, m = len(motions), len(places)
    which, held = np.flatnonzero(ties.kept), np.flatnonzero(ties.has_control)
    rows = np.zeros((len(which) + len(held), 3, 6 * n + 3 * m))
    misclosures, covariances = np.zeros((len(rows), 3)), np.zeros((len(rows), 3, 3))
    for r, k in enumerate(which):
        i, p, T = int(ties.scan[k]), int(ties.point[k]), motions[int(ties.scan[k])]
        at = apply(T, ties.positions[k])
        rows[r, :, 6 * i : 6 * i + 6] = point_rows(at[None], np.zeros(3))[0] / np.repeat([lever, 1.0], 3)
        rows[r, :, 6 * n + 3 * p : 6 * n + 3 * p + 3] = -np.eye(3)
        misclosures[r] = at - places[p]
        covariances[r] = T[:3, :3] @ ties.covariances[k] @ T[:3, :3].T
    for r, p in enumerate(held.tolist(), start=len(which)):
        rows[r, :, 6 * n + 3 * p : 6 * n + 3 * p + 3] = np.eye(3)
        misclosures[r] = places[p] - ties.control[p]
        covariances[r] = np.eye(3) * ties.sigma_control[p] ** 2
    return TieEquations(rows, misclosures, covariances, len(which), np.concatenate([which, held]))


@dataclass(frozen=True)
class Solution:
    """A step: `delta` (n, 6) [rad, m] of the scans, `shift` (m, 3) [m] of the points, and the normal matrix that it
    rests on, in 1 / m2 with rotations at the lever."""

    delta: Floats
    shift: Floats
    normal: Floats
    equations: TieEquations
    scaled: Floats


def solve_network(
    pairs: tuple[Floats, Floats], ties: Ties, places: Floats, motions: Sequence[Floats],
    scales: tuple[Scales, TieScales],
) -> Solution:  # fmt: skip
    """Return the step that lessens the residuals of pairs, targets, control and the poses as given."""
    scale, of_ties = scales
    n, m = len(motions), len(places)
    equations = tie_equations(ties, motions, places, scale.lever)
    factor = np.where(np.arange(len(equations.rows)) < equations.n_ties, of_ties.targets, of_ties.control)
    scaled = equations.covariances * factor[:, None, None]
    weights = np.linalg.inv(scaled) if len(scaled) else scaled
    u = 6 * n + 3 * m
    normal, right = np.zeros((u, u)), np.zeros(u)
    normal[: 6 * n, : 6 * n] = pairs[0] / scale.sigma**2
    right[: 6 * n] = pairs[1] / scale.sigma**2
    weighted = np.einsum("kab,kbu->kau", weights, equations.rows)
    normal += np.einsum("kau,kav->uv", equations.rows, weighted, optimize=True)
    right -= np.einsum("kau,ka->u", weighted, equations.misclosures)
    gone = np.concatenate([as_motion(T, scale.lever) for T in motions])
    hold = prior_information(scale, n)
    normal[: 6 * n, : 6 * n] += hold
    right[: 6 * n] -= hold @ gone
    lonely = np.flatnonzero(np.diag(normal) == 0.0)  # a point whose ties are all blunders
    normal[lonely, lonely] = prior_weights(scale, 1).min()
    step = np.linalg.solve(normal, right)
    unit = np.repeat([1.0 / scale.lever, 1.0], 3)
    return Solution(step[: 6 * n].reshape(n, 6) * unit, step[6 * n :].reshape(m, 3), normal, equations, scaled)


def prior_weights(scales: Scales, n: int) -> Floats:
    """Return the weights (6 n,) [1 / m2] of the poses as given."""
    return np.tile(np.repeat(1.0 / scales.prior**2, 3), n)


def prior_information(scales: Scales, n: int) -> Floats:
    """Return the information (6 n, 6 n) [1 / m2] of the poses as given, none of what scans do in common in control."""
    return np.kron(_less_common(scales, n), np.diag(prior_weights(scales, 1)))


def _less_common(scales: Scales, n: int) -> Floats:
    """Return the matrix (n, n) that takes from each scan in control the mean of all of them."""
    common, held = np.zeros((n, n)), list(scales.in_control)
    common[np.ix_(held, held)] = 1.0 / max(len(held), 1)
    return np.asarray(np.eye(n) - common)


def estimate_prior(solution: Solution, motions: Sequence[Floats], scales: Scales) -> Floats:
    """Return one sigma (2,) [m] of the poses as given, the roots of their variance components, turns and ways.

    With r the redundancy of the turns, of what pairs and ties tell better than the poses do, sum delta^2 / (r - 2) is
    the mean of their variance given the motions; infinite where too little is told. So for the ways.
    """
    n = len(motions)
    alone = np.kron(_less_common(scales, n), np.eye(6))
    left = np.diag(np.linalg.inv(solution.normal)[: 6 * n, : 6 * n] @ prior_information(scales, n))
    gone = alone @ np.concatenate([as_motion(T, scales.lever) for T in motions])
    redundancy, square = ((part.reshape(n, 2, 3)).sum(axis=(0, 2)) for part in (np.diag(alone) - left, gone**2))
    told = redundancy > LEAST_TOLD
    return np.where(told, np.sqrt(square / np.where(told, redundancy - 2.0, 1.0)), np.inf)


def as_motion(T: Floats, lever: float) -> Floats:
    """Return the motion (6,) that a transform has made so far, rotations as metres at the lever."""
    R = T[:3, :3]
    w = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return np.concatenate([w * lever, T[:3, 3]])


def tie_statistics(solution: Solution) -> tuple[Floats, Floats]:
    """Return for each tie and control point v' Q_vv^-1 v (k,), chi2 of 3 where it is no blunder, and its redundancy
    (k,), the share 0 to 1 of it that others check (Baarda 1968)."""
    equations, k = solution.equations, len(solution.equations.rows)
    if not k:
        return np.empty(0), np.empty(0)
    inverse = np.linalg.inv(solution.normal)
    adjusted = np.einsum("kau,uv,kbv->kab", equations.rows, inverse, equations.rows, optimize=True)
    left = solution.scaled - adjusted
    statistics, redundancy = np.zeros(k), np.zeros(k)
    for r in range(k):
        root = np.linalg.cholesky(np.linalg.inv(solution.scaled[r]))
        values, vectors = np.linalg.eigh(root.T @ left[r] @ root)
        v = vectors.T @ (root.T @ equations.misclosures[r])
        checked = values > LEAST_REDUNDANCY
        redundancy[r] = float(np.clip(values, 0.0, 1.0).mean())
        statistics[r] = as_of_three(float(np.sum(v[checked] ** 2 / values[checked])), int(checked.sum()))
    return statistics, redundancy


def as_of_three(statistic: float, freedom: int) -> float:
    """Return the chi2 of three that chance exceeds as often as a chi2 of `freedom`, three or fewer directions that are
    checked; 0 where none is."""
    if freedom in (0, 3):
        return statistic
    told = min(statistic, MOST_TOLD)
    return float(chi2.isf(chi2.sf(told, freedom), 3)) + statistic - told


LEAST_TOLD = 4.0  # of turns or of ways: below that the variance itself has no variance (inverse chi2)
MOST_TOLD = 1000.0  # of a chi2: beyond, its probability has no figure; there one of any freedom grows as the others
LEAST_REDUNDANCY = 0.02  # of a direction of a target: what no other observation checks says nothing


def uncontrolled(redundancy: Floats) -> Bools:
    """Return which observations (k,) no other checks: a blunder there would go unnoticed."""
    return redundancy < 5.0 * LEAST_REDUNDANCY
