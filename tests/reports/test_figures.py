"""Charts by value: what the plane cuts, what is written, and that the same input gives the same bytes."""

import dataclasses
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from small_comparison import DEPTH, FRONT, LEVEL, PATCH, RADIUS, RIGHT, make_comparison

from projects.errors import ParameterError
from projects.triangles import vertex_areas
from reports import figures, pictures
from reports.colours import HATCH_DARK
from reports.drawing import WIDTH, drawing, even_numbers, say_mm
from reports.figures import (
    TALLEST,
    WIDE,
    _add_states,
    _name_largest,
    _say_beyond,
    draw_colour_bar,
    draw_histogram,
    draw_section,
    heights_shown,
    profile_height,
    span_for,
)
from reports.sections import SectionLine, SectionPlane, choose_plane, cut_comparison, cut_side, region_areas


@pytest.fixture(scope="module")
def comparison():
    return make_comparison()


def words(drawing: bytes) -> list[str]:
    """Return the texts of an SVG, which matplotlib names in comments beside their outlines."""
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    root = ElementTree.fromstring(drawing, parser)
    return [e.text.strip() for e in root.iter() if e.tag is ElementTree.Comment]


def test_plane_cuts_a_ball_in_a_closed_circle(comparison):
    side = comparison.on_reference
    plane = SectionPlane(np.array([0.0, 0.0, 0.0007]), RIGHT, FRONT, 0.0, 0.0, np.inf)
    line = cut_side(side, plane, 1)
    radius = np.linalg.norm(line.ends, axis=-1)
    assert np.abs(radius - RADIUS).max() < 0.0015  # the ball's own undulation is 1 mm
    length = np.linalg.norm(line.ends[:, 1] - line.ends[:, 0], axis=-1).sum()
    assert length == pytest.approx(2 * np.pi * RADIUS, rel=0.01)
    _, count = np.unique(np.rint(line.ends.reshape(-1, 2) / 1e-9).astype(np.int64), axis=0, return_counts=True)
    assert (count == 2).all()  # each end is that of its neighbour


def test_change_along_the_section_is_that_of_the_surface(comparison):
    plane = choose_plane(comparison, 1)
    line = cut_side(comparison.on_compared, plane, 1)
    away = RADIUS * np.arctan2(np.abs(line.ends[..., 0]), plane.origin @ plane.outward + line.ends[..., 1])
    inside = line.in_region[:, None] & (away < 0.8 * PATCH)
    truth = DEPTH * 0.5 * (1 + np.cos(np.pi * away / PATCH))
    assert inside.sum() > 30
    np.testing.assert_allclose(line.distances[inside], truth[inside], atol=0.0004)
    assert line.lod95[inside] == pytest.approx(LEVEL)


@pytest.mark.parametrize(("number", "towards"), [(1, FRONT), (2, RIGHT)])
def test_section_holds_the_normal_and_runs_over_the_whole_region(comparison, number, towards):
    plane = choose_plane(comparison, number)
    assert plane.outward @ towards > 0.999
    assert abs(plane.along @ plane.outward) < 1e-12
    edge = PATCH / np.pi * np.arccos(2 * LEVEL / DEPTH - 1)  # where the patch is as high as its level of detection
    assert plane.high - plane.low == pytest.approx(
        2 * RADIUS * np.sin(edge / RADIUS), abs=2 * np.pi * RADIUS / 100
    )  # an edge


def test_section_runs_to_the_right_or_upwards(comparison):
    for number in (1, 2):
        plane = choose_plane(comparison, number)
        rightwards = plane.along @ np.cross([0.0, 0.0, 1.0], plane.outward)
        assert plane.along[2] > 0.8 or rightwards > 0


def test_section_shows_both_epochs_and_not_the_back(comparison):
    plane = choose_plane(comparison, 2)
    reference, compared = cut_comparison(comparison, 2, plane)
    assert reference.ends[..., 1].max() - compared.ends[..., 1].max() == pytest.approx(DEPTH, abs=0.002)
    assert min(reference.ends[..., 1].min(), compared.ends[..., 1].min()) > -RADIUS
    assert np.nanmin(compared.distances) == pytest.approx(-DEPTH, abs=0.0003)


