"""The demo's figure: an allegory with a mural crown, a raised torch and a shield, in a girded robe and a cloak.

Made of parts in units of its head's height (an eighth of the figure), x to the right seen from the front, y away from
it, z up from the soles. `statue_parts` hands them over in metres, standing on the pedestal.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from monitor.simulation.pedestal import HEIGHT
from monitor.simulation.shapes import (
    ball,
    box,
    capsule,
    draw_polygon,
    ellipsoid,
    pipe,
    placed,
    smoothstep,
    tube,
)
from monitor.simulation.solid import Field, Part, smooth_max, smooth_min
from projects.model import Floats
from projects.transforms import rotation_from_vector

HEAD = 0.128  # m, height of the head: the unit of this file
Points = Sequence[ArrayLike]


def turn_by(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Floats:
    """Return the rotation by degrees about x, then y, then z."""
    rx, ry, rz = (rotation_from_vector(np.radians(a) * e) for a, e in zip((x, y, z), np.eye(3), strict=True))
    return rz @ ry @ rx


def _part(name: str, field: Field, box_points: Points, margin: float, blend: float = 0.0, cut: bool = False) -> Part:
    """Return a part given in heads as one in metres on the pedestal."""
    corner = np.asarray(box_points, dtype=float)
    low, high = corner.min(axis=0) - margin, corner.max(axis=0) + margin
    lift = np.array([0.0, 0.0, HEIGHT])
    metres = np.stack([HEAD * low + lift, HEAD * high + lift])
    return Part(name, placed(field, at=lift, scale=HEAD), metres, blend * HEAD, cut)


# The robe --------------------------------------------------------------------------------------------------------

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
    k0 = np.sqrt((dx / rx) ** 2 + (dy / ry) ** 2)
    k1 = np.sqrt((dx / rx**2) ** 2 + (dy / ry**2) ** 2)
    distance = k0 * (k0 - 1.0) / np.maximum(k1, 1e-6)
    return np.where(k0 < 0.05, -ry, distance), np.arctan2(dx, -dy), h


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


def _robe() -> list[Part]:
    whole = ((-1.15, -1.05, 0.0), (1.15, 1.05, 5.2))
    leg = smooth_leg()
    return [
        _part("skirt", _skirt, whole, 0.08),
        _part("leg", leg, ((-0.52, -0.85, 0.3), (-0.1, 0.1, 4.2)), 0.36, blend=0.22),
        _part("bodice", _bodice, ((-0.95, -0.55, 4.6), (0.95, 0.55, 6.8)), 0.08, blend=0.10),
        _part("overfold", _overfold, ((-0.95, -0.8, 3.8), (1.05, 0.8, 5.25)), 0.08, blend=0.03),
        _part("girdle", _girdle, ((-0.75, -0.65, 5.0), (0.85, 0.7, 5.32)), 0.06, blend=0.02),
    ]


def smooth_leg() -> Field:
    """Return the free leg that shows through the cloth: thigh, knee and shin."""
    thigh = capsule((-0.26, -0.05, 4.1), (-0.40, -0.56, 2.45), 0.30, 0.235)
    shin = capsule((-0.40, -0.56, 2.45), (-0.46, -0.42, 0.55), 0.215, 0.15)
    return lambda p: smooth_min(thigh(p), shin(p), 0.12)


def _feet() -> list[Part]:
    parts = []
    for name, heel, ball_of_foot, spread in (
        ("free foot", (-0.47, -0.55, 0.16), (-0.58, -1.02, 0.10), -0.22),
        ("standing foot", (0.34, -0.5, 0.16), (0.42, -0.93, 0.10), 0.18),
    ):
        instep = capsule(heel, ball_of_foot, 0.17, 0.115)
        forward = np.array([np.sin(spread), -np.cos(spread), 0.0])
        across = np.array([np.cos(spread), np.sin(spread), 0.0])
        tip = np.array(ball_of_foot)
        toes = [
            capsule(
                tip + across * (0.052 * (k - 2)) + forward * 0.03 - np.array([0, 0, 0.015]),
                tip + across * (0.058 * (k - 2)) + forward * (0.20 - 0.018 * abs(k - 1.6)) - np.array([0, 0, 0.04]),
                0.042, 0.034,
            )
            for k in range(5)
        ]  # fmt: skip

        def foot(p: Floats, instep: Field = instep, toes: list[Field] = toes) -> Floats:
            value = instep(p)
            for toe in toes:
                value = smooth_min(value, toe(p), 0.02)
            return smooth_max(value, 0.0 - p[2], 0.01)

        parts.append(_part(name, foot, (heel, ball_of_foot), 0.34, blend=0.03))
    sole = box((-0.06, -0.12, 0.06), (1.28, 1.22, 0.10), 0.04)
    return [_part("base", sole, ((-1.34, -1.34, -0.04), (1.22, 1.10, 0.16)), 0.01), *parts]


# The cloak -------------------------------------------------------------------------------------------------------


def _cloak(p: Floats) -> Floats:
    """The cloak on the back: from the shoulders to the ankles, deep folds falling from the left shoulder."""
    x, y, z = p
    h = np.clip(z, 0.4, 6.5)
    rx = np.interp(h, [0.4, 2.0, 4.0, 5.2, 6.0, 6.5], [1.08, 0.98, 0.90, 0.80, 0.84, 0.70])
    ry = np.interp(h, [0.4, 2.0, 4.0, 5.2, 6.0, 6.5], [0.98, 0.86, 0.74, 0.66, 0.60, 0.36])
    dx, dy = x - 0.03, y - 0.04
    k0 = np.sqrt((dx / rx) ** 2 + (dy / ry) ** 2)
    k1 = np.sqrt((dx / rx**2) ** 2 + (dy / ry**2) ** 2)
    distance = k0 * (k0 - 1.0) / np.maximum(k1, 1e-6)
    turn = np.arctan2(dx, dy)  # zero at the back
    sweep = (h - 0.4) * (1.3 + 0.9 * np.tanh(1.5 * (turn + 0.3)))
    phase = 10.0 * (turn + 0.10 * sweep) + 1.1 * np.sin(2.0 * turn + 0.5 * h)
    depth = 0.022 + 0.070 * smoothstep(6.3 - h, 0.0, 3.5)
    fold = depth * pipe(phase) + 0.015 * np.sin(2.0 * phase + 1.0)
    edge = 0.30 * (y - 0.12 - 0.10 * np.sin(1.7 * h) + 0.30 * smoothstep(h, 5.6, 6.5) - 0.05 * np.sin(phase)) / 0.30
    hem = 0.42 + 0.16 * np.sin(turn * 2.0 + 0.8) + 0.05 * pipe(phase)
    cut = smooth_max(-edge, smooth_max(p[2] - 6.62, hem - p[2], 0.05), 0.05)
    return smooth_max(0.75 * smooth_max(distance - fold, -(distance - fold) - 0.20, 0.03), cut, 0.06)


def _mantle() -> list[Part]:
    """The rolled edge of the cloak across the body: shoulder, breast, hip; and the end that hangs from the arm."""
    t = np.linspace(0.0, 1.0, 15)
    course = CubicSpline(
        [0.0, 0.2, 0.45, 0.7, 0.9, 1.0],
        [(0.50, 0.30, 6.50), (0.50, -0.10, 6.62), (0.24, -0.47, 5.95), (-0.22, -0.56, 5.20), (-0.66, -0.36, 4.62),
         (-0.80, 0.12, 4.40)],
    )(t)  # fmt: skip
    radii = np.interp(t, [0.0, 0.2, 0.6, 1.0], [0.14, 0.115, 0.15, 0.17])
    roll = tube(course, radii, strands=6, relief=0.035, twist=1.6)
    return [_part("roll", roll, course.tolist(), 0.24, blend=0.05)]


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


# Arms and what they hold -----------------------------------------------------------------------------------------


def carve_hand(wrist: Floats, towards: Floats, palm: Floats, curl: float) -> Field:
    """Return a hand: a palm from the wrist `towards` its fingers, facing `palm`, the fingers curled by `curl` rad."""
    forward = towards / np.linalg.norm(towards)
    inward = palm - forward * (palm @ forward)
    inward = inward / np.linalg.norm(inward)
    across = np.cross(forward, inward)
    knuckles = wrist + 0.34 * forward
    pieces: list[tuple[Field, float]] = [(capsule(wrist, wrist + 0.10 * forward, 0.085, 0.095), 0.0)]
    for k in range(4):
        base = knuckles + across * (0.075 * (k - 1.5)) - 0.02 * abs(k - 1.2) * forward
        pieces.append((capsule(wrist + 0.08 * forward + across * (0.05 * (k - 1.5)), base, 0.058, 0.052), 0.05))
        at, heading = base, 0.25 * curl
        for length, radius in ((0.17, 0.046), (0.12, 0.041), (0.09, 0.036)):
            step = length * (np.cos(heading) * forward + np.sin(heading) * inward)
            pieces.append((capsule(at, at + step, radius + 0.003, radius), 0.012))
            at, heading = at + step, heading + curl
    thumb = wrist + 0.13 * forward - 0.10 * across + 0.03 * inward
    middle = thumb + 0.16 * forward - 0.05 * across + 0.09 * inward
    pieces.append((capsule(wrist + 0.05 * forward - 0.04 * across, thumb, 0.07, 0.058), 0.05))
    pieces.append((capsule(thumb, middle, 0.054, 0.046), 0.015))
    pieces.append((capsule(middle, middle + 0.11 * forward + 0.07 * inward + 0.03 * across, 0.045, 0.036), 0.012))

    def field(p: Floats) -> Floats:
        value = pieces[0][0](p)
        for piece, blend in pieces[1:]:
            value = smooth_min(value, piece(p), blend)
        return value

    return field


def _right_arm() -> list[Part]:
    """The arm raised with the torch, on the left seen from the front."""
    shoulder, elbow, wrist = (
        np.array([-0.76, 0.06, 6.36]),
        np.array([-1.42, -0.22, 6.22]),
        np.array([-1.36, -0.52, 7.26]),
    )
    upper, fore = capsule(shoulder, elbow, 0.20, 0.155), capsule(elbow, wrist, 0.15, 0.092)
    muscle = ellipsoid(0.6 * elbow + 0.4 * wrist, (0.15, 0.15, 0.30), turn_by(y=4, x=14))
    arm = _part("raised arm", lambda p: smooth_min(smooth_min(upper(p), fore(p), 0.06), muscle(p), 0.1),
                (shoulder, elbow, wrist), 0.25, blend=0.14)  # fmt: skip
    torch_x, torch_y = -1.36, -0.66
    grip = carve_hand(wrist, np.array([0.02, -0.16, 0.30]), np.array([0.35, -0.95, -0.3]), 1.15)
    hand = _part("torch hand", grip, (wrist, wrist + np.array([0.0, -0.2, 0.5])), 0.32, blend=0.04)

    def torch(p: Floats) -> Floats:
        x, y, z = p[0] - torch_x, p[1] - torch_y, p[2]
        r, turn = np.hypot(x, y), np.arctan2(y, x)
        shaft = np.interp(z, [6.9, 7.0, 7.1, 8.1, 8.25, 8.3, 8.36, 8.42, 8.6, 8.66, 8.7],
                          [0.03, 0.085, 0.07, 0.105, 0.15, 0.19, 0.16, 0.17, 0.27, 0.29, 0.27])  # fmt: skip
        flute = 0.010 * pipe(8.0 * turn) * smoothstep(z, 7.15, 7.3) * smoothstep(8.15 - z, 0.0, 0.15)
        return smooth_max(0.8 * (r - shaft - flute), np.abs(z - 7.79) - 0.90, 0.03)

    def flame(p: Floats) -> Floats:
        x, y, z = p[0] - torch_x, p[1] - torch_y, p[2]
        rise = np.clip((z - 8.6) / 0.95, 0.0, 1.0)
        bend = 0.14 * np.sin(3.2 * rise)
        x = x - bend * rise
        r, turn = np.hypot(x, y), np.arctan2(y, x)
        profile = 0.27 * (1.0 - rise) ** 0.75 * (0.75 + 0.9 * rise)
        tongues = 0.05 * (1.0 - 0.8 * rise) * pipe(5.0 * turn + 5.0 * rise)
        return smooth_max(0.65 * (r - profile - tongues), np.abs(z - 9.05) - 0.52, 0.04)

    return [
        arm,
        _part("torch", torch, ((torch_x, torch_y, 6.89), (torch_x, torch_y, 8.7)), 0.32, blend=0.01),
        hand,
        _part("flame", flame, ((torch_x, torch_y, 8.5), (torch_x, torch_y, 9.6)), 0.42, blend=0.05),
        _sleeve("right sleeve", shoulder, 0.55 * elbow + 0.45 * shoulder),
    ]


def _sleeve(name: str, start: Floats, end: Floats) -> Part:
    """A short sleeve: a cuff of folds around the upper arm."""
    along = (end - start) / np.linalg.norm(end - start)
    side = np.cross(along, [0.0, 1.0, 0.2])
    side = side / np.linalg.norm(side)
    other = np.cross(along, side)
    length = float(np.linalg.norm(end - start))

    def field(p: Floats) -> Floats:
        q = p - start[:, None]
        t = along @ q
        u, v = side @ q, other @ q
        r, turn = np.hypot(u, v), np.arctan2(v, u)
        radius = 0.22 + 0.06 * np.clip(t / length, 0.0, 1.0)
        phase = 9.0 * turn + 1.3 * np.sin(2.0 * turn) + 2.0 * t
        fold = 0.035 * pipe(phase)
        end_wave = length + 0.04 * np.sin(3.0 * turn) + 0.02 * pipe(phase)
        return 0.75 * smooth_max(r - radius - fold, smooth_max(t - end_wave, -0.1 - t, 0.03), 0.04)

    return _part(name, field, (start, end), 0.42, blend=0.08)


_SHIELD_AT = (0.93, -0.93, 1.90)
_SHIELD_TURN = (-9.0, 2.0, 20.0)


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


def _shield() -> list[Part]:
    """The shield that stands at her left: rim with beads, a tower in relief."""
    outline = draw_polygon(_shield_outline(), (-1.2, -2.0), (1.2, 2.0), step=0.006)
    tower = draw_polygon(_tower_outline(), (-0.9, -1.2), (0.9, 1.3), step=0.004)

    def relief(u: Floats, v: Floats, edge: Floats) -> Floats:
        rim = 0.055 * (1.0 - smoothstep(np.abs(edge + 0.075), 0.045, 0.075))
        studs = [np.hypot(np.abs(u) - a, v - b) for a, b in ((0.52, 1.22), (0.50, 0.35), (0.50, -0.35), (0.36, -0.95))]
        studs += [np.hypot(u, v - b) for b in (1.16, -1.25)]
        beads = 0.9 * np.sqrt(np.maximum(0.055**2 - np.min(studs, axis=0) ** 2, 0.0))
        castle = 0.06 * (1.0 - smoothstep(tower(u, v), -0.03, 0.005))
        gate = np.minimum(np.hypot(u, v + 0.35) - 0.13, np.maximum(np.abs(u) - 0.13, np.abs(v + 0.50) - 0.15))
        castle = castle - 0.05 * (1.0 - smoothstep(gate, -0.02, 0.01))
        window = np.maximum(np.abs(u) - 0.05, np.abs(v - 0.28) - 0.10)
        castle = castle - 0.045 * (1.0 - smoothstep(window, -0.02, 0.01))
        course = np.minimum(np.abs(v + 0.10), np.abs(v - 0.47)) * 1.0
        castle = castle + 0.02 * (1.0 - smoothstep(course, 0.015, 0.03)) * (1.0 - smoothstep(tower(u, v), -0.02, 0.01))
        return rim + beads + castle

    def field(p: Floats) -> Floats:
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
        _part("shield", turned, whole.tolist(), 0.05, blend=0.0),
        _part("shield support", rock, ((0.93, -0.90, 0.18),), 0.36, blend=0.05),
    ]


def shield_corner() -> Floats:
    """Return the middle of the shield's outer upper corner, in metres: the piece that is lost."""
    local = np.array([0.735, 0.0, 1.50])
    return HEAD * (turn_by(*_SHIELD_TURN) @ local + _SHIELD_AT) + [0.0, 0.0, HEIGHT]


