"""The truth of a body that is its mesh: closed triangle meshes in, exact closest points, distances and normals out.

Large scenes and those made of a table of heights are polyhedra by definition: what is scanned is what the truth
knows, without any chord error between the two. Open3D (float32) finds the nearest face, the foot on it is computed in
float64. Where two faces are equally near to float32's rounding (2 micrometres at 20 m from the mesh's middle) the
other one may be taken, which changes the distance by no more than that.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence

import numpy as np

from monitor.simulation.scenes import Body, Truth
from projects.model import Bools, Floats, Ints
from projects.open3d_library import load_open3d

ON_SURFACE = 5e-6  # m: nearer than this the side is that of the face, not of a float32 ray


def closest_on_faces(points: Floats, corners: Floats) -> tuple[Floats, Bools]:
    """Return the point of each triangle nearest to its point, (n, 3), and whether it lies inside its edges (n,).

    `points` (n, 3), `corners` (n, 3, 3). Ericson, Real-Time Collision Detection, section 5.1.5, as the best of the
    foot of the perpendicular, where it falls inside, and of the feet on the three edges.
    """
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    n = np.cross(ab, ac)
    n2 = np.maximum((n * n).sum(axis=1), 1e-300)
    w = points - a
    v = (np.cross(w, ac) * n).sum(axis=1) / n2
    u = (np.cross(ab, w) * n).sum(axis=1) / n2
    inside = (v >= 0.0) & (u >= 0.0) & (v + u <= 1.0)
    foot = points - ((w * n).sum(axis=1) / n2)[:, None] * n
    best2 = np.where(inside, 0.0, np.inf)
    for k in range(3):
        start, along = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        length2 = np.maximum((along * along).sum(axis=1), 1e-300)
        t = np.clip(((points - start) * along).sum(axis=1) / length2, 0.0, 1.0)
        on_edge = start + t[:, None] * along
        gap2 = ((points - on_edge) ** 2).sum(axis=1)
        closer = gap2 < best2
        foot[closer], best2[closer] = on_edge[closer], gap2[closer]
    return foot, inside


def truth_of_bodies(
    bodies: Sequence[Body], curvatures: Sequence[Callable[[Floats], Floats] | None] | None = None
) -> Truth:
    """Return the truth of closed bodies that may touch but not overlap, their meshes taken as their exact surface.

    Parameters
    ----------
    bodies : closed meshes.
    curvatures : for each body a function of points on it (n, 3) -> (n, 2) [1/m], for one whose mesh stands for a
        curved form, or None for one that truly consists of planes: 0 on faces, NaN where the foot lies on an edge.

    Returns
    -------
    Truth; inside the material a face that another body covers still counts as surface.
    """
    counts = [len(body.faces) for body in bodies]
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    corners = np.concatenate([body.vertices[body.faces] for body in bodies])
    owner = np.repeat(np.arange(len(bodies)), counts)
    middle = 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))

    @functools.cache
    def tree():  # type: ignore[no-untyped-def]
        o3d = load_open3d()
        scene = o3d.t.geometry.RaycastingScene(nthreads=2)
        for body in bodies:
            vertices = (body.vertices - middle).astype(np.float32)
            scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(body.faces.astype(np.uint32)))
        return scene

    def find(points: Floats) -> tuple[Ints, Floats, Bools]:
        """Return the nearest face of each point, the foot on it, and whether that lies inside its edges."""
        o3d = load_open3d()
        shifted = np.ascontiguousarray(points - middle, dtype=np.float32)
        found = tree().compute_closest_points(o3d.core.Tensor(shifted), nthreads=2)
        face = first[found["geometry_ids"].numpy()] + found["primitive_ids"].numpy()
        return (face, *closest_on_faces(points, corners[face]))

    def face_normals(face: Ints) -> Floats:
        c = corners[face]
        n = np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])
        return n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300)

    def signed(points: Floats) -> Floats:
        face, foot, inside = find(points)
        off = points - foot
        distance = np.linalg.norm(off, axis=1)
        above = (off * face_normals(face)).sum(axis=1) >= 0.0
        far = ~inside | (distance > ON_SURFACE)
        above[far] = _is_outside(tree(), points[far] - middle)
        return np.where(above, distance, -distance)

    def curvature(points: Floats) -> Floats:
        face, foot, inside = find(points)
        bent = np.where(inside[:, None], np.zeros((len(points), 2)), np.nan)
        for k, of_one in enumerate(curvatures or ()):
            of_body = owner[face] == k
            if of_one is not None and of_body.any():
                bent[of_body] = of_one(foot[of_body])
        return bent

    return Truth(lambda p: find(p)[1], signed, lambda p: face_normals(find(p)[0]), curvature)


def _is_outside(scene: object, points: Floats) -> Bools:
    """Return whether points lie outside of all closed bodies of an Open3D scene, by the parity of three rays."""
    o3d = load_open3d()
    if len(points) == 0:
        return np.empty(0, dtype=bool)
    inside = scene.compute_occupancy(  # type: ignore[attr-defined]
        o3d.core.Tensor(np.ascontiguousarray(points, dtype=np.float32)), nthreads=2, nsamples=3
    )
    return inside.numpy() < 0.5
