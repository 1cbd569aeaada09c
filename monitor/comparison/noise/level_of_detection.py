"""The smallest change that differs from zero at 95 %, per vertex: surfaces, registration, and what is left over.

lod95 = 1.96 sqrt(f^2 (a^2 (sigma_vertex^2 + sigma_foot^2) + c^2 sigma_discord^2 + b^2 sigma_shared^2 + floor^2)
+ limb^2 + n' J C J' n). The discord is what neighbouring fits of each surface contradict each other by; the shared part
is what the scans of each epoch disagree by and how well they are placed; of what an epoch saw only steeply, what is
beyond the usual of it, the limb, counts as stated (`sight.limbs`). The stable areas give a, b, c and the floor
(`error_parts`): where they show less than is stated, since part of the errors is the same in both epochs and falls out,
a, b and c are below 1; where they show more of all of the surface (unmodelled scanner errors), there is a floor. And
they give f, which is above 1 in one kind of place (grazing views, small relief sampled differently): see `noise`,
`strata`.
"""

from __future__ import annotations

import numpy as np
from numba import jit
from scipy.stats import norm

from monitor.boxes import box_of
from monitor.comparison.distances.quantile import between, quantile
from projects.errors import ParameterError
from projects.model import Z95, Floats, Ints

N_FLOOR = 200_000  # stable vertices that a floor is estimated from, at even steps


def level_of_detection(sigma_surfaces: Floats, sigma_common: Floats, floor: Floats | float) -> Floats:
    """Return lod95 [m] of independent parts, all one sigma in metres."""
    return Z95 * np.sqrt(sigma_surfaces**2 + sigma_common**2 + np.square(floor))


def lague_lod95(spread_reference: Floats, n_reference: Floats | Ints, spread_compared: Floats,
                n_compared: Floats | Ints, registration_error: float) -> Floats:  # fmt: skip
    """Return Lague's level of detection [m], the registration error added linearly, as other programs have it.

    Raises `ParameterError` where a spread [m], a number of points or the error [m] is negative; NaN is unknown.

    References
    ----------
    Lague, Brodu and Leroux (2013), Eq. (1): 1.96 (sqrt(s1^2 / n1 + s2^2 / n2) + reg).
    """
    _require_none_negative(spread_reference=spread_reference, n_reference=n_reference, spread_compared=spread_compared,
                           n_compared=n_compared, registration_error=registration_error)  # fmt: skip
    sampling2 = np.square(spread_reference) / n_reference + np.square(spread_compared) / n_compared
    return 1.96 * (np.sqrt(sampling2) + registration_error)


def _require_none_negative(**given: Floats | Ints | float) -> None:
    """Raise `ParameterError` for values of which any is negative."""
    for name, values in given.items():
        least = float(np.nanmin(values, initial=0.0))
        if least < 0.0:
            raise ParameterError(f"{name} = {least:.6g}: 0 or more is allowed, NaN where it is not known")


def far_levels(n_vertices: int, level: float) -> float:
    """Return how many levels of detection the farthest of so many vertices lies off zero by chance, in a share `level`
    of all surfaces, however their errors agree (Bonferroni)."""
    return float(norm.isf(0.5 * level / max(n_vertices, 1)) / Z95)


def estimate_floor(distances: Floats, sigma: Floats, share: float = 0.95) -> float:
    """Return the floor [m] with which `share` of the stable distances lie where a normal error would put them.

    Parameters
    ----------
    distances : (n,) m, of vertices held stable.
    sigma : (n,) m, what is stated of each.
    share : 0.95 sets the level itself; 0.6827 only looks at the core, for vertices that no one vouches for.

    Notes
    -----
    Solves: the `share` quantile of |d| / sqrt(sigma^2 + floor^2) = z(share), by bisection; 0 where the stated noise
    is enough.
    """
    step = max(len(distances) // N_FLOOR, 1)
    size, sigma2 = np.abs(distances[::step]), sigma[::step] ** 2
    if not len(size):
        return 0.0
    z = float(norm.ppf(0.5 + 0.5 * share))
    low, high = 0.0, quantile(size, share) / z  # with this floor alone the quantile would be met
    if not _exceed(size, np.maximum(sigma2, 1e-300), 0.0, share, z):
        return 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        too_small = _exceed(size, sigma2, middle**2, share, z)
        low, high = (middle, high) if too_small else (low, middle)
    return high


@jit(nopython=True, cache=True)
def _exceed(size, sigma2, floor2, share, z):  # type: ignore[no-untyped-def]
    """Whether the `share` quantile of size / sqrt(sigma2 + floor2) is above z."""
    place = (len(size) - 1) * share
    rank, n_upto, below, above = np.int64(np.floor(place)), 0, -np.inf, np.inf
    for i in range(len(size)):
        ratio = size[i] / np.sqrt(sigma2[i] + floor2)
        if ratio <= z:
            n_upto += 1
            below = max(below, ratio)
        else:
            above = min(above, ratio)
    if n_upto != rank + 1 or n_upto == len(size):  # both numbers of the quantile lie on one side of z
        return n_upto <= rank
    return between(below, above, place - rank) > z


def least_floor(points: Floats) -> float:
    """Return the distance [m] below which coordinates themselves are not resolved: 16 roundings of the largest."""
    return 16.0 * float(np.finfo(np.float64).eps) * (float(np.abs(box_of(points)).max()) if len(points) else 0.0)
