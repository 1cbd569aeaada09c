"""The demo's figure: an allegory with a mural crown, a raised torch and a shield, in a girded robe and a cloak.

Made of parts in units of its head's height (an eighth of the figure), x to the right seen from the front, y away from
it, z up from the soles. `statue_parts` hands them over in metres, standing on the pedestal.
"""

from __future__ import annotations

import numpy as np

from monitor.simulation.carving import carve_hand
from monitor.simulation.cloak import cascade_part, cloak_part, mantle_part
from monitor.simulation.crowned_head import head_parts
from monitor.simulation.heads import part_in_heads
from monitor.simulation.robe import robe_parts, sleeve_part
from monitor.simulation.shapes import box, capsule, ellipsoid, pipe, smoothstep, turn_by
from monitor.simulation.shield import shield_parts
from monitor.simulation.solid import Field, Part, join_blended, smooth_max, smooth_min
from projects.model import Floats


def _feet() -> list[Part]:
    """Return the slab under the figure and both feet, with toes."""
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
        bare = join_blended([(instep, 0.0), *((toe, 0.02) for toe in toes)])

        def foot(p: Floats, bare: Field = bare) -> Floats:
            """Return the foot (n,) at p (3, n), cut off at the ground."""
            return smooth_max(bare(p), 0.0 - p[2], 0.01)

        parts.append(part_in_heads(name, foot, (heel, ball_of_foot), 0.34, blend=0.03))
    sole = box((-0.06, -0.12, 0.06), (1.28, 1.22, 0.10), 0.04)
    return [part_in_heads("base", sole, ((-1.34, -1.34, -0.04), (1.22, 1.10, 0.16)), 0.01), *parts]


def _right_arm() -> list[Part]:
    """The arm raised with the torch, on the left seen from the front."""
    shoulder, elbow, wrist = (
        np.array([-0.76, 0.06, 6.36]),
        np.array([-1.42, -0.22, 6.22]),
        np.array([-1.36, -0.52, 7.26]),
    )
    upper, fore = capsule(shoulder, elbow, 0.20, 0.155), capsule(elbow, wrist, 0.15, 0.092)
    muscle = ellipsoid(0.6 * elbow + 0.4 * wrist, (0.15, 0.15, 0.30), turn_by(y=4, x=14))
    arm = part_in_heads("raised arm", lambda p: smooth_min(smooth_min(upper(p), fore(p), 0.06), muscle(p), 0.1),
                (shoulder, elbow, wrist), 0.25, blend=0.14)  # fmt: skip
    torch_x, torch_y = -1.36, -0.66
    grip = carve_hand(wrist, np.array([0.02, -0.16, 0.30]), np.array([0.35, -0.95, -0.3]), 1.15)
    hand = part_in_heads("torch hand", grip, (wrist, wrist + np.array([0.0, -0.2, 0.5])), 0.32, blend=0.04)

    def torch(p: Floats) -> Floats:
        """Return the fluted shaft and the bowl of the torch (n,) at p (3, n)."""
        x, y, z = p[0] - torch_x, p[1] - torch_y, p[2]
        r, turn = np.hypot(x, y), np.arctan2(y, x)
        shaft = np.interp(z, [6.9, 7.0, 7.1, 8.1, 8.25, 8.3, 8.36, 8.42, 8.6, 8.66, 8.7],
                          [0.03, 0.085, 0.07, 0.105, 0.15, 0.19, 0.16, 0.17, 0.27, 0.29, 0.27])  # fmt: skip
        flute = 0.010 * pipe(8.0 * turn) * smoothstep(z, 7.15, 7.3) * smoothstep(8.15 - z, 0.0, 0.15)
        return smooth_max(0.8 * (r - shaft - flute), np.abs(z - 7.79) - 0.90, 0.03)

    def flame(p: Floats) -> Floats:
        """Return the flame (n,) at p (3, n): tongues that bend as they rise."""
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
        part_in_heads("torch", torch, ((torch_x, torch_y, 6.89), (torch_x, torch_y, 8.7)), 0.32, blend=0.01),
        hand,
        part_in_heads("flame", flame, ((torch_x, torch_y, 8.5), (torch_x, torch_y, 9.6)), 0.42, blend=0.05),
        sleeve_part("right sleeve", shoulder, 0.55 * elbow + 0.45 * shoulder),
    ]


def _left_arm() -> list[Part]:
    """The arm that rests on the shield, on the right seen from the front."""
    shoulder, elbow, wrist = np.array([0.76, 0.06, 6.36]), np.array([1.12, 0.20, 5.00]), np.array([0.98, -0.52, 3.98])
    upper, fore = capsule(shoulder, elbow, 0.19, 0.15), capsule(elbow, wrist, 0.145, 0.092)
    muscle = ellipsoid(0.65 * elbow + 0.35 * wrist, (0.145, 0.145, 0.26), turn_by(x=-35, y=-8))
    arm = lambda p: smooth_min(smooth_min(upper(p), fore(p), 0.06), muscle(p), 0.1)  # noqa: E731
    hand = carve_hand(wrist, np.array([-0.05, -0.30, -0.42]), np.array([0.0, 0.9, -0.5]), 0.45)
    return [
        part_in_heads("lowered arm", arm, (shoulder, elbow, wrist), 0.25, blend=0.12),
        part_in_heads("shield hand", hand, (wrist, wrist + np.array([0.0, -0.35, -0.5])), 0.30, blend=0.03),
        sleeve_part("left sleeve", shoulder, 0.55 * elbow + 0.45 * shoulder),
        cascade_part(),
    ]


def statue_parts() -> tuple[Part, ...]:
    """Return the figure's parts in metres, standing on the pedestal, in the order in which they are joined."""
    neck, throat, *head = head_parts()
    return (
        *_feet(), *robe_parts(), cloak_part(), mantle_part(), neck, throat, *_right_arm(), *_left_arm(), *head,
        *shield_parts(),
    )  # fmt: skip
