"""The report as one HTML file that needs nothing else: pictures inside, no script, no network, ready for A4 paper.

`ReportFacts` go in; a file comes out that appears whole or not at all.
"""

from __future__ import annotations

import base64
import math
import os
import uuid
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from projects.errors import ParameterError
from projects.model import Comparison
from reports.colours import choose_limit
from reports.courses import draw_courses
from reports.document import MEANINGS
from reports.facts import ReportFacts
from reports.figures import draw_colour_bar, draw_histogram, draw_section
from reports.ranging import draw_calibration
from reports.stability import draw_stable
from reports.views import Picture, View, ViewPictures, choose_views, draw_close_up, draw_comparison, frame_views

VIEW_NAMES = {"front": "Front", "right": "Right side", "back": "Back", "left": "Left side", "top": "Top",
              "below": "From below"}  # fmt: skip
ROOM_NAMES = {"front": "Wall ahead", "right": "Wall to the left", "back": "Wall behind", "left": "Wall to the right",
              "top": "Floor", "below": "Ceiling"}  # fmt: skip
PIXELS = 1.6e6  # of one epoch's views together: about twice as fine as the page shows them
LARGEST, SMALLEST = 1200, 400  # pixels, longest side of a view
ROW, GAP, TALLEST = 99.0, 1.6, 66.0  # per cent of the page's width: a row of pictures, between them, height at most
CLOSE_UPS = 24  # so many regions, the largest, are drawn close up; all are in the table


@dataclass(frozen=True)
class Embedded:
    """A picture as the page holds it: a data URI, its size in pixels (0: drawn to scale), its text."""

    src: str
    width: int
    height: int
    alt: str


@dataclass(frozen=True)
class EmbeddedView:
    """One fixed view: before, after, difference; how wide each is shown in an overview and beside the others [%]."""

    name: str
    before: Embedded
    after: Embedded
    difference: Embedded
    wide: float
    narrow: float


@dataclass(frozen=True)
class EmbeddedSingle:
    """One picture by itself, its view's name, and how wide it is shown [%]."""

    name: str
    picture: Embedded
    wide: float


@dataclass(frozen=True)
class Pictures:
    """All pictures of a report; `regions` holds the close-up and the section of a region by its number,
    `courses` the charts of a series where there is one, `calibrations` those of corrected ranges, `stable` the stable
    areas from few views."""

    views: tuple[EmbeddedView, ...]
    colour_bar: Embedded
    histogram: Embedded
    regions: Mapping[int, tuple[Embedded, Embedded]]
    courses: Embedded | None = None
    calibrations: tuple[Embedded, ...] = ()
    stable: tuple[EmbeddedSingle, ...] = ()


def write_report(path: Path | str, facts: ReportFacts) -> None:
    """Draw the pictures of a comparison and write its report as one self-contained HTML file.

    Raises
    ------
    ParameterError
        If the file cannot be written there; what was there before stays.
    """
    pictures = draw_pictures(facts.comparison)
    if facts.series is not None and facts.series.courses:
        charts = embed_svg(draw_courses(facts.series.series), "Mean change of each followed region over time")
        pictures = replace(pictures, courses=charts)
    ranging = [embed_svg(draw_calibration(c.profile), "Distances to a plane by range") for c in facts.calibrations]
    pictures = replace(pictures, calibrations=tuple(ranging))
    pictures = replace(pictures, stable=embed_stable(draw_stable(facts.comparison, facts.stable)))
    write_whole(Path(path), fill_page(facts, pictures))


def draw_pictures(comparison: Comparison) -> Pictures:
    """Return every picture of the report, all with one range of colours."""
    limit = choose_limit(comparison)
    level = comparison.statistics.get("lod95_median_m", float("nan"))
    views = choose_views(comparison.on_reference.surface)
    drawn = draw_comparison(comparison, views, limit_m=limit, height_px=choose_size(comparison, views))
    numbers = [int(n) for n in comparison.regions["region"]][:CLOSE_UPS]
    regions = {
        n: (
            embed(draw_close_up(comparison, n, limit_m=limit)),
            embed_svg(draw_section(comparison, n), f"Section through region {n} with both epochs"),
        )
        for n in numbers
    }
    bar = embed_svg(draw_colour_bar(limit, level), "Colours of the differences in millimetres")
    histogram = embed_svg(draw_histogram(comparison), "Histogram of all differences")
    return Pictures(embed_views(drawn), bar, histogram, regions)


