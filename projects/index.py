"""The index of a project, `project.h5`: what exists, as values in memory and as one small HDF5 file.

It is read whole and replaced whole. A digest over all of its content shows a changed byte.
"""

from __future__ import annotations

import datetime
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path, PurePosixPath
from typing import Any

import h5py

from projects import hdf5
from projects.elements import KIND, VERSION, mark, read_mark
from projects.errors import StoreError
from projects.identifiers import split_product
from projects.migrations import require_known, upgrade
from projects.model import ControlPoint, EpochRecord, ObjectRecord, Step
from projects.records import from_json, plain, to_json

INDEX_NAME = "project.h5"
FORMAT = "heritage-monitor project"
RECORDS = {"extent", "sources", "control", "parameters", "inputs", "automatic", "counts", "versions"}  # kept as JSON


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
    gone = {p.step.step_id for p in owner.epochs[epoch.epoch_id].products.values()}

    def stays(product: ProductEntry) -> bool:
        of_it = split_product(product.step.product)[1] == epoch.epoch_id
        return not of_it and gone.isdisjoint(product.step.inputs)

    kept = {
        key: replace(e, products={k: p for k, p in e.products.items() if stays(p)})
        for key, e in owner.epochs.items()
        if key != epoch.epoch_id
    }
    return with_object(index, replace(owner, epochs=kept))


def write_index(path: Path, index: Index) -> None:
    """Write the index as an HDF5 file, with an external link to every product's file."""
    with hdf5.create_file(path) as file:
        mark(file, "project")
        _write_fields(file, {"format": FORMAT, "name": index.name, "crs": index.crs,
                             "description": index.description, "created": index.created})  # fmt: skip
        objects = file.create_group("objects")
        for object_id, entry in index.objects.items():
            group = objects.create_group(object_id)
            _write_record(group, "object", entry.record)
            for epoch_id, epoch in entry.epochs.items():
                _write_epoch(group.require_group("epochs").create_group(epoch_id), epoch)
        file.attrs["digest"] = digest(file)


def _write_epoch(group: h5py.Group, entry: EpochEntry) -> None:
    _write_record(group, "epoch", entry.record)
    for name, product in entry.products.items():
        item = group.require_group("products").create_group(name)
        _write_record(item, "step", product.step)
        kind, reference = split_product(name)
        _write_fields(item, {"kind": kind, "reference": reference, "sha256": product.sha256, "bytes": product.n_bytes})
        item["file"] = h5py.ExternalLink(_link_from_index(product.file), "/")


def _link_from_index(file: str) -> str:
    return PurePosixPath(file).as_posix()


def _write_record(group: h5py.Group, element: str, record: Any) -> None:
    mark(group, element)
    _write_fields(group, {f.name: getattr(record, f.name) for f in fields(record)})


def _write_fields(group: h5py.Group, values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        if value is None:
            continue
        if name in RECORDS:
            group.attrs[name] = to_json(value)
        else:
            group.attrs[name] = value if isinstance(value, bool | int | float) else str(plain(value))


def read_index(path: Path) -> Index:
    """Return the index of a project; raise `StoreError` where it is missing, damaged, or not one."""
    with hdf5.open_file(path, "project index") as file:
        if hdf5.read_attribute(file, "format") != FORMAT:
            raise StoreError(f"{path} is an HDF5 file, but not the index of a heritage-monitor project")
        require_known("project", hdf5.read_attribute(file, VERSION), str(path))
        if hdf5.read_attribute(file, "digest") != digest(file):
            raise StoreError(f"{path} was changed or is damaged: its digest does not fit; restore it from a copy")
        own = upgrade(*read_mark(file), {n: hdf5.read_attribute(file, n, "") for n in _PROJECT_FIELDS})
        objects = hdf5.child(file, "objects")
        return Index(**own, objects={key: _read_object(hdf5.child(objects, key)) for key in objects})


_PROJECT_FIELDS = ("name", "crs", "description", "created")


def _read_object(group: h5py.Group) -> ObjectEntry:
    epochs = hdf5.child(group, "epochs") if "epochs" in group else {}
    record = ObjectRecord(**_read_record(group, "object", ObjectRecord))
    return ObjectEntry(record, {key: _read_epoch(hdf5.child(group["epochs"], key)) for key in epochs})


def _read_epoch(group: h5py.Group) -> EpochEntry:
    values = _read_record(group, "epoch", EpochRecord)
    values["date"] = datetime.date.fromisoformat(values["date"])
    values["sources"] = tuple(values.get("sources", ()))
    values["control"] = tuple(
        ControlPoint(c["name"], hdf5.np.array(c["position"], dtype=float), c["sigma"])
        for c in values.get("control", ())
    )
    products = hdf5.child(group, "products") if "products" in group else {}
    return EpochEntry(EpochRecord(**values), {k: _read_product(hdf5.child(group["products"], k)) for k in products})


def _read_product(group: h5py.Group) -> ProductEntry:
    values = _read_record(group, "step", Step)
    values["inputs"] = tuple(values.get("inputs", ()))
    return ProductEntry(
        step=Step(**values),
        file=_require_inside(group),
        sha256=str(hdf5.read_attribute(group, "sha256")),
        n_bytes=int(hdf5.read_attribute(group, "bytes")),
    )


def _require_inside(group: h5py.Group) -> str:
    """Return where the product's link leads, relative to the project; raise where it leaves the project."""
    link = group.get("file", getlink=True)
    where = f"{group.file.filename}: {group.name}"
    if not isinstance(link, h5py.ExternalLink) or link.path != "/":
        raise StoreError(f"{where} has no link to its file")
    name = link.filename
    parts = PurePosixPath(name).parts
    if len(parts) != 4 or parts[0] != "objects" or ".." in parts or "\\" in name or ":" in name:
        raise StoreError(f"{where} links to {name!r}, which does not lie in the project; it is refused")
    return str(name)


def _read_record(group: h5py.Group, element: str, kind: type) -> dict[str, Any]:
    """Return the fields of a record by name, brought up to date; what this version does not know is left out."""
    where = f"{group.file.filename}: {group.name}"
    found, version = read_mark(group)
    if found != element:
        raise StoreError(f"{where} is a {found}; {element} was expected")
    values = {key: hdf5.read_attribute(group, key) for key in group.attrs if key not in (KIND, VERSION)}
    values = {k: from_json(v, f"{where}/{k}") if k in RECORDS else v for k, v in values.items()}
    known = {f.name for f in fields(kind)}
    return {k: v for k, v in upgrade(element, version, values).items() if k in known}


def digest(file: h5py.File) -> str:
    """Return the SHA-256 over all groups, attributes and links of an index, in the order that FORMAT.md states."""
    total = hashlib.sha256()

    def add(*texts: str) -> None:
        total.update("\0".join(texts).encode("utf-8", "surrogatepass") + b"\n")

    def walk(group: h5py.Group) -> None:
        for name in sorted(group.attrs):
            if (group.name, name) != ("/", "digest"):
                add("attribute", group.name, name, _as_text(hdf5.read_attribute(group, name)))
        for name in sorted(group):
            link = group.get(name, getlink=True)
            if isinstance(link, h5py.ExternalLink):
                add("link", group.name, name, link.filename, link.path)
            else:
                add("group", group.name, name)
                walk(hdf5.child(group, name))

    walk(file)
    return total.hexdigest()


def _as_text(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return value.hex() if isinstance(value, float) else str(value)
