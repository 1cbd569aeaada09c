"""Every picture of a report, and how wide each is shown: fixed views, close-ups, sections, charts.

`ReportFacts` go in; `Pictures` come out, from which the page and the document are made.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from projects.model import Comparison
from reports.cameras import title_of
from reports.colours import choose_limit
from reports.course_charts import CHARTS, draw_courses
from reports.drawing import say_mm
from reports.facts import ReportFacts
from reports.figures import draw_colour_bar, draw_histogram, draw_section
from reports.ranging import draw_calibration
from reports.smallest import dots_of_legend, least_told
from reports.stability import draw_stable
from reports.views import Picture, View, ViewPictures, choose_views, draw_close_up, draw_comparison, frame_views

PIXELS = 1.6e6  # of one epoch's views together: about twice as fine as the page shows them
LARGEST, SMALLEST = 1200, 400  # pixels, longest side of a view
ROW, GAP, TALLEST = 99.0, 1.6, 66.0  # per cent of the page's width: a row of pictures, between them, height at most
NAMED, DATED = 8.0, 20.0  # the same: words below a picture get at least so much, a view's name and an epoch
# On A4: the width of the text and the least height of letters in a picture [points], and how much of their per cent
# pictures take in an overview and beside the others, and a close-up of the text's width (templates/report.typ).
TEXT_WIDTH, LETTERS = 493.2, 6.2
OVERVIEW, BESIDE, CLOSE_UP = 0.985, 0.86, 0.29
CLOSE_UP_PIXELS = 640
CLOSE_UPS = 24  # so many regions, the largest, are drawn close up; all are in the table


@dataclass(frozen=True)
class Shown:
    """A picture as a report holds it: the bytes of the file, its size in pixels (0: drawn to scale), its text."""

    image: bytes
    media_type: str
    width: int
    height: int
    alt: str

    @property
    def src(self) -> str:
        """The address that holds the picture itself, so that a page needs no other file."""
        return f"data:{self.media_type};base64,{base64.b64encode(self.image).decode('ascii')}"


@dataclass(frozen=True)
class ShownView:
    """One fixed view: before, after, difference; how wide each is shown in an overview and beside the others [%]."""

    name: str
    before: Shown
    after: Shown
    difference: Shown
    wide: float
    narrow: float

    @property
    def wide_room(self) -> float:
        """How wide the place of its picture in an overview is [%]: a narrow one has room for its name."""
        return max(self.wide, NAMED)

    @property
    def narrow_room(self) -> float:
        """How wide the place of each of its pictures is beside the others [%]: a narrow one has room for a date."""
        return max(self.narrow, DATED)


@dataclass(frozen=True)
class ShownSingle:
    """One picture by itself, its view's name, and how wide it is shown [%]."""

    name: str
    picture: Shown
    wide: float

    @property
    def room(self) -> float:
        """How wide its place is [%]: that of a narrow picture has room for its name."""
        return max(self.wide, NAMED)


@dataclass(frozen=True)
class Pictures:
    """All pictures of a report; `regions` holds the close-up and the section of a region by its number,
    `courses` the charts of a series where there is one, `calibrations` those of corrected ranges, `stable` the stable
    areas from few views."""

    views: tuple[ShownView, ...]
    colour_bar: Shown
    histogram: Shown
    regions: Mapping[int, tuple[Shown, Shown]]
    courses: Shown | None = None
    calibrations: tuple[Shown, ...] = ()
    stable: tuple[ShownSingle, ...] = ()


def draw_pictures(facts: ReportFacts) -> Pictures:
    """Return every picture of a report."""
    pictures = draw_change(facts.comparison, facts.front)
    if facts.series is not None and facts.series.courses:
        charts = show_drawing(draw_courses(facts.series.series), _say_courses(facts))
        pictures = replace(pictures, courses=charts)
    ranging = [show_drawing(draw_calibration(c.profile), "Distances to a plane by range") for c in facts.calibrations]
    stable = show_stable(draw_stable(facts.comparison, facts.stable, facts.front))
    return replace(pictures, calibrations=tuple(ranging), stable=stable)


def draw_change(comparison: Comparison, bearing: float | None = None) -> Pictures:
    """Return the pictures of what changed, all with one range of colours; `bearing` [rad] of the front, where given."""
    limit = choose_limit(comparison)
    level = comparison.statistics.get("lod95_median_m", float("nan"))
    views = choose_views(comparison.on_reference.surface, bearing)
    drawn = draw_comparison(
        comparison, views, limit_m=limit, height_px=choose_size(comparison, views),
        letters_px=choose_letters(comparison, views),
    )  # fmt: skip
    near = LETTERS / (CLOSE_UP * TEXT_WIDTH / CLOSE_UP_PIXELS)
    numbers = [int(n) for n in comparison.regions["region"]][:CLOSE_UPS]
    regions = {
        n: (
            show(draw_close_up(comparison, n, limit_m=limit, height_px=CLOSE_UP_PIXELS, letters_px=near)),
            show_drawing(draw_section(comparison, n), _say_section(comparison, n)),
        )
        for n in numbers
    }
    histogram = show_drawing(draw_histogram(comparison), _say_histogram(len(comparison.regions), level))
    return Pictures(show_views(drawn), show_colour_bar(comparison), histogram, regions)


