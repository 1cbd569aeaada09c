"""What the stable areas say about the errors of a comparison: their size, and how far they agree along the surface.

Both epochs see the same shape with the same fits, so part of their errors is the same and falls out of the difference:
what is stated of each surface alone is then too much. Other errors are stated too small (relief that the points are
too sparse for, grazing views, places between samples) or not at all. The stable areas show it: as a scale of what the
surfaces state, one of what their neighbouring fits contradict each other by, one of what scans disagree by, a floor
beneath all, and a factor of each class of place. That is the size of most errors, and right for a level that one vertex
in twenty exceeds. Of a patch or region, a mean of many, what scans disagree by is most of the error: what it is there
patches show (`scan_errors`). What is a guess of the surfaces counts in a region as stated (`guesses`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import jit

from monitor.blocks import blocks
from monitor.comparison.distances.discord import SHARE
from monitor.comparison.distances.quantile import median
from monitor.comparison.distances.scratch import keep_on_disk
from monitor.comparison.distances.side import Side, larger_of, map_sides
from monitor.comparison.noise.asked_scale import asked_scale, believe
from monitor.comparison.noise.calm_vertices import CalmVertices, are_copies, gather_calm, n_held
from monitor.comparison.noise.correlation import Correlation, estimate_correlation, estimate_of_many
from monitor.comparison.noise.error_parts import Parts, fit_parts
from monitor.comparison.noise.guesses import split_stated, usual_sigma
from monitor.comparison.noise.level_of_detection import N_FLOOR, estimate_floor
from monitor.comparison.noise.strata import EVERY, GROUPS, KINDS, N_STRATA, lies_at_rim, mean_of_arms, stratum_of
from monitor.comparison.noise.stretch import EVEN, Stretch, learn_stretch
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
    errors; `spacing` [m] of the vertices; what surfaces state of most places is the `usual` [m], beyond which lies what
    they guess (`guesses`); `stretch`, how much farther than that errors agree, by the sigma of a vertex."""

    floors: Floats
    scales: Floats
    discord_scales: Floats
    shared_scales: Floats
    correlation: Correlation
    spacing: float
    usual: float = np.inf
    stretch: Stretch = EVEN

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

    def is_at_rim(self, side: Side, which: Ints | slice = slice(None)) -> Bools:
        """Return whether each vertex (n,), or each of those in `which`, lies in the two strata beside a free edge."""
        return lies_at_rim(stratum_of(side, self.spacing, which))

    def variance_of(self, side: Side, which: Ints | slice = slice(None)) -> Floats:
        """Return the variance [m2] of the change of each vertex, or of those in `which`, without what is common to
        many: scans, registration. It takes the thirds of the lever arm as one: what they differ by is right for a
        level that one vertex in twenty exceeds, and partly chance."""
        return self._scaled(side, which, side.sigma_surfaces[which] ** 2)

    def parts_of(self, side: Side, which: Ints | slice = slice(None)) -> tuple[Floats, Floats]:
        """Return what `variance_of` does in two: without what the surfaces guess, and this, which is as stated, or
        scaled where stable areas show more."""
        noise2, guess2 = split_stated(side, self.usual, which)
        return self._scaled(side, which, noise2), self._scaled_guess(side, which, guess2)

    def guess_of(self, side: Side, which: Ints | slice = slice(None)) -> Floats:
        """Return the second of `parts_of`."""
        return self._scaled_guess(side, which, split_stated(side, self.usual, which)[1])

    def _scaled_guess(self, side: Side, which: Ints | slice, guess2: Floats) -> Floats:
        """Return the variance [m2] of the vertices in `which` that is a guess, of which so much is stated."""
        if not guess2.any():
            return guess2
        scale = mean_of_arms(self.scales)[stratum_of(side, self.spacing, which)]
        return np.asarray(np.maximum(scale, 1.0) ** 2 * guess2)

    def _scaled(self, side: Side, which: Ints | slice, surfaces2: Floats) -> Floats:
        """Return the variance [m2] of the vertices in `which`, whose surfaces state `surfaces2` [m2]."""
        stratum = stratum_of(side, self.spacing, which)
        scales, discord, floors = (mean_of_arms(v) for v in (self.scales, self.discord_scales, self.floors))
        own2 = scales[stratum] ** 2 * surfaces2 + (discord[stratum] * side.sigma_discord[which]) ** 2
        return np.asarray(own2 + (floors**2)[stratum])

    def common_of(self, side: Side, which: Ints | slice = slice(None)) -> Floats:
        """Return one sigma (n,) [m] of what is common to many, as it shows in most places: scans, scaled but at limbs,
        and registration; of each vertex or of those in `which`."""
        scale = self.shared_scales[stratum_of(side, self.spacing, which)]
        scans = np.hypot(scale * side.sigma_shared[which], side.limb_of(which))
        return np.hypot(scans, side.sigma_motion[which])


