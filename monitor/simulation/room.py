"""The ornate room of paper 000: 7.5 x 7 m and 5 m high, stucco cartouches, panelled walls, cornice.

Parts by name: `floor`, `ceiling`, `north`, `east`, `south` and `west wall`, each a slab with heights over its plane.
The walls reach behind one another, so their cornices meet in mitres. The origin is the middle of the floor, x runs
along the longer walls (north and south).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence

import numpy as np

from monitor.simulation.changes import Edit
from monitor.simulation.height_field import HeightField, refine_axis
from monitor.simulation.model import Model, ModelPart, box_part, build_scene
from monitor.simulation.scenes import Scene
from monitor.simulation.shapes import Drawing, draw_strokes, smoothstep
from projects.model import Floats

LENGTH, WIDTH, HEIGHT = 7.5, 7.0, 5.0  # m
THICKNESS = 0.30
CARTOUCHE = 3.05  # m, height of the middle of the cartouches
PANEL = (0.55, 2.10)  # m, from and to what height the panels reach
PLASTER = 0.75
Cells = tuple[float, float]  # m, of the grid where there is ornament, and elsewhere
STATIONS = np.array([[-1.6, -1.2, 1.6], [1.7, -1.5, 1.5], [0.2, 1.6, 1.7]])


@functools.cache
def _scrolls() -> Drawing:
    """Return the distance to the strokes of a cartouche about its middle: C-scrolls in pairs, and a wreath."""
    strokes = []
    for sign in (-1.0, 1.0):
        for u, v, start, turns, radius in ((0.30, 0.20, 200, 1.6, 0.13), (0.27, -0.26, 100, -1.5, 0.12),
                                           (0.15, 0.43, 250, 1.2, 0.08), (0.38, -0.02, 180, -1.3, 0.07)):  # fmt: skip
            t = np.linspace(0.0, 1.0, 60)
            turn = np.radians(start) + 2.0 * np.pi * turns * t
            r = radius * (1.0 - 0.75 * t)
            strokes.append(np.column_stack([sign * (u + r * np.cos(turn)), v + r * np.sin(turn)]))
    wreath = np.linspace(0.0, 2.0 * np.pi, 80)
    strokes.append(np.column_stack([0.185 * np.cos(wreath), 0.245 * np.sin(wreath)]))
    return draw_strokes(strokes, (-0.62, -0.62), (0.62, 0.62), step=0.004)


def cartouche_height(u: Floats, v: Floats) -> Floats:
    """Return the height [m] of a cartouche at (u, v) [m] from its middle: scrolls 18 mm, an oval boss 40 mm high."""
    near = (np.abs(u) < 0.6) & (np.abs(v) < 0.6)
    found = np.zeros(np.shape(u))
    a, b = u[near], v[near]
    stroke = 0.018 * np.sqrt(np.clip(1.0 - (_scrolls()(a, b) / 0.019) ** 2, 0.0, None))
    oval = 1.0 - (a / 0.16) ** 2 - (b / 0.22) ** 2
    boss = 0.040 * np.sqrt(np.clip(oval, 0.0, None))
    turn, r = np.arctan2(a, b - 0.30), np.hypot(a, b - 0.30)
    flutes = (0.016 + 0.009 * np.cos(18.0 * turn)) * smoothstep(r, 0.03, 0.06) * (1.0 - smoothstep(r, 0.155, 0.170))
    shell = flutes * (np.abs(turn) < 1.3)
    found[near] = np.maximum(np.maximum(stroke, boss), shell)
    return found


def _ogee(across: Floats, width: float, height: float) -> Floats:
    """Return a moulding's section: a round bar with a smaller one on its inner side."""
    bar = height * np.cos(np.pi * np.clip(across / width, -0.5, 0.5)) ** 2
    return bar + 0.4 * height * np.cos(np.pi * np.clip((across + 0.6 * width) / (0.3 * width), -0.5, 0.5)) ** 2


def _running(z: Floats) -> Floats:
    """Return what runs along the wall at height z: skirting, dado rail and cornice."""
    skirting = 0.025 * (1.0 - smoothstep(z, 0.24, 0.27))
    rail = _ogee(z - 2.28, 0.09, 0.035)
    rise = z - (HEIGHT - 0.45)
    cornice = 0.05 * smoothstep(rise, 0.0, 0.03) + 0.06 * smoothstep(rise, 0.09, 0.16)
    cornice = cornice + 0.14 * smoothstep(rise, 0.18, 0.38) ** 2 + 0.03 * smoothstep(rise, 0.395, 0.405)
    dentils = 0.5 * (smoothstep(rise, 0.052, 0.058) - smoothstep(rise, 0.078, 0.084))
    return skirting + rail + cornice + 0.02 * dentils


def _panels(length: float) -> Floats:
    """Return the middles (k,) and half widths of the panels of a wall: three, even."""
    return np.array([-1.0, 0.0, 1.0]) * (length - 0.5) / 3.0


def _frame(u: Floats, z: Floats, middle: float, half: float, low: float, high: float) -> Floats:
    """Return a framed panel: its moulding 22 mm high, its field sunk by 8 mm."""
    out = np.maximum(np.abs(u - middle) - half, np.abs(z - 0.5 * (low + high)) - 0.5 * (high - low))
    return _ogee(out, 0.06, 0.022) - 0.008 * smoothstep(-out, 0.06, 0.066)


