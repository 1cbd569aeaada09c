"""The adjustment of many scans: time, peak memory and error with the number of scans of one million points each.

    python tests/benchmarks/bench_adjustment.py [--step METRES] [N_SCANS ...]        (10 scans where left out)

A wall of 3 m x 3 m a scan with relief, each scan 1.5 m beside the one before, so that it overlaps the next by half (at
a step of 0.05 m all of forty overlap all), with pose errors of 2 mm and 0.3 mrad. 40 scans are asked to take less than
3 minutes and 4 GiB. Scans are made one after the other as the adjustment asks for them, so that memory is the
adjustment's own; the time of making them is taken off. There is no peer: neither Open3D nor small_gicp adjusts many
scans at once with targets and states a covariance.
"""

import argparse
import resource
import time
from collections.abc import Iterator

import numpy as np

from monitor.registration.network.adjustment import adjust_scans
from projects.model import Floats, PointCloud
from projects.transforms import apply, perturb, rotate

N_POINTS = 1_000_000
WIDTH = 3.0  # m, of a scan
NOISE = 0.0005  # m
SIGMA_ANGLE, SIGMA_WAY = 0.0003, 0.002  # rad and m


def relief(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return height (n,) [m] and unit normals (n, 3) of the wall."""
    waves = ((0.05, 3.1, 1.7, 0.3), (0.03, -4.3, 5.9, 1.1), (0.02, 9.7, -7.3, 2.0))
    z, dx, dy = np.zeros(len(x)), np.zeros(len(x)), np.zeros(len(x))
    for height, u, v, phase in waves:
        z += height * np.sin(u * x + v * y + phase)
        slope = height * np.cos(u * x + v * y + phase)
        dx += u * slope
        dy += v * slope
    normals = np.column_stack([-dx, -dy, np.ones(len(x))])
    return z, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def pose_error(k: int, step: float) -> Floats:
    """Return the error of the pose of scan k about its middle."""
    rng = np.random.default_rng([7, k])
    delta = rng.normal(0, [SIGMA_ANGLE] * 3 + [SIGMA_WAY] * 3)
    return perturb(np.eye(4), np.array([step * k + 1.5, 1.5, 0.0]), delta)


def make_scan(k: int, step: float, n: int = N_POINTS) -> PointCloud:
    """Return scan k in its wrong place."""
    rng = np.random.default_rng([8, k])
    x, y = rng.uniform(step * k, step * k + WIDTH, n), rng.uniform(0.0, WIDTH, n)
    z, normals = relief(x, y)
    E = pose_error(k, step)
    return PointCloud(apply(E, np.column_stack([x, y, z + rng.normal(0, NOISE, n)])), normals=rotate(E, normals))


def make_scans(n: int, step: float, spent: list[tuple[float, float]]) -> Iterator[PointCloud]:
    """Yield scans; what making each one took, in seconds and CPU seconds, goes to `spent`."""
    for k in range(n):
        began, cpu = time.perf_counter(), time.process_time()
        scan = make_scan(k, step)
        spent.append((time.perf_counter() - began, time.process_time() - cpu))
        yield scan


def neighbour_error(motions: tuple[Floats, ...], step: float) -> float:
    """Return the root mean square [m] by which neighbouring scans still miss each other, where they overlap."""
    apart = []
    for k in range(len(motions) - 1):
        corners = np.array([[a, b, 0.0] for a in (step * (k + 1), step * k + WIDTH) for b in (0.0, WIDTH)])
        first, second = (apply(motions[i] @ pose_error(i, step), corners) for i in (k, k + 1))
        apart.append(np.mean(np.sum((first - second) ** 2, axis=1)))
    return float(np.sqrt(np.mean(apart)))


def bench(n: int, step: float) -> None:
    spent: list[tuple[float, float]] = []
    began, cpu = time.perf_counter(), time.process_time()
    found = adjust_scans(make_scans(n, step, spent))
    seconds, cpu_seconds = np.array([time.perf_counter() - began, time.process_time() - cpu]) - np.sum(spent, axis=0)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    before, after = (neighbour_error(m, step) for m in (tuple(np.eye(4) for _ in range(n)), found.motions))
    print(f"{n:5d} {len(found.pairs):6d} {seconds:9.1f} {cpu_seconds:9.1f} {n * N_POINTS / cpu_seconds:12.0f} "
          f"{peak:9.2f} {found.n_iterations:6d} {1e3 * before:12.3f} {1e3 * after:12.3f}", flush=True)  # fmt: skip
    assert found.converged
    assert after < 0.0003


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("n_scans", nargs="*", type=int, default=[10])
    parser.add_argument("--step", type=float, default=1.5, help="m, from each scan to the next")
    given = parser.parse_args()
    print("scans  pairs   seconds     CPU s  points/CPU s  peak GiB  steps  before [mm]   after [mm]")
    for size in given.n_scans:
        bench(size, given.step)
