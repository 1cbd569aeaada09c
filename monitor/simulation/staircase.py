"""The staircase of paper 002: 40 x 8 x 8 m, two flights of nosed steps to a landing, walls, balustrade, targets.

Parts by name, so that steps can be worn, lifted or sink: `step 1`... of the left and right flight, `landing`,
`left/middle/right string wall`, `... rail`, `baluster k`, `pier k`, `back wall`, `pilaster k`. Everything but the
balusters is an exact polyhedron. The origin is the middle of the plan, at the ground; the front looks towards -y. Rays
are float32: at 20 m from the origin positions round to 1 micrometre, and a range of 10 m so read to 2 micrometres.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from monitor.simulation.changes import Edit
from monitor.simulation.model import Model, ModelPart, box_part, build_scene
from monitor.simulation.prisms import prism_part, revolve_field
from monitor.simulation.scenes import Body, Scene, TrueTarget, make_ball, make_box
from monitor.simulation.shapes import arc_points
from projects.model import Floats
from projects.transforms import rotation_from_vector

LENGTH, DEPTH, HEIGHT = 40.0, 8.0, 8.0  # m
N_STEPS, TREAD, RISE = 24, 0.48, 0.15
NOSE, NOSE_THICKNESS = 0.03, 0.05  # m, by which a tread overhangs, and how thick it is there
LANDING = 0.5 * LENGTH - N_STEPS * TREAD  # m, half its length
TOP = N_STEPS * RISE
FRONT, STRING, BACK = -0.5 * DEPTH, -0.5 * DEPTH + 0.4, 0.5 * DEPTH - 0.4  # y: front, steps from string to back wall
BASE, BALUSTER, RAIL = 0.08, 0.72, 0.14  # m, heights of plinth, baluster and rail
SPHERE_RADIUS = 0.0725
BOARD_SIZE, BLACK, WHITE = 0.15, 0.05, 0.90
STONE = 0.45
# Heights of the scanner over the ground or the step it stands on are in the third column.
STATIONS = np.array(
    [[x, -8.5, 1.7] for x in (-17.0, -10.5, -3.5, 3.5, 10.5, 17.0)]
    + [[x, 0.0, TOP + 1.7] for x in (-6.0, 0.0, 6.0)]
    + [[s * (0.5 * LENGTH - k * TREAD + 0.24), 1.0, k * RISE + 1.7] for s in (-1, 1) for k in (4, 14)]
)
_LATHE = np.array(
    [[0.00, 0.070], [0.03, 0.072], [0.06, 0.050], [0.10, 0.045], [0.13, 0.055], [0.22, 0.092], [0.30, 0.088],
     [0.42, 0.052], [0.52, 0.040], [0.58, 0.040], [0.61, 0.055], [0.64, 0.056], [0.67, 0.045], [0.70, 0.066],
     [0.72, 0.068]]
)  # fmt: skip


def _step(k: int, side: str, cell: float) -> ModelPart:
    """Return step k (1 is the lowest) of the flight, from the ground up, its nose over the step below."""
    x0, x1 = -0.5 * LENGTH + (k - 1) * TREAD, -0.5 * LENGTH + k * TREAD
    z, r = k * RISE, 0.5 * NOSE_THICKNESS
    nose = arc_points((x0 - NOSE + r, z - r), r, 270, 90, 9)[::-1]  # half round, counter-clockwise from its top
    profile = [(x0, 0.0), (x1, 0.0), (x1, z), *nose, (x0, z - NOSE_THICKNESS)]
    polygon = np.array(profile)
    if side == "right":
        polygon = (polygon * [-1.0, 1.0])[::-1]
    return prism_part(f"{side} step {k}", polygon, STRING, BACK, cell=cell, reflectance=STONE)


def _stepped(low: float, bottom: float) -> list[tuple[float, float]]:
    """Return the steps' corners of the left flight from its foot to the landing, `low` above the treads."""
    corners = [(-0.5 * LENGTH, bottom)]
    for k in range(1, N_STEPS + 1):
        x, z = -0.5 * LENGTH + (k - 1) * TREAD, k * RISE + low
        corners += [(x, z), (x + TREAD, z)]
    return corners


