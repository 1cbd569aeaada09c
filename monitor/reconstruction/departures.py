"""How two fits at each probe depart from each other, judged against their noise, pooled over the probes around.

In: departures and their variances (n,), and the pool (n, k) of each probe. Out: where they exceed what noise explains
(Lepski 1991), and by how much. A single test does not see a bias of one standard error, and all of a sphere would keep
it: the evidence of neighbouring probes is pooled.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit

from monitor.reconstruction.gathering import tangent_frame
from projects.model import Bools, Floats, Ints

N_HERE = 4  # probes next to each other that tell how large a bias is where it is seen
FEWEST_AROUND = 12  # probes, that tell how the curvature changes,
NARROWEST_POOL = 0.0025  # determinant over squared trace of their places: of a strip twenty times as long as wide
DOUBT, REFUSAL, BENT = 1.25, 4.0, 2.0  # sigmas of a pooled mean square departure above that of noise alone
ONE_SIDED = 1.5  # sigmas of the mean departure of pooled probes, which curvature gives one sign
OWN_REFUSAL = 16.0  # the same for one probe: four sigma
CLIPPED = 4.0  # of a squared departure, so that an edge nearby does not decide
MEAN_CLIPPED = 0.92  # mean of min(chi2, 4)


class Departure(NamedTuple):
    """How two fits depart from each other at each probe: beyond noise or perhaps so; by how much (m2), how sure."""

    own2: Floats  # squared, in units of its variance
    is_refused: Bools
    is_doubtful: Bools
    is_one_sided: Bools
    excess2: Floats
    here2: Floats  # m2, by how much at the probe and those next to it, edges and all
    doubt2: Floats


def compare_steps(step: Floats, variance: Floats, pool: Ints, n_apart: float | Floats) -> Departure:
    """Judge departures (n,) against the variance (n,) that noise gives them, pooled over the probes around."""
    chance = np.sqrt(2.0 / n_apart)
    with np.errstate(invalid="ignore", divide="ignore"):
        own = step**2 / variance
        pooled = mean_of_pool(np.minimum(own, CLIPPED), pool) / MEAN_CLIPPED
        is_refused = (pooled > 1.0 + REFUSAL * chance) | (own > OWN_REFUSAL)
        one_sided = np.abs(mean_of_pool(np.clip(step / np.sqrt(variance), -2.0, 2.0), pool)) > ONE_SIDED / np.sqrt(
            n_apart
        )
        is_doubtful = pooled > 1.0 + DOUBT * chance
    expected = mean_of_pool(variance, pool)
    excess2 = np.nan_to_num(np.maximum(pooled - 1.0, 0.0) * expected)
    here2 = np.nan_to_num(np.maximum(mean_of_pool(step**2 - variance, pool, N_HERE), 0.0))
    return Departure(own, is_refused, is_doubtful, one_sided, excess2, here2, expected * chance)


def count_apart(n: int, area: float, radius: float) -> float:
    """Return how many independent fits `n` probes of `area` (m2) each amount to; those that overlap tell the same."""
    return min(float(n), max(n * area / (0.5 * np.pi * radius**2), 1.0))


def is_bent(step: Departure, radius: float, area: float) -> bool:
    """Whether probes together depart more than noise explains: a bias too small for any one neighbourhood.

    Neighbourhoods that doubt the radius by themselves are left out: their relief says nothing of the rest.
    """
    known = step.own2[np.isfinite(step.own2) & ~step.is_doubtful]
    if not len(known):
        return False
    limit = 1.0 + BENT * np.sqrt(2.0 / count_apart(len(known), area, radius))
    return bool(np.minimum(known, CLIPPED).mean() / MEAN_CLIPPED > limit)


@jit(nopython=True, cache=True, nogil=True)
def mean_of_pool(values: Floats, pool: Ints, n_next: int = 1 << 30) -> Floats:
    """Mean over each probe's neighbours, of which the next `n_next` count; NaN where none has a value.

    Numbers below none in the pool stand for no neighbour.
    """
    out = np.empty(len(pool))
    for i in range(len(pool)):
        total, count = 0.0, 0
        for k in range(min(pool.shape[1], n_next)):
            value = values[pool[i, k]]
            if pool[i, k] >= 0 and np.isfinite(value):
                total += value
                count += 1
        out[i] = total / count if count > 0 else np.nan
    return out


@jit(nopython=True, cache=True, nogil=True)
def change_around(values: Floats, places: Floats, normals: Floats, pool: Ints) -> Any:
    """Squared gradient (n,) along the surface of `values` over each place's pool, and what independent errors of one
    unit make of it, times their number [1/m2]; NaN where too few are known, or they lie on a line.

    Places whose normals look the other way are of another sheet.
    """
    change2, unit2 = np.full(len(values), np.nan), np.full(len(values), np.nan)
    for i in range(len(values)):
        (tx, ty, tz), (bx, by, bz) = tangent_frame(normals[i])
        n = su = sv = sh = suu = suv = svv = suh = svh = 0.0
        for j in pool[i]:
            h = values[j]
            cosine = normals[j, 0] * normals[i, 0] + normals[j, 1] * normals[i, 1] + normals[j, 2] * normals[i, 2]
            if np.isfinite(h) and cosine > 0.0:
                x, y, z = places[j, 0] - places[i, 0], places[j, 1] - places[i, 1], places[j, 2] - places[i, 2]
                u, v = x * tx + y * ty + z * tz, x * bx + y * by + z * bz
                n, su, sv, sh = n + 1.0, su + u, sv + v, sh + h
                suu, suv, svv, suh, svh = suu + u * u, suv + u * v, svv + v * v, suh + u * h, svh + v * h
        if n < FEWEST_AROUND:
            continue
        suu, suv, svv = (suu - su * su / n) / n, (suv - su * sv / n) / n, (svv - sv * sv / n) / n
        suh, svh = (suh - su * sh / n) / n, (svh - sv * sh / n) / n
        det, both = suu * svv - suv * suv, suu + svv
        if det > NARROWEST_POOL * both * both:
            gu, gv = (svv * suh - suv * svh) / det, (suu * svh - suv * suh) / det
            change2[i], unit2[i] = gu * gu + gv * gv, both / det
    return change2, unit2
