"""Where on the object a region lies, in the words of someone who stands before its front.

In: a comparison. Out: which way the region faces, or that it goes all round, on which part of the object it lies, its
height above the base. Of a room, in the words of someone who stands in it before the wall that the front view shows:
which wall, floor or ceiling.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from projects.model import Bools, ComparedSurface, Comparison, Floats, Surface
from projects.triangles import face_normals
from reports.cameras import UP, choose_views, front_of, lies_flat, outline_of_plan
from reports.quantities import NOT_KNOWN, height

STEEP = np.cos(np.deg2rad(40.0))  # a region that faces so nearly up or down is on the top or the underside
SIDES = ("front", "front right", "right side", "back right", "back", "back left", "left side", "front left")
WALLS = ("wall ahead", "wall ahead to the left", "wall to the left", "wall behind to the left",
         "wall behind", "wall behind to the right", "wall to the right", "wall ahead to the right")  # fmt: skip
ALL_WALLS = "walls all round"
SIDEWAYS = {*SIDES, *WALLS} - {"front", "back", "wall ahead", "wall behind"}  # where left and right are said already
ON_THE_WALL = 0.8  # of the way from the middle of a room to its end: what faces back from there is wall
ON_ALL_WALLS = 0.5  # the same of walls all round, which stand nearer in the mean: 0.79 of the way where a room is round
ALL_ROUND = 1.0 / 3.0  # of the area is left of the summed normals of three sides of a pillar; less: no side is meant
NO_LEVEL = 5e-4  # m: less below the base is 0 mm above it
APART = 1.0 / 6.0  # of the object's width, from its middle: beyond it one says "left" or "right"


@dataclass(frozen=True)
class Setting:
    """What words of place go by: the way to someone before the front (3,), the object's box (2, 3) m, if it is a room.

    A room is what views from outside do not show (`cameras.choose_views`). Of what lies flat, nearly all places are on
    top: they are told by its `plan`, whose outline (k, 2) m is then given.
    """

    front: Floats
    box: Floats
    is_room: bool
    plan: Floats | None = None


def setting_of(surface: Surface, bearing: float | None = None) -> Setting:
    """Return what words of place about a surface go by; `bearing` [rad] of its front, None where nobody said."""
    box = np.stack([surface.vertices.min(axis=0), surface.vertices.max(axis=0)])
    is_room = choose_views(surface, bearing)[0].cut_away
    return Setting(
        front_of(surface, bearing),
        box,
        is_room,
        outline_of_plan(surface) if lies_flat(surface) and not is_room else None,
    )


def patch_of(compared: ComparedSurface, number: int) -> Surface:
    """Return the faces that lie in a region."""
    inside = (compared.region == number)[compared.surface.faces].any(axis=1)
    return Surface(compared.surface.vertices, compared.surface.faces[inside])


def is_all_round(patch: Surface) -> bool:
    """Return whether faces look in all directions: nearly nothing is left of the sum of their normals."""
    normals = face_normals(patch)
    return bool(np.linalg.norm(normals.sum(axis=0)) < ALL_ROUND * np.linalg.norm(normals, axis=1).sum())


def name_side(normal: Floats, front: Floats) -> str:
    """Return the side of the object that faces along `normal`: one of `SIDES`, the top or the underside."""
    length = np.linalg.norm(normal)
    if not length > 0.0:
        return ""
    upward = float(normal @ UP) / length
    if abs(upward) > STEEP:
        return "top" if upward > 0 else "underside"
    right = np.cross(UP, front)
    turn = np.arctan2(normal @ right, normal @ front)
    return SIDES[round(float(turn) / (np.pi / 4)) % 8]


def name_wall(normal: Floats, place: Floats, setting: Setting) -> str:
    """Return the wall, floor or ceiling that faces along `normal` at `place`; what stands free is "within the room"."""
    side = name_side(normal, setting.front)
    if not side:
        return "within the room"
    if way_to_wall(normal[None], place[None], setting.box) < ON_THE_WALL:
        return "within the room"
    return {"top": "floor", "underside": "ceiling"}.get(side) or WALLS[SIDES.index(side)]


def way_to_wall(normals: Floats, places: Floats, box: Floats) -> float:
    """Return how far out of the middle of a room, 0, to its end, 1, faces lie that look back; below 0 they look away.

    `normals` (m, 3) are as long as each counts, `places` (m, 3) [m] those of the faces, `box` (2, 3) [m] the room's.
    """
    towards = -float(np.sum((places - box.mean(axis=0)) * normals))
    return towards / float(np.sum(np.abs(normals) @ (0.5 * np.ptp(box, axis=0))))


def name_all_round(patches: list[Surface], setting: Setting) -> str:
    """Return how one says of a change that it goes all round: round the object, or in a room along its walls."""
    if not setting.is_room:
        return "all round"
    lines_walls = all(way_to_wall(face_normals(p), p.vertices[p.faces].mean(axis=1), setting.box) >= ON_ALL_WALLS
                      for p in patches)  # fmt: skip
    return ALL_WALLS if lines_walls else "within the room"


def name_part(place: Floats, box: Floats, front: Floats) -> str:
    """Return "to the left" or "to the right" of the object's middle as seen from the front, else nothing."""
    corners = np.array([[x, y] for x in box[:, 0] for y in box[:, 1]])
    return _side_of_middle(place, corners, np.cross(UP, front), ("to the left", "to the right"))


