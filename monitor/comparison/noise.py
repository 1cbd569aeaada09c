"""What the stable areas say about the errors of a comparison: their floor, and how far they agree along the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from monitor.comparison.correlation import Correlation, estimate_correlation
from monitor.comparison.level_of_detection import estimate_floor, least_floor
from monitor.comparison.side import Side
from projects.model import Bools, Floats, Ints

Masks = tuple[Bools, Bools]
FEWEST_WITNESSES = 5.0  # that a stratum must hold to have a floor of its own
RIM_STEPS = (2.0, 4.0, 8.0, 16.0)  # spacings from a free edge, where one stratum ends and the next begins
N_STRATA = 3 * (len(RIM_STEPS) + 1)


@dataclass(frozen=True)
class Noise:
    """`floors` [m] of each stratum; `correlation` of the errors; `spacing` [m] of the vertices.

    A stratum is a roughness class at some distance from a free edge: where a surface ends it was seen at a glancing
    angle, by few scans, and the errors show it.
    """

    floors: Floats
    correlation: Correlation
    spacing: float

    def floor_of(self, side: Side) -> Floats:
        """Return the floor (n,) [m] of each vertex."""
        return self.floors[stratum_of(side, self.spacing)]

    def variance_of(self, side: Side) -> Floats:
        """Return the variance (n,) [m2] of each vertex's change without what is common to many: scans, registration."""
        return side.sigma_surfaces**2 + self.floor_of(side) ** 2


def stratum_of(side: Side, spacing: float) -> Ints:
    """Return the stratum (n,) of each vertex: 3 times the step from the rim, plus the roughness class."""
    rim = np.digitize(np.where(np.isnan(side.to_rim), np.inf, side.to_rim) / spacing, RIM_STEPS)
    rough = np.zeros(len(rim), dtype=np.int64) if side.surface.roughness is None else side.surface.roughness
    return 3 * rim + np.minimum(rough, 2)


def learn_noise(sides: tuple[Side, Side], calm: Masks, share: float, rng: np.random.Generator,
                witness_area: float = np.inf) -> Noise:  # fmt: skip
    """Learn the noise from the vertices in `calm`, of which the innermost `share` is trusted.

    `witness_area` [m2] is the area over which errors agree, as far as it is known already: a stratum that holds many
    has a floor of its own.
    """
    spacing = float(np.sqrt(np.median(np.concatenate([s.areas for s in sides]))))
    noise = Noise(
        learn_floors(sides, calm, share, spacing, witness_area), Correlation(np.zeros(1), np.ones(1)), spacing
    )
    lead = int(calm[1].sum() > calm[0].sum())
    side, which = sides[lead], calm[lead]
    errors = side.distances[which] / np.sqrt(noise.variance_of(side)[which] + side.sigma_common[which] ** 2)
    correlation = estimate_correlation(side.surface.vertices[which], errors, side.areas[which], rng)
    return Noise(noise.floors, correlation, spacing)


def learn_floors(sides: tuple[Side, Side], calm: Masks, share: float, spacing: float, witness_area: float) -> Floats:
    """Return the floor [m] of each stratum: the common one, or its own where its errors are of another size.

    Of another size means: by more than two standard errors of a spread learned from so many witnesses. A roughness
    class is judged within its distance from the rim.
    """
    distances = np.concatenate([s.distances[c] for s, c in zip(sides, calm, strict=True)])
    sigma = np.concatenate([np.hypot(s.sigma_surfaces, s.sigma_common)[c] for s, c in zip(sides, calm, strict=True)])
    stratum = np.concatenate([stratum_of(s, spacing)[c] for s, c in zip(sides, calm, strict=True)])
    area = np.concatenate([s.areas[c] for s, c in zip(sides, calm, strict=True)])
    least = max(least_floor(s.surface.vertices) for s in sides)
    floors = np.full(N_STRATA, max(estimate_floor(distances, sigma, share), least))
    at_rim = [(stratum // 3 == k, slice(3 * k, 3 * k + 3)) for k in range(N_STRATA // 3)]
    single = [(stratum == k, slice(k, k + 1)) for k in range(N_STRATA)]
    for group, which in at_rim + single:
        n_witnesses = 0.5 * float(area[group].sum()) / max(witness_area, spacing**2)  # both sides bear the same witness
        if n_witnesses < FEWEST_WITNESSES:
            continue
        spread = np.sqrt(sigma[group] ** 2 + floors[which][0] ** 2)
        asked = float(np.quantile(np.abs(distances[group]) / spread, share)) / float(norm.ppf(0.5 + 0.5 * share))
        if abs(np.log(max(asked, 1e-300))) > 2.0 / np.sqrt(n_witnesses):
            floors[which] = max(estimate_floor(distances[group], sigma[group], share), least)
    return floors
