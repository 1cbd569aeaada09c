"""How well each scan of a network is placed: 6 x 6 covariances that know that neighbouring residuals err together.

In: the pairs, the ties and the solution at the end of an adjustment. Out: the covariance of every scan's motion. As for
two epochs (`covariance`), C = H^-1 B H^-1 with B from the correlation that the residuals show; here a scan's own error
field is the same in all pairs that it takes part in, but for the factor by which a pair's patches err more than others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from monitor.registration.motion.correlation import correlate, find_ranges, fit_correlation
from monitor.registration.motion.patch_field import sum_by
from monitor.registration.motion.patches import cut_patches
from monitor.registration.motion.sampling import motion_rows
from monitor.registration.network.equations import Pairs, Scales, Solution, prior_information
from monitor.robust import tukey_slope, tukey_weights
from projects.model import Floats, Ints

N_PATCHES = 120  # of one scan
PATCHES_PER_PARAMETER = 3  # of the motions that residuals are cleared of; with fewer nothing would be left of them
FEWEST_PATCHES = 12  # that tell a range of correlation
LEAST_SLOPE = 0.1  # of psi, in the mean of a pair


def network_covariance(
    pairs: Pairs, motions: Sequence[Floats], scales: Scales, solution: Solution, *, is_absolute: bool
) -> Floats:
    """Return the covariance (6 n, 6 n) of the motions of all scans about the origin, rad and m.

    Without control (`is_absolute` False) it is of the motions less their mean, since the whole is held by nothing. With
    it the poses as given say where scans are against each other, and nothing of the whole: that is control's alone.
    """
    n = len(motions)
    turned = _turn(pairs, motions)
    bread, meat = _tie_information(solution, scales, n)
    for key, (points, a, b, residuals) in turned.items():
        slopes = tukey_slope(residuals / scales.sigma)
        _add_pair(bread, key, pair_weight(key, points, scales) * _information(points, (a, b), slopes, scales.lever))
    meat[: 6 * n, : 6 * n] += sum((_score_covariance(turned, s, n, scales) for s in range(n)), np.zeros((6 * n, 6 * n)))
    inverse = np.linalg.pinv(bread, hermitian=True, rcond=1e-14)
    full = (inverse @ meat @ inverse)[: 6 * n, : 6 * n]
    if not is_absolute:
        free = np.kron(np.eye(n) - np.full((n, n), 1.0 / n), np.eye(6))
        full = free @ full @ free.T
    unit = np.tile(np.repeat([1.0 / scales.lever, 1.0], 3), n)
    return np.asarray(full * np.outer(unit, unit))


def mean_motion(covariance: Floats) -> Floats:
    """Return the covariance (6, 6) of the mean of the motions of all scans, from that of all (6 n, 6 n)."""
    n = len(covariance) // 6
    mean = np.kron(np.full((1, n), 1.0 / n), np.eye(6))
    return np.asarray(mean @ covariance @ mean.T)


Turned = dict[tuple[int, int], tuple[Floats, Floats, Floats, Floats]]


def _turn(pairs: Pairs, motions: Sequence[Floats]) -> Turned:
    """Return of each pair its points, both normals and residuals [m] in the common frame."""
    return {
        (i, j): (m.points @ motions[j][:3, :3].T + motions[j][:3, 3], m.normals_source @ motions[j][:3, :3].T,
                 m.normals_target @ motions[j][:3, :3].T, m.residuals)
        for (i, j), m in pairs.items()
    }  # fmt: skip


def pair_weight(key: tuple[int, int], points: Floats, scales: Scales) -> float:
    """Return the weight [1 / m2] of one residual of a pair of scans: its patches are its witnesses."""
    return scales.witness_share(key, points) / scales.sigma**2


def _tie_information(solution: Solution, scales: Scales, n: int) -> tuple[Floats, Floats]:
    """Return bread and meat of targets, control and prior, which are alike: their variances are stated."""
    u = len(solution.normal)
    information = np.zeros((u, u))
    if len(solution.equations.rows):
        rows = solution.equations.rows
        information += np.einsum("kau,kab,kbv->uv", rows, np.linalg.inv(solution.scaled), rows, optimize=True)
    information[: 6 * n, : 6 * n] += prior_information(scales, n)
    return information, information.copy()


def _information(points: Floats, normals: tuple[Floats, Floats], slopes: Floats, lever: float) -> Floats:
    """Return the information (6, 6) that the shape of a pair holds, free of the noise of both its normals.

    It is the pull with which residuals answer a motion, `slopes` (n,) of psi each: what is held by places that fit
    badly alone (a turn in the plane of a wall, by the edges on it) is held by little. With few points noise can make
    it indefinite; what is negative is no information.
    """
    a, b = normals
    unit = np.repeat([1.0 / lever, 1.0], 3)
    one, other = motion_rows(points, a, np.zeros(3)) * unit, motion_rows(points, b, np.zeros(3)) * unit
    cross = (one * slopes[:, None]).T @ other
    values, vectors = np.linalg.eigh(0.5 * (cross + cross.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _add_pair(matrix: Floats, key: tuple[int, int], block: Floats) -> None:
    """Add the block of a pair of scans to the normal matrix, which is made here and nobody else's."""
    i, j = (slice(6 * k, 6 * k + 6) for k in key)
    matrix[i, i] += block
    matrix[j, j] += block
    matrix[i, j] -= block
    matrix[j, i] -= block


