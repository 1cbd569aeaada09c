"""Pictures looked at by value: colours, hatch, scale bar, numbers and framing are where the truth says."""

import dataclasses
import io

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage
from small_comparison import DEPTH, FRONT, RADIUS, RIGHT, make_comparison

from projects.errors import ParameterError
from projects.model import Surface
from reports import pictures
from reports.annotations import (
    Label,
    annotate,
    bar_length,
    bar_place,
    label_radius,
    place_labels,
    say_length,
    text_height,
)
from reports.cameras import Frame, all_views, choose_views, find_front, frame_views, project_points
from reports.lighting import SUBPIXELS
from reports.raycast import build_scene, cast_view
from reports.shading import DOT_PERIOD, DOT_RADIUS, HATCH_PERIOD
from reports.views import _say_change, draw_close_up, draw_comparison, draw_difference, draw_surface

SIZE = 340  # pixels


def pixels_of(picture):
    """Return the pixels of a finished or a shown picture."""
    return np.asarray(Image.open(io.BytesIO(picture.image))).astype(int)


def colour_at(picture, frame, place, half=2):
    """Return the mean colour of the pixels about a point of the object."""
    x, y, _ = project_points(frame, place[None])[0]
    return pixels_of(picture)[int(y) - half : int(y) + half + 1, int(x) - half : int(x) + half + 1].mean(axis=(0, 1))


def plate(towards, up=(0.0, 0.0, 1.0)):
    """Return a square of 1 m that faces a direction."""
    right = np.cross(up, towards)
    corners = [s * right + t * np.array(up) for s, t in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))]
    return Surface(np.array(corners), np.array([[0, 1, 2], [0, 2, 3]]))


@pytest.fixture(scope="module")
def comparison():
    return make_comparison()


@pytest.fixture(scope="module")
def drawn(comparison):
    return {p.view.name: p for p in draw_comparison(comparison, height_px=SIZE)}


@pytest.fixture(scope="module")
def frames(comparison):
    surfaces = [comparison.on_reference.surface, comparison.on_compared.surface]
    views = choose_views(surfaces[0])
    return {f.name: f for f in frame_views(views, surfaces, longest_px=SIZE)}


def test_ball_is_drawn_from_four_sides(drawn):
    assert list(drawn) == ["front", "right", "back", "left"]


def test_gained_patch_is_blue_and_lost_patch_red_at_their_pixels(drawn, frames):
    gained = colour_at(drawn["front"].difference, frames["front"], FRONT * (RADIUS + 0.8 * DEPTH) + [0, 0, 0.008])
    lost = colour_at(drawn["right"].difference, frames["right"], RIGHT * (RADIUS - 0.8 * DEPTH) + [0, 0, 0.008])
    assert gained[2] > gained[0] + 60
    assert lost[0] > lost[2] + 60


def test_unchanged_is_grey_and_stone_is_warm(drawn, frames):
    place = np.array([0.3, -0.8, -0.52]) * RADIUS
    grey = colour_at(drawn["front"].difference, frames["front"], place)
    stone = colour_at(drawn["front"].after, frames["front"], place)
    assert np.ptp(grey) < 10
    assert 8 < stone[0] - stone[2] < 50


