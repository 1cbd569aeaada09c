"""The report as an A4 document for the file and the archive: PDF/A-2a, fonts and pictures inside, to be signed.

`ReportFacts` and their pictures go in; a file comes out that appears whole or not at all. The same facts and pictures
give the same bytes. Texts are handed over as data, never as markup.
"""

from __future__ import annotations

import dataclasses
import datetime
import json
import math
import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
import typst
from matplotlib.ft2font import FT2Font

from projects.formats.complete_file import complete_file
from reports.captions import caption_calibration, caption_region, title_region, write_captions
from reports.facts import RegionFacts, ReportFacts, SeriesFacts, Table
from reports.making import mark_of
from reports.pictures import NAMED, Pictures, Shown
from reports.quantities import NBSP, Estimate

STANDARD: Literal["a-2a"] = (
    "a-2a"  # ISO 19005-2, level A: for the long term, with the order and the meaning of what it holds
)
FONTS = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
SUFFIX = {"image/jpeg": ".jpg", "image/png": ".png", "image/svg+xml": ".svg"}
MOST_COLUMNS = 8  # of a table; more stand in a second one below, its rows named again
HEAD = 3.0  # lines that a table's title and head take
LINE, PAGE = 55.0, 100.0  # letters that a table has room for: half as wide as the page, and as wide as the page,
SMALL, SMALLER = 115.0, 130.0  # in the small letters of the record, and its smaller ones
COURSES = 112.0  # the same of the table of courses, as wide as the page
NAMES, PIECE = 12, 8  # letters that a name of an epoch has room for there; a longer one is broken into such pieces
SEAM = 1.8  # letters that the space between two columns takes
WIDEST, NARROWEST = 24, 4  # letters that a column of short words gets at most and at least
NAMING = 36  # the same of the first column, which names the rows in sentences
LONGEST = 30  # letters of a word in a title or below a picture; a longer one may be broken
FOOT = 100  # letters of a title in the foot of each page
UNKNOWN = "\ufffd"
# What PDF/A refuses as text: controls, letters that have a meaning in one font alone, and marks that are no letters.
NOT_TEXT = re.compile("[\x7f-\x9f\ue000-\uf8ff\ufdd0-\ufdef\ufeff\ufffe\uffff\U000f0000-\U0010ffff]")
BREAK = "\u200b"  # where a word may be broken, without a sign


def write_document(path: Path, facts: ReportFacts, pictures: Pictures) -> None:
    """Write a report as PDF.

    Raises
    ------
    ParameterError
        If the file cannot be written there; what was there before stays.
    """
    document = set_document(facts, pictures)
    with complete_file(path) as unfinished:
        unfinished.write_bytes(document)


def set_document(facts: ReportFacts, pictures: Pictures) -> bytes:
    """Return the report as the bytes of a PDF file."""
    with tempfile.TemporaryDirectory() as folder:
        room = Path(folder)
        (room / "report.typ").write_bytes(files("reports").joinpath("templates/report.typ").read_bytes())
        told = json.dumps(lay_out(facts, pictures, _Room(room)), ensure_ascii=False)
        told = NOT_TEXT.sub(UNKNOWN, told.encode("utf-8", "replace").decode("utf-8"))
        (room / "facts.json").write_text(told, encoding="utf-8")
        return typst.compile(
            room / "report.typ", root=room, font_paths=[FONTS], ignore_system_fonts=has_letters(told), format="pdf",
            pdf_standards=STANDARD, timestamp=_moment(facts),
        )  # fmt: skip


def has_letters(text: str) -> bool:
    """Return whether the fonts that come with this program have every letter; if not, the machine's help out."""
    return set(map(ord, text)) <= FT2Font(str(FONTS / "DejaVuSans.ttf")).get_charmap().keys() | {ord("\n")}


class _Room:
    """The folder that a document is set in; pictures are put there once and named."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._n = folder, 0

    def put(self, picture: Shown | None) -> dict[str, str] | None:
        """Return the name of a picture's file and what it shows; None where there is no picture."""
        if picture is None:
            return None
        self._n += 1
        name = f"{self._n:03d}{SUFFIX[picture.media_type]}"
        (self.folder / name).write_bytes(picture.image)
        return {"file": name, "alt": picture.alt}


