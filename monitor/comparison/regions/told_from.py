"""From about how large a change on each place tells one, and how much of a surface tells only large ones.

In: the sides, what was detected on them, the answer. Out: metres at each vertex, and figures of the whole. "Unchanged"
says that no change was told; the median says of most of a surface how small one may be. On ornament that the points are
too sparse for, along edges and between samples only much larger ones are told.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from monitor.blocks import blocks
from monitor.comparison.detection.tested import Detected
from monitor.comparison.detection.units import average_by_unit
from monitor.comparison.distances.quantile import median
from monitor.comparison.distances.scratch import keep_on_disk
from monitor.comparison.distances.side import Side, larger_of, map_sides
from monitor.comparison.noise.guesses import BEYOND, SURE, areas_of_guesses, to_samples
from monitor.comparison.noise.model import Noise
from monitor.comparison.regions.finding import assessed_area, sigmas_needed
from projects.model import Z95, Bools, ComparedSurface, Floats, Ints, NotAssessed

Told = tuple[ComparedSurface, ComparedSurface]  # on the reference and the compared surface
COARSE = 4.0  # times what most places tell, beyond which a place tells only large changes
NEARLY_ALL = 0.95  # of the coarse area tells changes of the size given


def tell_smallest(
    sides: tuple[Side, Side], found: Detected, needs: tuple[Floats, Floats], level: float, are_points_asked: bool
) -> tuple[Floats, Floats]:
    """Return of each side from how large a mean change [m] of the unit of a vertex (n,) float32 on a region is told.

    That is what a unit's own patch needs (`needs`, (u, s) of each side, `needed.patches_needed`), and where the
    surfaces guess, no less than what a region must have that is the guessed part of the unit (`regions.known_of`, and
    `lies_beyond_guesses` where `are_points_asked`): a guess errs alike all over it.
    """
    usual = found.noise.usual
    no_region = (np.zeros(len(sides[0].areas), dtype=np.int32), np.zeros(len(sides[1].areas), dtype=np.int32))
    guessed, whole = areas_of_guesses(sides, usual, no_region, 0)[0], assessed_area(sides)

    def of_side(k: int) -> Floats:
        """Return that of side k."""
        side, units = sides[k], found.test.units[k]
        told = of_own_patch(units.number, needs[k])
        if not guessed:
            return keep_on_disk(told)
        guess2 = guess_of(side, found.noise)
        number = np.where((guess2 > 0.0) & side.is_assessed, units.number, -1)
        areas, mean2 = average_by_unit(number, side.areas, guess2, len(units.areas))
        areas = np.where(mean2 > 0.0, areas, np.inf)  # a unit that guesses nothing is not asked
        among = np.maximum(SURE, sigmas_needed(guessed / areas, level))
        least = np.minimum(among, sigmas_needed(whole / areas, level)) * np.sqrt(mean2)
        if are_points_asked:
            way = average_by_unit(number, side.areas, to_samples(side), len(least))[1]
            least = np.fmin(least, np.fmax(BEYOND * way, Z95 * np.sqrt(mean2)))
        is_guess = number >= 0
        told[is_guess] = np.maximum(told[is_guess], least.astype(np.float32)[number[is_guess]])
        return keep_on_disk(told)

    return map_sides(of_side, larger_of(sides))


def of_own_patch(number: Ints, needs: Floats) -> Floats:
    """Return what the patch of the unit of each vertex needs (n,) float32 [m]: of a scrap, which is not tested by
    itself, the one of its wider patches that needs least; NaN without any, and where that is not known."""
    of_unit = np.where(np.isnan(needs[:, 0]), np.fmin.reduce(needs, axis=1), needs[:, 0])
    return np.append(of_unit, np.nan).astype(np.float32)[number]


def guess_of(side: Side, noise: Noise) -> Floats:
    """Return the variance [m2] of each vertex (n,) that is a guess of the surfaces, as regions hold it."""
    out = np.empty(len(side.areas))
    for block in blocks(len(out)):
        out[block] = noise.guess_of(side, block)
    return out


def add_told_from(told: Told, smallest: tuple[Floats, Floats]) -> Told:
    """Return the answer on the reference and the compared surface with how small a change (n,) [m] each tells where it
    is assessed, and from where on that is coarse: on both by what most of the compared one tells."""
    coarse_from = coarse_beyond(smallest[1][told[1].reasons == NotAssessed.ASSESSED])

    def of_side(k: int) -> ComparedSurface:
        """Return that of side k."""
        is_assessed = told[k].reasons == NotAssessed.ASSESSED
        least = keep_on_disk(np.where(is_assessed, smallest[k], np.float32(np.nan)))
        return replace(told[k], told_from=least, coarse_from=coarse_from)

    return of_side(0), of_side(1)


def coarse_beyond(smallest: Floats) -> float:
    """Return beyond how large a change, or rate, a place that tells none smaller is coarse, of what all assessed places
    (m,) tell; NaN of none, and where that is not known."""
    known = smallest[np.isfinite(smallest)]
    return COARSE * float(median(known)) if len(known) else float("nan")


def coarse_figures(told: ComparedSurface, areas: Floats, tolerance: float | None) -> dict[str, Any]:
    """Return from how large a change on one is told on a side with vertices of so large `areas` (n,) [m2]: on most of
    it (`told_from_median_m`), beyond which change a place is coarse (`coarse_from_m`), the `share_of_coarse`
    (`coarse_area_share`, `coarse_told_from_m`), and, where a client's `tolerance` [m] is given, which share tells no
    change of that size (`share_coarser_than_tolerance`)."""
    assert told.told_from is not None
    is_assessed = told.reasons == NotAssessed.ASSESSED
    share, told_from = share_of_coarse(told.told_from, told.is_coarse, is_assessed, areas)
    figures = {
        "told_from_median_m": told.coarse_from / COARSE, "coarse_from_m": told.coarse_from, "coarse_area_share": share,
        "coarse_told_from_m": told_from,
    }  # fmt: skip
    if tolerance is not None:
        whole = float(areas[is_assessed & np.isfinite(told.told_from)].sum()) or float("nan")
        figures["share_coarser_than_tolerance"] = float(areas[is_assessed & (told.told_from > tolerance)].sum()) / whole
    return figures


def share_of_coarse(told_from: Floats, is_coarse: Bools, is_assessed: Bools, areas: Floats) -> tuple[float, float]:
    """Return which share of the assessed `areas` (n,) [m2] is coarse, and from how large a change, or rate, on nearly
    all of that tells one; NaN where there is none."""
    whole = float(areas[is_assessed & np.isfinite(told_from)].sum()) or float("nan")
    return float(areas[is_coarse].sum()) / whole, quantile_by_area(told_from[is_coarse], areas[is_coarse], NEARLY_ALL)


def quantile_by_area(values: Floats, areas: Floats, share: float) -> float:
    """Return the value that so large a share of the area has at most; NaN without any."""
    if not len(values):
        return float("nan")
    order = np.argsort(values, kind="stable")
    up_to = np.cumsum(areas[order])
    return float(values[order][np.searchsorted(up_to, share * up_to[-1]).clip(max=len(values) - 1)])
