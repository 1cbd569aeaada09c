"""Comparison of two surfaces, both ways with detection, against CloudCompare's cloud-to-mesh distance alone.

    python tests/benchmarks/bench_comparison.py speed [VERTICES ...]     ours and CloudCompare in one run
    python tests/benchmarks/bench_comparison.py memory [VERTICES ...]    peak memory, octets a vertex
    python tests/benchmarks/bench_comparison.py bodies VERTICES --folder F [--radius R]   the two surfaces into files
    python tests/benchmarks/bench_comparison.py ours VERTICES --folder F     ours alone, from there

CloudCompare is run where it is installed (Debian: apt-get install cloudcompare; 2.11 for the figures in BENCHMARKS.md),
otherwise Open3D's closest points are the peer. Each measurement is a process of its own. `bodies` and `ours` are for a
process whose memory is limited from outside: making the surfaces takes more than they do. Edges of twenty times as many
vertices are as long as before, and the surface as rough, where the radius [m] is sqrt(20) as large.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from monitor.comparison import compare
from projects.formats import write_ply_mesh
from projects.model import Floats, Ints, Registration, Surface

SIZES = (100_000, 300_000, 1_000_000)
NOISE = 2e-4  # m
DENT = (0.01, 0.05)  # m: depth and radius


def make_body(n_vertices: int, seed: int, mean_radius: float = 0.5) -> Surface:
    """Return a closed bumpy body of a mean radius [m] with some `n_vertices` even vertices, noise, a dent where seed is
    not 0."""
    rng = np.random.default_rng(seed)
    d, faces = cube_sphere(max(int(np.sqrt(n_vertices / 6.0)), 2))
    d = d @ Rotation.from_rotvec([0.3 * seed, 0.5 * seed, 0.1 * seed]).as_matrix().T  # other places in the other epoch
    bumps = 0.02 * np.sin(9 * d[:, 0]) * np.cos(7 * d[:, 1]) + 0.01 * np.sin(23 * d[:, 2])
    radius = mean_radius * (1.0 + 2.0 * bumps)
    away = mean_radius * np.linalg.norm(d - [1.0, 0.0, 0.0], axis=1)
    dent = np.where(away < DENT[1], 0.5 * DENT[0] * (1 + np.cos(np.pi * away / DENT[1])), 0.0) if seed else 0.0
    v = d * (radius - dent + rng.normal(0, NOISE, len(d)))[:, None]
    return Surface(v, faces, sigma=np.full(len(v), NOISE))


def cube_sphere(k: int) -> tuple[Floats, Ints]:
    """Return directions (6 k^2 + 2, 3) and faces of a cube of k x k fields a side, blown up to a sphere."""
    ticks = np.tan(np.linspace(-0.25 * np.pi, 0.25 * np.pi, k + 1))
    u, v = (a.ravel() for a in np.meshgrid(np.arange(k + 1), np.arange(k + 1), indexing="ij"))
    places, fields = [], []
    i, j = (a.ravel() for a in np.meshgrid(np.arange(k), np.arange(k), indexing="ij"))
    a, b, c, d = i * (k + 1) + j, (i + 1) * (k + 1) + j, (i + 1) * (k + 1) + j + 1, i * (k + 1) + j + 1
    quads = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    for axis in range(3):
        for end in (0, k):
            place = np.empty((len(u), 3), dtype=np.int64)
            place[:, axis], place[:, (axis + 1) % 3], place[:, (axis + 2) % 3] = end, u, v
            fields.append((quads if end else quads[:, ::-1]) + len(places) * len(u))
            places.append(place)
    places, number = np.unique(np.vstack(places), axis=0, return_inverse=True)
    out = ticks[places]
    return out / np.linalg.norm(out, axis=1)[:, None], number.reshape(-1)[np.vstack(fields)].astype(np.int32)


def known(surface: Surface) -> Registration:
    """Return an identity that is known well."""
    n = len(surface.vertices)
    return Registration(np.eye(4), np.diag([1e-6] * 3 + [1e-6] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                        is_stable=np.ones(n, dtype=bool))  # fmt: skip


def write_bodies(n_vertices: int, folder: Path, mean_radius: float) -> None:
    """Write both surfaces into `folder`: making them takes more memory than they do."""
    for seed in (0, 1):
        body = make_body(n_vertices, seed, mean_radius)
        np.save(folder / f"vertices-{seed}.npy", body.vertices)
        np.save(folder / f"faces-{seed}.npy", body.faces)


def load_body(folder: Path, seed: int) -> Surface:
    """Return a surface of `write_bodies`."""
    vertices, faces = (np.load(folder / f"{name}-{seed}.npy") for name in ("vertices", "faces"))
    return Surface(vertices, faces, sigma=np.full(len(vertices), NOISE))


def run_ours(n_vertices: int, folder: Path | None = None) -> None:
    """Compare once to compile, then once for the figures; write them to standard output. Surfaces from `folder` where
    one is given."""
    small = make_body(5000, 0), make_body(5000, 1)
    compare(*small, known(small[1]))
    reference, compared = (load_body(folder, k) if folder else make_body(n_vertices, k) for k in (0, 1))
    before = held_kib()
    wall, cpu = time.perf_counter(), time.process_time()
    with watch_memory() as peak:
        result = compare(reference, compared, known(compared))
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    truth = -DENT[0] * np.pi * DENT[1] ** 2 * (0.5 - 2.0 / np.pi**2)
    assert len(result.regions) >= 1
    assert abs(result.regions.volume_m3[0] / truth - 1.0) < 0.1  # of a bumpy body: relaxed
    sys.stdout.write(f"FIGURES {len(compared.vertices)} {len(reference.faces)} {wall} {cpu} {before} {peak[0]}\n")


def held_kib() -> int:
    """Return the memory that this process holds now [KiB], without what is mapped from files: the system drops those
    pages where memory is short."""
    _, resident, shared, *_ = Path("/proc/self/statm").read_text().split()
    return (int(resident) - int(shared)) * resource.getpagesize() // 1024


@contextlib.contextmanager
def watch_memory() -> Iterator[list[int]]:
    """Give a list whose one entry is the most memory held so far [KiB], looked at every 5 ms."""
    peak, ended = [held_kib()], threading.Event()

    def watch() -> None:
        while not ended.wait(0.005):
            peak[0] = max(peak[0], held_kib())

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield peak
    finally:
        ended.set()
        watcher.join()


def run_open3d(n_vertices: int) -> None:
    """Find the closest points of all vertices, one way."""
    from projects.open3d_library import load_open3d

    o3d = load_open3d()
    reference, compared = make_body(n_vertices, 0), make_body(n_vertices, 1)
    wall, cpu = time.perf_counter(), time.process_time()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(reference.vertices.astype(np.float32), reference.faces.astype(np.uint32))
    scene.compute_closest_points(compared.vertices.astype(np.float32))
    sys.stdout.write(f"FIGURES 0 0 {time.perf_counter() - wall} {time.process_time() - cpu} 0 0\n")


def measure(what: str, n_vertices: int) -> list[float]:
    """Return the figures of one measurement in a process of its own, which hands memory back as soon as it is free."""
    at_once = {"MALLOC_TRIM_THRESHOLD_": "65536", "MALLOC_MMAP_THRESHOLD_": "65536"}
    done = subprocess.run([sys.executable, __file__, what, str(n_vertices)], capture_output=True, text=True, check=True,
                          env={**os.environ, **at_once} if what == "ours-memory" else None)  # fmt: skip
    return [float(f) for f in re.search(r"FIGURES (.*)", done.stdout).group(1).split()]  # type: ignore[union-attr]


def measure_cloudcompare(program: str, n_vertices: int) -> tuple[float, float]:
    """Return what CloudCompare says its distances took, one way [s], and the CPU time of the whole run without the same
    run that only loads and saves."""
    reference, compared = make_body(n_vertices, 0), make_body(n_vertices, 1)
    with tempfile.TemporaryDirectory() as folder:
        mesh, points = Path(folder) / "mesh.ply", Path(folder) / "points.ply"
        write_ply_mesh(mesh, reference, {})
        write_ply_mesh(points, Surface(compared.vertices, compared.faces[:0]), {})
        common = [program, "-SILENT", "-AUTO_SAVE", "OFF", "-O", str(points), "-O", str(mesh)]
        environment = {**os.environ, "QT_QPA_PLATFORM": "offscreen", "HOME": folder}
        cpu = []
        for extra in ([], ["-C2M_DIST"]):
            start = resource.getrusage(resource.RUSAGE_CHILDREN)
            out = subprocess.run([*common, *extra], capture_output=True, text=True, check=True, env=environment)
            end = resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu.append(end.ru_utime + end.ru_stime - start.ru_utime - start.ru_stime)
        said = re.search(r"\[ComputeDistances\] Time: ([\d.]+) s", out.stdout + out.stderr)
        return float(said.group(1)) if said else float("nan"), cpu[1] - cpu[0]


def compare_speed(sizes: list[int]) -> None:
    """Print seconds of both, one way and both ways, and their ratio."""
    program = shutil.which("CloudCompare")
    for n in sizes:
        _, faces, wall, cpu, _, _ = measure("ours", n)
        name = "CloudCompare C2M" if program else "Open3D closest points"
        peer, peer_cpu = measure_cloudcompare(program, n) if program else measure("open3d", n)[2:4]
        sys.stdout.write(
            f"{n} vertices, {faces:.0f} triangles: ours both ways with detection {wall:.2f} s (CPU {cpu:.2f}); {name} "
            f"one way {peer:.2f} s (CPU {peer_cpu:.2f}); ratio of CPU {peer_cpu / cpu:.2f}\n"
        )


def compare_memory(sizes: list[int]) -> None:
    """Print the peak memory of a comparison and what it comes to for 20 million vertices on either side."""
    for n in sizes:
        vertices, _, _, cpu, before, peak = measure("ours-memory", n)
        octets = 1024.0 * (peak - before) / (2.0 * vertices)
        sys.stdout.write(f"{n} against {n} vertices: peak {peak / 2**20:.2f} GiB, {octets:.0f} octets a vertex on top "
                         f"of the surfaces; 20 M each: {octets * 4e7 / 2**30:.1f} GiB; {cpu:.0f} s CPU\n")  # fmt: skip


def main() -> None:
    """Run what the command line asks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "what", choices=("speed", "memory", "bodies", "ours", "ours-memory", "open3d"), nargs="?", default="speed"
    )
    parser.add_argument("sizes", type=int, nargs="*")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--radius", type=float, default=0.5)
    asked = parser.parse_args()
    sizes = asked.sizes or list(SIZES)
    {"speed": compare_speed, "memory": compare_memory, "ours": lambda s: run_ours(s[0], asked.folder),
     "bodies": lambda s: write_bodies(s[0], asked.folder or Path(), asked.radius), "open3d": lambda s: run_open3d(s[0]),
     "ours-memory": lambda s: run_ours(s[0])}[asked.what](sizes)  # fmt: skip


if __name__ == "__main__":
    main()
