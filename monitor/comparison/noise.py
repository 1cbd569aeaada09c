"""What the stable areas say about the errors of a comparison: their size, and how far they agree along the surface.

Both epochs see the same shape with the same fits, so part of their errors is the same and falls out of the difference:
what is stated of each surface alone is then too much. Other errors are stated too small (relief that the points are
too sparse for, grazing views, places between samples) or not at all. The stable areas show it: as a scale of what the
surfaces state, one of what their neighbouring fits contradict each other by, one of what scans disagree by, a floor
beneath all, and a factor of each class of place. That is the size of most errors, and right for a level that one vertex
in twenty exceeds. What scans disagree by is large in few places, of which most of the surface says nothing: a test of
patches at one in a hundred thousand keeps it as stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numba import jit
from scipy.stats import norm

from monitor.comparison.blocks import blocks
from monitor.comparison.correlation import Correlation, estimate_correlation, estimate_of_many
from monitor.comparison.discord import SHARE
from monitor.comparison.error_parts import Parts, fit_parts
from monitor.comparison.level_of_detection import N_FLOOR, estimate_floor, least_floor
from monitor.comparison.quantile import around_quantile, between, median, quantile
from monitor.comparison.scratch import keep_on_disk
from monitor.comparison.side import Side, larger_of, map_sides
from monitor.comparison.strata import EVERY, GROUPS, KINDS, N_STRATA, lies_at_rim, mean_of_arms, stratum_of
from monitor.threads import run_tasks
from projects.model import Bools, Floats, Ints

Masks = tuple[Bools, Bools]
FEWEST_WITNESSES = 5.0  # that a group must hold to be asked for a factor of its own
STATED_WITNESSES = 2.0  # that what is stated counts for: it may be off by a factor of two, one sigma; see `believe`
ALIKE_WITNESSES = 8.0  # that the rest counts for where a group is asked: it may differ by a factor of 1.4, one sigma
N_LEARNT = 800_000  # vertices of both sides that a scale is learned from: to 0.1 %, one sigma, if independent
MANY = 300_000  # calm vertices of a side, above which only those that are paired show how errors agree
N_PAIRED = 1000  # vertices of a stratum whose pairs show how many witnesses it holds


@dataclass(frozen=True)
class Noise:
    """Of each stratum (`strata`) the `floors` [m], and the scales of what surfaces state, `scales`, of what their fits
    contradict each other by, `discord_scales`, and of what scans disagree by, `shared_scales`; `correlation` of the
    errors; `spacing` [m] of the vertices."""

    floors: Floats
    scales: Floats
    discord_scales: Floats
    shared_scales: Floats
    correlation: Correlation
    spacing: float

    def floor_of(self, side: Side) -> Floats:
        """Return the floor (n,) [m] of each vertex."""
        return self.floors[stratum_of(side, self.spacing)]

    def scale_of(self, side: Side) -> Floats:
        """Return the scale (n,) of what the surfaces state at each vertex."""
        return self.scales[stratum_of(side, self.spacing)]

    def discord_share_of(self, side: Side) -> Floats:
        """Return how much (n,) of what neighbouring fits contradict each other by is error at each vertex."""
        return SHARE * self.discord_scales[stratum_of(side, self.spacing)]

    def shared_scale_of(self, side: Side) -> Floats:
        """Return the scale (n,) of what the scans disagree by at each vertex."""
        return self.shared_scales[stratum_of(side, self.spacing)]

    def scales_by_class(self, side: Side) -> dict[str, list[float]]:
        """Return the mean scale of the assessed vertices in each class of each kind, NaN where there are none."""
        counts = np.bincount(stratum_of(side, self.spacing)[side.is_assessed], minlength=N_STRATA)
        out = {}
        for kind, groups in KINDS.items():
            n = [int(counts[group].sum()) for group in groups]
            out[kind] = [
                float(counts[g] @ self.scales[g] / k) if k else float("nan") for g, k in zip(groups, n, strict=True)
            ]
        return out

    def sigma_of(self, side: Side, which: Ints | None = None) -> Floats:
        """Return one sigma (n,) [m] of the change of each vertex, or of those in `which`, with what is common to
        many."""
        if which is not None:
            return np.sqrt(self.variance_of(side, which) + self.common_of(side, which) ** 2)
        out = np.empty(len(side.distances))
        for block in blocks(len(out)):
            out[block] = np.sqrt(self.variance_of(side, block) + self.common_of(side, block) ** 2)
        return out

    def is_at_rim(self, side: Side) -> Bools:
        """Return whether each vertex (n,) lies in the two strata beside a free edge."""
        return lies_at_rim(stratum_of(side, self.spacing))

    def variance_of(self, side: Side, which: Ints | slice = slice(None)) -> Floats:
        """Return the variance [m2] of the change of each vertex, or of those in `which`, without what is common to
        many: scans, registration. It takes the thirds of the lever arm as one: what they differ by is right for a
        level that one vertex in twenty exceeds, and partly chance."""
        stratum = stratum_of(side, self.spacing, which)
        scales, discord, floors = (mean_of_arms(v) for v in (self.scales, self.discord_scales, self.floors))
        own2 = (scales[stratum] * side.sigma_surfaces[which]) ** 2 + (discord[stratum] * side.sigma_discord[which]) ** 2
        return np.asarray(own2 + (floors**2)[stratum])

    def common_of(self, side: Side, which: Ints | slice = slice(None)) -> Floats:
        """Return one sigma (n,) [m] of what is common to many, as it shows in most places: scans, scaled, and
        registration; of each vertex or of those in `which`."""
        scale = self.shared_scales[stratum_of(side, self.spacing, which)]
        return np.hypot(scale * side.sigma_shared[which], side.sigma_motion[which])


def learn_noise(sides: tuple[Side, Side], calm: Masks, share: float, rng: np.random.Generator,
                known: Correlation | None = None) -> Noise:  # fmt: skip
    """Learn the noise from the vertices in `calm`, of which the innermost `share` is trusted.

    `known` is how errors agree, as far as it is known already: what many witnesses say is too much is scaled down, and
    a stratum that holds many has a floor or a scale of its own.
    """
    spacing = float(np.sqrt(median(np.concatenate([s.areas for s in sides]))))
    witnesses = map_sides(lambda k: _witness(sides[k], calm[k], spacing), larger_of(sides))
    parts, factors = learn_sizes(witnesses, share, known, rng)
    floors = np.maximum(factors * parts.floor, max(w.resolution for w in witnesses))
    unknown = Correlation(np.zeros(1), np.ones(1))
    noise = Noise(floors, factors * parts.surfaces, factors * parts.discord, factors * parts.shared, unknown, spacing)
    lead = int(calm[1].sum() > calm[0].sum())
    return replace(noise, correlation=_correlate(sides[lead], calm[lead], noise, rng))


def _correlate(side: Side, calm: Bools, noise: Noise, rng: np.random.Generator) -> Correlation:
    """Return how the errors of the calm vertices of a side agree."""
    points, places = side.surface.vertices, np.flatnonzero(calm).astype(np.int32)
    if len(places) > MANY:
        return estimate_of_many(points, places, side.areas,
                                lambda which: side.distances[which] / noise.sigma_of(side, which), rng)  # fmt: skip
    errors = side.distances / noise.sigma_of(side)
    errors[~calm] = np.nan
    return estimate_correlation(points, errors, side.areas, rng)


class CalmVertices(NamedTuple):  # a named tuple, since kernels take it whole
    """The calm vertices of one side: their `places` (n,), rising, among all, of which `points` (m, 3) [m], `distances`
    (m,) [m], one sigma (m,) [m] of what is stated of the surfaces, `own`, of their `discord`, of the scans, `shared`,
    and of the registration, `motion`. `stratum` (n,) of each; `members` (n,) are the places by stratum, those of
    stratum k from starts[k] on; distances below the `resolution` [m] are none. Once their parts are known `own` is all
    of them but the registration's."""

    points: Floats
    places: Ints
    distances: Floats
    own: Floats
    discord: Floats
    shared: Floats
    motion: Floats
    stratum: Ints
    members: Ints
    starts: Ints
    resolution: float


