"""How far something reaches along a surface: shortest ways over the edges of its mesh (Dijkstra 1959)."""

from __future__ import annotations

from heapq import heappop, heappush

import numpy as np
from numba import jit

from monitor.comparison.distances.side import Side
from projects.model import Bools, Floats, Ints


def spread_along(side: Side, seeds: Ints, allowed: Bools, limit: float | Floats) -> Ints:
    """Return the seed (n,) that each vertex is nearest to within `limit` [m] along the surface; -1 where to none.

    Ways lead over the vertices in `allowed` (n,), the `seeds` (k,), rising, among them. Of seeds equally near it is the
    one whose way was found first, lower numbers first. The limit may be one for each seed (k,).
    """
    source = np.full(len(allowed), -1, dtype=np.int32)
    if len(seeds):
        limits = np.broadcast_to(np.asarray(limit, dtype=np.float64), len(seeds))
        _spread(side.surface.vertices, side.neighbours, np.asarray(seeds), allowed, limits.copy(), source)
    return source


@jit(nopython=True, cache=True)
def _spread(points, neighbours, seeds, allowed, limits, source):  # type: ignore[no-untyped-def]
    """Write to `source` (n,) the seed that is nearest along edges, as Dijkstra finds it, within its of `limits` [m]."""
    distance, limit = np.full(len(source), np.inf), np.zeros(len(source))
    limit[seeds] = limits
    ahead = [(0.0, np.int64(seed)) for seed in seeds]  # equal and rising: a heap
    for seed in seeds:
        distance[seed], source[seed] = 0.0, seed
    while len(ahead) > 0:
        so_far, v = heappop(ahead)
        if so_far > distance[v]:
            continue
        for k in range(neighbours.starts[v], neighbours.starts[v + 1]):
            w = neighbours.vertices[k]
            if not allowed[w] or distance[w] <= so_far:
                continue
            x, y, z = points[v, 0] - points[w, 0], points[v, 1] - points[w, 1], points[v, 2] - points[w, 2]
            further = so_far + max(np.sqrt(x * x + y * y + z * z), 1e-300)
            if further <= limit[source[v]] and further < distance[w]:
                distance[w], source[w] = further, source[v]
                heappush(ahead, (further, np.int64(w)))
