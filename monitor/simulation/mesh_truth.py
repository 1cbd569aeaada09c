"""The truth of a body that is its mesh: closed triangle meshes in, exact closest points, distances and normals out.

Large scenes and those made of a table of heights are polyhedra by definition: what is scanned is what the truth
knows, without any chord error between the two. Open3D (float32) finds the nearest face, the foot on it is computed in
float64. Where two faces are equally near to float32's rounding (2 micrometres at 20 m from the mesh's middle) the
other one may be taken, which changes the distance by no more than that.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from monitor.simulation.scenes import Body, Truth
from projects.model import Bools, Floats, Ints
from projects.open3d_library import load_open3d
from projects.triangles import unit_normals

RAYS = np.array([[0.31, 0.52, 0.797], [-0.73, 0.29, 0.619], [0.11, -0.83, -0.547]])
N_NEIGHBOURS_TRIED = 8
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
    """Return the truth of closed bodies that may touch and overlap, their meshes taken as their exact surface.

    Parameters
    ----------
    bodies : closed meshes.
    curvatures : for each body a function of points on it (n, 3) -> (n, 2) [1/m], for one whose mesh stands for a
        curved form, or None for one that truly consists of planes: 0 on faces, NaN where the foot lies on an edge.

    Returns
    -------
    Truth; faces that lie wholly inside of another body are no surface. A face covered in part is one.
    """
    mesh = _Mesh(tuple(bodies), tuple(curvatures or ()))
    return Truth(
        lambda p: mesh.find(p)[1], mesh.signed_distance, lambda p: mesh.face_normals(mesh.find(p)[0]), mesh.curvature
    )


@dataclass(frozen=True, eq=False)
class _Mesh:
    """The faces of closed bodies as one surface, with what is looked up in it; see `truth_of_bodies`."""

    bodies: tuple[Body, ...]
    curvatures: tuple[Callable[[Floats], Floats] | None, ...]

    @functools.cached_property
    def corners(self) -> Floats:
        """Corners of each face (f, 3, 3) m."""
        return np.concatenate([body.vertices[body.faces] for body in self.bodies])

    @functools.cached_property
    def owner(self) -> Ints:
        """Number (f,) of the body of each face."""
        return np.repeat(np.arange(len(self.bodies)), [len(body.faces) for body in self.bodies])

    @functools.cached_property
    def middle(self) -> Floats:
        """Middle (3,) m of the box of all, about which float32 is exact enough."""
        return np.asarray(0.5 * (self.corners.min(axis=(0, 1)) + self.corners.max(axis=(0, 1))))

    def face_normals(self, face: Ints) -> Floats:
        """Return the outward unit normals of faces (n,)."""
        return unit_normals(self.corners[face])

    @functools.cached_property
    def trees(self) -> tuple[_Tree, _Tree, Ints]:
        """All faces as a tree, the open ones as another, and the numbers of the open ones."""
        corners = self.corners - self.middle
        whole = _grow_tree(corners, self.owner)
        normals = self.face_normals(np.arange(len(corners)))
        open_ = np.flatnonzero(~_is_covered(whole, corners, self.owner, normals))
        return whole, whole if len(open_) == len(corners) else _grow_tree(corners[open_], self.owner[open_]), open_

    @functools.cached_property
    def is_open(self) -> Bools:
        """Whether each face (f,) is surface, and not inside of another body."""
        return np.isin(np.arange(len(self.corners)), self.trees[2])

    @functools.cached_property
    def neighbours(self) -> Ints:
        """Faces across the three edges of each, (f, 3)."""
        starts = np.cumsum([0, *(len(body.vertices) for body in self.bodies[:-1])])
        faces = [body.faces.astype(np.int64) + start for body, start in zip(self.bodies, starts, strict=True)]
        return _list_neighbours(np.concatenate(faces))

    def find(self, points: Floats) -> tuple[Ints, Floats, Bools]:
        """Return the nearest face of each point, the foot on it, and whether that lies inside its edges."""
        o3d = load_open3d()
        shifted = np.ascontiguousarray(points - self.middle, dtype=np.float32)
        _, tree, open_ = self.trees
        found = tree.scene.compute_closest_points(o3d.core.Tensor(shifted), nthreads=2)
        face = open_[tree.first[found["geometry_ids"].numpy()] + found["primitive_ids"].numpy()]
        foot, inside = closest_on_faces(points, self.corners[face])
        self._walk_nearer(points, face, foot, inside)
        return face, foot, inside

    def _walk_nearer(self, points: Floats, face: Ints, foot: Floats, inside: Bools) -> None:
        """Go from each face across edges while that leads nearer to its point; `face`, `foot`, `inside` are changed.

        On long thin faces float32 may have taken a neighbour of the nearest, a millimetre farther off on faces of 7 m
        by 3 cm.
        """
        gap, walking = np.linalg.norm(points - foot, axis=1), np.arange(len(points))
        for _ in range(N_NEIGHBOURS_TRIED):
            tried = self.neighbours[face[walking]]
            at = [closest_on_faces(points[walking], self.corners[tried[:, k]]) for k in range(3)]
            gaps = np.stack([np.linalg.norm(points[walking] - a[0], axis=1) for a in at])
            gaps[~self.is_open[tried].T] = np.inf  # beyond the rim of a joint the face is no surface
            best, row = gaps.argmin(axis=0), np.arange(len(walking))
            nearer = gaps[best, row] < gap[walking] - 1e-12
            walking, best, row = walking[nearer], best[nearer], row[nearer]
            if not len(walking):
                break
            face[walking] = tried[row, best]
            foot[walking] = np.stack([a[0] for a in at])[best, row]
            inside[walking] = np.stack([a[1] for a in at])[best, row]
            gap[walking] = gaps[best, row]

    def signed_distance(self, points: Floats) -> Floats:
        """Return the distance (n,) [m] of points, negative inside of a body."""
        face, foot, inside = self.find(points)
        off = points - foot
        distance = np.linalg.norm(off, axis=1)
        above = (off * self.face_normals(face)).sum(axis=1) >= 0.0
        # Below a face is inside of its body; above it, or beside it, another body may be: rays tell, and above a face
        # all of them must, since one that slips along an edge miscounts.
        unsure = np.flatnonzero(~inside | (above & (distance > ON_SURFACE)))
        held = count_bodies_around(self.trees[0], points[unsure] - self.middle, self.face_normals)
        above[unsure] = np.where(inside[unsure], held.min(axis=0, initial=np.inf), np.median(held, axis=0)) < 0.5
        return np.where(above, distance, -distance)

    def curvature(self, points: Floats) -> Floats:
        """Return both curvatures (n, 2) [1/m] at the feet of points; NaN where a flat face ends."""
        face, foot, inside = self.find(points)
        bent = np.where(inside[:, None], np.zeros((len(points), 2)), np.nan)
        for k, of_one in enumerate(self.curvatures):
            of_body = self.owner[face] == k
            if of_one is not None and of_body.any():
                bent[of_body] = of_one(foot[of_body])
        return bent


@dataclass(frozen=True)
class _Tree:
    """Open3D's tree of triangles, one geometry for each body, and the number of the first face of each."""

    scene: Any
    first: Ints


