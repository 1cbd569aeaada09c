"""Quantiles of many numbers without sorting or copying them: to the last bit those of numpy.

A sample shows between which two numbers the one asked for very likely lies; one pass over all gathers what does.
"""

from __future__ import annotations

import math

import numpy as np
from numba import jit

from projects.model import Floats

N_SAMPLE = 1 << 12  # numbers that show where to look
MARGIN = 4.0  # sigmas of a rank as a sample tells it
SPARE = 1.5  # room for so many times what is likely to be gathered


def quantile(values: Floats, share: float) -> float:
    """Return the `share` quantile of numbers (n,), n > 0, none NaN; linear between the two nearest, as numpy."""
    return float(between(*around_quantile(values, share)))


def around_quantile(values: Floats, share: float) -> tuple[float, float, float]:
    """Return the two numbers that the `share` quantile lies between, and how far (0 to 1) it is from the first."""
    place = (len(values) - 1) * share
    rank = math.floor(place)
    return *_select(values, rank), place - rank


def median(values: Floats) -> float:
    """Return the median of numbers (n,), n > 0, none NaN."""
    low, high = _select(values, (len(values) - 1) // 2)
    return low if len(values) % 2 else (low + high) / 2.0


@jit(nopython=True, cache=True, nogil=True)
def between(low, high, t):  # type: ignore[no-untyped-def]
    """Return the number at `t` (0 to 1) of the way, rounded as numpy does."""
    if t >= 0.5:
        return high - (high - low) * (1.0 - t)
    return low + (high - low) * t


def _select(values: Floats, rank: int) -> tuple[float, float]:
    """Return the number of this rank (from 0) in rising order and the one after it, itself if it is the last."""
    last, below = min(rank + 1, len(values) - 1), 0
    if len(values) >= 4 * N_SAMPLE:
        chosen, n_less = _gather(values, *_bracket(values, rank))
        if n_less <= rank and last < n_less + len(chosen):
            values, below = chosen, n_less
    found = np.partition(values, (rank - below, last - below))
    return float(found[rank - below]), float(found[last - below])


def _bracket(values: Floats, rank: int) -> tuple[float, float, int]:
    """Return two numbers between which that of a rank very likely lies, and for how many there to make room."""
    step = len(values) // N_SAMPLE
    sample = np.sort(values[::step])
    m, share = len(sample), rank / len(values)
    margin = MARGIN * math.sqrt(share * (1.0 - share) * m) + 2.0
    first, last = math.floor(share * m - margin), math.ceil(share * m + margin)
    low, high = sample[first] if first >= 0 else -np.inf, sample[last] if last < m else np.inf
    return float(low), float(high), int(SPARE * 2.0 * margin * step)


@jit(nopython=True, cache=True, nogil=True)
def _gather(values, low, high, room):  # type: ignore[no-untyped-def]
    """Return the numbers from `low` to `high`, none where there is no room for all, and how many are less."""
    chosen, n_less, n = np.empty(room), 0, 0
    for value in values:
        n_less += value < low
        chosen[n] = value
        n += (value >= low) & (value <= high)
        if n == room:
            return chosen[:0], 0
    return chosen[:n], n_less