def lay_out(facts: ReportFacts, pictures: Pictures, room: _Room) -> dict[str, Any]:
    """Return everything that the template sets, as plain values."""
    shown = break_names(facts)
    captions = write_captions(shown)
    foot = write_captions(replace(shown, title=shorten(shown.title, FOOT))).foot
    return {
        "file_title": f"{facts.title}: {facts.subtitle}", "mark": mark_of(facts),
        "title": shown.title, "subtitle": shown.subtitle, "made": facts.made, "author": "heritage-monitor",
        "date": _date(facts), "foot": foot, "captions": dataclasses.asdict(captions),
        "before": facts.before.caption, "after": facts.after.caption, "named": NAMED,
        "headline": facts.answer.headline, "changed": " ".join(facts.answer.changed),
        "largest": [dataclasses.asdict(told) for told in facts.answer.largest],
        "remarks": [_break_words(r, LONGEST) for r in facts.remarks],
        "figures": [dataclasses.asdict(f) for f in facts.answer.figures],
        "sure": [dataclasses.asdict(told) for told in facts.answer.sure],
        "views": [
            {"name": v.name, "wide": v.wide, "narrow": v.narrow, "narrow_room": v.narrow_room,
             "before": room.put(v.before), "after": room.put(v.after), "difference": room.put(v.difference)}
            for v in pictures.views
        ],
        "colour_bar": room.put(pictures.colour_bar), "histogram": room.put(pictures.histogram),
        "regions": [_region(r, facts, pictures.regions.get(r.number, (None, None)), room) for r in facts.regions],
        "parts": None if facts.parts is None else fit_columns(facts.parts, PAGE),
        "series": None if facts.series is None else _series(facts.series, room.put(pictures.courses)),
        "stable": [{"name": s.name, "width": s.wide, "picture": room.put(s.picture)} for s in pictures.stable],
        "certainty": set_beside(facts.certainty),
        "calibrations": [
            {"caption": caption_calibration(c), "picture": room.put(drawn)}
            for c, drawn in zip(facts.calibrations, pictures.calibrations, strict=True)
        ],
        "known": [[name, _break_words(text, LONGEST)] for name, text in facts.object_rows],
        "history": set_beside(facts.history),
        "record": [
            {"title": s.title, "settings": s.settings,
             "found": [fit_columns(n, SMALLER) for t in s.found for n in split_table(t, SMALLER)]}
            for s in facts.record
        ],
        "versions": fit_columns(facts.versions, SMALL), "inputs": fit_columns(facts.inputs, SMALLER),
    }  # fmt: skip


def break_names(facts: ReportFacts) -> ReportFacts:
    """Return the facts with the words of their titles and of the names of epochs to be broken where they are long."""
    before, after = (
        replace(e, epoch_id=_break_words(e.epoch_id, LONGEST), label=_break_words(e.label, LONGEST))
        for e in (facts.before, facts.after)
    )
    title, subtitle = (_break_words(text, LONGEST) for text in (facts.title, facts.subtitle))
    return replace(facts, title=title, subtitle=subtitle, before=before, after=after)


def shorten(text: str, most: int) -> str:
    """Return a text of at most `most` letters, with a sign where its end was left out."""
    return text if len(text) <= most else f"{text[: most - 1].rstrip(' ,;:.–-')}…"


def split_table(table: Table, letters: float) -> list[Table]:
    """Return a table in pieces much alike, the first column in each: of at most `MOST_COLUMNS` columns, and of so few
    that no word of them needs to be broken on a line of `letters`, as far as that can be."""
    inner = np.arange(1, len(table.columns))
    fewest = max(math.ceil(len(inner) / (MOST_COLUMNS - 1)), 1)
    splits = [np.array_split(inner, n) for n in range(fewest, max(len(inner), fewest) + 1)]
    fitting = (parts for parts in splits if all(sum(_needed(table, (0, *p))) <= letters for p in parts))
    parts = next(fitting, splits[-1])
    pieces = []
    for k, part in enumerate(parts):
        which = (0, *(int(c) for c in part))
        rows = tuple(tuple(row[c] for c in which) for row in table.rows)
        columns = tuple(table.columns[c] for c in which)
        pieces.append(Table("" if k else table.title, columns, rows, table.note if k == len(parts) - 1 else ""))
    return pieces


def _needed(table: Table, which: Sequence[int]) -> list[float]:
    """Return how many letters the longest word in each column takes, with the space beside it; a quantity and a date,
    held together by narrow spaces, are words."""
    columns = (" ".join([table.columns[c], *(row[c] for row in table.rows)]).replace(NBSP, "") for c in which)
    return [SEAM + max(map(len, (*words.split(), "-" * NARROWEST))) for words in columns]


def set_beside(tables: Sequence[Table]) -> list[list[dict[str, Any]]]:
    """Return tables in two columns of about one height, in order: down the first, then down the second."""
    heights = np.cumsum([HEAD + len(t.rows) + len(t.note) / LINE for t in tables])
    n_left = int(np.argmin(np.abs(2.0 * heights - heights[-1]))) + 1 if len(tables) else 0
    return [[fit_columns(t, LINE) for t in half] for half in (tables[:n_left], tables[n_left:])]


