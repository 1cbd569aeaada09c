"""A finished mesh within the object's extent: what else was modelled, floor and neighbours, is no part of the object.

In: a mesh and the extent, both in the project's frame. Out: the faces that lie within, and what share of the area does
not. A mesh of which nothing lies within stands in a frame of its own: it stays whole, and is found by its shape.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from monitor.reconstruction.mesh import compact, face_areas_and_normals
from projects.extent import inside
from projects.model import Bools, Surface


@dataclass(frozen=True)
class CutMesh:
    """A mesh, how many of its faces were left out, and the `share` of the area, 0 to 1, that lies outside of the
    extent: 1 where all does, and nothing was left out."""

    surface: Surface
    n_outside: int
    share: float


def cut_to_extent(mesh: Surface, extent: Mapping[str, Any] | None) -> CutMesh:
    """Return the part of a mesh that lies within an extent (`ObjectRecord.extent`), all of it where there is none.

    A face lies within where all its corners do.
    """
    if extent is None:
        return CutMesh(mesh, 0, 0.0)
    keep = np.asarray(inside(extent, mesh.vertices)[mesh.faces].all(axis=1))
    if keep.all():
        return CutMesh(mesh, 0, 0.0)
    if not keep.any():
        return CutMesh(mesh, 0, 1.0)
    areas = face_areas_and_normals(mesh.vertices, mesh.faces)[0]
    share = float(areas[~keep].sum() / max(areas.sum(), 1e-300))
    return CutMesh(take_faces(mesh, keep), int((~keep).sum()), share)


def take_faces(mesh: Surface, keep: Bools) -> Surface:
    """Return a mesh of the faces to keep (m,) and their corners alone, with what is known of them."""
    used, faces = compact(len(mesh.vertices), mesh.faces[keep])
    n = len(mesh.vertices)
    fields = {name: value for name, value in vars(mesh).items() if isinstance(value, np.ndarray) and len(value) == n}
    taken = {name: value[used] for name, value in fields.items() if name not in ("faces", "face_invented")}
    invented = None if mesh.face_invented is None else mesh.face_invented[keep]
    return replace(mesh, **taken, faces=faces, face_invented=invented)
