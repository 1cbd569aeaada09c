"""The terracotta relief of paper 003: a face, 20 x 20 cm and 4 cm high, with brows 3 to 5 mm wide and steep edges.

Heights over a plate, (u, v) in metres about its middle, go into a mesh that is the truth; brows, steep edges and flat
parts can be asked for, so that what a scanner or a filter keeps of them can be measured. Fired clay, 0.6 reflecting,
coated with delustering spray in the paper: no gloss.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from monitor.simulation.changes import Edit
from monitor.simulation.height_field import HeightField
from monitor.simulation.model import Model, ModelPart, build_scene
from monitor.simulation.scenes import Scene
from monitor.simulation.shapes import pipe, smoothstep
from projects.model import Bools, Floats

SIZE = 0.20  # m
HEIGHT = 0.040  # m, from the plate's ground to the tip of the nose
REFLECTANCE = 0.6
BROW_HEIGHT = 0.0012  # m
BROW_WIDTH = (0.005, 0.003)  # m, at the root of the nose and at the temple
# Columns: u (right), height, -y; the plate stands upright, its face towards -y.
UPRIGHT = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
STEEP = np.tan(np.radians(55.0))
FLAT = np.tan(np.radians(20.0))


def brow_coordinates(u: Floats, v: Floats) -> tuple[Floats, Floats, Floats]:
    """Return where points lie about the nearer brow: along it (0 root, 1 temple), across it [m], and its width [m].

    Each brow is an arc of 58 degrees of a circle of 34 mm about (+-17 mm, 3 mm).
    """
    du, dv = np.abs(u) - 0.017, v - 0.003
    turn = np.degrees(np.arctan2(du, dv))
    along = (turn + 22.0) / 58.0
    across = np.hypot(du, dv) - 0.034
    width = BROW_WIDTH[0] + (BROW_WIDTH[1] - BROW_WIDTH[0]) * np.clip(along, 0.0, 1.0)
    return along, across, width


def _brows(u: Floats, v: Floats) -> Floats:
    """Return the height [m] of the brows at (u, v)."""
    along, across, width = brow_coordinates(u, v)
    section = np.cos(np.pi * np.clip(across / width, -0.5, 0.5)) ** 2
    return BROW_HEIGHT * section * smoothstep(along, 0.0, 0.12) * (1.0 - smoothstep(along, 0.88, 1.0))


def _bump(u: Floats, v: Floats, at: tuple[float, float], radii: tuple[float, float]) -> Floats:
    """Return a smooth hill of height 1: cos^2 of the distance from `at` in units of `radii`."""
    r = np.hypot((u - at[0]) / radii[0], (v - at[1]) / radii[1])
    return np.cos(0.5 * np.pi * np.minimum(r, 1.0)) ** 2


def _face(u: Floats, v: Floats) -> Floats:
    """Return the face above the ground of the head, without brows: forehead, nose, eyes, cheeks, mouth, chin."""
    side = np.abs(u)
    nose_width = 0.0055 + 0.25 * np.clip(0.026 - v, 0.0, 0.038)
    nose = (0.0035 + 0.0095 * smoothstep(-v, -0.030, 0.010)) * np.cos(0.5 * np.pi * np.minimum(side / nose_width, 1.0))
    nose = nose * smoothstep(v, -0.0165, -0.0095) * (1.0 - smoothstep(v, 0.022, 0.040))
    lid = np.hypot((side - 0.024) / 1.6, v - 0.020)
    eyes = -0.0045 * _bump(side, v, (0.024, 0.020), (0.019, 0.013)) + 0.0042 * _bump(
        side, v, (0.024, 0.020), (0.011, 0.0075)
    )
    eyes = eyes + 0.0009 * np.cos(np.pi * np.clip((lid - 0.0072) / 0.0016, -0.5, 0.5)) ** 2
    cheeks = 0.0035 * _bump(side, v, (0.030, -0.012), (0.022, 0.022))
    nostrils = 0.0030 * _bump(side, v, (0.0085, -0.0095), (0.006, 0.006))
    lips = 0.0036 * _bump(u, v, (0.0, -0.0285), (0.021, 0.0050)) + 0.0042 * _bump(u, v, (0.0, -0.0365), (0.017, 0.0060))
    chin = 0.0045 * _bump(u, v, (0.0, -0.0560), (0.018, 0.013)) - 0.0016 * _bump(u, v, (0.0, -0.0450), (0.015, 0.005))
    return nose + eyes + cheeks + nostrils + lips + chin


def relief_height(u: Floats, v: Floats) -> Floats:
    """Return the height [m] of the relief over its ground at (u, v) [m], u to the right and v up from its middle."""
    inside = 1.0 - np.hypot(u / 0.056, (v - 0.002) / 0.076)  # 0 on the outline of the head
    dome = 0.0105 + 0.0165 * np.sqrt(np.clip(1.0 - (1.0 - inside) ** 2, 0.0, None))
    edge = smoothstep(inside, 0.0, 0.055)  # about 27 mm within 3 mm: the steep edge, as at the chin
    head = edge * dome + (_face(u, v) + _brows(u, v)) * smoothstep(inside, 0.055, 0.30)
    crown = np.hypot(u / 0.071, (v - 0.010) / 0.083)
    turn = np.arctan2(u, v - 0.010)
    locks = 0.0016 * pipe(26.0 * turn + 5.0 * np.sin(9.0 * crown)) * smoothstep(crown, 0.70, 0.80)
    hair = (0.0170 + locks) * (1.0 - smoothstep(crown, 0.965, 1.0)) * smoothstep(v, -0.035, -0.025)
    neck = 0.010 * (1.0 - smoothstep(np.abs(u), 0.024, 0.027)) * (1.0 - smoothstep(v, -0.055, -0.040))
    frame = 0.007 * smoothstep(np.maximum(np.abs(u), np.abs(v)), 0.0885, 0.0900)
    return np.maximum(np.maximum(np.maximum(head, hair), neck), frame)


def _slope(u: Floats, v: Floats) -> Floats:
    """Return the steepness of the relief, rise over run."""
    step = 2e-4  # m
    along_u = relief_height(u + step, v) - relief_height(u - step, v)
    along_v = relief_height(u, v + step) - relief_height(u, v - step)
    return np.hypot(along_u, along_v) / (2.0 * step)


def _on_brow(points: Floats) -> Bools:
    """Return which points (n, 3) lie on a brow, away from its ends."""
    along, across, width = brow_coordinates(points[:, 0], points[:, 2])
    return (np.abs(across) < 0.5 * width) & (along > 0.12) & (along < 0.88)


def relief_model(*, cell: float = 0.0004) -> Model:
    """Return the relief as a model with one part, `relief`; see `relief_scene`."""
    axis = np.linspace(-0.5 * SIZE, 0.5 * SIZE, round(SIZE / cell) + 1)
    heights = HeightField(relief_height, axis, axis, -0.02, HEIGHT + 0.01, UPRIGHT)
    part = ModelPart(
        "relief", heights.field, heights.bounds(), cell, reflectance=REFLECTANCE, mesher=heights.triangulate
    )  # fmt: skip
    return Model("terracotta relief", (part,))


def relief_scene(*, cell: float = 0.0004, changes: Sequence[Edit] = ()) -> Scene:
    """Return the relief, upright about the origin: u along x, v along z, its face towards -y, its ground at y = 0.

    Parameters
    ----------
    cell : m, spacing of the heights; the mesh over them is the truth. At 0.4 mm it lies within 0.02 mm (99 %) of the
        curved surface of `relief_height` on flat parts, 0.05 mm on the brows and 0.13 mm on steep edges.
    changes : what happened to it, see `monitor.simulation.changes`.

    Returns
    -------
    Scene; its `regions` are `brows`, `steep` (steeper than 55 degrees) and `flat` (less than 20 degrees, no brow), as
    they are before any change.
    """
    regions = {
        "brows": _on_brow,
        "steep": lambda p: _slope(p[:, 0], p[:, 2]) > STEEP,
        "flat": lambda p: (_slope(p[:, 0], p[:, 2]) < FLAT) & ~_on_brow(p),
    }
    return dataclasses.replace(build_scene(relief_model(cell=cell), changes), regions=regions)