def _witness(side: Side, calm: Bools, spacing: float) -> CalmVertices:
    """Return the calm vertices of a side."""
    places, stratum = np.flatnonzero(calm).astype(np.int32), stratum_of(side, spacing)
    if len(places) < len(calm):
        stratum = stratum[places]
    members, starts = sort_by_stratum(places, stratum)
    return CalmVertices(side.surface.vertices, places, side.distances, side.sigma_surfaces, side.sigma_discord,
                        side.sigma_shared, side.sigma_motion, stratum, keep_on_disk(members), starts,
                        least_floor(side.surface.vertices))  # fmt: skip


def sort_by_stratum(places: Ints, stratum: Ints) -> tuple[Ints, Ints]:
    """Return the places (n,) by stratum, in their order within one, and where each of the `N_STRATA` begins."""
    starts = np.append(0, np.cumsum(np.bincount(stratum, minlength=N_STRATA)))
    return np.asarray(_sort_places(places, stratum, starts)), starts


@jit(nopython=True, cache=True, nogil=True)
def _sort_places(places, stratum, starts):  # type: ignore[no-untyped-def]
    """Return the places (n,) sorted by stratum, in their order within each."""
    out, filled = np.empty_like(places), starts[:-1].copy()
    for i in range(len(places)):
        out[filled[stratum[i]]] = places[i]
        filled[stratum[i]] += 1
    return out


