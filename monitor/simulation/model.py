"""Scenes that can change: a model of named parts, the changes of it, and the scene and the truth that follow.

A `Model` is what a scene function makes before anything is contoured: parts, each a field with a box and a cell size
of its own (or exact triangles, for steps and slabs). `change_model` applies named changes, `build_scene` makes meshes
and truth, `measure_changes` tells how large each change truly is. A later epoch is the same model with changes.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from monitor.boxes import corners_of
from monitor.simulation.changes import Edit
from monitor.simulation.manifold import split_touching_sheets
from monitor.simulation.mesh_truth import truth_of_bodies
from monitor.simulation.scenes import Body, Scene
from monitor.simulation.shapes import box as box_field
from monitor.simulation.solid import Field, contour, gradient, principal_curvatures, project
from projects.errors import ParameterError
from projects.model import Floats, Ints, Surface
from projects.transforms import apply, invert

STILL = np.eye(4)


@dataclass(frozen=True)
class Wear:
    """A shallow change along the normal, and the field that it was made to."""

    before: Field
    edit: Edit

    def move(self, vertices: Floats) -> Floats:
        """Return vertices (n, 3) [m] of the field before, moved along its normals onto the field after."""
        depth = np.zeros(len(vertices)) if self.edit.tool is None else self.edit.tool(vertices.T)
        some = np.flatnonzero(depth)
        normals = gradient(self.before, vertices[some])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        moved = vertices.copy()
        moved[some] -= depth[some, None] * normals
        return moved


@dataclass(frozen=True)
class ModelPart:
    """A named rigid part of a model.

    Attributes
    ----------
    name : by which a change means this part.
    field : (3, n) m -> (n,) m, negative inside, in the part's own frame.
    box : (2, 3) m, holds the part, own frame.
    cell : m, edge of its triangles.
    reflectance, gloss : of its body, see `scenes.Body`.
    mesh : exact triangles of a polyhedron (its field an exact distance), own frame; None: the field is contoured.
        A change of the shape drops it.
    mesher : makes the triangles of the part's field, as it is or changed; None: it is contoured.
    T_model_part : (4, 4), where the part stands.
    worn : shallow changes along the normal, already in `field`, in the part's own frame. They move the triangles of
        the field before the first of them and make no new ones, so that what they take is even between vertices too.
    """

    name: str
    field: Field
    box: Floats
    cell: float
    reflectance: float = 0.6
    gloss: float = 0.0
    mesh: Surface | None = None
    mesher: Callable[[Field], Surface] | None = None
    T_model_part: Floats = dataclasses.field(default_factory=lambda: STILL)
    worn: tuple[Wear, ...] = ()

    def bounds(self) -> Floats:
        """Return the box (2, 3) [m] that holds the part where it stands."""
        return _moved_box(self.box, self.T_model_part)

    def field_in_model(self) -> Field:
        """Return the part's field in the model's coordinates."""
        return self.field if self.T_model_part is STILL else _moved_field(self.field, self.T_model_part)

    def body(self) -> Body:
        """Return the part as triangles where it stands."""
        if self.mesh is None:
            field = self.worn[0].before if self.worn else self.field
            vertices, faces = _mesh_once(field, self.mesher, tuple(map(tuple, np.asarray(self.box))), self.cell)
            for wear in self.worn:
                vertices = wear.move(vertices)
        else:
            vertices, faces = self.mesh.vertices, self.mesh.faces
        moved = vertices if self.T_model_part is STILL else apply(self.T_model_part, vertices)
        return Body(self.name, moved, faces, self.reflectance, self.gloss)


@dataclass(frozen=True)
class Model:
    """What is monitored, as named parts, and what stands around it (`surroundings`: floor, walls; no truth)."""

    name: str
    parts: tuple[ModelPart, ...]
    surroundings: tuple[Body, ...] = ()

    def __post_init__(self) -> None:
        names = [part.name for part in self.parts]
        if len(set(names)) < len(names):
            raise ParameterError(f"{self.name}: two parts are called {max(names, key=names.count)}; give each a name")

    def part(self, name: str) -> ModelPart:
        """Return the part of this name."""
        for part in self.parts:
            if part.name == name:
                return part
        raise ParameterError(
            f"{self.name} has no part {name!r}; its parts are {', '.join(part.name for part in self.parts)}"
        )

    def bounds(self) -> Floats:
        """Return the box (2, 3) [m] that holds all parts."""
        boxes = np.stack([part.bounds() for part in self.parts])
        return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])

    def field(self) -> Field:
        """Return the field of all parts together; far from a part its box bounds it."""
        parts = [(part.field_in_model(), part.bounds()) for part in self.parts]

        def value(p: Floats) -> Floats:
            """Return the field (n,) at p (3, n); a part far from all points only bounds it from below."""
            low, high = p.min(axis=1), p.max(axis=1)
            found = np.full(p.shape[1], np.inf)
            for field, box in parts:
                gap = float(np.linalg.norm(np.maximum(np.maximum(box[0] - high, low - box[1]), 0.0)))
                found = np.minimum(found, gap if gap > 1e-3 else field(p))
            return found

        return value


def box_part(name: str, low: ArrayLike, high: ArrayLike, *, cell: float, reflectance: float = 0.6) -> ModelPart:
    """Return a part that is a box between two corners [m], with exact triangles until it is changed."""
    from monitor.simulation.scenes import make_box

    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    field = box_field(0.5 * (low + high), 0.5 * (high - low))
    return ModelPart(name, field, np.stack([low, high]), cell, reflectance, mesh=make_box(name, low, high).surface())


def change_model(model: Model, changes: Sequence[Edit]) -> Model:
    """Return the model after changes, applied in their order, each in the coordinates that hold when it comes."""
    for edit in changes:
        concerned = list_concerned_parts(model, edit)
        parts = tuple(_change_part(part, edit) if part.name in concerned else part for part in model.parts)
        model = dataclasses.replace(model, parts=parts)
    return model


def build_scene(model: Model, changes: Sequence[Edit] = ()) -> Scene:
    """Return the scene of a model after changes: a body for each part, the surroundings, and the truth of the parts.

    The truth is that of the parts' triangles, which are what is scanned: where nothing changed, two epochs have the
    same triangles and differ by nothing. The curvature is that of the field.
    """
    model = change_model(model, changes)
    bodies = tuple(part.body() for part in model.parts)
    truth = truth_of_bodies(bodies, [_curvature_of(part) for part in model.parts])
    return Scene(model.name, bodies + model.surroundings, truth)


def _curvature_of(part: ModelPart) -> Callable[[Floats], Floats] | None:
    """Return the curvature of the part's field at points near it; None for a part that is its triangles."""
    field = part.field_in_model()
    if part.mesh is not None:
        return None
    return lambda points: principal_curvatures(field, project(field, points, n_steps=2))


