"""A campaign declared in one file (TOML): the project, its objects, their epochs, what to compare, what to hand out.

In: the file's path. Out: a `Campaign` of which everything was checked that can be before work begins; paths in the file
are relative to its folder.
"""

from __future__ import annotations

import datetime
import difflib
import glob
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from monitor.cli.adding import EpochRequest, read_request
from monitor.cli.results import parse_formats, require_place
from monitor.cli.units import bearing_from_direction, metres_from_millimetres
from monitor.comparison.comparable import MODES
from projects.errors import MonitorError, ParameterError
from projects.extent import read_extent
from projects.identifiers import require_id
from projects.model import ObjectRecord
from projects.visible_text import require_visible

TEXTS = ("name", "inventory", "place", "material", "description")
WILD = "*?["


@dataclass(frozen=True)
class PairRequest:
    """Two epochs to compare, and how: `mode` and `stable` as of the command compare."""

    reference: str
    compared: str
    mode: str | None
    stable: Path | None


@dataclass(frozen=True)
class ObjectRequest:
    """An object with its epochs; without `pairs` each epoch is compared with the first and the one before."""

    record: ObjectRecord
    epochs: tuple[EpochRequest, ...]
    pairs: tuple[PairRequest, ...]


@dataclass(frozen=True)
class Campaign:
    """What a campaign's file says; `report`, `export` and `archive` are folders, None where that is not wanted."""

    project: Path
    name: str
    crs: str
    description: str
    settings: Path | None
    report: Path | None
    export: Path | None
    formats: str
    archive: Path | None
    objects: tuple[ObjectRequest, ...]


def read_campaign(path: Path) -> Campaign:
    """Return what a campaign's file says.

    Raises
    ------
    ParameterError
        In one line where the file cannot be read, a name in it is unknown, something is missing or of the wrong kind,
        or a file that it names is not there.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or 'not UTF-8'})") from error
    except tomllib.TOMLDecodeError as error:
        raise ParameterError(f"{path}: is not TOML ({error})") from error
    except RecursionError as error:
        raise ParameterError(f"{path}: is nested too deeply for a campaign") from error
    table = _Table(content, "", path)
    formats = table.text("formats") or "ply"
    parse_formats(formats)
    campaign = Campaign(
        project=table.required_path("project"), name=table.text("name"), crs=table.text("crs"),
        description=table.text("description"), settings=table.file("settings"), report=table.path("report"),
        export=table.path("export"), formats=formats, archive=table.path("archive"),
        objects=tuple(_read_object(inner) for inner in table.tables("object")),
    )  # fmt: skip
    table.require_no_other()
    require_visible(campaign, "the project")
    if not campaign.objects:
        raise ParameterError(f"{path}: declares no object; add one: [[object]] with id and [[object.epoch]]")
    _require_once([o.record.object_id for o in campaign.objects], "object", path)
    _require_places(campaign, path)
    return campaign


def _require_places(campaign: Campaign, path: Path) -> None:
    """Refuse folders to write to of which it is known before work begins that nothing can be written there."""
    places = {"report": campaign.report, "export": campaign.export, "archive": campaign.archive}
    for name, place in places.items():
        if place is not None and not place.is_dir():  # what is there already may stay as it is
            require_place(place, f"{path}: {name}")
    for name, place in places.items():
        is_within = place is not None and place.resolve().is_relative_to(campaign.project.resolve())
        if is_within and name != "archive":
            raise ParameterError(
                f"{path}: {name} {place} lies within the project {campaign.project}; give another folder"
            )
    if campaign.archive is None:
        return
    archive = campaign.archive.resolve()
    for name, place in {"project": campaign.project, **places, "archive": None}.items():
        if place is not None and (place.resolve().is_relative_to(archive) or archive.is_relative_to(place.resolve())):
            raise ParameterError(
                f"{path}: {name} {place} and archive {campaign.archive} lie within each other; an archive needs a "
                "folder of its own"
            )


def _read_object(table: _Table) -> ObjectRequest:
    """Return one object."""
    object_id = require_id(table.required_text("id"), "OBJECT")
    extent, limit, front = table.file("extent"), table.number("tolerance"), table.direction("front")
    record = ObjectRecord(
        object_id=object_id,
        extent=None if extent is None else read_extent(extent).to_mapping(),
        tolerance=None if limit is None else metres_from_millimetres(limit, f"{table.where}tolerance"),
        front=None if front is None else bearing_from_direction(front, table.at("front")),
        **{name: table.text(name) for name in TEXTS},
    )
    require_visible(record, f"object {object_id}")
    epochs = tuple(_read_epoch(inner, object_id) for inner in table.tables("epoch"))
    known = [e.epoch_id for e in epochs]
    _require_once(known, f"epoch of {object_id}", table.path_of_file)
    pairs = tuple(_read_pair(inner) for inner in table.tables("compare"))
    _require_once([f"{p.reference} and {p.compared}" for p in pairs], f"comparison of {object_id}", table.path_of_file)
    table.require_no_other()
    return ObjectRequest(record, epochs, pairs)


def _read_epoch(table: _Table, object_id: str) -> EpochRequest:
    """Return one epoch, checked as `add-epoch` would."""
    request = EpochRequest(
        object_id=object_id, epoch_id=table.required_text("id"), date=table.date("date"), label=table.text("label"),
        scanner=table.text("scanner") or None, operator=table.text("operator"), poses=table.file("poses"),
        control=table.file("control"), repeated=table.flag("repeated"), mesh=table.flag("mesh"),
        unit=table.text("unit") or None, files=table.files("files"),
    )  # fmt: skip
    table.require_no_other()
    try:
        read_request(request)
    except MonitorError as error:
        raise ParameterError(f"{table.path_of_file}: {table.where.rstrip('.')}: {error}") from error
    return request


def _read_pair(table: _Table) -> PairRequest:
    """Return two epochs to compare."""
    mode = table.text("mode") or None
    if mode not in (None, *MODES):
        raise ParameterError(f"{table.at('mode')} {mode}: allowed are {', '.join(MODES)}")
    stable = table.file("stable")
    if stable is not None:
        read_extent(stable)
    pair = PairRequest(table.required_text("reference"), table.required_text("compared"), mode, stable)
    table.require_no_other()
    if pair.reference == pair.compared:
        raise ParameterError(f"{table.at('reference')} and compared are both {pair.compared}; two epochs are needed")
    return pair


def _require_once(ids: list[str], what: str, path: Path) -> None:
    """Refuse an id that is declared twice."""
    for k, name in enumerate(ids):
        if name in ids[:k]:
            raise ParameterError(f"{path}: {what} {name} is declared twice; leave one of them out or change its id")


def _at_home(path: str) -> str:
    """Return a path of which ~ at the beginning is the user's home, as on the command line; a file may be called ~a."""
    return os.path.expanduser(path) if path == "~" or path.startswith("~/") else path


