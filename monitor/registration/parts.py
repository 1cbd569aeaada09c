"""Parts that moved rigidly as a whole: a tilted arm, a shifted step, a stove put together again from its pieces.

In: both surfaces and the registration on what is stable. Out: `MovedParts`, each with its six parameters and their
covariance, and the part of each point of the source. Motions share out the surface (`part_growth`); a part is what of
it is held by its shape, significant, and bounded as a part is. Wear runs out where a part has a joint, and does not
bring to one side what it takes from the other; a layer is as thick everywhere. But what was lost as a wedge, along a
sharp border, passes for a part that tilted. (What no six parameters can be stated of may still show as moved:
`comparison.moved`.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial import cKDTree
from scipy.stats import chi2

from monitor.declare import check_settings, given_or_default, setting
from monitor.registration.motion.alignment import AlignmentRules
from monitor.registration.motion.covariance import about, at_least, estimate_covariance
from monitor.registration.motion.degeneracy import find_free_motion
from monitor.registration.motion.icp import find_centre, into_local
from monitor.registration.motion.matching import Matches, MatchLimits, make_samples, match
from monitor.registration.motion.patches import cut_patches
from monitor.registration.motion.sampling import in_space_order, motion_rows
from monitor.registration.motion.sides import Side, prepare_side
from monitor.registration.part_growth import (
    EXPLAINED,
    FITS,
    LEAST_POINTS,
    Field,
    Piece,
    find_pieces,
    fit,
    is_member,
    make_field,
)
from projects.errors import ParameterError
from projects.model import Bools, Floats, Ints, PointCloud, Registration, Surface
from projects.transforms import apply, invert, motion_about, rows_of_inverse

N_NEIGHBOURS = 12
LEAST_TELLING = LEAST_POINTS // 2  # points of a part that its motion tells from none, and as many from a layer
N_SHARPENINGS = 3
LEAST_NEW = 0.5  # of the points that tell must not fit the stable motion
N_BESIDE = 2  # rings of neighbours: within the first a piece's border is smoothed
N_BLENDED = 2  # rings of neighbours: fits reach so far
SAMPLES_PER_PATCH = 25  # patches of a part must hold its motion
JOINT = 0.8  # of the motion carried on along the normals: as large is the jump at a joint; beside wear 0.3 to 0.7
TWO_SIDED = 0.15  # of what tells gained, and as much lost
LEVEL = 1e-3  # of the test of a motion against none, over all parts tried
SOURCE_TURN = np.radians(60.0)


@dataclass(frozen=True, kw_only=True)
class PartSettings:
    """Parts that moved rigidly."""

    search_radius: float | None = setting(
        None, unit="m", low=1e-6, meaning="farthest that a part is looked for; auto: 0.02 of the object's diagonal"
    )  # fmt: skip
    n_samples: int = setting(100_000, unit="points", low=1000, meaning="points of the source that are looked at")

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class MovedPart:
    """One part: where it belongs, `T_target_source` (4, 4) from the source as given, and its own motion.

    `motion` (6,) is (w, t) [rad, m] of the part from the target's epoch to the source's, about `centre` (3,) in the
    target's frame, the motion of the stable areas taken off; `covariance` (6, 6) is of it, with what is not known of
    the stable areas' motion there. `n_points` samples show it.
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


