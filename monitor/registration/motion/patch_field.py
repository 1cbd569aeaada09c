"""How whole patches of a surface err together under a field of errors, by the parts of each.

In: points in patches. Out: the mean correlation of a point of one patch with one of another, and sums over all pairs of
points. A field that is shared over less than a patch differs within it, and so does what a motion does to the points
there: with each patch as one place, the turn of a nearly round body would be stated too sure (the change of support of
Journel & Huijbregts 1978).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from monitor.registration.motion.correlation import correlate
from monitor.registration.motion.patches import PatchGrid
from projects.model import Floats, Ints


@dataclass(frozen=True)
class PatchField:
    """Patches (p) and their parts (f), in order of their patches: the `part` (n,) of each point, the `patch` (f,) of
    each part, the numbers of points `counts` (p,) and `part_counts` (f,), and the `distances` (f, f) [m] between the
    middles of parts, in single precision."""

    part: Ints
    patch: Ints
    counts: Floats
    part_counts: Floats
    distances: Floats

    @property
    def member(self) -> Ints:
        """The patch (n,) of each point."""
        return self.patch[self.part]

    def correlate(self, reach: float, rows: Floats) -> tuple[Floats, Floats]:
        """Return the mean correlation (p, p) of two points, one of each patch, in a field of this range [m], and the
        sum (k, k) of J_i J_j' R(d_ij) over all pairs of points, `rows` (f, k) being the sums of J over each part.

        Far parts are not spared: with the middles of patches in their place R would no longer be a correlation, and
        smooth fields would be taken for longer ones (sigma 10 % too large).
        """
        R = correlate(self.distances, reach)
        counts = self.part_counts.astype(R.dtype)
        first = np.searchsorted(self.patch, np.arange(len(self.counts)))
        half = np.add.reduceat(R * counts[:, None], first, axis=0)
        between = np.add.reduceat(half * counts, first, axis=1)
        scale = float(np.abs(rows).max()) or 1.0  # within the reach of single precision
        scaled = (rows / scale).astype(R.dtype)
        sums = scale**2 * (scaled.T @ (R @ scaled)).astype(float)
        return between.astype(float) / np.outer(self.counts, self.counts), sums


def lay_field(points: Floats, normals: Floats, grid: PatchGrid) -> PatchField:
    """Return the patches of a grid that hold points (n, 3) [m], each cut in two along x, y and z."""
    whole = grid.numbers(points, normals)
    halves = grid.halved().numbers(points, normals)
    _, first, part = np.unique(whole * (int(halves.max()) + 1) + halves, return_index=True, return_inverse=True)
    patch = np.unique(whole[first], return_inverse=True)[1]
    part_counts = np.bincount(part).astype(float)
    counts = np.bincount(patch, part_counts).astype(float)
    places = sum_by(part, points) / part_counts[:, None]
    return PatchField(part, patch, counts, part_counts, cdist(places, places).astype(np.float32))


def sum_by(member: Ints, values: Floats) -> Floats:
    """Return the sums (p, k) of the rows of `values` (n, k) over equal `member` (n,)."""
    return np.stack([np.bincount(member, column) for column in values.T], axis=1)
