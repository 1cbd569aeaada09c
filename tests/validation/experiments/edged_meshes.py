"""Finished meshes of a sharp-edged body as other programs make them: unchanged, and with chips and hollows.

The pedestal of the demo's figure, its points drawn anew for each epoch and turned anew against the grid that the mesh
comes of: Open3D's Poisson surface, a contour that was smoothed, and one that was decimated. Each way of making a mesh
rounds edges otherwise, and otherwise each time; nobody states it. Every later epoch stands elsewhere, and is compared
with one made in the same way.
"""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import front_door
import numpy as np
import open3d as o3d
import trimesh
from front_door import Epoch
from region_places import look_at, places_of_regions
from rows import Row, Size, in_percent, in_words, judge
from set_up_elsewhere import set_up_elsewhere

from monitor.simulation.changes import Edit, hollow_out
from monitor.simulation.model import only_near
from monitor.simulation.pedestal import DIE, DIE_HALF_WIDTH, HALF_WIDTH, PANEL_DEPTH, pedestal_part
from monitor.simulation.solid import Field, Solid, contour
from projects.formats import write_ply_mesh
from projects.model import Comparison, Floats, Surface

TITLE = "Finished meshes of a sharp-edged pedestal, by other programs: unchanged, and hollowed by 3 to 10 mm"
LIMIT = 2400.0
N_PAIRS: dict[Size, int] = {"small": 1, "full": 4}  # of each way, unchanged; as many changed
CELL, SPACING = 0.003, 0.0025  # m, of the grids, and between the points of a Poisson surface
NOISE = 1.5e-4  # m, of each coordinate of a point or vertex
DECIMATED = 6  # times fewer faces
BOX = np.array([[-0.25, -0.25, 0.008], [0.25, 0.25, 0.46]])
NEAR = 0.015  # m: a region lies on a hollow if its centre lies so near
SMALL_BARS = ("Poisson by Open3D: unchanged pairs with a region",)


class Hollow(NamedTuple):
    """A hollow: its name, where it is and its half axes [m], and how deep it is [m], NaN where no one figure says."""

    name: str
    place: tuple[float, float, float]
    axes: tuple[float, float, float]
    depth: float


HOLLOWS = (
    Hollow("in a panel", (0.04, DIE_HALF_WIDTH - PANEL_DEPTH, 0.2), (0.015, 0.003, 0.015), 0.003),
    Hollow("in a plinth's face", (-HALF_WIDTH, 0.05, 0.03), (0.004, 0.012, 0.012), 0.004),
    Hollow("on an arris", (DIE_HALF_WIDTH, DIE_HALF_WIDTH, 0.5 * (DIE[0] + DIE[1])), (0.010, 0.010, 0.010), np.nan),
    Hollow("on a cornice", (HALF_WIDTH, -0.06, 0.406), (0.010, 0.010, 0.010), np.nan),
)


@functools.cache
def edits() -> tuple[Edit, ...]:
    """Return what takes the hollows off."""
    return tuple(hollow_out(h.name, np.array(h.place), np.array(h.axes)) for h in HOLLOWS)


def shape(is_hollowed: bool) -> Field:
    """Return the pedestal, whole or hollowed."""
    field: Field = Solid((pedestal_part(),))
    for edit in edits() if is_hollowed else ():
        field = only_near(edit, field)
    return field


def contour_turned(is_hollowed: bool, cell: float, rng: np.random.Generator) -> trimesh.Trimesh:
    """Return the pedestal's contour on a grid that lies across it in any way."""
    R, middle = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3], BOX.mean(axis=0)
    half = 0.5 * float(np.linalg.norm(np.ptp(BOX, axis=0)))
    field = shape(is_hollowed)
    low = -half - rng.uniform(0.0, cell, 3)
    vertices, faces = contour(
        lambda points: field(R.T @ points + middle[:, None]), np.array([low, np.full(3, half)]), cell=cell
    )
    return trimesh.Trimesh(vertices @ R + middle, faces, process=False)


def by_poisson(is_hollowed: bool, rng: np.random.Generator) -> Surface:
    """Return Open3D's Poisson surface of points drawn on the pedestal, with normals that it fits to them."""
    true = contour_turned(is_hollowed, 0.5 * CELL, rng)
    points, face = trimesh.sample.sample_surface(true, int(true.area / SPACING**2), seed=int(rng.integers(1 << 30)))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points + rng.normal(0.0, NOISE, points.shape)))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(20))
    fitted = np.asarray(cloud.normals)
    outward = np.sign(np.sum(fitted * true.face_normals[face], axis=1))
    cloud.normals = o3d.utility.Vector3dVector(fitted * outward[:, None])
    depth = int(np.ceil(np.log2(1.1 * np.ptp(points, axis=0).max() / CELL)))
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=depth, n_threads=1)
    return as_surface(mesh)


def smoothed(is_hollowed: bool, rng: np.random.Generator) -> Surface:
    """Return a noisy contour, smoothed twice."""
    return as_surface(noisy_contour(is_hollowed, rng).filter_smooth_laplacian(2))


