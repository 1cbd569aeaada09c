"""Change regions: what hangs together over both surfaces becomes one region with its figures (design step 13).

A region joins changed vertices of one sign that are neighbours on a surface or each other's foot. It must hold as a
whole: it makes a patch that is significant among all patches tested (Bonferroni), so the chance that an unchanged
object shows any region is at most the level. Specks smaller than the area over which errors agree (one independent
witness) are no regions. What is no region is not called changed.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from monitor.comparison.detection import Detected, Detection, Tested
from monitor.comparison.region_figures import describe_region, is_volume_known, spread_margin
from monitor.comparison.side import Side
from monitor.comparison.units import sum_groups
from projects.model import REGION_COLUMNS, Ints, Registration


def find_regions(sides: tuple[Side, Side], found: Detected, registration: Registration, level: float,
                 ) -> tuple[pd.DataFrame, tuple[Ints, Ints]]:  # fmt: skip
    """Return the table of regions, largest first, and the region of each vertex of both sides (0: none)."""
    parts = connect_sides(sides, found.sides)
    area = np.zeros(max(int(p.max(initial=-1)) for p in parts) + 1)
    for side, part in zip(sides, parts, strict=True):
        own = np.bincount(part[part >= 0], side.areas[part >= 0], minlength=len(area))
        area = np.maximum(area, own)
    candidate = area >= least_area(sides, found)
    kept = np.array([k for k in np.flatnonzero(candidate) if holds(int(k), sides, found.test, parts, level)],
                    dtype=np.int64)  # fmt: skip
    number = np.zeros(len(area) + 1, dtype=np.int32)
    number[kept] = np.arange(1, len(kept) + 1)
    regions = [number[part] for part in parts]  # part -1 is the last entry: 0
    width = min(found.noise.correlation.length, found.test.size)
    margins = [spread_margin(s, r, width) for s, r in zip(sides, regions, strict=True)]
    rows = [describe_region(k, sides, found, (regions[0], regions[1]), (margins[0], margins[1]), registration)
            for k in range(1, len(kept) + 1)]  # fmt: skip
    table = pd.DataFrame(rows, columns=list(REGION_COLUMNS))
    known = np.logical_and(*(is_volume_known(s, r, found.test.size, len(kept))
                             for s, r in zip(sides, regions, strict=True)))  # fmt: skip
    table.loc[~known, ["volume_m3", "sigma_volume_m3"]] = np.nan
    order = np.argsort(-table["area_m2"].to_numpy(dtype=float), kind="stable")
    rank = np.zeros(len(kept) + 1, dtype=np.int32)
    rank[order + 1] = np.arange(1, len(kept) + 1)
    table = table.iloc[order].reset_index(drop=True)
    table["region"] = np.arange(1, len(kept) + 1)
    return table, (rank[regions[0]], rank[regions[1]])


def holds(number: int, sides: tuple[Side, Side], test: Tested, parts: tuple[Ints, Ints], level: float) -> bool:
    """Whether a part makes up at least half of the change of a patch that is significant among all patches tested.

    Noise beside a large change shares its patches, but does not make them.
    """
    for k, side in enumerate(sides):
        units = test.units[k]
        vertices = np.flatnonzero((parts[k] == number) & (units.number >= 0))
        change = side.areas[vertices] * side.distances[vertices]
        here = sum_groups(units.number[vertices], change, len(units.means))
        for patches, p_values in zip(test.patches, test.p_values, strict=True):
            whole = patches[k].members @ (units.areas * units.means)
            share = (patches[k].members @ here) / np.where(whole == 0.0, np.inf, whole)
            if ((p_values[k] <= level / test.n_tested) & (share >= 0.5)).any():
                return True
    return False


def least_area(sides: tuple[Side, Side], found: Detected) -> float:
    """Return the area [m2] below which a speck is no region: one witness, at least a handful of vertices."""
    spacing2 = max(float(np.median(s.areas)) for s in sides)
    return max(min(found.noise.correlation.area, found.test.size**2), 7.0 * spacing2)


def connect_sides(sides: tuple[Side, Side], found: tuple[Detection, Detection]) -> tuple[Ints, Ints]:
    """Return the connected part of each vertex of both sides, -1 where not changed; numbers are common to both."""
    n_first = len(sides[0].areas)
    n = n_first + len(sides[1].areas)
    changed = np.concatenate([f.is_changed for f in found])
    sign = np.concatenate([np.sign(f.smooth) for f in found])
    links = [sides[0].edges, sides[1].edges + n_first]
    links += [_foot_links(sides[0]) + np.array([0, n_first]), _foot_links(sides[1]) + np.array([n_first, 0])]
    pairs = np.vstack(links)
    pairs = pairs[changed[pairs].all(axis=1)]
    pairs = pairs[sign[pairs[:, 0]] == sign[pairs[:, 1]]]
    graph = coo_matrix((np.ones(len(pairs), dtype=np.int8), pairs.T), shape=(n, n))
    _, part = connected_components(graph, directed=False)
    out = np.full(n, -1, dtype=np.int64)
    _, out[changed] = np.unique(part[changed], return_inverse=True)
    return out[:n_first], out[n_first:]


def _foot_links(side: Side) -> Ints:
    """Return (vertex, nearest vertex of its foot's face on the other surface) for each assessed vertex."""
    at = np.flatnonzero(side.is_assessed)
    corner = side.feet.weights[at].argmax(axis=1)
    return np.column_stack([at, side.other.faces[side.feet.faces[at], corner]]).astype(np.int64)
