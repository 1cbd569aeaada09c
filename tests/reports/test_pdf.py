"""The document: in order, for the long term, the same every time, and safe against what people type."""

import dataclasses
import io
import itertools

import numpy as np
import pytest
from pdf_oxide import PdfDocument
from PIL import Image
from report_examples import DENT, example_comparison, facts_of
from scipy.spatial import cKDTree
from series_examples import series_of
from shown_examples import BAR, DOT, pictures_of, text_of

from projects.errors import ParameterError
from reports.captions import write_captions
from reports.courses import tell_series
from reports.facts import Table
from reports.pdf import (
    MOST_COLUMNS,
    fit_columns,
    has_letters,
    set_beside,
    set_document,
    shorten,
    split_table,
    write_document,
)
from reports.pictures import Shown, ShownSingle, ShownView

LOST = (0xB8, 0x3F, 0x1B)  # of the page: material lost


def plain_picture(colour):
    """Return a picture of one colour."""
    stream = io.BytesIO()
    Image.new("RGB", (60, 40), colour).save(stream, "PNG")
    return Shown(stream.getvalue(), "image/png", 60, 40, "one colour")


def test_the_document_is_made_for_the_long_term_and_the_same_every_time():
    facts = facts_of()
    document = set_document(facts, pictures_of(facts))
    assert PdfDocument.from_bytes(document).validate_pdf_a("2a")["valid"]
    assert document == set_document(facts, pictures_of(facts))
    assert b"2026-05-19" in document  # the day of the computation, not of the printing


def test_the_sections_stand_in_order_with_the_answer_first_and_a_place_to_sign():
    facts = facts_of()
    text = text_of(set_document(facts, pictures_of(facts)))
    titles = (facts.title, facts.answer.headline, "The difference", "Before, after, difference", "Regions of change",
              "All differences", "How sure", "The object and its epochs", "Signed", "The record", "Software",
              "Input files")  # fmt: skip
    place = 0
    for title in titles:
        place = text.index(title, place) + len(title)
    assert "name, date, signature" in text


def test_every_figure_of_a_region_is_printed_with_its_margin():
    facts = facts_of()
    text = text_of(set_document(facts, pictures_of(facts)))
    assert f"Area, {facts.measures.area} Volume, {facts.measures.volume}" in text
    dent = facts.regions[0]
    assert dent.number == DENT[0]
    for figure in (dent.area, dent.volume, dent.extreme, dent.mean):
        assert f"{figure.value} ± {figure.margin}" in text.replace("\u202f", " ")
    for _, value in (pair for s in facts.record for pair in s.settings):
        assert value.split()[0] in text
    assert facts.inputs.rows[0][-1][:16] in text.replace(" ", "")


def test_what_people_type_is_set_as_text_and_never_read_as_markup():
    hostile = '#panic("no") $x$ *b* _i_ `c` <l> @r \\ [ ] {{ 7*7 }} #read("facts.json")'
    facts = facts_of(name=hostile, place=hostile, description=hostile)
    facts = dataclasses.replace(facts, after=dataclasses.replace(facts.after, label=hostile))
    text = text_of(set_document(facts, pictures_of(facts)))
    assert text.count('#panic("no") $x$ *b* _i_') >= 3
    assert '"headline"' not in text


def test_letters_of_any_script_leave_a_document():
    assert has_letters("Säule № 7, Ω, ж, ± 0.1 mm")
    assert not has_letters("石柱")
    facts = facts_of(name="石柱 Säule")
    assert "Säule" in text_of(set_document(facts, pictures_of(facts)))


@pytest.mark.parametrize("odd", ["\ufeff", "\uf0b7", "\x7f", "\ufffe", "\x0b", "\x07", "\udcff", "\u2028"])
def test_what_pdf_does_not_take_as_text_leaves_a_document(odd):
    facts = facts_of(name=f"Säule{odd} am Tor", description=f"pasted{odd}text")
    document = set_document(facts, pictures_of(facts))
    assert PdfDocument.from_bytes(document).validate_pdf_a("2a")["valid"]
    assert "Säule" in text_of(document)


def test_the_picture_of_the_difference_stands_on_the_first_page():
    facts = facts_of()
    document = set_document(facts, pictures_of(facts, plain_picture((10, 200, 30))))
    page = np.asarray(Image.open(io.BytesIO(PdfDocument.from_bytes(document).render_page(0))).convert("RGB"), int)
    green = np.abs(page - (10, 200, 30)).max(axis=2) < 12
    rows, columns = np.nonzero(green)
    assert columns.max() - columns.min() == pytest.approx(0.4 * 174 / 210 * page.shape[1], rel=0.03)  # 40 % of the text
    assert rows.max() - rows.min() == pytest.approx((columns.max() - columns.min()) * 40 / 60, rel=0.03)


