"""The project store: an open project folder, its objects, epochs, raw scans and products (projects/FORMAT.md).

What each call does is written in the modules named by their nouns; here is only who calls whom, under which lock.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path, PurePosixPath
from shlex import quote
from typing import Any

import h5py

from projects import hdf5, raw
from projects.atomic import PARTIAL, clear_partial, draft, make_folder, place
from projects.elements import read_element, write_element
from projects.errors import ParameterError, StoreError
from projects.extent import Extent
from projects.identifiers import (
    epoch_folder,
    object_folder,
    product_of_file,
    require_new_id,
    require_step_id,
    split_product,
)
from projects.index import (
    EpochEntry,
    Index,
    ObjectEntry,
    ProductEntry,
    all_products,
    find_epoch,
    find_object,
    find_product,
    with_epoch,
    with_object,
    with_product,
    without_epoch,
    without_product,
)
from projects.index_file import INDEX_NAME, read_index, write_index
from projects.letter_case import require_own_folder
from projects.lock import LOCK_NAME, Lock
from projects.model import EpochRecord, ObjectRecord, Scan, Step, Surface
from projects.products import CONTENT, drafted_product, is_whole, open_product, place_product, require_bytes
from projects.provenance import now
from projects.raw import Progress, ScanHeader, ScanStream
from projects.verify import VerifyReport, delete_unnamed, verify_project
from projects.visible_text import require_visible

LOCK_WAIT = 10.0  # s that a writer waits for another: they hold the lock to enter what lies written, not to write it


class Project:
    """An open project folder. Reading needs no lock; every change is entered whole, under the lock, or not at all."""

    def __init__(self, path: Path) -> None:
        """Use `Project.open` or `Project.create`."""
        self.path = path
        self._lock = Lock(path)
        self._index: tuple[Any, Index] | None = None
        self._verified: set[tuple[Any, ...]] = set()

    @classmethod
    def create(cls, path: Path | str, *, name: str = "", crs: str = "", description: str = "") -> Project:
        """Make a new project in an empty or new folder; refuse any other."""
        path, index = Path(path), Index(name=name, crs=crs, description=description, created=now())
        require_visible(index, f"project {path.name}")
        _require_empty(path)
        try:
            make_folder(path)
        except OSError as error:
            raise StoreError(f"{path} cannot be made ({error.strerror})") from error
        project = cls(path.resolve())
        with project.writing():
            _require_empty(path)
            project._commit(index)
        return project

    @classmethod
    def open(cls, path: Path | str) -> Project:
        """Open a project; raise `StoreError` where the folder is not one."""
        path = Path(path)
        if not _exists(path):
            raise StoreError(f"{path} does not exist; make a project with: monitor init {quote(str(path))}")
        if not path.is_dir():
            raise StoreError(f"{path} is a file; a project is a folder that holds {INDEX_NAME}")
        if not (path / INDEX_NAME).is_file():
            raise StoreError(f"{path} is not a project: it holds no {INDEX_NAME}; make one with: monitor init")
        project = cls(path.resolve())
        project.index()
        return project

    @property
    def name(self) -> str:
        """The project's name as the user wrote it."""
        return self.index().name

    @property
    def quoted(self) -> str:
        """The folder as a shell takes it, in commands that are suggested."""
        return quote(str(self.path))

    @property
    def crs(self) -> str:
        """The coordinate reference system of the project's frame, as stated; empty where it is local."""
        return self.index().crs

    @property
    def description(self) -> str:
        """The project's description."""
        return self.index().description

    # what exists

    def index(self) -> Index:
        """Return the last committed state; it is read anew only when a writer has replaced it."""
        key = _seen(self.path / INDEX_NAME)
        if key is None:
            raise StoreError(f"{self.path / INDEX_NAME} is gone; restore it from a copy")
        if self._index is None or self._index[0] != key:
            self._index = (key, read_index(self.path / INDEX_NAME))
        return self._index[1]

    def objects(self) -> list[ObjectRecord]:
        """Return the objects, by id."""
        return [entry.record for _, entry in sorted(self.index().objects.items())]

    def object(self, object_id: str) -> ObjectRecord:
        """Return an object; raise `StoreError` naming those that exist."""
        return find_object(self.index(), object_id).record

    def epochs(self, object_id: str) -> list[EpochRecord]:
        """Return the epochs of an object, by date, then id."""
        records = [entry.record for entry in find_object(self.index(), object_id).epochs.values()]
        return sorted(records, key=lambda e: (e.date, e.epoch_id))

    def epoch(self, object_id: str, epoch_id: str) -> EpochRecord:
        """Return an epoch; raise `StoreError` naming those that exist."""
        return find_epoch(self.index(), object_id, epoch_id).record

    def steps(self, object_id: str, epoch_id: str) -> list[Step]:
        """Return the steps of all products of an epoch, in the order of their making, of one second by their names."""
        products = find_epoch(self.index(), object_id, epoch_id).products.values()
        return sorted((p.step for p in products), key=lambda s: (s.created, s.product))

    def latest(self, object_id: str, epoch_id: str, product: str) -> Step | None:
        """Return the step of a product, None where there is none or its file is missing or cut off."""
        split_product(product)
        entry = find_epoch(self.index(), object_id, epoch_id).products.get(product)
        return entry.step if entry is not None and is_whole(self.path, entry) else None

    def find(self, object_id: str, epoch_id: str, product: str, step_id: str) -> Step | None:
        """Return the step of a product if it answers exactly this question, else None: then it is to be made."""
        step = self.latest(object_id, epoch_id, product)
        return step if step is not None and step.step_id == step_id else None

    # changes

    @contextmanager
    def writing(self, wait: float = LOCK_WAIT) -> Iterator[None]:
        """Hold the project's lock, so that nobody else writes in between; re-entrant. `wait` in seconds."""
        with self._lock.held(wait) as first:
            if first:
                self._lock.clear_drafts()
                clear_partial(self.path)
            yield

    def _commit(self, index: Index, made: ProductEntry | None = None) -> None:
        """Replace the index, atomically and durably: the one instant at which a change happens.

        Where the disk does not take it the file of the product that was to be entered is taken back.
        """
        try:
            with draft(self.path) as path:
                write_index(path, index)
                written = read_index(path)  # an index that cannot be read must not replace one that can
                self._lock.require_mine()
                place(path, self.path / INDEX_NAME)
            self._index = (_seen(self.path / INDEX_NAME), written)
        except OSError as error:
            if made is not None and made.file not in {entry.file for _, entry in all_products(self.index())}:
                with suppress(OSError):
                    (self.path / made.file).unlink()
            why = hdf5.in_one_line(error)
            raise StoreError(f"{self.path}: the index could not be written ({why}); nothing was entered") from error

    def add_object(self, record: ObjectRecord) -> None:
        """Enter an object; its id must be new."""
        with self.writing():
            require_new_id(record.object_id, self.index().objects, "object")
            require_own_folder(self.path, object_folder(record.object_id), f"object {record.object_id!r}")
            require_visible(record, f"object {record.object_id}")
            if record.extent is not None:
                Extent.from_mapping(record.extent)
            _require_bearing(record)
            self._commit(with_object(self.index(), ObjectEntry(record)))

    def set_front(self, object_id: str, front: float) -> None:
        """Enter to which side an object's front faces [rad], as of `ObjectRecord`; no product rests on it."""
        with self.writing():
            entry = find_object(self.index(), object_id)
            record = replace(entry.record, front=front)
            _require_bearing(record)
            self._commit(with_object(self.index(), replace(entry, record=record)))

    def add_epoch(
        self, record: EpochRecord, scans: Iterable[ScanStream] = (), *, mesh: Surface | None = None,
        progress: Progress | None = None,
    ) -> EpochRecord:  # fmt: skip
        """Enter an epoch with its scans, streamed (product `raw`), or with a finished mesh (product `mesh`).

        Any error, of a reader or of the disk, leaves the project as it was. Others may write while the scans stream.
        Returns the record with its sources.
        """
        with self.writing():  # what would be refused is refused before the scans are read
            self._require_new_epoch(record)
        if mesh is None:
            drafted = drafted_product(self.path, record, lambda f: raw.write_scans(f, record, scans, progress))
        else:
            step = raw.mesh_step(record, mesh)
            drafted = drafted_product(self.path, record, lambda f: _write_content(f, step, mesh))
        with drafted as (path, entry), self.writing():
            self._require_new_epoch(record)
            known = {"sources": raw.sources_of(entry.step)} if mesh is None else {"is_mesh": True}
            record = replace(record, **known)
            place_product(self.path, path, entry)
            self._commit(with_epoch(self.index(), EpochEntry(record, {entry.step.product: entry})), entry)
        return record

    def _require_new_epoch(self, record: EpochRecord) -> None:
        """Raise where an epoch has no date, or its object is not there, or has one of its id."""
        if type(record.date) is not datetime.date:
            raise ParameterError(f"date {record.date!r} of epoch {record.epoch_id!r}: a date (YYYY-MM-DD) is needed")
        require_new_id(record.epoch_id, find_object(self.index(), record.object_id).epochs, "epoch")
        require_own_folder(self.path, epoch_folder(record.object_id, record.epoch_id), f"epoch {record.epoch_id!r}")
        require_visible(record, f"epoch {record.epoch_id}")

    def remove_epoch(self, object_id: str, epoch_id: str, *, purge: bool = False) -> None:
        """Take an epoch out of the index, with the comparisons made from it; `purge` also deletes its files.

        An epoch that was taken out before can still be purged. What other epochs left on disk stays there.
        """
        with self.writing():
            before = self.index()
            if not (purge and self._has_left(object_id, epoch_id)):
                self._commit(without_epoch(before, self.epoch(object_id, epoch_id)))
            if purge:
                self._purge_epoch(object_id, epoch_id, {entry.file for _, entry in all_products(before)})

    def _purge_epoch(self, object_id: str, epoch_id: str, named_before: set[str]) -> None:
        """Delete what the index does not name, or no longer: in the folder of an epoch, and what was made from it."""
        own = epoch_folder(object_id, epoch_id)

        def is_of_it(name: str) -> bool:
            """Return whether a file of a product is of the epoch or rests on it."""
            path = PurePosixPath(name)
            return name in named_before or path.parent == own or product_of_file(path.name)[1] == epoch_id

        delete_unnamed(self.path, self.index(), object_id, is_of_it)

    def _has_left(self, object_id: str, epoch_id: str) -> bool:
        """Return whether an epoch is out of the index and its files are still there."""
        is_known = epoch_id in find_object(self.index(), object_id).epochs
        return not is_known and any((self.path / epoch_folder(object_id, epoch_id)).glob("*.h5"))

    def purge(self, object_id: str | None = None) -> list[Path]:
        """Delete the product files that the index does not name, of one object or of all; return what was deleted."""
        with self.writing():
            return delete_unnamed(self.path, self.index(), object_id)

    def verify(self, progress: Callable[[str, int], None] | None = None) -> VerifyReport:
        """Check every file against the index; `progress` is told each file and its size in bytes."""
        return verify_project(self.path, progress)

    def put(
        self, object_id: str, epoch_id: str, step: Step, noun: Any, *, require: Callable[[], None] = lambda: None
    ) -> Step:
        """Store a product and enter it: a noun, an array, a table, or a mapping of such and of JSON values.

        The same step put twice is stored once. `require` is called when nobody else can write any more, just before the
        product is entered; where it raises, nothing is. Returns the step with its time and versions.
        """
        require_step_id(step.step_id)
        epoch, present = self._present(object_id, epoch_id, step)
        if present is not None and self._is_intact(present):
            return present.step
        drafted = drafted_product(self.path, epoch.record, lambda f: _write_content(f, step, noun))
        with drafted as (path, entry), self.writing():
            require()
            epoch, present = self._present(object_id, epoch_id, step)
            if present is not None:
                if self._is_intact(present):
                    return present.step
                # its file is about to be replaced: first no longer claim the old bytes
                self._commit(without_product(self.index(), epoch.record, step.product))
            place_product(self.path, path, entry)
            self._commit(with_product(self.index(), epoch.record, entry), entry)
        return entry.step

    def _present(self, object_id: str, epoch_id: str, step: Step) -> tuple[EpochEntry, ProductEntry | None]:
        """Return an epoch, and the product of just this step where the index holds it; the epochs must be there."""
        _, reference = split_product(step.product)
        epoch = find_epoch(self.index(), object_id, epoch_id)
        if reference is not None:
            self.epoch(object_id, reference)
        present = epoch.products.get(step.product)
        return epoch, present if present is not None and present.step.step_id == step.step_id else None

    # contents

    def get(self, object_id: str, epoch_id: str, product: str, step_id: str | None = None) -> Any:
        """Return the noun that was put, equal to it; every byte of its file is checked against the index."""
        epoch = self.epoch(object_id, epoch_id)
        entry = find_product(find_epoch(self.index(), object_id, epoch_id), product, step_id)
        self._require_bytes(entry, f"{object_id} {epoch_id} {product}")
        with open_product(self.path, epoch, entry) as file:
            return read_element(file, CONTENT)

    def scan_headers(self, object_id: str, epoch_id: str) -> list[ScanHeader]:
        """Return what is known of each scan of an epoch, from the index alone; none for a finished mesh."""
        epoch = find_epoch(self.index(), object_id, epoch_id)
        return [] if epoch.record.is_mesh else raw.headers_of(find_product(epoch, "raw").step)

    def iterate_scan(self, object_id: str, epoch_id: str, index: int, *, chunk: int = 1_000_000) -> Iterator[Scan]:
        """Yield a raw scan in pieces of at most `chunk` points, in the scanner's frame; checksums are verified."""
        epoch = find_epoch(self.index(), object_id, epoch_id)
        entry = find_product(epoch, "raw")
        self._require_bytes(entry, f"{object_id} {epoch_id} raw")
        with open_product(self.path, epoch.record, entry) as file:
            groups = raw.scan_groups(file)
            if not 0 <= index < len(groups):
                raise StoreError(f"{object_id} {epoch_id} has scans 0 to {len(groups) - 1}; {index} was asked for")
            yield from raw.read_chunks(groups[index], chunk)

    def _require_bytes(self, entry: ProductEntry, what: str) -> None:
        """Check a file's hash before HDF5 reads it; once for as long as its size and time stay the same.

        HDF5's own checksums cover what it reads, but a damaged file can hold it for ever before it gets there.
        """
        key = (entry.file, entry.sha256, _seen(self.path / entry.file))
        if key not in self._verified:
            require_bytes(self.path, entry, what)
            self._verified.add(key)

    def _is_intact(self, entry: ProductEntry) -> bool:
        """Return whether the file of a product is as the index says."""
        try:
            require_bytes(self.path, entry, entry.file)
        except StoreError:
            return False
        return True


