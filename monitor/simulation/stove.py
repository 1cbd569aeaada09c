"""The Rocaille stove of paper 002: three metres of glazed ceramic on scroll feet, set from pieces of about 30 cm.

A bombe body in two storeys between moulded cornices, an arched niche with a shell, C- and S-scrolls, trellis, corner
volutes and an urn; it stands before a wall. Metres; x to the right seen from the front, y away from it, z up from the
floor, the axis at the origin. Each piece is a part of its own, so that it can be shifted singly, as when a stove is
taken down and set up again.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from monitor.simulation.changes import Edit, move_part
from monitor.simulation.model import Model, ModelPart, build_scene
from monitor.simulation.rocaille import Sheet, draw_scroll
from monitor.simulation.scenes import Scene, make_box
from monitor.simulation.shapes import Drawing, arc_points, ball, draw_mirrored, pipe, smoothstep, tube
from monitor.simulation.solid import Part, join_blended, smooth_max, smooth_min
from projects.model import Floats
from projects.transforms import perturb

HEIGHT = 3.02  # m
DEPTH_LESS = 0.20  # m, by which the half depth is less than the half width
COURSES = (0.26, 0.42, 0.70, 0.97, 1.225, 1.46, 1.72, 1.98, 2.225, 2.46, 2.72)  # m, heights of the bed joints
PIECES_A_COURSE = 12
TILE = 0.06  # m, thickness of a piece
GLAZE, BISCUIT = (0.78, 0.045), (0.70, 0.0)  # reflectance and gloss of glazed tiles and of matt mouldings; assumed
MATT_COURSES = (0, 4, 8, 9)
NICHE = (0.165, 1.57, 1.93, 0.13)  # m: half width, sill, springing of the arch, depth


# The body ----------------------------------------------------------------------------------------------------------


_arc = functools.partial(arc_points, n=9)


def _swell(heights: Sequence[float], widths: Sequence[float]) -> list[tuple[float, float]]:
    """Return a smooth stretch of the profile through half widths at heights."""
    z = np.linspace(heights[0], heights[-1], 20)
    return list(zip(CubicSpline(heights, widths)(z), z, strict=True))


@functools.cache
def profile() -> Drawing:
    """Return the section of the stove over (half width, height)."""
    half = [(0.0, 0.26), (0.56, 0.26)]
    half += _arc((0.575, 0.295), 0.032, -90, 90)  # torus of the base
    half += [(0.575, 0.330), (0.575, 0.345), *_arc((0.575, 0.385), 0.040, 270, 180), (0.535, 0.40), (0.525, 0.40)]
    half += _swell([0.42, 0.55, 0.80, 1.05, 1.225], [0.520, 0.560, 0.590, 0.540, 0.500])
    half += [(0.515, 1.225), (0.515, 1.245), *_arc((0.515, 1.300), 0.055, -90, 0), (0.570, 1.312), (0.605, 1.312)]
    half += [(0.605, 1.355), *_arc((0.560, 1.355), 0.045, 0, 90), (0.540, 1.400), (0.540, 1.412)]
    half += _swell([1.412, 1.435, 1.46], [0.530, 0.480, 0.455])
    half += _swell([1.461, 1.60, 1.80, 2.05, 2.224], [0.450, 0.425, 0.435, 0.440, 0.405])
    half += [(0.420, 2.225), (0.420, 2.243), *_arc((0.420, 2.293), 0.050, -90, 0), (0.470, 2.303), (0.500, 2.303)]
    half += [(0.500, 2.340), *_arc((0.465, 2.340), 0.035, 0, 90), (0.440, 2.375), (0.440, 2.388)]
    half += _swell([2.389, 2.46, 2.56, 2.66, 2.72], [0.430, 0.385, 0.345, 0.290, 0.245])
    half += [(0.0, 2.72)]
    return draw_mirrored(half, (-0.02, 0.10), (0.80, 2.90), step=0.003)


def _across(p: Floats) -> Floats:
    """Return the half width that a point would have in the plan: rounded corners, a front that bows out."""
    bow = 0.055 * np.cos(np.clip(p[0] / 0.62, -1.0, 1.0) * np.pi)
    return smooth_max(np.abs(p[0]), np.abs(p[1]) + DEPTH_LESS - np.where(p[1] < 0.0, bow, 0.0), 0.16)


def _niche(p: Floats) -> Floats:
    """The arched niche in the upper storey: a round-headed recess whose back is hollowed."""
    half, sill, spring, depth = NICHE
    arch = np.where(p[2] > spring, np.hypot(p[0], p[2] - spring), np.abs(p[0])) - half
    front = -(profile_depth() + 0.05)
    deep = p[1] - (front + 0.05 + depth * np.sqrt(np.clip(1.0 - (p[0] / (1.3 * half)) ** 2, 0.0, 1.0)))
    return smooth_max(smooth_max(arch, sill - p[2], 0.01), deep, 0.03)


def profile_depth() -> float:
    """Return the half depth [m] of the upper storey at the niche, without the bow."""
    return 0.435 - DEPTH_LESS


def _base_field(p: Floats) -> Floats:
    """The body without relief."""
    value = profile()(_across(p), p[2])
    low, high = p.min(axis=1), p.max(axis=1)
    near_niche = low[1] < 0.0 and high[2] > NICHE[1] - 0.1 and low[2] < 2.2 and low[0] < 0.4 and high[0] > -0.4
    return smooth_max(value, -_niche(p), 0.012) if near_niche else value


# The ornament --------------------------------------------------------------------------------------------------------


@functools.cache
def front_relief() -> Drawing:
    """Return the relief of the front over (x, z)."""
    sheet = Sheet((-0.65, 0.2), (0.65, 2.75))
    # Lower storey: a cartouche of scrolls about a trellis, shells above and below.
    sheet.lattice((-0.23, 0.60), (0.23, 1.02), mesh=0.052, height=0.007)
    sheet.mirrored_scroll((0.10, 0.535), (0.33, 0.86), width=0.031, height=0.041, ruffle=0.040, bulge=-1.0)
    sheet.mirrored_scroll((0.33, 0.78), (0.09, 1.10), width=0.029, height=0.038, ruffle=0.034, bulge=-1.0)
    sheet.mirrored_scroll((0.48, 0.50), (0.44, 1.14), width=0.022, height=0.027, ruffle=0.020, bulge=1.0)
    sheet.shell((0.0, 1.075), radius=0.125, height=0.034, lobes=9, spread=230.0)
    sheet.shell((0.0, 0.565), radius=0.100, height=0.028, lobes=7, spread=220.0, turn=-90.0)
    flame = draw_scroll(np.array([-0.07, 0.66]), np.array([0.085, 0.95]), bulge=1.0, s_shaped=True)
    sheet.scroll(flame, width=0.034, height=0.043, ruffle=0.045, both=True)  # the asymmetry that makes it rocaille
    # Cornices: a shell on each.
    sheet.shell((0.0, 1.300), radius=0.110, height=0.020, lobes=7, spread=200.0)
    sheet.shell((0.0, 2.290), radius=0.095, height=0.018, lobes=7, spread=200.0)
    # Upper storey: scrolls that frame the niche, its conch, a crest.
    sheet.shell((0.0, 1.905), radius=0.190, height=0.016, lobes=11, spread=190.0)
    sheet.mirrored_scroll((0.21, 1.545), (0.225, 1.90), width=0.025, height=0.032, ruffle=0.030, bulge=-1.0)
    sheet.mirrored_scroll((0.235, 1.94), (0.045, 2.155), width=0.025, height=0.032, ruffle=0.030, bulge=-1.0)
    sheet.mirrored_scroll((0.35, 1.56), (0.34, 2.14), width=0.019, height=0.023, ruffle=0.016, bulge=1.0)
    sheet.shell((0.012, 2.125), radius=0.082, height=0.028, lobes=7, spread=240.0, turn=80.0)
    sheet.mirrored_scroll((0.05, 1.515), (0.20, 1.535), width=0.017, height=0.022, ruffle=0.012, s_shaped=True)
    # Crown.
    sheet.mirrored_scroll((0.24, 2.44), (0.06, 2.655), width=0.023, height=0.030, ruffle=0.026, bulge=1.0)
    return sheet.heights()


@functools.cache
def side_relief() -> Drawing:
    """Return the relief of the sides over (y, z)."""
    sheet = Sheet((-0.45, 0.2), (0.45, 2.75))
    sheet.lattice((-0.19, 0.56), (0.19, 1.08), mesh=0.050, height=0.006)
    sheet.mirrored_scroll((0.05, 0.50), (0.25, 0.82), width=0.025, height=0.032, ruffle=0.028, bulge=-1.0)
    sheet.mirrored_scroll((0.25, 0.82), (0.05, 1.15), width=0.025, height=0.032, ruffle=0.028, bulge=-1.0)
    sheet.shell((0.0, 1.125), radius=0.080, height=0.024, lobes=7, spread=220.0)
    sheet.lattice((-0.11, 1.62), (0.11, 2.06), mesh=0.044, height=0.006)
    sheet.mirrored_scroll((0.03, 1.55), (0.15, 1.84), width=0.019, height=0.026, ruffle=0.022, bulge=-1.0)
    sheet.mirrored_scroll((0.15, 1.84), (0.03, 2.12), width=0.019, height=0.026, ruffle=0.022, bulge=-1.0)
    sheet.shell((0.0, 2.110), radius=0.065, height=0.020, lobes=7, spread=220.0)
    return sheet.heights()


def _lay_relief(p: Floats, base: Floats) -> Floats:
    """Return the field with relief, from that without; the back, which faces the wall, is plain."""
    value, near = base.copy(), np.abs(base) < 0.12
    q = p[:, near]
    lead = np.abs(q[0]) - np.abs(q[1]) - DEPTH_LESS  # positive on the sides
    front = np.where(q[1] < 0.0, front_relief()(q[0], q[2]), 0.0) * (1.0 - smoothstep(lead, -0.05, 0.02))
    side = side_relief()(q[1], q[2]) * smoothstep(lead, -0.02, 0.05)
    value[near] -= np.maximum(front, side)
    return 0.85 * value


@functools.cache
def _corner_volutes() -> tuple[Part, ...]:
    """The brackets on the corners: S-shaped, roped, from under each cornice down into the storey."""
    parts = []
    for storey, (z, inner) in {
        "lower": ((1.21, 1.10, 0.90, 0.66, 0.50), 0.0),
        "upper": ((2.21, 2.12, 1.95, 1.72, 1.55), 0.115),
    }.items():
        out = np.array([0.075, 0.105, 0.060, 0.030, 0.055])
        for side in (-1.0, 1.0):
            for front in (-1.0, 1.0):
                corner = np.array([0.485 - inner, 0.485 - inner - DEPTH_LESS])
                reach = corner[None, :] + 0.55 * out[:, None]
                knots = np.column_stack([side * reach[:, 0], front * reach[:, 1], z])
                course = CubicSpline(np.linspace(0, 1, 5), knots)(np.linspace(0.0, 1.0, 13))
                radii = np.interp(
                    np.linspace(0, 1, 13), [0.0, 0.15, 0.5, 0.85, 1.0], [0.050, 0.046, 0.030, 0.030, 0.040]
                )
                rope = tube(course, radii, strands=5, relief=0.006, twist=14.0)
                pieces = [(rope, 0.0), (ball(course[0], 0.056), 0.008), (ball(course[-1], 0.044), 0.008)]
                box = np.stack([course.min(axis=0) - 0.075, course.max(axis=0) + 0.075])
                parts.append(Part(f"{storey} volute", join_blended(pieces), box, blend=0.012))
    return tuple(parts)


def _body(p: Floats, base: Floats) -> Floats:
    """The body with all its ornament, from its field without."""
    low, high = p.min(axis=1), p.max(axis=1)
    value = _lay_relief(p, base)
    for part in _corner_volutes():
        if (low < part.box[1]).all() and (high > part.box[0]).all():
            value = smooth_min(value, part.field(p), part.blend)
    return value


# Feet, urn -----------------------------------------------------------------------------------------------------------


def _foot(side: float, front: float) -> ModelPart:
    """A foot: a scroll that swings out from the base and curls on the floor."""
    knots = np.array([(0.44, 0.22, 0.31), (0.52, 0.30, 0.22), (0.50, 0.285, 0.11), (0.545, 0.325, 0.052)])
    course = CubicSpline(np.linspace(0, 1, 4), knots * [side, front, 1.0])(np.linspace(0.0, 1.0, 11))
    radii = np.interp(np.linspace(0, 1, 11), [0.0, 0.3, 0.7, 1.0], [0.085, 0.066, 0.040, 0.050])
    leg, curl = tube(course, radii, strands=4, relief=0.005, twist=5.0), ball(course[-1], 0.058)

    def field(p: Floats) -> Floats:
        """Return the scroll (n,) at p (3, n), cut off at the floor and under the base."""
        return smooth_max(smooth_min(leg(p), curl(p), 0.015), smooth_max(-p[2], p[2] - 0.29, 0.004), 0.006)

    box = np.stack([course.min(axis=0) - 0.10, course.max(axis=0) + 0.10])
    box[0, 2], box[1, 2] = -0.005, 0.295
    name = f"foot {'front' if front < 0 else 'back'} {'left' if side < 0 else 'right'}"
    return ModelPart(name, field, box, 0.003, *GLAZE)


@functools.cache
def _urn_profile() -> Drawing:
    """Return the section of the urn over (half width, height) [m]."""
    half = [(0.0, 2.69), (0.135, 2.69), (0.135, 2.725), (0.10, 2.735), *_arc((0.10, 2.757), 0.022, -90, 90)]
    half += _swell([2.780, 2.80, 2.84, 2.88, 2.905], [0.055, 0.075, 0.112, 0.105, 0.065])
    half += [
        (0.075, 2.906),
        (0.078, 2.918),
        *_swell([2.919, 2.95, 2.985, 3.02], [0.060, 0.066, 0.042, 0.004]),
        (0.0, 3.02),
    ]
    return draw_mirrored(half, (-0.02, 2.60), (0.24, 3.10), step=0.0015)


def _urn() -> ModelPart:
    """The urn on top, gadrooned, a flame in its mouth."""

    def field(p: Floats) -> Floats:
        """Return the urn (n,) at p (3, n): flutes on its belly, a flame above."""
        turn = np.arctan2(p[1], p[0])
        belly = smoothstep(p[2], 2.79, 2.81) * (1.0 - smoothstep(p[2], 2.875, 2.895))
        flame = smoothstep(p[2], 2.925, 2.945)
        bend = 0.0035 * belly * pipe(14.0 * turn) + 0.006 * flame * pipe(5.0 * turn + 60.0 * (p[2] - 2.92))
        return 0.8 * (_urn_profile()(np.hypot(p[0], p[1]), p[2]) - bend)

    return ModelPart("urn", field, np.array([[-0.18, -0.18, 2.68], [0.18, 0.18, 3.04]]), 0.003, *GLAZE)


# The pieces ----------------------------------------------------------------------------------------------------------


def _wedge(course: int, k: int) -> tuple[Floats, Floats]:
    """Return the two inward normals (2,) of the joints that bound piece k of a course, half a piece off each other."""
    # Joints are spread evenly along the circumference of the mean plan, not over the angle.
    turn = np.linspace(-np.pi, np.pi, 721)
    reach = 1.0 / np.maximum(np.abs(np.cos(turn)) / 0.52, np.abs(np.sin(turn)) / 0.33)
    plan = np.column_stack([reach * np.cos(turn), reach * np.sin(turn)])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(plan, axis=0), axis=1))])
    share = (np.array([k, k + 1]) + 0.5 * (course % 2)) / PIECES_A_COURSE
    first, last = np.interp(share % 1.0, way / way[-1], turn)
    return np.array([-np.sin(first), np.cos(first)]), np.array([np.sin(last), -np.cos(last)])


def _piece(course: int, k: int, cell: float) -> ModelPart:
    """One piece: what lies between two bed joints and two upright joints, `TILE` thick."""
    low, high = COURSES[course] + 0.0005, COURSES[course + 1] - 0.0005
    first, last = _wedge(course, k)

    def field(p: Floats) -> Floats:
        """Return the piece (n,) at p (3, n): the body between its joints, as thick as a tile."""
        upright = 0.0005 - np.minimum(first @ p[:2], last @ p[:2])
        value = smooth_max(upright, np.maximum(low - p[2], p[2] - high), 0.002)
        near = value < 0.012  # further out the joints tell enough
        if near.any():
            q = p[:, near]
            base = _base_field(q)
            value[near] = np.maximum(smooth_max(_body(q, base), value[near], 0.004), -(0.85 * base + TILE))
        return value

    reflectance, gloss = BISCUIT if course in MATT_COURSES else GLAZE
    return ModelPart(f"piece {course + 1}.{k + 1}", field, _box_of_piece(course, k), cell, reflectance, gloss)


@functools.cache
def _plan_of_course(course: int) -> Floats:
    """Return places (2, n) of a grid where a course has its shell of pieces at some height."""
    low, high = COURSES[course], COURSES[course + 1]
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-0.72, 0.721, 0.01), np.arange(-0.58, 0.521, 0.01), indexing="ij"))
    depths = [_base_field(np.stack([x, y, np.full(x.shape, z)])) for z in np.linspace(low, high, 9)]
    shell = (np.min(depths, axis=0) < 0.11) & (np.max(depths, axis=0) > -TILE - 0.02)
    return np.stack([x[shell], y[shell]])


def _box_of_piece(course: int, k: int) -> Floats:
    """Return the box (2, 3) of a piece."""
    first, last = _wedge(course, k)
    plan = _plan_of_course(course)
    held = plan[:, (first @ plan > -0.005) & (last @ plan > -0.005)]
    at = np.stack([held.min(axis=1) - 0.012, held.max(axis=1) + 0.012])
    return np.column_stack([at, [COURSES[course] - 0.003, COURSES[course + 1] + 0.003]])


def _core() -> ModelPart:
    """The brick lining behind the pieces, hardly seen."""

    def field(p: Floats) -> Floats:
        """Return the masonry (n,) at p (3, n) behind the tiles."""
        return np.maximum(0.85 * _base_field(p) + 0.045, np.maximum(0.27 - p[2], p[2] - 2.70))

    return ModelPart("core", field, np.array([[-0.62, -0.50, 0.26], [0.62, 0.42, 2.71]]), 0.012, 0.35, 0.0)


@functools.cache
def stove_model(*, cell: float = 0.004) -> Model:
    """Return the stove as a model: pieces "piece 1.1" (lowest course) to "piece 10.12", feet, urn and core.

    `cell` [m] is the edge of the pieces' triangles.
    """
    pieces = [_piece(course, k, cell) for course in range(len(COURSES) - 1) for k in range(PIECES_A_COURSE)]
    feet = [_foot(side, front) for side in (-1.0, 1.0) for front in (-1.0, 1.0)]
    others = [
        ModelPart(p.name, p.field, p.box, max(cell, p.cell), p.reflectance, p.gloss) for p in (*feet, _urn(), _core())
    ]
    floor = make_box("floor", np.array([-3.7, -4.5, -0.1]), np.array([3.7, 0.7, 0.0]), reflectance=0.3)
    wall = make_box("wall", np.array([-3.7, 0.62, 0.0]), np.array([3.7, 0.72, 4.0]), reflectance=0.75)
    return Model("Rocaille stove", (*pieces, *others), (floor, wall))


def stove_scene(*, changes: Sequence[Edit] = (), cell: float = 0.004) -> Scene:
    """Return the Rocaille stove before a wall, as it stands after `changes`; see `stove_model` for its parts."""
    return build_scene(stove_model(cell=cell), changes)


def rebuild_stove(model: Model, *, seed: int, typical: float = 0.006, largest: float = 0.035) -> tuple[Edit, ...]:
    """Return the changes of a stove that was taken down and set up again: every piece a little off.

    Paper 002, fig. 3: after the restoration pieces stood up to 35 mm from where they had been.

    Parameters
    ----------
    model : of `stove_model`, or some of its pieces.
    seed : of the shifts.
    typical : m, median length of a piece's shift; lengths are spread as a Rayleigh distribution is, directions evenly.
    largest : m, to which longer shifts are cut; one piece is shifted by all of it.

    Returns
    -------
    One motion for each piece, with turns of up to a shift of `typical` over a piece's half length of 15 cm. Pieces may
    reach into one another by it. The stove also stood elsewhere in the room: add `move_whole` as the last change.
    """
    rng = np.random.default_rng([seed, 35])
    pieces = [part for part in model.parts if part.name.startswith("piece")]
    length = np.minimum(rng.rayleigh(typical / np.sqrt(2.0 * np.log(2.0)), len(pieces)), largest)
    length[rng.integers(len(pieces))] = largest
    towards = rng.normal(size=(len(pieces), 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    turns = rng.uniform(-typical / 0.15, typical / 0.15, (len(pieces), 3)) / np.sqrt(3.0)
    return tuple(
        move_part(
            f"{part.name} set anew", part.name,
            perturb(np.eye(4), part.bounds().mean(axis=0), np.concatenate([turns[k], length[k] * towards[k]])),
        )
        for k, part in enumerate(pieces)
    )  # fmt: skip