def learn_sizes(
    calm: Sequence[CalmVertices], share: float, known: Correlation | None, rng: np.random.Generator
) -> tuple[Parts, Floats]:
    """Return the parts of the errors, and the factor of each stratum, what its errors differ by from the rest.

    By what factor errors exceed their parts is asked of groups of strata one after another, each on top of what the
    groups before have shown: all; classes of each kind (`ORDER`), some again, whose factors the others have moved; and
    all again. A factor is believed as far as the group's witnesses go. All stay as stated where the same measurements
    stand on both sides: errors that are the same in both do not show.
    """
    if are_copies(calm):
        return Parts(1.0, 1.0, 1.0, 0.0), np.ones(N_STRATA)
    parts, factors = _learn_parts(calm, share, known, rng), np.ones(N_STRATA)
    calm = [c._replace(own=_mix(c, parts)) for c in calm]
    drawn = _thin_out(calm)
    for group in GROUPS:
        n_witnesses = _count(calm, group, known, rng)
        if n_witnesses >= FEWEST_WITNESSES:
            held_by = STATED_WITNESSES if len(group) == N_STRATA else ALIKE_WITNESSES
            asked = drawn if sum(_n_held(c, group) for c in calm) > N_LEARNT else calm
            factors[group] *= believe(asked_scale(asked, group, factors, share), n_witnesses, held_by)
    return parts, factors


def are_copies(calm: Sequence[CalmVertices]) -> bool:
    """Return whether most calm vertices lie on the other side to the last digit, which no second survey does."""
    n_off = sum(_count_within(c.distances, c.places, c.resolution) for c in calm)
    return bool(2 * n_off > sum(len(c.places) for c in calm))


@jit(nopython=True, cache=True, nogil=True)
def _count_within(distances, places, limit):  # type: ignore[no-untyped-def]
    """Return how many of the distances at the `places` are at most `limit` in size."""
    n = 0
    for v in places:
        n += abs(distances[v]) <= limit
    return n


def _mix(calm: CalmVertices, parts: Parts) -> Floats:
    """Return one sigma (m,) [m] of all parts but the registration's, of all vertices of the side."""
    out = np.empty(len(calm.own))
    run_tasks(_mix_parts, len(out), calm.own, calm.discord, calm.shared, parts, out)
    return keep_on_disk(out)


@jit(nopython=True, cache=True, nogil=True)
def _mix_parts(first, last, surfaces, discord, shared, parts, out):  # type: ignore[no-untyped-def]
    """Write what `Parts.mix` returns."""
    for v in range(first, last):
        a, b, c = parts.surfaces * surfaces[v], parts.discord * discord[v], parts.shared * shared[v]
        out[v] = np.sqrt(a * a + b * b + c * c + parts.floor * parts.floor)


