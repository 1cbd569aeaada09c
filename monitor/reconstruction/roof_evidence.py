"""What speaks for an edge at a vertex: what two planes leave of the points there, and what a smooth patch does.

In: groups of points near a vertex. Out: a row with both planes (`two_planes`), how well they are known, whether their
sides bow or the edge is round, and how much more a smooth patch with more unknowns leaves in the same window.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import jit

from monitor.reconstruction.gathering import frame_along
from monitor.reconstruction.quadric import factorise, substitute
from monitor.reconstruction.two_planes import (
    ASIDE,
    FEWEST,
    MIDDLE,
    MOST_ASIDE,
    N_SMOOTH,
    OFFSET,
    TOTAL,
    bring_back,
    carried_over,
    column,
    dot,
    error_under_vertex,
    fit_apart,
    fit_both,
    fit_side,
    mark_near_crest,
    put_together,
    sum_products,
    support_of,
    vector,
)
from monitor.tuples import sub
from projects.model import Floats

CLIPPED2 = 9.0  # of a squared residual, in variances of a point: the most that it counts
MOST_EXTRAPOLATED2 = 16.0  # variance of a plane under the vertex against that of a mean
N_UNKNOWNS = 6.0  # of two planes
APEX = 3.0  # how far a round edge lies inside of the roof at its middle, in its mean over twice the round part's width
CHI2, CHANCE, GAIN, BOW, TURN, UNIT, SUPPORT, OVER, ROUNDED, HIDDEN = range(10)
ACTIVE, OTHER, CREST, SEEN = slice(10, 13), slice(13, 16), slice(16, 19), 19
N_VALUES = 20


@jit(nopython=True, cache=True, error_model="numpy")
def look_for_roof(
    values: Floats, n_near: int, vertex: Floats, normal: Floats, sizes: Any, noise: float, window: Any, row: Floats
) -> None:
    """Fit two planes to the groups around a vertex; `row` stays as it is where that cannot be.

    `values` are as of `find_near`, `sizes` the radius of the window and how wide the edge is looked at (m), `noise` (m)
    one sigma of a point. Written are, of planes through all points: mean square of what they leave, in variances, and
    how much of it is chance; by how much more a smooth patch leaves. Of planes without what noise mixes
    (`fit_apart`): by how many sigmas either side bows; the cosine between them, and between the mean normals of their
    points; of the one under the vertex its error there per unit of noise, its points, and how far (m) the vertex is
    over it; by how many sigmas the edge is round, and how far per unit of noise it may be so unseen; the normals of the
    plane under the vertex and of the other; and from the vertex on the nearest point of both.
    """
    (radius, width), planes, noise2, up = sizes, window.planes, noise * noise, np.empty(3)
    n, kind = fit_both(values, n_near, vertex, normal, radius, window, up)
    if n == 0 or not what_is_left(n, window, noise2, row):
        return
    smooth, whole = left_by_patch(n, window, up, noise2), planes.copy()
    if smooth > row[GAIN]:  # planes of no edge may lean anywhere, and a patch over their middle stands askew
        upright = left_by_patch(n, window, normal, noise2)
        smooth = min(smooth, upright) if upright >= 0.0 else smooth
    is_apart = fit_apart(n, window, noise, up)
    bow = max(bow_of(n, 0, window, noise2), bow_of(n, 1, window, noise2))
    if is_apart and carried_over(dot(whole[0], whole[1]), noise) > MOST_ASIDE * radius:
        put_together(n, window, whole, up)
    under = 1 if kind * (planes[0, OFFSET] / dot(planes[0], up) - planes[1, OFFSET] / dot(planes[1], up)) > 0.0 else 0
    unit2, effective = error_under_vertex(n, under, window)
    if not smooth >= 0.0 or not unit2 * effective < MOST_EXTRAPOLATED2:
        row[:] = np.nan
        return
    row[SEEN] = turn_seen(n, window)
    row[GAIN] = smooth - row[GAIN]
    row[BOW] = bow
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
def turn_seen(n: int, window: Any) -> float:
    """Cosine between the mean normals of the points of both sides; 1 where a side has none."""
    normals, weights, sides = window.normals, window.weights, window.sides
    means = np.zeros((2, 3))
    for i in range(n):
        if sides[i] < ASIDE:
            for a in range(3):
                means[sides[i], a] += weights[i] * normals[a, i]
    both = np.sqrt(dot(means[0], means[0]) * dot(means[1], means[1]))
    return float(dot(means[0], means[1]) / both) if both > 0.0 else 1.0


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
            off = sub(column(places, i), middle)
            u, v = dot(off, across), dot(off, along)
            u3 += weights[i] * u * u * u
            u2v += weights[i] * u * u * v
    det = uu * vv - uv * uv
    per_u, per_v = (vv * u3 - uv * u2v) / det, (uu * u2v - uv * u3) / det
    moved, variance = 0.0, 0.0
    for i in range(n):
        if sides[i] == side:
            off = sub(column(places, i), middle)
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
    bring_back(n, window)
    n_near, kept = mark_near_crest(n, window, width), planes.copy()
    is_known = n_near > 0.0 and fit_side(n, 0, window) and fit_side(n, 1, window)
    first, second, offset = vector(planes[0]), vector(planes[1]), (planes[0, OFFSET], planes[1, OFFSET])
    n_aside, moved = (support_of(n, 0, window), support_of(n, 1, window)), 0.0
    for i in range(n):
        if sides[i] >= ASIDE:
            sides[i] -= ASIDE
            place = column(places, i)
            moved -= counts[i] * kind * (dot(second, place) - offset[1] if sides[i] else dot(first, place) - offset[0])
    planes[:] = kept
    if not is_known or min(n_aside) < FEWEST:
        return np.inf, np.inf
    unit = np.sqrt(1.0 / n_near + 1.0 / n_aside[0] + 1.0 / n_aside[1])
    return moved / (n_near * noise * unit), APEX * unit


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
