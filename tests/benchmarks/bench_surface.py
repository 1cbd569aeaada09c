"""The surface's speed and memory on a wavy sheet, step by step, against Open3D's (and MeshLab's) Poisson, in one run.

    python tests/benchmarks/bench_surface.py [points] [cell in mm]

A million points 1 mm apart (jittered) on waves of 90 and 140 mm, noise 0.3 mm, cells of 2.1 mm as in the published
comparisons; each engine runs in a process of its own, for its peak memory, and once before on few points, to compile.
Errors are of the vertices 10 mm inside of the edge, along z. Times are of the wall and of all threads together.
"""

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from monitor.reconstruction import SurfaceSettings, reconstruct_with_record
from monitor.reconstruction.localized import localized_mesh
from projects.model import Floats, PointCloud

SPACING, NOISE = 0.001, 0.0003
THREADS = 2


def wave(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Height (m) and unit normals of the sheet."""
    a, b = 2.0 * np.pi / 0.09, 2.0 * np.pi / 0.14
    height = 0.006 * np.sin(a * x) * np.cos(b * y)
    slope_x, slope_y = 0.006 * a * np.cos(a * x) * np.cos(b * y), -0.006 * b * np.sin(a * x) * np.sin(b * y)
    normals = np.column_stack([-slope_x, -slope_y, np.ones_like(x)])
    return height, normals / np.linalg.norm(normals, axis=1)[:, None]


def wavy_cloud(n_points: int) -> PointCloud:
    rng = np.random.default_rng(1)
    side = round(np.sqrt(n_points))
    x, y = (a.ravel() * SPACING for a in np.meshgrid(np.arange(side), np.arange(side)))
    x, y = (a + rng.uniform(-0.3, 0.3, side * side) * SPACING for a in (x, y))
    height, normals = wave(x, y)
    return PointCloud(np.column_stack([x, y, height]) + NOISE * rng.normal(size=(len(x), 1)) * normals, normals)


def run_field(cloud: PointCloud, cell: float) -> Floats:
    return localized_mesh(cloud.points, cloud.normals, cell, SPACING)[0]


def run_whole(cloud: PointCloud, cell: float) -> Floats:
    result = reconstruct_with_record(cloud, SurfaceSettings(cell_size=cell))
    assert np.median(result.surface.sigma) < NOISE
    return result.surface.vertices


def run_open3d(cloud: PointCloud, cell: float) -> Floats:
    from projects.open3d_library import load_open3d

    o3d = load_open3d()
    extent = float(np.ptp(cloud.points, axis=0).max())
    depth = int(np.ceil(np.log2(1.1 * extent / cell)))
    made = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points))
    made.normals = o3d.utility.Vector3dVector(cloud.normals)
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        made, depth=depth, scale=2.0**depth * cell / extent, n_threads=THREADS
    )
    return np.asarray(mesh.vertices)


def run_meshlab(cloud: PointCloud, cell: float) -> Floats:
    import pymeshlab

    extent = float(np.ptp(cloud.points, axis=0).max())
    depth = int(np.ceil(np.log2(1.1 * extent / cell)))
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=cloud.points, v_normals_matrix=cloud.normals))
    meshes.generate_surface_reconstruction_screened_poisson(
        depth=depth, scale=2.0**depth * cell / extent, threads=THREADS, preclean=False
    )
    return meshes.current_mesh().vertex_matrix()


ENGINES: dict[str, Callable[[PointCloud, float], Floats]] = {
    "field": run_field, "whole": run_whole, "open3d": run_open3d, "meshlab": run_meshlab}  # fmt: skip


def measure(name: str, n_points: int, cell: float) -> dict[str, Any]:
    """Run one engine in this process; figures of its time, memory and errors."""
    try:
        ENGINES[name](wavy_cloud(10_000), cell)
    except (ImportError, AttributeError):
        return {}
    cloud = wavy_cloud(n_points)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began, cpu = time.perf_counter(), time.process_time()
    vertices = ENGINES[name](cloud, cell)
    wall, cpu = time.perf_counter() - began, time.process_time() - cpu
    side = np.sqrt(n_points) * SPACING
    inside = (np.abs(vertices[:, :2] - 0.5 * side) < 0.5 * side - 0.01).all(axis=1) & (np.abs(vertices[:, 2]) < 0.02)
    height, normals = wave(*vertices[inside, :2].T)
    error = (vertices[inside, 2] - height) * normals[:, 2]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {"wall": wall, "cpu": cpu, "mb": peak / 1024.0, "mb_before": before / 1024.0, "vertices": len(vertices),
            "mean": error.mean(), "std": error.std()}  # fmt: skip


def main(n_points: int, cell: float) -> None:
    print(f"{n_points} points, cells of {1e3 * cell:g} mm, {THREADS} threads")
    print("engine      wall s    cpu s   peak MB  (before)   vertices  mean mm   std mm   open3d's cpu / its")
    environment = os.environ | {"NUMBA_NUM_THREADS": str(THREADS), "OMP_NUM_THREADS": str(THREADS)}
    theirs = 0.0
    for name in ("open3d", "meshlab", "field", "whole"):
        command = [sys.executable, __file__, "--one", name, str(n_points), str(cell)]
        found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True, env=environment).stdout)
        if not found:
            print(f"{name:10s} is not installed")
            continue
        theirs = theirs or found["cpu"]
        print(f"{name:10s} {found['wall']:7.1f} {found['cpu']:8.1f} {found['mb']:9.0f} {found['mb_before']:9.0f} "
              f"{found['vertices']:10d} {1e3 * found['mean']:+.4f}  {1e3 * found['std']:.4f} "
              f"{theirs / found['cpu']:8.2f}")  # fmt: skip
        assert abs(found["mean"]) < 1e-5


if __name__ == "__main__":
    if "--one" in sys.argv:
        name, size, cell_size = sys.argv[2:5]
        print(json.dumps(measure(name, int(size), float(cell_size))))
    else:
        numbers = [float(a) for a in sys.argv[1:]]
        main(int(numbers[0]) if numbers else 1_000_000, numbers[1] / 1e3 if len(numbers) > 1 else 2.1e-3)
