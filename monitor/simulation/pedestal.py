"""The pedestal of the demo's figure: a square moulded profile, panels, an inscription and a roundel.

Metres; x to the right seen from the front, y away from it, z up from the floor. The front looks towards -y.
"""

from __future__ import annotations

import functools

import numpy as np

from monitor.simulation.inscription import write_line
from monitor.simulation.shapes import Drawing, arc_points, draw_mirrored, draw_strokes, smoothstep
from monitor.simulation.solid import Field, Part, smooth_max
from projects.model import Floats

HEIGHT = 0.42  # m, as all lengths here
HALF_WIDTH = 0.215
DIE_HALF_WIDTH = 0.165
DIE = (0.112, 0.325)  # heights between which the plain block stands
PANEL = (0.128, 0.080)  # half width and half height of the sunk panels
PANEL_DEPTH = 0.004
LETTER_DEPTH = 0.0035
_MIDDLE = 0.5 * (DIE[0] + DIE[1])


_quarter = functools.partial(arc_points, n=12)


def _profile() -> Drawing:
    """Return the section of the pedestal over (half width, height)."""
    half = [(0.0, 0.0), (HALF_WIDTH, 0.0), (HALF_WIDTH, 0.052), (0.196, 0.052)]
    half += _quarter((0.194, 0.066), 0.014, -90, 90)  # torus
    half += [(0.191, 0.080), (0.191, 0.086)]
    half += _quarter((0.191, 0.112), 0.026, 270, 180)  # cavetto
    half += [(DIE_HALF_WIDTH, DIE[0]), (DIE_HALF_WIDTH, DIE[1]), (0.171, DIE[1])]
    half += _quarter((0.171, 0.331), 0.006, -90, 90)  # astragal
    half += [(0.173, 0.337), *_quarter((0.173, 0.369), 0.032, -90, 0)]  # ovolo
    half += [(0.209, 0.369), (0.209, 0.376), (HALF_WIDTH, 0.376), (HALF_WIDTH, 0.406), (0.206, HEIGHT), (0.0, HEIGHT)]
    return draw_mirrored(half, (-0.02, -0.08), (0.33, 0.52), step=0.001)


def _letters() -> Drawing:
    """Return the distance to the strokes of the inscription, over (x, z) on the front."""
    strokes = write_line("HERITAGE", height=0.036, middle=(0.0, _MIDDLE + 0.030), spacing=0.17)
    strokes += write_line("ANNO", height=0.023, middle=(-0.072, _MIDDLE - 0.032), spacing=0.17)
    strokes += write_line("MMXXVI", height=0.023, middle=(0.048, _MIDDLE - 0.032), spacing=0.17)
    return draw_strokes(strokes, (-0.14, _MIDDLE - 0.09), (0.14, _MIDDLE + 0.09), step=0.0005)


def _rosette(u: Floats, v: Floats) -> Floats:
    """Return the height [m] of an eight-leaved rosette with a rim, over a face's middle."""
    r, turn = np.hypot(u, v), np.arctan2(v, u)
    leaf = np.sqrt(np.maximum(1.0 - ((r - 0.027) / 0.020) ** 2, 0.0)) * np.sqrt(
        np.maximum(np.cos(4.0 * turn) ** 2, 0.0)
    )
    leaf = 0.008 * leaf - 0.0025 * (1.0 - smoothstep(np.abs(np.sin(4.0 * turn)) * r, 0.0, 0.004)) * (leaf > 0.0)
    heart = 0.8 * np.sqrt(np.maximum(0.012**2 - r**2, 0.0))
    rim = 0.007 * (1.0 - smoothstep(np.abs(r - 0.058), 0.002, 0.007))
    return np.maximum(leaf, np.maximum(heart, rim))


def pedestal_field() -> Field:
    """Return the field of the whole pedestal, undamaged."""
    profile, letters = _profile(), _letters()

    def field(p: Floats) -> Floats:
        """Return the pedestal (n,) at p (3, n): its section, the sunk panels, the inscription and the rosette."""
        x, y, z = p
        value = profile(smooth_max(np.abs(x), np.abs(y), 0.006), z)
        on_x = np.abs(x) > np.abs(y)
        u, v = np.where(on_x, y, x), z - _MIDDLE
        near_face = smoothstep(np.maximum(np.abs(x), np.abs(y)), DIE_HALF_WIDTH - 0.03, DIE_HALF_WIDTH - 0.015)
        inside = np.minimum(PANEL[0] - np.abs(u), PANEL[1] - np.abs(v))
        carved = PANEL_DEPTH * smoothstep(inside, 0.0, 0.007)
        front = ~on_x & (y < 0.0)
        stroke = letters(x, z)
        groove = LETTER_DEPTH * (1.0 - smoothstep(stroke, 0.0, 0.0042))
        carved = carved + np.where(front & (inside > 0.005), groove, 0.0)
        right = on_x & (x > 0.0)
        carved = carved - np.where(right & (inside > 0.01), _rosette(u, v), 0.0)
        return value + near_face * carved

    return field


def pedestal_part() -> Part:
    """Return the pedestal as a part of a solid."""
    low, high = np.array([-HALF_WIDTH, -HALF_WIDTH, 0.0]), np.array([HALF_WIDTH, HALF_WIDTH, HEIGHT])
    return Part("pedestal", pedestal_field(), np.stack([low - 0.004, high + 0.004]), blend=0.0)
