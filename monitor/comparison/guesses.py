"""What surfaces state beyond the noise of their points: a guess, since the points do not tell the shape there.

In: a side, and what its surfaces state of most places. Out: the part of each vertex's variance that is a guess, and
what of it a mean keeps. The noise of most of a surface is scaled to what its calm places show, and averages out over
patches. A guess does neither: that most places err by less than they state says nothing of an ornament that the points
are too sparse for, and there fits err alike as far as the ornament goes on. A scanner's columns cross a moulding along
all of its length as they cross it at one place, in each epoch at other heights of its profile; both surfaces lie off
it then by millimetres and decimetres long, and off each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from monitor.comparison.calm_vertices import CalmVertices
from monitor.comparison.quantile import median
from monitor.comparison.side import Side
from projects.model import Floats, Ints, Roughness

FARTHER = 2.0  # than what surfaces state of most places: no noise makes a fit to as many points so unsure
N_ASKED = 200_000  # vertices of both sides that show what they state of most places


def usual_sigma(calm: Sequence[CalmVertices]) -> float:
    """Return what the surfaces state of most calm vertices [m]: the median; infinite where there are none."""
    step = max(sum(len(c.places) for c in calm) // N_ASKED, 1)
    stated = np.concatenate([c.own[c.places[::step]] for c in calm])
    return float(median(stated)) if len(stated) else np.inf


def guessed_variance(side: Side, usual: float, which: Ints | slice = slice(None)) -> Floats:
    """Return the variance [m2] of each vertex, or of those in `which`, that is a guess: what the surfaces state beyond
    `FARTHER` times the `usual` [m], where the place is not smooth. On smooth places few points make a fit unsure."""
    excess = np.maximum(side.sigma_surfaces[which] ** 2 - (FARTHER * usual) ** 2, 0.0)
    if side.surface.roughness is not None:
        excess = np.where(side.surface.roughness[which] == Roughness.SMOOTH, 0.0, excess)
    return np.asarray(excess)


def kept_of_guess(n_units: Floats) -> Floats:
    """Return the share of a guess's variance that means over so many units keep: guesses err alike along one way, and
    by themselves across it, and of n units the root of n lie side by side."""
    return np.asarray(1.0 / np.sqrt(np.maximum(n_units, 1.0)))


def sigma_of_guess(points: Floats, weights: Floats, variance: Floats, size: float) -> float:
    """Return one sigma of a weighted sum of the changes of vertices at `points` (n, 3) [m], of which `variance` (n,)
    [m2] is a guess, that errs alike within units of edge `size` [m] and along the longest way of them all."""
    if not len(points):
        return 0.0
    across = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1:2] if len(points) > 1 else np.zeros(1)
    width = float(across[0]) * np.sqrt(12.0 / len(points))  # of an even strip whose points spread as these do
    return float(weights @ np.sqrt(variance)) / np.sqrt(max(width / size, 1.0))
