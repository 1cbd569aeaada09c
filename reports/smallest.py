"""From how large a change on one is told, in sentences: by its width, on coarser places, against a client's tolerance.

In: a comparison with its statistics. Out: sentences of the answer, and the lengths that pictures and tables need.
"""

from __future__ import annotations

import math

import numpy as np

from projects.model import Comparison
from projects.triangles import vertex_areas
from reports.quantities import MM, NAN, NBSP, millimetres, percent

MUCH_LESS = 0.9  # of what a narrower change needs: a wider one is worth words
LEAST_COARSE = 0.01  # of the assessed surface tells only large changes: the report says so in words
LEAST_DOTTED = 0.0005  # of a surface: a legend names dots, and not those in a spot that nobody sees
LEAST_UNSURE = 0.001  # of it does not tell changes of the client's tolerance: so here


def is_beside_layer(comparison: Comparison) -> bool:
    """Return whether the regions are what stands out of a layer all over, and their figures are beside it."""
    return "lod95_beside_layer_median_m" in comparison.statistics


def level_beside(comparison: Comparison) -> str:
    """Return the level of detection, in the median, of what stands out of a layer all over."""
    return millimetres(comparison.statistics.get("lod95_beside_layer_median_m", NAN))


def told_by_width(comparison: Comparison) -> list[tuple[float, float]]:
    """Return from how large a mean change [m] on one so wide [m] is told, in 19 of 20 cases, the narrowest first, and
    wider ones that need `MUCH_LESS`; nothing where that is not known, as of older programs."""
    rows: list[tuple[float, float]] = []
    for width, depth in comparison.statistics.get("told_by_width_m", ()):
        if np.isfinite(depth) and (not rows or depth < MUCH_LESS * rows[-1][1]):
            rows.append((float(width), float(depth)))
    return rows


def say_level(comparison: Comparison) -> str:
    """Return the level of detection, in the median, and that of what stands out of a layer, where there is one."""
    level = millimetres(comparison.statistics.get("lod95_median_m", NAN))
    return f"{level}, against the rest {level_beside(comparison)}" if is_beside_layer(comparison) else level


def say_how_small(comparison: Comparison, changed: bool) -> str:
    """Return how small a change is told, or would have been, by how wide it is."""
    told, rows = "is" if changed else "would have been", told_by_width(comparison)
    if not rows:
        return (
            f"The level of detection of single places is {say_level(comparison)} (95\u00a0%, median over the surface)."
            f"{_say_unknown(comparison)}"
        )
    (narrow, least), (wide, deepest) = rows[0], rows[-1]
    more = f", one {millimetres(wide)} wide from {millimetres(deepest)} on" if len(rows) > 1 else ""
    against = " against the rest" if is_beside_layer(comparison) else ""
    return (
        f"A change {millimetres(narrow)} wide or wider {told} told{against} from about {millimetres(least)} on{more} "
        "(19 of 20 such changes, median over the surface)."
    )


def _say_unknown(comparison: Comparison) -> str:
    """Return that how small a change is told is not known, and why, where surfaces state no noise; nothing of records
    of older programs, which tell no widths."""
    states = [s.surface.sigma is not None for s in (comparison.on_reference, comparison.on_compared)]
    if all(states) or not comparison.statistics.get("told_by_width_m"):
        return ""
    which = "one surface does not state" if any(states) else "neither surface states"
    return f" From how large a change on one is told, by its width, is not known, as {which} its noise."


def least_told(comparison: Comparison) -> float:
    """Return from how large a change [m] on one is told on most of the surface, as the answer says it; NaN where that
    is not known."""
    rows = told_by_width(comparison)
    return rows[0][1] if rows else NAN


def dotted_from(comparison: Comparison) -> float:
    """Return from which change [m] on dotted places tell one at best, NaN where pictures have no dots."""
    sides = comparison.on_compared, comparison.on_reference
    return comparison.on_compared.coarse_from if any(s.is_coarse.any() for s in sides) else NAN


def dots_of_legend(comparison: Comparison) -> float:
    """Return the same, NaN also where so little of either surface has dots that nobody sees them in a picture."""
    shares = []
    for side in (comparison.on_compared, comparison.on_reference):
        areas = vertex_areas(side.surface.vertices, side.surface.faces)
        shares.append(float(areas[side.is_coarse].sum()) / max(float(areas.sum()), 1e-300))
    return dotted_from(comparison) if max(shares) >= LEAST_DOTTED else NAN


def _tells_coarse(comparison: Comparison) -> bool:
    """Return whether the surface that tells only large changes is worth a sentence."""
    return bool(comparison.statistics.get("coarse_area_share", NAN) >= LEAST_COARSE)


def say_coarse(comparison: Comparison) -> tuple[str, ...]:
    """Return how much of the surface tells only much larger changes, where some does."""
    if not _tells_coarse(comparison):
        return ()
    share, least, most = (comparison.statistics[f"coarse_{n}"] for n in ("area_share", "from_m", "told_from_m"))
    above = [f"above {millimetres(least)}"] if math.isfinite(least) else []
    above += [f"on the coarsest twentieth of it above {millimetres(most)}"] if math.isfinite(most) else []
    told = f"On {percent(share)} of the assessed surface (dotted in the pictures) only larger changes are told"
    return (f"{told}: {', '.join(above)}." if above else f"{told}.",)


def say_coarse_beside(comparison: Comparison) -> str:
    """Return on how much of the surface only larger changes are told, for a figure to remember."""
    if not _tells_coarse(comparison):
        return ""
    share, least = (comparison.statistics[f"coarse_{name}"] for name in ("area_share", "from_m"))
    return f"; {millimetres(least)} or more on {percent(share)} of the surface" if math.isfinite(least) else ""


def say_beyond_tolerance(comparison: Comparison) -> tuple[str, ...]:
    """Return how much of the surface changed by more than the client's own limit, where one was given, and whether so
    small a change is told at all: what differs by more may be error. Older records tell only that."""
    tolerance = comparison.statistics.get("tolerance_m")
    if tolerance is None:
        return ()
    changed, differs, unsure = (
        comparison.statistics.get(f"share_{name}_tolerance", NAN)
        for name in ("changed_beyond", "beyond", "coarser_than")
    )
    what = f"the assessed surface {{}} by more than the tolerance of {tolerance_in_words(tolerance)}"
    told = f"{percent(changed)} of {what.format('changed')}"
    if not math.isfinite(changed):
        told = f"{percent(differs)} of {what.format('differs')}, by errors or by change"
    level = _level_above(comparison, tolerance)
    if level:
        return (f"{told}. This survey does not tell changes as small as that: {level}.",)
    return (
        f"{told}; {percent(unsure)} tells only larger changes than that." if unsure >= LEAST_UNSURE else f"{told}.",
    )


def _level_above(comparison: Comparison, tolerance: float) -> str:
    """Return in words from how large a change on most of the surface tells one, where that is above a client's limit
    [m]: of a wide one where that is known, else of a single place; else nothing."""
    level, least = comparison.statistics.get("lod95_median_m", NAN), least_told(comparison)
    if math.isfinite(least):
        return f"changes are told only from about {millimetres(least)} on" if least > tolerance else ""
    return f"the level of detection of single places is {millimetres(level)}" if level > tolerance else ""


def tolerance_in_words(tolerance: float) -> str:
    """Return the client's limit [m] as it was given: a number of a contract is not rounded."""
    return f"{tolerance * MM:.12g}{NBSP}mm"
