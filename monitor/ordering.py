"""The order of whole numbers, for what is sorted into cells, columns or along a curve.

In: keys, none below zero. Out: which comes first; of equal keys the one given first.
"""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.threads import run_tasks
from projects.model import Ints

BITS = 63  # of a whole number above zero
DIGIT = 9  # bits that are sorted by at once: places to write to that a processor's cache holds
FEWEST, MOST = 1 << 15, 1 << 24  # keys that are sorted by digits: worth it, and no more than 128 MiB beside them
N_PARTS = 8  # of the keys, for threads


def stable_order(keys: Ints) -> Ints:
    """Return the order (n,) of keys (n,), as `np.argsort` does by its stable kind.

    Numbers sort several times faster by their value than through an index: each key is sorted with its place behind it.
    """
    n = len(keys)
    room, size = max(n - 1, 0).bit_length(), int(keys.max(initial=0)).bit_length()
    if size + room > BITS:
        return np.argsort(keys, kind="stable")
    packed = np.left_shift(keys, room, dtype=np.int64)
    packed |= np.arange(n)
    if FEWEST <= n <= MOST:
        packed = _sort_by_digits(packed, room, room + size)
    else:
        packed.sort()
    packed &= (1 << room) - 1
    return packed


def _sort_by_digits(values: Ints, low: int, high: int) -> Ints:
    """Return the values (n,) sorted by their bits from `low` to `high`, equal ones in their order; `values` is used up.

    Digit by digit, the last first: parts of the values count theirs, then each writes to where its own begin.
    """
    bounds = np.array([len(values) * k // N_PARTS for k in range(N_PARTS + 1)])
    other, counts = np.empty_like(values), np.empty((N_PARTS, 1 << DIGIT), dtype=np.int64)
    for shift in range(low, high, DIGIT):
        mask = (1 << min(DIGIT, high - shift)) - 1
        run_tasks(_count_digits, N_PARTS, values, bounds, shift, mask, counts)
        first = np.cumsum(counts.T.ravel()) - counts.T.ravel()  # by digit, then by part
        places = np.ascontiguousarray(first.reshape(1 << DIGIT, N_PARTS).T)
        run_tasks(_write_by_digit, N_PARTS, values, bounds, shift, mask, places, other)
        values, other = other, values
    return values


@jit(nopython=True, cache=True, nogil=True)
def _count_digits(begin, end, values, bounds, shift, mask, counts):  # type: ignore[no-untyped-def]
    """Write how many values of each part have each digit."""
    for part in range(begin, end):
        counts[part] = 0
        for i in range(bounds[part], bounds[part + 1]):
            counts[part, (values[i] >> shift) & mask] += 1


@jit(nopython=True, cache=True, nogil=True)
def _write_by_digit(begin, end, values, bounds, shift, mask, places, out):  # type: ignore[no-untyped-def]
    """Write the values of each part to the place of their digit, which moves on."""
    for part in range(begin, end):
        for i in range(bounds[part], bounds[part + 1]):
            digit = (values[i] >> shift) & mask
            out[places[part, digit]] = values[i]
            places[part, digit] += 1
