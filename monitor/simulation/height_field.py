"""Bodies given by heights over a plane: a relief, a wall with stucco, a reef. Heights in, closed triangles out.

The grid may be finer where there is ornament. A body's field is negative inside, so the named changes apply to it;
triangles of a changed field have the same grid, each node moved along the plane's normal to where the field is zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from monitor.simulation.scenes import close_slab, rim_of_grid
from monitor.simulation.solid import Field, evaluate
from projects.model import Floats, Surface
from projects.transforms import apply, invert

SEARCH_STEP = 0.002  # m, with which a changed field's outermost surface is looked for; thinner fins are overlooked


@dataclass(frozen=True, eq=False)
class HeightField:
    """A slab whose front is h(u, v) over a plane, its sides straight, its back flat.

    Attributes
    ----------
    height : (n,), (n,) m -> (n,) m, of the front over the plane.
    u, v : (n_u,), (n_v,) m, ascending, the grid lines; the slab ends with them.
    back : m, height of the back, negative.
    top : m, no height is above it, nor after a change.
    T_scene_plane : (4, 4), its columns the directions of u, v and the outward normal, and the plane's origin.
    """

    height: Callable[[Floats, Floats], Floats]
    u: Floats
    v: Floats
    back: float
    top: float
    T_scene_plane: Floats

    def bounds(self) -> Floats:
        """Return the box (2, 3) [m] that holds the slab."""
        ends = [(self.u[0], self.u[-1]), (self.v[0], self.v[-1]), (self.back, self.top)]
        corners = apply(self.T_scene_plane, np.stack([a.ravel() for a in np.meshgrid(*ends)], axis=1))
        return np.stack([corners.min(axis=0), corners.max(axis=0)])

    def field(self, p: Floats) -> Floats:
        """Return the field at p (3, n): height above the front (not a distance where it is steep), or outside it."""
        inverse = invert(self.T_scene_plane)
        u, v, h = inverse[:3, :3] @ p + inverse[:3, 3:]
        aside = np.maximum(np.maximum(self.u[0] - u, u - self.u[-1]), np.maximum(self.v[0] - v, v - self.v[-1]))
        within = self.height(np.clip(u, self.u[0], self.u[-1]), np.clip(v, self.v[0], self.v[-1]))
        return np.maximum(np.maximum(h - within, self.back - h), aside)

    def triangulate(self, field: Field) -> Surface:
        """Return the closed triangles of a field: this slab's own, or one that came of it by changes."""
        u, v = (a.ravel() for a in np.meshgrid(self.u, self.v, indexing="ij"))
        front = np.column_stack([u, v, self.height(u, v)])
        # Nodes on the rim stay: the sides have no height of their own.
        shape = len(self.u), len(self.v)
        if field != self.field:
            changed = np.abs(evaluate(field, apply(self.T_scene_plane, front))) > 1e-9
            changed[rim_of_grid(*shape)] = False
            front[changed, 2] = self._find_heights(field, front[changed])
        middle = np.array([front[:, 0].mean(), front[:, 1].mean(), self.back])
        vertices, faces = close_slab(front, shape, middle)
        return Surface(apply(self.T_scene_plane, vertices), faces)

    def _find_heights(self, field: Field, nodes: Floats) -> Floats:
        """Return the greatest height (n,) [m] at which a field is zero over nodes (n, 3) in the plane's frame."""
        inside_at = np.full(len(nodes), self.back)
        open_ = np.arange(len(nodes))
        at = self.top
        while len(open_) and at > self.back:
            inside = self._at(field, nodes[open_], np.full(len(open_), at)) < 0.0
            inside_at[open_[inside]] = at
            open_, at = open_[~inside], at - SEARCH_STEP
        low, high = inside_at, np.minimum(inside_at + SEARCH_STEP, self.top)
        for _ in range(24):
            middle = 0.5 * (low + high)
            inside = self._at(field, nodes, middle) < 0.0
            low, high = np.where(inside, middle, low), np.where(inside, high, middle)
        return 0.5 * (low + high)

    def _at(self, field: Field, nodes: Floats, heights: Floats) -> Floats:
        """Return the field (n,) of the scene at `heights` (n,) [m] over the nodes."""
        return evaluate(field, apply(self.T_scene_plane, np.column_stack([nodes[:, :2], heights])))


def refine_axis(
    low: float, high: float, *, coarse: float, fine: float, within: Sequence[tuple[float, float]]
) -> Floats:
    """Return grid lines (n,) [m] from `low` to `high`, `coarse` apart, and `fine` apart in the intervals `within`."""
    ends = sorted({low, high, *(float(np.clip(e, low, high)) for interval in within for e in interval)})
    pieces = []
    for a, b in pairwise(ends):
        is_fine = any(start < 0.5 * (a + b) < end for start, end in within)
        n = max(1, int(np.ceil((b - a) / (fine if is_fine else coarse) - 1e-9)))
        pieces.append(np.linspace(a, b, n, endpoint=False))
    return np.concatenate([*pieces, [high]])
