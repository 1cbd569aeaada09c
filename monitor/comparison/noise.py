"""What the stable areas say about the errors of a comparison: their size, and how far they agree along the surface.

Both epochs see the same shape with the same fits, so part of their errors is the same and falls out of the difference:
what is stated of each surface alone is then too much. Other errors are stated of neither. The stable areas show both,
as a scale of what is stated (at most 1) or a floor beneath it. That is the size of most errors, and right for a level
that one vertex in twenty exceeds. What scans disagree by is large in few places, of which most of the surface says
nothing: a test of patches at one in a hundred thousand keeps it as stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import pdist
from scipy.stats import norm

from monitor.comparison.correlation import Correlation, estimate_correlation
from monitor.comparison.level_of_detection import estimate_floor, least_floor
from monitor.comparison.side import Side
from projects.model import Bools, Floats, Ints

Masks = tuple[Bools, Bools]
FEWEST_WITNESSES = 5.0  # that a stratum must hold to have a floor or a scale of its own
STATED_WITNESSES = 5.0  # that what is stated counts for, against those who say that it is too much
RIM_STEPS = (2.0, 4.0, 8.0, 16.0)  # spacings from a free edge, where one stratum ends and the next begins
N_STRATA = 3 * (len(RIM_STEPS) + 1)
N_PAIRED = 1000  # vertices of a stratum whose pairs show how many witnesses it holds


@dataclass(frozen=True)
class Noise:
    """`floors` [m] and `scales` (of what surfaces and scans state) of each stratum; `correlation` of the errors;
    `spacing` [m] of the vertices.

    A stratum is a roughness class at some distance from a free edge: where a surface ends it was seen at a glancing
    angle, by few scans, and the errors show it.
    """

    floors: Floats
    scales: Floats
    correlation: Correlation
    spacing: float

    def floor_of(self, side: Side) -> Floats:
        """Return the floor (n,) [m] of each vertex."""
        return self.floors[stratum_of(side, self.spacing)]

    def scale_of(self, side: Side) -> Floats:
        """Return the scale (n,) of what is stated at each vertex."""
        return self.scales[stratum_of(side, self.spacing)]

    def is_at_rim(self, side: Side) -> Bools:
        """Return whether each vertex (n,) lies in the two strata beside a free edge."""
        return stratum_of(side, self.spacing) < 3 * 2

    def variance_of(self, side: Side) -> Floats:
        """Return the variance (n,) [m2] of each vertex's change without what is common to many: scans, registration."""
        return (self.scale_of(side) * side.sigma_surfaces) ** 2 + self.floor_of(side) ** 2

    def common_of(self, side: Side) -> Floats:
        """Return one sigma (n,) [m] of what is common to many, as it shows in most places: scans, scaled, and
        registration."""
        return np.hypot(self.scale_of(side) * side.sigma_shared, side.sigma_motion)


def stratum_of(side: Side, spacing: float) -> Ints:
    """Return the stratum (n,) of each vertex: 3 times the step from the rim, plus the roughness class."""
    rim = np.digitize(np.where(np.isnan(side.to_rim), np.inf, side.to_rim) / spacing, RIM_STEPS)
    rough = np.zeros(len(rim), dtype=np.int64) if side.surface.roughness is None else side.surface.roughness
    return 3 * rim + np.minimum(rough, 2)


def learn_noise(sides: tuple[Side, Side], calm: Masks, share: float, rng: np.random.Generator,
                known: Correlation | None = None) -> Noise:  # fmt: skip
    """Learn the noise from the vertices in `calm`, of which the innermost `share` is trusted.

    `known` is how errors agree, as far as it is known already: what many witnesses say is too much is scaled down, and
    a stratum that holds many has a floor or a scale of its own.
    """
    spacing = float(np.sqrt(np.median(np.concatenate([s.areas for s in sides]))))
    floors, scales = learn_sizes([_witness(s, c, spacing) for s, c in zip(sides, calm, strict=True)], share, known, rng)
    floors = np.maximum(floors, max(least_floor(s.surface.vertices) for s in sides))
    noise = Noise(floors, scales, Correlation(np.zeros(1), np.ones(1)), spacing)
    lead = int(calm[1].sum() > calm[0].sum())
    side, which = sides[lead], calm[lead]
    errors = side.distances[which] / np.sqrt(noise.variance_of(side) + noise.common_of(side) ** 2)[which]
    correlation = estimate_correlation(side.surface.vertices[which], errors, side.areas[which], rng)
    return replace(noise, correlation=correlation)


