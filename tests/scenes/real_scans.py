"""Scans made by others: the points of a file, and the bunny's range images with their poses of bun.conf."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from monitor.filtering import estimate_normals
from projects.formats import read_scans
from projects.model import Floats, PointCloud

VIEW = np.array([0.0, 0.0, 1.0])  # towards the sensor, in the scan's frame


def read_points(path: Path) -> Floats:
    """Return the points of all scans of a file."""
    return np.vstack([chunk.cloud.points for scan in read_scans(path) for chunk in scan.chunks()])


def read_configuration(path: Path) -> list[tuple[str, np.ndarray]]:
    """Return (file name, T_project_scanner) of bun.conf, whose line maps by p' = R(q)^T p + t."""
    scans = []
    for line in path.read_text().splitlines():
        words = line.split()
        if not words or words[0] != "bmesh":
            continue
        t, (x, y, z, w) = (
            np.array(words[2:5], float),
            np.array(words[5:9], float) / np.linalg.norm(np.array(words[5:9], float)),
        )
        rotation = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation.T, t
        scans.append((words[1], pose))
    return scans


def read_range_image(folder: Path, name: str, step: int) -> tuple[PointCloud, Floats]:
    """Return a range image in its own frame with normals towards its sensor, and its pose of bun.conf."""
    line = next(text.split() for text in (folder / "bun.conf").read_text().splitlines() if f" {name} " in text)
    numbers, pose = np.array(line[2:], dtype=float), np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_quat(numbers[3:]).as_matrix().T, numbers[:3]
    cloud = estimate_normals(PointCloud(read_points(folder / name)[::step], origins=np.array([0.0, 0.0, 1.0])))
    return PointCloud(cloud.points, normals=cloud.normals, origins=np.array([0.0, 0.0, 1.0])), pose


def read_bunny(real_data: Path) -> tuple[list[PointCloud], list[np.ndarray]]:
    """Return the ten scans in their own frames, with normals towards the sensor, and their poses of bun.conf."""
    source = real_data / "stanford_bunny" / "range"
    clouds, poses = [], []
    for name, pose in read_configuration(source / "bun.conf"):
        points = np.concatenate([c.cloud.points for stream in read_scans(source / name) for c in stream.chunks()])
        clouds.append(estimate_normals(PointCloud(points, origins=VIEW)))
        poses.append(pose)
    return clouds, poses