def _wall_height(length: float, has_door: bool) -> Callable[[Floats, Floats], Floats]:
    """Return the heights of a wall over (u, z); u from the wall's middle."""
    half = (length - 0.5) / 6.0 - 0.12

    def height(u: Floats, z: Floats) -> Floats:
        """Return the height (n,) [m] of frames, cartouches and the door over the wall."""
        found = _running(z)
        for middle in _panels(length):
            found = found + _frame(u, z, middle, half, *PANEL)
            found = found + _frame(u, z, middle, half, 2.45, 3.85) + cartouche_height(u - middle, z - CARTOUCHE - 0.1)
        if has_door:
            out = np.maximum(np.abs(u) - 0.55, z - 2.20)
            found = (
                np.where(out < 0.06, 0.0, found) + _ogee(out - 0.03, 0.12, 0.03) - 0.12 * smoothstep(-out, 0.0, 0.02)
            )
        return np.asarray(found)

    return height


def _wall(name: str, length: float, turn: float, distance: float, cells: Cells, has_door: bool) -> ModelPart:
    """Return a wall at `distance` from the middle, looking inwards; `turn` [rad] from north (which looks to -y)."""
    half, widths = 0.5 * length + THICKNESS, (length - 0.5) / 6.0
    lines = [(m + s * (widths - 0.12) - 0.08, m + s * (widths - 0.12) + 0.08) for m in _panels(length) for s in (-1, 1)]
    lines += [(m - 0.6, m + 0.6) for m in _panels(length)]
    rows = [(0.23, 0.28), (PANEL[0] - 0.08, PANEL[0] + 0.08), (PANEL[1] - 0.08, 3.93), (HEIGHT - 0.46, HEIGHT)]
    lines += [(-0.65, 0.65)] if has_door else []
    rows += [(2.05, 2.35)] if has_door else []
    u = refine_axis(-half, half, coarse=cells[1], fine=cells[0], within=lines)
    z = refine_axis(-0.05, HEIGHT + 0.05, coarse=cells[1], fine=cells[0], within=rows)
    T = np.eye(4)
    c, s = np.cos(turn), np.sin(turn)
    # North: u along x, z up, normal -y; the others are turned about the vertical.
    T[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    T[:3, 3] = -distance * T[:3, 2]
    heights = HeightField(_wall_height(length, has_door), u, z, -THICKNESS, 0.40, T)
    return ModelPart(name, heights.field, heights.bounds(), 0.01, PLASTER, mesher=heights.triangulate)


def _ceiling(cells: Cells) -> ModelPart:
    """Return the ceiling with a rosette: rings and sixteen leaves about its middle, 60 mm deep."""

    def height(u: Floats, v: Floats) -> Floats:
        """Return the height (n,) [m] of the rose in the middle of the ceiling."""
        r, turn = np.hypot(u, v), np.arctan2(u, v)
        leaf = np.clip(1.0 - ((r - 0.30) / 0.20) ** 2, 0.0, None) * np.cos(8.0 * turn) ** 2
        rings = _ogee(r - 0.62, 0.10, 0.04) + _ogee(r - 0.85, 0.06, 0.02)
        return np.asarray(0.05 * leaf + rings + 0.06 * np.sqrt(np.clip(1.0 - (r / 0.11) ** 2, 0.0, None)))

    reach = [(-0.92, 0.92)]
    u = refine_axis(-0.5 * LENGTH - 0.2, 0.5 * LENGTH + 0.2, coarse=cells[1], fine=cells[0], within=reach)
    v = refine_axis(-0.5 * WIDTH - 0.2, 0.5 * WIDTH + 0.2, coarse=cells[1], fine=cells[0], within=reach)
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[2, 3] = HEIGHT
    heights = HeightField(height, u, v, -THICKNESS, 0.20, T)
    return ModelPart("ceiling", heights.field, heights.bounds(), 0.01, PLASTER, mesher=heights.triangulate)


def room_model(*, cell: float = 0.006, plain_cell: float = 0.25) -> Model:
    """Return the room as named parts; `cell` and `plain_cell` [m]: grid spacing where there is ornament, and elsewhere.

    Changes of plain parts are as fine as `plain_cell`: give all epochs of an experiment the same one, say 0.01.
    """
    cells = cell, plain_cell
    x, y = 0.5 * LENGTH, 0.5 * WIDTH
    low, high = [-x - THICKNESS, -y - THICKNESS, -0.2], [x + THICKNESS, y + THICKNESS, 0.0]
    walls = [
        _wall("north wall", LENGTH, 0.0, y, cells, False),
        _wall("east wall", WIDTH, -0.5 * np.pi, x, cells, False),
        _wall("south wall", LENGTH, np.pi, y, cells, True),
        _wall("west wall", WIDTH, 0.5 * np.pi, x, cells, False),
    ]
    floor = box_part("floor", low, high, cell=0.01, reflectance=0.35)
    return Model("ornate room", (floor, _ceiling(cells), *walls))


def room_scene(*, cell: float = 0.006, plain_cell: float = 0.25, changes: Sequence[Edit] = ()) -> Scene:
    """Return the room after changes, see `room_model`; scan it from `STATIONS`, which stand inside."""
    return build_scene(room_model(cell=cell, plain_cell=plain_cell), changes)
