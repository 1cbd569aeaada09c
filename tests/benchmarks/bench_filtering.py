"""Raw to thinned, all steps, on a simulated grid scan: `python tests/benchmarks/bench_filtering.py [N ...]`.

Each size runs in a process of its own (peak memory is its own); Open3D does in the same process what it has of the
same work: statistical outliers, plain normals, voxel means. Points a second are of CPU time times `CORES`, as long as
the cores are shared with others, and of the clock beside.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from projects.model import PointCloud, Scan

SIZES = (250_000, 500_000, 1_000_000)
CORES = 2
DISTANCE, STEP, NOISE = 4.0, 1.6e-4, 0.5e-3  # m, rad (0.64 mm), m


def grid_scan(n_points: int, seed: int = 1) -> Scan:
    """Return a scan of a wavy wall with steps, row by row, one in a hundred pulses a gross error."""
    rng = np.random.default_rng(seed)
    n_rows = int(np.sqrt(n_points / 2))
    rows, columns = (a.ravel().astype(np.int32) for a in np.mgrid[:n_rows, : n_points // n_rows])
    azimuth, elevation = STEP * (columns - columns.max() / 2), STEP * (rows - n_rows / 2)
    relief = 0.02 * np.sin(25 * azimuth) * np.cos(31 * elevation) + 0.03 * (np.sin(9 * azimuth + 4 * elevation) > 0.6)
    ranges = DISTANCE / (np.cos(azimuth) * np.cos(elevation)) - relief + rng.normal(0, NOISE, len(rows))
    wrong = rng.random(len(rows)) < 0.01
    ranges[wrong] += rng.uniform(-0.02, 0.02, wrong.sum())
    beams = np.column_stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    return Scan("bench", PointCloud(ranges[:, None] * beams), np.eye(4), rows=rows, columns=columns)


def peak_mib() -> float:
    """Return the most memory that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def timed(work: Callable[[], Any]) -> tuple[Any, float, float]:
    """Return what `work` returns, its CPU time and its time by the clock [s]."""
    cpu, wall = time.process_time(), time.perf_counter()
    result = work()
    return result, time.process_time() - cpu, time.perf_counter() - wall


def ours(n_points: int) -> dict[str, Any]:
    """Filter and thin a scan; the kernels are compiled before."""
    from monitor.filtering import filter_scan_with_record

    filter_scan_with_record(grid_scan(4000))
    scan = grid_scan(n_points)
    before = peak_mib()
    result, cpu, wall = timed(lambda: filter_scan_with_record(scan))
    assert 0.02 * n_points < len(result.cloud) < 0.9 * n_points
    assert abs(result.automatic["noise_before"] / NOISE - 1.0) < 0.15
    found = {"n_neighbours": result.automatic["n_neighbours_quartiles"][1], "out": len(result.cloud)}
    return {"cpu": cpu, "wall": wall, "before_mib": before, "peak_mib": peak_mib(), **found}


def open3d(n_points: int) -> dict[str, Any]:
    """Statistical outliers, plain normals of 48 neighbours and voxel means, as Open3D has them."""
    from projects.open3d_library import load_open3d

    o3d = load_open3d()
    points = grid_scan(n_points).cloud.points

    def work() -> Any:
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        cloud, _ = cloud.remove_statistical_outlier(20, 2.0)
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(48))
        return cloud.voxel_down_sample(0.0015)

    before = peak_mib()
    thin, cpu, wall = timed(work)
    return {"cpu": cpu, "wall": wall, "before_mib": before, "peak_mib": peak_mib(), "out": len(thin.points)}


def in_child(name: str, n_points: int) -> dict[str, Any]:
    """Run one program in a process of its own."""
    found = subprocess.run(
        [sys.executable, __file__, "--child", name, str(n_points)], stdout=subprocess.PIPE, check=True
    )
    return dict(json.loads(found.stdout.decode().strip().splitlines()[-1]))


def main(words: list[str]) -> None:
    """Print one line a size and program, and the growth from size to size."""
    if words[:1] == ["--child"]:
        print(json.dumps({"ours": ours, "open3d": open3d}[words[1]](int(words[2]))))
        return
    last: dict[str, tuple[int, float]] = {}
    print(
        "points | program | points/s of CPU, 2 cores | by the clock | peak MiB | of it, the work | thinned to | growth"
    )
    for n_points in [int(w) for w in words] or SIZES:
        for name in ("ours", "open3d"):
            r = in_child(name, n_points)
            growth = "-"
            if name in last:
                growth = f"{r['cpu'] / last[name][1]:.2f} times for {n_points / last[name][0]:.2g} times the points"
            last[name] = (n_points, r["cpu"])
            print(
                f"{n_points} | {name} | {CORES * n_points / r['cpu']:.0f} | {n_points / r['wall']:.0f} | "
                f"{r['peak_mib']:.0f} | {r['peak_mib'] - r['before_mib']:.0f} | {r['out']} | {growth}"
                + (f" | n_o {r['n_neighbours']:.0f}" if "n_neighbours" in r else ""),
                flush=True,
            )


if __name__ == "__main__":
    main(sys.argv[1:])
