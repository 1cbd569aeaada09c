"""Bosses with steep edges that moved along the ground they stand on, by little: only their edges show it.

A plaque with three flat bosses, as letters or appliques are, whose sides rise 79 degrees. All of them moved between the
epochs, so that no edge of the object tells how edges err. Through files and the command line, three stations an epoch
at 2.3 m, other ones each time, all settings automatic. A boss is told where it lost on the side that it left and
gained on the side that it moved to.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import front_door
import numpy as np
from rows import Row, Size

from monitor.simulation import Body, Scene, misregister, stand_at
from monitor.simulation.scenes import grid_faces
from monitor.simulation.stations import Station
from projects.model import Comparison

TITLE = "Bosses with steep edges that moved along their ground"
LIMIT = 3600.0
MIDDLES = np.array([[-0.14, 0.20], [0.0, 0.22], [0.13, 0.17]])  # m, along x and z
RADIUS, WALL, CELL = 0.020, 0.0015, 0.0008  # m: of a boss, how wide its sides are seen from the front, of triangles
HEIGHTS, SPACINGS, MOVES = (0.004, 0.008), (0.001, 0.002), (0.0, 0.001, 0.002, 0.004)  # m
STATIONS = ((-60.0, 2.2, 0.6), (-90.0, 2.4, 0.2), (-120.0, 2.3, 0.9))  # degrees, m, m
BOX = np.array([[-0.245, -0.05, 0.005], [0.245, 0.03, 0.395]])
ALONG = np.array([0.8, 0.6])  # of x and z, the way that they move


def plaque(height: float, move: float) -> Scene:
    """Return the plaque with its bosses so high [m], having moved so far [m]."""
    x, z = np.meshgrid(np.arange(-0.25, 0.25, CELL), np.arange(0.0, 0.4, CELL), indexing="ij")
    y = -0.004 * np.sin(x / 0.03) * np.cos(z / 0.04)
    for middle in MIDDLES + move * ALONG:
        away = np.hypot(x - middle[0], z - middle[1])
        y -= height * np.clip((RADIUS - away) / WALL, 0.0, 1.0)
    faces = grid_faces(*x.shape)  # counter-clockwise from the front, which is -y
    vertices = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    return Scene("plaque", (Body("plaque", vertices, np.ascontiguousarray(faces, np.int32), 0.6),))


def stations(rng: np.random.Generator, spacing: float, places: Sequence[tuple[float, float, float]] = STATIONS,
             middle: float = 0.2) -> tuple[Station, ...]:  # fmt: skip
    """Return those of an epoch before a wall whose `middle` is so high [m], points so far apart [m]; `places` are
    degrees, m away and m high, met to some degrees."""
    out = []
    for k, (angle, distance, height) in enumerate(places, start=1):
        turn = np.radians(angle + rng.normal(scale=3.0))
        place = np.array([distance * np.cos(turn), distance * np.sin(turn), height])
        pose = stand_at(place, facing=np.array([0.0, 0.0, middle]), heading=rng.uniform(-0.3, 0.3))
        given = misregister(pose, rng, sigma_position=2e-4, sigma_angle=3e-5)
        out.append(Station(f"station {k}", pose, spacing / distance, given))
    return tuple(out)


def compare_moves(height: float, spacing: float, moves: tuple[float, ...], seed: int) -> list[Comparison]:
    """Return the comparisons of the plaque as it stood first with each state after a move [m]."""
    rng = np.random.default_rng([seed, 21])
    return front_door.compare_states([(plaque(height, move), stations(rng, spacing)) for move in (0.0, *moves)],
                                     BOX, seed)  # fmt: skip


def count_told(found: Comparison, move: float) -> tuple[int, int]:
    """Return how many bosses are told, and how many regions lie on none of their edges."""
    places = found.regions[["x", "z"]].to_numpy(dtype=float)
    signs = np.sign(found.regions["mean_m"].to_numpy(dtype=float))
    n_told, is_beside = 0, np.ones(len(places), dtype=bool)
    for middle in MIDDLES + 0.5 * move * ALONG if move else ():
        on_edge = np.linalg.norm(places - middle, axis=1) < RADIUS + 0.005
        ahead = (places - middle) @ ALONG
        gained, lost = on_edge & (ahead > 0.0) & (signs > 0.0), on_edge & (ahead < 0.0) & (signs < 0.0)
        n_told += bool(gained.any() and lost.any())
        is_beside &= ~on_edge
    return n_told, int(is_beside.sum())


def run(size: Size) -> list[Row]:
    """Compare plaques of two heights, points 1 and 2 mm apart, and say of each move how many bosses were told."""
    cases = list(itertools.product(HEIGHTS, SPACINGS)) if size == "full" else [(0.008, 0.002)]
    moves = MOVES if size == "full" else (0.004,)
    rows = []
    for seed, (height, spacing) in enumerate(cases, start=1):
        for move, found in zip(moves, compare_moves(height, spacing, moves, seed), strict=True):
            rows.append(row_of(height, spacing, move, found))
    return rows


def row_of(height: float, spacing: float, move: float, found: Comparison) -> Row:
    """Return how many of the bosses that moved so far are told."""
    n_told, n_false = count_told(found, move)
    kinds = ", ".join(sorted(set(found.regions["kind"])))
    others = {"regions elsewhere": str(n_false), "called": kinds,
              "median level, mm": f"{1e3 * found.statistics['lod95_median_m']:.2f}"}  # fmt: skip
    what = f"bosses {1e3 * height:.0f} mm high, points {1e3 * spacing:.0f} mm apart, moved by {1e3 * move:.0f} mm: told"
    return Row(what, f"{n_told} of {len(MIDDLES)}" if move else "none moved", others=others, value=float(n_told))


NOTES = (
    "The ground is bumpy by 4 mm, so that nothing but the edges of the bosses tells their move. No bar is asked for."
)
SMALL_BARS = ()
