"""Which wave is strongest in what a fit leaves of its points, and whether anything but noise is left at all.

In: places (u, v) in a disc of radius 1 and what is left there. Out: the power of the strongest wave over that of noise
(Lomb 1976; Scargle 1982: of white noise it is above p with probability exp(-p) at one frequency) and its frequencies in
waves a radius; and whether what lies near each other is alike (Box and Pierce 1970, in two directions).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit

from projects.model import Floats

N_CELLS = np.int64(32)  # across the disc: as far apart as its points are
N_STEPS = np.int64(26)  # of frequency, up to `HIGHEST`
STEP = 0.25  # waves a radius: half of what a disc can tell apart
LOWEST, HIGHEST = 0.3, 6.4  # waves a radius: a longer one is a bend, a shorter one hardly more than two points
FARTHEST_LAG = np.int64(4)  # cells
SURE_OF_PATTERN = 2.0  # standard deviations of the sum of squared correlations of noise, for a look at waves


class Spectrum(NamedTuple):
    """Sums and numbers (c, c) of what lies in each cell, and room for the transform along v."""

    sums: Floats
    counts: Floats
    along_re: Floats
    along_im: Floats


def waves_over_cells() -> tuple[Floats, Floats]:
    """Return cosine and sine of each frequency in the middle of each cell, (2 n + 1, c) from the lowest negative on."""
    places = (np.arange(N_CELLS) + 0.5) * 2.0 / N_CELLS - 1.0
    turns = 2.0 * np.pi * STEP * np.outer(np.arange(-N_STEPS, N_STEPS + 1), places)
    return np.cos(turns), np.sin(turns)


COSINES, SINES = waves_over_cells()


@jit(nopython=True, cache=True)
def spectrum_room() -> Any:
    """Room for one window."""
    shape = (N_STEPS + 1, N_CELLS)
    return Spectrum(np.zeros((N_CELLS, N_CELLS)), np.zeros((N_CELLS, N_CELLS)), np.zeros(shape), np.zeros(shape))


@jit(nopython=True, cache=True)
def sum_in_cells(u: Floats, v: Floats, left: Floats, n: int, room: Any) -> None:
    """Sum up what is left of n points in cells; NaN is not known and does not count."""
    room.sums[:], room.counts[:] = 0.0, 0.0
    for i in range(n):
        if np.isnan(left[i]):
            continue
        a = min(max(np.int64(0.5 * (u[i] + 1.0) * N_CELLS), 0), N_CELLS - 1)
        b = min(max(np.int64(0.5 * (v[i] + 1.0) * N_CELLS), 0), N_CELLS - 1)
        room.sums[a, b] += left[i]
        room.counts[a, b] += 1.0


# Sums over cells may be taken in vector order: it is fixed when compiling, hence the same for any threads.
@jit(nopython=True, cache=True, fastmath=True)
def covariance_at(sums: Floats, counts: Floats, da: int, db: int) -> Any:
    """Sum over cells of the product with what lies (da, db) cells on, and of the product of their numbers."""
    product, number = 0.0, 0.0
    for a in range(np.uint64(N_CELLS - da)):
        here, there = sums[a], sums[a + np.uint64(da)]
        n_here, n_there = counts[a], counts[a + np.uint64(da)]
        first, last = np.uint64(max(0, -db)), np.uint64(min(N_CELLS, N_CELLS - db))
        on = np.uint64(first + db)
        for k in range(last - first):
            product += here[first + k] * there[on + k]
            number += n_here[first + k] * n_there[on + k]
    return product, number


@jit(nopython=True, cache=True)
def pattern_in(room: Any, variance: float) -> float:
    """By how many standard deviations what lies within a few cells is more alike, or unlike, than noise."""
    total, n_lags = 0.0, 0.0
    for da in range(FARTHEST_LAG + 1):
        for db in range(-FARTHEST_LAG if da > 0 else 1, FARTHEST_LAG + 1):
            if da * da + db * db <= FARTHEST_LAG * FARTHEST_LAG:
                product, number = covariance_at(room.sums, room.counts, da, db)
                if number > 0.0:
                    total += product * product / (number * variance * variance)
                    n_lags += 1.0
    return (total - n_lags) / np.sqrt(2.0 * max(n_lags, 1.0))


@jit(nopython=True, cache=True)
def alike_beside(room: Any) -> float:
    """Covariance of what lies in cells beside each other: what varies over several cells and is not noise."""
    product, number = 0.0, 0.0
    for da, db in ((0, 1), (1, 0), (1, 1), (1, -1)):
        p, n = covariance_at(room.sums, room.counts, da, db)
        product, number = product + p, number + n
    return product / max(number, 1.0)


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def strongest_waves(room: Any, n: int, variance: float, high: float, cosines: Floats, sines: Floats) -> Any:
    """Power over that of noise, and frequencies along u and v, of the strongest wave of n points that is no bend and
    not above `high`; the power of the strongest above, and its frequencies. Frequencies are in waves a radius."""
    re, im = room.along_re, room.along_im
    for k in range(N_STEPS + 1):
        for a in range(N_CELLS):
            x, y = 0.0, 0.0
            for b in range(N_CELLS):
                x += room.sums[a, b] * cosines[N_STEPS + k, b]
                y += room.sums[a, b] * sines[N_STEPS + k, b]
            re[k, a], im[k, a] = x, y
    most, best_u, best_v, most_above, above = 0.0, 0.0, 0.0, 0.0, (0.0, 0.0)
    for j in range(2 * N_STEPS + 1):
        for k in range(N_STEPS + 1):
            f_u, f_v = STEP * (j - N_STEPS), STEP * k
            f2 = f_u * f_u + f_v * f_v
            if f2 < LOWEST * LOWEST or f2 > HIGHEST * HIGHEST or (k == 0 and j < N_STEPS):
                continue
            x, y = 0.0, 0.0
            for a in range(N_CELLS):
                x += re[k, a] * cosines[j, a] - im[k, a] * sines[j, a]
                y += re[k, a] * sines[j, a] + im[k, a] * cosines[j, a]
            power = x * x + y * y
            if f2 > high * high:
                if power > most_above:
                    most_above, above = power, (f_u, f_v)
            elif power > most:
                most, best_u, best_v = power, f_u, f_v
    return most / (n * variance), best_u, best_v, most_above / (n * variance), above
