"""What surfaces state beyond the noise of their points: a guess, since the points do not tell the shape there.

In: a side, and what its surfaces state of most places. Out: the part of each vertex's variance that is a guess, what
of it the sum over a region keeps, and how much of a surface and its regions is guessed. The noise of most of a surface
is scaled to what its calm places show, and averages out over patches. A guess does neither: that most places err by
less than they state says nothing of an ornament that the points are too sparse for, and there fits err alike as far as
the ornament goes on. A scanner's columns cross a moulding along all of its length as they cross it at one place, in
each epoch at other heights of its profile; both surfaces lie off it then by millimetres and decimetres long, and off
each other.
"""

from __future__ import annotations

import numpy as np

from monitor.blocks import blocks
from monitor.comparison.distances.quantile import median
from monitor.comparison.distances.side import Side
from projects.model import Bools, Floats, Ints, Roughness

SURE = 3.0  # sigmas of a region's mean, a guess as stated, at least: guesses have longer tails than noise
BEYOND = 0.5  # of the way from both surfaces to their samples: relief of 27 degrees, missed by all fits of a region
FARTHER = 2.0  # than what surfaces state of most places: no noise makes a fit to as many points so unsure
LEAST_SMOOTH = 0.05  # of what is assessed, that shows what is stated of smooth places
N_ASKED = 200_000  # vertices of a side, at even steps, that show what is stated of most places
Places = Ints | slice


def usual_sigma(sides: tuple[Side, Side]) -> float:
    """Return what the surfaces state of most assessed vertices [m]: the median; infinite where none is assessed.

    On an object that is mostly too fine for its points that is itself a guess, beyond `FARTHER` times what they state
    of most smooth vertices: it is the median of these then. Fewer of them than `LEAST_SMOOTH` say nothing.
    """
    drawn, smooth = [], []
    for side in sides:
        places = np.flatnonzero(side.is_assessed)
        places = places[:: max(len(places) // N_ASKED, 1)]
        drawn.append(side.sigma_surfaces[places])
        smooth.append(is_smooth(side, places))
    stated, is_calm = np.concatenate(drawn), np.concatenate(smooth)
    if not len(stated):
        return np.inf
    of_all = float(median(stated))
    of_smooth = float(median(stated[is_calm])) if is_calm.mean() >= LEAST_SMOOTH else np.inf
    return of_smooth if of_all > FARTHER * of_smooth else of_all


def split_stated(side: Side, usual: float, which: Places = slice(None)) -> tuple[Floats, Floats]:
    """Return the variance [m2] that the surfaces state of each vertex, or of those in `which`, in two: what is noise of
    the points, and what is a guess, beyond `FARTHER` times the `usual` [m]. On smooth places, where few points make a
    fit unsure, all is noise."""
    stated2 = side.sigma_surfaces[which] ** 2
    noise2 = np.where(is_smooth(side, which), stated2, np.minimum(stated2, (FARTHER * usual) ** 2))
    return noise2, np.subtract(stated2, noise2, out=np.zeros(len(stated2)), where=noise2 < stated2)


def areas_of_guesses(
    sides: tuple[Side, Side], usual: float, regions: tuple[Ints, Ints], n: int
) -> tuple[float, Floats]:
    """Return the assessed area [m2] where surfaces guess, and that in each of the regions (n,) 1 to n; of the side that
    has more of it."""
    total, within = 0.0, np.zeros(n)
    for side, region in zip(sides, regions, strict=True):
        guessed = np.zeros(n + 1)
        for block in blocks(len(side.areas)):
            is_guess = (split_stated(side, usual, block)[1] > 0.0) & side.is_assessed[block]
            guessed += np.bincount(region[block][is_guess], side.areas[block][is_guess], minlength=n + 1)
        total, within = max(total, float(guessed.sum())), np.maximum(within, guessed[1:])
    return total, within


def to_samples(side: Side, which: Places = slice(None)) -> Floats:
    """Return how far [m] each vertex (n,), or each of those in `which`, and its foot lie from the nearest samples of
    their surfaces, together; infinite where one does not say or there is no foot."""
    own, other, feet = side.surface.sample_distance, side.other.sample_distance, side.foot_vertices[which]
    if own is None or other is None:
        return np.full(len(feet), np.inf)
    return np.where(feet >= 0, own[which] + other[feet], np.inf)


def mean_to_samples(sides: tuple[Side, Side], regions: tuple[Ints, Ints], n: int) -> Floats:
    """Return how far [m] both surfaces lie from their samples (`to_samples`) in each of the regions (n,) 1 to n: the
    mean over what is assessed on both sides; infinite where one has nothing of a region, and bears it not out."""
    if any(side.surface.sample_distance is None for side in sides):
        return np.full(n, np.inf)
    areas, sums = np.zeros((2, n + 1)), np.zeros((2, n + 1))
    for k, (side, region) in enumerate(zip(sides, regions, strict=True)):
        at = np.flatnonzero((region > 0) & side.is_assessed)
        areas[k] = np.bincount(region[at], side.areas[at], minlength=n + 1)
        sums[k] = np.bincount(region[at], side.areas[at] * to_samples(side, at), minlength=n + 1)
    is_shown = (areas > 0.0).all(axis=0)
    return np.asarray(np.divide(sums.sum(axis=0), areas.sum(axis=0), out=np.full(n + 1, np.inf), where=is_shown)[1:])


def is_smooth(side: Side, which: Places = slice(None)) -> Bools:
    """Return which vertices, or which of those in `which`, lie on a smooth place in both epochs, or in that which knows
    its roughness; none where neither does."""
    known = []
    if side.surface.roughness is not None:
        known.append(side.surface.roughness[which] == Roughness.SMOOTH)
    if side.other.roughness is not None:
        at_feet = np.append(side.other.roughness, np.uint8(Roughness.SMOOTH))[side.foot_vertices[which]]  # -1: no foot
        known.append(at_feet == Roughness.SMOOTH)
    return np.logical_and.reduce(known) if known else np.zeros(len(side.foot_vertices[which]), dtype=np.bool_)


def sigma_of_guess(points: Floats, areas: Floats, variance: Floats, size: float) -> float:
    """Return one sigma [m3] of the sum of area times error over vertices at `points` (n, 3) [m] with `areas` (n,) [m2],
    of which `variance` (n,) [m2] is a guess: it errs alike in units of edge `size` [m] that lie one behind another
    along the longest way, and by itself in those beside each other."""
    if not variance.any():
        return 0.0
    total = float(areas.sum())
    rows = max(width_of(points, total) / size, 1.0)
    return float(np.sqrt(total * float(areas @ variance) / rows))


def width_of(points: Floats, area: float) -> float:
    """Return how wide [m] an even strip is whose points (n, 3) [m] spread as these do, or, where that is less, one as
    long as they lie apart and of this `area` [m2]: a frame is no wider than its moulding."""
    away = points - points.mean(axis=0)
    spread = np.sqrt(12.0 * np.maximum(np.linalg.eigvalsh(away.T @ away / len(points)), 0.0))
    return float(min(spread[1], area / max(spread[2], 1e-300)))
