"""What scans err by in common where an epoch saw a place only steeply, as at the limb of a body.

In: both sides with the class of view of each vertex. Out: the sides with what is stated there beyond what is stated of
most places set apart (`Side.limb`). How much of what scans disagree by is error of a change most places show: where
both epochs' scans err alike, it falls out. They say nothing of a limb, where part of the spot misses the body: the only
scan that sees it stands off by millimetres, all alike, and that of the other epoch, from elsewhere, does not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from monitor.comparison.distances.quantile import median
from monitor.comparison.distances.scratch import keep_on_disk
from monitor.comparison.distances.side import Side
from projects.model import Floats

STEEP_VIEW = 2  # the class of view from which on no station of an epoch saw a place flatter than at 75 degrees
N_ASKED = 200_000  # vertices of a side, at even steps, that show what is stated of most places


def set_limbs_apart(sides: tuple[Side, Side]) -> tuple[Side, Side]:
    """Return the sides with what scans are stated to disagree by in two, where an epoch saw a place only steeply: up to
    what is stated of most places, and, in squares, what is beyond."""
    usual = _usual_shared(sides)
    first, second = (_set_apart(side, usual) for side in sides)
    return first, second


def _usual_shared(sides: tuple[Side, Side]) -> float:
    """Return what scans are stated to disagree by in most assessed places of both sides [m]; 0 where none is."""
    drawn: list[Floats] = []
    for side in sides:
        places = np.flatnonzero(side.is_assessed)
        drawn.append(side.sigma_shared[places[:: max(len(places) // N_ASKED, 1)]])
    stated = np.concatenate(drawn)
    return float(median(stated)) if len(stated) else 0.0


def _set_apart(side: Side, usual: float) -> Side:
    """Return a side whose steep places state up to the `usual` [m] of the scans, and the rest by itself."""
    is_steep = side.view >= STEEP_VIEW
    within = np.where(is_steep, np.minimum(side.sigma_shared, usual), side.sigma_shared)
    limb = np.sqrt(np.maximum(side.sigma_shared**2 - within**2, 0.0))
    return replace(side, sigma_shared=keep_on_disk(within), limb=keep_on_disk(limb)) if limb.any() else side
