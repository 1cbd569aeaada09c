"""Pairs of vertices of a large surface, as many at each scale, that show how far its errors agree.

In: which vertices are asked. Out: pairs of them and how far apart they lie. A few samples are paired with all that lie
within reach among an even draw of the vertices, as dense as the reach asks for: no tree of half of them is made. Which
are paired is chosen before anything is known of their errors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import jit

from projects.model import Floats, Ints

N_BUCKETS = 1 << 17  # of the table of cubes around samples: twice as many as the cubes of 2000


class Pairs(NamedTuple):
    """Pairs of vertices `first` and `second` (p,), `lags` [m] apart."""

    first: Ints
    second: Ints
    lags: Floats


class _Table(NamedTuple):  # a named tuple, since kernels take it whole
    """Which samples, at `places` (s, 3) [m], lie in each cube or in one beside it: `entries` of its bucket, from
    starts[bucket] on.

    Cubes of edge `size` [m] begin at `low` (3,) [m]; those that share a bucket share their entries."""

    places: Floats
    starts: Ints
    entries: Ints
    low: Floats
    size: float


def draw_evenly(n: int, k: int, rng: np.random.Generator) -> Ints:
    """Return k numbers below n, rising: one of each of k runs of them, k up to n."""
    first = np.arange(k + 1) * n // max(k, 1)
    return first[:-1] + (rng.random(k) * np.diff(first)).astype(np.int64)


def pair_within(points: Floats, samples: Ints, drawn: Ints, reach: float) -> Pairs:
    """Return the pairs of each drawn vertex (k,), in turn, with the samples (s,) within `reach` [m] of it.

    `samples` and `drawn` are places among `points` (n, 3) [m]; a sample is no pair with itself.
    """
    places = points[samples]
    low = places.min(axis=0) - reach
    starts, entries = _fill_table(places, low, reach, N_BUCKETS)
    table = _Table(places, starts, entries, low, reach)
    return Pairs(*_list_pairs(points, drawn, samples, table, 32 * len(samples) + 32))


@jit(nopython=True, cache=True, forceinline=True)
def _bucket_of(x, y, z, n):  # type: ignore[no-untyped-def]
    """Return the bucket of a cube, of n, a power of two."""
    return ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & (n - 1)


@jit(nopython=True, cache=True, forceinline=True)
def _cube_of(points, v, low, size):  # type: ignore[no-untyped-def]
    """Return the cube that point v lies in."""
    return (np.int64(np.floor((points[v, 0] - low[0]) / size)), np.int64(np.floor((points[v, 1] - low[1]) / size)),
            np.int64(np.floor((points[v, 2] - low[2]) / size)))  # fmt: skip


@jit(nopython=True, cache=True, nogil=True)
def _fill_table(places, low, size, n_buckets):  # type: ignore[no-untyped-def]
    """Return starts and entries of the buckets: of its own cube and 26 around, each sample once in a bucket."""
    starts, last = np.zeros(n_buckets + 1, dtype=np.int32), np.full(n_buckets, -1, dtype=np.int32)
    entries, filled = np.empty(0, dtype=np.int32), np.empty(0, dtype=np.int32)
    for is_written in (False, True):
        for s in range(len(places)):
            x, y, z = _cube_of(places, s, low, size)
            for k in range(27):
                bucket = _bucket_of(x + k // 9 - 1, y + k // 3 % 3 - 1, z + k % 3 - 1, n_buckets)
                if last[bucket] == s:
                    continue
                last[bucket] = s
                if is_written:
                    entries[filled[bucket]] = s
                    filled[bucket] += 1
                else:
                    starts[bucket + 1] += 1
        if not is_written:
            for bucket in range(n_buckets):
                starts[bucket + 1] += starts[bucket]
                last[bucket] = -1
            entries, filled = np.empty(starts[-1], dtype=np.int32), starts[:-1].copy()
    return starts, entries


@jit(nopython=True, cache=True, nogil=True)
def _list_pairs(points, drawn, samples, table, room):  # type: ignore[no-untyped-def]
    """Return first, second and lag of the pairs; `room` for so many is made at first, and doubled when it is full."""
    first, second, lags = np.empty(room, dtype=np.int32), np.empty(room, dtype=np.int32), np.empty(room)
    n, places, reach2, last = 0, table.places, table.size * table.size, len(table.starts) - 1
    for v in drawn:
        x, y, z = _cube_of(points, v, table.low, table.size)
        bucket = _bucket_of(x, y, z, last)
        for k in range(table.starts[bucket], table.starts[bucket + 1]):
            s = table.entries[k]
            dx, dy, dz = points[v, 0] - places[s, 0], points[v, 1] - places[s, 1], points[v, 2] - places[s, 2]
            lag2 = dx * dx + dy * dy + dz * dz
            if lag2 > reach2 or samples[s] == v:
                continue
            if n == len(first):
                first, second = np.append(first, np.empty_like(first)), np.append(second, np.empty_like(second))
                lags = np.append(lags, np.empty_like(lags))
            first[n], second[n], lags[n] = samples[s], v, np.sqrt(lag2)
            n += 1
    return first[:n].copy(), second[:n].copy(), lags[:n].copy()
