"""What neighbouring vertices of a surface contradict each other by: the height of one against the normal of the other.

In: a surface and who neighbours whom. Out: one sigma of each vertex by this alone. Each vertex has a fit of its own,
and its stated sigma says how sure that fit is if its points are of one smooth patch. Where they are not (an edge finer
than the points and the spots of the beam that made them, a joint, a twig) fits err by more than they know, and by other
amounts from one vertex to the next: they contradict one another, and a survey that met other points there errs anew.
"""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.comparison.distances.stars import Neighbours
from monitor.threads import run_tasks
from projects.model import Floats, Surface

SHARE = 0.5  # of what neighbours contradict each other by: as much of it is error on walls and bodies (BENCHMARKS.md)


def sigma_of_discord(surface: Surface, neighbours: Neighbours) -> Floats:
    """Return one sigma (n,) [m] of each vertex along its normal, by what it and those around contradict each other by.

    0 where a surface has no fits of its own (a finished mesh), and where nothing can be held against another.

    Notes
    -----
    Of a sphere, and of any smooth surface to third order, the chord between two points is perpendicular to the sum of
    their normals. What (p_j - p_i)'(n_i + n_j) / 2 is instead of 0 is what heights and normals contradict each other
    by. Of a vertex that alone is off by e it is e, of all that err independently 1.4 times what each does; normals that
    err add to it, points that fits share take off. `SHARE` of its root mean square is returned, over the edges of the
    vertex and of its neighbours: those of one vertex are few. The normal of a vertex on a crest is of neither side:
    edges to it say nothing.
    """
    n = len(surface.vertices)
    if surface.normals is None or surface.sigma is None:
        return np.zeros(n)
    is_crest = np.zeros(n, dtype=np.bool_) if surface.is_crest is None else surface.is_crest
    own, out = np.empty(n), np.empty(n)
    run_tasks(_contradict, n, surface.vertices, surface.normals, is_crest, neighbours, own)
    run_tasks(_average_around, n, own, neighbours, out)
    return SHARE * np.sqrt(out)


@jit(nopython=True, cache=True, nogil=True)
def _contradict(first, last, vertices, normals, is_crest, neighbours, out):  # type: ignore[no-untyped-def]
    """Write the mean square of what each vertex and its neighbours contradict each other by, NaN where nothing does."""
    for v in range(first, last):
        total, n = 0.0, 0
        for k in range(neighbours.starts[v], neighbours.starts[v + 1]):
            u, height = neighbours.vertices[k], 0.0
            for c in range(3):
                height += 0.5 * (vertices[u, c] - vertices[v, c]) * (normals[u, c] + normals[v, c])
            if np.isfinite(height) and not (is_crest[u] or is_crest[v]):
                total += height * height
                n += 1
        out[v] = total / n if n else np.nan


@jit(nopython=True, cache=True, nogil=True)
def _average_around(first, last, values, neighbours, out):  # type: ignore[no-untyped-def]
    """Write the mean of the values of each vertex and its neighbours that are known; 0 where none is."""
    for v in range(first, last):
        total, n = 0.0, 0
        for k in range(neighbours.starts[v] - 1, neighbours.starts[v + 1]):
            value = values[neighbours.vertices[k]] if k >= neighbours.starts[v] else values[v]
            if np.isfinite(value):
                total += value
                n += 1
        out[v] = total / n if n else 0.0
