"""Where an object is looked at from: orthographic views in the object's own frame, z up, all at one scale.

A surface goes in; named views and the frames of their pictures come out. "Front" is the side that somebody said, else
the one that most of the measured surface faces horizontally; "right" is the side at the right hand of someone who
stands before the front.

A room shows nothing from outside but the backs of its walls. It is looked at from the same six sides with all left out
that looks away from the viewer: what is seen is the wall beyond, the floor from above, the ceiling from below.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from projects.model import Bools, Floats, Ints, Surface
from projects.open3d_library import load_open3d
from projects.triangles import face_normals, measured_faces

VIEW_NAMES = {"front": "Front", "right": "Right side", "back": "Back", "left": "Left side", "top": "Top",
              "below": "From below"}  # fmt: skip
ROOM_NAMES = {"front": "Wall ahead", "right": "Wall to the left", "back": "Wall behind", "left": "Wall to the right",
              "top": "Floor", "below": "Ceiling"}  # fmt: skip
UP = np.array([0.0, 0.0, 1.0])
N_PROBES = 4000
WORTH_A_VIEW = 0.04  # share of the surface that a view must show and no earlier view does
MARGIN, FOOT = 0.035, 0.06  # of the longest side: room around the object, and below it for the scale bar
EDGE_ON = 0.01  # cosine to the viewer, below which a face is seen as a line and left out of a view that is cut away
FROM_WITHIN = 0.5  # share of the surface below which views from outside show too little of it
NEARLY = 0.8  # of the most that any view shows: epochs of one object are shown from one side
FLAT, LEVEL = 0.6, np.cos(np.deg2rad(40.0))  # of the surface of what lies flat faces so nearly up or down
LOW = 0.25  # of its width is the height of what lies flat, at most
LONG, FILLED = 1.25, 0.85  # a plan without a long side, that fills less of the rectangle about it, has no sides at all
ALONG_AXES = 1.0  # degrees off the axes, that are made none
ROUND = 1.25  # how much more surface the best side must show than the worst to be called a front


@dataclass(frozen=True)
class View:
    """A direction to look from. `towards` (object to viewer) and `up` (in the picture) are unit vectors (3,).

    `cut_away`: what looks away from the viewer is left out, so that a room is seen from within.
    """

    name: str
    towards: Floats
    up: Floats
    cut_away: bool = False


@dataclass(frozen=True)
class Frame:
    """What a picture shows: an orthographic view with its scale and size, the same for each surface drawn in it.

    Attributes
    ----------
    name : of the view.
    centre : (3,) m, the point at the middle of the picture.
    right, up, towards : (3,) unit vectors, right-handed; `towards` points at the viewer.
    metres_per_pixel : m.
    width, height : pixels.
    foot : pixels at the lower edge that are kept for the scale bar.
    near : m along `towards` from `centre`; what lies nearer to the viewer is cut away.
    beside : pixels of the longest side of the pictures that stand beside it at its scale; 0 where it stands alone.
    cut_away : as of the view.
    letters : pixels, the height of letters and numbers over the picture; 0 where nobody says how wide it is printed.
    """

    name: str
    centre: Floats
    right: Floats
    up: Floats
    towards: Floats
    metres_per_pixel: float
    width: int
    height: int
    foot: int = 0
    near: float = np.inf
    beside: int = 0
    cut_away: bool = False
    letters: float = 0.0

    @property
    def longest(self) -> int:
        """Pixels of the longest side of it, and of the pictures beside it."""
        return max(self.width, self.height, self.beside)

    @property
    def axes(self) -> Floats:
        """The rows right, up and towards (3, 3)."""
        return np.stack([self.right, self.up, self.towards])


def title_of(view: View | Frame) -> str:
    """Return the words below a view or its picture: the side that is seen, of a room the wall."""
    return (ROOM_NAMES if view.cut_away else VIEW_NAMES).get(view.name, view.name)


def project_points(frame: Frame, points: Floats) -> Floats:
    """Return pixel coordinates x (right), y (down) and height towards the viewer [m] of points (n, 3), as (n, 3)."""
    right, up, towards = np.moveaxis((points - frame.centre) @ frame.axes.T, -1, 0)
    x = right / frame.metres_per_pixel + frame.width / 2
    y = frame.height / 2 - up / frame.metres_per_pixel
    return np.stack([x, y, towards], axis=-1)


def _measured_normals(surface: Surface) -> Floats:
    """Return `face_normals`, 0 for the faces that close holes."""
    normals = face_normals(surface)
    return normals if surface.face_invented is None else normals * ~surface.face_invented[:, None]


def find_front(surface: Surface) -> Floats:
    """Return the horizontal unit vector (3,) from the object towards someone before its front.

    Among the directions that most of the measured area faces (cosine to the eighth, so that a wall counts where it is
    seen square-on, to the degree) it is the one nearest to -y, made an axis where that is as good; on an object that
    is round in plan it is -y. What lies flat has hardly any sides: there it is that of `front_in_plan`.
    """
    if lies_flat(surface):
        return front_in_plan(surface)
    normals = _measured_normals(surface)
    flat = np.hypot(normals[:, 0], normals[:, 1])
    bearing = np.degrees(np.arctan2(normals[:, 1], normals[:, 0])) % 360.0
    of_degree = np.bincount(np.rint(bearing).astype(int) % 360, flat, minlength=360)
    seen = np.maximum(np.cos(np.radians(np.arange(360))), 0.0) ** 8
    facing = np.fft.irfft(np.fft.rfft(of_degree) * np.fft.rfft(seen), 360)
    if facing.max() <= ROUND * max(facing.min(), 0.0):
        return np.array([0.0, -1.0, 0.0])
    crest = (facing >= np.roll(facing, 1)) & (facing >= np.roll(facing, -1)) & (facing >= 0.8 * facing.max())
    candidates = np.flatnonzero(crest)
    away = np.abs((candidates - 270 + 180) % 360 - 180)
    best = candidates[away.argmin()]
    axis = round(best / 90) * 90 % 360
    angle = np.radians(float(axis if facing[axis] >= 0.98 * facing[best] else best))
    return np.array([np.cos(angle), np.sin(angle), 0.0]).round(12)


def lies_flat(surface: Surface) -> bool:
    """Return whether a surface is low and most of it faces up or down: a slab, a tombstone on the ground, a floor."""
    normals = _measured_normals(surface)
    areas = np.linalg.norm(normals, axis=1)
    wide, deep, high = np.ptp(surface.vertices, axis=0)
    if high > LOW * min(wide, deep):
        return False
    return bool(areas[np.abs(normals[:, 2]) > LEVEL * areas].sum() >= FLAT * areas.sum() > 0.0)


def front_in_plan(surface: Surface) -> Floats:
    """Return the horizontal unit vector (3,) square to a side of the smallest rectangle about the plan, of its four the
    one nearest to -y: then that rectangle stands upright in the view from above. Of a round plan it is -y."""
    hull = outline_of_plan(surface)
    sides = np.diff(np.concatenate([hull, hull[:1]]), axis=0)
    along = sides / np.linalg.norm(sides, axis=1)[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    lengths = np.stack([np.ptp(hull @ along.T, axis=0), np.ptp(hull @ across.T, axis=0)])
    best = int(lengths.prod(axis=0).argmin())
    hull = hull - hull.mean(axis=0)
    area = 0.5 * abs(float(np.sum(hull[:, 0] * np.roll(hull[:, 1], -1) - hull[:, 1] * np.roll(hull[:, 0], -1))))
    if lengths[:, best].max() < LONG * lengths[:, best].min() and area < FILLED * lengths[:, best].prod():
        return np.array([0.0, -1.0, 0.0])
    turned = np.degrees(np.arctan2(along[best, 1], along[best, 0]))
    turned = (turned + 45.0) % 90.0 - 45.0  # off the axes: the side nearest to -y is turned by so much from it
    angle = np.radians(270.0 + (0.0 if abs(turned) <= ALONG_AXES else turned))
    return np.array([np.cos(angle), np.sin(angle), 0.0]).round(12)


def outline_of_plan(surface: Surface) -> Floats:
    """Return the corners (k, 2) of the convex hull of the measured surface seen from above, in order."""
    plan = surface.vertices[np.unique(measured_faces(surface)), :2]
    outline: Floats = plan[ConvexHull(plan - plan.mean(axis=0)).vertices]
    return outline


def front_of(surface: Surface, bearing: float | None) -> Floats:
    """Return the horizontal unit vector (3,) towards someone before the front: `bearing` [rad] clockwise from +y, as of
    `ObjectRecord.front`, or where None that of `find_front`. In a room it goes from the wall ahead into the room."""
    if bearing is None:
        return find_front(surface)
    return np.array([np.sin(bearing), np.cos(bearing), 0.0]).round(12)


def all_views(front: Floats) -> tuple[View, ...]:
    """Return the six named views about a horizontal unit vector (3,) towards someone before the front."""
    right = np.cross(UP, front)
    named = {"front": (front, UP), "right": (right, UP), "back": (-front, UP), "left": (-right, UP),
             "top": (UP, -front), "below": (-UP, front)}  # fmt: skip
    return tuple(View(name, towards, up) for name, (towards, up) in named.items())


def sample_surface(surface: Surface, n: int) -> tuple[Floats, Floats]:
    """Return n points spread evenly by measured area, and their unit normals: systematic, the same every time."""
    normals = _measured_normals(surface)
    areas = np.linalg.norm(normals, axis=1)
    reached = np.cumsum(areas)
    picked = np.searchsorted(reached, (np.arange(n) + 0.5) / n * reached[-1])
    points = surface.vertices[surface.faces[picked]].mean(axis=1)
    return points, normals[picked] / areas[picked, None]


def look_to(normals: Floats, towards: Floats) -> Bools:
    """Return which faces, with normals (m, 3) of any length, look to a viewer who is far away `towards` (3,)."""
    facing: Bools = normals @ towards > EDGE_ON * np.linalg.norm(normals, axis=1)
    return facing


def make_scene(vertices: NDArray[np.float32], faces: Ints) -> Any:
    """Return Open3D's scene for rays of vertices (n, 3) and faces (m, 3)."""
    scene = load_open3d().t.geometry.RaycastingScene()
    scene.add_triangles(vertices, faces.astype(np.uint32))
    return scene


