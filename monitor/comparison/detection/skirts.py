"""The skirt of a steep change: what the width of the fits makes of a step, and what did not change itself.

In: regions of a side and how much changed at each vertex. Out: the regions without their skirts. A surface bends from
one side of a step to the other within the reach of its fits, so a change that ends at a step shows beside it, too, as
far as it is more than the level of detection. A step lies where half of it is reached (as of any edge that is blurred
alike on both sides); a change that fades out, as worn places do, has no such border and is left as it is.
"""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.comparison.distances.side import Side
from monitor.comparison.distances.stars import Neighbours
from projects.model import Bools, Floats, Ints

HALF = 0.5  # of what is reached within the skirt's width: where the step lies
WIDTH = 2  # edges: beside a step fits are as narrow as points allow, two to three cells of the surface
LEVELS_OFF = 0.5  # of the rise within one width, in the next: a slope that goes on rises as much


def trim_skirts(side: Side, region: Ints, change: Floats) -> Ints:
    """Return the regions (n,), 0 for none, without what is the skirt of a step.

    Parameters
    ----------
    region : (n,) number of the region of each vertex, 0 for none.
    change : (n,) m, smoothed; NaN where it is not known: such a vertex is left as it is.

    Notes
    -----
    m1 and m2 are the largest changes of the region within two and four edges of a vertex, m its own. It is of the
    skirt where m < m1 / 2 and m2 - m1 < (m1 - m) / 2: the change rises within two edges and levels off within the
    next two. Where it goes on rising, as over a fracture that slopes in from an edge, or from the rim of a bowl,
    nothing is cut; nor where a surface is a finished mesh, of whose fits nothing is known.
    """
    members = np.flatnonzero(region > 0).astype(np.int64)
    if not (len(members) and side.states_noise):
        return region
    size = np.abs(change)
    once = _largest_around(members, region, np.nan_to_num(size), side.neighbours)
    twice = _largest_around(members, region, once, side.neighbours)
    out = region.copy()
    out[is_skirt(size, once, twice)] = 0
    return out


def is_skirt(size: Floats, once: Floats, twice: Floats) -> Bools:
    """Return where a change `size` (n,) [m] with so much within one and two widths is the skirt of a step."""
    return np.asarray((size < HALF * once) & (twice - once < LEVELS_OFF * (once - size)))


def _largest_around(members: Ints, region: Ints, size: Floats, neighbours: Neighbours) -> Floats:
    """Return the largest size (n,) in the same region within a skirt's width of each of the members (k,)."""
    out = size.copy()
    for _ in range(WIDTH):
        out = _take_largest(members, region, out, neighbours)
    return out


@jit(nopython=True, cache=True)
def _take_largest(members, region, size, neighbours):  # type: ignore[no-untyped-def]
    """Return the largest size of each member and its neighbours of the same region."""
    out = size.copy()
    for v in members:
        for k in range(neighbours.starts[v], neighbours.starts[v + 1]):
            w = neighbours.vertices[k]
            if region[w] == region[v]:
                out[v] = max(out[v], size[w])
    return out