def _left_arm() -> list[Part]:
    """The arm that rests on the shield, on the right seen from the front."""
    shoulder, elbow, wrist = np.array([0.76, 0.06, 6.36]), np.array([1.12, 0.20, 5.00]), np.array([0.98, -0.52, 3.98])
    upper, fore = capsule(shoulder, elbow, 0.19, 0.15), capsule(elbow, wrist, 0.145, 0.092)
    muscle = ellipsoid(0.65 * elbow + 0.35 * wrist, (0.145, 0.145, 0.26), turn_by(x=-35, y=-8))
    arm = lambda p: smooth_min(smooth_min(upper(p), fore(p), 0.06), muscle(p), 0.1)  # noqa: E731
    hand = carve_hand(wrist, np.array([-0.05, -0.30, -0.42]), np.array([0.0, 0.9, -0.5]), 0.45)
    return [
        _part("lowered arm", arm, (shoulder, elbow, wrist), 0.25, blend=0.12),
        _part("shield hand", hand, (wrist, wrist + np.array([0.0, -0.35, -0.5])), 0.30, blend=0.03),
        _sleeve("left sleeve", shoulder, 0.55 * elbow + 0.45 * shoulder),
        _part("cascade", _cascade, ((0.6, -0.2, 1.2), (1.5, 0.55, 5.15)), 0.06, blend=0.06),
    ]


