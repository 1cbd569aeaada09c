"""How far points lie from a surface along its normal: the difference model of a surface against its own scans.

`000` (figure 8) and `002` (figure 3) judge a surface so. Positive: the point lies outside, towards the scanner.
"""

from __future__ import annotations

import numpy as np

from monitor.boxes import middle_of
from monitor.reconstruction.bow import bow_at
from monitor.reconstruction.mesh import edge_table, face_areas_and_normals, normals_by_angle
from projects.errors import ReconstructionError
from projects.model import Bools, Floats, Ints, Surface
from projects.open3d_library import load_open3d

ON_EDGE = 1e-6  # barycentric coordinate below which a foot point is taken to lie on the edge
COS_OPPOSITE = -0.7  # a face beyond 135 degrees of the way of a place is of another sheet
COS_LOOKS_THE_SAME_WAY = 0.5  # a point's normal within 60 degrees of the face's


def surface_to_points(surface: Surface, points: Floats, normals: Floats | None = None) -> Floats:
    """Return the signed distance of each point to the surface along the surface normal.

    The surface of a face is not flat where its corners have fitted normals: see `bow_at`.

    Parameters
    ----------
    surface : what the points are measured against.
    points : (n, 3), m, in the frame of the surface.
    normals : (n, 3), optional; a point whose nearest face looks another way (beyond 60 degrees) is not over it.

    Returns
    -------
    (n,) float64, m, positive outside; NaN where the point is not over the surface: where its nearest place on the
    surface is a free edge, a face that looks another way, or one that closes a hole where nothing was measured (then
    the edge of that hole counts as free, as if it were open).

    Raises
    ------
    ReconstructionError
        Where the surface has no faces.
    """
    if not len(surface.faces):
        raise ReconstructionError("the surface has no faces to measure points against; give a mesh")
    points = np.asarray(points, float)
    face = nearest_faces(surface, points)
    foot, weights = closest_on_triangles(points, surface.vertices[surface.faces[face]])
    normal = _foot_normals(surface, face, weights)
    offset = points - foot
    side = np.einsum("ij,ij->i", offset, normal)
    distance = np.copysign(np.linalg.norm(offset, axis=1), side) - bow_at(surface, face, weights)
    invented = np.zeros(len(surface.faces), bool) if surface.face_invented is None else surface.face_invented
    is_over = ~(invented[face] | _on_free_edge(surface.faces, ~invented, face, weights))
    if normals is not None:
        is_over &= np.einsum("ij,ij->i", normal, normals) > COS_LOOKS_THE_SAME_WAY
    return np.where(is_over, distance, np.nan)


def is_covered(surface: Surface, places: Floats, ways: Floats, farthest: float) -> Bools:
    """Return which places (n, 3) lie over a measured face, not beside a free edge, within `farthest` (m).

    The face must not look against the way (n, 3) of the place: beyond an edge it may lie across, but on the other sheet
    of a plate it looks away.
    """
    face = nearest_faces(surface, places)
    foot, weights = closest_on_triangles(places, surface.vertices[surface.faces[face]])
    invented = np.zeros(len(surface.faces), bool) if surface.face_invented is None else surface.face_invented
    out: Bools = ~(invented[face] | _on_free_edge(surface.faces, ~invented, face, weights))
    out &= np.linalg.norm(places - foot, axis=1) < farthest
    return out & (np.einsum("ij,ij->i", _foot_normals(surface, face, weights), ways) > COS_OPPOSITE)


def nearest_faces(surface: Surface, points: Floats) -> Ints:
    """Return the index (n,) of the face nearest to each point, by Embree about the surface's centre."""
    open3d = load_open3d()
    centre = middle_of(surface.vertices)
    scene = open3d.t.geometry.RaycastingScene(nthreads=2)
    scene.add_triangles(
        np.ascontiguousarray(surface.vertices - centre, np.float32), np.ascontiguousarray(surface.faces, np.uint32)
    )
    answer = scene.compute_closest_points(np.ascontiguousarray(points - centre, np.float32))
    return answer["primitive_ids"].numpy().astype(np.int64)


def closest_on_triangles(points: Floats, corners: Floats) -> tuple[Floats, Floats]:
    """Return the nearest place (n, 3) of each triangle (n, 3, 3) to its point and its barycentric weights (n, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    dot = lambda x, y: np.einsum("ij,ij->i", x, y)  # noqa: E731
    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11, d20, d21 = dot(ab, ab), dot(ab, ac), dot(ac, ac), dot(ap, ab), dot(ap, ac)
    area2 = d00 * d11 - d01 * d01
    safe = np.where(area2 > 0.0, area2, 1.0)
    v, w = (d11 * d20 - d01 * d21) / safe, (d00 * d21 - d01 * d20) / safe
    weights = np.stack([1.0 - v - w, v, w], axis=1)
    inside = (weights >= 0.0).all(axis=1) & (area2 > 0.0)
    best = np.where(inside, 0.0, np.inf)
    for k in range(3):
        p, q = corners[:, k], corners[:, (k + 1) % 3]
        pq = q - p
        length2 = dot(pq, pq)
        t = np.clip(dot(points - p, pq) / np.where(length2 > 0.0, length2, 1.0), 0.0, 1.0)
        distance2 = ((p + t[:, None] * pq - points) ** 2).sum(axis=1)
        nearer = distance2 < best
        edge_weights = np.zeros_like(weights)
        edge_weights[:, k], edge_weights[:, (k + 1) % 3] = 1.0 - t, t
        weights = np.where(nearer[:, None], edge_weights, weights)
        best = np.where(nearer, distance2, best)
    return np.einsum("ij,ijk->ik", weights, corners), weights


def _foot_normals(surface: Surface, face: Ints, weights: Floats) -> Floats:
    """Return the face normal inside a face, the angle-weighted mean of the vertex normals on an edge or vertex."""
    _, face_normal = face_areas_and_normals(surface.vertices, surface.faces)
    blended = np.einsum("ij,ijk->ik", weights, normals_by_angle(surface.vertices, surface.faces)[surface.faces[face]])
    length = np.linalg.norm(blended, axis=1)
    blended /= np.where(length > 0.0, length, 1.0)[:, None]
    is_inside = np.all(weights > ON_EDGE, axis=1, keepdims=True)
    return np.where(is_inside, face_normal[face], blended)


def _on_free_edge(faces: Ints, measured: Bools, face: Ints, weights: Floats) -> Bools:
    """Return whether a foot point (n,) lies on an edge that one measured face has, or on an end of such an edge."""
    edges, edge_of, _ = edge_table(faces)
    n_faces = np.bincount(edge_of.reshape(-1, 3)[measured].ravel(), minlength=len(edges))
    free_vertex = np.zeros(int(faces.max()) + 1, bool)
    free_vertex[edges[n_faces == 1]] = True
    free_edge = np.equal(n_faces[edge_of], 1).reshape(-1, 3)[face]
    zero = weights <= ON_EDGE
    on_edge = (zero & np.roll(free_edge, -1, axis=1)).any(axis=1)
    at_vertex = (free_vertex[faces[face]] & (weights >= 1.0 - ON_EDGE)).any(axis=1)
    out: Bools = np.asarray(on_edge | at_vertex)
    return out
