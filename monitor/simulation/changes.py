"""Named changes of a solid with exact truth: a lost piece, a filling, an eroded patch.

A change edits a field, so the surface before and after are both known exactly; `measure_change` integrates what was
lost or gained.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monitor.simulation.shapes import ellipsoid, smoothstep
from monitor.simulation.solid import Field, contour, evaluate, project
from projects.model import Floats


@dataclass(frozen=True)
class Edit:
    """A change of a solid: `apply` makes the new field of the old one; nothing changes outside of `box` (2, 3) [m]."""

    name: str
    kind: str  # lost, added
    box: Floats
    tool: Field
    depth: float = 0.0

    def apply(self, field: Field) -> Field:
        """Return the field after the change."""
        if self.kind == "eroded":
            return lambda p: field(p) + self.tool(p)
        if self.kind == "lost":
            return lambda p: np.maximum(field(p), -self.tool(p))
        return lambda p: np.minimum(field(p), self.tool(p))


@dataclass(frozen=True)
class TrueChange:
    """What truly changed between two epochs in one place, in the reference epoch's coordinates.

    Attributes
    ----------
    kind : lost or added.
    centre : (3,) m, area-weighted centroid of the reference surface where it changed.
    area : m2 of that surface, where it changed by more than `threshold`.
    volume : m3, positive where material was gained.
    extreme : m, the largest distance from a point of the changed surface to the other epoch's surface, with sign.
    box : (2, 3) m that holds the change.
    """

    name: str
    kind: str
    centre: Floats
    area: float
    volume: float
    extreme: float
    threshold: float
    box: Floats


def break_off(name: str, point: Floats, direction: Floats, *, box: Floats) -> Edit:
    """Return the loss of all that lies beyond an uneven fracture through `point`, facing `direction`, inside `box`."""
    n = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    side = np.cross(n, [0.3, 0.8, 0.5])
    side /= np.linalg.norm(side)
    other = np.cross(n, side)
    middle, half = 0.5 * (box[0] + box[1]), 0.5 * (box[1] - box[0])

    def beyond(p: Floats) -> Floats:
        q = p - np.asarray(point, dtype=float)[:, None]
        u, v = side @ q, other @ q
        rough = 0.0012 * np.sin(u / 0.0042 + 1.3) * np.sin(v / 0.0051) + 0.0008 * np.sin((u + v) / 0.0027)
        held = (np.abs(p - middle[:, None]) - half[:, None]).max(axis=0)
        return np.maximum(-(n @ q) + rough, held)

    return Edit(name, "lost", np.asarray(box, dtype=float), beyond)


def hollow_out(name: str, centre: Floats, radii: Floats) -> Edit:
    """Return the loss of an uneven hollow: an ellipsoid about `centre` that reaches into the solid."""
    body = ellipsoid(centre, radii)

    def tool(p: Floats) -> Floats:
        q = p - np.asarray(centre, dtype=float)[:, None]
        uneven = 0.0009 * np.sin(q[0] / 0.006 + q[2] / 0.008) * np.sin(q[1] / 0.007 + 0.5) + 0.0006 * np.sin(
            q[2] / 0.004
        )
        return body(p) + uneven

    margin = np.asarray(radii, dtype=float) + 0.003
    return Edit(name, "lost", np.stack([centre - margin, centre + margin]), tool)


def erode(name: str, centre: Floats, *, radius: float, depth: float) -> Edit:
    """Return the wear of a round patch: `depth` [m] in its middle, running out smoothly at `radius` [m]."""

    def worn(p: Floats) -> Floats:
        r = np.sqrt(((p - np.asarray(centre, dtype=float)[:, None]) ** 2).sum(axis=0))
        return depth * (1.0 - smoothstep(r, 0.45 * radius, radius))

    box = np.stack([np.asarray(centre) - radius, np.asarray(centre) + radius])
    return Edit(name, "eroded", box, worn, depth)


def measure_change(
    edit_name: str, before: Field, after: Field, box: Floats, *, threshold: float = 0.0005, n_nodes: int = 200_000
) -> TrueChange:
    """Return what changed between two fields inside a box, integrated on a grid of about `n_nodes`."""
    cell = float(np.prod(box[1] - box[0]) / n_nodes) ** (1.0 / 3.0)
    axes = [np.arange(low + 0.5 * cell, high, cell) for low, high in zip(box[0], box[1], strict=True)]
    nodes = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    filled = [np.clip(0.5 - evaluate(f, nodes) / cell, 0.0, 1.0) for f in (before, after)]
    volume = float((filled[1] - filled[0]).sum() * cell**3)
    vertices, areas = _sample_surface(before, box, cell)
    reached = np.zeros(len(vertices))
    moved = np.abs(evaluate(after, vertices)) > 1e-5
    reached[moved] = _distance_to(after, vertices[moved], _sample_surface(after, box, cell)[0])
    changed = reached > threshold
    weight = areas * changed
    sign = 1.0 if volume > 0.0 else -1.0
    return TrueChange(
        edit_name, "added" if volume > 0.0 else "lost", (weight[:, None] * vertices).sum(axis=0) / weight.sum(),
        float(weight.sum()), volume, sign * float(reached[changed].max()), threshold, np.asarray(box),
    )  # fmt: skip


def _sample_surface(field: Field, box: Floats, cell: float) -> tuple[Floats, Floats]:
    """Return points (n, 3) of the field's surface inside the box and the area (n,) that each stands for."""
    middle, half = 0.5 * (box[0] + box[1])[:, None], 0.5 * (box[1] - box[0])[:, None]

    def clipped(p: Floats) -> Floats:
        return np.maximum(field(p), (np.abs(p - middle) - half).max(axis=0))

    vertices, faces = contour(clipped, box, cell=cell)
    corners = vertices[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    share = np.bincount(faces.ravel(), np.repeat(area / 3.0, 3), minlength=len(vertices))
    inner = (np.abs(vertices.T - middle) < half - 0.5 * cell).all(axis=0)
    return vertices[inner], share[inner]


def _distance_to(field: Field, points: Floats, samples: Floats) -> Floats:
    """Return the distance of points to the field's surface, given dense samples of it."""
    from scipy.spatial import cKDTree

    nearest = samples[cKDTree(samples).query(points)[1]]
    return np.linalg.norm(points - close_in(field, points, nearest), axis=1)


def close_in(field: Field, points: Floats, start: Floats, *, n_steps: int = 6) -> Floats:
    """Return the points of the field's zero nearest to `points` (n, 3), from starts on it that are nearly so.

    Slides along the tangent plane and falls back onto the surface; a step that leads further away is not taken.
    """
    best = np.array(start, dtype=float)
    gap2 = ((points - best) ** 2).sum(axis=1)
    for _ in range(n_steps):
        step = np.array([1e-5, 0.0, 0.0])
        g = np.column_stack(
            [evaluate(field, best + np.roll(step, a)) - evaluate(field, best - np.roll(step, a)) for a in range(3)]
        )
        n = g / np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 1e-12)
        off = points - best
        tried = project(field, best + 0.7 * (off - (off * n).sum(axis=1, keepdims=True) * n), n_steps=2)
        tried_gap2 = ((points - tried) ** 2).sum(axis=1)
        on_surface = np.abs(evaluate(field, tried)) < 1e-5
        better = on_surface & (tried_gap2 < gap2)
        best[better], gap2[better] = tried[better], tried_gap2[better]
    return best