def _balustrade(cell: float, ornament: float) -> list[ModelPart]:
    """Return string walls, rails, balusters and piers along the front."""
    rail_low = BASE + BALUSTER
    wall = [*_stepped(BASE, 0.0), (-LANDING, 0.0)]
    pitch = [(-0.5 * LENGTH, RISE + rail_low + RAIL), (-LANDING, TOP + rail_low + RAIL + RISE)]
    rail = [*_stepped(rail_low, rail_low + RISE)[1:], *pitch[::-1]]
    parts = []
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for name, outline in (("string wall", wall), ("rail", rail)):
            polygon = np.array(outline) * [sign, 1.0]
            polygon = polygon[::-1] if sign > 0.0 and name == "string wall" else polygon
            polygon = polygon if _area(polygon) > 0.0 else polygon[::-1]
            y = (FRONT, STRING) if name == "string wall" else (FRONT + 0.08, STRING - 0.08)
            parts.append(prism_part(f"{side} {name}", polygon, *y, cell=cell, reflectance=STONE))
    level = TOP + BASE
    parts.append(box_part("middle string wall", [-LANDING, FRONT, 0], [LANDING, STRING, level], cell=cell,
                          reflectance=STONE))  # fmt: skip
    parts.append(box_part("middle rail", [-LANDING, FRONT + 0.08, level + BALUSTER],
                          [LANDING, STRING - 0.08, level + BALUSTER + RAIL], cell=cell, reflectance=STONE))  # fmt: skip
    field, box = revolve_field(_LATHE), np.array([[-0.1, -0.1, 0.0], [0.1, 0.1, BALUSTER]])
    for n, (x, z) in enumerate(_places(), start=1):
        T = np.eye(4)
        T[:3, 3] = [x, 0.5 * (FRONT + STRING), z]
        parts.append(ModelPart(f"baluster {n}", field, box, ornament, STONE, T_model_part=T))
    return parts


def _places() -> list[tuple[float, float]]:
    """Return where balusters stand, x and height: one on each step but those of the piers, and along the landing."""
    flight = [(-0.5 * LENGTH + (k - 0.5) * TREAD, k * RISE + BASE) for k in range(2, N_STEPS)]
    middle = [(x, TOP + BASE) for x in np.arange(-LANDING + 0.7, LANDING - 0.69, 0.4)]
    return flight + middle + [(-x, z) for x, z in flight]


def _area(polygon: Floats) -> float:
    """Return the area [m2] of a polygon (m, 2), positive counter-clockwise."""
    x, y = polygon.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _back_wall(cell: float) -> list[ModelPart]:
    """Return the wall behind, with a base moulding over the landing and a cornice, and its pilasters."""
    y, z = BACK, HEIGHT
    profile = [(DEPTH / 2, 0.0), (DEPTH / 2, z), (y - 0.22, z), (y - 0.22, z - 0.10)]
    profile += arc_points((y - 0.04, z - 0.10), 0.18, 180, 270, 7)[1:]  # cavetto under the cornice
    profile += [(y - 0.04, z - 0.32), (y, z - 0.32), (y, TOP + 0.9), (y - 0.03, TOP + 0.87), (y - 0.03, TOP + 0.80)]
    profile += [(y, TOP + 0.77), (y, 0.0)]
    polygon = np.array(profile)
    polygon = polygon if _area(polygon) > 0.0 else polygon[::-1]
    wall = prism_part("back wall", polygon, -0.5 * LENGTH, 0.5 * LENGTH, plane="yz", cell=cell, reflectance=0.6)
    pilasters = [
        box_part(f"pilaster {n}", [x - 0.3, y - 0.12, TOP], [x + 0.3, y, HEIGHT - 0.32], cell=cell, reflectance=0.6)
        for n, x in enumerate(np.linspace(-LANDING + 0.5, LANDING - 0.5, 5), start=1)
    ]
    return [wall, *pilasters]


def staircase_model(*, cell: float = 0.01, ornament: float = 0.006) -> Model:
    """Return the staircase as named parts.

    `cell` and `ornament` [m]: edges of the triangles that a changed part gets, and of those of the balusters.
    """
    steps = [_step(k, side, cell) for side in ("left", "right") for k in range(1, N_STEPS + 1)]
    landing = box_part("landing", [-LANDING, STRING, 0.0], [LANDING, BACK, TOP], cell=cell, reflectance=STONE)
    ends = ((-0.5 * LENGTH + 0.24, RISE), (-LANDING, TOP), (LANDING, TOP), (0.5 * LENGTH - 0.24, RISE))
    piers = [
        box_part(f"pier {n}", [x - 0.24, FRONT, z + BASE], [x + 0.24, STRING, z + BASE + BALUSTER + RAIL + 0.25],
                 cell=cell, reflectance=STONE)
        for n, (x, z) in enumerate(ends, start=1)
    ]  # fmt: skip
    return Model("staircase", (*steps, landing, *_balustrade(cell, ornament), *piers, *_back_wall(cell)), (_ground(),))


