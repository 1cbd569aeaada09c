"""The index of a project in memory: what exists, as values that are never changed, only replaced by others.

`projects.index_file` writes it to `project.h5` and reads it; names that do not exist are answered with those that do.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from projects.errors import StoreError
from projects.identifiers import split_product
from projects.model import EpochRecord, ObjectRecord, Step


@dataclass(frozen=True)
class ProductEntry:
    """A product of the index: its step, its file relative to the project, and that file's SHA-256 and size."""

    step: Step
    file: str
    sha256: str
    n_bytes: int


@dataclass(frozen=True)
class EpochEntry:
    """An epoch of the index with its products by name."""

    record: EpochRecord
    products: Mapping[str, ProductEntry] = field(default_factory=dict)


@dataclass(frozen=True)
class ObjectEntry:
    """An object of the index with its epochs by id."""

    record: ObjectRecord
    epochs: Mapping[str, EpochEntry] = field(default_factory=dict)


@dataclass(frozen=True)
class Index:
    """All that a project holds; never changed, only replaced by another."""

    name: str = ""
    crs: str = ""
    description: str = ""
    created: str = ""
    objects: Mapping[str, ObjectEntry] = field(default_factory=dict)


def with_object(index: Index, entry: ObjectEntry) -> Index:
    """Return the index with an object added or replaced."""
    return replace(index, objects={**index.objects, entry.record.object_id: entry})


def with_epoch(index: Index, entry: EpochEntry) -> Index:
    """Return the index with an epoch added to its object or replaced there."""
    owner = index.objects[entry.record.object_id]
    return with_object(index, replace(owner, epochs={**owner.epochs, entry.record.epoch_id: entry}))


def with_product(index: Index, epoch: EpochRecord, product: ProductEntry) -> Index:
    """Return the index with a product added to an epoch or replaced there."""
    entry = index.objects[epoch.object_id].epochs[epoch.epoch_id]
    return with_epoch(index, replace(entry, products={**entry.products, product.step.product: product}))


def without_product(index: Index, epoch: EpochRecord, product: str) -> Index:
    """Return the index without a product of an epoch."""
    entry = index.objects[epoch.object_id].epochs[epoch.epoch_id]
    return with_epoch(index, replace(entry, products={k: p for k, p in entry.products.items() if k != product}))


def without_epoch(index: Index, epoch: EpochRecord) -> Index:
    """Return the index without an epoch and without what other epochs of the object made from it."""
    owner = index.objects[epoch.object_id]
    steps = {key: {p.step.step_id for p in e.products.values()} for key, e in owner.epochs.items()}
    gone = steps.pop(epoch.epoch_id).difference(*steps.values())  # two epochs of the same files share their steps

    def stays(product: ProductEntry) -> bool:
        """Return whether a product rests neither on the epoch nor on what went with it."""
        of_it = split_product(product.step.product)[1] == epoch.epoch_id
        return not of_it and gone.isdisjoint(product.step.inputs)

    kept = {
        key: replace(e, products={k: p for k, p in e.products.items() if stays(p)})
        for key, e in owner.epochs.items()
        if key != epoch.epoch_id
    }
    return with_object(index, replace(owner, epochs=kept))


def find_object(index: Index, object_id: str) -> ObjectEntry:
    """Return an object; raise `StoreError` naming those that exist."""
    if object_id not in index.objects:
        raise StoreError(f"the project has no object {object_id!r}; {_what_exists(object_id, index.objects)}")
    return index.objects[object_id]


def find_epoch(index: Index, object_id: str, epoch_id: str) -> EpochEntry:
    """Return an epoch of an object; raise `StoreError` naming those that exist."""
    epochs = find_object(index, object_id).epochs
    if epoch_id not in epochs:
        raise StoreError(f"object {object_id!r} has no epoch {epoch_id!r}; {_what_exists(epoch_id, epochs)}")
    return epochs[epoch_id]


def find_product(epoch: EpochEntry, product: str, step_id: str | None = None) -> ProductEntry:
    """Return a product of an epoch, of the given step where one is stated; raise `StoreError` where it is not there."""
    where = f"{epoch.record.object_id} {epoch.record.epoch_id}"
    entry = epoch.products.get(product)
    if entry is None:
        raise StoreError(f"{where} has no {product!r}; {_what_exists(product, epoch.products)}")
    if step_id is not None and entry.step.step_id != step_id:
        raise StoreError(f"{where} {product}: step {step_id} is not in the project; it holds {entry.step.step_id}")
    return entry


def all_products(index: Index) -> list[tuple[EpochRecord, ProductEntry]]:
    """Return every product of the project with the epoch that it belongs to."""
    epochs = [e for o in index.objects.values() for e in o.epochs.values()]
    return [(e.record, p) for e in epochs for p in e.products.values()]


def _what_exists(asked: str, existing: Iterable[str]) -> str:
    """Return the end of a message: what exists, and what was probably meant."""
    ids = sorted(existing)
    if not ids:
        return "there is none yet"
    close = difflib.get_close_matches(str(asked).lower(), [i.lower() for i in ids], n=1)
    meant = next((i for i in ids if close and i.lower() == close[0]), None)
    listed = ", ".join(ids[:8]) + (f" and {len(ids) - 8} more" if len(ids) > 8 else "")
    return f"it has {listed}" + (f"; did you mean {meant!r}?" if meant else "")