@pytest.mark.parametrize("height", [150, 200])  # of pictures 40 wide
def test_tall_pictures_are_made_smaller_for_the_first_page(height):
    facts = facts_of()
    tall = Shown(f"<svg xmlns='http://www.w3.org/2000/svg' width='40' height='{height}'/>".encode(), "image/svg+xml",
                 0, 0, "tall")  # fmt: skip
    views = tuple(ShownView(f"Side {k}", DOT, DOT, tall, 18.0, 18.0) for k in range(5))
    document = set_document(facts, dataclasses.replace(pictures_of(facts), views=views))
    assert "Figure 1" in PdfDocument.from_bytes(document).extract_text(0)


def test_a_disc_carries_the_colour_of_its_kind():
    facts = facts_of()
    read = PdfDocument.from_bytes(set_document(facts, pictures_of(facts)))
    k = next(k for k in range(read.page_count()) if "Regions of change" in read.extract_text(k) and k > 0)
    page = np.asarray(Image.open(io.BytesIO(read.render_page(k))).convert("RGB"), int)
    assert (np.abs(page - LOST).max(axis=2) < 12).sum() > 50


def printed(document):
    """Return the characters of each page: places of their middles (n, 2), right ends (n,), sizes (n,), all in mm."""
    read = PdfDocument.from_bytes(document)
    pages = []
    for k in range(read.page_count()):
        chars = [c for c in read.extract_chars(k) if c.char.strip()]
        x, y, wide, high = (25.4 / 72.0 * np.array([c.bbox[i] for c in chars]) for i in range(4))
        pages.append((np.stack([x + wide / 2.0, y + high / 2.0], axis=1), x + wide, high))
    return pages


def count_printed_over(document):
    """Return how many pairs of characters lie over one another."""
    pairs = 0
    for middles, _, sizes in printed(document):
        for i, j in cKDTree(middles).query_pairs(0.2 * sizes.max()):
            pairs += bool(np.hypot(*(middles[i] - middles[j])) < 0.2 * min(sizes[i], sizes[j]))
    return pairs


def test_words_below_narrow_pictures_neither_touch_nor_break_a_date():
    facts = facts_of()
    before = dataclasses.replace(
        facts.before, date="10\u00a0March\u00a02020", label="as_given_by_the_workshop_before_it_was_cleaned"
    )
    after = dataclasses.replace(facts.after, date="15\u00a0September\u00a02021", label="W" * 40)
    facts = dataclasses.replace(facts, before=before, after=after)
    thin = plain_picture((10, 200, 30))
    views = tuple(ShownView(n, thin, thin, thin, 1.0, 1.0) for n in ("Front", "Wall to the right", "From below"))
    pictures = dataclasses.replace(pictures_of(facts), views=views, stable=(ShownSingle("From below", thin, 0.3),) * 3)
    document = set_document(facts, pictures)
    assert count_printed_over(document) == 0
    read = PdfDocument.from_bytes(document)
    lines = [line.replace("\u00a0", " ") for k in range(2) for line in read.extract_text(k).splitlines()]
    assert sum("10 March 2020" in line and "September" not in line for line in lines) >= 3
    assert sum("15 September 2021" in line for line in lines) >= 3
    assert count_touching(document, 1) == 0


def count_touching(document, k):
    """Return how many letters of a page begin within the letter before them on their line, by more than a hair."""
    chars = [c for c in PdfDocument.from_bytes(document).extract_chars(k) if c.char.strip()]
    rows = sorted((round(c.bbox[1], 1), c.bbox[0], c.bbox[0] + c.bbox[2]) for c in chars)
    return sum(a[0] == b[0] and b[1] < a[2] - 1.0 for a, b in itertools.pairwise(rows))


def test_pictures_of_a_row_stand_on_one_line_however_many_lines_their_names_take():
    facts = facts_of()
    colours = ((200, 30, 120), (10, 200, 30))
    stable = tuple(ShownSingle(n, plain_picture(c), 6.0) for n, c in zip(("A", "of two lines"), colours, strict=True))
    read = PdfDocument.from_bytes(set_document(facts, dataclasses.replace(pictures_of(facts), stable=stable)))
    k = next(k for k in range(read.page_count()) if "How sure" in read.extract_text(k))
    page = np.asarray(Image.open(io.BytesIO(read.render_page(k))).convert("RGB"), int)
    tops = [np.nonzero((np.abs(page - c).max(axis=2) < 12).any(axis=1))[0].min() for c in colours]
    assert abs(tops[0] - tops[1]) <= 1  # pixel


