"""Where a region lies, in words: what goes all round is not said to lie on one side, what looks to one side is."""

import numpy as np
import pandas as pd
import pytest
import trimesh

from projects.model import REGION_COLUMNS, Assessment, ComparedSurface, Comparison, Registration, Surface
from reports.cameras import choose_views, find_front
from reports.whereabouts import Setting, locate, say_place, say_where, setting_of

OBJECT = Setting(np.array([0.0, -1.0, 0.0]), np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 2.0]]), is_room=False)
ROOM = Setting(np.array([0.0, -1.0, 0.0]), np.array([[-2.0, -1.5, 0.0], [2.0, 1.5, 2.5]]), is_room=True)
NOTHING = Surface(np.zeros((3, 3)), np.zeros((0, 3), dtype=np.int64))


def shaft(n_sides, turned=360.0, radius=0.2, at=(0.0, 0.0, 1.0), high=0.4):
    """Return the side of a prism, or what lies within `turned` degrees about its front; it faces outwards."""
    bearing = np.radians(np.linspace(-turned, turned, n_sides + 1) / 2 - 90.0)
    ring = np.stack([radius * np.cos(bearing), radius * np.sin(bearing), 0.0 * bearing], axis=1) + at
    a = np.arange(n_sides)
    b, up = a + 1, n_sides + 1
    half = np.array([0.0, 0.0, high / 2])
    faces = np.concatenate([np.stack([a, b, b + up], axis=1), np.stack([a, b + up, a + up], axis=1)])
    return Surface(np.concatenate([ring - half, ring + half]), faces)


def limb():
    """Return a round limb that stands out to the right of someone before the front, but for where it joins."""
    bar = trimesh.creation.cylinder(0.05, 0.5, transform=trimesh.geometry.align_vectors([0, 0, 1], [1, 0, 0]))
    faces = np.asarray(bar.faces)[bar.face_normals[:, 0] > -0.9]
    return Surface(np.asarray(bar.vertices) + np.array([0.45, 0.0, 1.5]), faces)