def learn_noise(sides: tuple[Side, Side], calm: Masks, share: float, rng: np.random.Generator,
                known: Correlation | None = None) -> Noise:  # fmt: skip
    """Learn the noise from the vertices in `calm`, of which the innermost `share` is trusted.

    `known` is how errors agree, as far as it is known already: what many witnesses say is too much is scaled down, and
    a stratum that holds many has a floor or a scale of its own.
    """
    spacing = float(np.sqrt(median(np.concatenate([s.areas for s in sides]))))
    witnesses = map_sides(lambda k: gather_calm(sides[k], calm[k], spacing), larger_of(sides))
    parts, factors = learn_sizes(witnesses, share, known, rng)
    floors = np.maximum(factors * parts.floor, max(w.resolution for w in witnesses))
    unknown = Correlation(np.zeros(1), np.ones(1))
    noise = Noise(floors, factors * parts.surfaces, factors * parts.discord, factors * parts.shared, unknown, spacing,
                  usual_sigma(sides))  # fmt: skip
    lead = int(calm[1].sum() > calm[0].sum())
    noise = replace(noise, correlation=_correlate(sides[lead], calm[lead], noise, rng))
    return replace(noise, stretch=_stretch(sides[lead], calm[lead], noise, rng))


def _stretch(side: Side, calm: Bools, noise: Noise, rng: np.random.Generator) -> Stretch:
    """Return how much farther the errors of the calm vertices agree where they are small or large."""

    def errors_of(which: Ints) -> tuple[Floats, Floats]:
        """Return standardized errors (k,) and one sigma (k,) [m], the latter of each by itself."""
        return side.distances[which] / noise.sigma_of(side, which), np.sqrt(noise.variance_of(side, which))

    places = np.flatnonzero(calm).astype(np.int32)
    return learn_stretch(side.surface.vertices, places, side.areas, errors_of, noise.correlation, rng)


def _correlate(side: Side, calm: Bools, noise: Noise, rng: np.random.Generator) -> Correlation:
    """Return how the errors of the calm vertices of a side agree."""
    points, places = side.surface.vertices, np.flatnonzero(calm).astype(np.int32)
    if len(places) > MANY:
        return estimate_of_many(points, places, side.areas,
                                lambda which: side.distances[which] / noise.sigma_of(side, which), rng)  # fmt: skip
    errors = side.distances / noise.sigma_of(side)
    errors[~calm] = np.nan
    return estimate_correlation(points, errors, side.areas, rng)


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
            asked = drawn if sum(n_held(c, group) for c in calm) > N_LEARNT else calm
            factors[group] *= believe(asked_scale(asked, group, factors, share), n_witnesses, held_by)
    return parts, factors


def _mix(calm: CalmVertices, parts: Parts) -> Floats:
    """Return one sigma (m,) [m] of all parts but the registration's, of all vertices of the side."""
    out = np.empty(len(calm.own))
    run_tasks(_mix_parts, len(out), calm.own, calm.discord, calm.shared, parts, out)
    return keep_on_disk(out)


@jit(nopython=True, cache=True, nogil=True)
def _mix_parts(first, last, surfaces, discord, shared, parts, out):  # type: ignore[no-untyped-def]
    """Write what `_mix` returns of the vertices from `first` to `last`."""
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


def _count(calm: Sequence[CalmVertices], members: Ints, known: Correlation | None, rng: np.random.Generator) -> float:
    """Return how many witnesses some strata hold, on the side that has more of them; both bear the same witness."""
    if known is None:
        return 0.0
    held = [n_held(c, members) for c in calm]
    most, n = calm[int(np.argmax(held))], max(held)
    ranks = _draw_ranks(n, rng)
    if n > MANY:  # by stratum, without a pass over all
        ends = np.cumsum(most.starts[members + 1] - most.starts[members])
        which = np.searchsorted(ends, ranks, side="right")
        some = most.members[most.starts[members + 1][which] + ranks - ends[which]]
    else:
        some = most.places[_find_members(most.stratum, _mark(members), ranks)]
    return count_witnesses(most.points[some], n, known)


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


def _draw_ranks(n: int, rng: np.random.Generator) -> Ints:
    """Return which of n vertices show how many witnesses all are, rising; all where they are few."""
    return np.arange(n) if n <= N_PAIRED else np.sort(rng.choice(n, N_PAIRED, replace=False))


def count_witnesses(points: Floats, n: int, correlation: Correlation) -> float:
    """Return how many independent errors n are worth to one who asks for their size, that lie as the `points` (k, 3)
    [m] drawn from them do.

    The squares of normal errors with correlation rho correlate with rho^2 (Isserlis 1918), so a variance learned from
    n of them is as sure as one from n / (1 + (n - 1) mean rho^2) independent ones.
    """
    if n < 2:
        return float(n)
    return n / (1.0 + (n - 1) * correlation.mean_square(points))
