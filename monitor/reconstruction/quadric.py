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

MOST_PASSES = 3  # against outliers: again where there are any, which had moved the fit that told them
FAR = 1e300  # of what counts as infinitely far
CUT = 6.0  # in sigmas, of a single point; wide, so that clean noise loses under 1 % and only outliers are left out
U, V, Z, COUNT, SPREAD_UU, SPREAD_UV, SPREAD_VV, SPREAD_UZ, SPREAD_VZ, SPREAD_ZZ = range(10)
PLANE, CURVED = np.int64(1), np.int64(2)  # degrees; kernels are compiled anew for each integer written out in a call
HEIGHT, SLOPE_U, SLOPE_V, UNIT_ERROR, SIGMA, EFFECTIVE, BEND = range(7)


@jit(nopython=True, cache=True)
def factorise(matrix: Floats, m: int) -> bool:
    """Cholesky in place of the lower triangle (m, m), its diagonal inverted; False where the system is singular."""
    for i in range(m):
        for j in range(i + 1):
            s = matrix[i, j]
            for k in range(j):
                s -= matrix[i, k] * matrix[j, k]
            if i == j:
                if s <= 1e-10:
                    return False
                matrix[i, i] = 1.0 / np.sqrt(s)
            else:
                matrix[i, j] = s * matrix[j, j]
    return True


@jit(nopython=True, cache=True)
def substitute(factor: Floats, rhs: Floats, m: int) -> None:
    """Solve in place for the right-hand side (m,), by what `factorise` made."""
    for i in range(m):
        for k in range(i):
            rhs[i] -= factor[i, k] * rhs[k]
        rhs[i] *= factor[i, i]
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            rhs[i] -= factor[k, i] * rhs[k]
        rhs[i] *= factor[i, i]


# Sums over a neighbourhood may be taken in vector order: it is fixed when compiling, hence the same for any threads.
# Groups are counted by unsigned numbers, which index without a look whether they count from the end: or else compilers
# gather each group by itself.
@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def flatten(patch: Floats, n: int, c: Floats, heights: Floats) -> None:
    """Heights less the fourth order of patch `c`, and their covariance with u and v, (3, n)."""
    c3, c4, c5 = c[3], c[4], c[5]
    for i in range(np.uint64(n)):
        u, v = patch[U, i], patch[V, i]
        uu, uv, vv = patch[SPREAD_UU, i], patch[SPREAD_UV, i], patch[SPREAD_VV, i]
        bend_u, bend_v = 2.0 * c3 * u + c4 * v, c4 * u + 2.0 * c5 * v
        bend2, twice = bend_u * bend_u + bend_v * bend_v, bend_u * u + bend_v * v
        rise_u = 0.25 * (bend_u * bend2 + twice * (2.0 * c3 * bend_u + c4 * bend_v))
        rise_v = 0.25 * (bend_v * bend2 + twice * (c4 * bend_u + 2.0 * c5 * bend_v))
        heights[0, i] = patch[Z, i] - 0.125 * twice * bend2
        heights[1, i] = patch[SPREAD_UZ, i] - rise_u * uu - rise_v * uv
        heights[2, i] = patch[SPREAD_VZ, i] - rise_u * uv - rise_v * vv


