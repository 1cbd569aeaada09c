"""Faces that are there more than once: some programs write each twice, or once for either direction.

In: a mesh. Out: the same with each face once. Copies count twice in each area, and are no surface beside themselves.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from monitor.blocks import blocks
from projects.model import Ints, Surface

FACTORS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)  # odd, no pattern


def without_copied_faces(surface: Surface, either_way: bool = False) -> Surface:
    """Return a surface with each of its faces once: the first of those with the same corners, that go round the same
    way, or `either_way`."""
    faces = surface.faces
    if not _may_be_copied(faces, either_way):
        return surface
    if either_way:
        alike = np.sort(faces, axis=1)
    else:
        alike = np.take_along_axis(faces, (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    kept = np.sort(np.unique(alike, axis=0, return_index=True)[1])
    invented = None if surface.face_invented is None else surface.face_invented[kept]
    return replace(surface, faces=faces[kept], face_invented=invented)


def share_both_ways(surface: Surface) -> float:
    """Return the share of the faces, 0 to 1, that are there in both directions: such a face has no outer side."""
    n_faces = len(surface.faces)
    return 2.0 * (n_faces - len(without_copied_faces(surface, either_way=True).faces)) / max(n_faces, 1)


def _may_be_copied(faces: Ints, either_way: bool) -> bool:
    """Return whether two faces (m, 3) may be one, by a number of each: quick, and hardly ever where none are."""
    keys = np.empty(len(faces), dtype=np.uint64)
    for block in blocks(len(faces)):
        keys[block] = _number(faces[block].astype(np.uint64), either_way)
    keys.sort()
    return bool((keys[1:] == keys[:-1]).any())


def _number(faces: np.ndarray, either_way: bool) -> np.ndarray:
    """Return a number of each face, the same wherever it begins; products wrap around."""
    following = np.roll(faces, -1, axis=1)
    start, end = (np.minimum(faces, following), np.maximum(faces, following)) if either_way else (faces, following)
    edges = (start * FACTORS[0] ^ end * FACTORS[1]) * FACTORS[2]
    return np.asarray(edges.sum(axis=1, dtype=np.uint64))
