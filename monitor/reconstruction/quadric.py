"""Robust local fit of a plane or curved patch to the points, or groups of points, around a vertex.

In: groups in the vertex's frame (u, v along the surface, z along its normal), in units of the radius, with the spread
of their points. Out: height of the patch over the vertex, its slope, its standard error and the scatter of the
points. The patch is z = c0 + c1 u + c2 v + Q + Q |grad Q|^2 / 4 with Q its quadratic part: it follows spheres and
cylinders to fourth order without a further unknown. Noise along the normals of a curved surface thins out the points
that lie outside of it, by 1 - 2 e / R on a sphere, so that a regression of heights is low by sigma^2 (k1 + k2); this
is taken off.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

from projects.model import Floats

PASSES = 2, 3  # by degree: least squares, with the fourth order, without outliers
MORE_PASSES = 2  # where there are outliers, which had moved the fit that told them
CUT = 6.0  # in sigmas, of a single point; wide, so that clean noise loses under 1 % and only outliers are left out
NO_CUT = 1e30  # a variance beside which every residual is small
U, V, Z, COUNT, SPREAD_UU, SPREAD_UV, SPREAD_VV, SPREAD_UZ, SPREAD_VZ, SPREAD_ZZ = range(10)
HEIGHT, SLOPE_U, SLOPE_V, UNIT_ERROR, SIGMA, EFFECTIVE, BEND = range(7)


@jit(nopython=True, cache=True)
def solve_spd(matrix: Floats, rhs: Floats, m: int) -> bool:
    """Solve in place by Cholesky for two right-hand sides (m, 2); False where the system is singular."""
    for i in range(m):
        for j in range(i + 1):
            s = matrix[i, j]
            for k in range(j):
                s -= matrix[i, k] * matrix[j, k]
            if i == j:
                if s <= 1e-10:
                    return False
                matrix[i, i] = np.sqrt(s)
            else:
                matrix[i, j] = s / matrix[j, j]
    for r in range(rhs.shape[1]):
        for i in range(m):
            for k in range(i):
                rhs[i, r] -= matrix[i, k] * rhs[k, r]
            rhs[i, r] /= matrix[i, i]
        for i in range(m - 1, -1, -1):
            for k in range(i + 1, m):
                rhs[i, r] -= matrix[k, i] * rhs[k, r]
            rhs[i, r] /= matrix[i, i]
    return True


# Sums over a neighbourhood may be taken in vector order: it is fixed when compiling, hence the same for any threads.
@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def residuals(patch: Floats, n: int, c: Floats, heights: Floats, squares: Floats) -> None:
    """Heights less the fourth order of patch `c` and their covariance with u and v, (3, n); mean squared residuals."""
    c0, c1, c2, c3, c4, c5 = c[0], c[1], c[2], c[3], c[4], c[5]
    for i in range(n):
        u, v = patch[U, i], patch[V, i]
        uu, uv, vv = patch[SPREAD_UU, i], patch[SPREAD_UV, i], patch[SPREAD_VV, i]
        bend_u, bend_v = 2.0 * c3 * u + c4 * v, c4 * u + 2.0 * c5 * v
        bend2, twice = bend_u * bend_u + bend_v * bend_v, bend_u * u + bend_v * v
        rise_u = 0.25 * (bend_u * bend2 + twice * (2.0 * c3 * bend_u + c4 * bend_v))
        rise_v = 0.25 * (bend_v * bend2 + twice * (c4 * bend_u + 2.0 * c5 * bend_v))
        height = patch[Z, i] - 0.125 * twice * bend2
        r = height - (c0 + c1 * u + c2 * v + c3 * (u * u + uu) + c4 * (u * v + uv) + c5 * (v * v + vv))
        su, sv = c1 + bend_u, c2 + bend_v
        within = (patch[SPREAD_ZZ, i] - 2.0 * (su * patch[SPREAD_UZ, i] + sv * patch[SPREAD_VZ, i])
                  + su * su * uu + 2.0 * su * sv * uv + sv * sv * vv)  # fmt: skip
        heights[0, i] = height
        heights[1, i] = patch[SPREAD_UZ, i] - rise_u * uu - rise_v * uv
        heights[2, i] = patch[SPREAD_VZ, i] - rise_u * uv - rise_v * vv
        squares[i] = (r * r + within) / (1.0 + su * su + sv * sv)


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def weigh(patch: Floats, n: int, span2: float, squares: Floats, scale2: float, weights: Floats) -> float:
    """Weights (2, n): of each group, its points times the mean of max(1 - t^2, 0), and how that follows 1 - t^2.

    At the rim a group is taken to lie evenly across it. Less weight where the mean square is more than noise explains:
    an outlier of 6 sigma among m points adds 36 / m to it, chance alone sqrt(2 / m). Returns how many groups are left
    out altogether.
    """
    n_cut = 0.0
    for i in range(n):
        count, u, v = patch[COUNT, i], patch[U, i], patch[V, i]
        suu, suv, svv = patch[SPREAD_UU, i], patch[SPREAD_UV, i], patch[SPREAD_VV, i]
        inside = 1.0 - (u * u + v * v + suu + svv) / span2
        half = np.sqrt(max(12.0 * (u * u * suu + 2.0 * u * v * suv + v * v * svv), 0.0)) / span2 + 1e-12
        share = min(max((inside + half) / (2.0 * half), 0.0), 1.0)
        beyond = squares[i] / scale2 - (1.0 - 1.0 / count)
        ratio = max(beyond, 0.0) / max(CUT * CUT / count, CUT * np.sqrt(2.0 / count))
        less = max(1.0 - ratio * ratio, 0.0)
        weights[1, i] = count * less * less * share
        weights[0, i] = count * less * less * (inside if inside > half else share * share * half)
        n_cut += 1.0 if share > 0.0 and less <= 0.0 else 0.0
    return n_cut


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def plane_equations(
    patch: Floats, n: int, span2: float, heights: Floats, weights: Floats, a: Floats, rhs: Floats
) -> None:
    """Fill normal matrix and right-hand side of a plane.

    They are sums over points: within a group, products of the means and what covariances add, also those with the
    weight 1 - t^2. Without the latter, noise along the normals of a curved surface, which moves points along it too,
    would thin out otherwise than `fit_patch` takes off.
    """
    s0 = s1 = s2 = s11 = s12 = s22 = h0 = h1 = h2 = 0.0
    for i in range(n):
        u, v, w, h, hu, hv = patch[U, i], patch[V, i], weights[0, i], heights[0, i], heights[1, i], heights[2, i]
        suu, suv, svv = patch[SPREAD_UU, i], patch[SPREAD_UV, i], patch[SPREAD_VV, i]
        down = -2.0 * weights[1, i] / span2
        e1, e2, eh = down * (u * suu + v * suv), down * (u * suv + v * svv), down * (u * hu + v * hv)
        p1, p2 = w * u + e1, w * v + e2
        s0 += w
        s1 += p1
        s2 += p2
        s11 += p1 * u + u * e1 + w * suu
        s12 += p1 * v + u * e2 + w * suv
        s22 += p2 * v + v * e2 + w * svv
        h0 += w * h + eh
        h1 += p1 * h + u * eh + w * hu
        h2 += p2 * h + v * eh + w * hv
    a[0, 0], a[1, 0], a[1, 1], a[2, 0], a[2, 1], a[2, 2] = s0, s1, s11, s2, s12, s22
    rhs[0, 0], rhs[1, 0], rhs[2, 0] = h0, h1, h2


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def curved_equations(
    patch: Floats, n: int, span2: float, heights: Floats, weights: Floats, a: Floats, rhs: Floats
) -> None:
    """Fill normal matrix and right-hand side of a curved patch; see `plane_equations`."""
    plane_equations(patch, n, span2, heights, weights, a, rhs)
    s30 = s31 = s32 = s33 = s40 = s41 = s42 = s43 = s44 = 0.0
    s50 = s51 = s52 = s53 = s54 = s55 = h3 = h4 = h5 = 0.0
    for i in range(n):
        u, v, w, h, hu, hv = patch[U, i], patch[V, i], weights[0, i], heights[0, i], heights[1, i], heights[2, i]
        suu, suv, svv = patch[SPREAD_UU, i], patch[SPREAD_UV, i], patch[SPREAD_VV, i]
        uu, uv, vv, u2, v2 = u * u + suu, u * v + suv, v * v + svv, 2.0 * u, 2.0 * v
        k31, k32, k41, k42, k51, k52 = u2 * suu, u2 * suv, v * suu + u * suv, v * suv + u * svv, v2 * suv, v2 * svv
        down = -2.0 * weights[1, i] / span2
        e1, e2, eh = down * (u * suu + v * suv), down * (u * suv + v * svv), down * (u * hu + v * hv)
        e3, e4, e5 = down * (u * k31 + v * k32), down * (u * k41 + v * k42), down * (u * k51 + v * k52)
        p3, p4, p5 = w * uu + e3, w * uv + e4, w * vv + e5
        s30 += p3
        s31 += p3 * u + uu * e1 + w * k31
        s32 += p3 * v + uu * e2 + w * k32
        s33 += p3 * uu + uu * e3 + w * u2 * k31
        s40 += p4
        s41 += p4 * u + uv * e1 + w * k41
        s42 += p4 * v + uv * e2 + w * k42
        s43 += p4 * uu + uv * e3 + w * u2 * k41
        s44 += p4 * uv + uv * e4 + w * (v * k41 + u * k42)
        s50 += p5
        s51 += p5 * u + vv * e1 + w * k51
        s52 += p5 * v + vv * e2 + w * k52
        s53 += p5 * uu + vv * e3 + w * u2 * k51
        s54 += p5 * uv + vv * e4 + w * v2 * k42
        s55 += p5 * vv + vv * e5 + w * v2 * k52
        h3 += p3 * h + uu * eh + w * u2 * hu
        h4 += p4 * h + uv * eh + w * (v * hu + u * hv)
        h5 += p5 * h + vv * eh + w * v2 * hv
    a[3, 0], a[3, 1], a[3, 2], a[3, 3] = s30, s31, s32, s33
    a[4, 0], a[4, 1], a[4, 2], a[4, 3], a[4, 4] = s40, s41, s42, s43, s44
    a[5, 0], a[5, 1], a[5, 2], a[5, 3], a[5, 4], a[5, 5] = s50, s51, s52, s53, s54, s55
    rhs[3, 0], rhs[4, 0], rhs[5, 0] = h3, h4, h5


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def sum_up(patch: Floats, n: int, g: Floats, squares: Floats, weights: Floats, influence: Floats) -> Any:
    """Influence (n,) of each point of a group; sums of weights, their squares a point, squares, squared influences."""
    total, weights2, misfit2, variance = 0.0, 0.0, 0.0, 0.0
    g0, g1, g2, g3, g4, g5 = g[0], g[1], g[2], g[3], g[4], g[5]
    for i in range(n):
        u, v, w, count = patch[U, i], patch[V, i], weights[0, i], patch[COUNT, i]
        uu, uv, vv = u * u + patch[SPREAD_UU, i], u * v + patch[SPREAD_UV, i], v * v + patch[SPREAD_VV, i]
        one = w / count * (g0 + g1 * u + g2 * v + g3 * uu + g4 * uv + g5 * vv)
        influence[i] = one
        total += w
        weights2 += w * w / count
        misfit2 += w * squares[i]
        variance += count * one * one
    return total, weights2, misfit2, variance


@jit(nopython=True, cache=True)
def robust_scale2(patch: Floats, n: int, span2: float, squares: Floats, m: int, buffer: Floats) -> float:
    """Variance of a point from the median of the groups' mean squares; -1 where they are too few for m unknowns."""
    used = 0
    for i in range(n):
        if patch[U, i] * patch[U, i] + patch[V, i] * patch[V, i] < span2:
            median_of_mean = (1.0 - 2.0 / (9.0 * patch[COUNT, i])) ** 3  # of chi2 over its degrees (Wilson & Hilferty)
            buffer[used] = squares[i] / median_of_mean
            used += 1
    if used < m + 4:
        return -1.0
    return max(float(np.median(buffer[:used])) * used / (used - m), 1e-18)


