"""The page: complete, in order, safe against what people type, and whole in a browser without a network."""

import dataclasses
import itertools
import re
from pathlib import Path

import pytest
from report_examples import DENT, example_comparison, facts_of
from shown_examples import DOT

from projects.errors import ParameterError
from reports import pictures
from reports.html import fill_page, write_page, write_whole
from reports.pictures import (
    Pictures,
    Shown,
    ShownView,
    choose_letters,
    choose_size,
    draw_pictures,
    fit_row,
    fit_rows,
    fit_strip,
)
from reports.views import choose_views, frame_views

CHROMIUM = Path("/usr/bin/chromium")
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
         "--ignore-gpu-blocklist"]  # fmt: skip


def page_of(facts):
    """Return the page with dots for pictures."""
    regions = {r.number: (DOT, DOT) for r in facts.regions}
    return fill_page(facts, Pictures((ShownView("Front", DOT, DOT, DOT, 40.0, 30.0),), DOT, DOT, regions))


def test_the_sections_stand_in_order_with_the_answer_first():
    sections = re.findall(r'<section id="(\w+)"', page_of(facts_of()))
    assert sections == ["answer", "difference", "views", "regions", "distribution", "certainty", "object", "record"]


def test_hostile_texts_are_shown_and_never_run():
    hostile = "<script>alert(1)</script> \"Häßlich\" & 'quoted' {{ 7*7 }} </style>"
    facts = facts_of(name=hostile, place=hostile, description="<img src=x onerror=alert(1)>")
    facts = dataclasses.replace(facts, after=dataclasses.replace(facts.after, label=hostile))
    page = page_of(facts)
    assert "<script" not in page.lower()
    assert "<img src=x" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt; &#34;Häßlich&#34; &amp; &#39;quoted&#39; {{ 7*7 }}" in page
    assert page.count("</style>") == 1


def test_the_page_asks_nobody_for_anything():
    page = page_of(facts_of())
    addresses = re.findall(r"""(?:src|href|url)\s*[=(]\s*["']?([^"')\s>]*)""", page)
    assert addresses
    assert all(a.startswith("data:") for a in addresses)
    assert "default-src 'none'" in page


def test_the_table_of_regions_holds_every_region_and_none_where_nothing_changed():
    assert page_of(facts_of()).count('<td class="value">') == 8
    empty = page_of(facts_of(example_comparison(rows=())))
    assert '<td class="value">' not in empty
    assert "<p>No change was found.</p>" in empty


def test_what_is_not_known_is_printed_as_such():
    unknown = (*DENT[:6], float("nan"), float("nan"), *DENT[8:])
    page = page_of(facts_of(example_comparison(rows=[unknown], nmad_m=float("nan"))))
    text = re.sub(r"<[^>]*>|data:[^\"]*", " ", page)
    assert "not known" in text
    assert not re.search(r"\b(nan|NaN|None|inf)\b", text)


