"""Other programs on the same input.

pymeshlab (GPL) and py4dgeo come with the extra `validation`; the product never imports them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from monitor.reconstruction.cell_size import choose_cell_size, measure_and_sort, tree_of_points
from monitor.reconstruction.open3d_poisson import poisson_mesh
from projects.model import Floats, Ints, PointCloud
from projects.open3d_library import load_open3d

APSS_SCALE = 8.0  # of the local spacing: the widest that was tried, with the least noise


def open3d_poisson_vertices(cloud: PointCloud, cell: float | None = None) -> Floats:
    """Return the vertices of Open3D's screened Poisson surface at the cell size that ours would choose."""
    return open3d_poisson(cloud, cell)[0]


def open3d_poisson(cloud: PointCloud, cell: float | None = None) -> tuple[Floats, Ints]:
    """Return vertices and faces of Open3D's screened Poisson surface; `cell` in metres."""
    middle = cloud.points.mean(axis=0)
    assert cloud.normals is not None
    cell = cell or choose_cell_size(measure_and_sort(cloud, tree_of_points(cloud.points))[0])
    vertices, faces, _ = poisson_mesh(cloud.points - middle, cloud.normals, cell)
    return vertices + middle, faces


def apss_vertices(cloud: PointCloud, scale: float = APSS_SCALE) -> Floats:
    """Return the vertices of the APSS surface of pymeshlab by marching cubes."""
    vertices, _ = apss(cloud, scale)
    return vertices


def apss(cloud: PointCloud, scale: float = APSS_SCALE, resolution: int = 64) -> tuple[Floats, Ints]:
    """Return vertices and faces of the APSS surface; `resolution` cells along the longest side."""
    meshes = meshlab_cloud(cloud)
    meshes.generate_marching_cubes_apss(filterscale=scale, resolution=resolution, maxprojectioniters=30)
    mesh = meshes.current_mesh()
    return np.asarray(mesh.vertex_matrix()) + cloud.points.mean(axis=0), np.asarray(mesh.face_matrix(), np.int32)


def apss_of_count(cloud: PointCloud, n_wanted: int, scale: float, cell: float) -> Floats:
    """Return at most `n_wanted` vertices, drawn at random, of the APSS surface by marching cubes of `cell` [m]."""
    vertices, _ = apss(cloud, scale, int(np.ceil(np.ptp(cloud.points, axis=0).max() / cell)))
    return vertices[np.random.default_rng(1).permutation(len(vertices))[:n_wanted]]


def meshlab_cloud(cloud: PointCloud) -> Any:
    """Return a pymeshlab set with the cloud, near the origin (MeshLab computes in single precision)."""
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    middle = cloud.points.mean(axis=0)
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=cloud.points - middle, v_normals_matrix=cloud.normals), "cloud")
    return meshes


def open3d_without_outliers(points: Floats, n_neighbours: int = 20, n_sigmas: float = 2.0) -> Floats:
    """Return the points that Open3D's statistical outlier removal leaves."""
    cloud, _ = _open3d_cloud(points).remove_statistical_outlier(n_neighbours, n_sigmas)
    return np.asarray(cloud.points)


def open3d_voxels(points: Floats, size: float) -> Floats:
    """Return the mean of the points of each voxel, `size` in metres."""
    return np.asarray(_open3d_cloud(points).voxel_down_sample(size).points)


def open3d_normals(points: Floats, station: Floats, n_neighbours: int = 30) -> Floats:
    """Return Open3D's normals of the nearest points, towards a station."""
    cloud = _open3d_cloud(points)
    cloud.estimate_normals(load_open3d().geometry.KDTreeSearchParamKNN(n_neighbours))
    cloud.orient_normals_towards_camera_location(station)
    return np.asarray(cloud.normals)


def _open3d_cloud(points: Floats) -> Any:
    o3d = load_open3d()
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
