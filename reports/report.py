"""The report of a comparison, in both its forms: the page for the screen and the document to be signed and filed."""

from __future__ import annotations

from pathlib import Path

from reports.facts import ReportFacts
from reports.html import write_page
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
    page, document = (stem.with_name(f"{stem.name}.{kind}") for kind in ("html", "pdf"))
    write_page(page, facts, pictures)
    write_document(document, facts, pictures)
    return [page, document]
