"""Vertices held back where bringing them onto the points would fold the mesh or push it through itself.

In: a raw mesh without intersections, and where its vertices would go. Out: how far each may go on its way. A vertex of
a face that is turned over or cut goes half as far as before, until no face is; at the raw mesh itself none is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import jit

from monitor.reconstruction.faces import area_vector
from monitor.reconstruction.intersections import find_intersections
from monitor.reconstruction.mesh import any_corner, untie
from monitor.threads import run_tasks
from projects.model import Bools, Floats, Ints

MOST_ROUNDS = 12
FEWEST_HALVES = 1.0 / 64.0  # of the way; less is none


class Untangled(NamedTuple):
    """Vertices (n, 3), the part of the way (n,) that each went: 1 where nothing was in it; and the faces (m,) that may
    meet others: those that did on the way, or moved last."""

    vertices: Floats
    share: Floats
    suspects: Bools


def untangle(raw: Floats, wanted: Floats, faces: Ints) -> Untangled:
    """Move vertices from `raw` towards `wanted` (n, 3) as far as no face turns over and no two faces meet.

    The faces around a vertex that is held back go along after two rounds, so that no spike is left. Faces that meet in
    the raw mesh may still do so after the last round: see `drop_intersecting`.
    """
    share, ever_bad = np.ones(len(raw)), np.zeros(len(faces), bool)
    vertices, suspects = wanted, np.ones(len(faces), bool)
    for n_round in range(MOST_ROUNDS):
        bad = _tangled(raw, vertices, faces, suspects)
        ever_bad |= bad
        if n_round >= 2:
            bad = _touching(faces, bad, len(raw))
        held: Bools = _vertices_of(faces[bad], len(raw)) & (share > 0.0)
        if not held.any():
            return Untangled(vertices, share, ever_bad)
        share[held] *= 0.5
        share[share < FEWEST_HALVES] = 0.0
        vertices = raw + share[:, None] * (wanted - raw)
        suspects = any_corner(held, faces)
    return Untangled(vertices, share, ever_bad | suspects)


def drop_intersecting(vertices: Floats, faces: Ints, suspects: Bools | None = None) -> Ints:
    """Return the faces without those that still meet others, and without the bow ties that this leaves.

    Of `suspects` (m,), where given, each pair that meets holds one at least.
    """
    met = np.unique(find_intersections(vertices, faces, suspects))
    if not len(met):
        return faces
    return untie(np.delete(faces, met, axis=0))


def _tangled(raw: Floats, vertices: Floats, faces: Ints, suspects: Bools) -> Bools:
    """Return which faces (m,) are turned over against the raw mesh or meet another; one of each pair is suspect."""
    out = np.zeros(len(faces), bool)
    run_tasks(_mark_turned, len(faces), raw, vertices, faces, suspects, out)
    out[find_intersections(vertices, faces, suspects).ravel()] = True
    return out


@jit(nopython=True, cache=True, nogil=True)
def _mark_turned(
    first: int, last: int, raw: Floats, vertices: Floats, faces: Ints, suspects: Bools, out: Bools
) -> None:
    """Mark those of the suspects `first` to `last` that look the other way than before or have no area, for threads."""
    for f in range(first, last):
        if suspects[f]:
            i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
            a, b = area_vector(raw, i, j, k), area_vector(vertices, i, j, k)
            out[f] = not a[0] * b[0] + a[1] * b[1] + a[2] * b[2] > 0.0


def _touching(faces: Ints, bad: Bools, n_vertices: int) -> Bools:
    """Return the bad faces and those that share a vertex with one."""
    return any_corner(_vertices_of(faces[bad], n_vertices), faces)


def _vertices_of(faces: Ints, n_vertices: int) -> Bools:
    """Return which vertices (n,) these faces have."""
    out = np.zeros(n_vertices, bool)
    out[faces] = True
    return out
