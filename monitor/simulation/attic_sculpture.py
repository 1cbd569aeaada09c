"""The attic sculpture of paper 001: a commander in cuirass and cloak, 2.5 m on his pedestal, whose limbs occlude.

One arm is raised with a baton, the other held before the chest, cloth hangs from it, the cloak falls behind to a tree
trunk: the chest behind the arm and the inside of the cloak are seen from few stations only. Made of parts in units of
his head (x to the right seen from the front, y away, z up from the soles); metres come at the end. The pedestal, the
raised arm (let in with a dowel, as such arms are) and the figure are parts of the model.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from monitor.boxes import corners_of
from monitor.simulation.carving import carve_face, carve_hand
from monitor.simulation.changes import Edit
from monitor.simulation.model import Model, ModelPart, build_scene
from monitor.simulation.scenes import Scene, make_box
from monitor.simulation.shapes import (
    Drawing,
    box,
    capsule,
    draw_mirrored,
    ellipsoid,
    pipe,
    placed,
    smoothstep,
    tube,
    turn_by,
)
from monitor.simulation.solid import Field, Part, Solid, join_blended, smooth_max, smooth_min
from projects.model import Floats

HEAD = 0.247  # m, the unit of this file
PEDESTAL_HEIGHT = 0.36  # m
REFLECTANCE = 0.55  # weathered limestone; assumed
_HEAD_AT, _HEAD_TURN = (-0.02, -0.04, 6.42), (-4.0, -2.0, -22.0)


def _part(name: str, field: Field, low: Sequence[float], high: Sequence[float], blend: float = 0.0) -> Part:
    """Return a part given in heads as one in metres on the pedestal."""
    lift = np.array([0.0, 0.0, PEDESTAL_HEIGHT])
    corners = HEAD * np.array([low, high]) + lift
    return Part(name, placed(field, at=lift, scale=HEAD), corners, blend * HEAD)


def _around(points: ArrayLike, margin: float) -> tuple[list[float], list[float]]:
    """Return the corners of the box about points, widened."""
    at = np.asarray(points, dtype=float)
    return (at.min(axis=0) - margin).tolist(), (at.max(axis=0) + margin).tolist()


# Legs and body -------------------------------------------------------------------------------------------------------


def _leg(hip: Sequence[float], knee: Sequence[float], ankle: Sequence[float], toe: Sequence[float]) -> Field:
    """A leg with greave and boot: thigh, knee, calf, foot."""
    h, k, a, t = (np.asarray(v, dtype=float) for v in (hip, knee, ankle, toe))
    back = np.array([0.0, 0.10, 0.0])
    pieces = [
        (capsule(h, k, 0.34, 0.205), 0.0), (ellipsoid(0.55 * h + 0.45 * k - [0, 0.07, 0], (0.27, 0.29, 0.60)), 0.15),
        (capsule(k, a, 0.185, 0.115), 0.10), (ellipsoid(0.68 * k + 0.32 * a + back, (0.19, 0.19, 0.42)), 0.12),
        (ellipsoid(k - [0, 0.11, 0], (0.12, 0.10, 0.15)), 0.06), (capsule(a - [0, 0, 0.10], t, 0.150, 0.095), 0.08),
        (capsule(a + back * 0.6 - [0, 0, 0.14], a - [0, 0, 0.1], 0.13, 0.13), 0.06),
    ]  # fmt: skip
    limb = join_blended(pieces)

    def field(p: Floats) -> Floats:
        """Return the limb (n,) at p (3, n), with the rim of the boot, cut off at the ground."""
        value = limb(p)
        cuff = np.abs(p[2] - 0.42 * k[2] - 0.58 * a[2]) - 0.03  # the rim of the boot
        rim = np.maximum(value - 0.035, cuff)
        return smooth_max(smooth_min(value, rim, 0.02), -p[2], 0.01)

    return field


def _cuirass(p: Floats) -> Floats:
    """The muscled breastplate."""
    x, y, z = p
    m = np.stack([np.abs(x), y, z])
    value = smooth_min(
        ellipsoid((0.0, 0.02, 5.40), (0.66, 0.43, 0.68))(p), ellipsoid((0.03, 0.0, 4.50), (0.52, 0.37, 0.72))(p), 0.30
    )
    value = smooth_min(value, ellipsoid((0.29, -0.27, 5.52), (0.30, 0.17, 0.25))(m), 0.09)  # breast
    for height, reach in ((5.02, 0.15), (4.72, 0.145), (4.42, 0.14)):
        value = smooth_min(value, ellipsoid((0.14, -0.34, height), (0.135, 0.09, 0.13))(m), 0.05)
        value = smooth_min(
            value, ellipsoid((0.40 - 0.4 * (5.02 - height), -0.24, height), (reach, 0.09, 0.12))(m), 0.06
        )
    value = smooth_min(value, capsule((0.30, 0.02, 6.02), (0.76, 0.03, 5.92), 0.20, 0.22)(m), 0.20)
    rim = np.maximum(np.abs(z - 3.98 - 0.16 * x * x + 0.14 * np.cos(4.0 * x)) - 0.045, value - 0.04)
    medusa = np.hypot(x, z - 5.62) - 0.11
    boss = np.maximum(medusa, np.abs(y + 0.44) - 0.06)
    return 0.9 * smooth_min(smooth_min(value, rim, 0.03), boss, 0.03)


def _straps(p: Floats) -> Floats:
    """The leather straps that hang from the cuirass, in two rows with fringes."""
    x, y, z = p[0] - 0.03, p[1], p[2]
    turn = np.arctan2(x, -y)
    value = np.full(p.shape[1], np.inf)
    for top, low, wide, number, start in ((4.08, 3.02, 0.60, 22.0, 0.0), (4.10, 3.55, 0.66, 22.0, 0.5)):
        out = wide + 0.16 * (top - z)
        k0 = np.sqrt((x / out) ** 2 + (y / (0.80 * out)) ** 2)
        shell = np.abs((k0 - 1.0) * 0.85 * out) - 0.045
        phase = number * turn / (2.0 * np.pi) + start
        strap = np.abs(phase - np.round(phase)) * 2.0
        gap = 0.05 * smoothstep(strap, 0.80, 1.0)
        fringe = 0.010 * np.cos(5.0 * np.pi * strap) * smoothstep(low + 0.22 - z, 0.0, 0.03)
        end = smooth_max(low + 0.03 * strap**2 - z, z - top, 0.02)
        value = smooth_min(value, smooth_max(shell + gap - fringe, end, 0.03), 0.01)
    filled = np.hypot(x / 0.60, y / 0.47) - 1.0
    return 0.7 * smooth_min(value, np.maximum(0.45 * filled, np.maximum(3.35 - z, z - 4.1)), 0.05)


def _body_parts() -> list[Part]:
    """Return the ground, the tree trunk, the legs, the straps and the cuirass."""
    standing = _leg((0.30, 0.02, 3.70), (0.37, -0.08, 2.02), (0.36, 0.06, 0.30), (0.50, -0.52, 0.10))
    free = _leg((-0.26, -0.02, 3.70), (-0.46, -0.40, 2.00), (-0.62, 0.02, 0.32), (-0.92, -0.44, 0.10))
    trunk_line = np.array([(0.82, 0.42, -0.05), (0.74, 0.36, 0.9), (0.62, 0.34, 1.8), (0.52, 0.30, 2.7)])
    bark = tube(trunk_line, np.array([0.36, 0.27, 0.24, 0.22]), strands=9, relief=0.022, twist=0.9)
    rock = box((0.0, 0.05, -0.03), (1.35, 1.00, 0.13), 0.05)
    uneven: Field = lambda p: rock(p) + 0.02 * np.sin(5.0 * p[0] + 2.0) * np.sin(6.0 * p[1]) * np.sin(4.0 * p[2] + 1.0)  # noqa: E731
    return [
        _part("ground", uneven, (-1.42, -1.02, -0.2), (1.42, 1.12, 0.15)),
        _part("trunk", lambda p: smooth_max(bark(p), -0.05 - p[2], 0.01), (0.2, -0.05, -0.06), (1.3, 0.9, 3.0), 0.06),
        _part("standing leg", standing, (-0.1, -0.75, 0.0), (0.75, 0.45, 4.1), 0.04),
        _part("free leg", free, (-1.1, -0.85, 0.0), (0.15, 0.45, 4.1), 0.04),
        _part("straps", _straps, (-0.9, -0.8, 2.9), (0.95, 0.8, 4.2), 0.03),
        _part("cuirass", _cuirass, (-1.05, -0.60, 3.7), (1.05, 0.55, 6.3), 0.03),
    ]


# Cloak ---------------------------------------------------------------------------------------------------------------


def _cloak(p: Floats) -> Floats:
    """The cloak: from the shoulders over the back to the ground, in deep folds that swing out to one side."""
    x, y, z = p
    h = np.clip(z, 0.1, 6.2)
    swing = 0.22 * (6.2 - h) ** 1.3 / 6.2
    rx = np.interp(h, [0.1, 1.5, 3.5, 5.0, 5.8, 6.2], [1.02, 0.98, 0.90, 0.84, 0.82, 0.60])
    ry = np.interp(h, [0.1, 1.5, 3.5, 5.0, 5.8, 6.2], [0.90, 0.86, 0.76, 0.62, 0.50, 0.30])
    dx, dy = x - 0.8 * swing, y - 0.02
    k0, k1 = np.hypot(dx / rx, dy / ry), np.hypot(dx / rx**2, dy / ry**2)
    distance = k0 * (k0 - 1.0) / np.maximum(k1, 1e-6)
    turn = np.arctan2(dx, dy)
    phase = 8.0 * turn + 0.8 * (6.2 - h) * np.tanh(turn + 0.4) + 1.2 * np.sin(1.7 * turn + 0.6 * h)
    depth = 0.02 + 0.085 * smoothstep(6.0 - h, 0.0, 3.0)
    fold = depth * pipe(phase) + 0.018 * np.sin(2.0 * phase + 0.7 * h)
    sheet = smooth_max(distance - fold, -(distance - fold) - 0.17, 0.03)
    edge = 0.10 + 0.12 * np.sin(1.3 * h + 0.5) - y + 0.05 * np.sin(phase)
    hem = 0.12 + 0.10 * np.sin(2.0 * turn) + 0.05 * pipe(phase) - z
    return 0.72 * smooth_max(sheet, smooth_max(edge, smooth_max(hem, z - 6.28, 0.05), 0.05), 0.05)


def _fall(p: Floats) -> Floats:
    """The end of the cloak that hangs over the forearm before the body, in a zigzag fall."""
    x, y, z = p
    h = np.clip(z, 2.2, 5.2)
    u, v = x - 0.70 - 0.05 * (5.0 - h), y + 0.52 + 0.05 * (5.0 - h)
    wide = 0.19 + 0.045 * (5.2 - h)
    zigzag = 0.085 * np.sin(12.0 * u + 2.0 * np.sin(1.1 * h) + 0.4) + 0.025 * np.sin(25.0 * u + h)
    slab = smooth_max(np.abs(v + zigzag) - 0.10, np.abs(u) - wide, 0.06)
    hem = 2.35 + 0.8 * np.abs(u - 0.1) + 0.07 * np.sin(24.0 * u) - z
    return 0.68 * smooth_max(slab, smooth_max(z - 5.12, hem, 0.04), 0.05)


def _cloak_parts() -> list[Part]:
    """Return the cloak, its rolled edge over the shoulders, and the cloth that falls from the arm."""
    course = CubicSpline(
        [0.0, 0.25, 0.5, 0.75, 1.0],
        [(-0.72, 0.22, 6.05), (-0.52, -0.18, 6.24), (0.0, -0.40, 6.02), (0.52, -0.16, 6.26), (0.76, 0.24, 6.02)],
    )(np.linspace(0.0, 1.0, 13))  # fmt: skip
    roll = tube(
        course, np.interp(np.linspace(0, 1, 13), [0, 0.5, 1], [0.15, 0.11, 0.16]), strands=5, relief=0.03, twist=2.2
    )
    return [
        _part("cloak", _cloak, (-1.3, -0.35, -0.06), (1.6, 1.25, 6.35), 0.05),
        _part("roll", roll, *_around(course, 0.24), 0.04),
        _part("fall", _fall, (0.1, -1.0, 2.1), (1.35, -0.15, 5.25), 0.04),
    ]


# Arms ----------------------------------------------------------------------------------------------------------------


def _arm(shoulder: Floats, elbow: Floats, wrist: Floats) -> Field:
    """A bare arm with a short strapped sleeve."""
    upper, fore = capsule(shoulder, elbow, 0.215, 0.150), capsule(elbow, wrist, 0.150, 0.095)
    biceps = capsule(0.7 * shoulder + 0.3 * elbow, 0.35 * shoulder + 0.65 * elbow, 0.175, 0.165)
    belly = capsule(0.85 * elbow + 0.15 * wrist, 0.5 * elbow + 0.5 * wrist, 0.155, 0.125)

    def field(p: Floats) -> Floats:
        """Return the arm (n,) at p (3, n), with the folded sleeve about its upper end."""
        value = smooth_min(smooth_min(upper(p), biceps(p), 0.10), smooth_min(fore(p), belly(p), 0.08), 0.06)
        along = (elbow - shoulder) / np.linalg.norm(elbow - shoulder)
        run = along @ (p - shoulder[:, None])
        side = np.cross(along, [0.0, 1.0, 0.1])
        turn = np.arctan2(np.cross(along, side) @ (p - shoulder[:, None]), side @ (p - shoulder[:, None]))
        sleeve = smooth_max(upper(p) - 0.075 - 0.02 * pipe(9.0 * turn), smooth_max(run - 0.52, -run - 0.1, 0.03), 0.04)
        return smooth_min(value, 0.8 * sleeve, 0.02)

    return field


def _held_arm() -> list[Part]:
    """The arm before the chest: it hides the breastplate behind it from most stations."""
    shoulder, elbow, wrist = np.array([0.80, 0.02, 5.86]), np.array([1.06, -0.30, 4.82]), np.array([0.34, -0.80, 5.12])
    hand = carve_hand(wrist, np.array([-0.45, -0.05, 0.10]), np.array([0.10, 0.85, -0.35]), 0.75)
    return [
        _part("held arm", _arm(shoulder, elbow, wrist), *_around([shoulder, elbow, wrist], 0.36), 0.08),
        _part("held hand", hand, *_around([wrist, wrist + np.array([-0.5, 0.1, 0.1])], 0.34), 0.03),
    ]


def _raised_arm() -> list[Part]:
    """The raised arm with the baton, a part of its own."""
    shoulder, elbow, wrist = (
        np.array([-0.80, 0.02, 5.92]),
        np.array([-1.38, -0.12, 6.62]),
        np.array([-1.16, -0.40, 7.62]),
    )
    hand = carve_hand(wrist, np.array([0.10, -0.10, 0.32]), np.array([0.55, -0.80, -0.1]), 1.10)
    low, high = np.array([-1.62, -0.52, 7.46]), np.array([-0.42, -0.66, 8.58])
    staff, knobs = (
        capsule(low, high, 0.075, 0.085),
        (ellipsoid(low, (0.13, 0.13, 0.13)), ellipsoid(high, (0.14, 0.14, 0.14))),
    )
    baton: Field = lambda p: smooth_min(staff(p), np.minimum(knobs[0](p), knobs[1](p)), 0.03)  # noqa: E731
    return [
        _part("raised arm", _arm(shoulder, elbow, wrist), *_around([shoulder, elbow, wrist], 0.36)),
        _part("raised hand", hand, *_around([wrist, wrist + np.array([0.2, -0.2, 0.4])], 0.36), 0.04),
        _part("baton", baton, *_around([low, high], 0.18), 0.01),
    ]


# Head ----------------------------------------------------------------------------------------------------------------


def _helmet(p: Floats) -> Floats:
    """The helmet: a cap with a peak and a neck guard, the face left free."""
    cap = ellipsoid((0.0, 0.08, 0.72), (0.41, 0.50, 0.46))(p)
    band = np.maximum(np.abs(p[2] - 0.80 + 0.25 * p[1]) - 0.035, cap - 0.03)
    peak = ellipsoid((0.0, -0.42, 0.86), (0.30, 0.16, 0.035), turn_by(x=18.0))(p)
    arch = np.hypot(p[0] / 0.29, (p[2] - 0.48) / 0.36) - 1.0
    cap = smooth_max(smooth_min(cap, band, 0.02), -np.maximum(0.3 * arch, p[1] + 0.10), 0.02)
    return 0.9 * smooth_min(smooth_max(cap, 0.18 - p[2], 0.03), peak, 0.03)


def _crest(p: Floats) -> Floats:
    """The crest: a plume of hair in an arc from brow to nape."""
    r, turn = np.hypot(p[1] - 0.10, p[2] - 0.72), np.arctan2(p[2] - 0.72, p[1] - 0.10)
    strands = 0.012 * pipe(44.0 * turn + 6.0 * np.sin(9.0 * r))
    arc = np.abs(r - 0.56) - 0.14
    ends = smooth_max(-0.95 - turn, turn - 2.75, 0.05) * 0.5
    return 0.8 * (smooth_max(smooth_max(arc, np.abs(p[0]) - 0.075, 0.05), ends, 0.06) - strands)


def _beard(p: Floats) -> Floats:
    """A short curled beard."""
    body = smooth_min(
        ellipsoid((0.0, -0.30, 0.17), (0.21, 0.16, 0.18))(p), ellipsoid((0.0, -0.40, 0.06), (0.11, 0.10, 0.15))(p), 0.08
    )
    curls = 0.018 * np.sin(26.0 * p[0] + 5.0 * np.sin(14.0 * p[2])) * np.sin(24.0 * p[2] + 4.0 * p[0])
    return 0.8 * (body - curls)


def _head_parts() -> list[Part]:
    """Return neck, face, beard and the helmet with its crest."""
    rotation = turn_by(*_HEAD_TURN)

    def put(name: str, field: Field, low: Sequence[float], high: Sequence[float], blend: float) -> Part:
        """Return a part given in the head's own frame, within the box from `low` to `high`."""
        turned = corners_of(np.array([low, high])) @ rotation.T + _HEAD_AT
        return _part(name, placed(field, at=_HEAD_AT, rotation=rotation), *_around(turned, 0.02), blend)

    neck = capsule((0.0, 0.08, 5.95), (-0.02, 0.02, 6.85), 0.25, 0.22)
    return [
        _part("neck", neck, (-0.3, -0.25, 5.7), (0.3, 0.4, 7.1), 0.08),
        put("face", carve_face, (-0.45, -0.6, 0.0), (0.45, 0.55, 1.15), 0.05),
        put("beard", _beard, (-0.30, -0.55, -0.15), (0.30, -0.05, 0.40), 0.03),
        put("helmet", _helmet, (-0.48, -0.65, 0.1), (0.48, 0.65, 1.25), 0.015),
        put("crest", _crest, (-0.12, -0.65, 0.16), (0.12, 0.85, 1.45), 0.01),
    ]