def long_record(n_scans=6):
    """Return the facts of the example with a record of long names and values, as of an epoch of many scans."""
    extent = " ".join(["-0.32"] * 40)
    found = Table("", ("", *(f"calibration{k:03d}" for k in range(n_scans))), (
        ("step", *("335f28eb4fed355d",) * n_scans),
        ("target_spacing_quartiles", *("0.00153 0.001748 0.002082",) * n_scans),
        ("amplitudes", *("not known not known not known",) * n_scans),
    ))  # fmt: skip
    settings = (("filter.normals.h_share", "0.55"), ("extent.polygon", extent))
    step = dataclasses.replace(facts_of().record[0], settings=settings, found=(found,))
    return dataclasses.replace(facts_of(), record=(step,))


def test_names_and_values_of_the_record_are_not_printed_over_one_another():
    facts = long_record()
    document = set_document(facts, pictures_of(facts))
    assert count_printed_over(document) == 0
    assert text_of(document).count("-0.32") == 40
    for _, right, _ in printed(document):
        assert right.max(initial=0.0) <= 192.1  # mm: the width of the page less its margin


def test_a_title_that_was_cut_or_ends_a_sentence_gets_no_second_stop():
    cut = shorten("Relief an der Nordwand, Feld 7 (links unten, neben der Tür)", 45)
    assert cut == "Relief an der Nordwand, Feld 7 (links unten…"
    for title, foot in ((cut, f"{cut} e1"), ("Who was he?", "Who was he? e1"), ("Column", "Column. e1")):
        assert write_captions(facts_of(name=title)).foot.startswith(f"{foot} compared with e2.")


def test_a_long_word_is_broken_within_the_page_and_the_foot_stays_short():
    word = "Donaudampfschifffahrtsgesellschaftskapitänswitwe" * 4
    facts = facts_of(name=word, place=word)
    facts = dataclasses.replace(facts, after=dataclasses.replace(facts.after, label=word, epoch_id="E" * 64))
    wide = Table("Input files", ("file", "SHA-256"), ((f"{'x' * 200}.e57", "0123456789abcdef" * 4),))
    facts = dataclasses.replace(facts, inputs=wide, subtitle=f"What changed {word}")
    document = set_document(facts, pictures_of(facts))
    for middles, right, _ in printed(document):
        assert right.max() <= 192.1
        assert middles[:, 1].min() > 5.0  # mm above the page's lower edge
    assert count_printed_over(document) == 0
    assert "0123456789abcdef" * 4 in text_of(document).replace(" ", "")
    assert PdfDocument.from_bytes(document).validate_pdf_a("2a")["valid"]


@pytest.mark.parametrize(
    "epoch_id", ["before-the-restoration-of-the-southern-portal-in-the-2nd-camp.A", "E" * 64, "e1"]
)
def test_courses_first_seen_in_an_epoch_of_a_long_name_are_not_printed_over_one_another(epoch_id):
    """Its column took the whole line, and the places and courses of regions stood below it."""
    told = tell_series(series_of("accelerating", (-1e-4, -4e-4)))
    course = dataclasses.replace(told.courses[0], first_seen=epoch_id, on_map="no.\u00a012", where="back right, above")
    facts = dataclasses.replace(facts_of(), series=dataclasses.replace(told, courses=(course,) * 3))
    document = set_document(facts, dataclasses.replace(pictures_of(facts), courses=BAR))
    assert count_printed_over(document) == 0
    assert text_of(document).count(epoch_id[-2:]) >= 3
    for _, right, _ in printed(document):
        assert right.max(initial=0.0) <= 192.1


def test_what_is_in_doubt_is_signed_as_in_doubt():
    """The headline, bold and above the signatures, was "No change was found." of an epoch that lay 11 mm off."""
    comparison = example_comparison(rows=())
    doubted = dataclasses.replace(comparison.registration, doubt="the stable areas lie 11 mm off each other")
    facts = facts_of(dataclasses.replace(comparison, registration=doubted))
    assert facts.answer.headline == "In doubt: no change was found."
    assert facts_of(comparison).answer.headline == "No change was found."
    signed = text_of(set_document(facts, pictures_of(facts))).partition("Signed")[2].partition("name, date")[0]
    assert "In doubt: no change was found." in signed
    assert "In doubt is how the epochs lie on each other: the stable areas lie 11 mm off each other." in signed


