"""What fits of one radius tell at probes on the surface: a curved patch, the one within the radius before, a plane.

In: places and normals, the samples and a rung of their ladder. Out: a row of figures for each probe (`N_ROW`), NaN
where points do not lie all around.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

from monitor.reconstruction.gathering import (
    OVER_THE_RIM,
    ROOM,
    Sites,
    block_edge,
    block_sites,
    edge_of_groups,
    find_near,
    gate_height,
    gather_inner_first,
    keep_own_side,
    mean_normal,
    near_room,
    patch_room,
    rows_room,
)
from monitor.reconstruction.moments import Level
from monitor.reconstruction.projection import MOST_EXTRAPOLATED, Samples
from monitor.reconstruction.quadric import (
    BEND,
    COUNT,
    CURVED,
    EFFECTIVE,
    HEIGHT,
    PLANE,
    SIGMA,
    UNIT_ERROR,
    fit_patch,
    substitute,
    sum_up,
)
from monitor.threads import run_tasks
from projects.model import Floats, Ints

(
    CURVATURE,
    CURVED_UNIT,
    SCATTER,
    STEP,
    STEP_UNIT2,
    FLAT_UNIT,
    FLAT_STEP,
    FLAT_STEP_UNIT2,
    SECOND2,
    SECOND_UNIT2,
    N_ROW,
) = range(11)


@jit(nopython=True, cache=True)
def is_supported(fit: Floats) -> bool:
    """Whether points lie all around, so that the patch does not extrapolate."""
    supported: bool = fit[UNIT_ERROR] * np.sqrt(fit[EFFECTIVE]) <= MOST_EXTRAPOLATED
    return supported


@jit(nopython=True, cache=True)
def probe_one(
    level: Any, near: Any, n_near: int, vertex: Floats, normal: Floats, along: Floats, sizes: Any, room: Any,
    row: Floats,
) -> None:  # fmt: skip
    """Compare three fits at one probe: curved within the radius, curved within the last taken, plane."""
    held, other, fit_other, own = room
    patch, work, influence, fit = held.patch, held.work, held.influence, held.fit
    radius, gate, inner = sizes
    if not mean_normal(near, n_near, vertex, normal, along, radius, 1.0, gate, own):
        return
    shape = (radius, 1.0, gate, inner)
    n_inner, n = gather_inner_first(level, near, n_near, vertex, own, along, shape, patch, held.picked)
    if not fit_patch(patch, n, radius, 1.0, 1.0, CURVED, work, fit, influence):
        return
    if not is_supported(fit):
        return
    row[CURVATURE], row[CURVED_UNIT], row[SCATTER] = fit[BEND], fit[UNIT_ERROR], fit[SIGMA]
    write_second(patch, n, radius, work, row)
    if (
        inner < 1.0
        and fit_patch(patch, n_inner, radius, inner, 1.0, CURVED, work, fit_other, other)
        and is_supported(fit_other)
    ):
        other[n_inner:n] = 0.0
        row[STEP] = fit[HEIGHT] - fit_other[HEIGHT]
        row[STEP_UNIT2] = apart2(patch, n, influence, other)
    if fit_patch(patch, n, radius, 1.0, 1.0, PLANE, work, fit_other, other):
        row[FLAT_UNIT] = fit_other[UNIT_ERROR]
        row[FLAT_STEP] = fit[HEIGHT] - fit_other[HEIGHT]
        row[FLAT_STEP_UNIT2] = apart2(patch, n, influence, other)


@jit(nopython=True, cache=True)
def write_second(patch: Floats, n: int, radius: float, work: Any, row: Floats) -> None:
    """Write the sum of squares (1/m2) of the second derivatives of the patch fitted last, and of the sum of both
    curvatures the variance (1/m4) in that of a point, which is about that of the former too."""
    c, a, g, _, squares, _, weights, influence = work
    row[SECOND2] = (4.0 * c[3] * c[3] + 2.0 * c[4] * c[4] + 4.0 * c[5] * c[5]) / radius**2
    g[:] = 0.0
    g[3] = g[5] = 2.0
    substitute(a, g, 6)
    _, _, _, variance = sum_up(patch, n, 1.0, 1.0, g, squares, weights, influence)
    row[SECOND_UNIT2] = variance / radius**4


@jit(nopython=True, cache=True)
def probe_room(n: int) -> Any:
    """Room for two fits to one patch of up to n groups, and for its normal."""
    return patch_room(n), np.empty(n), np.empty(7), np.empty(3)


@jit(nopython=True, cache=True)
def apart2(patch: Floats, n: int, influence: Floats, other: Floats) -> float:
    """Variance of the difference of two fits to one patch, in units of that of a point."""
    total = 0.0
    for i in range(n):
        total += patch[COUNT, i] * (influence[i] - other[i]) ** 2
    return total


def probe(
    places: Floats, normals: Floats, which: Ints, samples: Samples, rung: int, inner: Floats,
    cuts: Floats | None = None,
) -> Floats:  # fmt: skip
    """Return what fits at one rung tell at the places `which`, (n, `N_ROW`); NaN elsewhere.

    `inner` (n,) is the share of the radius within which the fit to compare with is made; 1 for none.
    """
    rows = np.full((len(places), N_ROW), np.nan)
    radius = samples.radii[rung]
    if len(which):
        sites, gate = block_sites(places, normals, which, radius, cuts=cuts), gate_height(radius, samples.noise)
        run_tasks(_probe, len(sites.starts) - 1, sites, samples.levels[rung], radius, gate, inner, rows)
    return rows


@jit(nopython=True, cache=True, nogil=True)
def _probe(
    first: int, last: int, sites: Sites, level: Level, radius: float, gate: float, inner: Floats, rows: Floats
) -> None:
    """Probe at the vertices of the blocks `first` to `last`, for `run_tasks`."""
    reach = np.hypot(OVER_THE_RIM * radius, gate)
    spans, near = rows_room(reach, block_edge(radius), level.bucket), near_room(ROOM)
    room, mixed, own = probe_room(ROOM), edge_of_groups(level, radius), near_room(ROOM)
    for block in range(first, last):
        n_near, near = find_near(level, sites, block, reach, spans, near)
        if n_near > len(room[1]):
            room = probe_room(2 * n_near)
        if len(near.groups) > len(own.groups):
            own = near_room(len(near.groups))
        for k in range(sites.starts[block], sites.starts[block + 1]):
            i = sites.which[k]
            sizes = (radius, gate, inner[i])
            vertex, normal, along = sites.vertices[i], sites.normals[i], sites.alongs[k]
            if len(sites.cuts) == 0:
                probe_one(level, near, n_near, vertex, normal, along, sizes, room, rows[i])
            else:
                n_own = keep_own_side(near, n_near, sites.cuts[k], mixed, own)
                probe_one(level, own, n_own, vertex, normal, along, sizes, room, rows[i])
