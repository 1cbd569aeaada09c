"""Registration of scans measured by others: the bunny's range images and the simulated epochs of Piecewise-ICP."""

from pathlib import Path

import numpy as np
import pytest
from real_scans import read_points
from scipy.spatial.transform import Rotation

from monitor.registration import register
from projects.model import PointCloud
from projects.transforms import apply, perturb


def read_bunny(folder: Path, name: str) -> PointCloud:
    """Return one range image in the frame of bun.conf: p' = R(q)^T p + t (see the data's README)."""
    line = next(text.split() for text in (folder / "bun.conf").read_text().splitlines() if f" {name} " in text)
    numbers = np.array(line[2:], dtype=float)
    return PointCloud(read_points(folder / name) @ Rotation.from_quat(numbers[3:]).as_matrix() + numbers[:3])


PAIRS = [("bun045.ply", "bun000.ply"), ("bun090.ply", "bun045.ply"), ("top3.ply", "bun000.ply"),
         ("bun315.ply", "bun270.ply"), ("ear_back.ply", "bun180.ply"), ("chin.ply", "bun000.ply")]  # fmt: skip


@pytest.mark.parametrize(("source", "target"), PAIRS)
def test_disturbed_range_images_come_back_to_their_published_poses(
    real_data: Path, rng: np.random.Generator, source: str, target: str
) -> None:
    folder = real_data / "stanford_bunny" / "range"
    cloud, fixed = read_bunny(folder, source), read_bunny(folder, target)
    axis, way = rng.normal(size=3), rng.normal(size=3)
    turn, shift = np.radians(3.0) * axis / np.linalg.norm(axis), 0.005 * way / np.linalg.norm(way)
    T = perturb(np.eye(4), cloud.points.mean(axis=0), np.concatenate([turn, shift]))
    registration = register(PointCloud(apply(T, cloud.points)), fixed)
    assert registration.converged, registration.reason
    error = apply(registration.T_target_source @ T, cloud.points) - cloud.points
    # the published poses are estimates themselves: pairs agree with them to 0.1-0.4 mm; 0.6 mm is asked for
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.6e-3
    assert 0.08e-3 < registration.sigma < 0.25e-3  # the scanner's noise, 0.12-0.15 mm between scans


@pytest.mark.parametrize("epoch", [*(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3, 4, 5)), 6])
def test_epochs_find_their_true_motion_while_parts_move(real_data: Path, epoch: int) -> None:
    folder = real_data / "piecewise_icp_synth"
    rows = [line.split() for line in (folder / "defined_transformations.txt").read_text().splitlines() if line.strip()]
    T_truth = np.array(rows[5 * epoch - 4 : 5 * epoch], dtype=float)  # after a line with the epoch's number
    source, target = (read_points(folder / "with_T" / f"Epoch_00{k}.pcd") for k in (epoch, 1))
    registration = register(PointCloud(source), PointCloud(target))
    assert registration.converged, registration.reason
    centroid = source.mean(axis=0)
    true_centroid = T_truth[:3, :3] @ centroid + T_truth[:3, 3]
    assert np.linalg.norm(apply(registration.T_target_source, centroid) - true_centroid) < 1e-3
    u, _, vt = np.linalg.svd(T_truth[:3, :3])  # the true rotations are first order and not orthonormal
    left = Rotation.from_matrix(registration.T_target_source[:3, :3] @ (u @ vt).T).magnitude()
    assert np.degrees(left) < 0.05
