"""Elementary solids as fields: coordinates p (3, n) in, distance-like values (n,) out, negative inside.

Exact for balls, capsules, boxes and profiles; a close lower bound for ellipsoids and shapes that were carved.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import map_coordinates

from monitor.simulation.solid import Field
from projects.model import Floats
from projects.transforms import rotation_from_vector

Vector = ArrayLike


def turn_by(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Floats:
    """Return the rotation by degrees about x, then y, then z."""
    rx, ry, rz = (rotation_from_vector(np.radians(a) * e) for a, e in zip((x, y, z), np.eye(3), strict=True))
    return rz @ ry @ rx


def placed(field: Field, *, at: Vector = (0.0, 0.0, 0.0), rotation: Floats | None = None, scale: float = 1.0) -> Field:
    """Return the field turned by `rotation` (3, 3), enlarged by `scale` and moved `at`."""
    turn = np.eye(3) if rotation is None else rotation
    origin = np.asarray(at, dtype=float)[:, None]
    return lambda p: scale * field(turn.T @ (p - origin) / scale)


def ball(centre: Vector, radius: float) -> Field:
    """Return a ball."""
    c = np.asarray(centre, dtype=float)[:, None]
    return lambda p: np.sqrt(((p - c) ** 2).sum(axis=0)) - radius


def ellipsoid(centre: Vector, radii: Vector, rotation: Floats | None = None) -> Field:
    """Return an ellipsoid with half axes `radii` along the columns of `rotation`."""
    c, r = np.asarray(centre, dtype=float)[:, None], np.asarray(radii, dtype=float)[:, None]
    turn = np.eye(3) if rotation is None else rotation

    def field(p: Floats) -> Floats:
        """Return k0 (k0 - 1) / k1 (n,) at p (3, n): the distance to first order, 0 on the surface."""
        q = (turn.T @ (p - c)) / r
        k0 = np.sqrt((q * q).sum(axis=0))
        k1 = np.sqrt(((q / r) ** 2).sum(axis=0))
        return np.where(k1 > 1e-9, k0 * (k0 - 1.0) / np.maximum(k1, 1e-9), -float(r.min()))

    return field


def ellipse(x: Floats, y: Floats, radius_x: Floats, radius_y: Floats) -> tuple[Floats, Floats]:
    """Return the distance (n,) to an ellipse about the origin to first order, and how many times its radii away."""
    k0 = np.sqrt((x / radius_x) ** 2 + (y / radius_y) ** 2)
    k1 = np.sqrt((x / radius_x**2) ** 2 + (y / radius_y**2) ** 2)
    return k0 * (k0 - 1.0) / np.maximum(k1, 1e-6), k0


def capsule(a: Vector, b: Vector, radius_a: float, radius_b: float | None = None) -> Field:
    """Return a rod from a to b with round ends, its radius changing evenly."""
    start, end = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    along, rb = end - start, radius_a if radius_b is None else radius_b
    length2 = float(along @ along)

    def field(p: Floats) -> Floats:
        """Return the distance (n,) from the nearest point of the axis, less the radius there."""
        q = p - start[:, None]
        t = np.clip((along @ q) / length2, 0.0, 1.0)
        return np.sqrt(((q - along[:, None] * t) ** 2).sum(axis=0)) - (radius_a + (rb - radius_a) * t)

    return field


def box(centre: Vector, half: Vector, rounding: float = 0.0) -> Field:
    """Return a box with half lengths `half`, edges rounded by `rounding`."""
    c, h = np.asarray(centre, dtype=float)[:, None], np.asarray(half, dtype=float)[:, None] - rounding

    def field(p: Floats) -> Floats:
        """Return the signed distance (n,) of the box."""
        q = np.abs(p - c) - h
        outside = np.sqrt((np.maximum(q, 0.0) ** 2).sum(axis=0))
        return outside + np.minimum(q.max(axis=0), 0.0) - rounding

    return field


def tube(points: Floats, radii: Floats, strands: int = 0, relief: float = 0.0, twist: float = 0.0) -> Field:
    """Return a rope through `points` (m, 3): radii (m,), `strands` ridges of height `relief`, twisted (rad a unit)."""
    start, along = points[:-1], np.diff(points, axis=0)
    length = np.linalg.norm(along, axis=1)
    run = np.concatenate([[0.0], np.cumsum(length)])
    # A frame carried along the curve, so that strands do not jump from piece to piece.
    tangent = along / length[:, None]
    side = np.cross(tangent[0], [0.3, 0.9, 0.1])
    sides = []
    for t in tangent:
        side = side - t * (side @ t)
        side = side / np.linalg.norm(side)
        sides.append(side)

    def field(p: Floats) -> Floats:
        """Return the least distance (n,) of the pieces of the rope, less the ridges at the angle about it."""
        best = np.full(p.shape[1], np.inf)
        where, angle = np.zeros(p.shape[1]), np.zeros(p.shape[1])
        for i in range(len(start)):
            q = p - start[i][:, None]
            t = np.clip((along[i] @ q) / length[i] ** 2, 0.0, 1.0)
            off = q - along[i][:, None] * t
            d = np.sqrt((off * off).sum(axis=0)) - (radii[i] + (radii[i + 1] - radii[i]) * t)
            closer = d < best
            best = np.where(closer, d, best)
            where = np.where(closer, run[i] + t * length[i], where)
            if strands:
                turn = np.arctan2(np.cross(tangent[i], sides[i]) @ off, sides[i] @ off)
                angle = np.where(closer, turn, angle)
        if strands:
            best = best - relief * pipe(strands * angle + twist * where)
        return best

    return field


def arc_points(centre: Sequence[float], radius: float, start: float, end: float, n: int) -> list[tuple[float, float]]:
    """Return n points along an arc in a plane, from `start` to `end` in degrees counter-clockwise from u."""
    angles = np.radians(np.linspace(start, end, n))
    return [(centre[0] + radius * np.cos(a), centre[1] + radius * np.sin(a)) for a in angles]


def pipe(phase: Floats) -> Floats:
    """Return the section of tubular folds over a phase [rad]: round ridges (1), narrow valleys (about -0.7)."""
    return 2.0 * np.sqrt(np.cos(0.5 * phase) ** 2 + 0.02) - 1.02


def smoothstep(value: Floats, low: float, high: float) -> Floats:
    """Return 0 below `low`, 1 above `high`, and a smooth rise between."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


