"""Raw to thinned, points per second on this machine (Nothegger & Dorninger 2007, section 3.1).

A wall in relief, scanned by the current scanner preset from one station at two densities; all
of a scan's filtering: calibration in situ, normals, outliers, silhouettes, thinning.
"""

from __future__ import annotations

import os
import time

import numpy as np
from rows import Row, Size, in_words, judge

from monitor.filtering import filter_scan
from monitor.filtering.calibration import calibrate_range, correct_range
from monitor.simulation import INSTRUMENTS, Scene, Window, simulate_scan, stand_at
from monitor.simulation.scenes import make_slab
from projects.model import Floats, Scan

TITLE = "Speed, raw to thinned"
POINTS = {"small": (20_000, 40_000), "full": (250_000, 500_000)}
PAPER = 4e9 / (3 * 7 * 86400)
ASKED = 40_000.0
LIMIT = 1200.0


def scan_relief(n_points: int) -> Scan:
    """Return a scan of about `n_points` of a wall in relief, 0.8 x 0.6 m, 60 mm deep, from 2.4 m."""

    def height(x: Floats, y: Floats) -> Floats:
        return 0.03 * np.sin(x / 0.05) * np.cos(y / 0.07) + 0.01 * np.sin(x / 0.011 + y / 0.013)

    upright = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
    scene = Scene("relief", (make_slab("relief", 1.0, 0.002, height).moved(upright),))
    pose = stand_at(np.array([0.0, -2.4, 0.0]), facing=np.zeros(3))
    step = float(np.sqrt(0.32 * 0.24 / n_points))
    return simulate_scan(scene, INSTRUMENTS["phase-2020"], pose, Window(-0.16, 0.16, -0.12, 0.12), step=step, seed=3)


def seconds_for(scan: Scan) -> tuple[float, float, int]:
    """Return wall and processor seconds of filtering a scan, and the number of points left."""
    began, cpu = time.perf_counter(), time.process_time()
    thinned = filter_scan(correct_range(scan, calibrate_range(scan)))
    return time.perf_counter() - began, time.process_time() - cpu, len(thinned)


def run(size: Size) -> list[Row]:
    """Filter a scan of each size, after a small one that compiles."""
    seconds_for(scan_relief(5_000))
    rows, taken = [], []
    for n in POINTS[size]:
        scan = scan_relief(n)
        wall, cpu, n_left = seconds_for(scan)
        taken.append(cpu / len(scan.cloud))
        rate, cpu_rate = len(scan.cloud) / wall, len(scan.cloud) / cpu
        what = f"{len(scan.cloud):_} points raw, {n_left:_} thinned: points/s"
        ours = f"{round(rate, -2):_.0f} ({round(cpu_rate, -2):_.0f} per core-second, load {os.getloadavg()[0]:.0f})"
        texts = [text.replace("_", " ") for text in (what, ours, f"{PAPER:_.0f} on 4 Xeons")]
        rows.append(Row(texts[0], texts[1], judge(rate >= ASKED), texts[2], "40 000 on 2 cores", value=rate))
    growth = taken[1] / taken[0] * 2.0
    rows.append(Row("double the points: times the processor time", in_words(growth, 2), judge(growth <= 2.1), "", "2.1",
                    value=growth))  # fmt: skip
    return rows


NOTES = (
    "On a loaded machine the rate of the wall clock is too low; twice that per core-second is what two cores would "
    "give at best. Where the noise is small against the spacing, as here, hardly a point is merged."
)