def find_parts(source: Surface | PointCloud, target: Surface | PointCloud, registration: Registration,
               settings: PartSettings | None = None, is_changed: Bools | None = None,
               sigma: Floats | None = None) -> MovedParts:  # fmt: skip
    """Find what moved rigidly against the stable areas.

    Parameters
    ----------
    source, target : m; the nouns that were registered.
    registration : of the source onto the target, converged; its `sigma` says what fits.
    is_changed : (n,) bool, vertices or points of the source that changed for certain; parts are looked for only there.
    sigma : (n,) m, of the distance between both where nothing changed, as `compare` learned it; NaN where it is not
        known. Without it what the registration is sure of and the nouns state.

    Returns
    -------
    MovedParts
        Its `parts` are empty where nothing moved. A part whose shape does not hold all six parameters is not told from
        wear.

    Raises
    ------
    ParameterError
        Where `sigma` is not of the source.
    """
    settings = given_or_default(settings, PartSettings)
    shift = find_centre(target)
    sides = prepare_side(source, shift), prepare_side(target, shift)
    n_source = len(source.vertices if isinstance(source, Surface) else source.points)
    if sigma is not None and sigma.shape != (n_source,):
        raise ParameterError(f"sigma has the shape {sigma.shape}: give one for each of the source's {n_source}")
    index = sides[0].index[_choose(sides[0], settings)]
    known = np.full(len(index), np.nan) if sigma is None else np.where(index >= 0, sigma[index], np.nan)
    has_fits = isinstance(source, Surface) and source.normals is not None and source.sigma is not None
    T = into_local(registration.T_target_source, shift)
    field = _prepare(sides, T, (registration.sigma, known), settings, N_BLENDED if has_fits else 0)
    may_start = np.ones(len(index), dtype=bool) if is_changed is None else (index >= 0) & is_changed[index]
    return _conclude(field, find_pieces(field, may_start), sides[0], n_source, registration, shift)