def name_part_of_plan(place: Floats, plan: Floats, front: Floats) -> str:
    """Return where in the outline (k, 2) of something that lies flat a place is, as of someone before its front."""
    across = _side_of_middle(place, plan, np.cross(UP, front), ("to the left", "to the right"))
    depth = _side_of_middle(place, plan, front, ("towards the back", "towards the front"))
    return ", ".join(filter(None, (across, depth))) or "in the middle"


def _side_of_middle(place: Floats, corners: Floats, way: Floats, words: tuple[str, str]) -> str:
    """Return the first of the words where a place lies before the middle of corners (k, 2) along `way` (3,), the second
    where beyond it, else nothing."""
    reach = corners @ way[:2]
    off = (place[:2] @ way[:2] - reach.min()) / max(float(np.ptp(reach)), 1e-300) - 0.5
    return words[0] if off < -APART else words[1] if off > APART else ""


def locate(comparison: Comparison, number: int, place: Floats, setting: Setting) -> str:
    """Return where a region with its centroid at `place` (3,) lies: its side, its part, its height above the base.

    It goes all round where both surfaces do: a limb that broke off looks in all directions too, but not its fracture.
    """
    if not np.isfinite(place).all():
        return NOT_KNOWN
    patches = [patch_of(side, number) for side in (comparison.on_compared, comparison.on_reference)]
    if all(is_all_round(patch) for patch in patches):
        return say_place(name_all_round(patches, setting), place, setting)
    return say_where(np.sum([face_normals(patch).sum(axis=0) for patch in patches], axis=0), place, setting)


def locate_most(side: ComparedSurface, which: Bools, setting: Setting) -> str:
    """Return where the largest connected place of some vertices (n,) of a side lies; nothing where no face is all of
    them."""
    faces = side.surface.faces[which[side.surface.faces].all(axis=1)]
    if not len(faces):
        return ""
    used, corners = np.unique(faces, return_inverse=True)
    corners = corners.reshape(-1, 3)
    ways = face_normals(Surface(side.surface.vertices[used], corners))
    edges = np.concatenate([corners[:, :2], corners[:, 1:]])
    links = coo_matrix((np.ones(len(edges)), edges.T), shape=(len(used), len(used)))
    patch = connected_components(links, directed=False)[1][corners[:, 0]]
    areas = np.linalg.norm(ways, axis=1)
    most = patch == np.bincount(patch, areas).argmax()
    centres = side.surface.vertices[faces[most]].mean(axis=1)
    return say_where(ways[most].sum(axis=0), np.average(centres, axis=0, weights=areas[most]), setting)


def say_where(normal: Floats, place: Floats, setting: Setting) -> str:
    """Return where something at `place` (3,) lies that faces along `normal`: its side, its part, its height."""
    side = name_wall(normal, place, setting) if setting.is_room else name_side(normal, setting.front)
    return say_place(side, place, setting)


def say_place(side: str, place: Floats, setting: Setting) -> str:
    """Return the words for a side with the part and the height at which `place` (3,) lies; floor and ceiling have none
    worth saying, and the lowest point of an object may be noise below its base."""
    part = "" if side in {*SIDEWAYS, ALL_WALLS} else name_part(place, setting.box, setting.front)
    if setting.plan is not None and side in ("top", "underside"):
        part = name_part_of_plan(place, setting.plan, setting.front)
    ground, level = "floor" if setting.is_room else "base", float(place[2] - setting.box[0, 2])
    above = f"{height(abs(level))} {'below' if level < -NO_LEVEL else 'above'} the {ground}"
    if setting.is_room and side in ("floor", "ceiling"):
        above = ""
    return ", ".join(words for words in (side, part, above) if words)
