"""Finished meshes as epochs: two real statues (`nikolov_statues`), unchanged and dented, with noise that nobody states.

Every epoch is the same mesh with noise of its own, set up elsewhere; half of them have a bowl pressed in. Relief finer
than the vertices and free edges are the statues' own. What the noise is, the comparison has to find.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import front_door
import numpy as np
import trimesh
from front_door import Epoch
from rows import Row, Size, in_percent, in_words, judge
from set_up_elsewhere import set_up_elsewhere
from shared_data import data_folder

from projects.formats import read_mesh, write_ply_mesh
from projects.model import Comparison, Floats, Surface

TITLE = "Finished meshes of two real statues: unchanged, and dented by 3 mm"
READS_REAL_DATA = True
LIMIT = 1200.0
STATUES = ("Angel_decimated.ply", "owl_decimated.ply")
N_EPOCHS = {"small": 1, "full": 6}  # of each statue, unchanged; as many dented
NOISE = 5e-5  # m, of each coordinate of a vertex
DEPTH, RADIUS = 0.003, 0.015  # m: of the bowl
SMALL_BARS = ("unchanged: epochs with a region",)


class Dented(NamedTuple):
    """What was said of a dent: whether it is a region, how many others there are, its depth less the true one (m)."""

    is_found: bool
    n_others: int
    depth_error: float


def run(size: Size) -> list[Row]:
    """Compare each statue with itself, moved, unchanged and dented."""
    unchanged: list[Comparison] = []
    dented: list[Dented] = []
    for index, name in enumerate(STATUES):
        statue = read_mesh(data_folder() / "nikolov_statues" / name, unit=1e-3)
        with tempfile.TemporaryDirectory() as folder:
            compared, told = compare_statue(statue, N_EPOCHS[size], np.random.default_rng([index, 23]), Path(folder))
        unchanged += compared
        dented += told
    return rows_of(unchanged, dented)


def compare_statue(
    statue: Surface, n: int, rng: np.random.Generator, folder: Path
) -> tuple[list[Comparison], list[Dented]]:
    """Return the comparisons of `n` unchanged epochs with the first, and what is said of `n` dented ones."""
    epochs = [write_epoch(folder, "first", statue.vertices, statue, rng, 2000)]
    centres: dict[str, Floats] = {}
    for k in range(n):
        moved = set_up_elsewhere(statue.vertices)
        epochs.append(write_epoch(folder, f"same-{k}", moved, statue, rng, 2001 + k))
        at = int(rng.integers(len(statue.vertices)))
        centres[f"dented-{k}"] = statue.vertices[at]
        dented = set_up_elsewhere(dent(statue, at))
        epochs.append(write_epoch(folder, f"dented-{k}", dented, statue, rng, 2001 + n + k))
    project = front_door.process(folder, epochs)
    same = [front_door.compare(project, "first", f"same-{k}") for k in range(n)]
    told = [judge_dent(front_door.compare(project, "first", name), at) for name, at in centres.items()]
    return same, told


def write_epoch(
    folder: Path, name: str, vertices: Floats, statue: Surface, rng: np.random.Generator, year: int
) -> Epoch:
    """Write the vertices with noise and the statue's faces as a mesh file."""
    path = folder / f"{name}.ply"
    write_ply_mesh(path, Surface(vertices + rng.normal(0.0, NOISE, vertices.shape), statue.faces))
    return Epoch(name, f"{year}-05-01", [], ("--mesh", path))


def dent(statue: Surface, at: int) -> Floats:
    """Return the vertices with a bowl pressed in around vertex `at`, along their normals."""
    normals = trimesh.Trimesh(statue.vertices, statue.faces, process=False).vertex_normals
    r2 = np.sum((statue.vertices - statue.vertices[at]) ** 2, axis=1) / RADIUS**2
    faces_alike = (normals @ normals[at] > 0.0).astype(float)  # not the far side of a thin part
    return statue.vertices - (DEPTH * np.clip(1.0 - r2, 0.0, None) * faces_alike)[:, None] * normals


def judge_dent(comparison: Comparison, centre: Floats) -> Dented:
    """Return whether the dent is a region, and what is said of its deepest place."""
    regions = comparison.regions
    is_near = np.linalg.norm(regions[["x", "y", "z"]].to_numpy(float) - centre, axis=1) < RADIUS
    found = regions[is_near]
    error = float(found["extreme_m"].min() + DEPTH) if len(found) else float("nan")
    return Dented(len(found) > 0, int((~is_near).sum()), error)


def rows_of(unchanged: Sequence[Comparison], dented: Sequence[Dented]) -> list[Row]:
    """Return the table."""
    n = sum(len(c.regions) > 0 for c in unchanged)
    share = float(np.mean([c.statistics["share_above_lod95"] for c in unchanged]))
    level = float(np.median([c.statistics["lod95_median_m"] for c in unchanged]))
    assessed = float(np.mean([1.0 - c.statistics["n_not_assessable"] / c.statistics["n_vertices"] for c in unchanged]))
    n_found, n_others = sum(d.is_found for d in dented), sum(d.n_others for d in dented)
    errors = np.abs([d.depth_error for d in dented if d.is_found])
    median = float(np.median(errors)) if len(errors) else float("nan")
    return [
        Row("unchanged: epochs with a region", f"{n} of {len(unchanged)}", judge(n == 0), asked="none", value=n),
        Row("unchanged: beyond lod95", in_percent(share, 1), value=share),
        Row("unchanged: median lod95, mm", in_words(1e3 * level, 2), value=1e3 * level),
        Row("unchanged: assessed", in_percent(assessed), value=assessed),
        Row("dented: found", f"{n_found} of {len(dented)}", value=n_found),
        Row("dented: other regions", f"{n_others}", judge(n_others == 0), asked="none", value=n_others),
        Row("dented: deepest, off the true 3 mm, median, mm", in_words(1e3 * median, 2), value=1e3 * median),
    ]


NOTES = (
    "Noise of 0.05 mm in each coordinate; vertices some 3 mm apart. The places of the dents are drawn among all "
    "vertices, those at rims and in folds, which the comparison may not be able to assess, among them."
)
