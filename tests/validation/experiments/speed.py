"""Raw to thinned, points per second and memory on this machine (Nothegger & Dorninger 2007, section 3.1).

A wall in relief, scanned by the current scanner preset from one station at two densities; all of a scan's filtering:
calibration in situ, normals, outliers, silhouettes, thinning. Each size in a process of its own with two threads, which
reads the scan from a file: its peak memory is that of the work. Other programs share the machine's cores; the time that
the calling thread alone spends on a processor is what the clock shows where both cores are free.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from rows import Row, Size, in_words, judge

from monitor.filtering import filter_scan_with_record
from monitor.filtering.calibration import calibrate_range
from monitor.simulation import INSTRUMENTS, Scene, Window, simulate_scan, stand_at
from monitor.simulation.scenes import make_slab
from projects.model import Floats, PointCloud, Scan

TITLE = "Speed, raw to thinned"
POINTS = {"small": (50_000, 100_000), "full": (5_000_000, 10_000_000)}
PAPER = 4e9 / (3 * 7 * 86400)
ASKED, MOST_GIB = 40_000.0, 2.0
LIMIT = 3600.0


def scan_relief(n_points: int) -> Scan:
    """Return a scan of about `n_points` of a wall in relief, 0.8 x 0.6 m, 60 mm deep, from 2.4 m."""

    def height(x: Floats, y: Floats) -> Floats:
        return 0.03 * np.sin(x / 0.05) * np.cos(y / 0.07) + 0.01 * np.sin(x / 0.011 + y / 0.013)

    upright = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
    scene = Scene("relief", (make_slab("relief", 1.0, 0.002, height).moved(upright),))
    pose = stand_at(np.array([0.0, -2.4, 0.0]), facing=np.zeros(3))
    step = float(np.sqrt(0.32 * 0.24 / n_points))
    return simulate_scan(scene, INSTRUMENTS["phase-2020"], pose, Window(-0.16, 0.16, -0.12, 0.12), step=step, seed=3)


def memory_gib(which: str) -> float:
    """Return the memory of this process [GiB]: VmRSS now, VmHWM the most it had."""
    line = next(x for x in Path("/proc/self/status").read_text().splitlines() if x.startswith(which))
    return int(line.split()[1]) / 2**20


def filter_all(scan: Scan) -> int:
    """Do all of a scan's filtering and return the number of points left."""
    return len(filter_scan_with_record(scan, calibration=calibrate_range(scan)).cloud)


def measure(path: Path) -> dict[str, float]:
    """Filter the scan of a file, after a small one that compiles; return seconds, memory [GiB] and points."""
    filter_all(scan_relief(5_000))
    with np.load(path) as kept:
        scan = Scan("relief", PointCloud(kept["points"]), np.eye(4), rows=kept["rows"], columns=kept["columns"])
    Path("/proc/self/clear_refs").write_text("5")  # the peak is that of the work from here on
    before, load = memory_gib("VmRSS"), os.getloadavg()[0]
    began, cpu, own = time.perf_counter(), time.process_time(), time.thread_time()
    n_left = filter_all(scan)
    return {
        "raw": len(scan.cloud), "thinned": n_left, "wall": time.perf_counter() - began, "load": load,
        "cpu": time.process_time() - cpu, "own": time.thread_time() - own, "before": before,
        "peak": memory_gib("VmHWM"),
    }  # fmt: skip


def in_child(n_points: int) -> dict[str, Any]:
    """Scan, and measure in a process of its own."""
    scan = scan_relief(n_points)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan.npz"
        np.savez(path, points=scan.cloud.points, rows=scan.rows, columns=scan.columns)
        del scan
        environment = {**os.environ, "NUMBA_NUM_THREADS": "2", "OMP_WAIT_POLICY": "passive",
                       "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}  # fmt: skip
        command = [sys.executable, __file__, str(path)]
        found = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True, text=True)
    return dict(json.loads(found.stdout.splitlines()[-1]))


def run(size: Size) -> list[Row]:
    """Filter a scan of each size."""
    found = [in_child(n) for n in POINTS[size]]
    rows = [row for r in found for row in rows_of(r)]
    growth = found[1]["cpu"] / found[0]["cpu"] * 2.0 * found[0]["raw"] / found[1]["raw"]
    rows.append(Row("double the points: times the processor time", in_words(growth, 2), judge(growth <= 2.1), "", "2.1",
                    value=growth))  # fmt: skip
    return rows


def rows_of(r: dict[str, Any]) -> list[Row]:
    """Return the rate and the memory of one size."""
    rate, clock, core = r["raw"] / r["own"], r["raw"] / r["wall"], r["raw"] / r["cpu"]
    what, ours, shared, paper = (text.replace("_", " ") for text in (
        f"{r['raw']:_} points raw, {r['thinned']:_} thinned: points/s", f"{round(rate, -2):_.0f}",
        f"{round(clock, -2):_.0f} by the clock at load {r['load']:.0f}, {round(core, -2):_.0f} per core-second",
        f"{PAPER:_.0f} on 4 Xeons",
    ))  # fmt: skip
    return [
        Row(what, ours, judge(rate >= ASKED), paper, "40 000 on 2 cores", {"as shared": shared}, rate),
        Row("peak memory of it, GiB", in_words(r["peak"], 2), judge(r["peak"] <= MOST_GIB), "", "2",
            {"before the work": in_words(r["before"], 2)}, r["peak"]),
    ]  # fmt: skip


NOTES = (
    "Points/s of the processor time of the calling thread of two: what the clock shows where both cores are free. "
    "Before the work the process already holds the scan itself, and numba."
)

if __name__ == "__main__":
    print(json.dumps(measure(Path(sys.argv[1]))))
