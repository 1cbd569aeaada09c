"""A raw surface by Open3D's screened Poisson reconstruction (Kazhdan & Hoppe 2013), to compare with.

In: points and outward normals near the origin, a cell size. Out: a closed raw mesh, closed also where nothing was
measured: the caller trims. One thread, since several give other bits in each run.
"""

from __future__ import annotations

import numpy as np

from projects.errors import ReconstructionError
from projects.model import Floats, Ints
from projects.open3d_library import load_open3d

MARGIN = 1.1  # the solver's cube against the extent of the points
DEEPEST = 11  # of the octree: 2048 cells along an edge; 12 takes tens of gigabytes


def poisson_mesh(points: Floats, normals: Floats, cell: float) -> tuple[Floats, Ints, float]:
    """Return vertices (n, 3), faces (m, 3) and the cell size used: `cell`, or the finest that Open3D can hold."""
    open3d = load_open3d()
    extent = float(np.ptp(points, axis=0).max())
    depth = min(max(int(np.ceil(np.log2(MARGIN * extent / cell))), 4), DEEPEST)
    scale = max(2.0**depth * cell / extent, MARGIN)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud.normals = open3d.utility.Vector3dVector(normals)
    mesh, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=depth, scale=scale, n_threads=1)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    if not len(faces) or not np.isfinite(vertices).all():
        raise ReconstructionError(
            f"no surface came of {len(points)} points with cells of {cell:.4g} m; "
            "give more points, or set another cell size"
        )
    return vertices, faces, scale * extent / 2.0**depth