def test_not_assessable_is_hatched_with_its_period(drawn, frames):
    picture, frame = pixels_of(drawn["left"].difference), frames["left"]
    row = picture[frame.height // 2 - frame.foot // 2, :, 1].astype(float)
    middle = row[frame.width // 2 - 36 : frame.width // 2 + 36]
    power = np.abs(np.fft.rfft(middle - middle.mean()))
    assert 72 / power[1:].argmax() == pytest.approx(HATCH_PERIOD, abs=1.5)
    assert np.ptp(middle) > 50
    stone = pixels_of(drawn["left"].after)[frame.height // 2 - frame.foot // 2, :, 1]
    assert np.ptp(stone[frame.width // 2 - 36 : frame.width // 2 + 36]) < 40  # no hatch there


def test_unchanged_places_that_tell_only_large_changes_are_dotted(comparison, drawn, frames):
    side, frame = comparison.on_compared, frames["back"]
    below = side.surface.vertices[:, 2] < 0.0
    known = dataclasses.replace(side, told_from=np.where(below, 0.01, 0.001), coarse_from=0.005)
    picture = draw_difference(known, choose_views(comparison.on_reference.surface)[2], limit_m=DEPTH, frame=frame)
    plain = draw_difference(side, choose_views(comparison.on_reference.surface)[2], limit_m=DEPTH, frame=frame)
    darker = (pixels_of(plain) - pixels_of(picture)).max(axis=-1) > 25
    middle = int(project_points(frame, np.zeros((1, 3)))[0][1])
    assert not darker[: middle - 3].any()
    share = darker[middle + 15 : middle + 60, frame.width // 2 - 40 : frame.width // 2 + 40].mean()
    assert share == pytest.approx(np.pi * DOT_RADIUS**2 / DOT_PERIOD**2, rel=0.3)
    rows = darker[middle + 15 : middle + 15 + 48].mean(axis=1)
    assert 48 / (1 + np.abs(np.fft.rfft(rows))[1:].argmax()) == pytest.approx(DOT_PERIOD, abs=0.9)


def test_what_only_the_reference_has_is_drawn_pale_beyond_the_outline(drawn, frames):
    place = RIGHT * (RADIUS - 0.3 * DEPTH)
    ghost = colour_at(drawn["front"].difference, frames["front"], place, half=0)
    after = colour_at(drawn["front"].after, frames["front"], place, half=0)
    assert after.min() > 250  # paper
    assert ghost[0] - ghost[2] > 20  # the colour of loss


def test_regions_are_named_in_the_views_that_show_them(drawn):
    seen = {name: p.difference.visible_regions for name, p in drawn.items()}
    assert seen["front"] == (1,)
    assert 2 in seen["right"]
    assert 2 not in seen["left"]
    assert seen["back"] == ()
    assert drawn["front"].difference.alt.endswith("regions seen: 1")


def test_a_region_of_which_little_is_seen_is_not_said_to_be_unseen():
    frame = frame_views([all_views(FRONT)[0]], [plate(FRONT)], longest_px=60)[0]
    none, little = np.zeros((60, 60), dtype=np.int32), np.zeros((60, 60), dtype=np.int32)
    little[:4, :4] = 3
    assert _say_change(frame, none, none) == "Change as colours, Front; no change region is seen"
    assert _say_change(frame, none, little).endswith("; only small parts of regions are seen: 3")
    room = dataclasses.replace(frame, name="left", cut_away=True)
    assert _say_change(room, little, little) == "Change as colours, Wall to the right; regions seen: 3"


def lettering_of(picture):
    """Return the height [pixels] of the capitals and figures beside the scale bar of a picture."""
    foot = pixels_of(picture)[-round(0.06 * max(picture.width, picture.height)) :].max(axis=2) < 110
    columns, n = ndimage.label(foot.any(axis=0))
    parts = [foot[:, columns == k].any(axis=1) for k in range(2, n + 1)]  # the first is the bar
    rows = np.nonzero(np.any(parts, axis=0))[0]
    return rows.max() - rows.min() + 1


def test_letters_in_pictures_are_large_enough_to_be_read_on_paper(comparison, monkeypatch):
    """On A4 they were 3.3 to 5 points high, in close-ups 3.5: capitals are 0.73 of that, of DejaVu Sans."""
    monkeypatch.setattr(pictures, "PIXELS", 4e5)
    shown = pictures.draw_change(comparison)
    view, near = shown.views[0], shown.regions[1][0]
    text = 174.0 / 25.4 * 72.0
    printed = [(view.difference, 0.00985 * view.wide), (view.difference, 0.0086 * view.narrow), (near, 0.29)]
    for picture, share in printed:
        assert lettering_of(picture) / picture.width * share * text >= 0.73 * 6.0 * 0.95  # a pixel is a twentieth


def test_label_is_drawn_where_it_is_placed(comparison, drawn, frames):
    plain = draw_difference(comparison.on_compared, choose_views(comparison.on_reference.surface)[0], limit_m=DEPTH,
                            frame=frames["front"], other=comparison.on_reference, label=False)  # fmt: skip
    altered = np.abs(pixels_of(plain) - pixels_of(drawn["front"].difference)).max(axis=-1) > 60
    rows, columns = np.nonzero(altered)
    x, y, _ = project_points(frames["front"], (FRONT * RADIUS)[None])[0]
    assert np.hypot(columns - x, rows - y).min() < 3  # the leader's dot
    assert np.hypot(columns - x, rows - y).max() > 2 * label_radius(frames["front"])
    assert altered.sum() > 80


def test_before_after_and_difference_are_framed_alike(drawn, frames):
    for name, p in drawn.items():
        three = (p.before, p.after, p.difference)
        assert len({(q.width, q.height, q.metres_per_pixel) for q in three}) == 1
        assert (p.before.width, p.before.height) == (frames[name].width, frames[name].height)
        paper = [(pixels_of(q).min(axis=-1) > 250) for q in three]
        assert (paper[0] != paper[1]).mean() < 0.015  # the two bumps at the outline only


def test_outline_has_its_true_place_and_size(comparison, frames):
    seen = cast_view(build_scene(comparison.on_reference.surface), frames["back"])
    columns = np.nonzero(seen.hit.any(axis=0))[0]
    width = (np.ptp(columns) + 1) / SUBPIXELS * frames["back"].metres_per_pixel
    assert width == pytest.approx(np.ptp(comparison.on_reference.surface.vertices[:, 0]), abs=0.002)
    rows = np.nonzero(seen.hit.any(axis=1))[0]  # nothing is lost to the strip below, which is the scale bar's
    height = (np.ptp(rows) + 1) / SUBPIXELS * frames["back"].metres_per_pixel
    assert height == pytest.approx(np.ptp(comparison.on_reference.surface.vertices[:, 2]), abs=0.002)


def test_scale_bar_is_as_long_as_it_says(drawn, frames):
    frame = frames["back"]
    _, top, right, bottom = bar_place(frame)
    dark = pixels_of(drawn["back"].difference)[round((top + bottom) / 2) - 2 : round((top + bottom) / 2) + 3] < 130
    columns = np.nonzero(dark.all(axis=-1).any(axis=0))[0]
    columns = columns[columns < right + 4]
    length = (np.ptp(columns) + 1) * frame.metres_per_pixel
    assert length == pytest.approx(bar_length(frame), abs=1.6 * frame.metres_per_pixel)
    assert say_length(bar_length(frame)) == "5 cm"


def pillar(across):
    """Return a pillar 1 m tall and `across` m wide and deep, without a foot and a head."""
    x, y, z = (a.ravel() for a in np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [0.0, 1.0], indexing="ij"))
    around = [0, 4, 6, 2]
    faces = [[a, b, b + 1] for a, b in zip(around, around[1:] + around[:1], strict=True)]
    faces += [[a, b + 1, a + 1] for a, b in zip(around, around[1:] + around[:1], strict=True)]
    return Surface(np.column_stack([across * x, across * y, z]), np.array(faces))


@pytest.mark.parametrize(("across", "said"), [(0.3, "20 cm"), (0.06, "5 cm"), (0.02, "2 cm")])
def test_bars_letters_and_circles_are_alike_in_pictures_at_one_scale(across, said):
    """The top of a pillar is a small picture: its own letters would be a third as tall as those beside it."""
    surface = pillar(across)
    views = [v for v in all_views(np.array([0.0, -1.0, 0.0])) if v.name in ("front", "top")]
    front, top = frame_views(views, [surface], longest_px=1600)
    assert top.height < 0.5 * front.height
    assert text_height(top) == pytest.approx(text_height(front))
    assert label_radius(top) == pytest.approx(label_radius(front))
    assert say_length(bar_length(top)) == say_length(bar_length(front)) == said
    for frame in (front, top):
        drawn = annotate(np.full((frame.height, frame.width, 3), 255, np.uint8), frame, [])
        columns = np.nonzero((drawn < 200).any(axis=(0, 2)))[0]
        assert columns.max() < frame.width - 2  # the text is not cut off
        assert columns.max() > bar_place(frame)[2] + 1.5 * text_height(frame)


@pytest.mark.parametrize(("metres", "text"), [(2.0, "2 m"), (0.2, "20 cm"), (0.01, "1 cm"), (0.005, "5 mm"),
                                              (0.0005, "0.5 mm")])  # fmt: skip
def test_lengths_are_said_in_the_unit_that_reads_best(metres, text):
    assert say_length(metres) == text


def test_labels_touch_neither_each_other_nor_the_edge_nor_the_scale_bar():
    frame = Frame("front", np.zeros(3), *np.eye(3), 0.001, 600, 500, foot=36)
    numbers = np.zeros((500, 600), dtype=np.int32)
    for k in range(9):
        numbers[180 + 30 * (k // 3) : 190 + 30 * (k // 3), 270 + 30 * (k % 3) : 280 + 30 * (k % 3)] = k + 1
    labels = place_labels(numbers, np.ones((500, 600), dtype=bool), frame)
    radius = label_radius(frame)
    centres = np.array([label.centre for label in labels])
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)[np.triu_indices(len(labels), 1)]
    assert len(labels) == 9
    assert apart.min() > 2 * radius
    assert centres.min() > radius
    assert centres[:, 1].max() < 500 - radius
    assert all(numbers[int(label.anchor[1]), int(label.anchor[0])] == label.number for label in labels)
    assert not any(crosses(a, b) for k, a in enumerate(labels) for b in labels[:k])


def crosses(one: Label, other: Label) -> bool:
    """Whether two leader lines cross, by solving for the point."""
    a, b, c, d = (np.array(v) for v in (one.anchor, one.centre, other.anchor, other.centre))
    s, t = np.linalg.solve(np.stack([b - a, c - d], axis=1), c - a)
    return bool(0 < s < 1 and 0 < t < 1)


def test_region_of_a_few_pixels_is_not_numbered():
    frame = Frame("front", np.zeros(3), *np.eye(3), 0.001, 200, 200)
    numbers = np.zeros((200, 200), dtype=np.int32)
    numbers[100, 100:104] = 1
    assert place_labels(numbers, numbers > 0, frame) == []


@pytest.mark.parametrize("angle", [0.0, 12.0, 133.0, 250.0])
def test_relief_is_seen_square_on_and_from_its_front_alone(angle):
    towards = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0])
    assert find_front(plate(towards)) @ towards > np.cos(np.radians(0.6))
    assert [v.name for v in choose_views(plate(towards))] == ["front"]


def test_floor_is_seen_from_its_top_and_ceiling_from_below():
    for z, name in ((1.0, "top"), (-1.0, "below")):
        assert [v.name for v in choose_views(plate((0.0, 0.0, z), up=(0.0, 1.0, 0.0)))] == [name]


def test_a_relief_that_lies_is_seen_from_its_top_alone_and_not_along_it():
    x, y = np.meshgrid(np.linspace(0.0, 0.5, 101), np.linspace(0.0, 0.3, 61), indexing="ij")
    bosses = 0.02 * np.sin(60.0 * x) * np.sin(60.0 * y)  # slopes of up to 50 degrees look to all four sides
    vertices = np.stack([x.ravel(), y.ravel(), bosses.ravel()], axis=1)
    i, j = np.meshgrid(np.arange(100), np.arange(60), indexing="ij")
    a = (i * 61 + j).ravel()
    faces = np.concatenate([np.stack([a, a + 61, a + 62], axis=1), np.stack([a, a + 62, a + 1], axis=1)])
    assert [v.name for v in choose_views(Surface(vertices, faces))] == ["top"]


def test_round_object_has_its_front_towards_minus_y(comparison):
    np.testing.assert_array_equal(find_front(comparison.on_reference.surface), [0.0, -1.0, 0.0])


@pytest.mark.parametrize(("degrees", "towards"), [
    (0.0, (0.0, 1.0)), (90.0, (1.0, 0.0)), (180.0, (0.0, -1.0)), (270.0, (-1.0, 0.0)), (30.0, (0.5, np.sqrt(0.75))),
])  # fmt: skip
def test_given_front_is_a_bearing_clockwise_from_plus_y(comparison, degrees, towards):
    surface = comparison.on_reference.surface
    views = {v.name: v.towards for v in choose_views(surface, np.radians(degrees))}
    np.testing.assert_allclose(views["front"], [*towards, 0.0], atol=1e-11)
    np.testing.assert_allclose(views["back"], [-towards[0], -towards[1], 0.0], atol=1e-11)
    # at the right hand of someone who looks along -towards
    np.testing.assert_allclose(views["right"], [-towards[1], towards[0], 0.0], atol=1e-11)


def test_relief_whose_front_is_said_to_be_behind_it_is_seen_from_its_back():
    (view,) = choose_views(plate(np.array([0.0, -1.0, 0.0])), 0.0)
    assert view.name == "back"
    np.testing.assert_allclose(view.towards, [0.0, -1.0, 0.0], atol=1e-11)


def test_close_up_is_centred_on_its_region_and_framed_two_to_three_times_its_size(comparison):
    for number, hot, cold in ((1, 2, 0), (2, 0, 2)):
        picture = draw_close_up(comparison, number, limit_m=DEPTH, height_px=SIZE)
        shown = pixels_of(picture)
        foot = round(0.1 * picture.height)
        middle = shown[(picture.height - foot) // 2, picture.width // 2]
        assert middle[hot] > middle[cold] + 50
        changed = comparison.on_compared.surface.vertices[comparison.on_compared.region == number]
        extent = max(np.ptp(changed[:, 2]), np.ptp(changed[:, 2 - number]))  # across its normal
        assert 2.0 < (picture.height - foot) * picture.metres_per_pixel / extent < 3.0
        assert picture.visible_regions == (number,)


def test_close_up_of_an_unknown_region_says_which_there_are(comparison):
    with pytest.raises(ParameterError, match=r"region 7 .* 1 to 2"):
        draw_close_up(comparison, 7)


def test_hollow_is_darker_than_the_open_surface():
    """Ambient occlusion: the bottom of a narrow slot sees less of the sky than the face beside it."""
    x = np.array([-1, -0.05, -0.05, 0.05, 0.05, 1])
    z = np.array([0, 0, -0.4, -0.4, 0, 0])
    low, high = (np.stack([x, np.full(6, y), z], axis=1) for y in (-1.0, 1.0))
    faces = [f for k in range(5) for f in ([k, k + 1, k + 7], [k, k + 7, k + 6])]
    slot = Surface(np.concatenate([low, high]), np.array(faces))
    view = choose_views(slot)[0]
    assert view.name == "top"
    frame = frame_views([view], [slot], longest_px=SIZE)[0]
    seen = cast_view(build_scene(slot), frame)
    x, y = (project_points(frame, np.array([[0.0, 0, -0.4], [0.5, 0, 0]])) * SUBPIXELS).astype(int).T[:2]
    sky = seen.sky[y, x]
    assert sky[1] > 0.95
    assert sky[0] < 0.6


def test_same_surface_gives_the_same_bytes(comparison):
    view = choose_views(comparison.on_reference.surface)[0]
    one, two = (draw_surface(comparison.on_reference.surface, view, height_px=200) for _ in range(2))
    assert one == two
    assert max(one.width, one.height) <= 200


def test_a_hole_that_was_closed_is_hatched_and_not_drawn_as_stone(comparison):
    surface = plate(FRONT)
    view = choose_views(comparison.on_reference.surface)[0]
    (frame,) = frame_views([view], [surface], longest_px=SIZE)
    half = dataclasses.replace(surface, face_invented=np.array([False, True]))
    first, second = (surface.vertices[faces].mean(axis=0) for faces in surface.faces)
    plain, closed = (pixels_of(draw_surface(s, view, frame=frame)) for s in (surface, half))
    spread = {}
    for name, place in (("measured", first), ("invented", second)):
        x, y, _ = project_points(frame, place[None])[0].astype(int)
        at = np.s_[y - 10 : y + 11, x - 10 : x + 11]
        spread[name] = closed[at].std(axis=(0, 1)).max()
        assert plain[at].std(axis=(0, 1)).max() < 3.0
    assert spread["measured"] < 3.0
    assert spread["invented"] > 10.0
