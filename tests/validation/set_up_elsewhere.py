"""A later epoch of a finished mesh, as another survey puts it: turned a little and shifted."""

from __future__ import annotations

import numpy as np
import trimesh

from projects.model import Floats

TURN, SHIFT = 0.02, (0.001, 0.002, 0.0005)  # rad, m: how a later epoch stands off the first


def set_up_elsewhere(points: Floats) -> Floats:
    """Return the points (n, 3) turned about the vertical through their middle, and shifted."""
    T = trimesh.transformations.rotation_matrix(TURN, [0.0, 0.0, 1.0], points.mean(axis=0))
    return np.asarray(points @ T[:3, :3].T + T[:3, 3] + np.array(SHIFT))