def _ground() -> Body:
    """Return the ground before the stairs."""
    return make_box("ground", np.array([-21.0, -12.0, -0.2]), np.array([21.0, 4.0, 0.0]), reflectance=0.25)


def make_board(name: str, centre: Floats, normal: Floats) -> tuple[Body, TrueTarget]:
    """Return a black-and-white board, 1 cm thick, its face's centre at `centre`, upright, looking along `normal`.

    Four square fields meet in the centre, black at the upper left and lower right seen from the front.
    """
    n = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    right = np.cross([0.0, 0.0, 1.0], n)
    right /= np.linalg.norm(right)
    up, s = np.cross(n, right), 0.5 * BOARD_SIZE
    grid = np.array([[u, v] for v in (-s, 0.0, s) for u in (-s, 0.0, s)])
    face = np.asarray(centre, dtype=float) + grid[:, :1] * right + grid[:, 1:] * up
    quads = [(0, 1, 4, 3), (1, 2, 5, 4), (3, 4, 7, 6), (4, 5, 8, 7)]
    rim = [0, 1, 2, 5, 8, 7, 6, 3]
    back = face - 0.01 * n
    front = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    rear = [(9 + t[0], 9 + t[2], 9 + t[1]) for t in front]
    edge = [t for a, b in zip(rim, rim[1:] + rim[:1], strict=True) for t in ((a, 9 + a, 9 + b), (a, 9 + b, b))]
    faces = np.array(front + rear + edge, dtype=np.int32)
    colours = np.concatenate([np.repeat([WHITE, BLACK, BLACK, WHITE], 2), np.full(len(faces) - 8, WHITE)])
    return Body(name, np.concatenate([face, back]), faces, colours), TrueTarget(name, "board", face[4], BOARD_SIZE, n)


def _targets() -> tuple[list[Body], list[TrueTarget]]:
    """Return ten boards on walls and piers and eight spheres on little feet on steps, landing and ground."""
    bodies, targets = [], []
    boards = [([x, BACK - 0.02, TOP + 1.6], [0.0, -1.0, 0.0]) for x in (-6.0, -2.2, 2.2, 6.0)]
    boards += [([x, FRONT - 0.02, 1.2], [0.0, -1.0, 0.0]) for x in (-9.0, -3.0, 3.0, 9.0)]
    boards += [([s * 14.0, BACK - 0.02, 4.6], [-s * 0.5, -1.0, 0.0]) for s in (-1, 1)]
    for n, (at, normal) in enumerate(boards, start=1):
        body, target = make_board(f"board {n}", np.array(at), np.array(normal, dtype=float))
        bodies.append(body)
        targets.append(target)
    feet = [
        (-16.0, -5.5, 0.0),
        (16.0, -5.5, 0.0),
        (-5.0, -6.5, 0.0),
        (5.0, -6.5, 0.0),
        (-4.0, 1.5, TOP),
        (4.0, -1.0, TOP),
        (-0.5 * LENGTH + 7.5 * TREAD, 2.0, 8 * RISE),
        (0.5 * LENGTH - 15.5 * TREAD, 0.5, 16 * RISE),
    ]
    for n, (x, y, z) in enumerate(feet, start=1):  # fmt: skip
        foot = make_box(f"foot {n}", np.array([x - 0.02, y - 0.02, z]), np.array([x + 0.02, y + 0.02, z + 0.10]))
        centre = np.array([x, y, z + 0.10 + SPHERE_RADIUS - 0.002])
        bodies += [foot, make_ball(f"sphere {n}", centre, SPHERE_RADIUS, reflectance=0.8, n_rings=160)]
        targets.append(TrueTarget(f"sphere {n}", "sphere", centre, SPHERE_RADIUS))
    return bodies, targets


def staircase_scene(*, cell: float = 0.01, ornament: float = 0.006, changes: Sequence[Edit] = ()) -> Scene:
    """Return the staircase with its survey targets, after changes; see the top of this file for its frame and parts.

    The targets do not move with the staircase, whatever happens to it: they stand for a stable network.
    """
    scene = build_scene(staircase_model(cell=cell, ornament=ornament), changes)
    bodies, targets = _targets()
    return dataclasses.replace(scene, bodies=(*scene.bodies, *bodies), targets=tuple(targets))


def settlement(depth: float, *, tilt: float = 0.0) -> Floats:
    """Return T_after_before of a staircase that sinks by `depth` [m] and leans to the front by `tilt` [rad]."""
    T = np.eye(4)
    T[:3, :3] = rotation_from_vector(np.array([tilt, 0.0, 0.0]))
    T[2, 3] = -depth
    return T
