"""How far a surface bows out of its own faces, between their corners.

The vertices of a reconstructed surface lie on fits to the points, and their normals are those of the fits: between the
corners of a face the surface is not flat. On a round body faces cut inside, so that each of two epochs seems to lie
outside of the other: by an eighth of a millimetre from side to side where edges of 5 mm cover a body of 50 mm radius.
"""

from __future__ import annotations

import numpy as np
from numba import jit

from monitor.threads import run_tasks
from projects.model import Floats, Ints, Surface

LEAST_COSINE = 0.5  # between the normals of two corners; farther apart there is an edge, and no bow


def bow_at(surface: Surface, faces: Ints, weights: Floats) -> Floats:
    """Return how far (n,) [m] a surface lies outside of its faces at places on them, negative inside.

    Parameters
    ----------
    surface : where it has no fitted normals (a finished mesh states no noise) its faces are the surface: 0.
    faces : (n,) the face of each place, -1 without one: 0.
    weights : (n, 3) those of its corners.

    Notes
    -----
    The quadratic patch through three corners p_i whose normals are n_i lies
    1/2 sum over the edges of w_i w_j (p_j - p_i)'(n_j - n_i) outside of the face where the corners weigh w_i: along an
    edge of length h on a sphere of radius R, w_i = 1/2, its sagitta h^2 / (8 R). The edges' terms are the middle
    control points of PN triangles (Vlachos, Peters, Boyd and Mitchell 2001) along the normal, taken to second order.
    """
    out = np.zeros(len(faces))
    if surface.normals is not None and surface.sigma is not None:
        is_crest = np.zeros(len(surface.vertices), bool) if surface.is_crest is None else surface.is_crest
        mesh = (surface.vertices, surface.normals, is_crest, np.asarray(surface.faces))
        run_tasks(_bow, len(out), *mesh, faces, weights, out)
    return out


@jit(nopython=True, cache=True, nogil=True)
def _bow(first, last, vertices, normals, is_crest, faces, at, weights, out):  # type: ignore[no-untyped-def]
    """Write the bow of the face `at` (n,) under the `weights` (n, 3) of its corners; 0 where corners have no normal.

    The normal of a vertex on a crest is of neither side: edges to it are straight.
    """
    for i in range(first, last):
        if at[i] < 0:
            continue
        bow = 0.0
        for k in range(3):
            p, q = faces[at[i], k], faces[at[i], (k + 1) % 3]
            if is_crest[p] or is_crest[q]:
                continue
            cosine, bend = 0.0, 0.0
            for a in range(3):
                cosine += normals[p, a] * normals[q, a]
                bend += (vertices[q, a] - vertices[p, a]) * (normals[q, a] - normals[p, a])
            if not cosine >= LEAST_COSINE:
                bow = 0.0
                break
            bow += 0.5 * weights[i, k] * weights[i, (k + 1) % 3] * bend
        out[i] = bow
