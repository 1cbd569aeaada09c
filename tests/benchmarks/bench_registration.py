"""Registration: speed against Open3D and small_gicp in one run.

    python tests/benchmarks/bench_registration.py

Two clouds of the same bumpy body, 1 degree and 10 mm apart; errors are of the worst point against the truth. (How often
the true motion lies within its ellipsoid: `python tests/validation/validate.py registration_covariance`.)
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scenes"))

from bumpy_body import move, noisy_cloud

from monitor.registration import register
from projects.model import Floats, PointCloud
from projects.open3d_library import load_open3d
from projects.transforms import apply, invert, perturb

SIZES = (10_000, 100_000, 1_000_000)


def run_open3d(source: PointCloud, target: PointCloud) -> Floats:
    o3d = load_open3d()
    clouds = []
    for cloud in (source, target):
        made = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points))
        made.normals = o3d.utility.Vector3dVector(cloud.normals)
        clouds.append(made)
    reg = o3d.pipelines.registration
    criteria = reg.ICPConvergenceCriteria(1e-9, 1e-9, 50)
    found = reg.registration_icp(*clouds, 0.02, np.eye(4), reg.TransformationEstimationPointToPlane(), criteria)
    return np.asarray(found.transformation)


def run_small_gicp(source: PointCloud, target: PointCloud) -> Floats:
    import small_gicp

    found = small_gicp.align(target.points, source.points, registration_type="PLANE_ICP", num_threads=2,
                             downsampling_resolution=0.002, max_correspondence_distance=0.02)  # fmt: skip
    return np.asarray(found.T_target_source)


def run_ours(source: PointCloud, target: PointCloud) -> Floats:
    return register(source, target).T_target_source


def bench_speed() -> None:
    """One program after the other: threads that one leaves spinning would count as another's time."""
    T = perturb(np.eye(4), np.zeros(3), np.array([0.0174, 0.0, 0.0, 0.006, -0.006, 0.005]))
    runs: dict[str, Callable[[PointCloud, PointCloud], Floats]] = {
        "ours": run_ours, "small_gicp": run_small_gicp, "open3d": run_open3d}  # fmt: skip
    ours: dict[int, float] = {}
    print("program      points      seconds    CPU s  points/s   worst point [um]  CPU / ours")
    for name, run in runs.items():
        for n in (2_000, *SIZES):  # the first only loads what is loaded once
            rng = np.random.default_rng(1)
            truth, target = noisy_cloud(n, rng), noisy_cloud(n, rng)
            source = move(truth, invert(T))
            began, cpu = time.perf_counter(), time.process_time()
            found = run(source, target)
            seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
            ratio = cpu / ours.setdefault(n, cpu)
            worst = float(np.linalg.norm(apply(found, source.points) - truth.points, axis=1).max())
            if n in SIZES:
                print(f"{name:11s} {n:9d}   {seconds:8.2f} {cpu:8.2f} {n / seconds:9.0f} {1e6 * worst:13.1f} "
                      f"{ratio:14.2f}")  # fmt: skip
            assert name != "ours" or n not in SIZES or worst < 2e-4


if __name__ == "__main__":
    bench_speed()
