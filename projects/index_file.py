"""`project.h5`, the index as a small HDF5 file: groups, attributes, and a link to every product's file.

It is read whole and replaced whole. A seal before its first HDF5 byte, in the user block that HDF5 leaves to programs,
holds the SHA-256 of all that follows; it is checked before HDF5 reads a file that it may never come back from.
"""

from __future__ import annotations

import datetime
import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path, PurePosixPath
from typing import Any

import h5py
import numpy as np

from projects import hdf5
from projects.elements import KIND, VERSION
from projects.errors import ParameterError, StoreError
from projects.identifiers import split_product
from projects.index import EpochEntry, Index, ObjectEntry, ProductEntry
from projects.migrations import CURRENT, require_known, upgrade
from projects.model import ControlPoint, EpochRecord, ObjectRecord, Step
from projects.records import from_json, plain, to_json

INDEX_NAME = "project.h5"
FORMAT = "heritage-monitor project"
SEAL_BYTES = 512  # the smallest user block of HDF5
RECORDS = {"extent", "sources", "control", "step"}  # kept as JSON
LINK = "file"  # name of the link to a product's file
GROUPS = {"objects", "epochs", "products"}

Value = str | bool | int | float


@dataclass
class Node:
    """A group of the index: its attributes, its groups, and the file that its link leads to."""

    where: str
    attributes: dict[str, Value] = field(default_factory=dict)
    groups: dict[str, Node] = field(default_factory=dict)
    link: str | None = None

    def group(self, name: str) -> Node:
        """Return a group inside, empty where there is none."""
        return self.groups.get(name, Node(f"{self.where}/{name}"))


def write_index(path: Path, index: Index) -> None:
    """Write the index as an HDF5 file."""
    with hdf5.create_file(path, userblock_size=SEAL_BYTES) as file:
        _write_node(file, _project_node(index))
    _seal(path)


def read_index(path: Path) -> Index:
    """Return the index of a project; raise `StoreError` where it is missing, damaged, or not one."""
    _require_seal(path)
    with hdf5.open_file(path, "project index") as file:
        root = _read_node(file, str(path))
    own = _values(root, "project", Index)
    try:
        return Index(**own, objects={key: _object_entry(node) for key, node in root.group("objects").groups.items()})
    except (KeyError, TypeError, ValueError) as error:
        raise StoreError(f"{path} is not a whole index ({error})") from error


def _seal(path: Path) -> None:
    """Write the SHA-256 of what follows the user block into it, as one line of text."""
    with open(path, "r+b") as file:
        file.seek(SEAL_BYTES)
        found = hashlib.file_digest(file, "sha256").hexdigest()
        file.seek(0)
        file.write(f"{FORMAT}, version {CURRENT['project']}, sha256 {found}\n".encode("ascii"))


def _require_seal(path: Path) -> None:
    """Raise `StoreError` where the file is not an index, is of a newer version, or is not as it was sealed."""
    try:
        with open(path, "rb") as file:
            line = file.read(SEAL_BYTES).split(b"\n")[0].decode("ascii", "replace")
            found = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise StoreError(f"{path} cannot be read ({error.strerror})") from error
    sealed = re.fullmatch(rf"{FORMAT}, version (\d+), sha256 ([0-9a-f]{{64}})", line)
    if sealed is None:
        raise StoreError(f"{path} is not the index of a heritage-monitor project, or its beginning is damaged")
    require_known("project", int(sealed[1]), str(path))
    if sealed[2] != found:
        raise StoreError(f"{path} was cut off, changed or is damaged: its seal does not fit; restore it from a copy")


# values -> nodes


def _project_node(index: Index) -> Node:
    """Return the whole index as nodes."""
    node = _node("project", index, "", skip={"objects"})
    node.groups["objects"] = Node("/objects", groups={k: _object_node(e) for k, e in index.objects.items()})
    return node


def _object_node(entry: ObjectEntry) -> Node:
    """Return an object with its epochs as nodes."""
    node = _node("object", entry.record, f"/objects/{entry.record.object_id}")
    node.groups["epochs"] = Node(f"{node.where}/epochs")
    for key, epoch in entry.epochs.items():
        inside = _node("epoch", epoch.record, f"{node.where}/epochs/{key}")
        products = {k: _product_node(p, f"{inside.where}/products/{k}") for k, p in epoch.products.items()}
        inside.groups["products"] = Node(f"{inside.where}/products", groups=products)
        node.groups["epochs"].groups[key] = inside
    return node


def _product_node(entry: ProductEntry, where: str) -> Node:
    """Return the entry of a product as a node that links to its file."""
    kind, reference = split_product(entry.step.product)
    attributes: dict[str, Value] = {
        KIND: "step", VERSION: CURRENT["step"], "kind": kind, "step_id": entry.step.step_id,
        "created": entry.step.created, "sha256": entry.sha256, "bytes": entry.n_bytes, "step": to_json(entry.step),
    }  # fmt: skip
    return Node(where, attributes | ({"reference": reference} if reference else {}), link=entry.file)


