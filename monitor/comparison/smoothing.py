"""A mean of the change around each vertex, along the surface: what a patch says where one vertex says too little."""

from __future__ import annotations

import numpy as np
from numba import jit, prange

from monitor.comparison.scratch import keep_on_disk
from monitor.comparison.side import Side
from projects.model import Floats

MOST_STEPS = 400


def smooth_distances(side: Side, radius: float, lod95: Floats | None = None) -> Floats:
    """Return the area-weighted mean of the distances around each vertex (n,) [m]; NaN where not assessable.

    The weights fall off like a Gaussian whose disc of equal weight has `radius` [m]: steps of the mean over a vertex
    and its neighbours, as many as take a random walker that far. Not assessable vertices take and give nothing.
    With `lod95` (n,) [m] neighbours whose distances differ by more than noise give each other little: what a steep
    change has lifted is not mixed with what lies beside it, or a region would grow by the radius all around.

    References
    ----------
    Perona and Malik (1990): the conductance exp(-(gradient / K)^2), with the noise for K; taken once, of what was
    measured.
    """
    neighbours, is_assessed = side.neighbours, side.is_assessed
    shares = keep_on_disk(_share_out(neighbours, side.distances, np.zeros(0) if lod95 is None else lod95))
    stride2 = 6.0 / 7.0 * _mean_length2(side.surface.vertices, neighbours)  # six neighbours and the vertex itself
    n_steps = min(max(round(0.5 * radius**2 / max(stride2, 1e-300)), 1), MOST_STEPS)  # E r^2 = 2 s^2, R^2 = 4 s^2
    mass = np.where(is_assessed, side.areas, 0.0)
    total = mass * np.where(is_assessed, side.distances, 0.0)
    for _ in range(n_steps):
        mass, total = _take_step(neighbours, shares, mass, total)
    return np.where(is_assessed, total / np.maximum(mass, 1e-300), np.nan)


@jit(nopython=True, parallel=True, cache=True)
def _share_out(neighbours, distances, lod95):  # type: ignore[no-untyped-def]
    """Return what each vertex gives to each of its neighbours in a step: an even share where distances agree, less
    where they do not; an even one where `lod95` is empty, and beside what is not assessed.

    lod95 is 1.96 sigma of one distance; the difference of two scatters by the root of their squares.
    """
    starts, out = neighbours.starts, np.empty(len(neighbours.vertices))
    for v in prange(len(distances)):
        for k in range(starts[v], starts[v + 1]):
            w = neighbours.vertices[k]
            out[k] = 1.0 / (1.0 + max(starts[v + 1] - starts[v], starts[w + 1] - starts[w]))
            if len(lod95):
                step2 = (distances[v] - distances[w]) ** 2 / (lod95[v] ** 2 + lod95[w] ** 2)
                if np.isfinite(step2):
                    out[k] *= np.exp(-step2)
    return out


@jit(nopython=True, cache=True)
def _mean_length2(points, neighbours):  # type: ignore[no-untyped-def]
    """Return the mean squared length of the edges; 7 / 6 where there is none."""
    total = 0.0
    for v in range(len(points)):
        for k in range(neighbours.starts[v], neighbours.starts[v + 1]):
            w = neighbours.vertices[k]
            if w > v:
                x, y, z = points[v, 0] - points[w, 0], points[v, 1] - points[w, 1], points[v, 2] - points[w, 2]
                total += x * x + y * y + z * z
    return 2.0 * total / len(neighbours.vertices) if len(neighbours.vertices) else 7.0 / 6.0


@jit(nopython=True, parallel=True, cache=True)
def _take_step(neighbours, shares, mass, total):  # type: ignore[no-untyped-def]
    """Return mass and total after one step of the walk: its share goes to each neighbour, the rest stays."""
    new_mass, new_total = np.empty(len(mass)), np.empty(len(mass))
    for v in prange(len(mass)):
        given, here, there = 0.0, 0.0, 0.0
        for k in range(neighbours.starts[v], neighbours.starts[v + 1]):
            given += shares[k]
            here += shares[k] * mass[neighbours.vertices[k]]
            there += shares[k] * total[neighbours.vertices[k]]
        new_mass[v], new_total[v] = here + (1.0 - given) * mass[v], there + (1.0 - given) * total[v]
    return new_mass, new_total