# Pedestal and model --------------------------------------------------------------------------------------------------


@functools.cache
def _pedestal_profile() -> Drawing:
    """Return the section of the pedestal over (half width, height) [m]."""
    half = [(0.0, 0.0), (0.46, 0.0), (0.46, 0.07), (0.44, 0.075), (0.43, 0.10), (0.405, 0.115), (0.40, 0.125),
            (0.40, 0.265), (0.41, 0.275), (0.415, 0.29), (0.445, 0.305), (0.445, 0.345), (0.435, 0.36),
            (0.0, 0.36)]  # fmt: skip
    return draw_mirrored(half, (-0.02, -0.08), (0.60, 0.46), step=0.0015)


def _pedestal_field(p: Floats) -> Floats:
    """The moulded pedestal, its corners a little round."""
    return _pedestal_profile()(smooth_max(np.abs(p[0]), np.abs(p[1] - 0.01) + 0.10, 0.008), p[2])


@functools.cache
def attic_model(*, cell: float = 0.004) -> Model:
    """Return the attic sculpture as a model of "pedestal", "figure" and "raised arm"; triangles about `cell` [m]."""
    figure = Solid((*_body_parts(), *_cloak_parts(), *_held_arm(), *_head_parts()))
    arm = Solid(tuple(_raised_arm()))
    margin = np.array([[-0.02] * 3, [0.02] * 3])
    held = np.array([[-0.50, -0.40, -0.005], [0.50, 0.42, PEDESTAL_HEIGHT + 0.005]])
    parts = (
        ModelPart("pedestal", _pedestal_field, held, cell, REFLECTANCE),
        ModelPart("figure", figure, figure.bounds() + margin, cell, REFLECTANCE),
        ModelPart("raised arm", arm, arm.bounds() + margin, cell, REFLECTANCE),
    )
    floor = make_box("floor", np.array([-5.0, -5.0, -0.1]), np.array([5.0, 5.0, 0.0]), reflectance=0.3)
    return Model("attic sculpture", parts, (floor,))


def attic_scene(*, changes: Sequence[Edit] = (), cell: float = 0.004) -> Scene:
    """Return the attic sculpture on a floor, as it stands after `changes`; see `attic_model` for its parts."""
    return build_scene(attic_model(cell=cell), changes)
