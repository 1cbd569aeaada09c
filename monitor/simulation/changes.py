"""Named changes of a scene: erosion, a lost piece, an infill, cleaning, a part moved, the whole moved.

A change edits the field of a solid or the place of a part, so the surfaces before and after are both known exactly.
`model.change_model` applies changes to a scene's model and `true_change.measure_changes` says how large each truly is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from monitor.simulation.shapes import ellipsoid, smoothstep
from monitor.simulation.solid import Field
from projects.errors import ParameterError
from projects.model import Floats
from projects.transforms import require_rigid

KINDS = ("offset", "lowered", "lost", "added", "moved")
EVERYWHERE = np.array([[-np.inf] * 3, [np.inf] * 3])


@dataclass(frozen=True)
class Edit:
    """A change of a scene, in the scene's coordinates.

    Attributes
    ----------
    name : what happened, as a restorer would note it.
    kind : "offset" (the surface sinks by `tool` [m] along its normal, rises where that is negative), "lowered" (the
        field rises by `tool`, whatever its slope), "lost" (what the solid `tool` holds is gone), "added" (the solid
        `tool` is joined on) or "moved" (the part is moved by `T_after_before`).
    box : (2, 3) m; nothing changes outside of it. Of no meaning when moved.
    tool : (3, n) m -> (n,) m; None when moved.
    part : the part that is changed; None: every part that reaches into the box.
    T_after_before : (4, 4), how the part is moved.
    """

    name: str
    kind: str
    box: Floats
    tool: Field | None = None
    part: str | None = None
    T_after_before: Floats | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ParameterError(f"{self.name}: kind {self.kind!r}; allowed are {', '.join(KINDS)}")
        if (self.kind == "moved") != (self.T_after_before is not None) or (self.kind == "moved") != (self.tool is None):
            raise ParameterError(f"{self.name}: a moved part has a motion and no tool, any other change a tool only")

    def apply(self, field: Field) -> Field:
        """Return the field after the change, of a field in the scene's coordinates."""
        tool = self.tool
        if tool is None:
            raise ParameterError(f"{self.name}: a motion has no field; apply it to a model by change_model")
        if self.kind == "offset":
            return _offset(field, tool)
        if self.kind == "lowered":
            return lambda p: field(p) + tool(p)
        if self.kind == "lost":
            return lambda p: np.maximum(field(p), -tool(p))
        return lambda p: np.minimum(field(p), tool(p))


def _offset(field: Field, depth: Field) -> Field:
    """Return the field whose zero lies deeper by `depth` [m] along the normal of the old one."""

    def value(p: Floats) -> Floats:
        """Return the field (n,) at p (3, n) moved by the depth, as a true distance where that is near."""
        found, deep = field(p), depth(p)
        # Only near the surface does the distance itself matter; fields here are sloped 0.5 to 2.
        near = (deep != 0.0) & (np.abs(found) < 3.0 * np.abs(deep).max(initial=0.0))
        if near.any():  # a solid asks for a point at least
            found[near] = _distance_along_normal(field, p[:, near])
        return found + deep

    return value


def _distance_along_normal(field: Field, p: Floats) -> Floats:
    """Return the signed distance of points (3, n) near a field's zero to where Newton's method leads them."""
    foot, side, step = p.copy(), np.sign(field(p)), 2e-5
    shifts = step * np.eye(3)[:, :, None]
    for _ in range(2 if p.shape[1] else 0):
        slope = np.stack([field(foot + s) - field(foot - s) for s in shifts]) / (2.0 * step)
        foot -= field(foot) / np.maximum((slope * slope).sum(axis=0), 1e-2) * slope
    return side * np.sqrt(((p - foot) ** 2).sum(axis=0))


def _patch(centre: ArrayLike, radius: float, plateau: float) -> tuple[Field, Floats]:
    """Return a weight of 1 about a centre, to the share `plateau` of `radius`, that falls to 0 at it; and its box."""
    c = np.asarray(centre, dtype=float)

    def weight(p: Floats) -> Floats:
        """Return the weight (n,): 1 on the plateau, 0 beyond the radius."""
        r = np.sqrt(((p - c[:, None]) ** 2).sum(axis=0))
        return 1.0 - smoothstep(r, plateau * radius, radius)

    return weight, np.stack([c - radius, c + radius])


def erode(
    name: str, centre: ArrayLike, *, radius: float, depth: float, plateau: float = 0.45, part: str | None = None
) -> Edit:
    """Return the wear of a round patch: `depth` [m] along the normal, running out smoothly at `radius` [m].

    `plateau` is the share of the radius within which it is worn by the whole depth.
    """
    weight, box = _patch(centre, radius, plateau)
    return Edit(name, "offset", box, lambda p: depth * weight(p), part)


