"""Which vertices are changed, once the patches are tested and the noise is known.

In: a side, the test, the noise. Out: lod95 of each vertex, the smoothed change, and whether it is changed.
"""

from __future__ import annotations

import numpy as np

from monitor.blocks import blocks
from monitor.comparison.detection.skirts import WIDTH
from monitor.comparison.detection.tested import Detection, Tested
from monitor.comparison.distances.connected import connect_like
from monitor.comparison.distances.quantile import quantile
from monitor.comparison.distances.scratch import keep_on_disk
from monitor.comparison.distances.side import Side
from monitor.comparison.distances.smoothing import smooth_distances
from monitor.comparison.distances.stars import Neighbours
from monitor.comparison.noise.level_of_detection import level_of_detection
from monitor.comparison.noise.model import Noise
from monitor.comparison.noise.strata import stratum_of
from projects.model import Z95, Bools, Floats, Ints

HALF = 0.5  # of what needs no patch: the border of what is deep lies where it is half as far off zero


def find_deep(side: Side, lod95: Floats, far: float) -> Bools:
    """Return which vertices (n,) are so far off zero that they need no patch, by `far` levels of detection, and those
    around them, of their sign, that are by half of it."""
    ratio = np.nan_to_num(np.where(side.is_assessed, side.distances, 0.0) / lod95)
    return grow(np.abs(ratio) > far, np.abs(ratio) > HALF * far, np.sign(ratio).astype(np.int8), side.neighbours)


def mark_changed(side: Side, own: Side, test: Tested, which: int, lod95: Floats, deep: Bools,
                 noise: Noise, calm: Bools) -> Detection:  # fmt: skip
    """Return which vertices are changed: those that are `deep`, with their skirts, and those connected to a significant
    unit, of its sign; all beyond a level themselves.

    Beyond a level is a vertex whose own change exceeds its lod95, or whose smoothed change exceeds what that of calm
    vertices does in 5 %, and what scans are stated to disagree by: how far a region reaches is told of each place by
    itself, and errors that are left there go on from vertex to vertex. `own` is the side without the motion of the
    whole, the same where none is left. `test` is that of the units without what is deep: it would carry all units that
    share a patch with it.
    """
    reach = 0.5 * min(noise.correlation.length, test.size)
    smooth = keep_on_disk(smooth_distances(side, reach, lod95))
    error = smooth if own is side else smooth_distances(own, reach, lod95)
    ratio = np.abs(error[calm]) / lod95[calm]
    kept = min(quantile(ratio, 0.95), 1.0) if len(ratio) else 1.0
    del error
    smooth_lod95 = keep_on_disk(np.maximum(kept * lod95, Z95 * side.sigma_common))
    sign = np.sign(np.where(side.is_assessed, smooth, 0.0)).astype(np.int8)
    is_own = np.sign(side.distances) == sign
    beyond = side.is_assessed & ((is_own & (np.abs(side.distances) > lod95)) | (np.abs(smooth) > smooth_lod95))
    deep = _skirt_of(deep & is_own, beyond, sign, side.neighbours)
    number = test.units[which].number
    is_seed = np.where(sign > 0, np.append(test.p_gained[which] <= test.limit, False)[number],
                       np.append(test.p_lost[which] <= test.limit, False)[number])  # fmt: skip
    is_changed = deep | grow(beyond & ~deep & is_seed, beyond & ~deep, sign, side.neighbours)
    mean = keep_on_disk(smooth_distances(side, reach))
    return Detection(lod95, mean, smooth, smooth_lod95, is_changed)


def _skirt_of(deep: Bools, beyond: Bools, sign: Ints, neighbours: Neighbours) -> Bools:
    """Return what is deep and the vertices of `beyond` within a skirt's width of it, of its sign."""
    around = deep
    for _ in range(WIDTH if deep.any() else 0):
        degrees = np.diff(neighbours.starts)
        from_deep = np.repeat(np.where(around, sign, np.int8(0)), degrees)
        reached = np.zeros(len(deep), dtype=np.bool_)
        reached[neighbours.vertices[(from_deep != 0) & (from_deep == sign[neighbours.vertices])]] = True
        around = around | (reached & beyond)
    return around


def level_at(side: Side, noise: Noise) -> Floats:
    """Return lod95 (n,) [m] of each vertex."""
    out = np.empty(len(side.distances))
    for block in blocks(len(out)):
        stratum = stratum_of(side, noise.spacing, block)
        own = np.hypot(noise.scales[stratum] * side.sigma_surfaces[block],
                       noise.discord_scales[stratum] * side.sigma_discord[block])  # fmt: skip
        out[block] = level_of_detection(own, noise.common_of(side, block), noise.floors[stratum])
    return keep_on_disk(out)


def grow(seeds: Bools, beyond: Bools, sign: Ints, neighbours: Neighbours) -> Bools:
    """Return the vertices of `beyond` that hang together with a seed of their sign."""
    if not seeds.any():
        return np.zeros(len(seeds), dtype=np.bool_)
    part = connect_like(np.where(beyond, sign + np.int8(1), np.int8(-1)), [neighbours])
    has_seed = np.zeros(int(part.max(initial=-1)) + 2, dtype=np.bool_)
    has_seed[part[seeds]] = True
    return beyond & has_seed[part]
