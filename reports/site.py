"""A project to be browsed: objects, their epochs and comparisons, with pictures and reports, as pages of a local site.

In: an open project, read only. Out: a WSGI application (PEP 3333). A page is made when it is asked for; what takes long
to draw is kept, by the step that it shows, until newer things need the room.
"""

from __future__ import annotations

import datetime
import re
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from projects.errors import MonitorError, StoreError
from projects.identifiers import series_product
from projects.model import Comparison, EpochRecord, Series, Step
from projects.store import Project
from reports.cameras import choose_one
from reports.colours import choose_limit
from reports.courses import tell_series
from reports.document import gather_facts
from reports.facts import Answer
from reports.history import describe_object
from reports.kept import end_of_longest_series, kept_comparisons, require_comparison
from reports.pictures import show_colour_bar
from reports.quantities import count, day
from reports.report import write_report
from reports.views import draw_difference, draw_surface

KEPT = 64  # pictures, answers and reports that are kept
PIXELS = 520  # longest side of a picture
POLICY = (
    "default-src 'none'; img-src 'self' data:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
HTML, JPEG, SVG, PDF = "text/html; charset=utf-8", "image/jpeg", "image/svg+xml", "application/pdf"
LOCAL = ("127.0.0.1", "localhost", "[::1]")

Key = tuple[str | float | None, ...]  # of what is shown, and the step and the front that it shows
Start = Callable[[str, list[tuple[str, str]]], Any]


@dataclass(frozen=True)
class Reply:
    """What one address holds."""

    content: bytes
    media_type: str
    status: str = "200 OK"


class Site:
    """The pages of one project: `/`, `/OBJECT`, `/OBJECT/EPOCH.jpg`, `/OBJECT/REFERENCE_COMPARED.jpg` (.html, .pdf, and
    .svg for the legend of its colours)."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._kept: OrderedDict[Key, Any] = OrderedDict()
        self._guard = threading.Lock()
        self._drawing = threading.Lock()  # one thing is drawn at a time: drawing takes all processors
        self._templates = Environment(
            loader=PackageLoader("reports", "templates"), autoescape=True, undefined=StrictUndefined,
            trim_blocks=True, lstrip_blocks=True,
        )  # fmt: skip

    def __call__(self, environ: dict[str, Any], start: Start) -> Iterable[bytes]:
        """Answer one request; only reading, only from this machine."""
        reply = self._answer(environ)
        start(reply.status, [
            ("Content-Type", reply.media_type), ("Content-Length", str(len(reply.content))),
            ("Content-Security-Policy", POLICY), ("X-Content-Type-Options", "nosniff"), ("Cache-Control", "no-store"),
            ("Referrer-Policy", "no-referrer"), ("Cross-Origin-Resource-Policy", "same-origin"),
        ])  # fmt: skip
        return [] if environ.get("REQUEST_METHOD") == "HEAD" else [reply.content]

    def _answer(self, environ: dict[str, Any]) -> Reply:
        """Return what a request gets."""
        host = re.sub(r":\d*$", "", str(environ.get("HTTP_HOST", "")))
        if host not in LOCAL:  # a page of another site that had its name point here (DNS rebinding)
            return self._say("403 Forbidden", "This page is for this machine alone.")
        if environ.get("REQUEST_METHOD") not in ("GET", "HEAD"):
            return self._say("405 Method Not Allowed", "This page can only be read.")
        try:
            return self.reply(str(environ.get("PATH_INFO", "/")))
        except MonitorError as error:
            return self._say("404 Not Found", str(error))

    def reply(self, address: str) -> Reply:
        """Return what an address holds; raise `StoreError` where there is no such thing."""
        project, parts = Project.open(self.path), [p for p in address.split("/") if p]
        if not parts:
            return self._page("site.html", self._front(project))
        if len(parts) == 1:
            return self._page("object.html", self._object(project, parts[0]))
        if len(parts) == 2:
            stem, dot, kind = parts[1].rpartition(".")
            pair = tuple(stem.split("_"))
            if dot and kind == "jpg" and len(pair) == 1:
                return Reply(self._epoch_picture(project, parts[0], stem), JPEG)
            if dot and len(pair) == 2 and kind in ("jpg", "svg", "html", "pdf"):
                return self._of_comparison(project, parts[0], (pair[0], pair[1]), kind)
        raise StoreError(f"there is no page {address[:200]}")

    def _front(self, project: Project) -> dict[str, Any]:
        """Return what the first page says: every object with its epochs and what was found last."""
        objects = [
            {"id": o.object_id, "name": o.name or o.object_id, "place": o.place,
             "epochs": [day(e.date) for e in project.epochs(o.object_id)],
             "last": self._last(project, o.object_id)}
            for o in project.objects()
        ]  # fmt: skip
        return {"title": project.name or project.path.name, "about": project.description, "objects": objects}

    def _last(self, project: Project, object_id: str) -> str:
        """Return what changed between which days, of the two latest epochs that are compared, "" where none are: there
        may be later ones."""
        pairs = kept_comparisons(project, object_id)
        if not pairs:
            return ""
        before, after = (day(project.epoch(object_id, e).date) for e in pairs[-1])
        try:
            return f"{before} to {after}: {self._facts(project, object_id, pairs[-1])[0].headline}"
        except MonitorError as error:  # of one object, which must not hide the others
            return f"cannot be shown: {error}"

    def _object(self, project: Project, object_id: str) -> dict[str, Any]:
        """Return what an object's page says."""
        record = project.object(object_id)
        comparisons = [self._comparison(project, object_id, p) for p in kept_comparisons(project, object_id)[::-1]]
        return {
            "id": object_id, "title": record.name or object_id, "project": project.name or project.path.name,
            "known": describe_object(record, project.name, project.crs),
            "epochs": [self._epoch(project, e) for e in project.epochs(object_id)], "comparisons": comparisons,
            "series": self._series(project, object_id),
        }  # fmt: skip

    def _comparison(self, project: Project, object_id: str, pair: tuple[str, str]) -> dict[str, Any]:
        """Return one comparison as the object's page shows it; of one that is damaged, what is wrong with it."""
        told = {"name": "_".join(pair), "pair": pair}
        try:
            answer, subtitle, remarks = self._facts(project, object_id, pair)
        except MonitorError as error:
            return {**told, "fault": str(error)}
        return {**told, "fault": "", "answer": answer, "subtitle": subtitle, "remarks": remarks}

    def _series(self, project: Project, object_id: str) -> list[dict[str, Any]]:
        """Return what is told of more than two epochs: of each reference the longest series, with its days, what it
        says, and the comparison whose report holds it; of one that is damaged, what is wrong with it."""
        told = []
        for reference in project.epochs(object_id):
            last = end_of_longest_series(project, object_id, reference.epoch_id)
            step = None if last is None else project.latest(object_id, last, series_product(reference.epoch_id))
            if last is not None and step is not None:
                told.append(self._one_series(project, object_id, (reference.epoch_id, last), step))
        return told

    def _one_series(self, project: Project, object_id: str, pair: tuple[str, str], step: Step) -> dict[str, Any]:
        """Return what is told of the series from one epoch to another, or what is wrong with it."""

        def tell() -> tuple[list[str], str]:
            series: Series = project.get(object_id, pair[1], step.product, step.step_id)
            dates = (series.reference_date, *series.dates)
            return [day(datetime.date.fromisoformat(d)) for d in dates], tell_series(series).lead

        one = {"name": "_".join(pair), "pair": pair, "fault": "", "days": []}
        try:
            days, lead = self._keep(("series", object_id, *pair, step.step_id), tell)
        except MonitorError as error:
            return {**one, "fault": str(error)}
        return {**one, "days": days, "lead": lead}

    def _epoch(self, project: Project, epoch: EpochRecord) -> dict[str, Any]:
        """Return one epoch as the object's page shows it."""
        headers = project.scan_headers(epoch.object_id, epoch.epoch_id)
        measured = (
            "finished mesh"
            if epoch.is_mesh
            else f"{len(headers)} scan{'s' * (len(headers) > 1)}, {count(sum(h.n_points for h in headers))} points"
        )
        made = project.latest(epoch.object_id, epoch.epoch_id, "surface")
        vertices = None if made is None else made.counts.get("vertices")
        return {"id": epoch.epoch_id, "date": day(epoch.date), "label": epoch.label, "measured": measured,
                "operator": epoch.operator, "has_surface": made is not None,
                "vertices": "" if vertices is None else count(vertices)}  # fmt: skip

    def _facts(self, project: Project, object_id: str, pair: tuple[str, str]) -> tuple[Answer, str, tuple[str, ...]]:
        """Return the answer of a comparison, what was compared, and what its reader must know first."""

        def gather() -> tuple[Answer, str, tuple[str, ...]]:
            facts = gather_facts(project, object_id, *pair)
            return facts.answer, facts.subtitle, facts.remarks

        key = ("answer", *_state_of(project, object_id, pair))
        return self._keep(key, gather)

    def _epoch_picture(self, project: Project, object_id: str, epoch_id: str) -> bytes:
        """Return an epoch's surface as stone, from where most of it is seen."""
        made = project.latest(object_id, project.epoch(object_id, epoch_id).epoch_id, "surface")
        if made is None:
            raise StoreError(f"epoch {epoch_id} of object {object_id} is not processed yet")
        bearing = project.object(object_id).front

        def draw() -> bytes:
            surface = project.get(object_id, epoch_id, made.product, made.step_id)
            return draw_surface(surface, choose_one(surface, bearing=bearing), height_px=PIXELS).image

        return self._draw(("surface", object_id, epoch_id, made.step_id, bearing), draw)

    def _of_comparison(self, project: Project, object_id: str, pair: tuple[str, str], kind: str) -> Reply:
        """Return the picture of a comparison, the legend of its colours, or its report."""
        step = require_comparison(project, object_id, *pair)
        bearing = project.object(object_id).front
        key = (object_id, *pair, step.step_id, bearing)
        if kind in ("html", "pdf"):
            state = _state_of(project, object_id, pair)
            page, document = self._draw(("report", *state), lambda: self._report(project, object_id, pair))
            return Reply(page, HTML) if kind == "html" else Reply(document, PDF)

        def kept() -> Comparison:
            comparison: Comparison = project.get(object_id, pair[1], step.product, step.step_id)
            return comparison

        if kind == "svg":
            return Reply(self._draw(("colours", *key), lambda: show_colour_bar(kept()).image), SVG)

        def draw() -> bytes:
            comparison = kept()
            side, other = comparison.on_compared, comparison.on_reference
            view = choose_one(side.surface, side.region > 0, bearing)
            return draw_difference(side, view, limit_m=choose_limit(comparison), height_px=PIXELS, other=other).image

        return Reply(self._draw(("difference", *key), draw), JPEG)

    def _report(self, project: Project, object_id: str, pair: tuple[str, str]) -> tuple[bytes, bytes]:
        """Return the report of a comparison as page and document."""
        with tempfile.TemporaryDirectory() as folder:
            page, document = write_report(Path(folder) / "report", gather_facts(project, object_id, *pair))
            return page.read_bytes(), document.read_bytes()

    def _draw(self, key: Key, make: Callable[[], Any]) -> Any:
        """Return what is kept under a key, drawn where it is not; pages are answered meanwhile."""
        with self._drawing:
            return self._keep(key, make)

    def _keep(self, key: Key, make: Callable[[], Any]) -> Any:
        """Return what is kept under a key, made where it is not."""
        with self._guard:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        made = make()
        with self._guard:
            self._kept[key] = made
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        return made

    def _page(self, template: str, facts: dict[str, Any]) -> Reply:
        """Return a page; every text is escaped."""
        css = (
            files("reports").joinpath(f"templates/{name}.css").read_text(encoding="utf-8")
            for name in ("report", "site")
        )
        page = self._templates.get_template(template).render(style=Markup("\n".join(css)), **facts)
        return Reply(page.encode("utf-8"), HTML)

    def _say(self, status: str, text: str) -> Reply:
        """Return a line of text for what cannot be shown."""
        return Reply(text.encode("utf-8"), "text/plain; charset=utf-8", status)


def _state_of(project: Project, object_id: str, pair: tuple[str, str]) -> Key:
    """Return what a report of two epochs depends on: all that is kept of both, and where the object's front is."""
    require_comparison(project, object_id, *pair)
    made = (step.step_id for epoch_id in pair for step in project.steps(object_id, epoch_id))
    return (object_id, *pair, project.object(object_id).front, *made)