def _grow_tree(corners: Floats, owner: Ints) -> _Tree:
    """Return the tree of triangles (n, 3, 3) of bodies `owner` (n,), ascending.

    One geometry a body: of two faces of one geometry that a ray meets at the same range, Open3D lists one only, as it
    should for the faces beside an edge, but not for those of two bodies that touch.
    """
    o3d = load_open3d()
    scene = o3d.t.geometry.RaycastingScene(nthreads=2)
    first = np.flatnonzero(np.diff(owner, prepend=-1))
    for mine in np.split(corners, first[1:]):
        faces = np.arange(3 * len(mine), dtype=np.uint32).reshape(-1, 3)
        scene.add_triangles(o3d.core.Tensor(mine.reshape(-1, 3).astype(np.float32)), o3d.core.Tensor(faces))
    return _Tree(scene, first)


def count_bodies_around(
    tree: _Tree, points: Floats, face_normals: Callable[[Ints], Floats], *, n_rays: int = 3
) -> Floats:
    """Return how many closed bodies hold each point (n_rays, n): exits less entries along each of some rays."""
    o3d = load_open3d()
    counts = np.zeros((n_rays, len(points)))
    for k, towards in enumerate(RAYS[:n_rays] if len(points) else ()):
        rays = np.concatenate([points, np.broadcast_to(towards, points.shape)], axis=1).astype(np.float32)
        met = tree.scene.list_intersections(o3d.core.Tensor(rays), nthreads=2)
        face = tree.first[met["geometry_ids"].numpy()] + met["primitive_ids"].numpy()
        leaves = np.sign(face_normals(face) @ towards)
        counts[k] = np.bincount(met["ray_ids"].numpy().astype(np.int64), leaves, minlength=len(points))
    return counts


def _list_neighbours(faces: Ints) -> Ints:
    """Return the face across each of the three edges of each face (n, 3); the face itself where there is none."""
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    key = edges[:, 0] * (faces.max() + 1) + edges[:, 1]
    order = np.argsort(key, kind="stable")
    pair = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    across = np.repeat(np.arange(len(faces)), 3)
    one, other = order[pair], order[pair + 1]
    across[one], across[other] = other // 3, one // 3
    return across.reshape(-1, 3)


def _is_covered(tree: _Tree, corners: Floats, owner: Ints, normals: Floats) -> Bools:
    """Return whether faces (n, 3, 3) lie wholly inside of another body: the middle and a point by each corner do."""
    covered = _reaches_another(corners, owner)
    for weight in np.array([[1 / 3, 1 / 3, 1 / 3], [0.9, 0.05, 0.05], [0.05, 0.9, 0.05], [0.05, 0.05, 0.9]]):
        left = np.flatnonzero(covered)
        lifted = np.einsum("nij,i->nj", corners[left], weight) + 2.0 * ON_SURFACE * normals[left]
        covered[left] = count_bodies_around(tree, lifted, lambda face: normals[face], n_rays=1)[0] > 0.5
    return covered


def _reaches_another(corners: Floats, owner: Ints) -> Bools:
    """Return whether the middle of a face lies in the box of a body other than its own."""
    middle, reaches = corners.mean(axis=1), np.zeros(len(corners), dtype=bool)
    for k in range(int(owner[-1]) + 1 if len(owner) else 0):
        mine = owner == k
        low, high = corners[mine].min(axis=(0, 1)) - ON_SURFACE, corners[mine].max(axis=(0, 1)) + ON_SURFACE
        reaches |= ~mine & ((middle >= low) & (middle <= high)).all(axis=1)
    return reaches
