"""Exact polyhedra for architecture: a polygon drawn out to a prism, with its triangles and its distance field.

A profile of steps, a wall with its mouldings or a hand rail goes in as a polygon; triangles by ear clipping.
"""

from __future__ import annotations

import numpy as np

from monitor.simulation.model import ModelPart
from monitor.simulation.solid import Field
from projects.errors import ParameterError
from projects.model import Floats, Ints, Surface

# Axes of the polygon's two coordinates and of the drawing out, right-handed.
PLANES = {"xz": (0, 2, 1), "yz": (1, 2, 0), "xy": (0, 1, 2)}


def triangulate_polygon(polygon: Floats) -> Ints:
    """Return the triangles (n - 2, 3) of a simple polygon (n, 2) given counter-clockwise, by clipping ears."""
    left, triangles = list(range(len(polygon))), []
    while len(left) > 3:
        for k in range(len(left)):
            a, b, c = left[k - 1], left[k], left[(k + 1) % len(left)]
            others = polygon[[i for i in left if i not in (a, b, c)]]
            if _turn(polygon[a], polygon[b], polygon[c]) > 0.0 and not _holds(polygon[[a, b, c]], others):
                triangles.append((a, b, c))
                left.pop(k)
                break
        else:
            raise ParameterError("the polygon crosses itself or runs clockwise; give a simple one, counter-clockwise")
    return np.array([*triangles, tuple(left)], dtype=np.int32)


def _turn(a: Floats, b: Floats, c: Floats) -> float:
    """Return twice the area of the triangle a b c, positive counter-clockwise."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _holds(triangle: Floats, points: Floats) -> bool:
    """Return whether a triangle (3, 2) holds one of the points (n, 2), its border included."""
    inside = np.ones(len(points), dtype=bool)
    for a, b in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        inside &= (b[0] - a[0]) * (points[:, 1] - a[1]) - (b[1] - a[1]) * (points[:, 0] - a[0]) >= -1e-12
    return bool(inside.any())


def prism_field(polygon: Floats, low: float, high: float, plane: str) -> Field:
    """Return the exact signed distance to a prism; see `prism_part`."""
    i, j, k = PLANES[plane]
    starts, ends = polygon, np.roll(polygon, -1, axis=0)

    def field(p: Floats) -> Floats:
        """Return the exact signed distance (n,) at p (3, n)."""
        x, y = p[i], p[j]
        gap2, inside = np.full(p.shape[1], np.inf), np.zeros(p.shape[1], dtype=bool)
        for a, b in zip(starts, ends, strict=True):
            ex, ey = b - a
            t = np.clip(((x - a[0]) * ex + (y - a[1]) * ey) / (ex * ex + ey * ey), 0.0, 1.0)
            gap2 = np.minimum(gap2, (x - a[0] - t * ex) ** 2 + (y - a[1] - t * ey) ** 2)
            if ey != 0.0:
                inside ^= ((a[1] > y) != (b[1] > y)) & (x < a[0] + (y - a[1]) / ey * ex)
        across = np.where(inside, -1.0, 1.0) * np.sqrt(gap2)
        along = np.maximum(low - p[k], p[k] - high)
        outside = np.hypot(np.maximum(across, 0.0), np.maximum(along, 0.0))
        return np.asarray(outside + np.minimum(np.maximum(across, along), 0.0))

    return field


def prism_part(
    name: str, polygon: Floats, low: float, high: float, *, plane: str = "xz", cell: float = 0.01,
    reflectance: float = 0.6,
) -> ModelPart:  # fmt: skip
    """Return a polygon drawn out from `low` to `high` [m] along the third axis, exact until its shape is changed.

    Parameters
    ----------
    polygon : (n, 2) m, counter-clockwise, in the coordinates that `plane` ("xz", "yz" or "xy") names.
    cell : m, edge of the triangles after a change of shape.
    """
    polygon = np.asarray(polygon, dtype=float)
    i, j, k = PLANES[plane]
    n = len(polygon)
    vertices = np.empty((2 * n, 3))
    vertices[:, [i, j]] = np.concatenate([polygon, polygon])
    vertices[:, k] = np.repeat([low, high], n)
    cap = triangulate_polygon(polygon)
    a = np.arange(n, dtype=np.int32)
    b = np.roll(a, -1)
    faces = np.concatenate([cap[:, ::-1], cap + n, np.column_stack([a, b, b + n]), np.column_stack([a, b + n, a + n])])
    if plane == "xz":  # x, z, y is left-handed
        faces = faces[:, ::-1]
    box = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    field = prism_field(polygon, low, high, plane)
    return ModelPart(name, field, box, cell, reflectance, mesh=Surface(vertices, faces.astype(np.int32)))


def revolve_field(profile: Floats) -> Field:
    """Return the field of a body of revolution about z: `profile` (n, 2) m, height (ascending) and radius.

    The radius runs smoothly through the profile (monotone cubic); the field is the distance across divided by the
    slope, a close bound, cut flat at both ends.
    """
    from scipy.interpolate import PchipInterpolator

    radius = PchipInterpolator(profile[:, 0], profile[:, 1])
    slope = radius.derivative()
    low, high = float(profile[0, 0]), float(profile[-1, 0])

    def field(p: Floats) -> Floats:
        """Return the distance (n,) at p (3, n) across the slope of the profile."""
        z = np.clip(p[2], low, high)
        aside = (np.hypot(p[0], p[1]) - radius(z)) / np.sqrt(1.0 + slope(z) ** 2)
        return np.asarray(np.maximum(aside, np.maximum(low - p[2], p[2] - high)))

    return field
