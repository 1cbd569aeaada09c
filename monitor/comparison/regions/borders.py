"""The border of a region: how far it moves with the errors there, and how far around it its volume is looked for.

In: a side, a region of it, how much changed at each vertex and from where on it counts. Out: the sigma of its area,
what noise alone adds to its mean, and its margin: the flanks of a change that fades out lie below the level of
detection and still hold volume.
"""

from __future__ import annotations

import numpy as np

from monitor.comparison.detection.skirts import trim_skirts
from monitor.comparison.detection.tested import Detected, Detection
from monitor.comparison.distances.side import Side
from monitor.comparison.distances.spreading import spread_along
from monitor.comparison.noise.correlation import Correlation
from projects.model import Z95, Bools, Floats, Ints, Surface

SWING = 0.8  # of a fit's radius, within which nine tenths of what it swings to the other side beside a step lie
NEAREST_SAMPLE = 0.43  # median way to the nearest, in spacings: 0.40 of points on a grid, 0.47 at random
EDGES = 4.0  # spacings of the vertices, at least: a margin narrower than an edge holds neither side of a step
FLANKS = 2.0  # times as far as a change reaches that goes on falling off as at its border: it flattens out


def margin_widths(sides: tuple[Side, Side], found: Detected, regions: tuple[Ints, Ints], signs: Floats) -> Floats:
    """Return how far [m] around each region (r + 1,) its volume is looked for: as far as its flanks and fits reach.

    A change that fades out is below the level of detection there; a step ends between its last vertex and the next, as
    where errors hardly agree from vertex to vertex. Beside a step a surface of quadric fits swings to the other side,
    and keeps the volume only over the reach of its fits: weighted by 1 - t^2, t the distance over the radius, they act
    as the kernel (1 - 2 t^2) (1 - t^2), whose response to a step is below zero from t = 0.42. No farther than a unit,
    or the reach of the fits: what lies farther off is error.
    """
    fits = max(SWING * reach_of_fits(side.surface) for side in sides)
    least = max(fits, EDGES * max(float(np.sqrt(np.median(side.areas))) for side in sides))
    most = max(found.test.size, least)
    widths = np.full(len(signs), most)
    wide = [spread_margin(s, r, most) for s, r in zip(sides, regions, strict=True)]
    for k in range(1, len(signs)):
        flanks = [flank_width(s, d, signs[k], (np.flatnonzero(r == k), w == k))
                  for s, d, r, w in zip(sides, found.sides, regions, wide, strict=True)]  # fmt: skip
        widths[k] = np.clip(FLANKS * max(flanks), least, most)
    return widths


def spread_margin(side: Side, region: Ints, width: float | Floats) -> Ints:
    """Return the region whose margin of `width` [m] along the surface each vertex lies in (n,), 0 for none; one width
    for all or one for each region, by its number.

    The margin takes the flanks in whatever they measure, so it adds no bias. Vertices that are not assessable are of
    the margin too: see `is_volume_known`.
    """
    inside = np.flatnonzero(region > 0)
    if not len(inside):
        return np.zeros(len(region), dtype=region.dtype)
    source = spread_along(side, inside, np.ones(len(region), dtype=np.bool_), width_at(region[inside], width))
    return np.where(source >= 0, region[np.maximum(source, 0)], 0).astype(region.dtype)


def width_at(region: Ints, width: float | Floats) -> Floats:
    """Return the width (k,) [m] of the regions of vertices: one for all, or one for each region, by its number."""
    return np.asarray(np.broadcast_to(width, len(region)) if np.isscalar(width) else np.asarray(width)[region])


def reach_of_fits(surface: Surface) -> float:
    """Return the radius [m] of the median fit, by how many samples it has and how densely they lie; 0 where unknown."""
    if surface.n_support is None or surface.sample_distance is None:
        return 0.0
    area = (np.nanmedian(surface.sample_distance) / NEAREST_SAMPLE) ** 2
    return float(np.sqrt(np.median(surface.n_support) * area / np.pi))


