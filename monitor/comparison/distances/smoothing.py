"""A mean of the change around each vertex, along the surface: what a patch says where one vertex says too little."""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.comparison.distances.scratch import keep_on_disk
from monitor.comparison.distances.side import Side
from monitor.comparison.distances.stars import Neighbours
from monitor.threads import run_tasks
from projects.model import Floats

MOST_STEPS = 400
N_CHUNKS = 64  # whose sums are added up in their order, for threads


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
    stride2 = 6.0 / 7.0 * _mean_length2(side.surface.vertices, neighbours)  # six neighbours and the vertex itself
    n_steps = min(max(round(0.5 * radius**2 / max(stride2, 1e-300)), 1), MOST_STEPS)  # E r^2 = 2 s^2, R^2 = 4 s^2
    shares = np.zeros(0)
    if lod95 is not None and n_steps > 1:
        shares = np.empty(len(neighbours.vertices))
        run_tasks(_share_out, len(is_assessed), neighbours, side.distances, lod95, shares)
        shares = keep_on_disk(shares)
    mass = np.where(is_assessed, side.areas, 0.0)
    total = mass * np.where(is_assessed, side.distances, 0.0)
    for _ in range(n_steps):
        new = np.empty(len(mass)), np.empty(len(mass))
        if lod95 is not None and n_steps == 1:
            run_tasks(_take_only_step, len(mass), neighbours, side.distances, lod95, mass, total, *new)
        else:
            run_tasks(_take_step, len(mass), neighbours, shares, mass, total, *new)
        mass, total = new
    return np.where(is_assessed, total / np.maximum(mass, 1e-300), np.nan)


@jit(nopython=True, cache=True, nogil=True)
def _share_out(first, last, neighbours, distances, lod95, shares):  # type: ignore[no-untyped-def]
    """Write what each vertex gives to each of its neighbours in a step: an even share where distances agree, less where
    they do not; an even one beside what is not assessed.

    lod95 is 1.96 sigma of one distance; the difference of two scatters by the root of their squares.
    """
    starts, vertices = neighbours.starts, neighbours.vertices
    for v in range(first, last):
        for k in range(starts[v], starts[v + 1]):
            shares[k] = _share_of(starts, v, vertices[k], distances, lod95)


@jit(nopython=True, cache=True, forceinline=True)
def _share_of(starts, v, w, distances, lod95):  # type: ignore[no-untyped-def]
    """Return what v gives to its neighbour w; see `_share_out`."""
    share = 1.0 / (1.0 + max(starts[v + 1] - starts[v], starts[w + 1] - starts[w]))
    step2 = (distances[v] - distances[w]) ** 2 / (lod95[v] ** 2 + lod95[w] ** 2)
    return share * np.exp(-step2) if np.isfinite(step2) else share


@jit(nopython=True, cache=True, nogil=True)
def _take_only_step(first, last, neighbours, distances, lod95, mass, total, new_mass, new_total):  # type: ignore[no-untyped-def]
    """Write what `_take_step` does with the shares of `_share_out`, where they are needed once."""
    starts, vertices = neighbours.starts, neighbours.vertices
    for v in range(first, last):
        given, here, there = 0.0, 0.0, 0.0
        for k in range(starts[v], starts[v + 1]):
            w = vertices[k]
            share = _share_of(starts, v, w, distances, lod95)
            given += share
            here += share * mass[w]
            there += share * total[w]
        new_mass[v], new_total[v] = here + (1.0 - given) * mass[v], there + (1.0 - given) * total[v]


def _mean_length2(points: Floats, neighbours: Neighbours) -> float:
    """Return the mean squared length of the edges; 7 / 6 where there is none."""
    if not len(neighbours.vertices):
        return 7.0 / 6.0
    sums = np.zeros(N_CHUNKS)
    run_tasks(_add_lengths2, N_CHUNKS, points, neighbours, sums)
    return 2.0 * float(sums.sum()) / len(neighbours.vertices)


@jit(nopython=True, cache=True, nogil=True)
def _add_lengths2(begin, end, points, neighbours, sums):  # type: ignore[no-untyped-def]
    """Write the sums of the squared lengths of the edges whose lower end lies in each chunk of the vertices."""
    starts, vertices = neighbours.starts, neighbours.vertices
    for chunk in range(begin, end):
        for v in range(len(points) * chunk // N_CHUNKS, len(points) * (chunk + 1) // N_CHUNKS):
            for k in range(starts[v], starts[v + 1]):
                w = vertices[k]
                if w > v:
                    x, y, z = points[v, 0] - points[w, 0], points[v, 1] - points[w, 1], points[v, 2] - points[w, 2]
                    sums[chunk] += x * x + y * y + z * z


@jit(nopython=True, cache=True, nogil=True)
def _take_step(first, last, neighbours, shares, mass, total, new_mass, new_total):  # type: ignore[no-untyped-def]
    """Write mass and total after one step of the walk: its share goes to each neighbour, an even one where `shares` are
    empty; the rest stays."""
    starts, vertices, is_even = neighbours.starts, neighbours.vertices, len(shares) == 0
    for v in range(first, last):
        given, here, there = 0.0, 0.0, 0.0
        for k in range(starts[v], starts[v + 1]):
            w = vertices[k]
            if is_even:
                share = 1.0 / (1.0 + max(starts[v + 1] - starts[v], starts[w + 1] - starts[w]))
            else:
                share = shares[k]
            given += share
            here += share * mass[w]
            there += share * total[w]
        new_mass[v], new_total[v] = here + (1.0 - given) * mass[v], there + (1.0 - given) * total[v]
