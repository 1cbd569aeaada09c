"""A real dry stone wall (`vapc_rockwall`, MIT) against itself: points drawn at random make epochs without a change.

Half of the points of a stretch are one epoch; the other half, and two draws of three in ten of that half, are others.
Their noise, relief, shadows and vegetation are real, nothing moved, and the sampling is all that differs. Into one of
the halves a wear of known depth is pressed. The station is not known: it stands 10 m before the wall.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import front_door
import numpy as np
from front_door import Epoch
from rockwall import read_wall
from rows import Row, Size, in_percent, in_words, judge

from projects.model import Comparison, Floats

TITLE = "A real dry stone wall against itself: no change, sampled differently"
READS_REAL_DATA = True
LIMIT = 2400.0
LENGTH = 4.0  # m of a stretch
N_STRETCHES = {"small": 1, "full": 4}
DENSE, SPARSE = ("half",), ("sparse-1", "sparse-2")
SHARE = 0.3  # of the other half, in a sparse epoch
WEAR, RADIUS, FLAT = 0.005, 0.15, 0.01  # m: deepest, radius, relief within it at most (one sigma)
SMALL_BARS = ("a half against the other: stretches with a region",)


def run(size: Size) -> list[Row]:
    """Compare the draws of each stretch of the wall, and a worn one."""
    points = read_wall(LENGTH * N_STRETCHES[size])
    first = points[:, 0].min()
    unchanged: dict[str, list[Comparison]] = {name: [] for name in DENSE + SPARSE}
    for k in range(N_STRETCHES[size]):
        own = points[(points[:, 0] >= first + k * LENGTH) & (points[:, 0] < first + (k + 1) * LENGTH)]
        rng = np.random.default_rng([k, 17])
        with tempfile.TemporaryDirectory() as folder:
            compared, row = compare_stretch(own, rng, Path(folder))
        for name, comparison in compared.items():
            unchanged[name].append(comparison)
    dense = [c for name in DENSE for c in unchanged[name]]
    sparse = [c for name in SPARSE for c in unchanged[name]]
    return [*rows_of("a half against the other", dense), row, *rows_of("a half against three in ten of it", sparse)]


def compare_stretch(points: Floats, rng: np.random.Generator, folder: Path) -> tuple[dict[str, Comparison], Row]:
    """Return the comparisons of the draws of one stretch with the first half, and what is said of a wear."""
    is_first = rng.random(len(points)) < 0.5
    rest = points[~is_first]
    worn, centre, depth = wear(rest, rng)
    clouds = {"first": points[is_first], "half": rest, "worn": worn}
    clouds |= {name: rest[rng.random(len(rest)) < SHARE] for name in SPARSE}
    epochs = [write_epoch(folder, name, cloud, year) for year, (name, cloud) in enumerate(clouds.items(), 2020)]
    project = front_door.process(folder, epochs)
    compared = {name: front_door.compare(project, "first", name) for name in clouds if name != "first"}
    return {name: compared[name] for name in DENSE + SPARSE}, row_of_wear(compared["worn"], centre, depth)


def write_epoch(folder: Path, name: str, points: Floats, year: int) -> Epoch:
    """Write the points and their pose as a survey would leave them."""
    path, poses = folder / f"{name}.xyz", folder / f"{name}.poses"
    np.savetxt(path, points, fmt="%.5f")
    station = f"{np.median(points[:, 0]):.3f} -10 1"
    poses.write_text(f"{path.name} 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 {station}\n")
    return Epoch(name, f"{year}-05-01", [path], ("--poses", str(poses)))


def wear(points: Floats, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Return the points with a bowl pressed into a stone's face, its centre (3,) and its inward direction (3,)."""
    for at in points[rng.permutation(len(points))]:
        own = points[np.linalg.norm(points - at, axis=1) < RADIUS]
        if len(own) < 60:
            continue
        middle = own.mean(axis=0)
        values, vectors = np.linalg.eigh(np.cov((own - middle).T))
        inward = vectors[:, 0] * np.sign(vectors[1, 0])
        if values[0] < FLAT**2 and inward[1] > 0.7 and np.linalg.norm(middle - at) < 0.2 * RADIUS:
            r = np.linalg.norm(points - at, axis=1) / RADIUS
            return points + WEAR * np.clip(1.0 - r**2, 0.0, None)[:, None] * inward, at, inward
    raise AssertionError("no stone of this stretch has a face flat enough for the wear")


def row_of_wear(comparison: Comparison, centre: Floats, inward: Floats) -> Row:
    """Return whether the wear was found as the only region, and how deep it is said to be at its middle."""
    side = comparison.on_reference
    near = np.linalg.norm(side.surface.vertices - centre, axis=1) < 0.3 * RADIUS
    found = float(np.nanmedian(side.distances[near]))
    r2 = np.sum((side.surface.vertices[near] - centre) ** 2, axis=1) / RADIUS**2
    assert side.surface.normals is not None
    true = -WEAR * float(np.median((1.0 - r2) * np.abs(side.surface.normals[near] @ inward)))
    is_there = int(np.linalg.norm(comparison.regions[["x", "y", "z"]] - centre, axis=1).min(initial=np.inf) < RADIUS)
    n_others = len(comparison.regions) - is_there
    holds = is_there == 1 and n_others == 0 and abs(found - true) < 0.2 * WEAR
    return Row(
        f"{1e3 * WEAR:g} mm pressed into a face, {2e3 * RADIUS:.0f} mm wide: at its middle, mm",
        f"{in_words(1e3 * found, 2, signed=True)}, truth {in_words(1e3 * true, 2, signed=True)}; "
        f"{'found' if is_there else 'missed'}, {n_others} other region{'s' if n_others != 1 else ''}",
        judge(holds), asked="within 1 mm, no other region", value=found - true,
    )  # fmt: skip


def rows_of(what: str, compared: Sequence[Comparison]) -> list[Row]:
    """Return the rows of unchanged stretches."""
    n = sum(len(c.regions) > 0 for c in compared)
    share = float(np.mean([c.statistics["share_above_lod95"] for c in compared]))
    level = float(np.median([c.statistics["lod95_median_m"] for c in compared]))
    assessed = float(np.mean([1.0 - c.statistics["n_not_assessable"] / c.statistics["n_vertices"] for c in compared]))
    return [
        Row(f"{what}: stretches with a region", f"{n} of {len(compared)}", judge(n == 0), asked="none", value=n),
        Row(f"{what}: beyond lod95", in_percent(share, 1), value=share),
        Row(f"{what}: median lod95, mm", in_words(1e3 * level, 2), value=1e3 * level),
        Row(f"{what}: assessed", in_percent(assessed), value=assessed),
    ]


NOTES = (
    "Stretches of 4 m of the wall. Points of a half lie some 20 mm apart, of three in ten of it 40 mm, among stones "
    "whose joints are no wider: between points so sparse the surface is a guess, which the points then bear out or not."
)
