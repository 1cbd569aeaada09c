"""A room is looked at from within: each wall, floor and ceiling, what stood free in it, and words for all of them."""

import io

import numpy as np
import pandas as pd
import pytest
import trimesh
from PIL import Image

from projects.model import REGION_COLUMNS, Assessment, ComparedSurface, Comparison, NotAssessed, Registration, Surface
from reports.cameras import choose_views, frame_views, project_points
from reports.colours import choose_limit
from reports.raycast import build_scene, cast_view
from reports.views import draw_comparison
from reports.whereabouts import locate, setting_of

SIZE = np.array([4.0, 3.0, 2.5])  # m; x to the right of someone who looks to +y
CHEST = np.array([0.8, 0.2, 0.0])  # middle of its foot
IN_IT = CHEST + np.array([0.2, 0.0, 0.6])
WORN = np.array([-1.0, 0.5 * SIZE[1], 1.5])  # on the wall at +y, which faces -y, the front
DEPTH = 0.005


def walls():
    """Return vertices and faces of the room, its floor at 0, all looking inwards."""
    box = trimesh.creation.box(SIZE)
    for _ in range(5):
        box = box.subdivide()
    return np.asarray(box.vertices) + np.array([0.0, 0.0, 0.5 * SIZE[2]]), np.asarray(box.faces)[:, ::-1]


@pytest.fixture(scope="module")
def comparison():
    """The chest is gone (region 1), a place on the wall ahead is worn by 5 mm (region 2)."""
    vertices, faces = walls()
    box = trimesh.creation.box([0.6, 0.4, 0.8])
    chest = np.asarray(box.vertices) + CHEST + [0.0, 0.0, 0.41]
    worn = np.linalg.norm(vertices - WORN, axis=1) < 0.3
    n, m = len(vertices), len(chest)
    change = np.r_[np.where(worn, -DEPTH, 0.0), np.full(m, -0.9)]
    region = np.r_[np.where(worn, 2, 0), np.ones(m)].astype(np.int32)
    state = np.where(region > 0, Assessment.CHANGED, Assessment.UNCHANGED).astype(np.uint8)
    reasons = np.r_[np.zeros(n), np.full(m, NotAssessed.LOOKED_THROUGH)].astype(np.uint8)
    before = Surface(np.r_[vertices, chest], np.r_[faces, np.asarray(box.faces) + n])
    sides = [
        ComparedSurface(surface, change[:k], np.full(k, 0.001), state[:k], region[:k], reasons[:k])
        for surface, k in ((before, n + m), (Surface(vertices, faces), n))
    ]
    rows = [[number, "lost", 0.3, 1e-3, -1e-3, 1e-4, -DEPTH, 1e-3, -DEPTH, 1e-3, *place]
            for number, place in ((1, IN_IT), (2, WORN))]  # fmt: skip
    registration = Registration(np.eye(4), 1e-12 * np.eye(6), np.zeros(3), converged=True)
    table = pd.DataFrame(rows, columns=list(REGION_COLUMNS))
    return Comparison(sides[1], sides[0], table, registration, "relative", {"lod95_median_m": 0.001})


def test_all_six_sides_of_a_room_are_seen_from_within(comparison):
    surface = comparison.on_compared.surface
    views = choose_views(surface)
    assert [v.name for v in views] == ["front", "right", "back", "left", "top", "below"]
    assert all(v.cut_away for v in views)
    scene = build_scene(surface)
    for view, frame in zip(views, frame_views(views, [surface], longest_px=300), strict=True):
        seen = cast_view(scene, frame)
        assert not seen.inside.any()
        extent = np.abs(view.towards) @ SIZE  # the far wall alone is seen, half of the room behind the middle
        np.testing.assert_allclose(seen.depth[seen.hit], -0.5 * extent, atol=1e-3)


def test_the_same_box_that_looks_outwards_is_no_room():
    vertices, faces = walls()
    views = choose_views(Surface(vertices, faces[:, ::-1]))
    assert len(views) == 6
    assert not any(v.cut_away for v in views)


def test_what_is_gone_is_drawn_pale_before_the_wall_behind_it(comparison):
    views = choose_views(comparison.on_reference.surface)
    front = draw_comparison(comparison, views[:1], height_px=500)[0]
    surfaces = [comparison.on_reference.surface, comparison.on_compared.surface]
    frame = frame_views(views[:1], surfaces, longest_px=500)[0]
    picture = np.asarray(Image.open(io.BytesIO(front.difference.image))).astype(int)

    def colour(place):
        x, y, _ = project_points(frame, np.asarray(place)[None])[0]
        return picture[int(y) - 2 : int(y) + 3, int(x) - 2 : int(x) + 3].mean(axis=(0, 1))

    gone, wall, worn = colour(IN_IT), colour([-1.0, 1.5, 0.5]), colour(WORN + np.array([0.15, 0.0, 0.0]))
    assert np.ptp(wall) < 10
    assert gone[0] - gone[2] > 15
    assert wall.mean() - gone.mean() > 50
    assert worn[0] - worn[2] > 60  # darkest: the chest's 0.9 m do not stretch the colours
    assert front.difference.visible_regions == (1, 2)


def test_colours_end_at_what_is_worn_and_not_at_the_way_behind_what_is_gone(comparison):
    assert choose_limit(comparison) == pytest.approx(DEPTH)


@pytest.mark.parametrize(("number", "place", "told"), [
    (1, IN_IT, "within the room, to the right, 60 cm above the floor"),
    (2, WORN, "wall ahead, to the left, 1.50 m above the floor"),
])  # fmt: skip
def test_places_in_a_room_are_told_by_its_walls(comparison, number, place, told):
    where = locate(comparison, number, place, setting_of(comparison.on_reference.surface))
    assert where.replace("\u202f", " ").replace("\xa0", " ") == told


@pytest.mark.parametrize(("degrees", "told"), [
    (180.0, "wall ahead, to the left"), (0.0, "wall behind, to the right"), (90.0, "wall to the right"),
    (270.0, "wall to the left"),
])  # fmt: skip
def test_wall_ahead_is_the_one_that_faces_as_was_given(comparison, degrees, told):
    """What is worn is on the wall at +y, which faces -y, to the south; the western wall, at -x, faces east."""
    surface = comparison.on_reference.surface
    where = locate(comparison, 2, WORN, setting_of(surface, np.radians(degrees)))
    assert where.replace("\u202f", " ").replace("\xa0", " ") == f"{told}, 1.50 m above the floor"
    first = choose_views(surface, np.radians(degrees))[0]
    assert (first.name, first.cut_away) == ("front", True)
    bearing = np.degrees(np.arctan2(first.towards[0], first.towards[1])) % 360.0
    assert bearing == pytest.approx(degrees, abs=1e-9)
