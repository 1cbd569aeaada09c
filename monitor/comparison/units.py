"""Small units of the surface, from which patches of every size are put together.

A unit is a connected piece, half as wide as errors agree. Each has its mean change, and what limits it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from monitor.comparison.correlation import Correlation
from monitor.comparison.noise import Noise
from monitor.comparison.side import Side, both_in
from monitor.registration.sampling import cell_numbers
from projects.model import Bools, Floats, Ints, Registration

LARGEST_UNIT = 8.0  # vertices along its edge


@dataclass(frozen=True)
class Units:
    """Units of one side, (u,) each.

    `number` (n,) is the unit of each vertex, -1 where not assessable; `areas` [m2]; `n_vertices`; `means` [m] of the
    change; `variances` [m2] of a vertex in it, without the registration's part; `shared` [m], one sigma of what its
    scans disagree by; `motion_rows` (u, 6), the mean of n' J; `calm_shares`, how much of its area is held to be
    unchanged.
    """

    number: Ints
    areas: Floats
    n_vertices: Ints
    means: Floats
    variances: Floats
    shared: Floats
    motion_rows: Floats
    calm_shares: Floats


def unit_size(correlation: Correlation, areas: Floats) -> float:
    """Return the edge [m] of a unit: half that of one witness's area, four to eight vertices, at most a 200th part.

    Errors that agree far along the surface make no change small: a piece that broke off is as certain as its depth is
    large, so units stay small and patches of several of them look for what is wide.
    """
    spacing = float(np.sqrt(np.median(areas)))
    largest = float(np.sqrt(areas.sum() / 200.0))
    half = 0.5 * float(np.sqrt(correlation.area))
    return max(min(half, largest, LARGEST_UNIT * spacing), 4.0 * spacing)


def cut_units(side: Side, size: float) -> Ints:
    """Return the unit of each vertex (n,), -1 where not assessable: connected parts of cubes of edge `size` [m]."""
    assessed = np.flatnonzero(side.is_assessed)
    number = np.full(len(side.areas), -1, dtype=np.int64)
    cell = cell_numbers(side.surface.vertices, size)
    edges = side.edges[both_in(side.is_assessed, side.edges)]
    joined = cell[edges[:, 0]] == cell[edges[:, 1]]
    n = len(number)
    graph = coo_matrix((np.ones(joined.sum(), dtype=np.int8), edges[joined].T), shape=(n, n))
    _, part = connected_components(graph, directed=False)
    _, number[assessed] = np.unique(part[assessed], return_inverse=True)
    return merge_slivers(number, edges[~joined], side.areas, 0.25 * size**2)


def merge_slivers(number: Ints, across: Ints, areas: Floats, least: float) -> Ints:
    """Return the units with those smaller than `least` [m2] given to the neighbour they share most edges with.

    `across` (e, 2) are the edges between units. A sliver without neighbour stays alone (and is too small to be tested).
    """
    n_units = int(number.max(initial=-1)) + 1
    area = np.bincount(number[number >= 0], areas[number >= 0], minlength=n_units)
    pairs = number[np.vstack([across, across[:, ::-1]])]
    pairs = pairs[(pairs[:, 0] != pairs[:, 1]) & (area[pairs[:, 0]] < least) & (area[pairs[:, 1]] >= least)]
    key, count = np.unique(pairs[:, 0] * max(n_units, 1) + pairs[:, 1], return_counts=True)
    small, big = np.divmod(key, max(n_units, 1))
    target = np.arange(n_units)
    rising = np.argsort(count, kind="stable")
    target[small[rising]] = big[rising]  # the last one written shares most edges
    merged = number.copy()
    merged[number >= 0] = target[number[number >= 0]]
    _, merged[number >= 0] = np.unique(merged[number >= 0], return_inverse=True)
    return merged


def summarize_units(side: Side, number: Ints, noise: Noise, registration: Registration, calm: Bools) -> Units:
    """Return the figures of each unit, area-weighted over its vertices."""
    inside = number >= 0
    points, normals = side.surface.vertices[inside], side.normals[inside]
    rows = np.hstack([np.cross(points - registration.centre, normals), normals])
    figures = [side.distances, noise.variance_of(side), side.sigma_shared, calm]
    areas, means = average_units(side, number, np.column_stack([*(f[inside] for f in figures), rows]))
    change, variances, shared, calm_shares = means[:, :4].T
    n_vertices = np.bincount(number[inside], minlength=len(areas))
    return Units(number, areas, n_vertices, change, variances, shared, means[:, 4:], calm_shares)


def place_units(side: Side, number: Ints) -> tuple[Floats, Floats]:
    """Return centres (u, 3) [m] and mean normals (u, 3), not of unit length, of the units."""
    inside = number >= 0
    _, figures = average_units(side, number, np.hstack([side.surface.vertices[inside], side.normals[inside]]))
    return figures[:, :3], figures[:, 3:]


def average_units(side: Side, number: Ints, values: Floats) -> tuple[Floats, Floats]:
    """Return the areas (u,) [m2] of the units and the area-weighted means (u, c) of the values (k, c) of the vertices
    that belong to one."""
    inside = number >= 0
    unit, weight = number[inside], side.areas[inside]
    n_units = int(number.max(initial=-1)) + 1
    areas = np.maximum(sum_groups(unit, weight, n_units), 1e-300)
    share = weight / areas[unit]
    return areas, np.column_stack([sum_groups(unit, share * column, n_units) for column in values.T])


def sum_groups(group: Ints, values: Floats, n_groups: int) -> Floats:
    """Return the sum of the values of each group (n_groups,)."""
    return np.asarray(np.bincount(group, values, minlength=n_groups), dtype=np.float64)