@jit(nopython=True, cache=True)
def fit_patch(
    patch: Floats, n: int, radius: float, span: float, degree: int, work: Any, out: Floats, influence: Floats
) -> bool:
    """Fit a plane (`degree` 1) or curved patch (2) to the first n groups of `patch`; False where it cannot be.

    `patch` (10, n) is in units of `radius` (m), of which the fit takes the share `span`. `out` receives height, slope
    along u, slope along v, standard error per unit sigma, sigma, effective number, and the sum of the slopes that both
    curvatures make at the rim. `influence[i]` is how far the height moves with a point of group i: the heights of two
    fits to the same groups differ by sigma * |influence - influence'|. `work` is as of `fit_room`.
    """
    c, a, rhs, heights, squares, weights, buffer = work
    m, span2, scale2 = (3 if degree == 1 else 6), span * span, NO_CUT
    c[:] = 0.0
    n_cut, k, last = 0.0, 0, PASSES[degree - 1] - 1
    while k <= last or (n_cut > 0.0 and k <= last + MORE_PASSES):
        residuals(patch, n, c, heights, squares)
        if k >= last:
            scale2 = robust_scale2(patch, n, span2, squares, m, buffer)
            if scale2 < 0.0:
                return False
        n_cut = weigh(patch, n, span2, squares, scale2, weights)
        rhs[:, 1] = 0.0
        rhs[0, 1] = 1.0
        if degree == 1:
            plane_equations(patch, n, span2, heights, weights, a, rhs)
        else:
            curved_equations(patch, n, span2, heights, weights, a, rhs)
            if k >= last:
                rhs[3, 1] = rhs[5, 1] = -2.0 * scale2
        if not a[0, 0] > 0.0 or not solve_spd(a, rhs, m):
            return False
        c[:m] = rhs[:m, 0]
        k += 1
    rhs[m:, 1] = 0.0
    total, weights2, misfit2, variance = sum_up(patch, n, rhs[:, 1], squares, weights, influence)
    effective = total * total / weights2
    sigma2 = misfit2 / total * effective / max(effective - m, 1.0)
    thinned = 2.0 * sigma2 * (c[3] + c[5])
    out[HEIGHT], out[SLOPE_U], out[SLOPE_V] = (c[0] - thinned) * radius, c[1], c[2]
    out[UNIT_ERROR], out[SIGMA], out[EFFECTIVE] = np.sqrt(variance), np.sqrt(max(sigma2, 0.0)) * radius, effective
    out[BEND] = 2.0 * (c[3] + c[5]) * span
    return True


@jit(nopython=True, cache=True)
def fit_room(n: int) -> Any:
    """Room for `fit_patch` with up to n groups."""
    return (
        np.empty(6),
        np.empty((6, 6)),
        np.empty((6, 2)),
        np.empty((3, n)),
        np.empty(n),
        np.empty((2, n)),
        np.empty(n),
    )
