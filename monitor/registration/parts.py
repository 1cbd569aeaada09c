"""Parts that moved rigidly as a whole: a tilted arm, a shifted step, a stove put together again from its pieces.

In: both surfaces and the registration on what is stable. Out: `MovedParts`, each with its six parameters and their
covariance, and the part of each point of the source. Small pieces that no motion explains yet are aligned by ICP; all
motions then share out the surface, each is fitted anew to what it explains best, and so on (Isack and Boykov 2012, here
with smoothed misfits in place of graph cuts). Wear is no motion: it runs out where a part has a joint, and it does not
bring to one side what it takes from the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from monitor.declare import check_settings, setting
from monitor.registration.alignment import AlignmentRules, align
from monitor.registration.covariance import estimate_covariance
from monitor.registration.degeneracy import find_free_motion
from monitor.registration.icp import find_centre, into_local
from monitor.registration.matching import MatchLimits, Samples, make_samples, match
from monitor.registration.patches import cut_patches
from monitor.registration.sampling import in_space_order, motion_rows
from monitor.registration.sides import Side, prepare_side
from projects.model import Bools, Floats, Ints, PointCloud, Registration, Surface
from projects.transforms import apply, invert, perturb

FITS = 3.0  # sigmas: a point nearer than this is explained by a motion
WORST, EXPLAINED = 16.0, 4.0  # squared sigmas: a point's most, and the mean of a neighbourhood that a motion explains
N_NEIGHBOURS = 12
N_SMOOTHINGS = 2
SEED_POINTS = 200  # of the piece that a part starts from
N_TRIES = 6  # places of a set that none explains, of which the best is taken
LEAST_OF_SEED = 0.8  # of a seed's points must fit its motion
LEAST_POINTS = 150
MOST_PARTS = 60
N_ROUNDS = 4
LEAST_NEW = 0.3  # of a part's points must not fit the stable motion
JOINT = 0.5  # of the motion along the normal: as large is the jump at a joint
TWO_SIDED = 0.15  # of a part gained, and as much lost
LEVEL = 1e-3  # of the test of a motion against none, over all parts tried
SOURCE_TURN = np.radians(60.0)


@dataclass(frozen=True, kw_only=True)
class PartSettings:
    """Parts that moved rigidly."""

    search_radius: float | None = setting(
        None, unit="m", low=0.0, meaning="farthest that a part is looked for; auto: a fiftieth of the object's diagonal"
    )  # fmt: skip
    n_samples: int = setting(40_000, unit="points", low=1000, meaning="points of the source that are looked at")

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class MovedPart:
    """One part: where it belongs, `T_target_source` (4, 4) from the source as given, and its own motion.

    `motion` (6,) is (w, t) [rad, m] of the part from the target's epoch to the source's, about `centre` (3,) in the
    target's frame, the motion of the stable areas taken off; `covariance` (6, 6) is of it. `n_points` samples show it.
    """

    T_target_source: Floats
    motion: Floats
    covariance: Floats
    centre: Floats
    n_points: int


@dataclass(frozen=True)
class MovedParts:
    """Parts, the largest first, and `part_of` (n,) for each vertex or point of the source: 1 and on, 0 for none."""

    parts: tuple[MovedPart, ...]
    part_of: Ints


@dataclass(frozen=True)
class _Field:
    """The samples that parts are looked for among: neighbours (n, k), sigma [m], and the rules of their alignment."""

    samples: Samples
    target: Side
    neighbours: Ints
    sigma: float
    rules: AlignmentRules
    T_stable: Floats
    both_oriented: bool


@dataclass(frozen=True)
class _Piece:
    """A part while it grows: its pose and which samples (n,) it explains."""

    T: Floats
    members: Bools


def find_parts(source: Surface | PointCloud, target: Surface | PointCloud, registration: Registration,
               settings: PartSettings | None = None) -> MovedParts:  # fmt: skip
    """Find what moved rigidly against the stable areas.

    Parameters
    ----------
    source, target : m; the nouns that were registered.
    registration : of the source onto the target, converged; its `sigma` says what fits.

    Returns
    -------
    MovedParts
        None where nothing moved. A part whose shape does not hold all six parameters is not told from wear.
    """
    settings = settings or PartSettings()
    shift = find_centre(target)
    sides = prepare_side(source, shift), prepare_side(target, shift)
    n_source = len(source.vertices if isinstance(source, Surface) else source.points)
    field = _prepare(sides, into_local(registration.T_target_source, shift), registration.sigma, settings)
    poses = [field.T_stable]
    misfits = [_misfit(field, field.T_stable)]
    tried = np.zeros(len(field.samples.points), dtype=bool)
    for _ in range(MOST_PARTS):
        seed = _find_seed(field, misfits, tried)
        if seed is None:
            break
        poses, misfits = _share_out(field, [*poses, seed], [*misfits, _misfit(field, seed)])
    return _conclude(field, poses, misfits, sides[0], n_source, shift)


def _prepare(sides: tuple[Side, Side], T_stable: Floats, sigma: float, settings: PartSettings) -> _Field:
    source, target = sides
    every = max(1, len(source) // settings.n_samples)
    which = in_space_order(source.points, np.arange(0, len(source), every))
    samples = make_samples(source, which)
    diagonal = float(np.linalg.norm(np.ptp(target.points, axis=0)))
    radius = settings.search_radius or 0.02 * diagonal
    rules = AlignmentRules(radius, SOURCE_TURN, LEAST_POINTS // 3, 1e-6, 60)
    _, neighbours = cKDTree(samples.points).query(samples.points, k=min(N_NEIGHBOURS + 1, len(which)), workers=-1)
    floor = 1e-6 * diagonal
    return _Field(samples, target, neighbours[:, 1:], max(sigma, floor), rules, T_stable,
                  source.is_oriented and target.is_oriented)  # fmt: skip


def _misfit(field: _Field, T: Floats) -> Floats:
    """Return how badly each sample (n,) fits at a pose: its squared distance in sigmas, at most `WORST`, in the mean
    over its neighbourhood."""
    limits = MatchLimits(field.rules.distance, field.rules.distance, field.rules.angle)
    pairs = match(field.samples, field.target, T, limits, field.both_oriented)
    worst = np.full(len(field.samples.points), WORST)
    worst[pairs.source] = np.minimum((pairs.residuals / field.sigma) ** 2, WORST)
    return 0.5 * (worst + worst[field.neighbours].mean(axis=1))


def _find_seed(field: _Field, misfits: list[Floats], tried: Bools) -> Floats | None:
    """Return the pose of a small piece that none of the poses explains, None where no such piece fits any.

    `tried` (n,) is marked around the places looked at.
    """
    unexplained = (np.min(misfits, axis=0) > EXPLAINED) & ~tried
    while unexplained.sum() >= SEED_POINTS // 4:
        number = _connected(field, unexplained)
        largest = np.flatnonzero(unexplained & (number == np.bincount(number[unexplained]).argmax()))
        if len(largest) < SEED_POINTS // 4:
            return None
        best, share = None, LEAST_OF_SEED
        for start in largest[np.linspace(0, len(largest) - 1, N_TRIES + 2).astype(int)[1:-1]]:
            distance = np.linalg.norm(field.samples.points - field.samples.points[start], axis=1)
            ball = np.argsort(distance, kind="stable")[:SEED_POINTS]
            T, explained = _fit_piece(field, ball)
            tried[ball[: SEED_POINTS // 3]] = True
            if explained > share:
                best, share = T, explained
        if best is not None:
            return best
        unexplained &= ~tried
    return None


def _fit_piece(field: _Field, which: Ints) -> tuple[Floats, float]:
    """Return the pose of a piece by ICP from the stable one, and the share of its samples that it explains."""
    piece = field.samples.points[which], field.samples.normals[which], field.samples.sigma[which]
    samples = Samples(*piece)
    found = align(samples, field.target, field.T_stable, field.rules, both_oriented=field.both_oriented)
    if not found.weights.any():
        return field.T_stable, 0.0
    near = np.abs(found.matches.residuals) <= FITS * field.sigma
    return found.T_target_source, float(near.sum() / len(which))


def _share_out(field: _Field, poses: list[Floats], misfits: list[Floats]) -> tuple[list[Floats], list[Floats]]:
    """Return the poses fitted anew to the samples that each explains best, without those that explain too few."""
    for _ in range(N_ROUNDS):
        label = _label(field, misfits)
        kept = [0, *(k for k in range(1, len(poses)) if np.count_nonzero(label == k) >= LEAST_POINTS // 2)]
        fitted = [poses[0], *(_refit(field, poses[k], label == k) for k in kept[1:])]
        misfits = [misfits[0], *(_misfit(field, T) for T in fitted[1:])]
        still = len(fitted) == len(poses) and all(
            np.allclose(a, b, atol=1e-6) for a, b in zip(fitted, poses, strict=True)
        )
        poses = fitted
        if still:
            break
    return poses, misfits


def _label(field: _Field, misfits: list[Floats]) -> Ints:
    """Return the pose (n,) that explains each sample best, -1 for none; islands go to what surrounds them."""
    score = np.stack(misfits)
    for _ in range(N_SMOOTHINGS):
        score = 0.5 * (score + score[:, field.neighbours].mean(axis=2))
    label = score.argmin(axis=0)
    label[score.min(axis=0) > EXPLAINED] = -1
    return label


def _refit(field: _Field, T: Floats, members: Bools) -> Floats:
    """Return the pose after ICP over its members."""
    found = align(field.samples, field.target, T, field.rules, is_kept=members, fine=True,
                  both_oriented=field.both_oriented)  # fmt: skip
    return found.T_target_source if found.weights.any() else T


def _connected(field: _Field, members: Bools) -> Ints:
    """Return the number of the connected set of each sample (n,); those that are not members are sets of their own."""
    n = len(members)
    a = np.repeat(np.arange(n), field.neighbours.shape[1])
    b = field.neighbours.ravel()
    both = members[a] & members[b]
    graph = coo_matrix((np.ones(int(both.sum()), dtype=np.int8), (a[both], b[both])), shape=(n, n))
    return connected_components(graph, directed=False)[1]


def _conclude(field: _Field, poses: list[Floats], misfits: list[Floats], source: Side, n_source: int,
              shift: Floats) -> MovedParts:  # fmt: skip
    """Return the parts that hold: connected, significant, held by their shape, and bounded as a part is."""
    label = _label(field, misfits)
    pieces = [_Piece(T, members) for k, T in enumerate(poses[1:], start=1) for members in _largest(field, label == k)]
    found = []
    for piece in pieces:
        part = _measure(field, piece, max(len(pieces), 1))
        if part is not None and _is_rigid_part(field, piece, pieces, misfits[0]):
            found.append((part, piece.members))
    found.sort(key=lambda item: -item[0].n_points)
    number = np.zeros(len(label), dtype=np.int32)
    for k, (_, members) in enumerate(found, start=1):
        number[members] = k
    part_of = np.zeros(n_source, dtype=np.int32)
    if found:
        usable = source.index >= 0
        nearest = cKDTree(field.samples.points).query(source.points[usable], workers=-1)[1]
        part_of[source.index[usable]] = number[nearest]
    return MovedParts(tuple(_in_given_frame(part, shift) for part, _ in found), part_of)


def _largest(field: _Field, members: Bools) -> list[Bools]:
    """Return the largest connected set of members, if it is large enough for a part."""
    if not members.any():
        return []
    number = _connected(field, members)
    largest = members & (number == np.bincount(number[members]).argmax())
    return [largest] if largest.sum() >= LEAST_POINTS else []


def _measure(field: _Field, piece: _Piece, n_tested: int) -> MovedPart | None:
    """Return a part with its motion and covariance; None where the shape or the significance does not hold it."""
    limits = MatchLimits(field.rules.distance, 0.0, field.rules.angle)
    pairs = match(field.samples, field.target, piece.T, limits, field.both_oriented)
    pairs = pairs.take(piece.members[pairs.source] & (np.abs(pairs.residuals) <= FITS * field.sigma))
    if len(pairs) < LEAST_POINTS // 2:
        return None
    centre = pairs.points.mean(axis=0)
    grid = cut_patches(pairs.points, pairs.normals, 25)
    if find_free_motion(pairs, centre, grid.numbers(pairs.points, pairs.normals)):
        return None
    covariance = estimate_covariance(pairs, np.full(len(pairs), field.sigma), centre)
    motion = motion_between(piece.T, field.T_stable, centre)
    statistic = float(motion @ np.linalg.pinv(covariance, rcond=1e-15, hermitian=True) @ motion)
    if chi2.sf(statistic, 6) > LEVEL / n_tested:
        return None
    return MovedPart(piece.T, motion, covariance, centre, int(piece.members.sum()))


def motion_between(T_part: Floats, T_stable: Floats, centre: Floats) -> Floats:
    """Return (w, t) [rad, m] about `centre` of a part that `T_part` puts back, in the frame of the stable areas."""
    step = T_stable @ invert(T_part)
    return np.concatenate([Rotation.from_matrix(step[:3, :3]).as_rotvec(), apply(step, centre) - centre])


def _is_rigid_part(field: _Field, piece: _Piece, pieces: list[_Piece], misfit_stable: Floats) -> bool:
    """Whether a piece ends at a joint, or gains on one side what it loses on the other; wear does neither."""
    members = piece.members
    if np.mean(misfit_stable[members] > EXPLAINED) < LEAST_NEW:
        return False
    own = _way_along_normal(field, piece.T)
    size = float(np.sqrt(np.mean(own[members] ** 2)))
    lost = float(np.mean(own[members] < -FITS * field.sigma))
    gained = float(np.mean(own[members] > FITS * field.sigma))
    if min(lost, gained) >= TWO_SIDED:
        return True
    other = np.zeros(len(own))
    for neighbour in pieces:
        if neighbour is not piece:
            other = np.where(neighbour.members, _way_along_normal(field, neighbour.T), other)
    b = field.neighbours[members].ravel()
    across = ~members[b]
    if not across.any():
        return True
    jump = own[b[across]] - other[b[across]]
    return float(np.sqrt(np.mean(jump**2))) >= JOINT * size


def _way_along_normal(field: _Field, T: Floats) -> Floats:
    """Return how far (n,) [m] the samples of a part at pose T moved along their normals."""
    place = apply(field.T_stable, field.samples.points)
    normals = field.samples.normals @ field.T_stable[:3, :3].T
    centre = place.mean(axis=0)
    return motion_rows(place, normals, centre) @ motion_between(T, field.T_stable, centre)


def _in_given_frame(part: MovedPart, shift: Floats) -> MovedPart:
    return MovedPart(into_local(part.T_target_source, -shift), part.motion, part.covariance, part.centre + shift,
                     part.n_points)  # fmt: skip


def put_back(part: MovedPart) -> Floats:
    """Return the transform (4, 4) that brings the moved part back to where it was, in the target's frame."""
    return invert(perturb(np.eye(4), part.centre, part.motion))
