"""The cloak of the demo's figure, its rolled edge across the body, and the cloth that hangs from the left forearm.

In heads: coordinates p (3, n) in, distance-like values (n,) out, negative inside.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from monitor.simulation.heads import part_in_heads
from monitor.simulation.shapes import ellipse, pipe, smoothstep, tube
from monitor.simulation.solid import Part, smooth_max
from projects.model import Floats


def _cloak(p: Floats) -> Floats:
    """The cloak on the back: from the shoulders to the ankles, deep folds falling from the left shoulder."""
    x, y, z = p
    h = np.clip(z, 0.4, 6.5)
    rx = np.interp(h, [0.4, 2.0, 4.0, 5.2, 6.0, 6.5], [1.08, 0.98, 0.90, 0.80, 0.84, 0.70])
    ry = np.interp(h, [0.4, 2.0, 4.0, 5.2, 6.0, 6.5], [0.98, 0.86, 0.74, 0.66, 0.60, 0.36])
    dx, dy = x - 0.03, y - 0.04
    distance, _ = ellipse(dx, dy, rx, ry)
    turn = np.arctan2(dx, dy)  # zero at the back
    sweep = (h - 0.4) * (1.3 + 0.9 * np.tanh(1.5 * (turn + 0.3)))
    phase = 10.0 * (turn + 0.10 * sweep) + 1.1 * np.sin(2.0 * turn + 0.5 * h)
    depth = 0.022 + 0.070 * smoothstep(6.3 - h, 0.0, 3.5)
    fold = depth * pipe(phase) + 0.015 * np.sin(2.0 * phase + 1.0)
    edge = 0.30 * (y - 0.12 - 0.10 * np.sin(1.7 * h) + 0.30 * smoothstep(h, 5.6, 6.5) - 0.05 * np.sin(phase)) / 0.30
    hem = 0.42 + 0.16 * np.sin(turn * 2.0 + 0.8) + 0.05 * pipe(phase)
    cut = smooth_max(-edge, smooth_max(p[2] - 6.62, hem - p[2], 0.05), 0.05)
    return smooth_max(0.75 * smooth_max(distance - fold, -(distance - fold) - 0.20, 0.03), cut, 0.06)


def mantle_part() -> Part:
    """Return the rolled edge of the cloak across the body, from the shoulder over the breast to the hip."""
    t = np.linspace(0.0, 1.0, 15)
    course = CubicSpline(
        [0.0, 0.2, 0.45, 0.7, 0.9, 1.0],
        [(0.50, 0.30, 6.50), (0.50, -0.10, 6.62), (0.24, -0.47, 5.95), (-0.22, -0.56, 5.20), (-0.66, -0.36, 4.62),
         (-0.80, 0.12, 4.40)],
    )(t)  # fmt: skip
    radii = np.interp(t, [0.0, 0.2, 0.6, 1.0], [0.14, 0.115, 0.15, 0.17])
    roll = tube(course, radii, strands=6, relief=0.035, twist=1.6)
    return part_in_heads("roll", roll, course.tolist(), 0.24, blend=0.05)


def _cascade(p: Floats) -> Floats:
    """The cloth that hangs from the left forearm in a stepped fall."""
    x, y, z = p
    h = np.clip(z, 1.0, 5.1)
    u, v = x - 1.02 - 0.02 * (5.0 - h), y - 0.16
    wide = 0.17 + 0.035 * (5.1 - h)
    zigzag = 0.09 * np.sin(11.0 * u + 2.2 * np.sin(0.9 * h)) + 0.03 * np.sin(23.0 * u + h)
    thick = 0.20 + 0.012 * (5.1 - h)
    side = np.abs(u) - wide
    hem = 1.3 + 0.9 * np.abs(u + 0.15) + 0.08 * np.sin(22.0 * u) - z
    slab = smooth_max(np.abs(v + zigzag) - thick, side, 0.08)
    return 0.7 * smooth_max(slab, smooth_max(z - 5.12, hem, 0.04), 0.06)


def cloak_part() -> Part:
    """Return the cloak on the back."""
    return part_in_heads("cloak", _cloak, ((-1.2, -0.35, 0.3), (1.25, 1.2, 6.65)), 0.05, blend=0.06)


def cascade_part() -> Part:
    """Return the cloth that hangs from the left forearm."""
    return part_in_heads("cascade", _cascade, ((0.6, -0.2, 1.2), (1.5, 0.55, 5.15)), 0.06, blend=0.06)