def test_areas_of_vertices_and_regions_are_those_of_the_faces(comparison):
    side = comparison.on_reference
    assert vertex_areas(side.surface.vertices, side.surface.faces).sum() == pytest.approx(
        4 * np.pi * RADIUS**2, rel=0.01
    )
    edge = PATCH / np.pi * np.arccos(2 * LEVEL / DEPTH - 1)
    cap = 2 * np.pi * RADIUS**2 * (1 - np.cos(edge / RADIUS))
    assert region_areas(side)[1:] == pytest.approx([cap, cap], rel=0.05)


def test_colour_bar_says_millimetres_signs_and_states():
    said = words(draw_colour_bar(0.02, 0.0002, 0.0006))
    assert {"−20", "−10", "0", "+10", "+20", "lost", "gained", "not assessable"} <= set(said)
    assert "change [mm], scale of this report" in said
    assert "unchanged (up to about 0.60 mm)" in said


def test_colour_bar_says_what_dots_mean_where_there_are_any():
    said = words(draw_colour_bar(0.02, 0.0002, 0.0006, 0.0024))
    assert {"unchanged (up to about 0.60 mm)", "unchanged (up to 2.4 mm or more)", "not assessable"} <= set(said)
    assert not any("or more" in word for word in words(draw_colour_bar(0.02, 0.0002, 0.0006)))


def test_the_colour_bar_of_a_report_says_what_its_answer_says_is_told(comparison, monkeypatch):
    monkeypatch.setattr(pictures, "LARGEST", 120)
    monkeypatch.setattr(pictures, "CLOSE_UP_PIXELS", 120)
    told = {"told_by_width_m": [[0.07, 0.00049], [0.155, 0.00044]], "told_from_median_m": 0.00048}
    drawn = pictures.draw_change(dataclasses.replace(comparison, statistics={**comparison.statistics, **told}))
    assert "unchanged (up to about 0.49 mm)" in words(drawn.colour_bar.image)
    assert "from −5.0 mm (lost, red) over grey (unchanged) to +5.0 mm (gained, blue)" in drawn.colour_bar.alt
    assert drawn.histogram.alt == "Histogram of all differences, level of detection ±0.40 mm, 2 regions changed"
    assert drawn.regions[2][1].alt.endswith("the change between them: mean −2.0 mm, extreme −5.0 mm")


def test_colour_bar_without_a_level_of_detection_is_drawn():
    assert "unchanged" in words(draw_colour_bar(0.001, float("nan")))
    assert "unchanged" in words(draw_colour_bar(0.001, 0.0002))  # of an older program: not known up to what


def test_histogram_names_the_level_of_detection(comparison):
    said = words(draw_histogram(comparison))
    assert "level of detection ±0.40 mm" in said
    assert "assessed surface [%]" in said


def test_comparison_of_which_nothing_is_known_is_drawn(comparison):
    side = comparison.on_compared
    unknown = np.full(len(side.distances), np.nan)
    blank = dataclasses.replace(side, distances=unknown, lod95=unknown, assessment=np.zeros_like(side.assessment),
                                region=np.zeros_like(side.region))  # fmt: skip
    nothing = dataclasses.replace(comparison, on_compared=blank, on_reference=blank, regions=comparison.regions[:0])
    assert "assessed surface [%]" in words(draw_histogram(nothing))


def test_section_names_its_largest_change_with_sign_and_unit(comparison):
    for number, sign in ((1, "+"), (2, "−")):
        said = words(draw_section(comparison, number))
        named = [w for w in said if w.endswith(" mm") and w[0] in "+−"]
        assert len(named) == 1
        assert named[0][0] == sign
        assert float(named[0][1:-3]) == pytest.approx(DEPTH * 1000, abs=0.2)
        assert {"A", "B", "reference", "compared", "change [mm]"} <= set(said)


