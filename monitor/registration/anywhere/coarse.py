"""Registration from anywhere, by shape alone: for objects that were moved, and scans whose stations nobody knows.

In: two surfaces or clouds with oriented normals, in any two frames. Out: a `CoarseAlignment` with the pose, how well it
explains the shapes, and how well the best other pose does. Pairs of places that look alike are mostly wrong; right ones
agree with each other in their distances and normals (second-order compatibility, Chen et al. 2022), from which poses
are guessed, refined by ICP, and judged by what they explain and by what they contradict.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from monitor.registration.anywhere.shape_features import Places, choose_cell, find_places, pair_alike
from monitor.registration.motion.alignment import AlignmentRules, align
from monitor.registration.motion.icp import IcpSettings, Within, find_centre, register
from monitor.registration.motion.matching import make_samples
from monitor.registration.motion.sides import Side, prepare_side
from projects.errors import ParameterError, RegistrationError
from projects.model import Floats, Ints, PointCloud, Registration, Surface
from projects.transforms import apply, invert, rotate

CLOSE_CELLS = 1.5  # distances of two right pairs differ by no more
APART_CELLS = 4.0  # nearer pairs say little about a pose
SAME_TURN = np.cos(np.radians(35.0))
N_SEEDS, N_WITNESSES, N_GUESSES = 300, 24, 12
DISTINCT_CELLS = 4.0  # poses that move the shape by less, in the mean, are one
NEAR_CELLS = 3.0  # the search of the ICP that refines a guess
FITS = 4.0  # sigmas: a place nearer to the other surface is explained
LOOKS_ALIKE = np.cos(np.radians(40.0))
MOST_AMBIGUOUS = 0.9  # of the best pose's score: another pose with more explains the shapes as well
CLOSE = 0.6  # of the best score: another pose with more casts doubt on it; right ones of real scans had 0.3 at most
LEAST_EXPLAINED = 0.15  # of the smaller shape
FEWEST = 10  # usable points of a side


@dataclass(frozen=True)
class CoarseAlignment:
    """Where a shape belongs on another.

    Attributes
    ----------
    T_target_source : (4, 4).
    score : share of the places of the smaller shape that the pose explains, less those that it contradicts.
    ambiguity : score of the best other pose over this score; near 1 where the shapes do not tell which is right.
    is_unique : whether the pose may be built upon; else `reason` says why not.
    doubt : which other pose explains nearly as much, and how much; "" where none does.
    """

    T_target_source: Floats
    score: float
    ambiguity: float
    is_unique: bool
    reason: str
    doubt: str = ""


@dataclass(frozen=True)
class Shape:
    """A side with its places, and the station it was seen from (3,) [m], None where it is not one."""

    side: Side
    places: Places
    station: Floats | None


def align_coarsely(source: Surface | PointCloud, target: Surface | PointCloud) -> CoarseAlignment:
    """Find the pose of a shape on another without any start.

    Parameters
    ----------
    source, target : in metres, each in any frame, with oriented normals. A cloud whose `origins` are one station (3,)
        is judged also by what that station saw through.

    Raises
    ------
    ParameterError
        For clouds without normals.
    RegistrationError
        Where too little of one can be used.
    """
    shifts = find_centre(source), find_centre(target)
    sides = prepare_oriented(source, shifts[0]), prepare_oriented(target, shifts[1])
    if min(map(len, sides)) < FEWEST:
        raise RegistrationError(
            f"{len(sides[0])} and {len(sides[1])} usable points are too few to find a pose by shape; where all corners "
            "of a mesh lie on free edges its faces do not hang together: join the corners that they share"
        )
    cell = choose_cell(sides)
    shapes = [Shape(side, find_places(side, cell), station_of(noun, shift))
              for side, noun, shift in zip(sides, (source, target), shifts, strict=True)]  # fmt: skip
    found = align_shapes(shapes[0], shapes[1], cell)
    to_source, from_target = np.eye(4), np.eye(4)
    to_source[:3, 3], from_target[:3, 3] = -shifts[0], shifts[1]
    return replace(found, T_target_source=from_target @ found.T_target_source @ to_source)


def register_from_anywhere(source: Surface | PointCloud, target: Surface | PointCloud,
                           settings: IcpSettings | None = None, within: Within | None = None,
                           ) -> tuple[Registration, CoarseAlignment]:  # fmt: skip
    """Return the fine registration from the pose found by shape alone; not converged where that is not unique, in doubt
    where another pose comes close."""
    coarse = align_coarsely(source, target)
    start = coarse.T_target_source
    fine = register(source, target, settings, T_target_source=start, T_given=np.eye(4), within=within)
    if coarse.is_unique or not fine.converged:
        return replace(fine, doubt="; ".join(filter(None, (coarse.doubt, fine.doubt)))), coarse
    return replace(fine, converged=False, reason=coarse.reason), coarse


def prepare_oriented(noun: Surface | PointCloud, shift: Floats) -> Side:
    """Return one side of a coarse alignment; `ParameterError` where its normals have no sign."""
    side = prepare_side(noun, shift)
    if not side.is_oriented:
        raise ParameterError("a cloud without normals cannot be aligned by shape; give one filtered, with normals")
    return side


def station_of(noun: Surface | PointCloud, shift: Floats) -> Floats | None:
    """Return the one station (3,) [m] of a cloud less `shift`; None where it has several or none is known."""
    if not isinstance(noun, PointCloud) or noun.origins is None:
        return None
    origins = np.atleast_2d(noun.origins)
    one = np.isfinite(origins).all() and np.ptp(origins, axis=0).max() == 0.0
    return origins[0] - shift if one else None


def align_shapes(source: Shape, target: Shape, cell: float) -> CoarseAlignment:
    """Find the pose of a prepared shape on another, both cut into places of `cell` [m]."""
    return judge_guesses((source, target), guess_poses(source.places, target.places, cell), cell)


def guess_poses(source: Places, target: Places, cell: float) -> list[Floats]:
    """Return distinct poses T_target_source (4, 4) that many pairs of alike places agree on, the most first."""
    pairs = pair_alike(source, target)
    p, q = source.points[pairs[:, 0]], target.points[pairs[:, 1]]
    agreement = find_agreement(source, target, pairs, cell)
    support = agreement.sum(axis=1)
    guesses: list[tuple[int, Floats]] = []
    for seed in np.argsort(-support, kind="stable")[:N_SEEDS]:
        witnesses = np.argsort(-agreement[seed], kind="stable")[:N_WITNESSES]
        witnesses = witnesses[agreement[seed, witnesses] > 0]
        if len(witnesses) < 3:
            continue
        T = fit_rigid(p[witnesses], q[witnesses])
        for _ in range(2):
            near = np.linalg.norm(apply(T, p) - q, axis=1) < 2.0 * cell
            T = fit_rigid(p[near], q[near]) if near.sum() >= 3 else T
        guesses.append((int(near.sum()), T))
    guesses.sort(key=lambda guess: -guess[0])
    return keep_distinct([T for _, T in guesses], source.points, cell)[:N_GUESSES]


def find_agreement(source: Places, target: Places, pairs: Ints, cell: float) -> Floats:
    """Return for each two pairs (k, k) how many third pairs agree with both of them; 0 where they disagree.

    Two pairs agree where the distance between their places is the same in both shapes, and the angle of their normals.
    """
    p, q = source.points[pairs[:, 0]], target.points[pairs[:, 1]]
    m, n = source.normals[pairs[:, 0]], target.normals[pairs[:, 1]]
    d, e = _distances(p), _distances(q)
    agree = (np.abs(d - e) < CLOSE_CELLS * cell) & (np.minimum(d, e) > APART_CELLS * cell)
    turn, other = m @ m.T, n @ n.T
    agree &= np.arccos(np.clip(turn, -1, 1)) - np.arccos(np.clip(other, -1, 1)) < np.arccos(SAME_TURN)
    agree &= np.arccos(np.clip(other, -1, 1)) - np.arccos(np.clip(turn, -1, 1)) < np.arccos(SAME_TURN)
    first = agree.astype(np.float32)
    return np.where(agree, first @ first, 0.0)


def _distances(points: Floats) -> Floats:
    squares = (points**2).sum(axis=1)
    return np.sqrt(np.maximum(squares[:, None] + squares[None] - 2.0 * points @ points.T, 0.0))


def fit_rigid(source: Floats, target: Floats) -> Floats:
    """Return the rigid motion (4, 4) of points (n, 3) onto points, by least squares (Arun et al. 1987)."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((source - a).T @ (target - b))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    T = np.eye(4)
    T[:3, :3] = vt.T @ flip @ u.T
    T[:3, 3] = b - T[:3, :3] @ a
    return T


