"""Two planes that meet along a line, fitted to the points around a vertex, each to those of its side.

In: groups of points near a vertex, with their normals. Out: a row with both planes, what they leave of the points, and
what a smooth patch with more unknowns leaves in the same window. The sides are told by normals at first, then by which
plane is the surface at a place: of a ridge the lower one, of a fold the higher (Magnani and Boyd 2009 fit convex
piecewise planes so). Points err along their own side's normal, so that each plane is a regression along its own.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit

from monitor.reconstruction.gathering import N_POINTS, NORMAL_X, PLACE_X, frame_along, tangent_frame
from monitor.reconstruction.quadric import factorise, substitute
from projects.model import Floats, Ints

COS_BACK = -0.5  # points that look 120 degrees away from the vertex are of another sheet
LEAST_UPRIGHT = 0.45  # cosine of either plane with the mean of both: they look 127 degrees apart; a vertex sees 120
FEWEST = 6.0  # points of either side
N_ROUNDS, N_POWER, N_TURNS = 8, 16, 3
CLIPPED2 = 9.0  # of a squared residual, in variances of a point: the most that it counts
MOST_EXTRAPOLATED2 = 16.0  # variance of a plane under the vertex against that of a mean
FLATTEST = 1e-6  # of the product of both squares: points of a side lie on a line
N_UNKNOWNS, N_SMOOTH = 6.0, 8  # of two planes, and of the smooth patch
MIDDLE, OFFSET, TOTAL = slice(4, 7), 3, 7  # of a plane's row, whose first three are its normal
CHI2, CHANCE, GAIN, BOW, TURN, UNIT, SUPPORT, OVER, ROUNDED, HIDDEN = range(10)
ACTIVE, OTHER, CREST = slice(10, 13), slice(13, 16), slice(16, 19)
N_VALUES = 19
APEX = 3.0  # how far a round edge lies inside of the roof at its middle, in its mean over twice the round part's width


class Window(NamedTuple):
    """Room for the groups around a vertex and what is fitted to them."""

    places: Floats  # (3, n) m, from the vertex on
    normals: Floats  # (3, n)
    weights: Floats  # (n,) counts times 1 - (r / radius)^2
    counts: Floats  # (n,)
    sides: Ints  # (n,) 0 or 1
    planes: Floats  # (2, 8) unit normal, offset, middle of its points, their weight
    matrix: Floats
    unknowns: Floats


@jit(nopython=True, cache=True, error_model="numpy")
def window_room(n: int) -> Any:
    """Room for up to n groups."""
    return Window(np.empty((3, n)), np.empty((3, n)), np.empty(n), np.empty(n), np.empty(n, np.int64), np.empty((2, 8)),
                  np.empty((N_SMOOTH, N_SMOOTH)), np.empty(N_SMOOTH))  # fmt: skip


@jit(nopython=True, cache=True, error_model="numpy")
def dot(a: Floats, b: Floats) -> float:
    """Scalar product of two vectors of three."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@jit(nopython=True, cache=True, error_model="numpy")
def column(values: Floats, i: int) -> Any:
    """Column i of three rows: tuples need no room of their own."""
    return values[0, i], values[1, i], values[2, i]


@jit(nopython=True, cache=True, error_model="numpy")
def vector(values: Floats) -> Any:
    """The first three of a row."""
    return values[0], values[1], values[2]


