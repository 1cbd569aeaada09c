"""The oyster reef of paper 001: 20 x 15 m of petrified shells with sharp edges, seen from its rim at shallow angles.

Heights over a slope that rises by 8 degrees towards +y; the origin is its middle. Thousands of shells lie and stand
at random, 8 to 60 cm long, their rims sharp to one cell; pits between them have floors that no station sees.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import map_coordinates

from monitor.simulation.changes import Edit
from monitor.simulation.height_field import HeightField
from monitor.simulation.model import Model, ModelPart, build_scene
from monitor.simulation.scenes import Scene
from monitor.simulation.shapes import smoothstep
from projects.model import Bools, Floats
from projects.transforms import apply, invert

LENGTH, WIDTH = 20.0, 15.0  # m
SLOPE = np.radians(8.0)
N_SHELLS, N_PITS = 4000, 24
PIT_DEPTH = 0.45
REFLECTANCE = 0.4
# Eight stations along the rim, 1.7 m over it (paper 001, section 4.2: along the boundary of the area).
STATIONS = np.array(
    [[x, s * 8.6, 1.7 + s * 8.6 * np.tan(SLOPE)] for s in (-1, 1) for x in (-6.5, 0.0, 6.5)]
    + [[s * 11.2, 0.0, 1.7] for s in (-1, 1)]
)


@functools.lru_cache(maxsize=4)
def _table(cell: float, seed: int) -> Floats:
    """Return the heights [m] on the nodes of the grid, (n_u, n_v)."""
    rng = np.random.default_rng(seed)
    u = np.linspace(-0.5 * LENGTH, 0.5 * LENGTH, round(LENGTH / cell) + 1)
    v = np.linspace(-0.5 * WIDTH, 0.5 * WIDTH, round(WIDTH / cell) + 1)
    grid_u, grid_v = np.meshgrid(u, v, indexing="ij")
    height = 0.10 * np.sin(grid_u / 1.9 + 0.4) * np.sin(grid_v / 1.4) + 0.05 * np.sin(grid_u / 0.7 + grid_v / 0.9)
    for wave, amplitude in ((0.23, 0.012), (0.11, 0.006), (0.06, 0.003)):
        a, b, c = rng.uniform(0.0, 2.0 * np.pi, 3)
        height += amplitude * np.sin(grid_u / wave + a + 2.0 * np.sin(grid_v / 0.5 + b)) * np.sin(grid_v / wave + c)
    pits = _pits(seed)
    for middle_u, middle_v, radius in pits:
        r = np.hypot(grid_u - middle_u, grid_v - middle_v)
        height -= PIT_DEPTH * (1.0 - smoothstep(r, 0.80 * radius, radius))
    for _ in range(N_SHELLS):
        at, length = rng.uniform([u[0], v[0]], [u[-1], v[-1]]), np.exp(rng.uniform(np.log(0.08), np.log(0.60)))
        turn, lift, thick = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-0.1, 0.9), 0.06 * length
        if np.hypot(pits[:, 0] - at[0], pits[:, 1] - at[1]).min() > 0.7:
            _lay_shell(height, u, v, at, length, turn, lift, thick)
    return height


def _pits(seed: int) -> Floats:
    """Return middle and radius of each pit, (N_PITS, 3) m, in the plane of the reef."""
    rng = np.random.default_rng([seed, 1])
    low, high = [-0.5 * LENGTH + 1.0, -0.5 * WIDTH + 1.0, 0.12], [0.5 * LENGTH - 1.0, 0.5 * WIDTH - 1.0, 0.30]
    return rng.uniform(low, high, (N_PITS, 3))


def _lay_shell(
    height: Floats, u: Floats, v: Floats, at: Floats, length: float, turn: float, lift: float, thick: float
) -> None:
    """Lay one shell onto the heights, in place: an oval dish that rises by `lift` along its length to a sharp rim."""
    i0, i1 = np.searchsorted(u, [at[0] - length, at[0] + length])
    j0, j1 = np.searchsorted(v, [at[1] - length, at[1] + length])
    du, dv = u[i0:i1, None] - at[0], v[None, j0:j1] - at[1]
    along = (np.cos(turn) * du + np.sin(turn) * dv) / (0.5 * length)
    across = (np.cos(turn) * dv - np.sin(turn) * du) / (0.28 * length)
    inside = along**2 + across**2 < 1.0
    if not inside.any():
        return
    patch = height[i0:i1, j0:j1]
    ground = float(np.median(patch[inside]))
    dish = ground + thick + 0.35 * length * lift * (0.5 * along + 0.5) - 0.5 * thick * (1.0 - across**2)
    patch[inside] = np.maximum(patch[inside], dish[inside])


def reef_model(*, cell: float = 0.02, seed: int = 8) -> Model:
    """Return the reef as a model with one part, `reef`; `cell` [m]: spacing of its heights, `seed`: of its shells."""
    table = _table(cell, seed)
    u, v = (np.linspace(-0.5 * size, 0.5 * size, round(size / cell) + 1) for size in (LENGTH, WIDTH))

    def height(at_u: Floats, at_v: Floats) -> Floats:
        """Return the height (n,) [m] of the table at (u, v), linear between its nodes."""
        places = np.stack([(at_u - u[0]) / (u[1] - u[0]), (at_v - v[0]) / (v[1] - v[0])])
        return np.asarray(map_coordinates(table, places, order=1, mode="nearest"))

    heights = HeightField(height, u, v, -1.0, float(table.max()) + 0.1, slope_frame())
    part = ModelPart("reef", heights.field, heights.bounds(), cell, REFLECTANCE, mesher=heights.triangulate)
    return Model("oyster reef", (part,))


def slope_frame() -> Floats:
    """Return T_scene_plane (4, 4) of the slope that the reef lies on."""
    c, s = np.cos(SLOPE), np.sin(SLOPE)
    return np.array([[1.0, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])


def reef_scene(*, cell: float = 0.02, seed: int = 8, changes: Sequence[Edit] = ()) -> Scene:
    """Return the reef after changes; `regions`: `pits`, which hold their floors. Scan it from `STATIONS`.

    Its curvature is that of a table of heights: of use over more than a few cells only.
    """
    pits = _pits(seed)

    def in_pits(points: Floats) -> Bools:
        """Return which points (n, 3) lie over a pit."""
        at = apply(invert(slope_frame()), points)
        return np.asarray((np.hypot(at[:, :1] - pits[:, 0], at[:, 1:2] - pits[:, 1]) < pits[:, 2]).any(axis=1))

    return dataclasses.replace(build_scene(reef_model(cell=cell, seed=seed), changes), regions={"pits": in_pits})