def fracture():
    """Return what is left where the limb was: a patch that faces to the right."""
    corners = np.array([[0.2, -0.05, 1.45], [0.2, 0.05, 1.45], [0.2, 0.05, 1.55], [0.2, -0.05, 1.55]])
    return Surface(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def where(reference, compared, place, setting=OBJECT):
    """Return the words for region 1, which is all of two surfaces."""
    sides = [ComparedSurface(s, np.full(n, 1e-3), np.full(n, 1e-4), np.full(n, Assessment.CHANGED, dtype=np.uint8),
                             np.ones(n, dtype=np.int32), np.zeros(n, dtype=np.uint8))
             for s, n in ((s, len(s.vertices)) for s in (compared, reference))]  # fmt: skip
    registration = Registration(np.eye(4), 1e-12 * np.eye(6), np.zeros(3), converged=True)
    comparison = Comparison(*sides, pd.DataFrame(columns=list(REGION_COLUMNS)), registration, "relative", {})
    return locate(comparison, 1, np.asarray(place), setting).replace("\u202f", " ").replace("\xa0", " ")


@pytest.mark.parametrize(("n_sides", "turned", "told"), [
    (4, 360.0, "all round"), (36, 360.0, "all round"), (36, 300.0, "all round"), (3, 270.0, "front"),
    (36, 180.0, "front"), (1, 20.0, "front"),
])  # fmt: skip
def test_a_band_round_a_shaft_is_all_round_and_three_sides_of_a_pillar_are_not(n_sides, turned, told):
    """Whose coat covers 300 of 360 degrees is coated all round; a pillar has a front that is not its back."""
    before, after = (shaft(n_sides, turned, radius) for radius in (0.2, 0.201))
    assert where(before, after, [0.0, 0.0, 1.0]) == f"{told}, 1.00 m above the base"


def test_what_goes_round_one_of_two_columns_is_said_to_lie_on_its_side_of_the_object():
    there = [0.3, 0.0, 1.0]
    assert where(shaft(36, at=there), shaft(36, at=there), there) == "all round, to the right, 1.00 m above the base"


@pytest.mark.parametrize("left", [fracture(), NOTHING])
def test_a_limb_that_is_gone_lies_where_it_joined(left):
    """Its own surface looks in all directions; what is told is on which side of the object it was."""
    assert where(limb(), left, [0.45, 0.0, 1.5]) == "right side, 1.50 m above the base"
    assert where(left, limb(), [0.45, 0.0, 1.5]) == "right side, 1.50 m above the base"


@pytest.mark.parametrize(("n_sides", "radius", "place", "told"), [
    (4, 2.0, [0.0, 0.0, 1.2], "walls all round"), (36, 1.5, [0.0, 0.0, 1.2], "walls all round"),
    (4, 2.0, [0.9, 0.0, 1.2], "walls all round"),
])  # fmt: skip
def test_walls_all_round_a_room_have_neither_a_side_nor_a_left_and_right(n_sides, radius, place, told):
    walls = shaft(n_sides, radius=radius, at=(0.0, 0.0, 1.2))
    inwards = Surface(walls.vertices, walls.faces[:, ::-1])
    assert where(inwards, inwards, place, ROOM) == f"{told}, 1.20 m above the floor"


@pytest.mark.parametrize("at", [(0.0, 0.0, 1.2), (1.7, 0.0, 1.2)])
def test_a_pillar_coated_all_round_stands_within_the_room(at):
    side = " to the right," if at[0] > 0 else ""
    assert where(shaft(36, at=at), shaft(36, at=at), at, ROOM) == f"within the room,{side} 1.20 m above the floor"


@pytest.mark.parametrize(("side", "place", "setting", "told"), [
    ("floor", [1.5, 0.0, -0.01], ROOM, "floor, to the right"), ("ceiling", [0.0, 0.0, 2.39], ROOM, "ceiling"),
    ("wall to the left", [0.0, 0.0, -0.01], ROOM, "wall to the left, 10 mm below the floor"),
    ("wall to the left", [0.0, 0.0, -0.0004], ROOM, "wall to the left, 0 mm above the floor"),
])  # fmt: skip
def test_nothing_is_said_to_lie_a_negative_height_above_the_floor(side, place, setting, told):
    """A floor that sank lay "−10 mm above the floor", and the ceiling of a hall 9 m above it."""
    assert say_place(side, np.array(place), setting).replace("\u00a0", " ") == told


@pytest.mark.parametrize(("degrees", "told"), [
    (None, "right side"), (180.0, "right side"), (0.0, "left side"), (90.0, "front, to the left"),
    (270.0, "back, to the right"), (45.0, "front left"),
])  # fmt: skip
def test_a_side_is_named_from_the_front_that_was_given(degrees, told):
    """The fracture faces +x, on a shaft that is round in plan: its guessed front is at -y."""
    body = shaft(36, radius=0.5, high=2.0)
    setting = setting_of(body, None if degrees is None else np.radians(degrees))
    assert where(fracture(), fracture(), [0.2, -0.3, 1.5], setting) == f"{told}, 1.50 m above the base"


def slab(turned, sides=(2.0, 0.8, 0.15), rough=0.002):
    """Return a rough slab on the ground, turned in plan by so many degrees; its underside was not recorded."""
    body = trimesh.creation.box(sides).subdivide().subdivide().subdivide().subdivide()
    faces = np.asarray(body.faces)[body.face_normals[:, 2] > -0.5]
    turn = trimesh.transformations.rotation_matrix(np.radians(turned), [0, 0, 1])[:3, :3]
    noise = np.random.default_rng(4).normal(0.0, rough, np.shape(body.vertices))
    return Surface((np.asarray(body.vertices) + noise) @ turn.T + [300.0, 200.0, 5.0], faces)


@pytest.mark.parametrize(
    ("turned", "front"), [(0.0, 270.0), (25.0, 295.0), (-25.0, 245.0), (70.0, 250.0), (90.0, 270.0)]
)
def test_the_view_from_above_of_what_lies_flat_stands_square_to_its_long_side(turned, front):
    surface = slab(turned)
    top = next(view for view in choose_views(surface) if view.name == "top")
    bearing = np.degrees(np.arctan2(*find_front(surface)[1::-1])) % 360.0
    assert bearing == pytest.approx(front, abs=1.0)
    assert top.up == pytest.approx(-find_front(surface))


def test_a_round_plate_on_the_ground_has_its_front_at_minus_y():
    plate = trimesh.creation.cylinder(0.5, 0.05, sections=97)
    assert find_front(Surface(np.asarray(plate.vertices), np.asarray(plate.faces))).tolist() == [0.0, -1.0, 0.0]


def test_a_place_on_what_lies_flat_is_told_by_its_plan():
    """The front is the lower edge of the view from above; without, all places were "top" and a height."""
    setting = setting_of(slab(25.0))
    up, turn = np.array([0.0, 0.0, 1.0]), np.radians(25.0)
    along, across = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([-np.sin(turn), np.cos(turn), 0.0])
    told = [
        say_where(up, np.array([300.0, 200.0, 5.075]) + x * along + y * across, setting).partition(", 1")[0]
        for x, y in ((0.0, 0.0), (-0.5, 0.0), (0.5, 0.25), (0.0, -0.25))
    ]
    assert told == ["top, in the middle", "top, to the left", "top, to the right, towards the back",
                    "top, towards the front"]  # fmt: skip
    assert say_where(-across, np.array([300.0, 200.0, 5.0]), setting).startswith("front, ")
    assert say_where(up, np.zeros(3), OBJECT).startswith("top, 0")  # of what stands, as before
