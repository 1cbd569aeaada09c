"""How large a change must at least be to be told, place by place, and how much of a surface tells only large ones.

In: the sides and what was detected on them. Out: metres at each vertex, and figures of the whole. "Unchanged" says that
no change was told; the median level of detection says of most of a surface how small one may be. On ornament that the
points are too sparse for, along edges and between samples only much larger ones are.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from monitor.comparison.guesses import SURE, areas_of_guesses, split_stated
from monitor.comparison.quantile import median
from monitor.comparison.regions import assessed_area, sigmas_needed
from monitor.comparison.scratch import keep_on_disk
from monitor.comparison.side import Side, larger_of, map_sides
from monitor.comparison.tested import Detected
from projects.model import ComparedSurface, Floats, Ints

Told = tuple[ComparedSurface, ComparedSurface]  # on the reference and the compared surface
COARSE = 4.0  # times the median level of detection, beyond which a place tells only large changes
WORST = 0.95  # of the coarse area tells smaller changes than the figure given


def add_told_from(told: Told, sides: tuple[Side, Side], found: Detected, level: float) -> tuple[Told, dict[str, Any]]:
    """Return both sides (reference, compared) with `told_from` and `coarse_from`, and the figures of the compared one:
    from which change on a place is coarse `coarse_from_m`, which share of the assessed area is so, `coarse_area_share`,
    and from how large a change on nearly all of that tells one, `coarse_told_from_m`, NaN without any."""
    assessed = told[1].lod95[sides[1].is_assessed]
    coarse_from = COARSE * median(assessed) if len(assessed) else float("nan")
    smallest = tell_smallest(sides, found, level)
    before, after = (replace(t, told_from=s, coarse_from=coarse_from) for t, s in zip(told, smallest, strict=True))
    areas, is_coarse = sides[1].areas, after.is_coarse
    whole = float(areas[sides[1].is_assessed].sum())
    figures = {
        "coarse_from_m": coarse_from,
        "coarse_area_share": float(areas[is_coarse].sum()) / whole if whole else float("nan"),
        "coarse_told_from_m": quantile_by_area(smallest[1][is_coarse], areas[is_coarse], WORST),
    }
    return (before, after), figures


def tell_smallest(sides: tuple[Side, Side], found: Detected, level: float) -> tuple[Floats, Floats]:
    """Return of each side how large the mean change [m] around a vertex (n,) must at least be to be told, NaN where it
    is not assessed: its level of detection, or what a region of one unit must have where surfaces guess
    (`regions.known_of`)."""
    usual, size2 = found.noise.usual, found.test.size**2
    no_region = (np.zeros(len(sides[0].areas), dtype=np.int32), np.zeros(len(sides[1].areas), dtype=np.int32))
    guessed, _ = areas_of_guesses(sides, usual, no_region, 0)
    among = max(SURE, sigmas_needed(guessed / size2, level))
    needed = min(among, sigmas_needed(assessed_area(sides) / size2, level))

    def of_side(k: int) -> Floats:
        """Return that of side k."""
        side = sides[k]
        guess = needed * guess_of_units(side, usual, found.test.units[k].number)
        return keep_on_disk(np.where(side.is_assessed, np.maximum(found.sides[k].lod95, guess), np.nan))

    return map_sides(of_side, larger_of(sides))


def guess_of_units(side: Side, usual: float, number: Ints) -> Floats:
    """Return one sigma [m] of what surfaces guess of the mean of the unit of each vertex (n,): they err alike in it.

    `number` (n,) are the units, -1 for none: 0 there.
    """
    n = int(number.max(initial=-1)) + 1
    guess2 = split_stated(side, usual)[1]
    counts = side.is_assessed & (number >= 0)
    areas, at = side.areas[counts], number[counts]
    total = np.bincount(at, areas * guess2[counts], minlength=n) / np.maximum(np.bincount(at, areas, n), 1e-300)
    return np.append(np.sqrt(total), 0.0)[number]  # -1 is the last


def quantile_by_area(values: Floats, areas: Floats, share: float) -> float:
    """Return the value that so large a share of the area has at most; NaN without any."""
    if not len(values):
        return float("nan")
    order = np.argsort(values, kind="stable")
    up_to = np.cumsum(areas[order])
    return float(values[order][np.searchsorted(up_to, share * up_to[-1]).clip(max=len(values) - 1)])