def _node(element: str, record: Any, where: str, skip: Iterable[str] = ()) -> Node:
    """Return a record as a group: one attribute per field, None absent."""
    node = Node(where, {KIND: element, VERSION: CURRENT[element]})
    for f in fields(record):
        value = getattr(record, f.name)
        if value is None or f.name in skip:
            continue
        if f.name in RECORDS:
            node.attributes[f.name] = to_json(value)
        else:
            node.attributes[f.name] = _attribute(plain(value), f"{element} {f.name}")
    return node


def _attribute(value: Any, what: str) -> Value:
    """Return a value as an attribute holds it; refuse text that HDF5 cannot hold."""
    if isinstance(value, bool | int | float):
        return value
    text = str(value)
    if "\0" in text or any("\ud800" <= c <= "\udfff" for c in text):
        raise ParameterError(f"{what} {text[:60]!r} holds characters that are no text; write it in UTF-8 without NUL")
    return text


# nodes -> values


def _object_entry(node: Node) -> ObjectEntry:
    """Return the object that a node holds."""
    epochs = {key: _epoch_entry(inside) for key, inside in node.group("epochs").groups.items()}
    return ObjectEntry(ObjectRecord(**_values(node, "object", ObjectRecord)), epochs)


def _epoch_entry(node: Node) -> EpochEntry:
    """Return the epoch that a node holds."""
    values = _values(node, "epoch", EpochRecord)
    values["date"] = datetime.date.fromisoformat(values["date"])
    values["sources"] = tuple(values.get("sources", ()))
    values["control"] = tuple(
        ControlPoint(c["name"], np.array(c["position"], dtype=float), c["sigma"]) for c in values.get("control", ())
    )
    products = {key: _product_entry(inside) for key, inside in node.group("products").groups.items()}
    return EpochEntry(EpochRecord(**values), products)


def _product_entry(node: Node) -> ProductEntry:
    """Return the entry of a product that a node holds."""
    values = _values(node, "step", None)
    step: Mapping[str, Any] = values["step"]
    known = {f.name for f in fields(Step)}
    step = {k: v for k, v in step.items() if k in known} | {"inputs": tuple(step.get("inputs", ()))}
    return ProductEntry(Step(**step), _require_inside(node), str(values["sha256"]), int(values["bytes"]))


def _values(node: Node, element: str, kind: type | None) -> dict[str, Any]:
    """Return a group's record by field, brought up to date; what `kind` does not have is left out."""
    found, version = node.attributes.get(KIND), node.attributes.get(VERSION)
    if found != element:
        raise StoreError(f"{node.where} is a {found!r}; {element!r} was expected")
    require_known(element, version, node.where)
    values = {k: v for k, v in node.attributes.items() if k not in (KIND, VERSION)}
    values = {k: from_json(str(v), f"{node.where}/{k}") if k in RECORDS else v for k, v in values.items()}
    values = upgrade(element, int(version or 0), values)
    return values if kind is None else {f.name: values[f.name] for f in fields(kind) if f.name in values}


def _require_inside(node: Node) -> str:
    """Return the product's file relative to the project; raise where the link leads out of it."""
    name = node.link or ""
    path = PurePosixPath(name)
    if len(path.parts) != 4 or path.parts[0] != "objects" or ".." in path.parts or set(name) & set("\\:\0"):
        raise StoreError(f"{node.where} links to {name!r}, which does not lie in the project; it is refused")
    return name


# nodes <-> HDF5


def _write_node(group: h5py.Group, node: Node) -> None:
    """Write a node with all that is in it."""
    for name, value in node.attributes.items():
        group.attrs[name] = value
    for name, inside in node.groups.items():
        _write_node(group.create_group(name), inside)
    if node.link is not None:
        group[LINK] = h5py.ExternalLink(node.link, "/")


def _read_node(group: h5py.Group, where: str) -> Node:
    """Return the node of a group with the groups in it; arrays that another program added are passed over."""
    node = Node(where, {name: hdf5.read_attribute(group, name) for name in group.attrs})
    for name in group:
        link = group.get(name, getlink=True)
        if name == LINK and isinstance(link, h5py.ExternalLink) and link.path == "/":
            node.link = link.filename
        elif isinstance(item := hdf5.child(group, name), h5py.Group):
            node.groups[name] = _read_node(item, f"{where}/{name}")
        elif name in GROUPS:
            raise StoreError(f"{where}/{name} is an array; a group was expected")
        else:
            hdf5.require_allowed(group, name)
    return node