@jit(nopython=True, cache=True)
def copy_heights(patch: Floats, n: int, heights: Floats) -> None:
    """Heights and their covariance with u and v, (3, n), as `flatten` makes them of a plane."""
    for i in range(np.uint64(n)):
        heights[0, i], heights[1, i], heights[2, i] = patch[Z, i], patch[SPREAD_UZ, i], patch[SPREAD_VZ, i]


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def mean_squares(patch: Floats, n: int, c: Floats, heights: Floats, squares: Floats) -> None:
    """Mean squared residuals (n,) of each group's points across patch `c`."""
    c0, c1, c2, c3, c4, c5 = c[0], c[1], c[2], c[3], c[4], c[5]
    for i in range(np.uint64(n)):
        u, v = patch[U, i], patch[V, i]
        uu, uv, vv = patch[SPREAD_UU, i], patch[SPREAD_UV, i], patch[SPREAD_VV, i]
        r = heights[0, i] - (c0 + c1 * u + c2 * v + c3 * (u * u + uu) + c4 * (u * v + uv) + c5 * (v * v + vv))
        su, sv = c1 + 2.0 * c3 * u + c4 * v, c2 + c4 * u + 2.0 * c5 * v
        within = (patch[SPREAD_ZZ, i] - 2.0 * (su * patch[SPREAD_UZ, i] + sv * patch[SPREAD_VZ, i])
                  + su * su * uu + 2.0 * su * sv * uv + sv * sv * vv)  # fmt: skip
        squares[i] = (r * r + within) / (1.0 + su * su + sv * sv)


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def place_weights(patch: Floats, n: int, per2: float, along2: float, weights: Floats) -> None:
    """Weights (2, n) by place: points of each group times the mean of max(1 - t^2, 0), and how that follows 1 - t^2.

    The square t^2 is that of the distance over the span. At the rim a group is taken to lie evenly across it: with the
    share s inside, max(1 - t^2, 0) has the mean s^2 times half the group's width, and s^2 (3 - 2 s) of the covariance
    with place that it would have all inside.
    """
    for i in range(np.uint64(n)):
        count, u, v = patch[COUNT, i], patch[U, i], patch[V, i]
        suu, suv, svv = patch[SPREAD_UU, i], patch[SPREAD_UV, i], patch[SPREAD_VV, i]
        pu, qv = along2 * u, per2 * v
        inside = 1.0 - (pu * u + qv * v + along2 * suu + per2 * svv)
        half = np.sqrt(max(12.0 * (pu * pu * suu + 2.0 * pu * qv * suv + qv * qv * svv), 0.0)) + 1e-12
        share = min(max((inside + half) / (2.0 * half), 0.0), 1.0)
        weights[0, i] = count * (inside if inside > half else share * share * half)
        weights[1, i] = count * share * share * (3.0 - 2.0 * share)


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def weigh(patch: Floats, n: int, placed: Floats, squares: Floats, scale2: float, weights: Floats) -> float:
    """Weights (2, n) of place, less where the mean square is more than noise explains.

    An outlier of 6 sigma among m points adds 36 / m to it, chance alone sqrt(2 / m). Returns how many groups are left
    out altogether.
    """
    n_cut, per = 0.0, 1.0 / scale2
    for i in range(np.uint64(n)):
        count = patch[COUNT, i]
        beyond = squares[i] * per - (1.0 - 1.0 / count)
        ratio = max(beyond, 0.0) * min(count / (CUT * CUT), np.sqrt(0.5 * count) / CUT)
        less = max(1.0 - ratio * ratio, 0.0)
        weights[0, i] = less * less * placed[0, i]
        weights[1, i] = less * less * placed[1, i]
        n_cut += 1.0 if placed[1, i] > 0.0 and less <= 0.0 else 0.0
    return n_cut


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def plane_matrix(patch: Floats, n: int, per2: float, along2: float, weights: Floats, a: Floats) -> None:
    """Fill the normal matrix of a plane.

    Its sums are over points: within a group, products of the means and what covariances add, also those with the
    weight 1 - t^2. Without the latter, noise along the normals of a curved surface, which moves points along it too,
    would thin out otherwise than `fit_patch` takes off.
    """
    s0 = s1 = s2 = s11 = s12 = s22 = 0.0
    for i in range(np.uint64(n)):
        u, v, w = patch[U, i], patch[V, i], weights[0, i]
        suu, suv, svv = patch[SPREAD_UU, i], patch[SPREAD_UV, i], patch[SPREAD_VV, i]
        du, dv = -2.0 * along2 * weights[1, i] * u, -2.0 * per2 * weights[1, i] * v
        e1, e2 = du * suu + dv * suv, du * suv + dv * svv
        p1, p2 = w * u + e1, w * v + e2
        s0 += w
        s1 += p1
        s2 += p2
        s11 += p1 * u + u * e1 + w * suu
        s12 += p1 * v + u * e2 + w * suv
        s22 += p2 * v + v * e2 + w * svv
    a[0, 0], a[1, 0], a[1, 1], a[2, 0], a[2, 1], a[2, 2] = s0, s1, s11, s2, s12, s22


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def curved_matrix(patch: Floats, n: int, per2: float, along2: float, weights: Floats, a: Floats) -> None:
    """Fill the normal matrix of a curved patch; see `plane_matrix`."""
    plane_matrix(patch, n, per2, along2, weights, a)
    a[3, 0], a[4, 0], a[5, 0] = a[1, 1], a[2, 1], a[2, 2]  # products with 1 of uu, uv, vv
    s31 = s32 = s33 = s41 = s42 = s43 = s44 = s51 = s52 = s53 = s54 = s55 = 0.0
    for i in range(np.uint64(n)):
        u, v, w = patch[U, i], patch[V, i], weights[0, i]
        suu, suv, svv = patch[SPREAD_UU, i], patch[SPREAD_UV, i], patch[SPREAD_VV, i]
        uu, uv, vv, u2, v2 = u * u + suu, u * v + suv, v * v + svv, 2.0 * u, 2.0 * v
        k31, k32, k41, k42, k51, k52 = u2 * suu, u2 * suv, v * suu + u * suv, v * suv + u * svv, v2 * suv, v2 * svv
        du, dv = -2.0 * along2 * weights[1, i] * u, -2.0 * per2 * weights[1, i] * v
        e1, e2 = du * suu + dv * suv, du * suv + dv * svv
        e3, e4, e5 = du * k31 + dv * k32, du * k41 + dv * k42, du * k51 + dv * k52
        p3, p4, p5 = w * uu + e3, w * uv + e4, w * vv + e5
        s31 += p3 * u + uu * e1 + w * k31
        s32 += p3 * v + uu * e2 + w * k32
        s33 += p3 * uu + uu * e3 + w * u2 * k31
        s41 += p4 * u + uv * e1 + w * k41
        s42 += p4 * v + uv * e2 + w * k42
        s43 += p4 * uu + uv * e3 + w * u2 * k41
        s44 += p4 * uv + uv * e4 + w * (v * k41 + u * k42)
        s51 += p5 * u + vv * e1 + w * k51
        s52 += p5 * v + vv * e2 + w * k52
        s53 += p5 * uu + vv * e3 + w * u2 * k51
        s54 += p5 * uv + vv * e4 + w * v2 * k42
        s55 += p5 * vv + vv * e5 + w * v2 * k52
    a[3, 1], a[3, 2], a[3, 3] = s31, s32, s33
    a[4, 1], a[4, 2], a[4, 3], a[4, 4] = s41, s42, s43, s44
    a[5, 1], a[5, 2], a[5, 3], a[5, 4], a[5, 5] = s51, s52, s53, s54, s55


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def right_side(
    patch: Floats, n: int, per2: float, along2: float, heights: Floats, weights: Floats, rhs: Floats
) -> None:
    """Fill the right-hand side (6,) of a curved patch, its first three of a plane too; see `plane_matrix`."""
    h0 = h1 = h2 = h3 = h4 = h5 = 0.0
    for i in range(np.uint64(n)):
        u, v, w, h, hu, hv = patch[U, i], patch[V, i], weights[0, i], heights[0, i], heights[1, i], heights[2, i]
        suu, suv, svv = patch[SPREAD_UU, i], patch[SPREAD_UV, i], patch[SPREAD_VV, i]
        uu, uv, vv, u2, v2 = u * u + suu, u * v + suv, v * v + svv, 2.0 * u, 2.0 * v
        du, dv = -2.0 * along2 * weights[1, i], -2.0 * per2 * weights[1, i]
        du, dv = du * u, dv * v
        e1, e2, eh = du * suu + dv * suv, du * suv + dv * svv, du * hu + dv * hv
        e4 = v * e1 + u * e2
        h0 += w * h + eh
        h1 += (w * u + e1) * h + u * eh + w * hu
        h2 += (w * v + e2) * h + v * eh + w * hv
        h3 += (w * uu + u2 * e1) * h + uu * eh + w * u2 * hu
        h4 += (w * uv + e4) * h + uv * eh + w * (v * hu + u * hv)
        h5 += (w * vv + v2 * e2) * h + vv * eh + w * v2 * hv
    rhs[0], rhs[1], rhs[2], rhs[3], rhs[4], rhs[5] = h0, h1, h2, h3, h4, h5


