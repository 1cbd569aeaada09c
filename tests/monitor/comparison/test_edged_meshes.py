"""Finished meshes of a box, each made by Open3D of points of its own: edges are rounded otherwise each time."""

import numpy as np
import open3d as o3d
import pytest

from monitor.comparison import compare
from monitor.comparison.detection import detect as detection
from monitor.comparison.noise.patch_errors import calm_errors
from monitor.filtering import estimate_normals
from projects.model import Comparison, Floats, PointCloud, Registration, Surface

HALF = np.array([0.06, 0.05, 0.04])  # m, half the box
SPACING, NOISE = 0.002, 1.5e-4  # m
DENT, RADIUS = 0.002, 0.012  # m, in the middle of the face towards +x


def points_of_box(rng: np.random.Generator, dent: float) -> tuple[Floats, Floats]:
    """Return noisy points (n, 3) [m] on the six faces, and which way out is."""
    points, normals = [], []
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        for sign in (-1.0, 1.0):
            n = int(4.0 * HALF[a] * HALF[b] / SPACING**2)
            p = rng.uniform(-HALF, HALF, (n, 3))
            p[:, axis] = sign * HALF[axis]
            if axis == 0 and sign > 0.0:
                p[:, 0] -= dent * np.clip(1.0 - (p[:, 1] ** 2 + p[:, 2] ** 2) / RADIUS**2, 0.0, None)
            points.append(p)
            normals.append(sign * np.tile(np.eye(3)[axis], (n, 1)))
    where = np.concatenate(points)
    return where + rng.normal(0.0, NOISE, where.shape), np.concatenate(normals)


def mesh_of_box(rng: np.random.Generator, dent: float = 0.0) -> Surface:
    """Return the mesh that Open3D makes of such points, as the chain takes it."""
    points, outward = points_of_box(rng, dent)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(20))
    normals = np.asarray(cloud.normals)
    signs = np.sign(np.sum(normals * outward, axis=1))
    cloud.normals = o3d.utility.Vector3dVector(normals * signs[:, None])
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=6, n_threads=1)
    vertices = np.asarray(mesh.vertices)
    roughness = estimate_normals(PointCloud(vertices)).roughness
    return Surface(vertices, np.asarray(mesh.triangles).astype(np.int32), roughness=roughness)


def compared(seed: int, dent: float = 0.0) -> Comparison:
    rng = np.random.default_rng(seed)
    still = Registration(np.eye(4), np.zeros((6, 6)), np.zeros(3), True)
    return compare(mesh_of_box(rng), mesh_of_box(rng, dent), still)


@pytest.mark.parametrize("seed", [10, 12])
def test_edges_rounded_otherwise_are_no_change(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a normal distribution of the means of patches regions stand along edges."""
    assert len(compared(seed).regions) == 0
    monkeypatch.setattr(detection, "errors_of_calm", lambda side: calm_errors)
    assert len(compared(seed).regions) > 0


def test_a_dent_is_still_found() -> None:
    regions = compared(1, DENT).regions
    assert len(regions) == 1
    assert regions["extreme_m"][0] == pytest.approx(-DENT, abs=0.5e-3)
    assert np.linalg.norm(regions[["x", "y", "z"]].to_numpy(float)[0] - [HALF[0], 0.0, 0.0]) < 0.004