@jit(nopython=True, cache=True, error_model="numpy")
def less(a: Any, b: Any) -> Any:
    """Difference of two vectors of three."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@jit(nopython=True, cache=True, error_model="numpy")
def to_unit(a: Floats) -> bool:
    """Divide a vector of three by its length, in place; False where it has none."""
    length = np.sqrt(dot(a, a))
    if not length > 0.0:
        return False
    a /= length
    return True


@jit(nopython=True, cache=True, error_model="numpy")
def fit_two_planes(
    values: Floats, n_near: int, vertex: Floats, normal: Floats, sizes: Any, noise: float, window: Any, row: Floats
) -> None:
    """Fit two planes to the groups around a vertex; `row` stays as it is where that cannot be.

    `values` are as of `find_near`, `sizes` the radius of the window and how wide the edge is looked at (m), `noise` (m)
    one sigma of a point. Written are: mean square of what the planes leave, in variances, and how much of it is chance;
    by how much more a smooth patch leaves; by how many sigmas either side bows; the cosine between the planes; of the
    one under the vertex its error there per unit of noise, its points, and how far (m) the vertex is over it; by how
    many sigmas the edge is round, and how far per unit of noise it may be so unseen; the normals of the plane under the
    vertex and of the other; and from the vertex on the nearest point of both.
    """
    radius, width = sizes
    planes, noise2 = window.planes, noise * noise
    n = collect(values, n_near, vertex, normal, radius, window)
    if n < 2 * FEWEST or not split_by_normals(n, window) or not (fit_side(n, 0, window) and fit_side(n, 1, window)):
        return
    kind, up = kind_of(planes), np.empty(3)
    for _ in range(N_ROUNDS):
        if not mean_upright(planes, up):
            return
        n_changed = part_by_place(n, window, up, kind)
        if not (fit_side(n, 0, window) and fit_side(n, 1, window)):
            return
        if n_changed == 0:
            break
    if not mean_upright(planes, up) or not what_is_left(n, window, noise2, row):
        return
    under = 1 if kind * (planes[0, OFFSET] / dot(planes[0], up) - planes[1, OFFSET] / dot(planes[1], up)) > 0.0 else 0
    unit2, effective = error_under_vertex(n, under, window)
    smooth = left_by_patch(n, window, up, noise2)
    if not smooth >= 0.0 or not unit2 * effective < MOST_EXTRAPOLATED2:
        row[:] = np.nan
        return
    row[GAIN] = smooth - row[GAIN]
    row[BOW] = max(bow_of(n, 0, window, noise2), bow_of(n, 1, window, noise2))
    row[UNIT], row[OVER] = np.sqrt(unit2), -planes[under, OFFSET]
    row[SUPPORT] = support_of(n, under, window)
    row[ROUNDED], row[HIDDEN] = how_round(n, window, kind, width, noise)
    row[ACTIVE], row[OTHER] = planes[under, :3], planes[1 - under, :3]
    turn = dot(planes[0], planes[1])
    row[TURN], part = turn, 1.0 / (1.0 - turn * turn)
    one = part * (planes[0, OFFSET] - turn * planes[1, OFFSET])
    other = part * (planes[1, OFFSET] - turn * planes[0, OFFSET])
    row[CREST] = one * planes[0, :3] + other * planes[1, :3]


@jit(nopython=True, cache=True, error_model="numpy")
def collect(values: Floats, n_near: int, vertex: Floats, normal: Floats, radius: float, window: Any) -> int:
    """Copy the groups within `radius` of a vertex to the window; how many they are."""
    places, normals, counts, weights = window.places, window.normals, window.counts, window.weights
    n, radius2 = 0, radius * radius
    for k in range(n_near):
        x, y, z = values[PLACE_X, k] - vertex[0], values[PLACE_X + 1, k] - vertex[1], values[PLACE_X + 2, k] - vertex[2]
        r2, look = x * x + y * y + z * z, (values[NORMAL_X, k], values[NORMAL_X + 1, k], values[NORMAL_X + 2, k])
        if r2 < radius2 and dot(look, normal) > COS_BACK:
            places[0, n], places[1, n], places[2, n] = x, y, z
            normals[0, n], normals[1, n], normals[2, n] = look
            counts[n] = values[N_POINTS, k]
            weights[n] = values[N_POINTS, k] * (1.0 - r2 / radius2)
            n += 1
    return n


@jit(nopython=True, cache=True, error_model="numpy")
def split_by_normals(n: int, window: Any) -> bool:
    """Part the groups by how they look, along the direction in which their normals vary most; then by the nearer mean.

    The means are left in the planes' normals.
    """
    normals, weights, sides, planes = window.normals, window.weights, window.sides, window.planes
    mean, spread, way = np.zeros(3), np.zeros((3, 3)), np.empty(3)
    total = 0.0
    for i in range(n):
        total += weights[i]
        for a in range(3):
            mean[a] += weights[i] * normals[a, i]
    mean /= total
    for i in range(n):
        for a in range(3):
            off = weights[i] * (normals[a, i] - mean[a])
            for b in range(a + 1):
                spread[a, b] += off * (normals[b, i] - mean[b])
    spread[0, 1], spread[0, 2], spread[1, 2] = spread[1, 0], spread[2, 0], spread[2, 1]
    way[:] = spread[np.argmax(np.diag(spread))]
    for _ in range(N_POWER):
        way[0], way[1], way[2] = dot(spread[0], way), dot(spread[1], way), dot(spread[2], way)
        if not to_unit(way):
            return False
    along, middle = vector(way), dot(way, mean)
    for i in range(n):
        sides[i] = 1 if dot(along, column(normals, i)) > middle else 0
    for _ in range(N_TURNS):
        for side in range(2):
            x = y = z = 0.0
            for i in range(n):
                weight = weights[i] if sides[i] == side else 0.0
                x += weight * normals[0, i]
                y += weight * normals[1, i]
                z += weight * normals[2, i]
            planes[side, 0], planes[side, 1], planes[side, 2] = x, y, z
            if not to_unit(planes[side, :3]):
                return False
        apart = less(vector(planes[1]), vector(planes[0]))
        for i in range(n):
            sides[i] = 1 if dot(column(normals, i), apart) > 0.0 else 0
    return True


@jit(nopython=True, cache=True, error_model="numpy")
def sum_products(n: int, side: int, window: Any, u: Any, v: Any, w: Any) -> Any:
    """Weighted sums over one side's groups, about its middle, of the products uu, uv, vv, uw, vw of directions."""
    places, weights, sides = window.places, window.weights, window.sides
    middle, uu, uv, vv, uw, vw = vector(window.planes[side, MIDDLE]), 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        if sides[i] == side:
            off, weight = less(column(places, i), middle), weights[i]
            a, b, c = dot(off, u), dot(off, v), dot(off, w)
            uu += weight * a * a
            uv += weight * a * b
            vv += weight * b * b
            uw += weight * a * c
            vw += weight * b * c
    return uu, uv, vv, uw, vw


