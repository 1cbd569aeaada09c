"""The report as one HTML file that needs nothing else: pictures inside, no script, no network, ready for A4 paper.

`ReportFacts` and their pictures go in; a file comes out that appears whole or not at all.
"""

from __future__ import annotations

import os
import uuid
from contextlib import suppress
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from projects.errors import ParameterError
from reports.captions import caption_calibration, caption_region, title_region, write_captions
from reports.facts import ReportFacts
from reports.making import mark_of
from reports.pictures import Pictures


def write_page(path: Path, facts: ReportFacts, pictures: Pictures) -> None:
    """Write a report as one self-contained HTML file.

    Raises
    ------
    ParameterError
        If the file cannot be written there; what was there before stays.
    """
    write_whole(path, fill_page(facts, pictures))


def fill_page(facts: ReportFacts, pictures: Pictures) -> str:
    """Return the page; every text is escaped, and a fact that is missing is an error, not a gap."""
    templates = Environment(
        loader=PackageLoader("reports", "templates"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    style = files("reports").joinpath("templates/report.css").read_text(encoding="utf-8")
    page = templates.get_template("report.html")
    return page.render(
        facts=facts, pictures=pictures, style=Markup(style), captions=write_captions(facts), title_region=title_region,
        caption_region=caption_region, caption_calibration=caption_calibration, mark=mark_of(facts),
    )  # fmt: skip


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
