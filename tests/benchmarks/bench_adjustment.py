"""The adjustment of many scans: time, peak memory and error with the number of scans of one million points each.

    python tests/benchmarks/bench_adjustment.py [N_SCANS ...]        (5, 10 and 40 where left out)

A wall of 3 m x 3 m a scan with relief, each scan overlapping the next by half, with pose errors of 2 mm and 0.3 mrad.
Scans are made one after the other as the adjustment asks for them, so that memory is the adjustment's own. There is no
peer: neither Open3D nor small_gicp adjusts many scans at once with targets and states a covariance.
"""

import resource
import sys
import time
from collections.abc import Iterator

import numpy as np

from monitor.registration.adjustment import adjust_scans
from projects.model import Floats, PointCloud
from projects.transforms import apply, perturb, rotate

N_POINTS = 1_000_000
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


def pose_error(k: int) -> Floats:
    """Return the error of the pose of scan k about its middle."""
    rng = np.random.default_rng([7, k])
    delta = rng.normal(0, [SIGMA_ANGLE] * 3 + [SIGMA_WAY] * 3)
    return perturb(np.eye(4), middle(k), delta)


def middle(k: int) -> Floats:
    return np.array([1.5 * k + 1.5, 1.5, 0.0])


def make_scan(k: int, n: int = N_POINTS) -> PointCloud:
    """Return scan k in its wrong place."""
    rng = np.random.default_rng([8, k])
    x, y = rng.uniform(1.5 * k, 1.5 * k + 3.0, n), rng.uniform(0.0, 3.0, n)
    z, normals = relief(x, y)
    E = pose_error(k)
    return PointCloud(apply(E, np.column_stack([x, y, z + rng.normal(0, NOISE, n)])), normals=rotate(E, normals))


def scans(n: int) -> Iterator[PointCloud]:
    for k in range(n):
        yield make_scan(k)


def neighbour_error(motions: tuple[Floats, ...]) -> float:
    """Return the root mean square [m] by which neighbouring scans still miss each other, where they overlap."""
    apart = []
    for k in range(len(motions) - 1):
        corners = np.array([[1.5 * k + 1.5 + a, b, 0.0] for a in (0.0, 1.5) for b in (0.0, 3.0)])
        first, second = (apply(motions[i] @ pose_error(i), corners) for i in (k, k + 1))
        apart.append(np.mean(np.sum((first - second) ** 2, axis=1)))
    return float(np.sqrt(np.mean(apart)))


def bench(n: int) -> None:
    began, cpu = time.perf_counter(), time.process_time()
    for _ in scans(n):
        pass
    making, making_cpu = time.perf_counter() - began, time.process_time() - cpu
    began, cpu = time.perf_counter(), time.process_time()
    found = adjust_scans(scans(n))
    seconds, cpu_seconds = time.perf_counter() - began - making, time.process_time() - cpu - making_cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    before = neighbour_error(tuple(np.eye(4) for _ in range(n)))
    after = neighbour_error(found.motions)
    print(f"{n:5d} {seconds:9.1f} {cpu_seconds:9.1f} {n * N_POINTS / cpu_seconds:12.0f} {peak:9.2f} "
          f"{found.n_iterations:6d} {1e3 * before:12.3f} {1e3 * after:12.3f}", flush=True)  # fmt: skip
    assert found.converged
    assert after < 0.0003


if __name__ == "__main__":
    print("scans   seconds     CPU s   points/CPU s  peak GiB  steps  before [mm]   after [mm]")
    for size in [int(word) for word in sys.argv[1:]] or [5, 10, 40]:
        bench(size)
