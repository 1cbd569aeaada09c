"""How large a change truly is: its area, volume, extreme and place from the exact surfaces before and after.

Local changes of shape are integrated from the two fields inside the change's box; a part that moved or was cleaned
all over is measured on its triangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from monitor.simulation.changes import Edit
from monitor.simulation.model import Model, build_scene, change_model, list_concerned_parts
from monitor.simulation.scenes import Scene, Truth
from monitor.simulation.solid import Field, contour, evaluate
from monitor.simulation.truth import close_in
from projects.errors import ParameterError
from projects.model import Floats
from projects.triangles import vertex_areas

N_NODES = 200_000  # of the grid that a change is integrated on
THRESHOLD = 0.0005  # m, above which a surface counts as changed; half the extreme where the change is below a mm
N_SAMPLES = 20_000  # vertices on which a change of whole parts is measured


@dataclass(frozen=True)
class TrueChange:
    """What truly changed between two epochs in one place, in the reference epoch's coordinates.

    Attributes
    ----------
    kind : lost, added or moved.
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


def change_at(points: Floats, after: Truth) -> Floats:
    """Return the true change (n,) [m] at points (n, 3) of the surface before: positive where material was gained."""
    return -after.signed_distance(points)


def measure_changes(model: Model, changes: Sequence[Edit]) -> tuple[TrueChange, ...]:
    """Return how large each change of a model truly is, each against the state that it was made to.

    Motions of the whole are left out: their truth is their matrix. Overlapping changes are told one by one; the
    scenes' truths (`change_at`) hold their sum.
    """
    told = []
    for edit in changes:
        after = change_model(model, [edit])
        if edit.kind == "moved" and edit.part is None:
            pass
        elif edit.kind == "moved" or not np.isfinite(edit.box).all():
            told.append(_measure_parts(edit, model, after))
        else:
            told.append(measure_change(edit.name, model.field(), after.field(), edit.box))
        model = after
    return tuple(told)


def measure_change(
    edit_name: str, before: Field, after: Field, box: Floats, *, threshold: float = THRESHOLD
) -> TrueChange:
    """Return what changed between two fields inside a box, integrated on a grid of about `N_NODES`."""
    cell = float(np.prod(box[1] - box[0]) / N_NODES) ** (1.0 / 3.0)
    axes = [np.arange(low + 0.5 * cell, high, cell) for low, high in zip(box[0], box[1], strict=True)]
    nodes = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
    filled = [np.clip(0.5 - evaluate(f, nodes) / cell, 0.0, 1.0) for f in (before, after)]
    volume = float((filled[1] - filled[0]).sum() * cell**3)
    vertices, areas = _sample_surface(before, box, cell)
    reached = np.zeros(len(vertices))
    moved = np.abs(evaluate(after, vertices)) > 1e-5
    if not moved.any():
        raise ParameterError(f"{edit_name}: nothing changes in its box; place it on the surface")
    reached[moved] = _distance_to(after, vertices[moved], _sample_surface(after, box, cell)[0])
    threshold = min(threshold, 0.5 * float(reached.max()))
    changed = reached > threshold
    weight = areas * changed
    sign = 1.0 if volume > 0.0 else -1.0
    return TrueChange(
        edit_name, "added" if volume > 0.0 else "lost", (weight[:, None] * vertices).sum(axis=0) / weight.sum(),
        float(weight.sum()), volume, sign * float(reached[changed].max()), threshold, np.asarray(box),
    )  # fmt: skip


def _measure_parts(edit: Edit, before: Model, after: Model) -> TrueChange:
    """Return what a change of whole parts comes to, from their triangles and the truth after it."""
    names = list_concerned_parts(before, edit)
    scenes = build_scene(before), build_scene(after)
    parts = [body for body in scenes[0].bodies if body.name in names]
    shares = [vertex_areas(body.vertices, body.faces) for body in parts]
    vertices, areas = np.concatenate([body.vertices for body in parts]), np.concatenate(shares)
    open_ = np.flatnonzero(evaluate(before.field(), vertices) > -1e-5)  # what is buried in a neighbour is no surface
    some = open_[:: max(1, len(open_) // N_SAMPLES)]
    shift = change_at(vertices[some], scenes[1].truth or _no_truth())
    threshold = min(THRESHOLD, 0.5 * float(np.abs(shift).max()))
    weight = areas[some] * (np.abs(shift) > threshold)
    volume = _volume_of(scenes[1], names) - _volume_of(scenes[0], names)
    kind = "moved" if edit.kind == "moved" else ("added" if volume > 0.0 else "lost")
    boxes = np.stack([m.part(name).bounds() for m in (before, after) for name in names])
    return TrueChange(
        edit.name, kind, (weight[:, None] * vertices[some]).sum(axis=0) / weight.sum(),
        float(weight.sum() * areas[open_].sum() / areas[some].sum()), volume,
        float(shift[np.abs(shift).argmax()]), threshold,
        np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)]),
    )  # fmt: skip


def _no_truth() -> Truth:
    """Refuse a scene that was not built from a model."""
    raise ParameterError("the scene has no truth; build it from a model")


def _volume_of(scene: Scene, names: Sequence[str]) -> float:
    """Return the volume [m3] of the bodies of these names, by the divergence theorem."""
    total = 0.0
    for body in scene.bodies:
        if body.name in names:
            a, b, c = ((body.vertices - body.vertices.mean(axis=0))[body.faces[:, i]] for i in range(3))
            total += float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)
    return total


def _sample_surface(field: Field, box: Floats, cell: float) -> tuple[Floats, Floats]:
    """Return points (n, 3) of the field's surface inside the box and the area (n,) that each stands for."""
    middle, half = 0.5 * (box[0] + box[1])[:, None], 0.5 * (box[1] - box[0])[:, None]

    def clipped(p: Floats) -> Floats:
        """Return the field (n,) held within the box."""
        return np.maximum(field(p), (np.abs(p - middle) - half).max(axis=0))

    vertices, faces = contour(clipped, box, cell=cell)
    share = vertex_areas(vertices, faces)
    inner = (np.abs(vertices.T - middle) < half - 0.5 * cell).all(axis=0)
    return vertices[inner], share[inner]


def _distance_to(field: Field, points: Floats, samples: Floats) -> Floats:
    """Return the distance of points to the field's surface, given dense samples of it."""
    nearest = samples[cKDTree(samples).query(points)[1]]
    return np.linalg.norm(points - close_in(field, points, nearest), axis=1)
