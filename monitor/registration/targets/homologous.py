"""Homologous points: which points of two sets are the same, whatever the names and however the sets are turned.

In: points in two frames, wrong and missing ones among them. Out: the pairs that agree in all invariants of a rigid
motion. `papers/004`, section 2.2: distances and angles between all points, with each accepted point as origin in turn.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from math import comb, perm

import numpy as np
from scipy.stats import norm

from monitor.registration.motion.six_parameters import ACROSS_SIGMAS, closest_motion, point_rows, require_spread
from projects.errors import RegistrationError
from projects.model import Bools, Floats, Ints
from projects.transforms import apply

REFUSED_BY_CHANCE = 0.001  # chance that a right set of pairs fails one of its many tests
FOUND_BY_CHANCE = 0.01  # expected number of sets of this size that agree though they are wrong; more is refused
N_BASES = 20_000  # pairs of equal distances that are tried, rarest distances first
N_TRIPLES = 1_000  # that are tried: so many agree only where sigmas are so poor that chance makes all of them
N_ROUNDS = 6


@dataclass(frozen=True)
class PointPairs:
    """Row numbers of the points that are the same, (k,) each, and how many such pairs chance would be expected to make.

    `n_second` is the number of pairs of the best answer that moves the points elsewhere, 0 where there is none.
    """

    source: Ints
    target: Ints
    T_target_source: Floats
    expected_by_chance: float
    n_second: int

    def __len__(self) -> int:
        return len(self.source)


@dataclass(frozen=True)
class _Sets:
    """Both sets of points with sigmas and distances, and how many sigma a difference may have."""

    source: Floats
    target: Floats
    sigma_source: Floats
    sigma_target: Floats
    apart_source: Floats
    apart_target: Floats
    limit: float

    def agree(self, i: int, j: int) -> Bools:
        """Return (n, m) whether source point p lies as far from i as target point q from j."""
        own = self.sigma_source[i] ** 2 + self.sigma_target[j] ** 2
        sigma2 = own + self.sigma_source[:, None] ** 2 + self.sigma_target[None, :] ** 2
        apart = np.abs(self.apart_source[i][:, None] - self.apart_target[j][None, :])
        agrees = apart <= self.limit * np.sqrt(sigma2)
        agrees[i, :], agrees[:, j] = False, False
        return agrees


def match_points(
    source: Floats, target: Floats, sigma_source: float | Floats = 0.001, sigma_target: float | Floats = 0.001
) -> PointPairs:
    """Find the points that two sets have in common.

    Parameters
    ----------
    source, target : (n, 3) and (m, 3) m, in any order, any rotation between them.
    sigma_source, sigma_target : m, one sigma of a coordinate, one for all or one for each point.

    Returns
    -------
    PointPairs
        Every pair agrees with every other one in distance, angle and handedness.

    Raises
    ------
    RegistrationError
        Where fewer than three points are the same, where they lie on one line, where chance would make as many pairs,
        where another motion explains the points as well (a symmetric arrangement), or where their mirror image does and
        explains more of them.

    Notes
    -----
    Three points with the same three distances give a motion; it is confirmed by the other points and verified by
    invariants. An answer with k pairs is refused where random points would be expected to give more than
    `FOUND_BY_CHANCE` of them, C(n, k) P(m, k) (2 tolerance / extent)^(3k - 6).
    """
    sets = _prepare(source, target, sigma_source, sigma_target)
    found = _find_all(sets)
    n_found = len(found[0][0]) if found else 0
    if n_found < min(len(sets.source), len(sets.target)) and (n_image := _count_mirrored(sets)) > max(n_found, 3):
        raise RegistrationError(
            f"the points are mirrored: {n_image} of {len(sets.source)} and {len(sets.target)} agree as their mirror "
            f"image, {n_found} as they are; does an axis point the other way in one of the files, or are two exchanged?"
        )
    return _conclude(sets, found)


def _conclude(sets: _Sets, found: list[tuple[Ints, Ints, Floats]]) -> PointPairs:
    """Return the best of the answers, or raise where it does not hold."""
    if not found:
        raise RegistrationError(
            f"no three of {len(sets.source)} points agree in their distances with three of {len(sets.target)}; "
            "more targets that both see are needed"
        )
    best = found[0]
    moved = apply(best[2], sets.source[best[0]])
    others = [f for f in found[1:] if _moves_elsewhere(f[2], sets, best[0], moved)]
    n_second = max((len(f[0]) for f in others), default=0)
    k, chance = len(best[0]), expected_by_chance(sets, len(best[0]))
    require_spread(sets.target[best[1]], sets.sigma_target[best[1]])
    if chance > FOUND_BY_CHANCE:
        raise RegistrationError(
            f"{k} of {len(sets.source)} and {len(sets.target)} points agree, but chance would make {chance:.2g} such "
            "sets; more targets that both see are needed"
        )
    if n_second >= k or (n_second == k - 1 and expected_by_chance(sets, n_second) <= FOUND_BY_CHANCE):
        raise RegistrationError(
            f"the arrangement of the points is ambiguous: {k} pairs agree, and {n_second} with another motion; "
            "place targets less regularly"
        )
    return PointPairs(best[0], best[1], best[2], chance, n_second)


def verify_pairs(
    source: Floats, target: Floats, sigma_source: float | Floats = 0.001, sigma_target: float | Floats = 0.001
) -> Bools:
    """Return which of given pairs (n,) agree with all others, the worst being dropped until all do.

    Row k of `source` (n, 3) is held to be row k of `target` (n, 3). With each pair as origin in turn, the distances to
    all others, the angles between all others as seen from it, and their handedness must be the same on both sides.
    """
    a, b = (np.broadcast_to(np.asarray(s, dtype=float), len(source)) for s in (sigma_source, sigma_target))
    keep = np.arange(len(source))
    limit = _limit(len(source))
    while len(keep) >= 3:
        fails = _failures(source[keep], target[keep], np.hypot(a[keep], b[keep]), limit)
        if not fails.any():
            break
        keep = np.delete(keep, np.argmax(fails))
    accepted = np.zeros(len(source), dtype=bool)
    accepted[keep if len(keep) >= 3 else keep[:0]] = True
    return accepted


def expected_by_chance(sets: _Sets, k: int) -> float:
    """Return the expected number of sets of k pairs that agree though no point is the same."""
    n, m = len(sets.source), len(sets.target)
    extent = float(np.sqrt(np.mean(sets.apart_target[np.triu_indices(m, 1)] ** 2)))
    tolerance = sets.limit * 2.0**0.5 * float(np.hypot(np.median(sets.sigma_source), np.median(sets.sigma_target)))
    return comb(n, k) * perm(m, k) * min(2.0 * tolerance / extent, 1.0) ** (3 * k - 6)


def _prepare(source: Floats, target: Floats, sigma_source: float | Floats, sigma_target: float | Floats) -> _Sets:
    """Return both sets, or raise where one has too few points."""
    a, b = np.asarray(source, dtype=float).reshape(-1, 3), np.asarray(target, dtype=float).reshape(-1, 3)
    if min(len(a), len(b)) < 3:
        raise RegistrationError(f"{len(a)} and {len(b)} points; three or more on both sides are needed")
    sigma_a, sigma_b = (
        np.broadcast_to(np.asarray(s, float), len(p)) for s, p in ((sigma_source, a), (sigma_target, b))
    )
    return _Sets(a, b, sigma_a, sigma_b, _distances(a), _distances(b), _limit(min(len(a), len(b))))


def _limit(n: int) -> float:
    """Return how many sigma a difference may have, so that n right points seldom fail one of their tests."""
    return float(norm.isf(0.5 * REFUSED_BY_CHANCE / max(n * (n - 1) // 2, 1)))


def _distances(points: Floats) -> Floats:
    return np.asarray(np.linalg.norm(points[:, None] - points[None], axis=2))


def _find_all(sets: _Sets) -> list[tuple[Ints, Ints, Floats]]:
    """Return the answers (rows of source, rows of target, motion), most pairs first, then the least residual."""
    answers: list[tuple[Ints, Ints, Floats]] = []
    explained: list[dict[int, int]] = []
    for triple in islice(_triples(sets), N_TRIPLES):
        if any(all(known.get(i) == j for i, j in triple) for known in explained):
            continue
        answer = _confirm(sets, triple, max((len(a[0]) for a in answers), default=3) - 1)
        if answer is not None:
            explained.append(dict(zip(answer[0].tolist(), answer[1].tolist(), strict=True)))
            answers.append(answer)
    return sorted(answers, key=lambda f: (-len(f[0]), _misfit(sets, f)))


def _count_mirrored(sets: _Sets) -> int:
    """Return how many pairs agree once one set is mirrored, 0 where they do not hold."""
    image = replace(sets, source=sets.source * np.array([-1.0, 1.0, 1.0]))
    try:
        return len(_conclude(image, _find_all(image)))
    except RegistrationError:
        return 0


def _misfit(sets: _Sets, answer: tuple[Ints, Ints, Floats]) -> float:
    i, j, T = answer
    return float(np.mean((apply(T, sets.source[i]) - sets.target[j]) ** 2))


def _triples(sets: _Sets) -> Iterator[tuple[tuple[int, int], tuple[int, int], tuple[int, int]]]:
    """Yield three pairs each whose three distances agree, those with rare distances first."""
    n = len(sets.source)
    order = np.sort(sets.apart_target[np.triu_indices(len(sets.target), 1)])
    tolerance = sets.limit * 2.0**0.5 * np.hypot(sets.sigma_source.max(), sets.sigma_target.max())
    agree = np.searchsorted(order, sets.apart_source + tolerance) - np.searchsorted(
        order, sets.apart_source - tolerance
    )
    rows, columns = np.triu_indices(n, 1)
    n_tried = 0
    for which in np.argsort(agree[rows, columns], kind="stable"):
        i, k = int(rows[which]), int(columns[which])
        if not agree[i, k]:
            continue
        for j in range(len(sets.target)):
            first = sets.agree(i, j)
            for m in np.flatnonzero(first[k]):
                n_tried += 1
                both = first & sets.agree(k, int(m))
                for p, q in zip(*np.nonzero(both), strict=True):
                    yield (i, j), (k, int(m)), (int(p), int(q))
        if n_tried > N_BASES:
            return


def _confirm(sets: _Sets, triple: tuple[tuple[int, int], ...], fewest: int) -> tuple[Ints, Ints, Floats] | None:
    """Return all pairs that agree with the motion of three, verified, or None where fewer than `fewest` remain."""
    i, j = np.array(triple).T
    for _ in range(N_ROUNDS):
        before = set(zip(i.tolist(), j.tolist(), strict=True))
        i, j = _pair_up(sets, i, j)
        if len(i) < max(fewest, 3) or before == set(zip(i.tolist(), j.tolist(), strict=True)):
            break
    if len(i) < max(fewest, 3):
        return None
    accepted = verify_pairs(sets.source[i], sets.target[j], sets.sigma_source[i], sets.sigma_target[j])
    i, j = i[accepted], j[accepted]
    if len(i) < max(fewest, 3):
        return None
    return i, j, closest_motion(sets.source[i], sets.target[j], np.ones(len(i)))


def _pair_up(sets: _Sets, i: Ints, j: Ints) -> tuple[Ints, Ints]:
    """Return the rows of points that lie on each other, mutually nearest, under the motion of the pairs (i, j)."""
    T = closest_motion(sets.source[i], sets.target[j], np.ones(len(i)))
    moved = apply(T, sets.source)
    apart = np.linalg.norm(moved[:, None] - sets.target[None], axis=2)
    rows, nearest = np.arange(len(apart)), apart.argmin(axis=1)
    sigma2 = np.hypot(sets.sigma_source, sets.sigma_target[nearest]) ** 2
    centre = moved[i].mean(axis=0)
    held, all_rows = point_rows(moved[i], centre), point_rows(moved, centre)
    covariance = np.linalg.pinv(np.einsum("nai,naj->ij", held, held), hermitian=True) * sigma2[i].mean()
    # what is far from the pairs moves with the uncertainty of their motion
    sigma2 = sigma2 + np.linalg.norm(np.einsum("nai,ij,nbj->nab", all_rows, covariance, all_rows), ord=2, axis=(1, 2))
    keep = (apart[rows, nearest] <= sets.limit * np.sqrt(sigma2)) & (apart.argmin(axis=0)[nearest] == rows)
    return rows[keep], nearest[keep]


def _moves_elsewhere(T: Floats, sets: _Sets, rows: Ints, moved: Floats) -> bool:
    """Return whether a motion brings the points of the best answer to other places than `moved`."""
    apart = np.linalg.norm(apply(T, sets.source[rows]) - moved, axis=1)
    return bool((apart > 2.0 * sets.limit * np.hypot(sets.sigma_source[rows], sets.sigma_target.max())).any())


def _failures(source: Floats, target: Floats, sigma: Floats, limit: float) -> Ints:
    """Return how many tests each pair fails: distances, angles seen from each origin, handedness."""
    n = len(source)
    fails = np.zeros(n, dtype=int)
    apart, pair_sigma = _distances(source) - _distances(target), np.hypot(sigma[:, None], sigma[None])
    fails += (np.abs(apart) > limit * pair_sigma).sum(axis=1)
    for origin in range(n):
        others = np.delete(np.arange(n), origin)
        angle, sigma_angle = _angle_differences(source, target, sigma, origin, others)
        wrong = np.abs(angle) > limit * sigma_angle
        fails[others] += wrong.sum(axis=1)
        fails[origin] += wrong.sum() // 2
        fails[others] += _mirrored(source[others] - source[origin], target[others] - target[origin], sigma[others])
    return fails


def _angle_differences(
    source: Floats, target: Floats, sigma: Floats, origin: int, others: Ints
) -> tuple[Floats, Floats]:
    """Return the differences (k, k) [rad] of the angles between all others seen from the origin, and their sigma."""
    a, b = source[others] - source[origin], target[others] - target[origin]
    length = np.linalg.norm(b, axis=1)
    reach = np.maximum(length, 1e-12)
    sigma2 = (sigma[others] / reach) ** 2
    from_origin = sigma[origin] * (1.0 / reach[:, None] + 1.0 / reach[None])
    return _angles(a) - _angles(b), np.sqrt(sigma2[:, None] + sigma2[None] + from_origin**2)


def _angles(vectors: Floats) -> Floats:
    """Return the angles (k, k) [rad] between vectors (k, 3)."""
    cross = np.linalg.norm(np.cross(vectors[:, None], vectors[None]), axis=2)
    return np.arctan2(cross, vectors @ vectors.T)


def _mirrored(a: Floats, b: Floats, sigma: Floats) -> Ints:
    """Return (k,) whether each vector lies on the other side of the widest pair's plane, by more than its sigma."""
    spread = np.linalg.norm(np.cross(b[:, None], b[None]), axis=2)
    p, q = np.unravel_index(int(spread.argmax()), spread.shape)
    heights = []
    for v in (a, b):
        normal = np.cross(v[p], v[q])
        heights.append(v @ (normal / max(np.linalg.norm(normal), 1e-300)))
    first, second = heights
    is_off = np.minimum(np.abs(first), np.abs(second)) > ACROSS_SIGMAS * sigma
    return (is_off & (first * second < 0.0)).astype(int)