@pytest.mark.parametrize(
    ("sizes", "n_in_row"),
    [
        ([(300, 800)] * 4, 4),
        ([(240, 799)] * 5, 5),
        ([(800, 700)] * 6, 3),
        ([(1600, 200)] * 2, 1),
        ([(800, 500)], 1),
        ([(800, 400)] * 2, 2),
    ],
)
def test_views_share_a_scale_and_as_few_a_row_as_keeps_them_in_sight(sizes, n_in_row):
    width, height = sizes[0]
    n_rows = -(-len(sizes) // n_in_row)
    assert fit_rows(sizes) * width * n_in_row + pictures.GAP * (n_in_row - 1) == pytest.approx(pictures.ROW)
    assert fit_rows(sizes) * height * n_rows <= pictures.TALLEST
    assert fit_strip(sizes) * width * 3 + pictures.GAP * 2 <= pictures.ROW + 1e-9


def test_pictures_narrower_than_their_names_leave_them_room_in_the_row():
    sizes = [(1000, 800), (10, 800), (10, 800)]
    scale = fit_row([width for width, _ in sizes])
    assert scale * 1000 + 2 * pictures.NAMED + 2 * pictures.GAP == pytest.approx(pictures.ROW)
    assert fit_row([400, 400]) * 800 + pictures.GAP == pytest.approx(pictures.ROW)


def test_pictures_too_tall_for_any_row_are_made_smaller():
    assert fit_rows([(50, 900)]) * 900 == pytest.approx(pictures.TALLEST)
    assert fit_strip([(50, 900)]) * 900 == pytest.approx(pictures.TALLEST)


def test_views_are_as_fine_as_a_budget_of_pixels_allows():
    comparison = example_comparison()
    views = choose_views(comparison.on_reference.surface)
    size = choose_size(comparison, views)
    surfaces = [comparison.on_reference.surface, comparison.on_compared.surface]
    pixels = sum(f.width * f.height for f in frame_views(views, surfaces, longest_px=size))
    assert size < pictures.LARGEST
    assert pixels == pytest.approx(pictures.PIXELS, rel=0.02)


def test_a_report_that_cannot_be_written_leaves_what_was_there(tmp_path):
    present = tmp_path / "report.html"
    write_whole(present, "before")
    with pytest.raises(ParameterError, match="the report cannot be written"):
        write_whole(present / "below", "after")
    write_whole(present, "ä \ud800")  # half a surrogate, as a broken file name may hold
    assert present.read_text(encoding="utf-8") == "ä ?"
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.page
def test_a_browser_without_network_shows_every_picture(tmp_path, monkeypatch):
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}")
    monkeypatch.setattr(pictures, "LARGEST", 120)
    path = tmp_path / "report.html"
    facts = facts_of()
    write_page(path, facts, draw_pictures(facts))
    asked, complaints = [], []
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS)
        page = browser.new_context(offline=True, viewport={"width": 1280, "height": 900}).new_page()
        page.on("request", lambda request: asked.append(request.url))
        page.on("console", lambda message: complaints.append(message.text))
        page.goto(path.as_uri())
        images = page.evaluate("[...document.images].map(i => [i.complete, i.naturalWidth, i.alt.length])")
        wide = page.evaluate("document.documentElement.scrollWidth")
        text = page.inner_text("#answer")
        largest = [item.inner_text().split(" (")[0] for item in page.query_selector_all("#answer li")]
        subjects = [term.inner_text() for term in page.query_selector_all("#answer dl.known dt")]
        browser.close()
    n_views = len(re.findall('class="strip"', path.read_text(encoding="utf-8")))
    assert len(images) == 4 * n_views + 2 + 2 * len(facts.regions)
    assert n_views >= 4
    assert all(complete and width > 0 and alt > 0 for complete, width, alt in images)
    assert [url for url in asked if not url.startswith("data:")] == [path.as_uri()]
    assert not complaints
    assert wide <= 1280
    assert "Two regions changed." in text
    assert largest == ["Region 1", "Region 2"]
    assert subjects == ["How small", "The whole", "Not assessed"]
    assert path.stat().st_size < 8e6


CAPTIONS = """[...document.querySelectorAll('.view > span')].map(span => {
    const letters = document.createRange(); letters.selectNodeContents(span);
    const text = document.createTreeWalker(span, NodeFilter.SHOW_TEXT).nextNode(), date = document.createRange();
    date.setStart(text, 0); date.setEnd(text, text.data.match(/^[^,]*/)[0].length);
    const lines = new Set([...date.getClientRects()].map(r => r.top)), r = letters.getBoundingClientRect();
    return [r.left, r.top, r.right, r.bottom, lines.size, text.data]; })"""
REACH = """Math.min(...[...document.querySelectorAll('.wide:has(> .views), .wide:has(> .triple)')].map(
    w => w.getBoundingClientRect().left + w.scrollWidth))"""  # how far a reader can scroll
WIDTHS = "[...document.querySelectorAll('.triple')].map(t => [...t.querySelectorAll('img')].map(i => i.width))"


