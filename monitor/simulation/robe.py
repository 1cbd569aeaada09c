"""The girded robe of the demo's figure, with the leg that shows through it, and its sleeves.

In heads: coordinates p (3, n) in, distance-like values (n,) out, negative inside.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from monitor.simulation.heads import part_in_heads
from monitor.simulation.shapes import capsule, ellipse, ellipsoid, pipe, smoothstep
from monitor.simulation.solid import Field, Part, smooth_max, smooth_min
from projects.model import Floats

_ROBE_Z = [0.0, 0.6, 1.6, 2.8, 4.0, 4.6, 5.2]
_ROBE_X = CubicSpline(_ROBE_Z, [0.02, 0.02, 0.03, 0.06, 0.10, 0.09, 0.05])
_ROBE_Y = CubicSpline(_ROBE_Z, [-0.02, 0.00, 0.02, 0.02, 0.02, 0.03, 0.03])
_ROBE_RX = CubicSpline(_ROBE_Z, [0.98, 0.88, 0.80, 0.76, 0.74, 0.66, 0.52])
_ROBE_RY = CubicSpline(_ROBE_Z, [0.86, 0.78, 0.70, 0.62, 0.56, 0.50, 0.42])


def _column(p: Floats, extra: float) -> tuple[Floats, Floats, Floats]:
    """Return the distance to the robe's smooth column widened by `extra`, the angle about it and the height."""
    x, y, z = p
    h = np.clip(z, 0.0, 5.2)
    dx, dy = x - _ROBE_X(h), y - _ROBE_Y(h)
    rx, ry = _ROBE_RX(h) + extra, _ROBE_RY(h) + extra
    distance, away = ellipse(dx, dy, rx, ry)
    return np.where(away < 0.05, -ry, distance), np.arctan2(dx, -dy), h


def _skirt(p: Floats) -> Floats:
    """The long skirt: tubular folds from the hips to the ground, pressed flat over the free knee."""
    distance, turn, h = _column(p, 0.0)
    phase = 13.0 * turn + 0.9 * np.sin(2.0 * turn + 0.6) + 0.5 * np.sin(5.0 * turn - 0.5 * h) + 0.35 * h * np.sin(turn)
    knee = np.exp(-(((turn + 0.52) / 0.42) ** 2) - ((h - 2.6) / 1.5) ** 2)
    depth = (0.105 - 0.013 * h) * (0.75 + 0.25 * np.sin(3.0 * turn + 1.3)) * (1.0 - 0.9 * knee)
    fold = depth * pipe(phase)
    fold = fold + 0.02 * np.sin(2.3 * phase + 1.7 * h) * (1.0 - knee)
    end = smooth_max(p[2] - 5.2, 0.02 + 0.05 * np.sin(phase) - p[2], 0.03)
    return smooth_max(0.75 * (distance - fold), end, 0.06)


def _overfold(p: Floats) -> Floats:
    """The upper cloth that falls over the girdle to the hips, with finer folds and a waving hem."""
    distance, turn, h = _column(p, 0.075)
    phase = 19.0 * turn + 1.1 * np.sin(3.0 * turn + 0.9) + 0.9 * np.sin(h + turn)
    spread = smoothstep(5.1 - h, 0.0, 1.1)
    fold = (0.012 + 0.05 * spread) * pipe(phase)
    hem = 4.02 + 0.10 * np.sin(2.0 * turn + 1.0) + 0.06 * pipe(phase)
    end = smooth_max(p[2] - 5.2, hem - p[2], 0.02)
    inner = -(distance + 0.14)
    return smooth_max(smooth_max(0.75 * (distance - fold), end, 0.04), inner, 0.02)


