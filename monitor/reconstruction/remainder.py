"""What a fit does not follow: how far its height moves with the next order of the surface where its points end.

In: a patch and the influence of its points on the height, as `fit_patch` makes them. Out: a moment, in units of the
radius to its order, root mean square over all directions that a wave of the surface may have: of a dome or a saddle,
which bend two ways, it is right in the mean only. A quadric fit in the middle of its points errs by the fourth order,
at a rim by the third, which is more (Fan & Gijbels 1996, 3.2.5); a plane errs by the second.
"""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.reconstruction.quadric import COUNT, SPREAD_UU, SPREAD_UV, SPREAD_VV, U, V
from projects.model import Floats


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def third_moment(patch: Floats, n: int, influence: Floats) -> float:
    """How far the height of a fit to the first n groups moves per third derivative of the surface, in radii cubed."""
    m30 = m21 = m12 = m03 = 0.0
    for i in range(np.uint64(n)):
        u, v, of_all = patch[U, i], patch[V, i], patch[COUNT, i] * influence[i]
        uu, uv, vv = patch[SPREAD_UU, i], patch[SPREAD_UV, i], patch[SPREAD_VV, i]
        m30 += of_all * u * (u * u + 3.0 * uu)
        m21 += of_all * (v * (u * u + uu) + 2.0 * u * uv)
        m12 += of_all * (u * (v * v + vv) + 2.0 * v * uv)
        m03 += of_all * v * (v * v + 3.0 * vv)
    square = 5.0 * (m30 * m30 + m03 * m03) + 9.0 * (m21 * m21 + m12 * m12) + 6.0 * (m30 * m12 + m21 * m03)
    return np.sqrt(max(square, 0.0) / 16.0) / 6.0


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def second_moment(patch: Floats, n: int, influence: Floats) -> float:
    """How far the height of a plane through the first n groups moves per second derivative, in radii squared."""
    m20 = m11 = m02 = 0.0
    for i in range(np.uint64(n)):
        u, v, of_all = patch[U, i], patch[V, i], patch[COUNT, i] * influence[i]
        m20 += of_all * (u * u + patch[SPREAD_UU, i])
        m11 += of_all * (u * v + patch[SPREAD_UV, i])
        m02 += of_all * (v * v + patch[SPREAD_VV, i])
    square = 3.0 * (m20 * m20 + m02 * m02) + 4.0 * m11 * m11 + 2.0 * m20 * m02
    return np.sqrt(max(square, 0.0) / 8.0) / 2.0


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def off_middle(patch: Floats, n: int, span: float) -> float:
    """How far the middle of the points within a share of the radius lies off the middle of that disc, in its radii."""
    total = su = sv = 0.0
    for i in range(np.uint64(n)):
        u, v = patch[U, i], patch[V, i]
        count = patch[COUNT, i] if u * u + v * v < span * span else 0.0
        total += count
        su += count * u
        sv += count * v
    return np.sqrt(su * su + sv * sv) / (max(total, 1.0) * span)
