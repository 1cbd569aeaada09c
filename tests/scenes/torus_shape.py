"""A ring by formula: a shape with a hole, whose curvature is known."""

import numpy as np

from monitor.simulation.solid import Field
from projects.model import Floats


def torus(centre: Floats, axis: Floats, radius: float, thickness: float) -> Field:
    """Return a ring of `radius` about `axis`, `thickness` the radius of its section."""
    c, a = np.asarray(centre, dtype=float)[:, None], np.asarray(axis, dtype=float)
    a = a / np.linalg.norm(a)

    def field(p: Floats) -> Floats:
        """Return the signed distance (n,) of the ring."""
        q = p - c
        h = a @ q
        across = np.sqrt(np.maximum((q * q).sum(axis=0) - h * h, 0.0))
        return np.hypot(across - radius, h) - thickness

    return field