def _prepare(sides: tuple[Side, Side], T_stable: Floats, judged_by: tuple[float, Floats], settings: PartSettings,
             blended: int) -> Field:  # fmt: skip
    """Return the field of samples of the source, which are judged by what is known of each, `judged_by` [m], and by no
    less than the least."""
    (source, target), (least, sigma) = sides, judged_by
    samples = make_samples(source, _choose(source, settings))
    diagonal = float(np.linalg.norm(np.ptp(target.points, axis=0)))
    rules = AlignmentRules(settings.search_radius or 0.02 * diagonal, SOURCE_TURN, LEAST_POINTS // 3, 1e-6, 60)
    _, neighbours = cKDTree(samples.points).query(
        samples.points, k=min(N_NEIGHBOURS + 1, len(samples.points)), workers=-1
    )
    both_oriented = source.is_oriented and target.is_oriented
    pairs = match(samples, target, T_stable, MatchLimits(rules.distance, rules.distance, rules.angle), both_oriented)
    stated = np.full(len(sigma), max(least, 1e-6 * diagonal))
    stated[pairs.source] = np.maximum(stated[pairs.source], pairs.sigma)
    judged = np.where(np.isfinite(sigma), np.maximum(sigma, least), stated)
    return make_field(samples, target, neighbours[:, 1:], judged, rules, T_stable, both_oriented, blended)


def _choose(source: Side, settings: PartSettings) -> Ints:
    """Return the points of the source that are looked at, neighbours in space near in order."""
    n = min(len(source), settings.n_samples)
    return in_space_order(source.points, np.linspace(0, len(source) - 1, n).astype(np.int64))


def _conclude(field: Field, pieces: list[Piece], source: Side, n_source: int, registration: Registration,
              shift: Floats) -> MovedParts:  # fmt: skip
    """Return the parts that hold: connected, significant, held by their shape, and bounded as a part is."""
    pieces = [_sharpen(field, p) for p in pieces if len(p.members) >= LEAST_POINTS]

    def of_stable(centre: Floats) -> Floats:
        """Return the covariance (6, 6) of the stable areas' motion about a place (3,) of the field."""
        return about(registration.covariance, centre + shift - registration.centre)

    measured = [(_measure(field, piece, len(pieces), of_stable), piece.members)
                for piece in _rigid_parts(field, pieces)]  # fmt: skip
    found = [(part, members) for part, members in measured if part is not None]
    found.sort(key=lambda item: -item[0].n_points)
    number = np.zeros(len(field.samples.points), dtype=np.int32)
    for k, (_, members) in enumerate(found, start=1):
        number[members] = k
    part_of = np.zeros(n_source, dtype=np.int32)
    if found:
        usable = source.index >= 0
        nearest = cKDTree(field.samples.points).query(source.points[usable], workers=-1)[1]
        part_of[source.index[usable]] = number[nearest]
    return MovedParts(tuple(_in_given_frame(part, shift) for part, _ in found), part_of)


def _sharpen(field: Field, piece: Piece) -> Piece:
    """Return a piece with the pose that its telling samples give: what fits both motions may belong to what is beside
    it, as ground that a boss slides along, and would bend it."""
    for _ in range(N_SHARPENINGS):
        telling = _telling(field, piece)
        if len(telling) < LEAST_TELLING:
            break
        piece = Piece(fit(field, telling, piece.T, fine=True)[0], piece.members)
    return piece


def _telling(field: Field, piece: Piece) -> Ints:
    """Return which samples (k,) of a piece its motion tells from none: moved along their normals beyond errors."""
    own = _way_along_normal(field, piece.T, piece.members)
    return piece.members[np.abs(own) > FITS * field.sigma[piece.members]]


def _measure(field: Field, piece: Piece, n_tested: int, of_stable: Callable[[Floats], Floats]) -> MovedPart | None:
    """Return a part with its motion and covariance; None where the shape or the significance does not hold it."""
    limits = MatchLimits(field.rules.distance, 0.0, field.rules.angle)
    telling = _telling(field, piece)
    pairs = match(field.samples.take(telling), field.target, piece.T, limits, field.both_oriented)
    sigma = field.sigma[telling[pairs.source]]
    fits = np.abs(pairs.residuals) <= FITS * sigma
    pairs, sigma = pairs.take(fits), sigma[fits]
    if len(pairs) < LEAST_TELLING:
        return None
    centre = pairs.points.mean(axis=0)
    if _free_motion(pairs, centre):
        return None
    own = _covariance_of(field, piece, telling[pairs.source], pairs, sigma, centre)
    covariance = covariance_between(piece.T, field.T_stable, centre, own, of_stable)
    if not np.isfinite(covariance).all():
        return None
    motion = motion_between(piece.T, field.T_stable, centre)
    statistic = float(motion @ np.linalg.pinv(covariance, rcond=1e-15, hermitian=True) @ motion)
    if chi2.sf(statistic, 6) > LEVEL / n_tested:
        return None
    return MovedPart(piece.T, motion, covariance, centre, len(piece.members))


def _covariance_of(field: Field, piece: Piece, which: Ints, pairs: Matches, sigma: Floats, centre: Floats) -> Floats:
    """Return the covariance (6, 6) of a piece's motion, as the pairs (k,) of its samples `which` show it, and no less
    than those show that lie within what is blended at its border, as many rings of neighbours as leave a shape that
    holds it. Surfaces were fitted there to points of what moved and of what did not: they hold a motion in place more
    firmly than they know it."""
    covariance = estimate_covariance(pairs, sigma, centre)
    inside = is_member(piece.members, len(field.samples.points))
    least = covariance
    for _ in range(field.blended):
        inside &= inside[field.neighbours].all(axis=1)
        within = pairs.take(inside[which])
        if len(within) < LEAST_TELLING or _free_motion(within, centre):
            break
        least = estimate_covariance(within, sigma[inside[which]], centre)
    return covariance if least is covariance else at_least(covariance, least)


def _free_motion(pairs: Matches, centre: Floats) -> str:
    """Return in words the motion that the shape of some pairs leaves free; empty where it holds all."""
    grid = cut_patches(pairs.points, pairs.normals, SAMPLES_PER_PATCH)
    return find_free_motion(pairs, centre, grid.numbers(pairs.points, pairs.normals), by_sign=True)


def motion_between(T_part: Floats, T_stable: Floats, centre: Floats) -> Floats:
    """Return (w, t) [rad, m] about `centre` of a part that `T_part` puts back, in the frame of the stable areas."""
    return motion_about(T_stable @ invert(T_part), centre)


def covariance_between(T_part: Floats, T_stable: Floats, centre: Floats, own: Floats,
                       of_stable: Callable[[Floats], Floats]) -> Floats:  # fmt: skip
    """Return the covariance (6, 6) of what `motion_between` tells, by that of the pose of the part about `centre`, its
    `own`, and that of the stable areas' about a place: what they err by moves the part where it is now."""
    T = T_part @ invert(T_stable)
    rows = rows_of_inverse(T)
    of_rest = rows @ block_diag(T[:3, :3], T[:3, :3])
    return np.asarray(rows @ own @ rows.T + of_rest @ of_stable(apply(invert(T), centre)) @ of_rest.T)


def _rigid_parts(field: Field, pieces: list[Piece]) -> list[Piece]:
    """Return the pieces that are parts: those that are by themselves, and those that are but for what lies beside them
    of these, which may have moved nearly as they did."""
    is_part = np.zeros(len(field.samples.points), dtype=bool)
    alone = [_is_rigid_part(field, piece, is_part) for piece in pieces]
    for piece, is_alone in zip(pieces, alone, strict=True):
        is_part[piece.members] |= is_alone
    return [piece for piece, is_alone in zip(pieces, alone, strict=True)
            if is_alone or _is_rigid_part(field, piece, is_part)]  # fmt: skip


def _is_rigid_part(field: Field, piece: Piece, is_part: Bools) -> bool:
    """Whether a piece is told by its motion from what stands still, from a layer, and from wear: it ends at a joint, or
    gains on one side what it loses on the other."""
    own, telling = _way_along_normal(field, piece.T, piece.members), _telling(field, piece)
    if len(telling) < LEAST_TELLING or np.mean(field.misfit_stable[telling] > EXPLAINED) < LEAST_NEW:
        return False
    tells = own[np.isin(piece.members, telling)]
    if np.sum(np.abs(own - np.mean(tells)) > FITS * field.sigma[piece.members]) < LEAST_TELLING:
        return False
    lost, gained = float(np.mean(tells < 0.0)), float(np.mean(tells > 0.0))
    return min(lost, gained) >= TWO_SIDED or _ends_at_joint(field, piece, is_part)


def _ends_at_joint(field: Field, piece: Piece, is_part: Bools) -> bool:
    """Whether what lies beside a piece, and is not known to be of a part (n,), did not go along: what was measured
    there differs from the piece's motion, carried on, by nearly all of it. Wear runs out: next to a piece of it is
    wear."""
    inside = is_member(piece.members, len(field.samples.points))
    beside = piece.members
    for _ in range(N_BESIDE):
        inside[beside] = True
        beside = np.unique(field.neighbours[beside])
        beside = beside[~inside[beside]]
    beside = beside[~is_part[beside]]
    limits = MatchLimits(field.rules.distance, 0.0, field.rules.angle)
    pairs = match(field.samples.take(beside), field.target, field.T_stable, limits, field.both_oriented)
    if not len(pairs):
        return True
    carried_on = _way_along_normal(field, piece.T, beside[pairs.source])
    jump = carried_on - pairs.residuals
    return float(np.mean(jump**2)) >= JOINT**2 * float(np.mean(carried_on**2))


def _way_along_normal(field: Field, T: Floats, which: Ints) -> Floats:
    """Return how far (k,) [m] some samples, of a part at pose T, moved along their normals."""
    place = apply(field.T_stable, field.samples.points[which])
    normals = field.samples.normals[which] @ field.T_stable[:3, :3].T
    centre = place.mean(axis=0)
    return motion_rows(place, normals, centre) @ motion_between(T, field.T_stable, centre)


def _in_given_frame(part: MovedPart, shift: Floats) -> MovedPart:
    return MovedPart(into_local(part.T_target_source, -shift), part.motion, part.covariance, part.centre + shift,
                     part.n_points)  # fmt: skip