def keep_distinct(poses: list[Floats], points: Floats, cell: float) -> list[Floats]:
    """Return the poses without those that move the points nearly as an earlier one does."""
    kept: list[Floats] = []
    some = points[:: max(1, len(points) // 200)]
    for T in poses:
        moved = apply(T, some)
        if all(np.sqrt(np.mean((moved - apply(k, some)) ** 2) * 3.0) > DISTINCT_CELLS * cell for k in kept):
            kept.append(T)
    return kept


def judge_guesses(shapes: tuple[Shape, Shape], guesses: list[Floats], cell: float) -> CoarseAlignment:
    """Refine each guess by ICP, score it, and return the best with the doubt that the next one casts on it."""
    source, target = shapes
    sigma = 0.1 * cell
    refined = keep_distinct([refine(source, target, T, cell) for T in guesses], source.places.points, cell)
    scored = sorted(((score_pose(source, target, T, sigma, cell), k) for k, T in enumerate(refined)), reverse=True)
    if not scored:
        return CoarseAlignment(np.eye(4), 0.0, float("nan"), False, "no places of the two shapes look alike")
    best, k = scored[0]
    other, j = scored[1] if len(scored) > 1 else (0.0, k)
    ambiguity = max(other, 0.0) / best if best > 0.0 else 1.0
    reason = doubt = ""
    if best < LEAST_EXPLAINED:
        reason = (
            f"the best pose explains only {100 * max(best, 0.0):.0f} % of the shape; do the two show the same part?"
        )
    elif ambiguity > MOST_AMBIGUOUS:
        reason = f"the shapes fit as well {describe_turn(refined[k], refined[j])}; mark the true pose with targets"
    elif ambiguity > CLOSE:
        doubt = (
            f"found by shape alone, and {100 * ambiguity:.0f} % as much fits {describe_turn(refined[k], refined[j])}"
        )
    return CoarseAlignment(refined[k], best, ambiguity, not reason, reason, doubt)


def describe_turn(one: Floats, other: Floats) -> str:
    """Return in words how a second pose differs from the first, in the target's frame."""
    turn = other[:3, :3] @ one[:3, :3].T
    angle = np.degrees(np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0)))
    if angle < 5.0:
        return f"shifted by {np.linalg.norm(other[:3, 3] - one[:3, 3]):.3g} m"
    values, vectors = np.linalg.eig(turn)
    axis = np.real(vectors[:, np.argmin(np.abs(values - 1.0))])
    x, y, z = axis / np.linalg.norm(axis) * (1.0 if axis[np.argmax(np.abs(axis))] > 0 else -1.0)
    return f"turned by {angle:.0f} degrees about ({x:.2f}, {y:.2f}, {z:.2f})"


