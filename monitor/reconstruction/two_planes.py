"""Two planes that meet along a line, fitted to the points around a vertex, each to those of its side.

In: groups of points near a vertex, with their normals. Out: a `Window` with both planes and the side of each group.
The sides are told by normals at first, then by which plane is the surface at a place: of a ridge the lower one, of a
fold the higher (Magnani and Boyd 2009 fit convex piecewise planes so). Points err along their own side's normal, so
that each plane is a regression along its own.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import jit

from monitor.reconstruction.gathering import N_POINTS, NORMAL_X, PLACE_X, tangent_frame
from monitor.tuples import sub
from projects.model import Floats, Ints

COS_BACK = -0.5  # points that look 120 degrees away from the vertex are of another sheet
LEAST_UPRIGHT = 0.45  # cosine of either plane with the mean of both: they look 127 degrees apart; a vertex sees 120
FEWEST = 6.0  # points of either side
N_ROUNDS, N_POWER, N_TURNS = 8, 16, 3
FLATTEST = 1e-6  # of the product of both squares: points of a side lie on a line
ASIDE = 2  # added to the side of a group that is left out of its plane
CARRIED_SIGMAS = 2.5  # of noise, that carry few points over an edge
MOST_ASIDE = 0.25  # of the radius: a wider strip along an edge costs a narrow window more than it saves
MOST_POINTS = 6000  # of a window: of more, every so many-th
N_SMOOTH = 8  # unknowns of the smooth patch that two planes are held against
MIDDLE, OFFSET, TOTAL = slice(4, 7), 3, 7  # of a plane's row, whose first three are its normal


class Window(NamedTuple):
    """Room for the groups around a vertex and what is fitted to them."""

    places: Floats  # (3, n) m, from the vertex on
    normals: Floats  # (3, n)
    weights: Floats  # (n,) counts times 1 - (r / radius)^2
    counts: Floats  # (n,)
    sides: Ints  # (n,) 0 or 1; `ASIDE` more where the group is left out
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
def to_unit(a: Floats) -> bool:
    """Divide a vector of three by its length, in place; False where it has none."""
    length = np.sqrt(dot(a, a))
    if not length > 0.0:
        return False
    a /= length
    return True


@jit(nopython=True, cache=True, error_model="numpy")
def fit_both(
    values: Floats, n_near: int, vertex: Floats, normal: Floats, radius: float, window: Any, up: Floats
) -> Any:
    """Fit two planes to the groups within `radius` (m) of a vertex; how many these are, 0 where that cannot be.

    `values` are as of `find_near`. Also whether they are a ridge (1) or a fold (-1); `up` receives the direction
    between the normals of both planes.
    """
    planes = window.planes
    n = collect(values, n_near, vertex, normal, radius, window)
    if n < 2 * FEWEST or not split_by_normals(n, window) or not (fit_side(n, 0, window) and fit_side(n, 1, window)):
        return 0, 0.0
    kind = kind_of(planes)
    for _ in range(N_ROUNDS):
        if not mean_upright(planes, up):
            return 0, 0.0
        n_changed = part_by_place(n, window, up, kind)
        if not (fit_side(n, 0, window) and fit_side(n, 1, window)):
            return 0, 0.0
        if n_changed == 0:
            break
    return (n, kind) if mean_upright(planes, up) else (0, 0.0)


@jit(nopython=True, cache=True, error_model="numpy")
def fit_apart(n: int, window: Any, noise: float, up: Floats) -> bool:
    """Fit both planes again without the points next to the line where they meet, where `noise` (m) mixes the sides.

    What is next to the line is told along a point's own plane, in which its own error does not choose. With too few
    points left both planes stay as they are: False.
    """
    planes, kept = window.planes, window.planes.copy()
    mark_near_crest(n, window, carried_over(dot(planes[0], planes[1]), noise))
    is_known = min(support_of(n, 0, window), support_of(n, 1, window)) >= FEWEST
    if is_known and fit_side(n, 0, window) and fit_side(n, 1, window) and mean_upright(planes, up):
        return True
    put_together(n, window, kept, up)
    return False


@jit(nopython=True, cache=True, error_model="numpy")
def put_together(n: int, window: Any, planes: Floats, up: Floats) -> None:
    """Take both planes (2, 8) for those of all groups, none of which is left out."""
    bring_back(n, window)
    window.planes[:] = planes
    mean_upright(window.planes, up)


@jit(nopython=True, cache=True, error_model="numpy")
def carried_over(cosine: Any, noise: Any) -> Any:
    """How near to an edge (m) points of one side lie on the other's plane by their `noise` (m, one sigma), or are lost.

    `cosine` is that of the turn; numbers or arrays. A point that errs by e along its side's normal passes the plane
    between both sides from as far as e tan(turn / 2), and lands on the other side up to e sin(turn) from the edge.
    """
    sine = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0))
    return CARRIED_SIGMAS * noise * np.maximum(sine, sine / (1.0 + cosine))


@jit(nopython=True, cache=True, error_model="numpy")
def mark_near_crest(n: int, window: Any, width: float) -> float:
    """Put the groups within `width` (m) of the line where both planes meet `ASIDE`; how many points they have."""
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
            sides[i] += ASIDE
            n_near += counts[i]
    return n_near


@jit(nopython=True, cache=True, error_model="numpy")
def bring_back(n: int, window: Any) -> None:
    """Give the groups that were put `ASIDE` back to their sides."""
    for i in range(n):
        window.sides[i] %= ASIDE


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
    return n if n <= MOST_POINTS else thin_out(n, window)


@jit(nopython=True, cache=True, error_model="numpy")
def thin_out(n: int, window: Any) -> int:
    """Keep every so many-th group of a window, `MOST_POINTS` at most; how many they are. They lie sorted by place."""
    step = 1 + (n - 1) // MOST_POINTS
    kept = 0
    for i in range(0, n, step):
        for a in range(3):
            window.places[a, kept], window.normals[a, kept] = window.places[a, i], window.normals[a, i]
        window.counts[kept], window.weights[kept] = window.counts[i], window.weights[i]
        kept += 1
    return kept


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
        apart = sub(vector(planes[1]), vector(planes[0]))
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
            off, weight = sub(column(places, i), middle), weights[i]
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
            off = sub(column(places, i), middle)
            one = weights[i] * (1.0 / whole + per_u * dot(off, u) + per_v * dot(off, v))
            variance += one * one / counts[i]
            squares += weights[i] ** 2 / counts[i]
    return variance, plane[TOTAL] ** 2 / squares