def _score_covariance(turned: Turned, scan: int, n: int, scales: Scales) -> Floats:
    """Return B (6 n, 6 n) of one scan's own error: half of what its residuals scatter, with their correlation."""
    mine = {key: value for key, value in turned.items() if scan in key}
    if not mine:
        return np.zeros((6 * n, 6 * n))
    points = np.concatenate([v[0] for v in mine.values()])
    member, cell = _patches(points, np.concatenate([v[1] for v in mine.values()]))
    count = np.bincount(member).astype(float)
    scores, y, own = np.zeros((len(count), 6 * n)), [], np.zeros((6 * n, 6 * n))
    absorbed: dict[int, Floats] = {}  # by the scan's motion against each other one
    unit, at = np.repeat([1.0 / scales.lever, 1.0], 3), 0
    for key, (p, a, b, residuals) in mine.items():
        other = key[1] if key[0] == scan else key[0]
        which = member[at : at + len(p)]
        at += len(p)
        root = float(np.sqrt(scales.pair_factors.get(key, 1.0)))  # by which residuals of this pair are the larger
        row = motion_rows(p, 0.5 * (a + b), np.zeros(3)) * unit
        psi = residuals / scales.sigma
        slope = max(float(np.mean(tukey_slope(psi))), LEAST_SLOPE)
        weight = slope * pair_weight(key, p, scales) * root
        sums = weight * _sum_into(which, row, len(count))
        scores[:, 6 * scan : 6 * scan + 6] += sums
        scores[:, 6 * other : 6 * other + 6] -= sums
        absorbed[other] = absorbed.get(other, np.zeros((len(count), 6))) + _sum_into(which, row / root, len(count))
        _add_pair(own, key, weight**2 * row.T @ row)
        sign = 1.0 if key[0] == scan else -1.0
        y.append(sign * scales.sigma / (root * slope) * psi * tukey_weights(psi))
    values = np.concatenate(y)
    if len(count) < FEWEST_PATCHES:
        return np.asarray(np.mean(values**2) * scores.T @ scores)
    means = np.bincount(member, values) / count
    middles = sum_by(member, points) / count[:, None]
    distances = np.linalg.norm(middles[:, None] - middles[None], axis=2)
    correlations = {r: correlate(distances, r) for r in find_ranges(cell, float(distances.max()))}
    fields = {r: scores.T @ R @ scores for r, R in correlations.items()}
    models = fit_correlation(means, absorbed_motions(absorbed) / count[:, None], count, correlations)
    return np.asarray(sum(0.5 * m.probability * (m.noise2 * own + m.field2 * fields[m.range]) for m in models))


def absorbed_motions(absorbed: Mapping[int, Floats]) -> Floats:
    """Return what the fit could absorb in the patches (p, k): the scan's motion against all others, and against each of
    those that share most with it, as long as there are three patches for each of k parameters."""
    own = np.sum(list(absorbed.values()), axis=0)
    most = max(len(own) // (6 * PATCHES_PER_PARAMETER) - 1, 0)
    size = {other: float(np.abs(rows).sum()) for other, rows in absorbed.items()}
    largest = sorted(absorbed, key=lambda other: (-size[other], other))[:most]
    return np.hstack([own, *(absorbed[other] for other in largest)])


def _patches(points: Floats, normals: Floats) -> tuple[Ints, float]:
    """Return the patch (k,) of each point, numbered without gaps, and their edge [m]."""
    grid = cut_patches(points, normals, len(points) / N_PATCHES)
    return np.unique(grid.numbers(points, normals), return_inverse=True)[1], grid.cell


def _sum_into(member: Ints, values: Floats, n: int) -> Floats:
    """Return the sums (n, k) of the rows of `values` over equal `member`."""
    return np.stack([np.bincount(member, column, n) for column in values.T], axis=1)
