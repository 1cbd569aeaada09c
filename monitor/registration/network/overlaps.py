"""Overlapping scans: which pairs of scans share points, how their surfaces match, and how well each pair fits.

In: the scans as sides with samples. Out: matches of all pairs at given motions, and `PairFit`s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from monitor.registration.motion.matching import Matches, MatchLimits, Samples, match
from monitor.registration.motion.sampling import lever_of, motion_rows
from monitor.registration.motion.sides import Side
from monitor.registration.network.equations import Pairs
from monitor.robust import robust_scale
from projects.model import Floats, Ints
from projects.transforms import invert, rotate

FEWEST_PAIRS = 100  # points that two scans must share to be held together
FEWEST_SEEN = 50  # of these, that both saw well enough
STEEP = np.radians(70.0)  # beyond this incidence part of the spot may miss a bent surface
SEEN = np.radians(80.0)  # beyond this what one scan measured there is no place that the other saw
NEAR_SHARE = 1.0 / 3.0  # of the points with a partner far and wide, that have one near: scans lie on each other
SEARCH_MEDIANS, SEARCH_SHARE = 4.0, 0.1  # of the distances between scans as given; of the smallest scan's diagonal
CLOSURE_HELD = 0.1  # of the best held motion: what a pair by itself hardly holds is not asked of it


MOST_MATCHES = 50_000  # of one scan with all others: with ten others all samples, with forty every fourth
ENOUGH = 1000  # shared points of two scans: with fewer, none is left out

Steepest = dict[tuple[int, int], float]  # cosine of the incidence up to which pairs of two scans count


@dataclass(frozen=True)
class Overlaps:
    """The scans as sides and samples [m], and the pairs of them whose boxes meet.

    Of a scan that overlaps many, every so many-th sample is enough with each: the `strides`, chosen when two scans are
    first found to share points and kept, so that counts of points can be compared.
    """

    sides: tuple[Side, ...]
    samples: tuple[Samples, ...]
    pairs: tuple[tuple[int, int], ...]
    spacing: float
    strides: dict[tuple[int, int], int] = field(default_factory=dict)

    def match(self, pair: tuple[int, int], T_second_first: Floats, limits: MatchLimits) -> tuple[Matches, Ints]:
        """Return the matches of a pair of scans, in the second's frame, and the points (k,) of the first's side."""
        i, j = pair
        stride = self.strides.get(pair, 1)
        samples = self.samples[i].every(stride)
        matches = match(samples, self.sides[j], T_second_first, limits, True)
        if pair not in self.strides and len(matches) >= FEWEST_PAIRS:
            n_others = sum(first == i for first, _ in self.pairs)
            most = -(-n_others * len(self.samples[i].points) // MOST_MATCHES)
            self.strides[pair] = max(1, min(most, len(matches) // ENOUGH))
            matches = matches.take(matches.source % self.strides[pair] == 0)
        return matches, samples.index[matches.source]


@dataclass(frozen=True)
class PairFit:
    """How two scans fit: shared points, bias and robust sigma [m] of their distances, before and after, and
    the `closure` [m]: by how much the pair by itself would still move."""

    first: int
    second: int
    n: int
    bias_before: float
    sigma_before: float
    bias_after: float
    sigma_after: float
    closure: float = float("nan")


def first_radius(sides: Sequence[Side], samples: Sequence[Samples]) -> float:
    """Return how far partners are looked for at first [m]: a few median distances to the nearest other scan as given,
    at most a tenth of the smallest scan's diagonal."""
    limit = SEARCH_SHARE * float(min(np.linalg.norm(np.ptp(side.points, axis=0)) for side in sides))
    nearest = []
    for i, own in enumerate(samples):
        some = own.every(max(len(own.points) // 300, 1)).points
        apart = [side.tree.query(some, distance_upper_bound=limit)[0] for j, side in enumerate(sides) if j != i]
        nearest.append(np.min(apart, axis=0) if apart else np.empty(0))
    distances = np.concatenate(nearest)
    distances = distances[np.isfinite(distances)]
    return float(min(SEARCH_MEDIANS * np.median(distances), limit)) if len(distances) else 0.0


def match_overlaps(
    overlaps: Overlaps, motions: Sequence[Floats], radius: float, *, fine: bool, steepest: Steepest | None = None
) -> Pairs:
    """Return the matches of every pair of scans that share enough points, in the frame of the second as given.

    Where one scan saw a bent surface steeply or at its limb, part of its spot missed it, and its points lie outside by
    tenths of the spot. The other scan sees that place from the front and would be drawn outwards, each scan of a ring
    by the next: such pairs do not count. What lies at a limb has a poor normal, so that the other scan's normal has its
    say in how steeply a place was seen. Of two scans that share too little, the flattest of what is steep counts, but
    nothing that only one of them saw well: they are not held together by it. How steep pairs may be is kept in
    `steepest` at the first fine matching, so that it swings no iteration.
    """
    steepest = {} if steepest is None else steepest
    aside = 1.5 * overlaps.spacing if fine else radius
    limits = MatchLimits(radius, aside, np.radians(30.0 if fine else 45.0))
    found = {}
    for i, j in overlaps.pairs:
        T = invert(motions[j]) @ motions[i]
        matches, points = overlaps.match((i, j), T, limits)
        if len(matches) < FEWEST_PAIRS:
            continue
        cosines = _least_cosines((overlaps.sides[i], overlaps.sides[j]), points, matches, T)
        limit = steepest.get((i, j), _steepest(cosines))
        matches = matches.take(cosines >= limit)
        if len(matches) < FEWEST_SEEN:
            continue
        found[i, j] = matches
        if fine:
            steepest[i, j] = limit
    return found


def _least_cosines(sides: tuple[Side, Side], points: Ints, matches: Matches, T_second_first: Floats) -> Floats:
    """Return the cosine (k,) of the steepest incidence at which either of two scans saw a place, by the normals of
    both; 0 at a rim of what one of them saw."""
    first, second = sides
    least = np.minimum(first.frontality_of(points), second.frontality_of(matches.target))
    if first.views is not None:
        views = rotate(T_second_first, first.views[points])
        least = np.minimum(least, np.abs(np.einsum("ij,ij->i", views, matches.normals_target)))
    if second.views is not None:
        views = second.views[matches.target]
        least = np.minimum(least, np.abs(np.einsum("ij,ij->i", views, matches.normals_source)))
    return least


def _steepest(cosines: Floats) -> float:
    """Return the cosine of the steepest incidence that counts, such that enough pairs do as long as both saw them."""
    enough = min(np.cos(STEEP), np.partition(cosines, -FEWEST_PAIRS)[-FEWEST_PAIRS])
    return float(max(enough, np.cos(SEEN)))


def misfit_of(matches: Pairs) -> float:
    """Return the robust sigma [m] of all residuals about zero, each pair of scans counting by its points."""
    return robust_scale(np.concatenate([m.residuals for m in matches.values()])) if matches else float("nan")


def lie_near(fine: Pairs, wide: Pairs, n_scans: int, spacing: float) -> bool:
    """Return whether every scan lies on others: they miss it by less than a `spacing` [m] of the points, in as many
    places, matched finely, as a third (`NEAR_SHARE`) of those that find partners far and wide."""
    for k in range(n_scans):
        own = {key: matches for key, matches in fine.items() if k in key}
        n_fine, n_wide = (sum(len(m) for key, m in of.items() if k in key) for of in (fine, wide))
        if not own or n_fine < NEAR_SHARE * n_wide or misfit_of(own) > spacing:
            return False
    return True


def describe_pairs(before: Pairs, after: Pairs) -> tuple[PairFit, ...]:
    """Return how each pair of scans, counted once, fits before and after."""
    fits = []
    for i, j in sorted({(min(p), max(p)) for p in (*before, *after)}):
        was, now = _residuals(before, i, j), _residuals(after, i, j)
        bias = [float(np.median(r)) if len(r) else float("nan") for r in (was, now)]
        closure = _closure([m for key in ((i, j), (j, i)) if (m := after.get(key)) is not None])
        n = max(len(was), len(now))
        fits.append(PairFit(i, j, n, bias[0], robust_scale(was), bias[1], robust_scale(now), closure))
    return tuple(fits)


def _closure(matches: Sequence[Matches]) -> float:
    """Return by how much [m, root mean square over the points] the pair by itself would still move, NaN without."""
    if not matches:
        return float("nan")
    ways = []
    for pair in matches:
        centre = pair.points.mean(axis=0)
        lever = lever_of(pair.points, centre) + 1e-12
        unit = np.repeat([1.0 / lever, 1.0], 3)
        rows = motion_rows(pair.points, pair.normals, centre) * unit
        motion = -np.linalg.pinv(rows, rcond=CLOSURE_HELD) @ pair.residuals
        ways.append(float(np.sqrt(np.mean((rows @ motion) ** 2))))
    return float(np.mean(ways))


def _residuals(matches: Pairs, i: int, j: int) -> Floats:
    """Return the residuals [m] of a pair of scans from both sides, positive where scan i lies outside of scan j."""
    parts = [matches[i, j].residuals] if (i, j) in matches else []
    parts += [-matches[j, i].residuals] if (j, i) in matches else []
    return np.concatenate(parts) if parts else np.empty(0)