# The head --------------------------------------------------------------------------------------------------------

_HEAD_AT = (0.02, -0.03, 6.86)
_HEAD_TURN = (-3.0, 3.0, 14.0)


def carve_face(p: Floats) -> Floats:
    """The face and skull; origin at the base of the skull, the face towards -y, its chin at z = 0.14."""
    x = np.abs(p[0])
    m = np.stack([x, p[1], p[2]])
    skull = ellipsoid((0.0, 0.07, 0.72), (0.335, 0.415, 0.38))(p)
    value = smooth_min(skull, ellipsoid((0.0, -0.17, 0.50), (0.262, 0.27, 0.37))(p), 0.12)
    value = smooth_min(value, ellipsoid((0.0, -0.335, 0.215), (0.10, 0.085, 0.075))(p), 0.09)  # chin
    value = smooth_min(value, ball((0.155, -0.315, 0.475), 0.085)(m), 0.10)  # cheek
    socket = ellipsoid((0.125, -0.455, 0.615), (0.092, 0.060, 0.050))(m)
    value = smooth_max(value, -socket, 0.05)
    value = smooth_min(value, capsule((0.045, -0.425, 0.680), (0.175, -0.385, 0.690), 0.024, 0.020)(m), 0.035)  # brow
    eye = ellipsoid((0.125, -0.368, 0.612), (0.068, 0.062, 0.050))(m)
    value = smooth_min(value, eye, 0.008)
    for lift, sink in ((0.034, -0.002), (-0.031, 0.004)):
        lid = capsule((0.070, -0.410 + sink, 0.612 + 0.55 * lift), (0.125, -0.425 + sink, 0.612 + lift), 0.011)(m)
        lid = np.minimum(lid, capsule((0.125, -0.425 + sink, 0.612 + lift), (0.190, -0.375, 0.606), 0.011, 0.008)(m))
        value = smooth_min(value, lid, 0.010)
    bridge = capsule((0.0, -0.420, 0.665), (0.0, -0.520, 0.475), 0.034, 0.044)(p)
    value = smooth_min(value, bridge, 0.035)
    value = smooth_min(value, ball((0.0, -0.535, 0.462), 0.036)(p), 0.02)
    value = smooth_min(value, ball((0.045, -0.470, 0.452), 0.030)(m), 0.018)  # nostril wing
    value = smooth_max(value, -capsule((0.022, -0.50, 0.428), (0.030, -0.475, 0.440), 0.011)(m), 0.008)
    upper = capsule((0.0, -0.452, 0.352), (0.085, -0.405, 0.343), 0.024, 0.010)(m)
    lower = capsule((0.0, -0.446, 0.312), (0.070, -0.408, 0.330), 0.027, 0.012)(m)
    value = smooth_min(value, upper, 0.014)
    value = smooth_min(value, lower, 0.014)
    value = smooth_max(value, -capsule((0.0, -0.482, 0.334), (0.090, -0.420, 0.338), 0.006)(m), 0.008)
    return smooth_max(value, -capsule((0.0, -0.470, 0.392), (0.0, -0.462, 0.375), 0.008)(p), 0.012)  # philtrum


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
    gate = np.maximum(
        np.hypot(0.42 * np.sin(tower_turn), np.minimum(z - 1.03, 0.0) * 0.0) - 0.028, np.abs(z - 1.03) - 0.055
    )
    joint = np.minimum(np.abs((z - 0.955) % 0.055), np.abs(z - 0.955) % 0.055)
    value = value + 0.006 * (1.0 - smoothstep(joint, 0.004, 0.010)) * smoothstep(1.11 - z, 0.0, 0.01)
    return 0.8 * smooth_max(value, -np.maximum(gate, 0.40 - r), 0.01)


