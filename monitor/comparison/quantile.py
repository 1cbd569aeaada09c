"""Quantiles of many numbers in two passes over them, without sorting or copying: to the last bit those of numpy."""

from __future__ import annotations

import math

import numpy as np
from numba import jit

from projects.model import Floats

BINS = 1 << 16  # by sign, exponent and four bits of the mantissa: sixteen bins to a factor of two


def quantile(values: Floats, share: float) -> float:
    """Return the `share` quantile of numbers (n,), n > 0, none NaN; linear between the two nearest, as numpy."""
    place = (len(values) - 1) * share
    rank = math.floor(place)
    low, high = _select(np.ascontiguousarray(values), rank)
    return float(between(low, high, place - rank))


def median(values: Floats) -> float:
    """Return the median of numbers (n,), n > 0, none NaN."""
    low, high = _select(np.ascontiguousarray(values), (len(values) - 1) // 2)
    return float(low if len(values) % 2 else (low + high) / 2.0)


@jit(nopython=True, cache=True)
def between(low, high, t):  # type: ignore[no-untyped-def]
    """Return the number at `t` (0 to 1) of the way, rounded as numpy does."""
    if t >= 0.5:
        return high - (high - low) * (1.0 - t)
    return low + (high - low) * t


@jit(nopython=True, cache=True)
def _bin_of(bits):  # type: ignore[no-untyped-def]
    """Return the bin of a number by its bits; bins rise with the numbers."""
    top = np.int64(bits >> np.uint64(48))
    return BINS - 1 - top if top >= BINS // 2 else top + BINS // 2


@jit(nopython=True, cache=True)
def _select(values, rank):  # type: ignore[no-untyped-def]
    """Return the number of this rank (from 0) in rising order and the one after it, itself if it is the last."""
    bits, counts, last = values.view(np.uint64), np.zeros(BINS, dtype=np.int64), min(rank + 1, len(values) - 1)
    for b in bits:
        counts[_bin_of(b)] += 1
    first_bin, below = 0, 0
    while below + counts[first_bin] <= rank:
        below += counts[first_bin]
        first_bin += 1
    last_bin, upto = first_bin, below + counts[first_bin]
    while upto <= last:
        last_bin += 1
        upto += counts[last_bin]
    chosen, n = np.empty(upto - below), 0
    for i in range(len(values)):
        if first_bin <= _bin_of(bits[i]) <= last_bin:
            chosen[n] = values[i]
            n += 1
    chosen.sort()
    return chosen[rank - below], chosen[last - below]
