"""Triangles: their normals and areas, and what the vertices that they meet at have of them.

In: corners (m, 3, 3) of triangles, or vertices (n, 3) and faces (m, 3); metres. Out: one row a triangle or a vertex.
Normals follow the right hand: seen from where they point to, the corners go round to the left.
"""

from __future__ import annotations

import numpy as np

from projects.model import Bools, Floats, Ints, Surface


def area_vectors(corners: Floats) -> Floats:
    """Return the normals (m, 3) of triangles, as long as twice their areas [m2]; 0 0 0 without area."""
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def face_normals(surface: Surface) -> Floats:
    """Return the normals (m, 3) of a surface's faces, as long as twice their areas [m2]."""
    return area_vectors(surface.vertices[surface.faces])


def unit_normals(corners: Floats) -> Floats:
    """Return the unit normals (m, 3) of triangles, 0 0 0 without area."""
    across = area_vectors(corners)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    return np.divide(across, length, out=np.zeros_like(across), where=length > 0)


def face_areas(corners: Floats) -> Floats:
    """Return the areas (m,) [m2] of triangles."""
    return np.asarray(0.5 * np.linalg.norm(area_vectors(corners), axis=1))


def share_among_vertices(values: Floats, faces: Ints, n_vertices: int) -> Floats:
    """Return the sum (n,) over the faces around each vertex of the values (m,) of these faces."""
    shares = np.zeros(n_vertices)
    for corner in range(3):
        shares += np.bincount(faces[:, corner], values, n_vertices)
    return shares


def vertex_areas(vertices: Floats, faces: Ints) -> Floats:
    """Return the area (n,) [m2] that each vertex stands for: a third of its faces'."""
    return share_among_vertices(face_areas(vertices[faces]) / 3.0, faces, len(vertices))


def vertex_normals(vertices: Floats, faces: Ints) -> Floats:
    """Return unit normals (n, 3) at the vertices, the area-weighted mean of the faces around; NaN without faces."""
    around = area_vectors(vertices[faces])
    normals = np.column_stack([share_among_vertices(around[:, k], faces, len(vertices)) for k in range(3)])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.full_like(normals, np.nan), where=length > 0)


def measured_faces(surface: Surface) -> Ints:
    """Return the faces (k, 3) of a surface that are not invented."""
    return surface.faces if surface.face_invented is None else surface.faces[~surface.face_invented]


def rest_on_nothing(surface: Surface) -> Bools:
    """Return which vertices (n,) of a surface with invented faces have no other face: nobody measured them."""
    out = np.zeros(len(surface.vertices), dtype=np.bool_)
    if surface.face_invented is not None:
        out[:] = True
        out[measured_faces(surface)] = False
    return out