@jit(nopython=True, cache=True, fastmath=True, error_model="numpy")
def sum_up(
    patch: Floats, n: int, per2: float, along2: float, g: Floats, squares: Floats, weights: Floats, influence: Floats
) -> Any:
    """Influence (n,) of each point of a group; sums of weights, their squares a point, squares, squared influences.

    The influence is that of a group's middle; in the last sum goes how it changes across the group's points too.
    """
    total, weights2, misfit2, variance = 0.0, 0.0, 0.0, 0.0
    g0, g1, g2, g3, g4, g5 = g[0], g[1], g[2], g[3], g[4], g[5]
    for i in range(np.uint64(n)):
        u, v, w, count = patch[U, i], patch[V, i], weights[0, i], patch[COUNT, i]
        suu, suv, svv = patch[SPREAD_UU, i], patch[SPREAD_UV, i], patch[SPREAD_VV, i]
        height = g0 + g1 * u + g2 * v + g3 * (u * u + suu) + g4 * (u * v + suv) + g5 * (v * v + svv)
        steeper = -2.0 * weights[1, i] * height
        du = steeper * along2 * u + w * (g1 + 2.0 * g3 * u + g4 * v)
        dv = steeper * per2 * v + w * (g2 + g4 * u + 2.0 * g5 * v)
        one = w / count * height
        influence[i] = one
        total += w
        weights2 += w * w / count
        misfit2 += w * squares[i]
        variance += count * one * one + (du * du * suu + 2.0 * du * dv * suv + dv * dv * svv) / count
    return total, weights2, misfit2, variance


