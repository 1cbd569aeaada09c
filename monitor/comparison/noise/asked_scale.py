"""How many times larger than stated errors are, that calm vertices show: a quantile of their distances; and how much of
that is believed, of so many witnesses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import jit
from scipy.stats import norm

from monitor.comparison.distances.quantile import around_quantile, between, quantile
from monitor.comparison.noise.calm_vertices import CalmVertices, n_held
from projects.model import Floats, Ints


def asked_scale(calm: Sequence[CalmVertices], members: Ints, factors: Floats, share: float) -> float:
    """Return what `own` must be multiplied by for `share` of the distances to lie where a normal error puts them.

    Asked are the vertices in the strata `members`, whose `own` is taken times the `factors` (N_STRATA,) of their
    stratum. The registration's part is learned from residuals and stays as stated. It was fitted to these very
    distances, which show less of it than there is: it makes up for half of the variance at most.

    Notes
    -----
    A distance lies within z sqrt(s^2 own^2 + motion^2) where s^2 >= (d^2 / z^2 - motion^2) / own^2: s^2 is the `share`
    quantile of the right-hand sides.
    """
    z = float(norm.ppf(0.5 + 0.5 * share))
    low, high, t = around_quantile(_gather_ratios(calm, members, factors, z, False), share)
    found = between(low, high, t)
    if low > 0.51:  # the other ratios lie between these and 1: at most twice as large from here on
        return float(np.sqrt(found))
    return float(np.sqrt(max(found, 0.5 * quantile(_gather_ratios(calm, members, factors, z, True), share))))


def _gather_ratios(calm: Sequence[CalmVertices], members: Ints, factors: Floats, z: float, is_within: bool) -> Floats:
    """Return (d^2 / z^2 - motion^2) / own^2, or d^2 / z^2 / (own^2 + motion^2) where `is_within`, of the vertices in
    the strata `members`."""
    ratios, used = np.empty(sum(n_held(c, members) for c in calm)), 0
    for c in calm:
        used = _add_ratios(c, members, factors, z, is_within, ratios, used)
    return ratios


@jit(nopython=True, cache=True, nogil=True)
def _add_ratios(calm, strata, factors, z, is_within, ratios, used):  # type: ignore[no-untyped-def]
    """Write the ratios of some strata of one side from `used` on; return how many are used then."""
    for k in strata:
        for i in range(calm.starts[k], calm.starts[k + 1]):
            v = calm.members[i]
            d, own = calm.distances[v] / z, factors[k] * calm.own[v]
            own2, motion2 = max(own * own, 1e-300), calm.motion[v] * calm.motion[v]
            ratios[used] = d * d / (own2 + motion2) if is_within else (d * d - motion2) / own2
            used += 1
    return used


def believe(asked: float, n_witnesses: float, held_by: float) -> float:
    """Return the factor that remains of the one `asked` for by so many witnesses: its logarithm, weighted against those
    that it is `held_by`.

    The 95 % quantile of n independent errors is known to 0.95 / sqrt(n) of its logarithm, one sigma. What is held to be
    off by a factor of f, one sigma, weighs 0.95^2 / ln(f)^2 witnesses: of two 2, of 1.4 8.
    """
    return float(max(asked, 1e-300) ** (n_witnesses / (n_witnesses + held_by)))