@pytest.mark.page
@pytest.mark.parametrize("width", [360, 1280])
def test_captions_of_narrow_pictures_do_not_touch_and_hold_their_dates_together(tmp_path, width):
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}")
    facts = facts_of()
    before = dataclasses.replace(facts.before, date="10\u00a0March\u00a02020", label="a" * 40)
    after = dataclasses.replace(facts.after, date="15\u00a0September\u00a02021", label="before the winter")
    stone = Shown(DOT.image, DOT.media_type, 40, 400, "stone")
    names = ("Wall to the right", "From below", "Right side")
    views = tuple(ShownView(n, stone, stone, stone, 3.0, 2.5) for n in names)
    shown = Pictures(views, DOT, DOT, {r.number: (DOT, DOT) for r in facts.regions})
    path = tmp_path / "report.html"
    path.write_text(fill_page(dataclasses.replace(facts, before=before, after=after), shown), encoding="utf-8")
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS)
        page = browser.new_context(offline=True, viewport={"width": width, "height": 900}).new_page()
        page.goto(path.as_uri())
        captions, widths = page.evaluate(CAPTIONS), page.evaluate(WIDTHS)
        reach = page.evaluate(REACH)
        wide = page.evaluate("document.documentElement.scrollWidth")
        browser.close()
    assert len(captions) == 4 * len(names)
    for a, b in itertools.combinations(captions, 2):
        assert a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]
    assert all(c[0] >= 0 and c[2] <= max(width, reach) for c in captions)  # nothing is cut
    assert [c[4] for c in captions if c[5][0].isdigit()] == [1] * 2 * len(names)  # dates in one piece
    assert all(max(row) - min(row) <= 1 and min(row) > 0 for row in widths)  # one scale
    assert wide <= width


@pytest.mark.page
@pytest.mark.parametrize(("medium", "n_rows"), [("print", 1), ("screen", 2)])
def test_a_page_that_is_printed_is_no_phone(tmp_path, medium, n_rows):
    """A4 is narrower than 50 rem: on paper the figures to remember stood in two rows, and the tables in one column."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}")
    path = tmp_path / "report.html"
    path.write_text(page_of(facts_of()), encoding="utf-8")
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS)
        page = browser.new_page(viewport={"width": 673, "height": 980})  # 178 mm between the margins of A4
        page.emulate_media(media=medium)
        page.goto(path.as_uri())
        tops = page.evaluate("[...document.querySelectorAll('.figures div')].map(d => d.getBoundingClientRect().top)")
        columns = page.evaluate("getComputedStyle(document.querySelector('.columns')).columnCount")
        browser.close()
    assert len(set(tops)) == n_rows
    assert columns == ("2" if medium == "print" else "1")


@pytest.mark.page
@pytest.mark.parametrize("width", [390, 1280])
def test_letters_in_pictures_can_be_read_on_a_phone(tmp_path, monkeypatch, width):
    """The page is as wide as the screen, and its pictures go on to the side: letters were 4 pixels high."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}")
    monkeypatch.setattr(pictures, "LARGEST", 120)
    facts = facts_of()
    shown = draw_pictures(facts)
    letters = choose_letters(facts.comparison, choose_views(facts.comparison.on_reference.surface))
    path = tmp_path / "report.html"
    write_page(path, facts, shown)
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS)
        page = browser.new_context(offline=True, viewport={"width": width, "height": 844}).new_page()
        page.goto(path.as_uri())
        views = page.evaluate("[...document.querySelectorAll('.view > img')].map(i => i.width / i.naturalWidth)")
        drawn = page.evaluate("[...document.querySelectorAll('.wide > img')].map(i => i.getBoundingClientRect().width)")
        wide = page.evaluate("document.documentElement.scrollWidth")
        browser.close()
    assert wide <= width
    assert len(drawn) == 2 + len(facts.regions)
    assert min(drawn) * 8.0 / (6.7 * 72.0) > 8.0  # pixels of letters of 8 points in a drawing 6.7 inches wide
    assert letters * min(views) > 8.0
