"""Ten real scans of one sculpture come back from poses disturbed by 5 degrees and 10 mm, in one adjustment."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "validation"))

from test_bunny_main_job import read_configuration

from monitor.filtering import estimate_normals
from monitor.registration.motion.six_parameters import closest_motion
from monitor.registration.network.adjustment import AdjustmentSettings, adjust_scans
from projects.formats import read_scans
from projects.model import PointCloud
from projects.transforms import apply, rotate

VIEW = np.array([0.0, 0.0, 1.0])  # towards the sensor, in the scan's frame
ANGLE, WAY = np.radians(5.0), 0.010


def read_bunny(real_data: Path) -> tuple[list[PointCloud], list[np.ndarray]]:
    """Return the ten scans in their own frames, with normals towards the sensor, and their poses of bun.conf."""
    source = real_data / "stanford_bunny" / "range"
    clouds, poses = [], []
    for name, pose in read_configuration(source / "bun.conf"):
        points = np.concatenate([c.cloud.points for stream in read_scans(source / name) for c in stream.chunks()])
        clouds.append(estimate_normals(PointCloud(points, origins=VIEW)))
        poses.append(pose)
    return clouds, poses


def in_place(cloud: PointCloud, T: np.ndarray) -> PointCloud:
    return PointCloud(apply(T, cloud.points), normals=rotate(T, cloud.normals))


def disturb(pose: np.ndarray, centre: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the pose turned by 5 degrees about the scan's middle and shifted by 10 mm, in random directions."""
    axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(ANGLE * axis).as_matrix()
    T[:3, 3] = centre - T[:3, :3] @ centre + WAY * way
    return T @ pose


@pytest.mark.slow
def test_ten_scans_of_the_bunny_come_back_from_5_degrees_and_10_mm(real_data: Path) -> None:
    rng = np.random.default_rng(3)
    clouds, poses = read_bunny(real_data)
    start = [disturb(T, apply(T, c.points).mean(axis=0), rng) for c, T in zip(clouds, poses, strict=True)]
    found = adjust_scans([in_place(c, T) for c, T in zip(clouds, start, strict=True)])
    assert found.applied, found.reason
    placed = [apply(M @ T, c.points) for M, T, c in zip(found.motions, start, clouds, strict=True)]
    truth = [apply(T, c.points) for T, c in zip(poses, clouds, strict=True)]
    common = closest_motion(np.concatenate(placed), np.concatenate(truth), np.ones(sum(map(len, truth))))
    rms = [
        float(np.sqrt(np.mean(np.sum((apply(common, a) - b) ** 2, axis=1)))) for a, b in zip(placed, truth, strict=True)
    ]
    given = adjust_scans([in_place(c, T) for c, T in zip(clouds, poses, strict=True)])
    as_given = [p.sigma_before for p in given.pairs if p.n >= 1000]
    ours = [p.sigma_after for p in found.pairs if p.n >= 1000]
    print(f"\nrms to bun.conf [mm] {np.round(1e3 * np.array(rms), 3)}; {found.n_iterations} steps")
    print(f"median pair sigma {1e3 * np.median(ours):.4f} mm, with bun.conf {1e3 * np.median(as_given):.4f} mm")
    assert max(rms) < 0.0006
    assert np.median(ours) <= np.median(as_given)


@pytest.mark.slow
def test_the_bunny_scans_as_given_converge(real_data: Path) -> None:
    clouds, poses = read_bunny(real_data)
    found = adjust_scans([in_place(c, T) for c, T in zip(clouds, poses, strict=True)], AdjustmentSettings(seed=1))
    assert found.converged, found.reason
