"""How steeply the scans of an epoch saw its surface, by the surface's own normals.

In: the surface's vertices with their normals, and of each scan's points the beams and which lie at a rim of what it
saw. Out: classes of incidence. Past a limb, where part of the spot misses, a scan's own normals are 8 to 20 degrees off
and pass for 45 to 80 degrees: the surface, of which other scans and the places around tell, shows 80 and more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from monitor.blocks import blocks
from projects.model import Bools, Floats, Ints

STEPS = np.radians([45.0, 60.0, 70.0, 80.0])  # of incidence, where one class ends and the next begins
STEEP_RIM = 2  # the class from which on rims, past which a spot reaches, are a class of their own, the last but one
N_CLASSES = len(STEPS) + 2
N_POINTS_AROUND = 64  # of all scans, whose incidence counts at a vertex: a fit takes in some tens


@dataclass(frozen=True)
class Views:
    """How the points (k,) of all scans, one after another, were seen: the unit directions to their scanner, `beams`
    (k, 3), NaN where that is not known, and whether each lies at a rim of what its scan saw, `is_rim` (k,); `normals`
    (n, 3) are those of the surface's vertices."""

    beams: Floats
    is_rim: Bools
    normals: Floats

    def classes(self, which: Ints | slice, normals: Floats) -> Ints:
        """Return the class of incidence of some points on a surface with these normals (..., 3), 0 the flattest; where
        it is not known they count as seen from the front."""
        cosine = np.abs(np.einsum("...i,...i->...", self.beams[which], normals))
        steepness = np.digitize(-np.where(np.isfinite(cosine), cosine, 1.0), -np.cos(STEPS))
        steepness[steepness == len(STEPS)] = N_CLASSES - 1
        steepness[self.is_rim[which] & (steepness >= STEEP_RIM) & (steepness < N_CLASSES - 1)] = N_CLASSES - 2
        return steepness


def join_views(beams: Sequence[Floats], is_rim: Sequence[Bools], normals: Floats) -> Views:
    """Return the views of some scans' points."""
    return Views(np.concatenate(beams), np.concatenate(is_rim), normals)


def steepness_of_points(views: Views | None, vertices: Floats, points: Floats) -> Ints:
    """Return the class of incidence (k,) of points (k, 3) on the surface at the vertex next to each; 0 without
    views."""
    out = np.zeros(len(points), dtype=np.int64)
    if views is None:
        return out
    tree = cKDTree(vertices)
    for block in blocks(len(points)):
        out[block] = views.classes(block, views.normals[tree.query(points[block], workers=-1)[1]])
    return out


def expected_at(views: Views | None, vertices: Floats, points: Floats, steepness: Ints, variances: Floats) -> Floats:
    """Return the variance (n,) [m2] of the mean of the points nearest to each vertex, whose errors agree: as steep as
    they lie, `steepness` (k,), or as they look at the vertex, whichever is steeper; `variances` (c,) [m2] are those of
    the classes. A few points past a limb pull a surface by as much as is their share."""
    out = np.empty(len(vertices))
    tree, k = cKDTree(points), min(N_POINTS_AROUND, len(points))
    for block in blocks(len(vertices)):
        near = tree.query(vertices[block], k=k, workers=-1)[1].reshape(-1, k)
        steepest = steepness[near]
        if views is not None:
            steepest = np.maximum(steepest, views.classes(near, views.normals[block, None]))
        out[block] = np.sqrt(variances)[steepest].mean(axis=1) ** 2
    return out
