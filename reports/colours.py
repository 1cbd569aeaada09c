"""The colours of change: one diverging, colour-blind safe map with fixed rules, the same on screen, paper and in files.

Lost is warm (sand to dark red), gained is cool (pale to dark blue), both darker the larger the change; unchanged is a
light grey, darker (in pictures dotted) where only large changes would be told, and what is not assessable a cool grey,
hatched in pictures, that neither sign can be taken for. The ramps
begin beside the grey and not in it: only significant vertices are coloured, so a change is seen however small.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from projects.model import Assessment, Bools, ComparedSurface, Comparison, Floats, NotAssessed

UNCHANGED = (214, 213, 210)
COARSE, DOTS = (186, 184, 180), (132, 129, 124)  # unchanged, but only large changes would be told; its dots
NOT_ASSESSABLE = (158, 164, 174)
HATCH_LIGHT = (228, 230, 234)
HATCH_DARK = (142, 147, 156)
STONE = (226, 219, 206)
INSIDE = (164, 166, 171)
STABLE, SET_ASIDE = (158, 190, 168), (222, 190, 150)  # what held the epochs together; what changed
LEFT_OUT, OUTSIDE = (214, 213, 210), (240, 239, 236)  # what took no part; what was not asked
LOST = ((248, 214, 160), (244, 165, 82), (219, 96, 38), (168, 38, 30), (98, 8, 28))
GAINED = ((184, 222, 236), (104, 178, 216), (42, 118, 186), (26, 66, 148), (18, 24, 92))
ROUND_STEPS = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)

RGB = NDArray[np.uint8]


def round_up(value: float, steps: tuple[float, ...] = ROUND_STEPS) -> float:
    """Return the smallest of `steps` (1 to 10) times a power of ten that is not below `value` (> 0)."""
    power = 10.0 ** np.floor(np.log10(value))
    step = next(s for s in steps if s * power >= value * (1.0 - 1e-9))
    return float(f"{step * power:.3g}")


def change_range(distances: Floats, lod95: Floats) -> float:
    """Return the distance [m] at which the colours end, for both signs: a round number, one for a whole comparison.

    It is the round number above the 99.5 % quantile of the absolute distances that exceed their level of detection,
    and at least twice the median level of detection.

    Parameters
    ----------
    distances : (n,) m, signed; NaN where unknown. Give those called changed where the states are known.
    lod95 : (n,) m, or that of all vertices: only its median is used beyond the test.
    """
    size = np.abs(distances)
    beyond = size[size > lod95] if np.shape(lod95) == np.shape(distances) else size
    beyond = beyond[np.isfinite(beyond)]
    levels = lod95[np.isfinite(lod95)]
    least = 2.0 * float(np.median(levels)) if len(levels) else 0.0
    largest = float(np.quantile(beyond, 0.995)) if len(beyond) else 0.0
    wanted = max(least, largest)
    return round_up(wanted) if wanted > 0.0 else 1e-3


def choose_limit(comparison: Comparison) -> float:
    """Return `change_range` [m] over what is called changed on both sides: one for every picture, bar and export.

    Of a region that is gone or came as a whole most has no perpendicular: how far behind it the next surface lies does
    not stretch the colours where anything else changed. Where nothing changed they go on to what would have been told
    on most of the surface.
    """
    sides = (comparison.on_compared, comparison.on_reference)
    changed = np.concatenate([np.where(s.assessment == Assessment.CHANGED, s.distances, np.nan) for s in sides])
    as_whole = np.concatenate([gone_or_come(s) for s in sides])
    if np.isfinite(changed[~as_whole]).any():
        changed[as_whole] = np.nan
    limit = change_range(changed, np.concatenate([s.lod95 for s in sides]))
    told = float(comparison.statistics.get("told_from_median_m", float("nan")))
    return max(limit, round_up(told)) if np.isfinite(told) and not np.isfinite(changed).any() else limit


def gone_or_come(side: ComparedSurface) -> Bools:
    """Return which vertices (n,) are of a region of which most was looked through by the other epoch's scans."""
    through = side.reasons == NotAssessed.LOOKED_THROUGH
    share = np.bincount(side.region, through) / np.maximum(np.bincount(side.region), 1)
    return through | ((share > 0.5)[side.region] & (side.region > 0))


def change_ramp(distances: Floats, limit_m: float) -> Floats:
    """Return the colour (n, 3) float in 0 to 255 of significant signed distances [m]; beyond the limit the last."""
    fraction = np.clip(np.abs(distances) / limit_m, 0.0, 1.0) * (len(LOST) - 1)
    stops = np.arange(len(LOST), dtype=float)
    lost, gained = np.array(LOST, dtype=float), np.array(GAINED, dtype=float)
    ramp = [np.where(distances < 0, np.interp(fraction, stops, lost[:, k]), np.interp(fraction, stops, gained[:, k]))
            for k in range(3)]  # fmt: skip
    return np.stack(ramp, axis=-1)


def vertex_colours(compared_surface: ComparedSurface, limit_m: float) -> RGB:
    """Return the colour (n, 3) uint8 of each vertex: by distance where changed, else the colour of its state."""
    state = compared_surface.assessment
    colours = np.empty((len(state), 3))
    colours[:] = UNCHANGED
    colours[compared_surface.is_coarse] = COARSE
    colours[state == Assessment.NOT_ASSESSABLE] = NOT_ASSESSABLE
    changed: Bools = state == Assessment.CHANGED
    colours[changed] = change_ramp(compared_surface.distances[changed], limit_m)
    return np.rint(colours).astype(np.uint8)