def _thin_out(calm: Sequence[CalmVertices]) -> list[CalmVertices]:
    """Return some `N_LEARNT` of the calm vertices of both sides, at even steps through their strata, side by side in
    memory: what a scale is learned from where a group holds more. All where they are no more than that.
    """
    step, ahead, out = max(sum(len(c.places) for c in calm) // N_LEARNT, 1), 0, []
    for c in calm:
        chosen = c.members[ahead::step] if step > 1 else c.members
        stratum = np.repeat(np.arange(N_STRATA, dtype=np.uint16), np.diff(c.starts))[ahead::step]
        ahead = (ahead - len(c.members)) % step
        starts = np.append(0, np.cumsum(np.bincount(stratum, minlength=N_STRATA)))
        own, motion, places = c.own[chosen], c.motion[chosen], np.arange(len(chosen), dtype=np.int32)
        out.append(c._replace(places=places, distances=c.distances[chosen], own=own, motion=motion, stratum=stratum,
                              members=places, starts=starts))  # fmt: skip
    return list(calm) if step == 1 else out


def _learn_parts(calm: Sequence[CalmVertices], share: float, known: Correlation | None,
                 rng: np.random.Generator) -> Parts:  # fmt: skip
    """Return the parts that the distances show; as stated, above a floor, where nobody knows how many witnesses there
    are."""
    distances, *stated = _draw_evenly(calm)
    n_witnesses = _count(calm, EVERY, known, rng)
    if n_witnesses < FEWEST_WITNESSES:
        return Parts(1.0, 1.0, 1.0, estimate_floor(distances, np.sqrt(sum(s**2 for s in stated)), share))
    return fit_parts(distances, (stated[0], stated[1], stated[2], stated[3]), n_witnesses)


def _draw_evenly(calm: Sequence[CalmVertices]) -> list[Floats]:
    """Return distances and the four stated sigmas [m] of as many calm vertices as parts are learned from, at even
    steps."""
    step, first, drawn = max(sum(len(c.places) for c in calm) // N_FLOOR, 1), 0, []
    for c in calm:
        some = c.places[-first % step :: step]
        drawn.append([c.distances[some], c.own[some], c.discord[some], c.shared[some], c.motion[some]])
        first += len(c.places)
    return [np.concatenate(column) for column in zip(*drawn, strict=True)]


def believe(asked: float, n_witnesses: float, held_by: float) -> float:
    """Return the factor that remains of the one `asked` for by so many witnesses: its logarithm, weighted against those
    that it is `held_by`.

    The 95 % quantile of n independent errors is known to 0.95 / sqrt(n) of its logarithm, one sigma. What is held to be
    off by a factor of f, one sigma, weighs 0.95^2 / ln(f)^2 witnesses: of two 2, of 1.4 8.
    """
    return float(max(asked, 1e-300) ** (n_witnesses / (n_witnesses + held_by)))


def _count(calm: Sequence[CalmVertices], members: Ints, known: Correlation | None, rng: np.random.Generator) -> float:
    """Return how many witnesses some strata hold, on the side that has more of them; both bear the same witness."""
    if known is None:
        return 0.0
    held = [_n_held(c, members) for c in calm]
    most, n = calm[int(np.argmax(held))], max(held)
    ranks = _draw_ranks(n, rng)
    if n > MANY:  # by stratum, without a pass over all
        ends = np.cumsum(most.starts[members + 1] - most.starts[members])
        which = np.searchsorted(ends, ranks, side="right")
        some = most.members[most.starts[members + 1][which] + ranks - ends[which]]
    else:
        some = most.places[_find_members(most.stratum, _mark(members), ranks)]
    return _worth(most.points[some], n, known)


def _n_held(calm: CalmVertices, members: Ints) -> int:
    """Return how many vertices some strata hold."""
    return int((calm.starts[members + 1] - calm.starts[members]).sum())


def _mark(members: Ints) -> Bools:
    """Return whether each stratum (N_STRATA,) is one of `members`."""
    table = np.zeros(N_STRATA, dtype=np.bool_)
    table[members] = True
    return table


@jit(nopython=True, cache=True, nogil=True)
def _find_members(stratum, is_member, ranks):  # type: ignore[no-untyped-def]
    """Return where the vertices are that have these `ranks`, rising, among those whose stratum is a member."""
    out, at, rank = np.empty(len(ranks), dtype=np.int64), 0, 0
    for k in range(len(ranks)):
        while not is_member[stratum[at]] or rank < ranks[k]:
            rank += is_member[stratum[at]]
            at += 1
        out[k] = at
    return out


def count_witnesses(points: Floats, places: Ints, correlation: Correlation, rng: np.random.Generator) -> float:
    """Return how many independent errors those at the `places` (n,) among `points` (m, 3) m are worth to one who asks
    for their size.

    The squares of normal errors with correlation rho correlate with rho^2 (Isserlis 1918), so a variance learned from
    n of them is as sure as one from n / (1 + (n - 1) mean rho^2) independent ones.
    """
    return _worth(points[places[_draw_ranks(len(places), rng)]], len(places), correlation)


def _draw_ranks(n: int, rng: np.random.Generator) -> Ints:
    """Return which of n vertices show how many witnesses all are, rising; all where they are few."""
    return np.arange(n) if n <= N_PAIRED else np.sort(rng.choice(n, N_PAIRED, replace=False))


def _worth(points: Floats, n: int, correlation: Correlation) -> float:
    """Return how many independent errors n are worth that lie as the `points` (k, 3) [m] drawn from them do."""
    if n < 2:
        return float(n)
    return n / (1.0 + (n - 1) * correlation.mean_square(points))


def asked_scale(calm: Sequence[CalmVertices], members: Ints, factors: Floats, share: float) -> float:
    """Return what `own` must be multiplied by for `share` of the distances to lie where a normal error puts them.

    Asked are the vertices in the strata `members`, whose `own` is taken times the `factors` (N_STRATA,) of their
    stratum. The registration's part is learned from residuals and stays as stated. It was fitted to these very
    distances, which show less of it than there is: it makes up for half of the variance at most.

    Notes
    -----
    A distance lies within z sqrt(s^2 own^2 + motion^2) where s^2 >= (d^2 / z^2 - motion^2) / own^2: s^2 is the `share`
    quantile of the right-hand sides.
    """
    z = float(norm.ppf(0.5 + 0.5 * share))
    low, high, t = around_quantile(_gather_ratios(calm, members, factors, z, False), share)
    found = between(low, high, t)
    if low > 0.51:  # the other ratios lie between these and 1: at most twice as large from here on
        return float(np.sqrt(found))
    return float(np.sqrt(max(found, 0.5 * quantile(_gather_ratios(calm, members, factors, z, True), share))))


def _gather_ratios(calm: Sequence[CalmVertices], members: Ints, factors: Floats, z: float, is_within: bool) -> Floats:
    """Return (d^2 / z^2 - motion^2) / own^2, or d^2 / z^2 / (own^2 + motion^2) where `is_within`, of the vertices in
    the strata `members`."""
    ratios, used = np.empty(sum(_n_held(c, members) for c in calm)), 0
    for c in calm:
        used = _add_ratios(c, members, factors, z, is_within, ratios, used)
    return ratios


@jit(nopython=True, cache=True, nogil=True)
def _add_ratios(calm, strata, factors, z, is_within, ratios, used):  # type: ignore[no-untyped-def]
    """Write the ratios of some strata of one side from `used` on; return how many are used then."""
    for k in strata:
        for i in range(calm.starts[k], calm.starts[k + 1]):
            v = calm.members[i]
            d, own = calm.distances[v] / z, factors[k] * calm.own[v]
            own2, motion2 = max(own * own, 1e-300), calm.motion[v] * calm.motion[v]
            ratios[used] = d * d / (own2 + motion2) if is_within else (d * d - motion2) / own2
            used += 1
    return used