def _require_bearing(record: ObjectRecord) -> None:
    """Raise `ParameterError` where the front of an object faces to no bearing."""
    front = record.front
    if front is not None and (
        isinstance(front, bool) or not isinstance(front, int | float) or not 0.0 <= front < math.tau
    ):
        raise ParameterError(
            f"front {front!r} of {record.object_id}: a bearing from 0 to below 2 pi rad is needed, or None"
        )


def _seen(path: Path) -> tuple[int, int, int] | None:
    """Return what changes when a file is replaced, None where it is missing."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size


def _write_content(file: h5py.File, step: Step, noun: Any) -> Step:
    """Write the noun of a product and return its step."""
    write_element(file, CONTENT, noun)
    return step


def _exists(path: Path) -> bool:
    """Return whether there is anything at a path; refuse one that cannot be reached."""
    try:
        path.stat()
    except FileNotFoundError:
        return False
    except (OSError, ValueError) as error:  # a name too long, a folder above that may not be entered, a NUL
        raise StoreError(f"{str(path)[:200]!r} cannot be reached ({hdf5.in_one_line(error)})") from error
    return True


def _require_empty(path: Path) -> None:
    """Raise where a folder is in use; what an interrupted `create` left there does not count."""
    if not _exists(path):
        return
    if not path.is_dir():
        raise StoreError(f"{path} is a file; choose a new folder for the project")
    if (path / INDEX_NAME).exists():
        raise StoreError(f"{path} is a project already; open it, or choose another folder")
    others = [p.name for p in path.iterdir() if p.name != PARTIAL and not p.name.startswith(LOCK_NAME)]
    if others:
        raise StoreError(f"{path} is not empty (it holds {sorted(others)[0]!r}); choose a new folder for the project")
