"""Memory and time of the localized surface over tiles: 10 and 100 tiles of a wavy sheet, each in a process of its own.

Besides the points (as given, and once more sorted by tile) and the mesh that comes out, memory is to be that of the
tiles in work. `python tests/benchmarks/bench_tiles.py [tile edge in cells]`; the last lines compare with the limits.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time

import numpy as np

SPACING, CELL, NOISE = 0.001, 0.0015, 0.0003
SORTED_BYTES = 24 + 12 + 8  # a point: coordinates in cells, normal in float32, place in the input
NUMBERS = (1, 10, 100)
MARGIN = 6 * CELL  # of a row of tiles beyond its points, which the band reaches into


def wavy_sheet(n_tiles: int, tile: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points and normals of a sheet in a row of tiles, waves of 40 cells and an amplitude of 4."""
    rng, edge = np.random.default_rng(n_tiles), tile * CELL
    width = edge - 2.0 * MARGIN
    n = int(edge * width / SPACING**2)
    points, normals = np.empty((n_tiles * n, 3)), np.empty((n_tiles * n, 3))
    turn, height = 2 * np.pi / (40 * CELL), 4 * CELL
    for j in range(n_tiles):  # tile by tile, so that the peak of memory is not made here
        x, y = edge * (j + rng.uniform(size=n)) * (1.0 - 2.0 * MARGIN / n_tiles / edge), rng.uniform(size=n) * width
        z = 0.5 * edge + height * np.sin(turn * x) * np.cos(turn * y) + NOISE * rng.normal(size=n)
        slope_x = height * turn * np.cos(turn * x) * np.cos(turn * y)
        slope_y = -height * turn * np.sin(turn * x) * np.sin(turn * y)
        points[j * n : (j + 1) * n] = np.c_[x, y, z]
        normals[j * n : (j + 1) * n] = np.c_[-slope_x, -slope_y, np.ones(n)]
        normals[j * n : (j + 1) * n] /= np.sqrt(1.0 + slope_x**2 + slope_y**2)[:, None]
    return points, normals


def measure(n_tiles: int, tile: int) -> None:
    """Make the surface of so many tiles, one at a time, and print what it took (runs in a process of its own)."""
    from monitor.reconstruction.localized import localized_mesh

    def one_by_one(function, numbers):
        return [function(j) for j in numbers]

    localized_mesh(*wavy_sheet(1, 20), CELL, SPACING, tile=20, map_tiles=one_by_one)  # compiles
    points, normals = wavy_sheet(n_tiles, tile)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    began = time.process_time()
    vertices, faces = localized_mesh(points, normals, CELL, SPACING, tile=tile, map_tiles=one_by_one)
    seconds = time.process_time() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    known = points.nbytes + normals.nbytes + SORTED_BYTES * len(points) + vertices.nbytes + faces.nbytes
    print(json.dumps({"tiles": n_tiles, "points": len(points), "faces": len(faces), "seconds": seconds, "peak": peak,
                      "known": known, "before": before}))  # fmt: skip


def main() -> None:
    tile = int(sys.argv[1]) if len(sys.argv) > 1 else 128
    print(f"tiles of {tile} cells | points | faces | CPU s | points/s | peak MB | points and mesh MB | beyond them MB")
    beyond = {}
    for n_tiles in NUMBERS:
        command = [sys.executable, __file__, "--measure", str(n_tiles), str(tile)]
        found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        beyond[n_tiles] = (found["peak"] - found["known"]) / 1e6
        print(f"{n_tiles} | {found['points']} | {found['faces']} | {found['seconds']:.1f} | "
              f"{found['points'] / found['seconds']:.0f} | {found['peak'] / 1e6:.0f} | {found['known'] / 1e6:.0f} | "
              f"{beyond[n_tiles]:.0f}")  # fmt: skip
    ratio = beyond[100] / beyond[10]
    print(f"100 tiles against 10: {ratio:.3f} (limit 1.10); beyond points and mesh at most 1024 MB")
    assert ratio < 1.10
    assert max(beyond.values()) < 1024


if __name__ == "__main__":
    if sys.argv[1:2] == ["--measure"]:
        measure(int(sys.argv[2]), int(sys.argv[3]))
    else:
        main()
