"""Directions across others: a frame about each normal. In: unit vectors (n, 3). Out: two more at right angles."""

from __future__ import annotations

import numpy as np

from projects.model import Floats


def frames_across(normals: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors (n, 3) each, at right angles to unit normals (n, 3) and to each other, right-handed with
    them as the third. Which way the first looks is anyone's: across the axis that the normal is farthest from."""
    first = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)