def see_probes(surface: Surface, views: Sequence[View]) -> Bools:
    """Return which of `N_PROBES` points of the surface are seen, less than 75 degrees oblique, in each view."""
    middle, of_faces = surface.vertices.mean(axis=0), face_normals(surface)
    vertices = (surface.vertices - middle).astype(np.float32)
    whole = None if all(view.cut_away for view in views) else make_scene(vertices, surface.faces)
    points, normals = sample_surface(surface, N_PROBES)
    lift = 1e-4 * np.ptp(surface.vertices, axis=0).max()
    seen = []
    for view in views:
        scene = make_scene(vertices, surface.faces[look_to(of_faces, view.towards)]) if view.cut_away else whole
        assert scene is not None
        start = points - middle + lift * (normals + view.towards)
        rays = np.concatenate([start, np.broadcast_to(view.towards, start.shape)], axis=1).astype(np.float32)
        seen.append(~scene.test_occlusions(rays).numpy() & (normals @ view.towards > np.cos(np.deg2rad(75.0))))
    return np.array(seen)


def choose_views(surface: Surface, bearing: float | None = None) -> list[View]:
    """Return the views worth drawing, of front, right, back, left, top and below, in this order.

    A view is worth it where it shows at least 4 % of the measured surface that none chosen before it shows: a relief
    has its front alone, a statue its four sides, a floor, a tombstone or a ceiling its top or what is below. Chosen
    first is what shows most, or nearly as much and stands before it in this order. Where all six show less than half
    of the surface, and more of it cut away, as of a room, all are cut away. `bearing` is that of the front, as of
    `front_of`.
    """
    views = all_views(front_of(surface, bearing))
    seen = see_probes(surface, views)
    if seen.any(axis=0).mean() < FROM_WITHIN:
        cut = tuple(replace(view, cut_away=True) for view in views)
        through = see_probes(surface, cut)
        if through.any(axis=0).sum() > seen.any(axis=0).sum():
            views, seen = cut, through
    return [views[k] for k in sorted(pick_views(seen))]