def coat(
    name: str, centre: ArrayLike, *, radius: float, height: float, plateau: float = 0.45, part: str | None = None
) -> Edit:
    """Return a round patch built up by `height` [m] along the normal: plaster, a crust, dirt."""
    weight, box = _patch(centre, radius, plateau)
    return Edit(name, "offset", box, lambda p: -height * weight(p), part)


def clean(name: str, *, depth: float = 0.0003, box: Floats | None = None, part: str | None = None) -> Edit:
    """Return the uniform loss of `depth` [m] along the normal: everywhere, inside a box (2, 3) [m], or of one part."""
    if box is None:
        return Edit(name, "offset", EVERYWHERE, lambda p: np.full(p.shape[1], depth), part)
    low, high = np.asarray(box, dtype=float)[:, :, None]
    held = np.asarray(box, dtype=float)
    return Edit(name, "offset", held, lambda p: depth * ((p >= low) & (p <= high)).all(axis=0), part)


def break_off(name: str, point: ArrayLike, direction: ArrayLike, *, box: Floats, part: str | None = None) -> Edit:
    """Return the loss of all that lies beyond an uneven fracture through `point`, facing `direction`, inside `box`."""
    n = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    side = np.cross(n, [0.3, 0.8, 0.5])
    side /= np.linalg.norm(side)
    other = np.cross(n, side)
    middle, half = 0.5 * (box[0] + box[1]), 0.5 * (box[1] - box[0])

    def beyond(p: Floats) -> Floats:
        """Return the rough plane of the break (n,), held within the box; negative in what is lost."""
        q = p - np.asarray(point, dtype=float)[:, None]
        u, v = side @ q, other @ q
        rough = 0.0012 * np.sin(u / 0.0042 + 1.3) * np.sin(v / 0.0051) + 0.0008 * np.sin((u + v) / 0.0027)
        held = (np.abs(p - middle[:, None]) - half[:, None]).max(axis=0)
        return np.maximum(-(n @ q) + rough, held)

    return Edit(name, "lost", np.asarray(box, dtype=float), beyond, part)


def hollow_out(name: str, centre: ArrayLike, radii: ArrayLike, *, part: str | None = None) -> Edit:
    """Return the loss of an uneven hollow: an ellipsoid about `centre` that reaches into the solid."""
    body, c = ellipsoid(centre, radii), np.asarray(centre, dtype=float)

    def tool(p: Floats) -> Floats:
        """Return the uneven ellipsoid (n,) that is taken out."""
        q = p - c[:, None]
        uneven = 0.0009 * np.sin(q[0] / 0.006 + q[2] / 0.008) * np.sin(q[1] / 0.007 + 0.5) + 0.0006 * np.sin(
            q[2] / 0.004
        )
        return body(p) + uneven

    margin = np.asarray(radii, dtype=float) + 0.003
    return Edit(name, "lost", np.stack([c - margin, c + margin]), tool, part)


def fill(
    name: str, centre: ArrayLike, direction: ArrayLike, *, radius: float, depth: float, part: str | None = None
) -> Edit:
    """Return an infill: a round plug of `radius` and `depth` [m], its end through `centre`, facing `direction`.

    What lay below that plane is filled up to it, as a hollow is by a restorer's mortar.
    """
    c, n = np.asarray(centre, dtype=float), np.asarray(direction, dtype=float) / np.linalg.norm(direction)

    def plug(p: Floats) -> Floats:
        """Return the plug (n,), a disc below the surface."""
        q = p - c[:, None]
        h = n @ q
        across = np.sqrt(np.maximum((q * q).sum(axis=0) - h * h, 0.0))
        return np.maximum(across - radius, np.abs(h + 0.5 * depth) - 0.5 * depth)

    ends, reach = np.stack([c, c - depth * n]), radius * np.sqrt(1.0 - n * n) + 0.2 * depth
    return Edit(name, "added", np.stack([ends.min(axis=0) - reach, ends.max(axis=0) + reach]), plug, part)


def move_part(name: str, part: str, T_after_before: Floats) -> Edit:
    """Return the rigid motion of one named part, in the scene's coordinates."""
    return Edit(name, "moved", EVERYWHERE, None, part, require_rigid(T_after_before, name))


def move_whole(name: str, T_after_before: Floats) -> Edit:
    """Return the rigid motion of all that is monitored; the surroundings stay."""
    return Edit(name, "moved", EVERYWHERE, None, None, require_rigid(T_after_before, name))
