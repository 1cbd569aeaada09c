"""The shield that stands at the left of the demo's figure: a rim with beads and a tower in relief.

In heads; `shield_corner` tells in metres where its upper corner is, the piece that the demo loses.
"""

from __future__ import annotations

import numpy as np

from monitor.simulation.heads import HEAD, part_in_heads
from monitor.simulation.pedestal import HEIGHT
from monitor.simulation.shapes import draw_polygon, ellipsoid, placed, smoothstep, turn_by
from monitor.simulation.solid import Part, smooth_max
from projects.model import Floats

_SHIELD_AT = (0.93, -0.93, 1.90)  # heads, of its middle
_SHIELD_TURN = (-9.0, 2.0, 20.0)  # degrees about x, y and z


def _shield_outline() -> Floats:
    """Return the outline of a heater shield with drawn-up corners, in heads."""
    half = [(0.0, 1.40), (0.25, 1.42), (0.48, 1.50), (0.66, 1.62), (0.80, 1.62), (0.77, 1.35), (0.72, 1.05),
            (0.74, 0.5), (0.73, 0.0), (0.66, -0.55), (0.50, -1.05), (0.27, -1.42), (0.0, -1.62)]  # fmt: skip
    return np.array(half + [(-u, v) for u, v in half[-2:0:-1]])


def _tower_outline() -> Floats:
    """Return the outline of the tower that the shield bears."""
    half = [(0.06, 0.88), (0.06, 0.74), (0.16, 0.74), (0.16, 0.88), (0.30, 0.88), (0.30, 0.55), (0.23, 0.47),
            (0.23, -0.10), (0.34, -0.10), (0.34, 0.06), (0.44, 0.06), (0.44, -0.10), (0.44, -0.62)]  # fmt: skip
    return np.array(half + [(-u, v) for u, v in half[::-1]])


def shield_parts() -> list[Part]:
    """Return the shield that stands at her left: rim with beads, a tower in relief, and the rock that carries it."""
    outline = draw_polygon(_shield_outline(), (-1.2, -2.0), (1.2, 2.0), step=0.006)
    tower = draw_polygon(_tower_outline(), (-0.9, -1.2), (0.9, 1.3), step=0.004)

    def relief(u: Floats, v: Floats, edge: Floats) -> Floats:
        """Return how far rim, beads and tower stand out at (u, v), `edge` being the distance to the outline."""
        rim = 0.055 * (1.0 - smoothstep(np.abs(edge + 0.075), 0.045, 0.075))
        studs = [np.hypot(np.abs(u) - a, v - b) for a, b in ((0.52, 1.22), (0.50, 0.35), (0.50, -0.35), (0.36, -0.95))]
        studs += [np.hypot(u, v - b) for b in (1.16, -1.25)]
        beads = 0.9 * np.sqrt(np.maximum(0.055**2 - np.min(studs, axis=0) ** 2, 0.0))
        castle = 0.06 * (1.0 - smoothstep(tower(u, v), -0.03, 0.005))
        gate = np.minimum(np.hypot(u, v + 0.35) - 0.13, np.maximum(np.abs(u) - 0.13, np.abs(v + 0.50) - 0.15))
        castle = castle - 0.05 * (1.0 - smoothstep(gate, -0.02, 0.01))
        window = np.maximum(np.abs(u) - 0.05, np.abs(v - 0.28) - 0.10)
        castle = castle - 0.045 * (1.0 - smoothstep(window, -0.02, 0.01))
        course = np.minimum(np.abs(v + 0.10), np.abs(v - 0.47))
        castle = castle + 0.02 * (1.0 - smoothstep(course, 0.015, 0.03)) * (1.0 - smoothstep(tower(u, v), -0.02, 0.01))
        return rim + beads + castle

    def field(p: Floats) -> Floats:
        """Return the shield (n,) at p (3, n) in its own frame."""
        u, w, v = p[0], p[1], p[2]
        bulge = w + 0.16 * (1.0 - u * u / 0.64) - 0.16  # curved about its long axis, the front towards -y
        edge = outline(u, v)
        face = -bulge - 0.075 - relief(u, v, edge)
        return 0.8 * smooth_max(smooth_max(face, bulge - 0.075, 0.02), edge, 0.035)

    turned = placed(field, at=_SHIELD_AT, rotation=turn_by(*_SHIELD_TURN))
    corners = np.array([[i, j, k] for i in (-0.82, 0.82) for j in (-0.2, 0.3) for k in (-1.64, 1.64)])
    whole = corners @ turn_by(*_SHIELD_TURN).T + _SHIELD_AT
    rock = ellipsoid((0.93, -0.90, 0.18), (0.34, 0.26, 0.24))
    return [
        part_in_heads("shield", turned, whole.tolist(), 0.05, blend=0.0),
        part_in_heads("shield support", rock, ((0.93, -0.90, 0.18),), 0.36, blend=0.05),
    ]


def shield_corner() -> Floats:
    """Return the middle of the shield's outer upper corner, in metres: the piece that is lost."""
    local = np.array([0.735, 0.0, 1.50])
    return HEAD * (turn_by(*_SHIELD_TURN) @ local + _SHIELD_AT) + [0.0, 0.0, HEIGHT]
