"""Cracks a few points wide that opened in a wall: which are told, how much of their mouths, and how deep.

A surface needs some five points across a hollow to follow it; of narrower ones the points tell, and they alone. A wall
with five new cracks of 3 to 15 mm, as deep as 30 mm, and joints that both epochs have; three stations before it, points
2 mm apart in each scan, through files and the command line, all settings automatic. The truth is the mouth of each
crack.
"""

from __future__ import annotations

from dataclasses import dataclass

import front_door
import numpy as np
import pandas as pd
from moved_bosses import stations
from rows import Row, Size, in_words, judge, mean_of

from monitor.simulation import Body, Scene
from monitor.simulation.scenes import grid_faces
from projects.model import Comparison, Floats

TITLE = "Cracks a few points wide that opened in a wall"
LIMIT = 1800.0
LENGTH, DEPTH, CELL, STEEP = 0.2, 0.03, 0.002, 1e-4  # m
SPACING = 0.002  # m, of the points of a scan
PLACES = ((-60.0, 2.2, 0.5), (-90.0, 2.4, 0.2), (-120.0, 2.3, 0.8))  # degrees, m, m
MIDDLE = 0.25  # m, half as high as the wall
BOX = np.array([[-0.43, -0.1, 0.02], [0.43, 0.1, 0.48]])
PAIRS = {"small": 1, "full": 8}
TOLD, AREA = 2.0, 0.2  # spacings wide, from which on cracks are to be told; share by which areas may be off


@dataclass(frozen=True)
class Crack:
    """An upright slit at x [m], so wide [m]."""

    x: float
    width: float

    def covers(self, x: Floats, z: Floats) -> np.ndarray:
        """Return whether places of the wall lie in its mouth."""
        return (np.abs(x - self.x) < self.width / 2) & (np.abs(z - MIDDLE) < LENGTH / 2)


WIDTHS = ((-0.36, 0.003), (-0.2, 0.004), (-0.04, 0.006), (0.12, 0.008), (0.28, 0.015))  # m, at m
NEW = tuple(Crack(x, width) for x, width in WIDTHS)
JOINTS = (Crack(-0.28, 0.004), Crack(0.36, 0.008))


def wall(cracks: tuple[Crack, ...]) -> Scene:
    """Return a wall that looks along -y, with these cracks."""
    sides = [c.x + sign * c.width / 2 + off for c in (*NEW, *JOINTS) for sign in (-1, 1) for off in (-STEEP, STEEP)]
    ends = [MIDDLE + sign * LENGTH / 2 + off for sign in (-1, 1) for off in (-STEEP, STEEP)]
    x, z = np.meshgrid(np.unique(np.concatenate([np.arange(-0.45, 0.45, CELL), sides])),
                       np.unique(np.concatenate([np.arange(0.0, 0.5, CELL), ends])), indexing="ij")  # fmt: skip
    y = -0.004 * np.sin(x / 0.03) * np.cos(z / 0.04)
    for crack in cracks:
        y = np.where(crack.covers(x, z), y + DEPTH, y)
    vertices = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    faces = np.ascontiguousarray(grid_faces(*x.shape), np.int32)
    return Scene("wall", (Body("wall", vertices, faces, 0.6),))


def compare_walls(seed: int) -> Comparison:
    """Return the comparison of the wall before and after the cracks opened."""
    rng = np.random.default_rng([seed, 61])
    states = [(wall(cracks), stations(rng, SPACING, PLACES, MIDDLE)) for cracks in (JOINTS, (*JOINTS, *NEW))]
    return front_door.compare_states(states, BOX, seed)[0]


def regions_at(crack: Crack, regions: pd.DataFrame) -> pd.DataFrame:
    """Return the regions whose centre lies in or next to a crack."""
    is_near = (np.abs(regions["x"] - crack.x) < crack.width / 2 + 0.01) & (np.abs(regions["z"] - MIDDLE) < LENGTH / 2)
    return regions[is_near]


def run(size: Size) -> list[Row]:
    """Survey pairs and tell what became of each crack."""
    found = [compare_walls(seed).regions for seed in range(PAIRS[size])]
    rows = [row_of(crack, found) for crack in NEW]
    n_known = [sum(len(regions_at(crack, regions)) for crack in (*NEW, *JOINTS)) for regions in found]
    n_joints = sum(len(regions_at(joint, regions)) for joint in JOINTS for regions in found)
    n_others = sum(len(regions) - n for regions, n in zip(found, n_known, strict=True))
    rows.append(Row("regions at joints that both epochs have, and elsewhere", f"{n_joints} and {n_others}",
                    judge(n_joints + n_others == 0), asked="none", value=float(n_joints + n_others)))  # fmt: skip
    return rows


def row_of(crack: Crack, found: list[pd.DataFrame]) -> Row:
    """Return the row of one crack."""
    of = [regions_at(crack, regions) for regions in found]
    told = [regions for regions in of if len(regions)]
    areas = [regions["area_m2"].sum() / (crack.width * LENGTH) for regions in told]
    deepest = [-1e3 * regions["extreme_m"].min() for regions in told]
    volumes = [regions["volume_m3"].sum(skipna=False) / (-crack.width * LENGTH * DEPTH) for regions in told]
    mean, error = mean_of(areas) if areas else (np.nan, np.nan)
    is_asked = crack.width >= TOLD * SPACING
    holds = len(told) == len(found) and abs(mean - 1.0) <= AREA
    n_known = int(np.isfinite(volumes).sum())
    others = {"in pieces": in_words(float(np.mean([len(r) for r in told])), 1) if told else "-",
              "mouth over the true one": f"{in_words(mean, 2)} ± {in_words(error, 2)}",
              "deepest, mm (true 30)": in_words(float(np.mean(deepest)), 1) if told else "-",
              "volume over the true one": f"{in_words(float(np.nanmean(volumes)), 2)}, known in {n_known}"
                                          if n_known else "not known"}  # fmt: skip
    return Row(f"{1e3 * crack.width:.0f} mm wide", f"told in {len(told)} of {len(found)}",
               judge(holds) if is_asked else "stated",
               asked=f"all, mouth within {AREA:.0%}" if is_asked else "", others=others,
               value=len(told) / len(found))  # fmt: skip
