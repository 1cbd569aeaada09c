"""The report of a comparison, in both its forms: the page for the screen and the document to be signed and filed."""

from __future__ import annotations

from pathlib import Path

from reports.facts import ReportFacts
from reports.html import write_page
from reports.making import mark_of
from reports.pdf import write_document
from reports.pictures import draw_pictures


def write_report(stem: Path, facts: ReportFacts) -> list[Path]:
    """Draw the pictures of a comparison once, write `STEM.html` and `STEM.pdf`, and return both paths.

    Raises
    ------
    ParameterError
        If a file cannot be written there; what was there before stays.
    """
    pictures = draw_pictures(facts)
    page, document = _paths(stem)
    write_page(page, facts, pictures)
    write_document(document, facts, pictures)
    return [page, document]


def is_current(stem: Path, facts: ReportFacts) -> bool:
    """Return whether both files of a report are there, each marked as made of just these facts by this program."""
    mark = mark_of(facts).encode("ascii")
    return all(path.is_file() and mark in path.read_bytes() for path in _paths(stem))


def _paths(stem: Path) -> tuple[Path, Path]:
    """Return the paths of the page and of the document."""
    page, document = (stem.with_name(f"{stem.name}.{kind}") for kind in ("html", "pdf"))
    return page, document