def sigma_of_area(side: Side, size: Floats, level: Floats, parts: tuple[Ints, Bools], correlation: Correlation,
                  ) -> float:  # fmt: skip
    """Return one sigma [m2] of the area: how far the border moves when the change there is a sigma more or less, and
    how well it is told where vertices are a spacing apart.

    See `border_shift`. Errors along the border agree over a correlation length only, so the whole of it moves less than
    a part. What fits make of a border, wider or narrower by up to a spacing, they do everywhere.
    """
    vertices, shift = parts[0], border_shift(side, size, level, parts)
    perimeter, share = perimeter_of(side, vertices), share_that_agrees(side, vertices, correlation)
    step = perimeter * float(np.sqrt(np.median(side.areas[vertices]) / 3.0))  # uniform up to a spacing on either side
    return float(np.hypot(shift * share, step))


def share_that_agrees(side: Side, vertices: Ints, correlation: Correlation) -> float:
    """Return by which share of one sigma the whole border of a region moves, where each place of it moves by one."""
    return float(min(np.sqrt(2.0 * correlation.length / perimeter_of(side, vertices)), 1.0))


def chosen_by_noise(side: Side, found: Detection, sign: float, parts: tuple[Ints, Bools],
                    correlation: Correlation) -> tuple[float, float]:  # fmt: skip
    """Return how much [m] noise alone adds to the size of a region's mean change, and one sigma of it.

    A vertex is of the region since its change, or its smoothed change, lies beyond a level: of those at the border the
    ones whose noise goes that way are in, and the others out. The mean of noise over what passes a threshold is its
    variance times the density of what lies at the threshold (Stein 1981, lemma 1; errors may agree as they like):
    here, one sigma of a vertex times the area that one sigma moves in or out, over the area of the region.
    `parts` as in `border_shift`.
    """
    vertices, margin = parts
    own, size = (sign * np.nan_to_num(v) for v in (side.distances, found.smooth))
    by = tuple((v, level, level / Z95) for v, level in ((own, found.lod95), (size, found.smooth_lod95)))
    beyond = np.logical_or(*(v > level - 0.5 * sigma for v, level, sigma in by))
    around = _around_border(side, vertices, margin & side.is_assessed & beyond, size)
    added, n_border = 0.0, 0
    for (v, level, sigma), (other, its_level, _) in (by, by[::-1]):
        at_border = (np.abs(v - level) < 0.5 * sigma)[around] & (other <= its_level)[around]
        added += float((side.areas * sigma)[around][at_border].sum())
        n_border += int(np.count_nonzero(at_border))
    added /= float(side.areas[vertices].sum())
    unsure = np.hypot(share_that_agrees(side, vertices, correlation), 1.0 / np.sqrt(max(n_border, 1)))
    return added, added * float(unsure)


def border_shift(side: Side, size: Floats, level: Floats, parts: tuple[Ints, Bools]) -> float:
    """Return the area [m2] by which a region grows or shrinks when its change is one sigma of a vertex more or less.

    `size` (n,) [m] is the smoothed change in the direction of the region's, `level` (n,) [m] that from which it counts;
    `parts` are the vertices of the region and, as a mask (n,), those of it with its margin, of which what hangs
    together with the region counts, less the skirts of its steps. The slope at the border tells it, from half a sigma
    below the level to half of one above.
    """
    vertices, margin = parts
    around = _around_border(side, vertices, margin & (size > level * (1.0 - 0.5 / Z95)), size)
    at_border = np.abs(size[around] - level[around]) < 0.5 * level[around] / Z95
    return float(side.areas[around][at_border].sum())


def _around_border(side: Side, vertices: Ints, allowed: Bools, size: Floats) -> Ints:
    """Return the vertices of a region and of those `allowed` (n,) what hangs together with it, less the skirts of its
    steps."""
    allowed[vertices] = True
    joined = (spread_along(side, vertices, allowed, np.inf) >= 0).astype(np.int32)
    return np.flatnonzero(trim_skirts(side, joined, size))


def perimeter_of(side: Side, vertices: Ints) -> float:
    """Return the perimeter [m] of a round patch as large as some vertices."""
    return float(2.0 * np.sqrt(np.pi * side.areas[vertices].sum()))


def flank_width(side: Side, found: Detection, sign: float, parts: tuple[Ints, Bools]) -> float:
    """Return how far [m] outside of a region its change reaches zero, were it to go on falling off as it does at the
    border; 0 where a side has no vertex of it. `parts` as in `border_shift`."""
    if not len(parts[0]):
        return 0.0
    return Z95 * border_shift(side, sign * found.smooth, found.smooth_lod95, parts) / perimeter_of(side, parts[0])