def show_colour_bar(comparison: Comparison) -> Shown:
    """Return the legend of all difference pictures of a comparison, and what it shows in words."""
    limit, level = choose_limit(comparison), float(comparison.statistics.get("lod95_median_m", math.nan))
    return show_drawing(
        draw_colour_bar(limit, level, least_told(comparison), dots_of_legend(comparison)),
        f"Colours of the differences: from {say_mm(-limit)} (lost, red) over grey (unchanged) to "
        f"{say_mm(limit, sign=True)} (gained, blue), hatched where not assessable",
    )


def _say_histogram(n_regions: int, level: float) -> str:
    """Return in words what the histogram shows; `level` [m] of detection, NaN where it is not known."""
    detected = f", level of detection ±{say_mm(level)}" if math.isfinite(level) else ""
    changed = f"{n_regions} region{'s' * (n_regions != 1)} changed" if n_regions else "no region changed"
    return f"Histogram of all differences{detected}, {changed}"


def _say_section(comparison: Comparison, number: int) -> str:
    """Return in words what the drawing of a section shows."""
    row = comparison.regions[comparison.regions["region"] == number].iloc[0]
    return (
        f"Section through region {number} with both epochs and the change between them: mean "
        f"{say_mm(float(row['mean_m']), sign=True)}, extreme {say_mm(float(row['extreme_m']), sign=True)}"
    )


def _say_courses(facts: ReportFacts) -> str:
    """Return in words what the charts of a series show: the last mean change of each region that is drawn."""
    assert facts.series is not None
    told = [f"region {c.number} {c.mean.text}, {c.course}" for c in facts.series.courses[:CHARTS]]
    return f"Mean change of each followed region over time, as last measured: {'; '.join(told)}"


def choose_size(comparison: Comparison, views: Sequence[View]) -> int:
    """Return the pixels of the longest side of the views at which all of them together have `PIXELS`."""
    surfaces = [comparison.on_reference.surface, comparison.on_compared.surface]
    pixels = sum(f.width * f.height for f in frame_views(views, surfaces, longest_px=1000))
    return min(max(round(1000 * math.sqrt(PIXELS / pixels)), SMALLEST), LARGEST)


def choose_letters(comparison: Comparison, views: Sequence[View]) -> float:
    """Return the height of letters [pixels] in the views that is `LETTERS` on A4 where they are printed smallest: in
    the overview or beside each other."""
    surfaces = [comparison.on_reference.surface, comparison.on_compared.surface]
    frames = frame_views(views, surfaces, longest_px=choose_size(comparison, views))
    sizes = [(f.width, f.height) for f in frames]
    points_per_pixel = min(OVERVIEW * fit_rows(sizes), BESIDE * fit_strip(sizes)) / 100.0 * TEXT_WIDTH
    return LETTERS / points_per_pixel


def show_views(views: Sequence[ViewPictures]) -> tuple[ShownView, ...]:
    """Return the views for the page, at one scale in the overview and at one beside each other."""
    sizes = [(v.difference.width, v.difference.height) for v in views]
    wide, narrow = fit_rows(sizes), fit_strip(sizes)
    return tuple(
        ShownView(title_of(v.view), show(v.before), show(v.after), show(v.difference),
                     round(wide * v.difference.width, 2), round(narrow * v.difference.width, 2))
        for v in views
    )  # fmt: skip


def show_stable(drawn: Sequence[tuple[View, Picture]]) -> tuple[ShownSingle, ...]:
    """Return the pictures of the stable areas for the page: in one row, no wider than a third of the page each."""
    row = fit_row([p.width for _, p in drawn]) if drawn else 0.0
    scale = min(row, min((ROW / 4.0 / p.width for _, p in drawn), default=0.0))
    return tuple(ShownSingle(title_of(v), show(p), round(scale * p.width, 2)) for v, p in drawn)


def fit_rows(sizes: Sequence[tuple[int, int]]) -> float:
    """Return the per cent of the page's width for one pixel of pictures (width, height) that share a scale.

    Few stand in a row, so that they are large, but as many as keep all rows together no taller than `TALLEST`.
    """
    scale = 0.0
    for n in range(1, len(sizes) + 1):
        rows = [sizes[k : k + n] for k in range(0, len(sizes), n)]
        scale = min(fit_row([width for width, _ in row]) for row in rows)
        height = sum(max(height for _, height in row) for row in rows)
        if scale * height <= TALLEST:
            return scale
        scale = TALLEST / height
    return scale


def fit_row(widths: Sequence[int]) -> float:
    """Return the per cent of the page's width for one pixel of pictures so wide, side by side; those narrower than
    their names take `NAMED`."""
    left, rest = ROW - GAP * (len(widths) - 1), sorted(widths)
    while len(rest) > 1 and rest[0] * left / sum(rest) < NAMED:
        left, rest = left - NAMED, rest[1:]
    return left / sum(rest)


def fit_strip(sizes: Sequence[tuple[int, int]]) -> float:
    """Return the same where three pictures of each size stand in a row of their own."""
    return min((ROW - 2.0 * GAP) / 3.0 / max(width for width, _ in sizes), TALLEST / max(height for _, height in sizes))


def show(picture: Picture) -> Shown:
    """Return a picture for the report."""
    return Shown(picture.image, picture.media_type, picture.width, picture.height, picture.alt)


def show_drawing(drawing: bytes, alt: str) -> Shown:
    """Return a drawing for the report; as an image, nothing in it can act."""
    return Shown(drawing, "image/svg+xml", 0, 0, alt)
