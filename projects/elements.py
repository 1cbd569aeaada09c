"""How each noun is written to and read from an HDF5 group, with its kind and version beside it (FORMAT.md).

A noun's fields become arrays, attributes and records under their own names; a field that is None stays absent.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import h5py
import numpy as np
import pandas as pd

from projects import hdf5
from projects.errors import StoreError
from projects.migrations import CURRENT, require_known, upgrade
from projects.model import ComparedSurface, Comparison, PointCloud, Registration, Series, Surface

NOUNS: Mapping[str, type] = {
    "point-cloud": PointCloud,
    "surface": Surface,
    "registration": Registration,
    "compared-surface": ComparedSurface,
    "comparison": Comparison,
    "series": Series,
}
SHORT = 10_000  # characters; HDF5 keeps attributes below 64 KiB beside the object, longer text becomes a record
KIND, VERSION = "encoding-type", "encoding-version"


def mark(item: h5py.Group | h5py.Dataset, element: str) -> None:
    """Write an element's kind and current version."""
    item.attrs[KIND] = element
    item.attrs[VERSION] = CURRENT[element]


def read_mark(item: h5py.Group | h5py.Dataset) -> tuple[str, int]:
    """Return an element's kind and version; raise `StoreError` where this program cannot read it."""
    where = f"{item.file.filename}: {item.name}"
    element = str(hdf5.read_attribute(item, KIND, ""))
    return element, require_known(element, hdf5.read_attribute(item, VERSION), where)


def write_element(group: h5py.Group, name: str, value: Any) -> None:
    """Write a noun, table, array, or mapping of such and of JSON values, as item `name` of the group."""
    element = next((e for e, noun in NOUNS.items() if type(value) is noun), None)
    if element is not None:
        _write_noun(group.create_group(name), element, value)
    elif isinstance(value, pd.DataFrame):
        _write_table(group.create_group(name), value)
    elif isinstance(value, np.ndarray):
        hdf5.write_array(group, name, value)
    elif isinstance(value, Mapping) and _holds_arrays(value):
        _write_mapping(group.create_group(name), value)
    else:
        mark(hdf5.write_record(group, name, value), "json")


def read_element(group: h5py.Group, name: str) -> Any:
    """Return what `write_element` wrote, equal to what it was given; tuples in records come back as lists."""
    item = hdf5.child(group, name)
    if isinstance(item, h5py.Dataset):
        return _read_json(item) if hdf5.read_attribute(item, KIND) == "json" else hdf5.read_array(item)
    element, version = read_mark(item)
    if element == "table":
        return _read_table(item)
    if element == "mapping":
        return {key: read_element(item, key) for key in item}
    if element not in NOUNS:
        raise StoreError(f"{item.file.filename}: {item.name} is a {element}, which cannot stand here")
    known = {f.name for f in dataclasses.fields(NOUNS[element])}
    parts = upgrade(element, version, _read_fields(item, known if version == CURRENT[element] else set(item)))
    try:
        return NOUNS[element](**{key: value for key, value in parts.items() if key in known})
    except TypeError as error:
        raise StoreError(f"{item.file.filename}: {item.name} is not a whole {element} ({error})") from error


def _read_json(dataset: h5py.Dataset) -> Any:
    """Return a JSON value; older programs wrote the first version of it without a number."""
    if VERSION in dataset.attrs:
        read_mark(dataset)
    return hdf5.read_record(dataset)


def _read_fields(group: h5py.Group, known: set[str]) -> dict[str, Any]:
    """Return the attributes of a noun, and of its items those that are known; others are passed over."""
    for key in set(group) - known:
        hdf5.require_allowed(group, key)
    attributes = {key: hdf5.read_attribute(group, key) for key in group.attrs if key not in (KIND, VERSION)}
    return {key: read_element(group, key) for key in group if key in known} | attributes


def _holds_arrays(value: Any) -> bool:
    """Return whether a value is or holds what JSON cannot say: an array, a table or a noun."""
    if isinstance(value, Mapping):
        return any(_holds_arrays(v) for v in value.values())
    return isinstance(value, (np.ndarray, pd.DataFrame, *NOUNS.values()))


def _write_noun(group: h5py.Group, element: str, noun: Any) -> None:
    """Write the fields of a noun under their names; short ones as attributes."""
    mark(group, element)
    for f in dataclasses.fields(noun):
        value = getattr(noun, f.name)
        if isinstance(value, np.generic):
            value = value.item()
        if isinstance(value, bool | int | float) or (isinstance(value, str) and len(value) <= SHORT):
            hdf5.write_attribute(group, f.name, value)
        elif value is not None:
            write_element(group, f.name, value)


def _write_mapping(group: h5py.Group, values: Mapping[str, Any]) -> None:
    """Write a mapping item by item; refuse keys that cannot name one."""
    mark(group, "mapping")
    for key, value in values.items():
        if not isinstance(key, str) or key in ("", ".", "..") or "/" in key or "\0" in key:
            raise StoreError(f"{key!r} cannot name an item of a stored mapping; text without '/' is needed")
        write_element(group, key, value)


def _write_table(group: h5py.Group, table: pd.DataFrame) -> None:
    """Write a table column by column in its order; rows are numbered from 0, other row labels are not kept."""
    mark(group, "table")
    columns = [str(c) for c in table.columns]
    if twice := [name for name in columns if columns.count(name) > 1]:
        raise StoreError(f"a table has two columns {twice[0]!r}; give each a name of its own")
    hdf5.write_record(group, "columns", columns)
    for k, column in enumerate(columns):
        values = table.iloc[:, k]
        dataset = hdf5.write_array(group, f"{k:03d}", values.to_numpy())
        hdf5.write_attribute(dataset, "column", column)
        hdf5.write_attribute(dataset, "dtype", str(values.dtype))


def _read_table(group: h5py.Group) -> pd.DataFrame:
    """Return a table with its columns in order."""
    columns = hdf5.read_record(hdf5.child(group, "columns"))
    return pd.DataFrame({name: _read_column(hdf5.child(group, f"{k:03d}")) for k, name in enumerate(columns)})


def _read_column(dataset: h5py.Dataset) -> pd.Series:
    """Return one column with the type that it was written with."""
    values = hdf5.read_array(dataset)
    if values.dtype.kind not in "UO":
        return pd.Series(values)
    return pd.Series(values.tolist(), dtype="str" if hdf5.read_attribute(dataset, "dtype") == "str" else "object")
