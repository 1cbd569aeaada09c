"""Where on the object a region lies, in the words of someone who stands before its front.

In: a comparison. Out: which way the region faces, on which part of the object it lies, its height above the base.
"""

from __future__ import annotations

import numpy as np

from projects.model import ComparedSurface, Comparison, Floats
from reports.cameras import UP, face_normals, find_front
from reports.quantities import NOT_KNOWN, height

STEEP = np.cos(np.deg2rad(40.0))  # a region that faces so nearly up or down is on the top or the underside
SIDES = ("front", "front right", "right side", "back right", "back", "back left", "left side", "front left")
APART = 1.0 / 6.0  # of the object's width, from its middle: beyond it one says "left" or "right"


def facing(compared: ComparedSurface, number: int) -> Floats:
    """Return the sum of the outward normals [m2] of the faces that lie in a region."""
    inside = (compared.region == number)[compared.surface.faces].any(axis=1)
    return face_normals(compared.surface)[inside].sum(axis=0)


def name_side(normal: Floats, front: Floats) -> str:
    """Return the side of the object that faces along `normal`: one of `SIDES`, the top or the underside."""
    length = np.linalg.norm(normal)
    if not length > 0.0:
        return ""
    upward = float(normal @ UP) / length
    if abs(upward) > STEEP:
        return "top" if upward > 0 else "underside"
    right = np.cross(UP, front)
    turn = np.arctan2(normal @ right, normal @ front)
    return SIDES[round(float(turn) / (np.pi / 4)) % 8]


def name_part(place: Floats, box: Floats, front: Floats) -> str:
    """Return "to the left" or "to the right" of the object's middle as seen from the front, else nothing."""
    right = np.cross(UP, front)
    corners = np.array([[x, y] for x in box[:, 0] for y in box[:, 1]]) @ right[:2]
    across = (place[:2] @ right[:2] - corners.min()) / max(float(np.ptp(corners)), 1e-300) - 0.5
    return "to the left" if across < -APART else "to the right" if across > APART else ""


def locate(comparison: Comparison, number: int, place: Floats) -> str:
    """Return where a region with its centroid at `place` (3,) lies: its side, its part, its height above the base."""
    if not np.isfinite(place).all():
        return NOT_KNOWN
    reference = comparison.on_reference.surface
    front = find_front(reference)
    box = np.stack([reference.vertices.min(axis=0), reference.vertices.max(axis=0)])
    side = name_side(facing(comparison.on_compared, number) + facing(comparison.on_reference, number), front)
    part = name_part(place, box, front) if side in ("front", "back", "top", "underside", "") else ""
    above = f"{height(float(place[2] - box[0, 2]))} above the base"
    return ", ".join(words for words in (side, part, above) if words)