def _bodice(p: Floats) -> Floats:
    """The cloth over the chest: folds that fall from both shoulders and meet between the breasts."""
    x, y, z = p
    trunk = smooth_min(
        ellipsoid((0.0, 0.06, 5.85), (0.60, 0.42, 0.92))(p), ellipsoid((0.03, 0.04, 5.15), (0.53, 0.42, 0.5))(p), 0.3
    )
    for side in (-1.0, 1.0):
        trunk = smooth_min(trunk, ellipsoid((0.29 * side, -0.24, 5.92), (0.27, 0.26, 0.27))(p), 0.14)
        trunk = smooth_min(trunk, capsule((0.25 * side, 0.08, 6.52), (0.74 * side, 0.06, 6.36), 0.16, 0.20)(p), 0.22)
    sag = np.sqrt(x * x + 0.012)
    phase = 15.0 * (z + 1.25 * sag - 0.35 * sag * sag) + 1.2 * np.sin(3.0 * x + 0.5)
    front = smoothstep(-y, -0.25, 0.1)
    neck = smoothstep(6.72 - z, 0.0, 0.3)
    vertical = 17.0 * np.arctan2(x, -y + 0.1) + 0.8 * np.sin(3.0 * z)
    low = smoothstep(5.75 - z, 0.0, 0.5)
    fold = 0.024 * front * neck * (1.0 - low) * pipe(phase) + 0.026 * low * pipe(vertical)
    fold = fold + 0.02 * (1.0 - front) * neck * pipe(vertical)
    return 0.8 * (trunk - fold)


def _girdle(p: Floats) -> Floats:
    """The cord around the waist, above which the cloth bulges."""
    distance, turn, _ = _column(p, 0.11)
    rise = p[2] - (5.16 + 0.03 * np.cos(turn))
    return np.hypot(distance, rise) - 0.062 - 0.012 * np.sin(34.0 * turn + 30.0 * rise)


def robe_parts() -> list[Part]:
    """Return the robe: skirt, leg, bodice, overfold and girdle, in the order in which they are joined."""
    whole = ((-1.15, -1.05, 0.0), (1.15, 1.05, 5.2))
    leg = smooth_leg()
    return [
        part_in_heads("skirt", _skirt, whole, 0.08),
        part_in_heads("leg", leg, ((-0.52, -0.85, 0.3), (-0.1, 0.1, 4.2)), 0.36, blend=0.22),
        part_in_heads("bodice", _bodice, ((-0.95, -0.55, 4.6), (0.95, 0.55, 6.8)), 0.08, blend=0.10),
        part_in_heads("overfold", _overfold, ((-0.95, -0.8, 3.8), (1.05, 0.8, 5.25)), 0.08, blend=0.03),
        part_in_heads("girdle", _girdle, ((-0.75, -0.65, 5.0), (0.85, 0.7, 5.32)), 0.06, blend=0.02),
    ]


def smooth_leg() -> Field:
    """Return the free leg that shows through the cloth: thigh, knee and shin."""
    thigh = capsule((-0.26, -0.05, 4.1), (-0.40, -0.56, 2.45), 0.30, 0.235)
    shin = capsule((-0.40, -0.56, 2.45), (-0.46, -0.42, 0.55), 0.215, 0.15)
    return lambda p: smooth_min(thigh(p), shin(p), 0.12)


def sleeve_part(name: str, start: Floats, end: Floats) -> Part:
    """Return a short sleeve: a cuff of folds around the upper arm, from `start` to `end` (3,) in heads."""
    along = (end - start) / np.linalg.norm(end - start)
    side = np.cross(along, [0.0, 1.0, 0.2])
    side = side / np.linalg.norm(side)
    other = np.cross(along, side)
    length = float(np.linalg.norm(end - start))

    def field(p: Floats) -> Floats:
        """Return the cuff (n,) at p (3, n): a cone of tubular folds, its rims waving."""
        q = p - start[:, None]
        t = along @ q
        u, v = side @ q, other @ q
        r, turn = np.hypot(u, v), np.arctan2(v, u)
        radius = 0.22 + 0.06 * np.clip(t / length, 0.0, 1.0)
        phase = 9.0 * turn + 1.3 * np.sin(2.0 * turn) + 2.0 * t
        fold = 0.035 * pipe(phase)
        end_wave = length + 0.04 * np.sin(3.0 * turn) + 0.02 * pipe(phase)
        return 0.75 * smooth_max(r - radius - fold, smooth_max(t - end_wave, -0.1 - t, 0.03), 0.04)

    return part_in_heads(name, field, (start, end), 0.42, blend=0.08)