def _head() -> list[Part]:
    rotation = turn_by(*_HEAD_TURN)

    def put(name: str, field: Field, points: Points, margin: float, blend: float) -> Part:
        turned = np.asarray(points) @ rotation.T + _HEAD_AT
        return _part(name, placed(field, at=_HEAD_AT, rotation=rotation), turned.tolist(), margin, blend)

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
        _part("neck", neck, ((0.0, 0.1, 6.4), (0.0, 0.0, 7.3)), 0.25, blend=0.08),
        _part("throat", throat, ((0.10, -0.16, 6.62), (0.26, 0.12, 7.2)), 0.08, blend=0.12),
        put("face", carve_face, corners, 0.03, 0.04),
        put("hair", _hair, corners, 0.10, 0.012),
        put("knot", _knot, [(0.0, 0.53, 0.40)], 0.26, 0.03),
        _part("lock", locks[0], ((-0.40, 0.25, 7.2), (-0.25, -0.45, 6.1)), 0.12, blend=0.02),
        _part("lock", locks[1], ((0.40, 0.25, 7.2), (0.25, -0.45, 6.1)), 0.12, blend=0.02),
        put("crown", _crown, crown_box, 0.04, 0.008),
    ]


def statue_parts() -> tuple[Part, ...]:
    """Return the figure's parts in metres, standing on the pedestal, in the order in which they are joined."""
    cloak = _part("cloak", _cloak, ((-1.2, -0.35, 0.3), (1.25, 1.2, 6.65)), 0.05, blend=0.06)
    return (
        *_feet(), *_robe(), cloak, *_mantle(), *_head()[:2], *_right_arm(), *_left_arm(), *_head()[2:], *_shield(),
    )  # fmt: skip