def fit_columns(table: Table, letters: float) -> dict[str, Any]:
    """Return a table with how its columns share a line of `letters`: none narrower than its longest word, beyond that
    by the longest text in each; where even the words have no room, the longest are broken."""
    columns = list(zip(table.columns, *table.rows, strict=True))
    least = np.array(_needed(table, range(len(columns))))
    while least.sum() > letters and least.max() > SEAM + NARROWEST:
        least[least.argmax()] -= 1.0
    widest = (NAMING, *(WIDEST for _ in columns[1:]))
    longest = [max(map(len, column)) for column in columns]
    wished = np.maximum([SEAM + min(n, most) for n, most in zip(longest, widest, strict=True)], least)
    spare, more = max(letters - least.sum(), 0.0), max((wished - least).sum(), 1.0)
    widths = least + (wished - least) * min(spare / more, 1.0)

    def broken(texts: Sequence[str]) -> list[str]:
        """Return the texts of a row with their words broken where they are longer than their column."""
        return [_break_words(text, int(w - SEAM)) for text, w in zip(texts, least, strict=True)]

    rows = [broken(row) for row in table.rows]
    return {"title": table.title, "columns": broken(table.columns), "rows": rows, "note": table.note,
            "widths": widths.tolist()}  # fmt: skip


def _break_words(text: str, most: int) -> str:
    """Return a text whose words, where they are longer, may be broken after hyphens and after every `most` letters."""

    def broken(word: re.Match[str]) -> str:
        """Return one long word with its breaks."""
        parted = re.sub(rf"([^-]{{{most}}})(?=[^-])", rf"\1{BREAK}", word[0])
        return re.sub(r"-(?=\w)", f"-{BREAK}", parted)

    return re.sub(rf"\S{{{most + 1},}}", broken, text)


def _region(
    region: RegionFacts, facts: ReportFacts, drawn: tuple[Shown | None, Shown | None], room: _Room
) -> dict[str, Any]:
    """Return one region with its pictures, where it has any."""
    figures = (region.area, region.volume, region.extreme, region.mean)
    return {
        "number": region.number, "kind": region.kind, "side": region.side, "where": region.where,
        "title": title_region(region), "caption": caption_region(region, facts),
        "estimates": _in_columns(*figures),
        "close_up": room.put(drawn[0]), "section": room.put(drawn[1]),
    }  # fmt: skip


def _in_columns(*figures: Estimate) -> list[dict[str, Any]]:
    """Return what of each estimate stands in the column of its value, and in the one beside it; words take both."""
    return [{"value": e.value, "beside": e.beside, "is_words": e.is_words} for e in figures]


def _series(series: SeriesFacts, chart: Mapping[str, str] | None) -> dict[str, Any]:
    """Return what goes on over several epochs."""
    motions = None if series.motions is None else fit_columns(series.motions, PAGE)
    heads = ("Region", "On the map", "Where", "How it goes on", "First seen")
    rows = tuple(
        (str(c.number), c.on_map, c.where, "; ".join(t for t in (c.course, c.origin) if t), c.first_seen[:NAMES])
        for c in series.courses
    )
    figures = [(c.area, c.mean, c.rate, c.volume_rate) for c in series.courses]
    fitted = fit_columns(Table("", heads, rows), max(COURSES - _letters_beside(figures), LINE))
    courses = [
        {
            "number": c.number,
            "side": c.side,
            "words": [*words[1:4], _break_words(c.first_seen, PIECE)],
            "estimates": _in_columns(*estimates),
        }
        for c, words, estimates in zip(series.courses, fitted["rows"], figures, strict=True)
    ]
    return {"lead": _break_words(series.lead, LONGEST), "chart": chart, "courses": courses, "motions": motions,
            "columns": fitted["columns"], "widths": fitted["widths"]}  # fmt: skip


def _letters_beside(figures: Sequence[Sequence[Estimate]]) -> float:
    """Return how many letters the columns of figures take, a row of `figures` a course: value and what is beside it."""
    pairs = [[(len(e.value), len(e.beside) - 1) for e in column] for column in zip(*figures, strict=True)]
    return sum(max(v for v, _ in pair) + max(b for _, b in pair) + 2 * SEAM for pair in pairs)


def _date(facts: ReportFacts) -> Mapping[str, int] | None:
    """Return the day of the computation, None where it is not known."""
    moment = facts.computed
    return None if moment is None else {"year": moment.year, "month": moment.month, "day": moment.day}


def _moment(facts: ReportFacts) -> datetime.datetime | None:
    """Return when the document is said to have been made: when the comparison was, so that its bytes are the same."""
    return None if facts.computed is None else datetime.datetime.combine(facts.computed, datetime.time(), datetime.UTC)