class Drawing:
    """A plane figure as a table of signed distances [m], negative inside, interpolated linearly between its nodes."""

    def __init__(self, distance: Floats, low: Vector, step: float) -> None:
        self._distance, self._low, self._step = distance, np.asarray(low, dtype=float), step

    def __call__(self, u: Floats, v: Floats) -> Floats:
        """Return the distance at (u, v); outside of the table, that of its nearest node."""
        at = np.stack([(u - self._low[0]) / self._step, (v - self._low[1]) / self._step])
        return map_coordinates(self._distance, at, order=1, mode="nearest")


def draw_strokes(strokes: Sequence[Floats], low: Vector, high: Vector, *, step: float) -> Drawing:
    """Return the distance to open polylines [m] as a drawing (never negative)."""
    u, v = _nodes(low, high, step)
    best = np.full(u.shape, np.inf)
    for line in strokes:
        for a, b in pairwise(line):
            best = np.minimum(best, _segment_distance(u, v, a, b))
    return Drawing(best, low, step)


def draw_polygon(polygon: Floats, low: Vector, high: Vector, *, step: float) -> Drawing:
    """Return the signed distance to a closed polygon (m, 2) [m], negative inside, as a drawing."""
    u, v = _nodes(low, high, step)
    best, inside = np.full(u.shape, np.inf), np.zeros(u.shape, dtype=bool)
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        best = np.minimum(best, _segment_distance(u, v, a, b))
        if a[1] != b[1]:
            crosses = (a[1] > v) != (b[1] > v)
            inside ^= crosses & (u < a[0] + (v - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
    return Drawing(np.where(inside, -best, best), low, step)


def draw_mirrored(half: Sequence[tuple[float, float]], low: Vector, high: Vector, *, step: float) -> Drawing:
    """Return as a drawing the section of a solid over (half width, height): its right half, an open outline [m] that
    begins and ends on the axis, and the mirror image of that."""
    whole = np.array([*half, *((-u, v) for u, v in half[::-1])])
    return draw_polygon(whole, low, high, step=step)


def _nodes(low: Vector, high: Vector, step: float) -> tuple[Floats, Floats]:
    """Return the places (u, v) of the nodes from `low` to `high` at even steps."""
    axes = [np.arange(a, b + step, step) for a, b in zip(np.asarray(low), np.asarray(high), strict=True)]
    u, v = np.meshgrid(*axes, indexing="ij")
    return u, v


def _segment_distance(u: Floats, v: Floats, a: Floats, b: Floats) -> Floats:
    """Return the distances of the places (u, v) to the segment from a to b."""
    du, dv = b[0] - a[0], b[1] - a[1]
    t = np.clip(((u - a[0]) * du + (v - a[1]) * dv) / max(du * du + dv * dv, 1e-30), 0.0, 1.0)
    return np.hypot(u - a[0] - t * du, v - a[1] - t * dv)