@jit(nopython=True, cache=True, error_model="numpy")
def fit_side(n: int, side: int, window: Any) -> bool:
    """Fit the plane of one side along the normal that it has: unit normal, offset, middle and weight of its points."""
    places, weights, sides = window.places, window.weights, window.sides
    plane = window.planes[side]
    x = y = z = total = 0.0
    for i in range(n):
        weight = weights[i] if sides[i] == side else 0.0
        x += weight * places[0, i]
        y += weight * places[1, i]
        z += weight * places[2, i]
        total += weight
    if not total > 0.0:
        return False
    plane[4], plane[5], plane[6], plane[TOTAL] = x / total, y / total, z / total, total
    u, v = tangent_frame(plane)
    uu, uv, vv, uw, vw = sum_products(n, side, window, u, v, vector(plane))
    det = uu * vv - uv * uv
    if not det > FLATTEST * uu * vv:
        return False
    du, dv = (vv * uw - uv * vw) / det, (uu * vw - uv * uw) / det
    for a in range(3):
        plane[a] -= du * u[a] + dv * v[a]
    if not to_unit(plane[:3]):
        return False
    plane[OFFSET] = dot(plane, plane[MIDDLE])
    return True


@jit(nopython=True, cache=True, error_model="numpy")
def kind_of(planes: Floats) -> float:
    """Return 1 for a ridge, whose sides look away from each other, -1 for a fold."""
    apart = planes[1, MIDDLE] - planes[0, MIDDLE]
    return 1.0 if dot(apart, planes[1]) > dot(apart, planes[0]) else -1.0


@jit(nopython=True, cache=True, error_model="numpy")
def mean_upright(planes: Floats, up: Floats) -> bool:
    """Write the direction between both planes' normals; False where these are too far apart for one roof."""
    up[:] = planes[0, :3] + planes[1, :3]
    return to_unit(up) and min(dot(planes[0], up), dot(planes[1], up)) >= LEAST_UPRIGHT


@jit(nopython=True, cache=True, error_model="numpy")
def part_by_place(n: int, window: Any, up: Floats, kind: float) -> int:
    """Give each group to the plane that is the surface there: of a ridge the lower one along `up`. How many changed."""
    places, sides, planes = window.places, window.sides, window.planes
    first, second, n_changed = vector(planes[0]), vector(planes[1]), 0
    offset, upright = (planes[0, OFFSET], planes[1, OFFSET]), (dot(first, up), dot(second, up))
    for i in range(n):
        place = column(places, i)
        over, over_other = (dot(first, place) - offset[0]) / upright[0], (dot(second, place) - offset[1]) / upright[1]
        side = 1 if kind * (over_other - over) > 0.0 else 0
        n_changed += side != sides[i]
        sides[i] = side
    return n_changed