def list_concerned_parts(model: Model, edit: Edit) -> list[str]:
    """Return the names of the parts that a change is made to."""
    if edit.part is not None:
        return [model.part(edit.part).name]
    if edit.kind == "moved":
        return [part.name for part in model.parts]
    boxes = {part.name: part.bounds() for part in model.parts}
    reached = [n for n, box in boxes.items() if (box[0] <= edit.box[1]).all() and (box[1] >= edit.box[0]).all()]
    if not reached or (edit.kind == "added" and len(reached) > 1):
        raise ParameterError(
            f"{edit.name}: its box reaches {len(reached)} parts ({', '.join(reached[:4])}); name the part that changes"
        )
    return reached


def _change_part(part: ModelPart, edit: Edit) -> ModelPart:
    """Return a part after an edit: moved, or its field changed, its box as large as what it may hold now."""
    if edit.T_after_before is not None:
        return dataclasses.replace(part, T_model_part=edit.T_after_before @ part.T_model_part)
    edit, held = _edit_in_part(edit, part.T_model_part), part.box
    changed = only_near(edit, part.field)
    if edit.kind == "added":
        held = np.stack([np.minimum(held[0], edit.box[0]), np.maximum(held[1], edit.box[1])])
    worn: tuple[Wear, ...] = ()
    if edit.kind == "offset":
        highest, deepest = _reach(edit, held)
        if part.mesh is None and max(highest, deepest) <= 0.5 * part.cell:
            worn = (*part.worn, Wear(part.field, edit))
        else:
            held = held + highest * np.array([[-1.0], [1.0]])
    return dataclasses.replace(part, field=changed, box=held, mesh=None, worn=worn)


def _edit_in_part(edit: Edit, T_model_part: Floats) -> Edit:
    """Return a change of shape in the part's own frame."""
    if T_model_part is STILL or edit.tool is None:
        return edit
    inverse = invert(T_model_part)
    box = _moved_box(edit.box, inverse) if np.isfinite(edit.box).all() else edit.box
    return dataclasses.replace(edit, tool=_moved_field(edit.tool, inverse), box=box)


def _reach(edit: Edit, held: Floats) -> tuple[float, float]:
    """Return by how much [m] a change along the normal builds up, and by how much it wears, inside the box `held`."""
    low, high = np.maximum(edit.box[0], held[0]), np.minimum(edit.box[1], held[1])
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 17).T, indexing="ij")).reshape(3, -1)
    depth = np.zeros(1) if edit.tool is None else edit.tool(grid)
    return max(0.0, -float(depth.min())), max(0.0, float(depth.max()))


def _moved_box(box: Floats, T: Floats) -> Floats:
    """Return the box (2, 3) that holds a box after a motion."""
    if T is STILL:
        return box
    corners = apply(T, corners_of(np.asarray(box, dtype=float)))
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def only_near(edit: Edit, field: Field) -> Field:
    """Return the edited field, the edit asked only about points in its box."""
    changed = edit.apply(field)

    def value(p: Floats) -> Floats:
        """Return the changed field (n,), that of before where all points lie outside of the edit's box."""
        low, high = p.min(axis=1), p.max(axis=1)
        apart = (low > edit.box[1]).any() or (high < edit.box[0]).any()
        return field(p) if apart else changed(p)

    return value


def _moved_field(field: Field, T_model_part: Floats) -> Field:
    """Return the field of a part in the frame of the model."""
    inverse = invert(T_model_part)
    return lambda p: field(inverse[:3, :3] @ p + inverse[:3, 3:])


@functools.lru_cache(maxsize=512)
def _mesh_once(
    field: Field, mesher: Callable[[Field], Surface] | None, box: tuple[tuple[float, ...], ...], cell: float
) -> tuple[Floats, Ints]:
    """Make a part's triangles; parts that do not change between epochs are made once and have the same triangles."""
    if mesher is None:
        return split_touching_sheets(*contour(field, np.array(box), cell=cell))
    made = mesher(field)
    return made.vertices, made.faces