class _Calm(NamedTuple):
    """The calm vertices of one side: `points` (n, 3), `distances` and stated `sigma` (n,) [m], `stratum` (n,)."""

    points: Floats
    distances: Floats
    sigma: Floats
    stratum: Ints


def _witness(side: Side, calm: Bools, spacing: float) -> _Calm:
    """Return the calm vertices of a side."""
    sigma = np.hypot(side.sigma_surfaces, side.sigma_common)
    return _Calm(side.surface.vertices[calm], side.distances[calm], sigma[calm], stratum_of(side, spacing)[calm])


def learn_sizes(
    calm: Sequence[_Calm], share: float, known: Correlation | None, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return floor [m] and scale of each stratum: the common ones, or its own where its errors are of another size.

    Of another size means: by more than two standard errors of a spread learned from so many witnesses. A roughness
    class is judged within its distance from the rim.
    """
    distances, sigma, stratum = (np.concatenate([getattr(c, name) for c in calm])
                                 for name in ("distances", "sigma", "stratum"))  # fmt: skip
    every = np.arange(N_STRATA)
    floor, scale = size_of_errors(distances, sigma, share, _count(calm, every, known, rng))
    floors, scales = np.full(N_STRATA, floor), np.full(N_STRATA, scale)
    for members in [every[every // 3 == k] for k in range(N_STRATA // 3)] + [every[k : k + 1] for k in every]:
        n_witnesses, group = _count(calm, members, known, rng), _is_of(stratum, members)
        if n_witnesses < FEWEST_WITNESSES:
            continue
        spread = np.hypot(scales[members[0]] * sigma[group], floors[members[0]])
        if abs(np.log(max(asked_scale(distances[group], spread, share), 1e-300))) > 2.0 / np.sqrt(n_witnesses):
            floors[members], scales[members] = size_of_errors(distances[group], sigma[group], share, n_witnesses)
    return floors, scales


def _count(calm: Sequence[_Calm], members: Ints, known: Correlation | None, rng: np.random.Generator) -> float:
    """Return how many witnesses some strata hold, on the side that has more of them; both bear the same witness."""
    if known is None:
        return 0.0
    return count_witnesses(max((c.points[_is_of(c.stratum, members)] for c in calm), key=len), known, rng)


def _is_of(stratum: Ints, members: Ints) -> Bools:
    """Return whether each stratum number (n,) is one of `members`."""
    table = np.zeros(N_STRATA, dtype=np.bool_)
    table[members] = True
    return table[stratum]


def count_witnesses(points: Floats, correlation: Correlation, rng: np.random.Generator) -> float:
    """Return how many independent errors those at `points` (n, 3) m are worth to one who asks for their size.

    The squares of normal errors with correlation rho correlate with rho^2 (Isserlis 1918), so a variance learned from
    n of them is as sure as one from n / (1 + (n - 1) mean rho^2) independent ones.
    """
    n = len(points)
    if n < 2:
        return float(n)
    some = points if n <= N_PAIRED else points[np.sort(rng.choice(n, N_PAIRED, replace=False))]
    return n / (1.0 + (n - 1) * float(np.mean(correlation.at(pdist(some)) ** 2)))


def size_of_errors(distances: Floats, sigma: Floats, share: float, n_witnesses: float) -> tuple[float, float]:
    """Return the floor [m] beneath what is stated, or the scale of it, with which the innermost `share` is as stated.

    A scale below 1 is the mean of its square and of 1, weighted by the witnesses and by `STATED_WITNESSES`.
    """
    floor = estimate_floor(distances, sigma, share)
    if floor > 0.0 or not len(distances):
        return floor, 1.0
    asked2 = min(asked_scale(distances, sigma, share), 1.0) ** 2
    return floor, float(np.sqrt((n_witnesses * asked2 + STATED_WITNESSES) / (n_witnesses + STATED_WITNESSES)))


def asked_scale(distances: Floats, sigma: Floats, share: float) -> float:
    """Return what sigma must be multiplied by for `share` of the distances to lie where a normal error puts them."""
    ratio = np.abs(distances) / np.maximum(sigma, 1e-300)
    return float(np.quantile(ratio, share)) / float(norm.ppf(0.5 + 0.5 * share))
