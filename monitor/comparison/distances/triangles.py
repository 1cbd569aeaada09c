"""Scalar kernels over one point and one triangle or box: tuples in, tuples out, float64.

Used by `search`, for which faces to look at and the nearest of them. They are put into what calls them: a call would
copy all arrays of a tree.
Closest point by Voronoi regions: Ericson, Real-Time Collision Detection (2005), section 5.1.5.
"""

from __future__ import annotations

from numba import jit

from monitor.tuples import cross, dot, sub

FACE, EDGE_AB, EDGE_BC, EDGE_CA, CORNER_A, CORNER_B, CORNER_C = range(7)


@jit(nopython=True, cache=True, forceinline=True)
def closest_on_triangle(p, a, b, c):  # type: ignore[no-untyped-def]
    """Return the point of the triangle nearest to p as (weight of b, weight of c) and the feature it lies on."""
    ab, ac, ap = sub(b, a), sub(c, a), sub(p, a)
    d1, d2 = dot(ab, ap), dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return 0.0, 0.0, CORNER_A
    bp = sub(p, b)
    d3, d4 = dot(ab, bp), dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return 1.0, 0.0, CORNER_B
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0 and d1 > d3:  # a and b may be one place
        return d1 / (d1 - d3), 0.0, EDGE_AB
    cp = sub(p, c)
    d5, d6 = dot(ab, cp), dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 1.0, CORNER_C
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return 0.0, d2 / (d2 - d6), EDGE_CA
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and (d4 - d3) >= 0.0 and (d5 - d6) >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 1.0 - w, w, EDGE_BC
    whole = va + vb + vc
    return vb / whole, vc / whole, FACE


@jit(nopython=True, cache=True)
def crosses_triangle(p, direction, a, b, c):  # type: ignore[no-untyped-def]
    """Return t with p + t direction on the triangle, or -1 where the line misses it (Moeller and Trumbore 1997)."""
    ab, ac = sub(b, a), sub(c, a)
    h = cross(direction, ac)
    det = dot(ab, h)
    if det == 0.0:
        return -1.0
    s = sub(p, a)
    u = dot(s, h) / det
    q = cross(s, ab)
    v = dot(direction, q) / det
    if u < 0.0 or v < 0.0 or u + v > 1.0:
        return -1.0
    return dot(ac, q) / det


@jit(nopython=True, cache=True, forceinline=True)
def box_distance2(p, nodes, i):  # type: ignore[no-untyped-def]
    """Return the squared distance of p to the box in nodes[i, 0:3], nodes[i, 3:6]; 0 inside."""
    dx = max(nodes[i, 0] - p[0], p[0] - nodes[i, 3], 0.0)
    dy = max(nodes[i, 1] - p[1], p[1] - nodes[i, 4], 0.0)
    dz = max(nodes[i, 2] - p[2], p[2] - nodes[i, 5], 0.0)
    return dx * dx + dy * dy + dz * dz


@jit(nopython=True, cache=True, forceinline=True)
def cone_looks(looks, nodes, i):  # type: ignore[no-untyped-def]
    """Whether some face under node i may look the same way: its cone's axis is nodes[i, 6:9], its limit nodes[i, 9]."""
    return looks[0] * nodes[i, 6] + looks[1] * nodes[i, 7] + looks[2] * nodes[i, 8] >= nodes[i, 9]