def test_a_section_hatches_where_its_change_is_not_assessable(comparison, monkeypatch):
    """It broke off without a word."""
    drawn = []
    monkeypatch.setattr(figures, "write_svg", lambda figure: drawn.append(figure) or b"")
    side = comparison.on_compared
    plane = choose_plane(comparison, 1)
    along = (side.surface.vertices - plane.origin) @ plane.along - plane.low
    unknown = (side.region == 1) & (along > 0.02) & (along < 0.03)
    torn = dataclasses.replace(side, distances=np.where(unknown, np.nan, side.distances))
    draw_section(dataclasses.replace(comparison, on_compared=torn), 1)
    figure = drawn[0]
    axes = figure.axes[1]
    assert "hatched: not assessable" in [t.get_text() for t in axes.texts]
    (hatched,) = (p for p in axes.patches if p.get_hatch())
    edge = 2e3 * np.pi * RADIUS / 100  # mm, an edge of the ball
    assert hatched.get_x() == pytest.approx(20.0, abs=1.5 * edge)
    assert hatched.get_x() + hatched.get_width() == pytest.approx(30.0, abs=1.5 * edge)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())[..., :3].astype(int)
    box = hatched.get_window_extent(canvas.get_renderer())
    rows, columns = (slice(int(low) + 2, int(high) - 2) for low, high in ((box.y0, box.y1), (box.x0, box.x1)))
    inside = picture[::-1][rows, columns]
    assert 0.05 < (np.abs(inside - HATCH_DARK).max(axis=2) < 40).mean() < 0.6
    whole = draw_section(comparison, 1)
    assert whole == b""
    assert not any(p.get_hatch() for p in drawn[1].axes[1].patches)


def line_of(heights: Sequence[float], region: tuple[float, float]) -> SectionLine:
    """Return a line upwards through these heights [m], in the region between two of them."""
    up = np.array(heights)
    ends = np.stack([np.column_stack([0 * up[:-1], up[:-1]]), np.column_stack([0 * up[1:], up[1:]])], axis=1)
    middle, nothing = 0.5 * (up[:-1] + up[1:]), np.zeros((len(up) - 1, 2))
    return SectionLine(ends, nothing, nothing, (middle > region[0]) & (middle < region[1]))


def test_a_profile_shows_all_of_a_lost_piece_that_is_higher_than_wide():
    before, after = line_of(np.arange(0.0, 0.061, 0.001), (0.01, 0.05)), line_of([0.0, 0.01], (0.5, 0.6))
    shown = heights_shown((before, after), 70.0)
    assert shown == pytest.approx([0.0, 60.0])  # mm, all of it
    shown = heights_shown((before, after), 30.0)
    assert shown[0] == pytest.approx(10.0)
    assert shown[1] == pytest.approx(50.0)
    span = span_for(shown)
    assert span > 30.0
    assert profile_height(shown, span) == pytest.approx(TALLEST)
    assert 40.0 * WIDE * WIDTH / span < TALLEST - 0.2  # it has room at one scale


def test_a_profile_of_an_outline_that_goes_on_shows_the_region_and_what_is_beside_it():
    endless = line_of(np.arange(-0.5, 0.5, 0.001), (0.010, 0.020))
    assert heights_shown((endless, endless), 80.0) == pytest.approx([-25.0, 55.0])
    nothing = line_of([0.0], (0.0, 0.0))
    assert len(heights_shown((nothing, nothing), 80.0)) == 0


def test_section_of_an_unknown_region_says_which_there_are(comparison):
    with pytest.raises(ParameterError, match=r"region 9 .* 1 to 2"):
        draw_section(comparison, 9)


def test_drawings_are_the_same_every_time(comparison):
    assert draw_section(comparison, 1) == draw_section(comparison, 1)
    assert draw_histogram(comparison) == draw_histogram(comparison)


@pytest.mark.parametrize(
    ("metres", "text"), [(0.000351, "+0.35 mm"), (-0.0024, "−2.4 mm"), (0.0123, "+12 mm"), (0.000004, "+0.0040 mm"),
                         (0.0, "0 mm"), (-0.0, "0 mm"), (float("nan"), "not known")]
)  # fmt: skip
def test_millimetres_have_two_digits_and_a_true_minus(metres, text):
    assert say_mm(metres, sign=True) == text


def test_a_share_beyond_the_scale_is_said_as_a_reader_writes_it():
    figure = Figure()
    axes = figure.add_subplot()
    _say_beyond(axes, 2e-8)
    assert [t.get_text().replace("\u00a0", " ") for t in axes.texts] == ["< 0.01 % beyond the scale"]


