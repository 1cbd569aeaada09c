"""What the stable areas say about the errors of a comparison: their floor, and how far they agree along the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monitor.comparison.correlation import Correlation, estimate_correlation
from monitor.comparison.level_of_detection import estimate_floor, least_floor
from monitor.comparison.side import Side
from projects.model import Bools, Floats

Masks = tuple[Bools, Bools]
LEAST_SHARE = 0.05  # of the stable vertices that a roughness class must hold to have a floor of its own


@dataclass(frozen=True)
class Noise:
    """`floors` [m], one for all vertices or one per roughness class; `correlation` of the errors."""

    floors: Floats
    correlation: Correlation

    def floor_of(self, side: Side) -> Floats:
        """Return the floor (n,) [m] of each vertex."""
        if side.surface.roughness is None:
            return np.full(len(side.areas), self.floors.max())
        return self.floors[np.minimum(side.surface.roughness, len(self.floors) - 1)]

    def variance_of(self, side: Side) -> Floats:
        """Return the variance (n,) [m2] of each vertex's change without the registration's part."""
        return side.sigma_surfaces**2 + self.floor_of(side) ** 2


def learn_noise(sides: tuple[Side, Side], calm: Masks, share: float, rng: np.random.Generator) -> Noise:
    """Learn the noise from the vertices in `calm`, of which the innermost `share` is trusted."""
    noise = Noise(learn_floors(sides, calm, share), Correlation(np.zeros(1), np.ones(1)))
    lead = int(calm[1].sum() > calm[0].sum())
    side, which = sides[lead], calm[lead]
    errors = side.distances[which] / np.sqrt(noise.variance_of(side)[which] + side.sigma_common[which] ** 2)
    return Noise(noise.floors, estimate_correlation(side.surface.vertices[which], errors, side.areas[which], rng))


def learn_floors(sides: tuple[Side, Side], calm: Masks, share: float) -> Floats:
    """Return the floor [m] of each roughness class; the common one where a class has too few stable vertices."""
    distances = np.concatenate([s.distances[c] for s, c in zip(sides, calm, strict=True)])
    sigma = np.concatenate([np.hypot(s.sigma_surfaces, s.sigma_common)[c] for s, c in zip(sides, calm, strict=True)])
    least = max(least_floor(s.surface.vertices) for s in sides)
    common = max(estimate_floor(distances, sigma, share), least)
    classes = [s.surface.roughness for s in sides]
    if classes[0] is None or classes[1] is None or not len(distances):
        return np.array([common])
    kind = np.concatenate([classes[0][calm[0]], classes[1][calm[1]]])
    floors = np.full(3, common)
    for k in range(3):
        if np.mean(kind == k) > LEAST_SHARE:
            floors[k] = max(estimate_floor(distances[kind == k], sigma[kind == k], share), least)
    return floors
