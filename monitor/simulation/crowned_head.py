"""The head of the demo's figure: neck and face, waved hair with a knot and two locks, and the mural crown.

In heads: coordinates p (3, n) in, distance-like values (n,) out, negative inside.
"""

from __future__ import annotations

import numpy as np

from monitor.simulation.carving import carve_face
from monitor.simulation.heads import Points, part_in_heads
from monitor.simulation.shapes import capsule, ellipsoid, pipe, placed, smoothstep, tube, turn_by
from monitor.simulation.solid import Field, Part, smooth_max, smooth_min
from projects.model import Floats

_HEAD_AT = (0.02, -0.03, 6.86)  # heads, of the base of the skull
_HEAD_TURN = (-3.0, 3.0, 14.0)  # degrees about x, y and z


def _hair(p: Floats) -> Floats:
    """Waved hair, parted in the middle, drawn back over the ears to a knot at the nape."""
    x, y, z = p
    m = np.stack([np.abs(x), y, z])
    cap = ellipsoid((0.0, 0.08, 0.715), (0.385, 0.465, 0.425))(p)
    # The face stays free: an arch whose top lies at the hairline.
    arch = np.hypot(x / 0.255, (z - 0.52) / 0.335) - 1.0
    free = np.maximum(0.25 * arch, -(y + 0.13))
    strand = np.arctan2(z - 0.70, -(y - 0.02))
    phase = 26.0 * strand + 5.0 * m[0] + 2.4 * np.sin(7.0 * (y + 0.5 * z) + 3.0 * m[0])
    wave = 0.022 * pipe(phase) + 0.012 * pipe(0.5 * phase + 1.0) + 0.018 * np.sin(13.0 * (y + 0.6 * z))
    parting = 0.035 * np.exp(-((x / 0.022) ** 2)) * smoothstep(z, 0.75, 0.9)
    cap = cap - wave + parting
    roll = tube(
        np.array([(0.02, -0.335, 0.93), (0.14, -0.33, 0.86), (0.245, -0.235, 0.68), (0.30, -0.08, 0.50),
                  (0.26, 0.16, 0.38), (0.10, 0.38, 0.36)]),
        np.array([0.06, 0.085, 0.09, 0.095, 0.10, 0.09]), strands=5, relief=0.018, twist=9.0,
    )(m)  # fmt: skip
    cap = smooth_max(cap, -free, 0.03)
    cap = smooth_max(cap, 0.26 - z, 0.05)
    return 0.8 * smooth_min(cap, roll, 0.03)


def _knot(p: Floats) -> Floats:
    """The knot of hair at the nape, wound like a shell."""
    q = p - np.array([0.0, 0.53, 0.40])[:, None]
    r, turn = np.hypot(q[0], q[2]), np.arctan2(q[2], q[0])
    body = ellipsoid((0.0, 0.0, 0.0), (0.20, 0.15, 0.19))(q)
    return 0.8 * (body - 0.02 * pipe(2.0 * turn + 55.0 * r))


def _crown(p: Floats) -> Floats:
    """A mural crown: a ring of masonry with towers and battlements."""
    x, y, z = p[0], p[1] - 0.07, p[2] - 0.16 * p[1]
    r, turn = np.hypot(x / 0.93, y), np.arctan2(x, -y)
    wall = np.abs(r - 0.395 - 0.10 * (z - 1.0)) - 0.040
    tooth = smoothstep(np.cos(24.0 * turn), -0.25, 0.25)
    top = 1.165 + 0.055 * tooth
    tower_turn = (turn + np.pi / 6) % (np.pi / 3) - np.pi / 6
    tower = np.hypot(0.42 * np.sin(tower_turn), np.maximum(np.abs(r - 0.43) - 0.02, 0.0)) - 0.072
    tower_top = 1.27 + 0.045 * smoothstep(np.cos(36.0 * turn), -0.2, 0.2)
    ring = smooth_max(wall, np.maximum(z - top, 0.90 - z), 0.012)
    towers = smooth_max(tower, np.maximum(z - tower_top, 0.90 - z), 0.012)
    value = smooth_min(ring, towers, 0.01)
    band = np.minimum(np.abs(z - 0.93), np.abs(z - 1.12))
    value = value - 0.014 * (1.0 - smoothstep(band, 0.015, 0.028))
    gate = np.maximum(np.abs(0.42 * np.sin(tower_turn)) - 0.028, np.abs(z - 1.03) - 0.055)
    joint = np.minimum(np.abs((z - 0.955) % 0.055), np.abs(z - 0.955) % 0.055)
    value = value + 0.006 * (1.0 - smoothstep(joint, 0.004, 0.010)) * smoothstep(1.11 - z, 0.0, 0.01)
    return 0.8 * smooth_max(value, -np.maximum(gate, 0.40 - r), 0.01)


def head_parts() -> list[Part]:
    """Return neck and throat, then what stands before the arms: face, hair, knot, locks and crown."""
    rotation = turn_by(*_HEAD_TURN)

    def put(name: str, field: Field, points: Points, margin: float, blend: float) -> Part:
        """Return a part given in the head's own frame, within `margin` about `points`."""
        turned = np.asarray(points) @ rotation.T + _HEAD_AT
        return part_in_heads(name, placed(field, at=_HEAD_AT, rotation=rotation), turned.tolist(), margin, blend)

    neck = capsule((0.0, 0.10, 6.45), (0.02, 0.03, 7.25), 0.225, 0.19)
    throat = capsule((0.10, -0.16, 6.62), (0.26, 0.12, 7.2), 0.05, 0.06)
    locks = [
        tube(np.array([(s * 0.30, 0.22, 7.20), (s * 0.36, 0.16, 6.98), (s * 0.33, -0.05, 6.78), (s * 0.37, -0.22, 6.58),
                       (s * 0.33, -0.30, 6.36), (s * 0.36, -0.38, 6.18)]),
             np.array([0.07, 0.075, 0.07, 0.065, 0.055, 0.03]),
             strands=3, relief=0.016, twist=13.0)
        for s in (-1.0, 1.0)
    ]  # fmt: skip
    corners = [(i, j, k) for i in (-0.42, 0.42) for j in (-0.58, 0.55) for k in (0.1, 1.15)]
    crown_box = [(i, j, k) for i in (-0.50, 0.50) for j in (-0.46, 0.60) for k in (0.8, 1.42)]
    return [
        part_in_heads("neck", neck, ((0.0, 0.1, 6.4), (0.0, 0.0, 7.3)), 0.25, blend=0.08),
        part_in_heads("throat", throat, ((0.10, -0.16, 6.62), (0.26, 0.12, 7.2)), 0.08, blend=0.12),
        put("face", carve_face, corners, 0.03, 0.04),
        put("hair", _hair, corners, 0.10, 0.012),
        put("knot", _knot, [(0.0, 0.53, 0.40)], 0.26, 0.03),
        part_in_heads("lock", locks[0], ((-0.40, 0.25, 7.2), (-0.25, -0.45, 6.1)), 0.12, blend=0.02),
        part_in_heads("lock", locks[1], ((0.40, 0.25, 7.2), (0.25, -0.45, 6.1)), 0.12, blend=0.02),
        put("crown", _crown, crown_box, 0.04, 0.008),
    ]