@pytest.mark.parametrize("share", [0.02, 0.3, 0.49, 0.51, 0.8, 1.0, 1.7])
def test_the_level_of_detection_is_named_within_the_histogram(comparison, share, monkeypatch):
    """It ended at "±0.44 m": of a level near the end of the scale the name was cut off."""
    found = []

    def measure(figure):
        renderer = FigureCanvasAgg(figure).get_renderer()
        (axes,) = figure.axes
        (name,) = (t for t in axes.texts if t.get_text().startswith("level of detection ±"))
        box, line = name.get_window_extent(renderer), axes.transData.transform((level, 1.0))[0]
        found.append((box.x0 / figure.dpi, box.x1 / figure.dpi, line / figure.dpi, axes.get_xlim()[1]))
        return b""

    level = share * DEPTH * 1e3  # mm; colours and distances end at the depth of the patches
    side = comparison.on_compared
    raised = dataclasses.replace(side, lod95=np.where(np.isfinite(side.lod95), level * 1e-3, np.nan))
    monkeypatch.setattr(figures, "write_svg", measure)
    draw_histogram(dataclasses.replace(comparison, on_compared=raised))
    left, right, line, reach = found[0]
    assert 0.0 < left < right < WIDTH
    assert min(abs(left - line), abs(right - line)) < 0.1  # it stands beside its line
    assert level < 0.65 * reach  # which is not at the end of the scale


@pytest.mark.parametrize("limit", [1.5e-6, 1.5e-4, 0.003, 12.0])
def test_the_numbers_of_the_colour_bar_stand_within_the_picture_and_have_like_decimals(limit, monkeypatch):
    """Of a medal and of a wall the numbers at its ends were cut off."""
    drawn = []
    monkeypatch.setattr(figures, "write_svg", lambda figure: drawn.append(figure) or b"")
    draw_colour_bar(limit, 0.3 * limit)
    figure, renderer = drawn[0], FigureCanvasAgg(drawn[0]).get_renderer()
    numbers = figure.axes[0].get_xticklabels()
    boxes = [text.get_window_extent(renderer) for text in numbers]
    assert min(box.x0 for box in boxes) > 0.0
    assert max(box.x1 for box in boxes) / figure.dpi < 0.61 * WIDTH  # where grey is explained
    assert len({len(text.get_text().partition(".")[2]) for text in numbers if text.get_text() != "0"}) == 1


@pytest.mark.parametrize(("values", "told"), [
    ([-0.5, 0.0, 0.5, 1.0], ["−0.5", "0", "+0.5", "+1.0"]), ([8e-5], ["+0.00008"]), ([-20.0, 0.0], ["−20", "0"]),
    ([0.1 + 0.2], ["+0.3"]), ([-1e-17, 2.0], ["0", "+2"]),
])  # fmt: skip
def test_numbers_of_a_scale_have_like_decimals_and_no_powers_of_ten(values, told):
    assert even_numbers(values) == told


def test_the_words_of_the_colour_bar_end_within_the_picture():
    """Of fine scans "unchanged (up to 0.075 mm or more)" was cut off."""
    with drawing(0.78) as figure:
        _add_states(figure, 3.5e-5, 7.5e-6)
        renderer = FigureCanvasAgg(figure).get_renderer()
        ends = [text.get_window_extent(renderer).x1 / figure.dpi for text in figure.texts]
    assert len(ends) == 3
    assert max(ends) < WIDTH


@pytest.mark.filterwarnings("error")
def test_a_section_of_which_no_change_is_known_is_drawn_without_complaint(comparison):
    """Its scale had no height, of which the drawing complained to whoever asked for a report."""
    torn = {
        name: dataclasses.replace(side, distances=np.full(len(side.distances), np.nan))
        for name, side in (("on_compared", comparison.on_compared), ("on_reference", comparison.on_reference))
    }
    assert "hatched: not assessable" in words(draw_section(dataclasses.replace(comparison, **torn), 1))


def test_the_largest_change_is_readable_over_hatching():
    axes = Figure().add_subplot()
    _name_largest(axes, np.array([[0.0, 1.0]]), np.array([[1.0, 5.4]]))
    (name,) = axes.texts
    ground = name.get_bbox_patch()
    assert name.get_text() == "+5.4 mm"
    assert ground is not None
    assert ground.get_facecolor() == (1.0, 1.0, 1.0, 0.8)