def decimated(is_hollowed: bool, rng: np.random.Generator) -> Surface:
    """Return a noisy contour with a sixth of its faces."""
    mesh = noisy_contour(is_hollowed, rng, cell=0.8 * CELL)
    return as_surface(mesh.simplify_quadric_decimation(len(mesh.triangles) // DECIMATED))


def noisy_contour(is_hollowed: bool, rng: np.random.Generator, cell: float = CELL) -> o3d.geometry.TriangleMesh:
    """Return the pedestal's contour with noise on its vertices."""
    true = contour_turned(is_hollowed, cell, rng)
    vertices = true.vertices + rng.normal(0.0, NOISE / 3.0, true.vertices.shape)
    return o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(np.asarray(true.faces, dtype=np.int32))
    )


def as_surface(mesh: o3d.geometry.TriangleMesh) -> Surface:
    """Return a mesh of Open3D as ours."""
    return Surface(np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int32))


WAYS: dict[str, Callable[[bool, np.random.Generator], Surface]] = {
    "Poisson by Open3D": by_poisson, "contour, smoothed": smoothed, "contour, a sixth of its faces": decimated,
}  # fmt: skip


def compare_pair(name: str, seed: int) -> tuple[Comparison, Comparison]:
    """Return the comparisons of one pair of unchanged epochs, and of the second with a hollowed one."""
    rng = np.random.default_rng([seed, list(WAYS).index(name), 61])
    with tempfile.TemporaryDirectory() as folder:
        told = []
        for k, is_hollowed in enumerate((False, False, True)):
            mesh, path = WAYS[name](is_hollowed, rng), Path(folder) / f"e{k}.ply"
            vertices = mesh.vertices if k == 0 else set_up_elsewhere(mesh.vertices)
            write_ply_mesh(path, Surface(vertices, mesh.faces))
            told.append(Epoch(f"e{k}", f"200{k}-05-01", [], ("--mesh", path)))
        project = front_door.process(Path(folder), told)
        return front_door.compare(project, "e0", "e1"), front_door.compare(project, "e0", "e2")


def run(size: Size) -> list[Row]:
    """Compare so many pairs made in each way."""
    names = list(WAYS) if size == "full" else list(WAYS)[:1]
    return [
        row for name in names for row in rows_of(name, [compare_pair(name, k) for k in range(1, N_PAIRS[size] + 1)])
    ]


def rows_of(name: str, pairs: list[tuple[Comparison, Comparison]]) -> list[Row]:
    """Return what is said of the pairs made in one way."""
    same, later = [s for s, _ in pairs], [h for _, h in pairs]
    n = sum(len(c.regions) > 0 for c in same)
    share = float(np.mean([c.statistics["share_above_lod95"] for c in same]))
    level = float(np.median([c.statistics["lod95_median_m"] for c in same]))
    others = sum(hollows_of(c).count(-1) for c in later)
    off = np.concatenate([errors_of_depth(c) for c in later])
    rows = [
        Row(f"{name}: unchanged pairs with a region", f"{n} of {len(same)}", judge(n == 0), asked="none", value=n,
            others={"beyond lod95": in_percent(share, 1), "median lod95, mm": in_words(1e3 * level, 2)}),
        Row(f"{name}: regions beside the hollows", str(others), judge(others == 0), asked="none", value=others),
    ]  # fmt: skip
    for k, hollow in enumerate(HOLLOWS):
        n = sum(k in hollows_of(c) for c in later)
        unchanged = sum(look_at(c, np.array(hollow.place))[0] for c in later)
        rows.append(Row(f"{name}: a hollow {hollow.name}: told", f"{n} of {len(later)}", judge(n == len(later)),
                        asked="all", value=n,
                        others={"its middle called unchanged": f"{unchanged} of {len(later)}"}))  # fmt: skip
    worst = float(np.abs(off).max()) if len(off) else float("nan")
    return [*rows, Row(f"{name}: depth in faces off, at most, mm", in_words(1e3 * worst, 2), value=worst)]


def hollows_of(comparison: Comparison) -> list[int]:
    """Return the hollow that each region lies on, -1 where on none."""
    return places_of_regions(comparison, [np.array(h.place) for h in HOLLOWS], NEAR)


def errors_of_depth(comparison: Comparison) -> Floats:
    """Return how far off [m] the depths of the hollows in faces are told."""
    return np.array([comparison.regions["extreme_m"][k] + HOLLOWS[hollow].depth
                     for k, hollow in enumerate(hollows_of(comparison))
                     if hollow >= 0 and np.isfinite(HOLLOWS[hollow].depth)])  # fmt: skip


NOTES = (
    "Cells 3 mm, 0.15 mm of noise in each coordinate of a Poisson surface's points, 0.05 mm of a contour's vertices. "
    "Hollows: 30 mm wide and 3 mm deep in a panel, 24 and 4 mm in a face, balls of 10 mm off an arris and a cornice. A "
    "contour is smoothed as often in each epoch: what another smoothing takes off mouldings is told, as another shape."
)