class _Table:
    """One table of the file: gives its values by name and kind, and knows which names were never asked for."""

    def __init__(self, values: Mapping[str, Any], where: str, path_of_file: Path) -> None:
        """`where` names the table within the file, with a dot at its end."""
        self.values, self.where, self.path_of_file = values, where, path_of_file
        self._asked: list[str] = []

    def at(self, key: str) -> str:
        """Return the full name of a value for a message."""
        return f"{self.path_of_file}: {self.where}{key}"

    def _take(self, key: str, kind: type | tuple[type, ...], needed: str) -> Any:
        """Return a value of the kind that is needed, None where there is none."""
        self._asked.append(key)
        value = self.values.get(key)
        if value is None or (isinstance(value, kind) and not (isinstance(value, bool) and kind is not bool)):
            return value
        raise ParameterError(f"{self.at(key)} is {value!r}; {needed} is needed")

    def text(self, key: str) -> str:
        """Return a text, empty where there is none."""
        return self._take(key, str, "a text in quotes") or ""

    def required_text(self, key: str) -> str:
        """Return a text that must be there."""
        value = self.text(key)
        if not value:
            raise ParameterError(f"{self.at(key)} is missing")
        return value

    def flag(self, key: str) -> bool:
        """Return true or false, false where it is left out."""
        return bool(self._take(key, bool, "true or false"))

    def number(self, key: str) -> float | None:
        """Return a number."""
        value = self._take(key, (int, float), "a number")
        try:
            return None if value is None else float(value)
        except OverflowError as error:
            raise ParameterError(f"{self.at(key)} is too large for a number") from error

    def direction(self, key: str) -> str | float | None:
        """Return the name of a side, or degrees."""
        value: str | float | None = self._take(key, (str, int, float), "the name of a side or a number of degrees")
        return value

    def date(self, key: str) -> str:
        """Return a date as text, written with or without quotes."""
        value = self._take(key, (str, datetime.date), "a date like 2026-05-31")
        if value is None:
            raise ParameterError(f"{self.at(key)} is missing; a date like 2026-05-31 is needed")
        return value if isinstance(value, str) else value.isoformat()

    def path(self, key: str) -> Path | None:
        """Return a path, relative to the file's folder."""
        value = self.text(key)
        return self.path_of_file.parent / _at_home(value) if value else None

    def required_path(self, key: str) -> Path:
        """Return a path that must be given."""
        return self.path_of_file.parent / _at_home(self.required_text(key))

    def file(self, key: str) -> Path | None:
        """Return the path of a file that must be there, where one is given."""
        path = self.path(key)
        if path is not None and not path.is_file():
            raise ParameterError(f"{self.at(key)}: there is no file {path}")
        return path

    def files(self, key: str) -> tuple[Path, ...]:
        """Return files, each named or by a pattern like `after-*.ply`, in the order of their names."""
        listed = self._take(key, list, "a list of files")
        if not listed or not all(isinstance(name, str) and name for name in listed):
            raise ParameterError(f'{self.at(key)}: a list of files is needed, like ["after-*.ply"]')
        found: list[Path] = []
        for name in map(_at_home, listed):
            folder = self.path_of_file.parent
            path = folder / name
            wild = any(c in name for c in WILD) and not path.exists()
            matching = sorted(glob.glob(name, root_dir=folder)) if wild else [name]
            some = [folder / match for match in matching if not wild or (folder / match).is_file()]
            if not some or not all(p.is_file() for p in some):
                raise ParameterError(f"{self.at(key)}: there is no file {path}")
            found += [p for p in some if p not in found]
        return tuple(found)

    def tables(self, key: str) -> list[_Table]:
        """Return the tables of an array of tables."""
        listed = self._take(key, list, f"a table headed [[{self.where}{key}]]") or []
        if not all(isinstance(inner, dict) for inner in listed):
            raise ParameterError(f"{self.at(key)}: tables headed [[{key}]] are needed")
        names = (str(inner.get("id") or k) for k, inner in enumerate(listed, start=1))
        return [_Table(inner, f"{self.where}{key} {name}.", self.path_of_file)
                for inner, name in zip(listed, names, strict=True)]  # fmt: skip

    def require_no_other(self) -> None:
        """Refuse a name that nothing asked for, with the nearest one that is known."""
        for key in self.values:
            if key not in self._asked:
                near = difflib.get_close_matches(key, self._asked, 1)
                hint = f"; is {near[0]} meant?" if near else f"; known are {', '.join(self._asked)}"
                raise ParameterError(f"{self.at(key)} is not known{hint}")