def choose_size(comparison: Comparison, views: Sequence[View]) -> int:
    """Return the pixels of the longest side of the views at which all of them together have `PIXELS`."""
    surfaces = [comparison.on_reference.surface, comparison.on_compared.surface]
    pixels = sum(f.width * f.height for f in frame_views(views, surfaces, longest_px=1000))
    return min(max(round(1000 * math.sqrt(PIXELS / pixels)), SMALLEST), LARGEST)


def title_of(view: View) -> str:
    """Return the words below a view: the side that is seen, of a room the wall."""
    return (ROOM_NAMES if view.cut_away else VIEW_NAMES).get(view.name, view.name)


def embed_views(views: Sequence[ViewPictures]) -> tuple[EmbeddedView, ...]:
    """Return the views for the page, at one scale in the overview and at one beside each other."""
    sizes = [(v.difference.width, v.difference.height) for v in views]
    wide, narrow = fit_rows(sizes), fit_strip(sizes)
    return tuple(
        EmbeddedView(title_of(v.view), embed(v.before), embed(v.after), embed(v.difference),
                     round(wide * v.difference.width, 2), round(narrow * v.difference.width, 2))
        for v in views
    )  # fmt: skip


def embed_stable(drawn: Sequence[tuple[View, Picture]]) -> tuple[EmbeddedSingle, ...]:
    """Return the pictures of the stable areas for the page: in one row, no wider than a third of the page each."""
    total = sum(p.width for _, p in drawn) if drawn else 1
    scale = min((ROW - GAP * (len(drawn) - 1)) / total, min((ROW / 4.0 / p.width for _, p in drawn), default=0.0))
    return tuple(EmbeddedSingle(title_of(v), embed(p), round(scale * p.width, 2)) for v, p in drawn)


def fit_rows(sizes: Sequence[tuple[int, int]]) -> float:
    """Return the per cent of the page's width for one pixel of pictures (width, height) that share a scale.

    Few stand in a row, so that they are large, but as many as keep all rows together no taller than `TALLEST`.
    """
    scale = 0.0
    for n in range(1, len(sizes) + 1):
        rows = [sizes[k : k + n] for k in range(0, len(sizes), n)]
        scale = min((ROW - GAP * (len(row) - 1)) / sum(width for width, _ in row) for row in rows)
        height = sum(max(height for _, height in row) for row in rows)
        if scale * height <= TALLEST:
            return scale
        scale = TALLEST / height
    return scale


def fit_strip(sizes: Sequence[tuple[int, int]]) -> float:
    """Return the same where three pictures of each size stand in a row of their own."""
    return min((ROW - 2.0 * GAP) / 3.0 / max(width for width, _ in sizes), TALLEST / max(height for _, height in sizes))


def embed(picture: Picture) -> Embedded:
    """Return a picture for the page."""
    return Embedded(_uri(picture.image, picture.media_type), picture.width, picture.height, picture.alt)


def embed_svg(drawing: bytes, alt: str) -> Embedded:
    """Return a drawing for the page; as an image, nothing in it can act."""
    return Embedded(_uri(drawing, "image/svg+xml"), 0, 0, alt)


def _uri(content: bytes, media_type: str) -> str:
    """Return content as the address that holds it, so that the page needs no other file."""
    return f"data:{media_type};base64,{base64.b64encode(content).decode('ascii')}"


def fill_page(facts: ReportFacts, pictures: Pictures) -> str:
    """Return the page; every text is escaped, and a fact that is missing is an error, not a gap."""
    templates = Environment(
        loader=PackageLoader("reports", "templates"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    style = files("reports").joinpath("templates/report.css").read_text(encoding="utf-8")
    present = dict.fromkeys(r.kind for r in facts.regions)
    kinds = [(kind, MEANINGS[kind]) for kind in present if kind in MEANINGS]
    page = templates.get_template("report.html")
    return page.render(facts=facts, pictures=pictures, style=Markup(style), kinds=kinds)


def write_whole(path: Path, text: str) -> None:
    """Write a text file so that it appears whole or not at all, beside what was there before."""
    draft = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        try:
            with open(draft, "w", encoding="utf-8", newline="\n", errors="replace") as stream:
                stream.write(text)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(draft, path)
        finally:
            with suppress(OSError):
                draft.unlink(missing_ok=True)
    except OSError as error:
        raise ParameterError(f"{path}: the report cannot be written ({error.strerror})") from error
