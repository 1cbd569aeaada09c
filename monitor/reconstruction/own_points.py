"""What the points say of the mesh that was made of them: where it passes them by, it is known less well than its fits.

A fit that takes relief for noise, or leaves some of its points aside, is sure of itself and wrong. The points around
show it: they lie off the mesh by more than their noise.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from monitor.reconstruction.distances import surface_to_points
from projects.model import Floats, PointCloud, Surface

N_AROUND = 9  # points about a vertex that are asked
FEWEST = 6  # of them that must lie over the mesh
NORMAL = 0.818  # rms of the smaller eight of nine normal errors (simulated)
BEYOND = 1.517  # what it exceeds in one of a thousand


def misfit_at_vertices(surface: Surface, cloud: PointCloud, samples: cKDTree, shift: Floats, noise: float) -> Floats:
    """Return how far the points around each vertex lie off the mesh beyond their noise (n,) [m]; 0 where they do not.

    Parameters
    ----------
    surface : made of the points of `cloud`, m, in its frame.
    samples : the points, less `shift` (3,) m.
    noise : m, one sigma of the points, or what each states where that is larger.

    Notes
    -----
    The rms of nine points without the worst: a stray one says nothing of the mesh. Where it exceeds what noise does in
    one of a thousand, the scatter of the points about the mesh, less their noise, is the vertex's misfit. Points beyond
    free edges are left out; where fewer than six are over the mesh nothing is said.
    """
    off = np.abs(surface_to_points(surface, cloud.points, cloud.normals))
    own = np.full(len(off), noise) if cloud.sigma is None else np.fmax(cloud.sigma, noise)
    _, index = samples.query(surface.vertices - shift, k=min(N_AROUND, len(off)), workers=2)
    ratio = np.sort(off[index] / own[index], axis=1)  # NaN last
    n_kept = np.isfinite(ratio).sum(axis=1) - 1
    is_kept = np.arange(ratio.shape[1]) < n_kept[:, None]
    rms = np.sqrt(np.sum(np.where(is_kept, ratio, 0.0) ** 2, axis=1) / np.maximum(n_kept, 1))
    excess = np.sqrt(np.maximum(rms**2 - NORMAL**2, 0.0)) * np.median(own[index], axis=1)
    return np.where((rms > BEYOND) & (n_kept >= FEWEST - 1), excess, 0.0)
