"""Registration: speed against Open3D and small_gicp in one run, and the calibration of the covariance.

    python tests/benchmarks/bench_registration.py [speed] [calibration]

Two clouds of the same bumpy body, 1 degree and 10 mm apart; errors are of the worst point against the truth. The
calibration registers 200 pairs each with independent and with spatially correlated noise and counts how often the
true motion lies within the 95 % ellipsoid.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.stats import chi2

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "monitor"))

from bumpy_body import move, noisy_cloud
from test_motion_covariance import squared_error

from monitor.registration import register
from projects.model import Floats, PointCloud
from projects.open3d_library import load_open3d
from projects.transforms import apply, invert, perturb

SIZES = (10_000, 100_000, 1_000_000)
N_SIMULATED = 200


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


def bench_calibration() -> None:
    for reach in (None, 0.01, 0.03, 0.1):
        errors = [squared_error(np.random.default_rng(10_000 + seed), reach) for seed in range(N_SIMULATED)]
        inside = float(np.mean(np.array(errors) < chi2.ppf(0.95, 6)))
        noise = "independent" if reach is None else f"correlated over {1e3 * reach:.0f} mm"
        print(f"{noise:24s} inside the 95 % ellipsoid: {100 * inside:.1f} %, mean chi2 of 6: {np.mean(errors):.2f}")


if __name__ == "__main__":
    wanted = sys.argv[1:] or ["speed", "calibration"]
    if "speed" in wanted:
        bench_speed()
    if "calibration" in wanted:
        bench_calibration()
