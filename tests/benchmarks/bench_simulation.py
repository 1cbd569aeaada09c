"""The simulated scanner: pulses a second with nine sub-rays each, against Open3D casting the same rays, and memory.

    python tests/benchmarks/bench_simulation.py

The demo's figure before its wall, in 1.2 million triangles, from 2.6 m. Open3D alone is the floor: nine rays a pulse,
made beforehand, nothing done with what they meet. CPU seconds of both threads together count, since machines are
shared; two threads on two free cores take half of it. Streaming: the peak memory of scans of growing size, each scanned
once more into an E57 file.
"""

import resource
import tempfile
import time
from pathlib import Path

import numpy as np

from monitor.bearings import directions_of
from monitor.simulation import INSTRUMENTS, Window, carved_figure, stand_at, stream_scan
from monitor.simulation.beam import make_rays, sample_beam
from monitor.simulation.demo_campaign import demo_scene
from monitor.simulation.scanner import BLOCK_PULSES, Target, cast, lay_grid
from monitor.simulation.scenes import Scene
from projects.formats import write_e57
from projects.transforms import rotate

SIZES = (250_000, 1_000_000, 4_000_000)
WINDOW = Window(-0.16, 0.16, -0.52, 0.10)
POSE = stand_at([0.0, -2.6, 1.45], facing=[0.0, 0.0, 0.0])
N_THREADS = 2


def cast_bare(target: Target, step: float) -> tuple[float, int]:
    """Cast nine rays for each pulse in the scanner's own blocks; return CPU seconds and the number of pulses."""
    angles, _, _ = lay_grid(WINDOW, step)
    offsets, _ = sample_beam(9)
    seconds, n_cast = 0.0, 0
    for first in range(0, len(angles), BLOCK_PULSES):
        directions = rotate(POSE, directions_of(*angles[first : first + BLOCK_PULSES].T))
        rays = make_rays(
            POSE[:3, 3], directions, offsets, exit_sigma=7.5e-4, divergence_sigma=2e-4, twist=np.zeros(len(directions))
        )
        start = time.process_time()
        cast(target, rays, N_THREADS)
        seconds += time.process_time() - start
        n_cast += len(directions)
    return seconds, n_cast


def scan_all(scene: Scene, step: float) -> tuple[float, float, int, int]:
    """Return CPU seconds, wall seconds, pulses and returns of one streamed scan, the tree included."""
    start, wall, n_pulses, n_seen = time.process_time(), time.perf_counter(), 0, 0
    for block in stream_scan(scene, INSTRUMENTS["phase-2020"], POSE, WINDOW, step=step, seed=1, n_threads=N_THREADS):
        n_seen += len(block.cloud)
        n_pulses += len(block.cloud) + block.dropped["no return"]
    return time.process_time() - start, time.perf_counter() - wall, n_pulses, n_seen


def write_all(scene: Scene, step: float) -> int:
    """Scan straight into an E57 file; return its size [octets]."""
    blocks = stream_scan(scene, INSTRUMENTS["phase-2020"], POSE, WINDOW, step=step, seed=1, n_threads=N_THREADS)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan.e57"
        write_e57(path, [blocks])
        return path.stat().st_size


def main() -> None:
    scene = demo_scene(carved_figure(1, cell=0.0025))
    target = Target.of(scene, N_THREADS)
    scan_all(scene, 0.004)  # numba compiles
    print("pulses      pulses/s of 2 cores (CPU)   as it ran   bare ray casting   ours / bare   E57 file   peak memory")
    for n_asked in SIZES:
        step = float(np.sqrt(0.32 * 0.62 / n_asked))
        cpu, wall, n_pulses, n_seen = scan_all(scene, step)
        assert n_seen > 0.9 * n_pulses
        bare, n_cast = cast_bare(target, step)
        assert n_cast == n_pulses
        size = write_all(scene, step)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"{n_pulses:9,d}   {N_THREADS * n_pulses / cpu:20,.0f}   {n_pulses / wall:12,.0f}"
              f"   {N_THREADS * n_pulses / bare:14,.0f}   {cpu / bare:11.2f}"
              f"   {size / 1e6:5.0f} MB   {peak:8.0f} MiB")  # fmt: skip


if __name__ == "__main__":
    main()