@jit(nopython=True, cache=True, error_model="numpy")
def what_is_left(n: int, window: Any, noise2: float, row: Floats) -> bool:
    """Write what both planes leave: per degree of freedom, its chance, as a whole; False where points are too few."""
    places, weights, counts, sides, planes = window.places, window.weights, window.counts, window.sides, window.planes
    left, total, total2 = 0.0, 0.0, 0.0
    first, second = vector(planes[0]), vector(planes[1])
    offset = planes[0, OFFSET], planes[1, OFFSET]
    for i in range(n):
        place, share = column(places, i), weights[i] / counts[i]
        off = dot(second, place) - offset[1] if sides[i] == 1 else dot(first, place) - offset[0]
        left += weights[i] * min(off * off / noise2, CLIPPED2 / counts[i])
        total += share
        total2 += share * share
    expected = total - N_UNKNOWNS * total2 / total
    if not expected > 0.0 or min(support_of(n, 0, window), support_of(n, 1, window)) < FEWEST:
        return False
    row[CHI2], row[CHANCE], row[GAIN] = left / expected, np.sqrt(2.0 * total2) / expected, left
    return True


@jit(nopython=True, cache=True, error_model="numpy")
def support_of(n: int, side: int, window: Any) -> float:
    """Points of one side."""
    counts, sides = window.counts, window.sides
    total = 0.0
    for i in range(n):
        total += counts[i] if sides[i] == side else 0.0
    return total


@jit(nopython=True, cache=True, error_model="numpy")
def error_under_vertex(n: int, side: int, window: Any) -> Any:
    """Variance of a plane under the vertex in that of a point, and the effective number of its points."""
    places, weights, counts, sides = window.places, window.weights, window.counts, window.sides
    plane = window.planes[side]
    (u, v), middle, whole = tangent_frame(plane), vector(plane[MIDDLE]), plane[TOTAL]
    uu, uv, vv, _, _ = sum_products(n, side, window, u, v, u)
    a, b, det = -dot(plane[MIDDLE], u), -dot(plane[MIDDLE], v), uu * vv - uv * uv
    per_u, per_v = (vv * a - uv * b) / det, (uu * b - uv * a) / det
    variance, squares = 0.0, 0.0
    for i in range(n):
        if sides[i] == side:
            off = less(column(places, i), middle)
            one = weights[i] * (1.0 / whole + per_u * dot(off, u) + per_v * dot(off, v))
            variance += one * one / counts[i]
            squares += weights[i] ** 2 / counts[i]
    return variance, plane[TOTAL] ** 2 / squares


@jit(nopython=True, cache=True, error_model="numpy")
def bow_of(n: int, side: int, window: Any, noise2: float) -> float:
    """By how many sigmas the points of one side bow out of its plane, across the line where both meet or along it.

    What is beyond the next edge or bend shows there long before all that is left does; along an edge, what is round.
    """
    across, along = frame_along(vector(window.planes[side]), window.planes[1 - side])
    return max(bow_along(n, side, window, noise2, across, along), bow_along(n, side, window, noise2, along, across))


@jit(nopython=True, cache=True, error_model="numpy")
def bow_along(n: int, side: int, window: Any, noise2: float, across: Any, along: Any) -> float:
    """By how many sigmas the points of one side bow out of its plane in the first of two directions in it."""
    places, weights, counts, sides = window.places, window.weights, window.counts, window.sides
    up, middle, whole = vector(window.planes[side]), vector(window.planes[side, MIDDLE]), window.planes[side, TOTAL]
    uu, uv, vv, _, _ = sum_products(n, side, window, across, along, up)
    u3 = u2v = 0.0
    for i in range(n):
        if sides[i] == side:
            off = less(column(places, i), middle)
            u, v = dot(off, across), dot(off, along)
            u3 += weights[i] * u * u * u
            u2v += weights[i] * u * u * v
    det = uu * vv - uv * uv
    per_u, per_v = (vv * u3 - uv * u2v) / det, (uu * u2v - uv * u3) / det
    moved, variance = 0.0, 0.0
    for i in range(n):
        if sides[i] == side:
            off = less(column(places, i), middle)
            u, v = dot(off, across), dot(off, along)
            rest = weights[i] * (u * u - uu / whole - per_u * u - per_v * v)
            moved += rest * dot(off, up)
            variance += rest * rest / counts[i] * noise2
    return float(abs(moved) / np.sqrt(variance)) if variance > 0.0 else np.inf


