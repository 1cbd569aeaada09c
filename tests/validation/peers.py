"""Other programs on the same input.

pymeshlab (GPL) and py4dgeo come with the extra `validation`; the product never imports them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from monitor.reconstruction.cell_size import choose_cell_size, measure_sampling
from monitor.reconstruction.open3d_poisson import poisson_mesh
from projects.model import Floats, Ints, PointCloud

APSS_SCALE = 8.0  # of the local spacing: the widest that was tried, with the least noise


def open3d_poisson_vertices(cloud: PointCloud, cell: float | None = None) -> Floats:
    """Return the vertices of Open3D's screened Poisson surface at the cell size that ours would choose."""
    return open3d_poisson(cloud, cell)[0]


def open3d_poisson(cloud: PointCloud, cell: float | None = None) -> tuple[Floats, Ints]:
    """Return vertices and faces of Open3D's screened Poisson surface; `cell` in metres."""
    middle = cloud.points.mean(axis=0)
    assert cloud.normals is not None
    cell = cell or choose_cell_size(measure_sampling(cloud))
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


def apss_projected(cloud: PointCloud, places: Floats, scale: float) -> Floats:
    """Return `places` (n, 3) projected onto the APSS surface of the cloud."""
    import pymeshlab

    middle = cloud.points.mean(axis=0)
    meshes = meshlab_cloud(cloud)
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=places - middle), "places")
    meshes.compute_mls_projection_apss(controlmesh=0, proxymesh=1, filterscale=scale, maxprojectioniters=30)
    return np.asarray(meshes.mesh(1).vertex_matrix()) + middle


def meshlab_cloud(cloud: PointCloud) -> Any:
    """Return a pymeshlab set with the cloud, near the origin (MeshLab computes in single precision)."""
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    middle = cloud.points.mean(axis=0)
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=cloud.points - middle, v_normals_matrix=cloud.normals), "cloud")
    return meshes
