"""Where a mesh ends: the vertices on its free edges."""

from __future__ import annotations

import numpy as np

from monitor.reconstruction.mesh import edge_table
from projects.model import Bools, Ints


def boundary_vertices(faces: Ints, n_vertices: int) -> Bools:
    """Return which vertices (n,) lie on an edge that has one face only."""
    edges, _, n_faces = edge_table(faces)
    out = np.zeros(n_vertices, bool)
    out[edges[n_faces == 1]] = True
    return out
