"""Shares out a surface among rigid motions: small pieces that none explains are aligned and grow as far as they fit.

In: samples of a surface, their partner and the motion of the stable areas. Out: `Piece`s, each a pose and the samples
that it explains better than any other pose does (Isack and Boykov 2012, here with smoothed misfits in place of graph
cuts). Each piece is looked at within its own surroundings, so that many cost no more than their own size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from monitor.registration.motion.alignment import AlignmentRules, align
from monitor.registration.motion.matching import MatchLimits, Samples, match
from monitor.registration.motion.sides import Side
from projects.model import Bools, Floats, Ints

FITS = 3.0  # sigmas: a point nearer than this is explained by a motion
WORST, EXPLAINED = 16.0, 4.0  # squared sigmas: a point's most, and the mean of a neighbourhood that a motion explains
N_SMOOTHINGS = 3
SEED_POINTS = 120  # of the piece that a part starts from
LEAST_OF_SEED = 0.8  # of a seed's points must fit its motion
LEAST_POINTS = 150
N_GROWTHS = 8
GROWN = 1.05  # a piece that grew by less has found its end
AROUND = 1.6  # of the radius about a piece's middle that holds its points: so far it is looked for
SAME = 0.8  # of a piece's points explained by another's motion: they are one
DAMPING = 1e-3  # a seed's shape need not hold all motions; those it does not stay as they are
N_ROUNDS = 3
MOST_SEEDS = 1500


@dataclass(frozen=True)
class Field:
    """The samples that parts are looked for among: neighbours (n, k), what each is judged by, sigma (n,) [m], the rules
    of their alignment, the misfit (n,) of the stable pose in squared sigmas, and how many rings of neighbours at a
    border are `blended`, fitted to points on both sides of it."""

    samples: Samples
    target: Side
    neighbours: Ints
    sigma: Floats
    rules: AlignmentRules
    T_stable: Floats
    both_oriented: bool
    misfit_stable: Floats
    blended: int


@dataclass(frozen=True)
class Piece:
    """A part while it grows: its pose and which samples (k,) it explains."""

    T: Floats
    members: Ints


def make_field(samples: Samples, target: Side, neighbours: Ints, sigma: Floats, rules: AlignmentRules, T_stable: Floats,
               both_oriented: bool, blended: int) -> Field:  # fmt: skip
    """Return the field with its misfit at the stable pose."""
    field = Field(samples, target, neighbours, sigma, rules, T_stable, both_oriented, np.empty(0), blended)
    return replace(field, misfit_stable=measure_misfit(field, T_stable, np.arange(len(samples.points))))


def measure_misfit(field: Field, T: Floats, window: Ints) -> Floats:
    """Return how badly the samples `window` (k,) fit at a pose: the squared distance in sigmas, at most `WORST`, in the
    mean over their neighbourhoods."""
    limits = MatchLimits(field.rules.distance, field.rules.distance, field.rules.angle)
    pairs = match(field.samples.take(window), field.target, T, limits, field.both_oriented)
    score = np.full(len(field.samples.points), WORST)
    score[window[pairs.source]] = np.minimum((pairs.residuals / field.sigma[window[pairs.source]]) ** 2, WORST)
    around = field.neighbours[window]
    for _ in range(N_SMOOTHINGS):
        score[window] = 0.5 * (score[window] + score[around].mean(axis=1))
    return score[window]


def find_pieces(field: Field, may_start: Bools) -> list[Piece]:
    """Return the pieces that a motion of their own explains, after all motions have shared out the surface.

    Pieces start where the stable motion does not fit and `may_start` (n,) allows; they grow anywhere.
    """
    best = field.misfit_stable.copy()
    pieces: list[Piece] = []
    unexplained = (best > EXPLAINED) & may_start
    for group in connected_sets(field, np.flatnonzero(unexplained), SEED_POINTS // 2):
        tree = cKDTree(field.samples.points[group])
        tried = np.zeros(len(group), dtype=bool)
        for start in spread_out(len(group)):
            if tried[start] or best[group[start]] <= EXPLAINED or len(pieces) >= MOST_SEEDS:
                continue
            near = tree.query(field.samples.points[group[start]], k=min(3 * SEED_POINTS, len(group)))[1]
            near = near[best[group[near]] > EXPLAINED][:SEED_POINTS]
            tried[near[: SEED_POINTS // 3]] = True
            piece = None if len(near) < SEED_POINTS // 2 else grow_piece(field, best, group[near])
            if piece is not None:
                pieces.append(piece)
                best[piece.members] = np.minimum(best[piece.members], EXPLAINED)
    return share_out(field, merge_pieces(field, pieces))


def spread_out(n: int) -> Ints:
    """Return the numbers below n, those far apart first."""
    return np.argsort(np.mod(np.arange(n) * 0.6180339887498949, 1.0), kind="stable")


def connected_sets(field: Field, members: Ints, least: int) -> list[Ints]:
    """Return the connected sets of samples among `members` with at least so many, the largest first."""
    if not len(members):
        return []
    local = np.full(len(field.samples.points), -1)
    local[members] = np.arange(len(members))
    b = local[field.neighbours[members]]
    a = np.broadcast_to(np.arange(len(members))[:, None], b.shape)
    graph = coo_matrix((np.ones(int((b >= 0).sum()), dtype=np.int8), (a[b >= 0], b[b >= 0])), shape=(len(members),) * 2)
    number = connected_components(graph, directed=False)[1]
    count = np.bincount(number)
    order = np.argsort(-count, kind="stable")
    return [members[number == k] for k in order if count[k] >= least]


def grow_piece(field: Field, best: Floats, seed: Ints) -> Piece | None:
    """Return the piece that grows from a seed (k,) of samples, None where no motion explains the seed.

    It takes in what it explains better than `best` (n,), the least misfit so far, and hangs together with the seed.
    """
    T, share = fit(field, seed, field.T_stable, damping=DAMPING)
    if share < LEAST_OF_SEED:
        return None
    members = seed
    for _ in range(N_GROWTHS):
        window = surroundings(field, members)
        score = measure_misfit(field, T, window)
        held = window[(score < EXPLAINED) & (score < best[window])]
        grown = next((s for s in connected_sets(field, held, LEAST_POINTS // 2) if np.isin(seed, s).mean() > 0.5), None)
        if grown is None:
            return None
        T, _ = fit(field, grown, T, fine=True, damping=DAMPING)
        if len(grown) < GROWN * len(members):
            return Piece(T, grown)
        members = grown
    return Piece(T, members)


def surroundings(field: Field, members: Ints) -> Ints:
    """Return the samples within and about a piece."""
    points = field.samples.points
    low, high = points[members].min(axis=0), points[members].max(axis=0)
    middle, reach = 0.5 * (low + high), AROUND * 0.5 * float(np.linalg.norm(high - low))
    near = np.flatnonzero((np.abs(points - middle) <= reach).all(axis=1))
    return near[np.sum((points[near] - middle) ** 2, axis=1) <= reach**2]


def fit(field: Field, members: Ints, T: Floats, *, fine: bool = False, damping: float = 0.0) -> tuple[Floats, float]:
    """Return the pose of some samples by ICP from a pose, and the share of them that it explains."""
    rules = replace(field.rules, n_pairs=max(len(members) // 3, 20), damping=damping)
    found = align(field.samples.take(members), field.target, T, rules, fine=fine, both_oriented=field.both_oriented)
    if not found.weights.any():
        return T, 0.0
    fits = np.abs(found.matches.residuals) <= FITS * field.sigma[members[found.matches.source]]
    return found.T_target_source, float(fits.sum()) / len(members)


def merge_pieces(field: Field, pieces: Sequence[Piece]) -> list[Piece]:
    """Return the pieces, those joined of which the motion of the larger explains the smaller too."""
    left = sorted(pieces, key=lambda p: -len(p.members))
    merged: list[Piece] = []
    while left:
        whole, *left = left
        window = set(surroundings(field, whole.members).tolist())
        rest = []
        for other in left:
            is_near = np.mean([m in window for m in other.members[:: max(len(other.members) // 20, 1)]]) > 0.5
            if is_near and np.mean(measure_misfit(field, whole.T, other.members) < EXPLAINED) >= SAME:
                members = np.union1d(whole.members, other.members)
                whole = Piece(fit(field, members, whole.T, fine=True)[0], members)
            else:
                rest.append(other)
        left = rest
        merged.append(whole)
    return merged


def share_out(field: Field, pieces: list[Piece]) -> list[Piece]:
    """Return the pieces fitted anew to the samples that each explains best, without those that explain too few."""
    for _ in range(N_ROUNDS):
        best = np.minimum(field.misfit_stable, EXPLAINED)
        label = np.full(len(best), -1)
        for k, piece in enumerate(pieces):
            window = surroundings(field, piece.members)
            score = measure_misfit(field, piece.T, window)
            better = score < best[window]
            label[window[better]], best[window[better]] = k, score[better]
        shared = [connected_sets(field, np.flatnonzero(label == k), LEAST_POINTS // 2) for k in range(len(pieces))]
        pieces = [Piece(fit(field, s[0], p.T, fine=True)[0], s[0]) for p, s in zip(pieces, shared, strict=True) if s]
    return pieces


def is_member(members: Ints, n: int) -> Bools:
    """Return which of n samples are members."""
    mask = np.zeros(n, dtype=bool)
    mask[members] = True
    return mask