@jit(nopython=True, cache=True, error_model="numpy")
def how_round(n: int, window: Any, kind: float, width: float, noise: float) -> Any:
    """By how many sigmas the points within `width` of the line where both planes meet lie on the round side of it.

    Of planes through the others, which a round edge does not tilt. And how far inside, per unit of noise, a round edge
    may lie at its middle without showing.
    """
    places, counts, sides, planes = window.places, window.counts, window.sides, window.planes
    n_near, kept = mark_near_crest(n, window, width), planes.copy()
    is_known = n_near > 0.0 and fit_side(n, 0, window) and fit_side(n, 1, window)
    first, second, offset = vector(planes[0]), vector(planes[1]), (planes[0, OFFSET], planes[1, OFFSET])
    n_aside, moved = (support_of(n, 0, window), support_of(n, 1, window)), 0.0
    for i in range(n):
        if sides[i] > 1:
            sides[i] -= 2
            place = column(places, i)
            moved -= counts[i] * kind * (dot(second, place) - offset[1] if sides[i] else dot(first, place) - offset[0])
    planes[:] = kept
    if not is_known or min(n_aside) < FEWEST:
        return np.inf, np.inf
    unit = np.sqrt(1.0 / n_near + 1.0 / n_aside[0] + 1.0 / n_aside[1])
    return moved / (n_near * noise * unit), APEX * unit


@jit(nopython=True, cache=True, error_model="numpy")
def mark_near_crest(n: int, window: Any, width: float) -> float:
    """Take the groups within `width` of the line where both planes meet off their sides, 2 or 3 now; their points."""
    places, counts, sides, planes = window.places, window.counts, window.sides, window.planes
    first, second, offset = vector(planes[0]), vector(planes[1]), (planes[0, OFFSET], planes[1, OFFSET])
    cosine, n_near = dot(first, second), 0.0
    reach = width * np.sqrt(max(1.0 - cosine * cosine, 0.0))
    for i in range(n):
        place = column(places, i)
        over, over_other = dot(first, place) - offset[0], dot(second, place) - offset[1]
        if sides[i] == 1:
            over, over_other = over_other, over
        if abs(over_other - cosine * over) < reach:
            sides[i] += 2
            n_near += counts[i]
    return n_near


@jit(nopython=True, cache=True, error_model="numpy")
def left_by_patch(n: int, window: Any, up: Floats, noise2: float) -> float:
    """Weighted squares that a smooth patch over the plane across `up` leaves, in variances; -1 where there is none.

    It is of second degree, and across the edge of fourth: what is round there is no edge, however narrow.
    """
    places, weights, counts = window.places, window.weights, window.counts
    a, c, terms = window.matrix, window.unknowns, np.empty(N_SMOOTH)
    across, along = frame_along(up, window.planes[1])
    longest2 = 0.0
    for i in range(n):
        longest2 = max(longest2, dot(column(places, i), column(places, i)))
    per = 1.0 / np.sqrt(longest2)
    a[:], c[:] = 0.0, 0.0
    for i in range(n):
        place, weight = column(places, i), weights[i]
        height = per * dot(place, up)
        write_terms(per * dot(place, across), per * dot(place, along), terms)
        for j in range(N_SMOOTH):
            c[j] += weight * terms[j] * height
            for k in range(j + 1):
                a[j, k] += weight * terms[j] * terms[k]
    if not factorise(a, N_SMOOTH):
        return -1.0
    substitute(a, c, N_SMOOTH)
    left = 0.0
    for i in range(n):
        place = column(places, i)
        u, v, off = per * dot(place, across), per * dot(place, along), per * dot(place, up)
        write_terms(u, v, terms)
        for j in range(N_SMOOTH):
            off -= c[j] * terms[j]
        slope_u = c[1] + 2.0 * c[3] * u + c[4] * v + (3.0 * c[6] + 4.0 * c[7] * u) * u * u
        slope_v = c[2] + c[4] * u + 2.0 * c[5] * v
        square = off * off / (per * per * noise2 * (1.0 + slope_u * slope_u + slope_v * slope_v))
        left += weights[i] * min(square, CLIPPED2 / counts[i])
    return left


@jit(nopython=True, cache=True, error_model="numpy")
def write_terms(u: float, v: float, terms: Floats) -> None:
    """Terms of the smooth patch at (u, v)."""
    terms[0], terms[1], terms[2], terms[3], terms[4], terms[5] = 1.0, u, v, u * u, u * v, v * v
    terms[6], terms[7] = u * u * u, u * u * u * u
