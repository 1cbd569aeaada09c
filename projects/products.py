"""One immutable HDF5 file per product: its step, and its content; and the check that a file is the one asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py

from projects import hdf5
from projects.atomic import draft, flush, move
from projects.elements import VERSION, mark
from projects.errors import StoreError
from projects.identifiers import product_file
from projects.index import ProductEntry
from projects.migrations import require_known
from projects.model import EpochRecord, Step
from projects.provenance import hash_file, now, versions
from projects.records import from_json, to_json

FORMAT = "heritage-monitor product"
CONTENT = "content"
GIVEN = ("raw", "mesh")  # products that nothing makes anew: what was measured, or given as a finished mesh


@contextmanager
def drafted_product(
    root: Path, epoch: EpochRecord, write: Callable[[h5py.File], Step]
) -> Iterator[tuple[Path, ProductEntry]]:
    """Yield a product's file, its bytes on the disk but not in its place yet, and its entry for the index.

    `write` puts `content` into the open file and returns the step that it was (the id of raw scans is known only
    when all of them were read). No lock is needed. A file that was not placed by the end is removed.
    """
    with ExitStack() as stack:
        with _told_as_refusal(root):
            path = stack.enter_context(draft(root))
            with hdf5.create_file(path) as file:
                step = complete(write(file))
                _write_header(file, epoch, step)
            name = product_file(epoch.object_id, epoch.epoch_id, step.product, step.step_id)
            entry = ProductEntry(step, name.as_posix(), hash_file(path), path.stat().st_size)
            flush(path)
        yield path, entry


def place_product(root: Path, path: Path, entry: ProductEntry) -> None:
    """Move a drafted product to where its entry says; under the project's lock, just before it is entered."""
    if not (root / entry.file).resolve().is_relative_to(root.resolve()):
        raise StoreError(f"{root / entry.file} leads out of the project by a symbolic link; remove the link")
    with _told_as_refusal(root):
        move(path, root / entry.file)


@contextmanager
def _told_as_refusal(root: Path) -> Iterator[None]:
    """Tell an error of the disk as one line."""
    try:
        yield
    except OSError as error:
        why = hdf5.in_one_line(error)
        raise StoreError(f"{root}: a product could not be written ({why}); nothing was entered") from error


def complete(step: Step) -> Step:
    """Return the step with its time and versions filled in, and its records as they will be read back."""
    plain = {n: from_json(to_json(getattr(step, n))) for n in ("parameters", "automatic", "counts")}
    return replace(step, **plain, inputs=tuple(step.inputs), created=step.created or now(),
                   versions=dict(step.versions or versions()))  # fmt: skip


def _write_header(file: h5py.File, epoch: EpochRecord, step: Step) -> None:
    """Write what names the product, and its step."""
    mark(file, "product")
    for name, text in _identity(epoch, step).items():
        hdf5.write_attribute(file, name, text)
    hdf5.write_record(file, "step", step)


def stored_step(file: h5py.File) -> Any:
    """Return the step record of an open product file."""
    return hdf5.read_record(hdf5.child(file, "step"))


def _identity(epoch: EpochRecord, step: Step) -> dict[str, str]:
    """Return the attributes by which the index names a product."""
    return {"format": FORMAT, "object": epoch.object_id, "epoch": epoch.epoch_id, "product": step.product,
            "step_id": step.step_id}  # fmt: skip


def is_whole(root: Path, entry: ProductEntry) -> bool:
    """Return whether the product's file is there with its size (its bytes are checked where they are used)."""
    path = root / entry.file
    return path.is_file() and path.stat().st_size == entry.n_bytes


@contextmanager
def open_product(root: Path, epoch: EpochRecord, entry: ProductEntry) -> Iterator[h5py.File]:
    """Yield a product's file, open to read, if it is whole and the one that the index names."""
    what = f"{epoch.object_id} {epoch.epoch_id} {entry.step.product}"
    path = require_file(root, entry, what)
    with hdf5.open_file(path, what) as file:
        for name, text in _identity(epoch, entry.step).items():
            if hdf5.read_attribute(file, name) != text:
                raise StoreError(f"{what}: {path} was replaced by another file ({name} is not {text!r})")
        require_known("product", hdf5.read_attribute(file, VERSION), str(path))
        yield file


def require_file(root: Path, entry: ProductEntry, what: str) -> Path:
    """Return the path of a product's file; raise `StoreError` where it is missing, cut off or not in the project."""
    path = root / entry.file
    if not path.resolve().is_relative_to(root.resolve()):
        raise StoreError(f"{what}: {entry.file} leads out of the project; it is refused")
    if not path.is_file():
        raise StoreError(f"{what}: the file {path} is missing; {_advice(entry, False)}")
    if path.stat().st_size != entry.n_bytes:
        raise StoreError(
            f"{what}: {path} has {path.stat().st_size} bytes instead of {entry.n_bytes}; it was cut off or changed: "
            f"{_advice(entry, False)}"
        )
    return path


def require_bytes(root: Path, entry: ProductEntry, what: str) -> None:
    """Raise `StoreError` where the file's SHA-256 is not the one that the index holds."""
    path = require_file(root, entry, what)
    if hash_file(path) != entry.sha256:
        raise StoreError(f"{what}: the bytes of {path} were changed; {_advice(entry, True)}")


def _advice(entry: ProductEntry, has_its_size: bool) -> str:
    """Return what to do about a product's file that is not as it was written; one of its size passes for whole."""
    if entry.step.product in GIVEN:
        return "restore it from a copy, or take the epoch out and add it again from its files: monitor remove-epoch"
    return f"restore it from a copy, or {'delete it and ' if has_its_size else ''}make it anew with: monitor process"
