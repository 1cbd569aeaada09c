"""Small units of the surface, from which patches of every size are put together.

A unit is a connected piece, half as wide as errors agree. Each has its mean change, and what limits it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import jit

from monitor.blocks import blocks
from monitor.boxes import box_of
from monitor.comparison.distances.connected import connect_like
from monitor.comparison.distances.quantile import median
from monitor.comparison.distances.side import Side
from monitor.comparison.distances.stars import Neighbours
from monitor.comparison.noise.correlation import Correlation
from monitor.comparison.noise.model import Noise
from monitor.tuples import cross
from projects.model import Bools, Floats, Ints, Registration, Roughness

LARGEST_UNIT = 8.0  # vertices along its edge
ROUGH_FROM = 0.25  # of a unit's area, which is rough: so is the unit then


@dataclass(frozen=True)
class Units:
    """Units of one side, (u,) each.

    `number` (n,) is the unit of each vertex, -1 where not assessable; `areas` [m2]; `n_vertices`; `centres` (u, 3) [m];
    `means` [m] of the change; `shared` [m], one sigma of what its scans disagree by, and `limbs` [m], of what they err
    by besides at limbs; `motion_rows` (u, 6), the mean of n' J, of which the last three are the mean normal, not of
    unit length; `kinds`, 1 where it is rough and noise is not stated, else 0. As far as the noise is known: `variances`
    [m2] of a vertex in it, without the registration's part; `calm_shares`, how much of its area is held unchanged;
    `agreeing` [m2], the variances times the square of how much farther errors agree there (`noise.stretch`).
    """

    number: Ints
    areas: Floats
    n_vertices: Ints
    centres: Floats
    means: Floats
    shared: Floats
    limbs: Floats
    motion_rows: Floats
    kinds: Ints
    variances: Floats
    calm_shares: Floats
    agreeing: Floats


def unit_size(correlation: Correlation, areas: Floats) -> float:
    """Return the edge [m] of a unit: half that of one witness's area, four to eight vertices, at most a 200th part.

    Errors that agree far along the surface make no change small: a piece that broke off is as certain as its depth is
    large, so units stay small and patches of several of them look for what is wide.
    """
    spacing = float(np.sqrt(median(areas)))
    largest = float(np.sqrt(areas.sum() / 200.0))
    half = 0.5 * float(np.sqrt(correlation.area))
    return max(min(half, largest, LARGEST_UNIT * spacing), 4.0 * spacing)


def cut_units(side: Side, size: float) -> Ints:
    """Return the unit of each vertex (n,), -1 where not assessable: connected parts of cubes of edge `size` [m]."""
    low, high = box_of(side.surface.vertices)
    cells = _number_cells(side.surface.vertices, side.is_assessed, low, high, size)
    return merge_slivers(connect_like(cells, [side.neighbours]), side.neighbours, side.areas, 0.25 * size**2)


@jit(nopython=True, cache=True, nogil=True)
def _number_cells(points, is_assessed, low, high, size):  # type: ignore[no-untyped-def]
    """Return the number of the cube of edge `size` that each point lies in, -1 where it is not assessed."""
    out = np.full(len(points), -1, dtype=np.int64)
    n_y, n_z = np.int64(np.floor((high[1] - low[1]) / size)) + 1, np.int64(np.floor((high[2] - low[2]) / size)) + 1
    for v in range(len(points)):
        if is_assessed[v]:
            i = np.int64(np.floor((points[v, 0] - low[0]) / size))
            j = np.int64(np.floor((points[v, 1] - low[1]) / size))
            out[v] = (i * n_y + j) * n_z + np.int64(np.floor((points[v, 2] - low[2]) / size))
    return out


def merge_slivers(number: Ints, neighbours: Neighbours, areas: Floats, least: float) -> Ints:
    """Return the units (n,) with those smaller than `least` [m2] given to the neighbour they share most edges with.

    A sliver without neighbour stays alone (and is too small to be tested).
    """
    n_units = int(number.max(initial=-1)) + 1
    area, _ = _sum_areas(number, areas, n_units)
    key, count = np.unique(_border_pairs(number, neighbours, area, least), return_counts=True)
    small, big = np.divmod(key, max(n_units, 1))
    target = np.arange(n_units)
    rising = np.argsort(count, kind="stable")
    target[small[rising]] = big[rising]  # the last one written shares most edges
    _, target = np.unique(target, return_inverse=True)
    return np.append(target, -1).astype(np.int32)[number]  # -1 is the last


@jit(nopython=True, cache=True, nogil=True)
def _border_pairs(number, neighbours, area, least):  # type: ignore[no-untyped-def]
    """Return small unit * number of units + large one for each edge between a unit below `least` and one above."""
    out, n = np.empty(len(neighbours.vertices) // 2, dtype=np.int64), 0
    for v in range(len(number)):
        own = np.int64(number[v])
        if own < 0 or area[own] >= least:
            continue
        for k in range(neighbours.starts[v], neighbours.starts[v + 1]):
            other = np.int64(number[neighbours.vertices[k]])
            if other >= 0 and area[other] >= least:
                out[n] = own * len(area) + other
                n += 1
    return out[:n].copy()


def summarize_units(side: Side, number: Ints, registration: Registration, n_units: int | None = None) -> Units:
    """Return the figures of each unit, area-weighted over its vertices; what the noise says is not known yet. Some of
    `n_units` may have no vertex."""
    n_units = int(number.max(initial=-1)) + 1 if n_units is None else n_units
    areas, n_vertices = _sum_areas(number, side.areas, n_units)
    areas = np.maximum(areas, 1e-300)
    centres = _average(number, side.areas, areas, np.ascontiguousarray(side.surface.vertices))
    rows = _average_rows(number, side.areas, areas, side.surface.vertices, side.normals, registration.centre)
    means, shared, limbs = (_average(number, side.areas, areas, f[:, None])[:, 0]
                            for f in (side.distances, side.sigma_shared, side.limb_of()))  # fmt: skip
    unknown = np.full(len(areas), np.nan)
    kinds = _kinds_of(side, number, areas)
    return Units(number, areas, n_vertices, centres, means, shared, limbs, rows, kinds, unknown, unknown, unknown)


def _kinds_of(side: Side, number: Ints, areas: Floats) -> Ints:
    """Return the kind (u,) of each unit of so much area, by how much of it is rough; 0 where noise is stated."""
    if side.states_noise or side.surface.roughness is None:
        return np.zeros(len(areas), dtype=np.int64)
    is_rough = (side.surface.roughness == Roughness.ROUGH).astype(np.float64)
    return (_average(number, side.areas, areas, is_rough[:, None])[:, 0] >= ROUGH_FROM).astype(np.int64)


def average_by_unit(number: Ints, areas: Floats, values: Floats, n_units: int) -> tuple[Floats, Floats]:
    """Return the area [m2] and the mean (u,) by area of the values (n,) over the vertices of each unit `number` (n,),
    -1 for none; a unit without vertices has hardly any area, and 0."""
    whole = np.maximum(_sum_areas(number, areas, n_units)[0], 1e-300)
    return whole, _average(number, areas, whole, values[:, None])[:, 0]


def judge_noise(units: Units, side: Side, noise: Noise, calm: Bools) -> Units:
    """Return the units with what the noise says of their vertices, and how much of them is in `calm` (n,)."""
    variance, agreeing = np.empty(len(calm)), np.empty(len(calm))
    for block in blocks(len(variance)):
        variance[block] = noise.variance_of(side, block)
        agreeing[block] = variance[block] * noise.stretch.square_of(variance[block])
    variances, calm_shares, alike = (_average(units.number, side.areas, units.areas, f[:, None])[:, 0]
                                     for f in (variance, calm, agreeing))  # fmt: skip
    return replace(units, variances=variances, calm_shares=calm_shares, agreeing=alike)


@jit(nopython=True, cache=True, nogil=True)
def _sum_areas(number, areas, n_units):  # type: ignore[no-untyped-def]
    """Return the sum of the areas of the vertices of each unit, and how many they are."""
    whole, counts = np.zeros(n_units), np.zeros(n_units, dtype=np.int64)
    for v in range(len(number)):
        if number[v] >= 0:
            whole[number[v]] += areas[v]
            counts[number[v]] += 1
    return whole, counts


@jit(nopython=True, cache=True, nogil=True)
def _average(number, weights, whole, values):  # type: ignore[no-untyped-def]
    """Return the weighted means (u, c) of the values (n, c) of each unit's vertices, whose weights sum to `whole`."""
    out = np.zeros((len(whole), values.shape[1]))
    for v in range(len(number)):
        if number[v] >= 0:
            share = weights[v] / whole[number[v]]
            for c in range(values.shape[1]):
                out[number[v], c] += share * values[v, c]
    return out


@jit(nopython=True, cache=True, nogil=True)
def _average_rows(number, weights, whole, points, normals, centre):  # type: ignore[no-untyped-def]
    """Return the weighted means (u, 6) of n' J: the arm across the normal, and the normal."""
    out = np.zeros((len(whole), 6))
    for v in range(len(number)):
        if number[v] >= 0:
            share = weights[v] / whole[number[v]]
            normal = (normals[v, 0], normals[v, 1], normals[v, 2])
            arm = (points[v, 0] - centre[0], points[v, 1] - centre[1], points[v, 2] - centre[2])
            across = cross(arm, normal)
            for k in range(3):
                out[number[v], k] += share * across[k]
                out[number[v], 3 + k] += share * normal[k]
    return out