def test_pictures_of_one_view_stand_at_one_height_whatever_their_names_take():
    facts = facts_of()
    facts = dataclasses.replace(facts, before=dataclasses.replace(facts.before, label="as it stood before " * 6))
    colours = ((200, 30, 120), (10, 200, 30))
    view = ShownView("Front", plain_picture(colours[0]), plain_picture(colours[1]), DOT, 10.0, 30.0)
    document = set_document(facts, dataclasses.replace(pictures_of(facts), views=(view,)))
    page = np.asarray(Image.open(io.BytesIO(PdfDocument.from_bytes(document).render_page(0))).convert("RGB"), int)
    tops = [np.nonzero((np.abs(page - c).max(axis=2) < 12).any(axis=1))[0].min() for c in colours]
    assert abs(tops[0] - tops[1]) <= 2  # pixels


@pytest.mark.parametrize("n", range(0, 36, 5))
def test_signatures_stand_with_what_is_signed_and_never_alone_on_a_page(n):
    facts = facts_of()
    facts = dataclasses.replace(facts, object_rows=(("Place", "Garden"),) * n)
    read = PdfDocument.from_bytes(set_document(facts, pictures_of(facts)))
    pages = [" ".join(read.extract_text(k).replace("\u00a0", " ").split()) for k in range(read.page_count())]
    (k,) = (k for k, text in enumerate(pages) if "name, date, signature" in text)
    signed = pages[k][pages[k].index("Signed") :]
    assert f"{facts.title}. {facts.subtitle}. {facts.answer.headline}".replace("\u00a0", " ") in signed
    begins = pages[k].startswith("Signed")
    assert ("The record" in signed) == begins  # else the record begins a page of its own


def test_a_date_in_the_head_of_a_column_is_one_word():
    heads = ("", "before (10\u00a0March\u00a02020)", "after (15\u00a0September\u00a02021)")
    widths = fit_columns(Table("t", heads, (("a sentence that names a row at length", "1", "2"),)), 46.0)["widths"]
    assert widths[1] >= len("(10March2020)")
    assert widths[2] >= len("(15September2021)")


def test_a_wide_table_goes_on_below_with_its_rows_named_again():
    names = ("", *"abcdefghi")
    table = Table("t", names, (("x", *"123456789"),), note="n")
    pieces = split_table(table, 100.0)
    assert [len(p.columns) for p in pieces] == [6, 5]
    assert max(len(p.columns) for p in pieces) <= MOST_COLUMNS
    assert [p.rows[0][0] for p in pieces] == ["x", "x"]
    assert tuple(c for p in pieces for c in p.columns[1:]) == names[1:]
    assert tuple(c for p in pieces for c in p.rows[0][1:]) == tuple("123456789")
    assert [(p.title, p.note) for p in pieces] == [("t", ""), ("", "n")]
    assert split_table(Table("s", ("", "a"), ()), 100.0) == [Table("s", ("", "a"), ())]
    assert [len(p.columns) for p in split_table(table, 25.0)] == [4, 4, 4]  # so few that no word is broken


def test_no_column_is_narrower_than_its_words_as_long_as_there_is_room():
    table = Table("t", ("", "a"), (("target_spacing_quartiles", "1 2 3"), ("x", "0.001 " * 20)))
    set_out = fit_columns(table, 60.0)
    assert set_out["widths"][0] >= len("target_spacing_quartiles")
    assert sum(set_out["widths"]) <= 60.0
    assert set_out["rows"][0] == ["target_spacing_quartiles", "1 2 3"]
    cramped = fit_columns(Table("t", ("", "a"), (("y" * 40, "z" * 10),)), 30.0)
    assert max(map(len, cramped["rows"][0][0].split("\u200b"))) + 10 <= 30
    assert cramped["rows"][0][0].replace("\u200b", "") == "y" * 40
    assert cramped["rows"][0][1] == "z" * 10  # only what is longest gives way


def test_tables_side_by_side_are_of_about_one_height():
    def table(n):
        return Table("t", ("", "a"), (("x", "1"),) * n)

    left, right = set_beside([table(10), table(2), table(3), table(8)])
    assert ([len(t["rows"]) for t in left], [len(t["rows"]) for t in right]) == ([10, 2], [3, 8])
    assert set_beside([]) == [[], []]


def test_a_document_that_cannot_be_written_leaves_what_was_there(tmp_path):
    facts = facts_of()
    path = tmp_path / "report.pdf"
    path.mkdir()
    with pytest.raises(ParameterError, match=r"report\.pdf: cannot be written"):
        write_document(path, facts, pictures_of(facts))
    assert list(tmp_path.iterdir()) == [path]
