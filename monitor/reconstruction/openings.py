"""Openings that a surface spans though what lies behind them was seen through them: the mouth of a crack, of a niche.

In: a settled surface and the samples. Out: the surface without what hangs in the air there. A gap in the samples is
closed where it is narrow, as nobody knows better; where samples lie behind it that look the same way, the scanner saw
them through it, and there is nothing to close. Behind what is solid the first samples met look the other way.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from monitor.reconstruction.cell_size import Sampling
from monitor.reconstruction.gathering import GATE_SIGMAS
from monitor.reconstruction.mesh import compact, keep_faces, piece_areas, untie
from monitor.reconstruction.moments import Level
from monitor.reconstruction.nearness import has_near
from monitor.reconstruction.settling import Settled, all_corners
from projects.model import Bools, Floats

GAP = 1.5  # spacings of the points there: farther from all samples than this a vertex spans a gap (0.1 % do by chance)
AROUND = 8  # samples that tell their spacing there
BESIDE = 1.0  # spacings from the way behind a vertex, within which samples that look the same way lie on it
AGAINST = 2.0  # and those that look the other way: the back of what is solid, sampled more sparsely or not
DEEPEST = 64  # spacings behind a vertex that are looked into
COS_ALIKE = 0.7  # within 45 degrees


def leave_openings(settled: Settled, samples: Level, tree: cKDTree, sampling: Sampling, crumb: float,
                   counts: dict[str, int]) -> Settled:  # fmt: skip
    """Return what was settled without faces that span an opening seen through, nor pieces that are left smaller than a
    disc of `crumb` [m]; all of it where nothing else is left. `tree` is that of the samples."""
    projection = settled.projection
    spans = span_openings(projection.vertices, projection.normals, samples, tree, sampling)
    counts["faces_over_openings"] = 0
    if not spans.any():
        return settled
    faces = untie(keep_faces(settled.faces, all_corners(~spans, settled.faces)))
    faces = keep_faces(faces, piece_areas(projection.vertices, faces) >= np.pi * crumb**2)
    if not len(faces):
        return settled
    counts["faces_over_openings"] = len(settled.faces) - len(faces)
    used, faces = compact(len(projection.vertices), faces)
    return Settled(projection.take(used), faces, settled.beside[used], settled.is_crest[used])


def span_openings(vertices: Floats, normals: Floats, samples: Level, tree: cKDTree, sampling: Sampling) -> Bools:
    """Return which vertices (n, 3) m lie in a gap of the samples with samples behind it that look the same way, deeper
    than those of their own sheet scatter."""
    spacing, noise = sampling.spacing, GATE_SIGMAS * sampling.noise
    out = np.zeros(len(vertices), dtype=np.bool_)
    which = np.flatnonzero(~has_near(samples, vertices, normals, float(np.hypot(GAP * spacing, noise)), 0.0))
    which = which[_lie_in_gaps(vertices[which], tree)]
    for step in range(DEEPEST):
        if not len(which):
            break
        places = vertices[which] - ((BESIDE + step) * spacing + noise) * normals[which]
        alike = has_near(samples, places, normals[which], BESIDE * spacing, COS_ALIKE)
        against = has_near(samples, places, -normals[which], AGAINST * spacing, 0.0)
        out[which[alike & ~against]] = True
        which = which[~alike & ~against]
    return out


def _lie_in_gaps(places: Floats, tree: cKDTree) -> Bools:
    """Return which places (n, 3) m lie farther from the nearest sample than `GAP` spacings of the samples there."""
    if not len(places):
        return np.zeros(0, dtype=np.bool_)
    distance, nearest = tree.query(places, workers=2)
    k = min(AROUND, tree.n - 1)
    reach = tree.query(tree.data[nearest], k=[k + 1], workers=2)[0][:, 0]
    out: Bools = distance > GAP * reach * np.sqrt(np.pi / k)
    return out