@jit(nopython=True, cache=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def medians_of_groups(patch: Floats, n: int, per2: float, along2: float, squares: Floats, buffer: Floats) -> Any:
    """Mean squares (n,) of groups within the span over the median of such means, `FAR` beyond: number and mean."""
    used, total = 0.0, 0.0
    for i in range(np.uint64(n)):
        u, v, nine = patch[U, i], patch[V, i], 9.0 * patch[COUNT, i]
        more = nine / (nine - 2.0)
        one = squares[i] * (more * more * more)  # of chi2 over its degrees (Wilson & Hilferty)
        inside = 1.0 if along2 * u * u + per2 * v * v < 1.0 else 0.0
        buffer[i] = max(one, (1.0 - inside) * FAR)  # no branch, or compilers take each group by itself
        used += inside
        total += inside * one
    return used, total / max(used, 1.0)


@jit(nopython=True, cache=True, fastmath={"reassoc"}, error_model="numpy")
def count_below(values: Floats, n: int, limit: float) -> float:
    """How many of n values lie below a limit."""
    below = 0.0
    for i in range(np.uint64(n)):
        below += 1.0 if values[i] < limit else 0.0
    return below


@jit(nopython=True, cache=True, fastmath={"reassoc"}, error_model="numpy")
def mean_between(values: Floats, n: int, low: float, high: float) -> float:
    """Mean of those of n values from `low` to below `high`; the middle between both where there is none."""
    count = total = 0.0
    for i in range(np.uint64(n)):
        one = 1.0 if (values[i] >= low) & (values[i] < high) else 0.0
        count += one
        total += one * values[i]
    return total / count if count > 0.0 else 0.5 * (low + high)


@jit(nopython=True, cache=True, error_model="numpy")
def median(values: Floats, n: int, used: float, mean: float) -> float:
    """Median, to two in a hundred, of the `used` of n positive values that are not `FAR`, with that mean.

    By halves of what it may be, up to twice the mean: to count what lies below is quicker than to sort. Of an even
    number it lies between both in the middle.
    """
    low, high = 0.0, 2.0 * mean
    while high - low > 0.02 * high and high > 1e-18:
        middle = 0.5 * (low + high)
        below = count_below(values, n, middle)
        if 2.0 * below == used:
            return middle
        if 2.0 * below < used:
            low = middle
        else:
            high = middle
    return mean_between(values, n, low, high)


@jit(nopython=True, cache=True)
def robust_scale2(patch: Floats, n: int, per2: float, along2: float, squares: Floats, m: int, buffer: Floats) -> float:
    """Variance of a point from the median of the groups' mean squares; -1 where they are too few for m unknowns."""
    used, mean = medians_of_groups(patch, n, per2, along2, squares, buffer)
    if used < m + 4:
        return -1.0
    if not mean > 1e-18:
        return 1e-18
    return max(median(buffer, n, used, mean) * used / (used - m), 1e-18)


@jit(nopython=True, cache=True)
def fit_patch(
    patch: Floats, n: int, radius: float, span: float, stretch: float, degree: int, work: Any, out: Floats,
    influence: Floats,
) -> bool:  # fmt: skip
    """Fit a plane (`degree` 1) or curved patch (2) to the first n groups of `patch`; False where it cannot be.

    `patch` (10, n) is in units of `radius` (m), of which the fit takes the share `span`, and `stretch` times as much
    along u. `out` receives height, slope along u, slope along v, standard error per unit sigma, sigma, effective
    number, and the sum of the slopes that both curvatures make at the rim. `influence[i]` is how far the height moves
    with a point of group i: the heights of two fits to the same groups differ by sigma * |influence - influence'|.
    `work` is as of `fit_room`. By least squares first; a curved patch once more with its fourth order, by the same
    matrix; then without outliers.
    """
    c, a, g, heights, squares, placed, weights, buffer = work
    m, per2 = (3 if degree == 1 else 6), 1.0 / (span * span)
    along2 = per2 / (stretch * stretch)
    c[:] = 0.0
    place_weights(patch, n, per2, along2, placed)
    copy_heights(patch, n, heights)
    if not solve_patch(patch, n, per2, along2, heights, placed, a, c, m):
        return False
    if degree == 2:
        flatten(patch, n, c, heights)
        right_side(patch, n, per2, along2, heights, placed, c)
        substitute(a, c, m)
    scale2, n_cut, k = 0.0, 1.0, 0
    while n_cut > 0.0 and k < MOST_PASSES:
        if degree == 2:
            flatten(patch, n, c, heights)
        mean_squares(patch, n, c, heights, squares)
        scale2 = robust_scale2(patch, n, per2, along2, squares, m, buffer)
        if scale2 < 0.0:
            return False
        n_cut = weigh(patch, n, placed, squares, scale2, weights)
        if not solve_patch(patch, n, per2, along2, heights, weights, a, c, m):
            return False
        k += 1
    g[:] = 0.0
    g[0] = 1.0
    if degree == 2:
        g[3] = g[5] = -2.0 * scale2
    substitute(a, g, m)
    total, weights2, misfit2, variance = sum_up(patch, n, per2, along2, g, squares, weights, influence)
    effective = total * total / weights2
    sigma2 = misfit2 / total * effective / max(effective - m, 1.0)
    thinned = 2.0 * sigma2 * (c[3] + c[5])
    out[HEIGHT], out[SLOPE_U], out[SLOPE_V] = (c[0] - thinned) * radius, c[1], c[2]
    out[UNIT_ERROR], out[SIGMA], out[EFFECTIVE] = np.sqrt(variance), np.sqrt(max(sigma2, 0.0)) * radius, effective
    out[BEND] = 2.0 * (c[3] + c[5]) * span
    return True


@jit(nopython=True, cache=True)
def slope_chi2(
    patch: Floats, n: int, radius: float, span: float, stretch: float, degree: int, work: Any, out: Floats
) -> float:
    """Squared slope of the patch that `fit_patch` made last over what noise makes of it, for either direction.

    `work` and `out` as it left them; room for the unknowns and a buffer in `work` are used up. What both slopes have in
    common is left out.
    """
    _, a, g, _, squares, _, weights, influence = work
    m, per2, chi2 = (3 if degree == 1 else 6), 1.0 / (span * span), 0.0
    along2, sigma2 = per2 / (stretch * stretch), (out[SIGMA] / radius) ** 2
    for k in range(1, 3):
        g[:] = 0.0
        g[k] = 1.0
        substitute(a, g, m)
        _, _, _, variance = sum_up(patch, n, per2, along2, g, squares, weights, influence)
        chi2 += out[k] ** 2 / max(variance * sigma2, 1e-300)
    return chi2


@jit(nopython=True, cache=True)
def solve_patch(
    patch: Floats, n: int, per2: float, along2: float, heights: Floats, weights: Floats, a: Floats, c: Floats, m: int
) -> bool:
    """Set c (6,) to the least squares plane (m 3) or curved patch (6); `a` becomes its factor. False where singular."""
    if m == 3:
        plane_matrix(patch, n, per2, along2, weights, a)
    else:
        curved_matrix(patch, n, per2, along2, weights, a)
    if not a[0, 0] > 0.0 or not factorise(a, m):
        return False
    right_side(patch, n, per2, along2, heights, weights, c)
    substitute(a, c, m)
    c[m:] = 0.0
    return True


@jit(nopython=True, cache=True)
def fit_room(n: int) -> Any:
    """Room for `fit_patch` with up to n groups."""
    return (
        np.empty(6),
        np.empty((6, 6)),
        np.empty(6),
        np.empty((3, n)),
        np.empty(n),
        np.empty((2, n)),
        np.empty((2, n)),
        np.empty(n),
    )
