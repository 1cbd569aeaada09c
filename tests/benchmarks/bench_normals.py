"""Robust normals per second, neighbours included, beside Open3D's plain ones and scikit-learn's MinCovDet, in one run.

`python tests/benchmarks/bench_normals.py [n_points ...]`. Surface: a wavy relief of 1 mm spacing with 0.3 mm noise and
`BAD` outliers; neighbourhoods of 48, and of what the chain chooses by itself. CPU seconds of all threads over the
number of threads, which a loaded machine does not change; and the wall clock.
"""

import resource
import sys
import time

import numba
import numpy as np
from sklearn.covariance import MinCovDet

from monitor.filtering import NormalSettings
from monitor.filtering.nearest import build_index, canonical_order, find_nearest
from monitor.filtering.normals import fit_planes
from projects.open3d_library import load_open3d

SIZES = (100_000, 300_000, 1_000_000)
BAD = 0.02
K = 48


def relief(n_points: int) -> np.ndarray:
    """Return points (n, 3) [m] in canonical order."""
    rng = np.random.default_rng(1)
    x, y = 1e-3 * np.sqrt(n_points) * rng.random((2, n_points))
    z = 0.004 * np.sin(x / 0.02) * np.cos(y / 0.03) + rng.normal(0, 0.3e-3, n_points)
    z += (rng.random(n_points) < BAD) * rng.uniform(1e-3, 10e-3, n_points)
    points = np.column_stack([x, y, z])
    return points[canonical_order(points)]


def seconds_of(work, *given):
    """Return CPU seconds over threads, wall seconds, and the result."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work(*given)
    return (time.process_time() - cpu) / numba.get_num_threads(), time.perf_counter() - wall, result


def plain(points):
    """Return Open3D's normals from the covariance of K neighbours."""
    o3d = load_open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(K))
    return np.asarray(cloud.normals)


def min_cov_det(points, n_sample=100):
    """Fit scikit-learn's MinCovDet to the neighbours of a sample."""
    index, which = build_index(points), slice(0, 8 * n_sample, 8)
    near = find_nearest(index, 0, 8 * n_sample, np.full(8 * n_sample, K))[which]
    for row in near:
        MinCovDet(random_state=0).fit(points[row])


def main() -> None:
    """Print one table."""
    up = np.array([0.0, 0.0, 1.0])
    fit_planes(build_index(relief(20_000)), np.tile(up, (20_000, 1)), NormalSettings(n_neighbours=K))
    print(f"{numba.get_num_threads()} threads; points per second by CPU time (by the clock)")
    for n_points in [int(a) for a in sys.argv[1:]] or SIZES:
        points = relief(n_points)
        towards = np.tile(up, (n_points, 1))
        rates = {}
        for name, settings in (("k = 48", NormalSettings(n_neighbours=K)), ("n of the chain", NormalSettings())):
            cpu, wall, planes = seconds_of(fit_planes, build_index(points), towards, settings)
            rates[f"{name} (median {int(np.median(planes.n_neighbours))})"] = n_points / cpu, n_points / wall
        cpu, wall, normals = seconds_of(plain, points)
        rates["Open3D plain, k = 48"] = n_points / cpu, n_points / wall
        cpu, wall, _ = seconds_of(min_cov_det, points)
        rates["scikit-learn MinCovDet, k = 48"] = 100 / cpu, 100 / wall
        agreement = np.abs((normals * planes.normals).sum(axis=1))
        assert np.median(agreement) > 0.98
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        told = "; ".join(f"{name}: {cpu:,.0f} ({wall:,.0f})" for name, (cpu, wall) in rates.items())
        print(f"{n_points:>9,} points: {told}; peak {memory:,.0f} MiB", flush=True)


if __name__ == "__main__":
    main()