def pick_views(seen: Bools) -> list[int]:
    """Return which views to draw, first the one that shows most, by which probes each one sees (v, p): always one."""
    chosen: list[int] = []
    shown = np.zeros(seen.shape[1], dtype=np.bool_)
    while True:
        more = np.count_nonzero(seen & ~shown, axis=1)
        if chosen and more.max() < WORTH_A_VIEW * len(shown):
            return chosen
        k = int(np.flatnonzero(more >= NEARLY * more.max())[0])
        chosen.append(k)
        shown |= seen[k]


def choose_one(surface: Surface, wanted: Bools | None = None, bearing: float | None = None) -> View:
    """Return the first view, from the front on, that shows nearly as much as any of the surface, or of the vertices
    (n,) that are wanted, where there are any: by the area of the faces that look to the viewer, as it appears.
    `bearing` as of `front_of`."""
    normals = face_normals(surface)
    if wanted is not None and wanted.any():
        normals = normals * wanted[surface.faces].mean(axis=1)[:, None]
    views = choose_views(surface, bearing)
    areas = [float(np.maximum(normals @ view.towards, 0.0).sum()) for view in views]
    return next(v for v, area in zip(views, areas, strict=True) if area >= NEARLY * max(areas))


def frame_view(view: View, points: Floats, metres_per_pixel: float, *, room: int = 0, foot: int = 0) -> Frame:
    """Return the frame that holds all points (n, 3) [m], with `room` pixels around them and `foot` more below."""
    towards = view.towards / np.linalg.norm(view.towards)
    right = np.cross(view.up, towards)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(towards, right), towards])
    seen = points @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    width, height = (int(np.ceil(length / metres_per_pixel)) + 2 * room for length in (high - low)[:2])
    centre = (low + high) / 2
    centre[1] -= foot / 2 * metres_per_pixel
    return Frame(
        view.name, centre @ axes, axes[0], axes[1], axes[2], metres_per_pixel, width, height + foot, foot,
        cut_away=view.cut_away,
    )  # fmt: skip


def frame_views(
    views: Sequence[View], surfaces: Sequence[Surface], *, longest_px: int = 900, letters_px: float = 0.0
) -> list[Frame]:
    """Return the frames of the views at one common scale, for every surface alike, the longest side `longest_px`, with
    letters `letters_px` high (0: as the size of the pictures suggests)."""
    points = np.concatenate([s.vertices for s in surfaces])
    frames = [frame_view(view, points, 1.0) for view in views]  # only for their axes
    extents = np.stack([np.ptp(points @ f.axes.T, axis=0)[:2] for f in frames])
    room, foot = round(MARGIN * longest_px), round(FOOT * longest_px)
    free = np.array([longest_px - 2 * room, longest_px - 2 * room - foot]) - 1
    metres_per_pixel = float((extents / free).max())
    frames = [frame_view(view, points, metres_per_pixel, room=room, foot=foot) for view in views]
    return [replace(frame, beside=longest_px, letters=letters_px) for frame in frames]
