"""The vertices that are held to be unchanged, by the stratum of place that each is of: they teach the noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import jit

from monitor.comparison.distances.scratch import keep_on_disk
from monitor.comparison.distances.side import Side
from monitor.comparison.noise.level_of_detection import least_floor
from monitor.comparison.noise.strata import N_STRATA, stratum_of
from projects.model import Bools, Floats, Ints


class CalmVertices(NamedTuple):  # a named tuple, since kernels take it whole
    """The calm vertices of one side: their `places` (n,), rising, among all, of which `points` (m, 3) [m], `distances`
    (m,) [m], one sigma (m,) [m] of what is stated of the surfaces, `own`, of their `discord`, of the scans, `shared`,
    and of the registration and of limbs, `motion`. `stratum` (n,) of each; `members` (n,) are the places by stratum,
    those of stratum k from starts[k] on; distances below the `resolution` [m] are none. Once their parts are known
    `own` is all of them but that `motion`."""

    points: Floats
    places: Ints
    distances: Floats
    own: Floats
    discord: Floats
    shared: Floats
    motion: Floats
    stratum: Ints
    members: Ints
    starts: Ints
    resolution: float


def gather_calm(side: Side, calm: Bools, spacing: float) -> CalmVertices:
    """Return the vertices of a side in the mask `calm` (n,); `spacing` [m] is that of the vertices of both sides."""
    places, stratum = np.flatnonzero(calm).astype(np.int32), stratum_of(side, spacing)
    if len(places) < len(calm):
        stratum = stratum[places]
    members, starts = sort_by_stratum(places, stratum)
    fixed = side.sigma_motion if side.limb is None else keep_on_disk(np.hypot(side.sigma_motion, side.limb))
    return CalmVertices(side.surface.vertices, places, side.distances, side.sigma_surfaces, side.sigma_discord,
                        side.sigma_shared, fixed, stratum, keep_on_disk(members), starts,
                        least_floor(side.surface.vertices))  # fmt: skip


def sort_by_stratum(places: Ints, stratum: Ints) -> tuple[Ints, Ints]:
    """Return the places (n,) by stratum, in their order within one, and where each of the `N_STRATA` begins."""
    starts = np.append(0, np.cumsum(np.bincount(stratum, minlength=N_STRATA)))
    return np.asarray(_sort_places(places, stratum, starts)), starts


@jit(nopython=True, cache=True, nogil=True)
def _sort_places(places, stratum, starts):  # type: ignore[no-untyped-def]
    """Return the places (n,) sorted by stratum, in their order within each."""
    out, filled = np.empty_like(places), starts[:-1].copy()
    for i in range(len(places)):
        out[filled[stratum[i]]] = places[i]
        filled[stratum[i]] += 1
    return out


def n_held(calm: CalmVertices, members: Ints) -> int:
    """Return how many vertices some strata hold."""
    return int((calm.starts[members + 1] - calm.starts[members]).sum())


def are_copies(calm: Sequence[CalmVertices]) -> bool:
    """Return whether most calm vertices lie on the other side to the last digit, which no second survey does."""
    n_off = sum(_count_within(c.distances, c.places, c.resolution) for c in calm)
    return bool(2 * n_off > sum(len(c.places) for c in calm))


@jit(nopython=True, cache=True, nogil=True)
def _count_within(distances, places, limit):  # type: ignore[no-untyped-def]
    """Return how many of the distances at the `places` are at most `limit` in size."""
    n = 0
    for v in places:
        n += abs(distances[v]) <= limit
    return n