def refine(source: Shape, target: Shape, T_target_source: Floats, cell: float) -> Floats:
    """Return the pose after ICP over places of the source, or as given where it finds no hold."""
    every = max(1, len(source.side) // 3000)
    samples = make_samples(source.side, np.arange(0, len(source.side), every))
    rules = AlignmentRules(NEAR_CELLS * cell, np.radians(60.0), 50, 1e-3 * cell, 30)
    found = align(samples, target.side, T_target_source, rules)
    return found.T_target_source if found.weights.any() else T_target_source


def score_pose(source: Shape, target: Shape, T_target_source: Floats, sigma: float, cell: float) -> float:
    """Return the share of places explained, less that contradicted, of the shape that explains more of itself."""
    there = explained_share(source, target, T_target_source, sigma, cell)
    back = explained_share(target, source, invert(T_target_source), sigma, cell)
    blocked = blocking_share(source, target, T_target_source, cell) + blocking_share(
        target, source, invert(T_target_source), cell
    )
    return max(there, back) - blocked


def explained_share(source: Shape, target: Shape, T_target_source: Floats, sigma: float, cell: float) -> float:
    """Return the share of the source's places that lie on the target's surface and look the same way."""
    moved = apply(T_target_source, source.places.points)
    normals = rotate(T_target_source, source.places.normals)
    distance, nearest = target.side.tree.query(moved, distance_upper_bound=cell)
    near = np.isfinite(distance)
    there = target.side.normals_of(nearest[near])
    height = np.einsum("ij,ij->i", moved[near] - target.side.points[nearest[near]], there)
    alike = np.einsum("ij,ij->i", normals[near], there) > LOOKS_ALIKE
    return float(np.count_nonzero(alike & (np.abs(height) < FITS * sigma)) / len(moved))


def blocking_share(source: Shape, target: Shape, T_target_source: Floats, cell: float) -> float:
    """Return the share of the source's places that would have hidden what the target's station saw behind them."""
    if target.station is None:
        return 0.0
    rays = target.places.points - target.station
    ranges = np.linalg.norm(rays, axis=1)
    moved = apply(T_target_source, source.places.points) - target.station
    far = np.linalg.norm(moved, axis=1)
    tree = cKDTree(rays / ranges[:, None])
    angle = cell / float(np.median(ranges))
    gap, nearest = tree.query(moved / far[:, None], distance_upper_bound=angle, workers=-1)
    seen = np.isfinite(gap)
    before = far[seen] < ranges[nearest[seen]] - NEAR_CELLS * cell
    return float(np.count_nonzero(before) / len(moved))
