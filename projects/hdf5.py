"""Arrays, text and records in HDF5 files, and files opened so that nothing in them can lead out of them.

Every array is chunked, shuffled, deflated (gzip, which every HDF5 program reads) and carries a Fletcher-32 checksum.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from projects.errors import StoreError
from projects.records import from_json, to_json

CHUNK_ROWS = 65536
LIBRARY_BOUNDS = ("v110", "v110")  # checksummed metadata; readable by every HDF5 since 1.10 (2016)
FILTERS = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}


class NewFile(io.FileIO):
    """A file as HDF5 writes it. Its first `error` is kept, and what comes after it is taken for written.

    HDF5 cannot stand an error of the disk: its handles stay open, and the process crashes as it ends.
    """

    error: OSError | None = None

    def write(self, data: Any) -> int:
        """Write all of the data, or keep why not; return how many bytes they are."""
        left = memoryview(data).cast("B")
        n_bytes = len(left)
        try:
            while self.error is None and len(left):
                left = left[super().write(left) :]
        except OSError as error:
            self.error = error
        return n_bytes

    def truncate(self, size: int | None = None) -> int:
        """Cut or extend the file, or keep why not; return its size."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.error = self.error or error
            return size or 0


@contextmanager
def create_file(path: Path, userblock_size: int = 0) -> Iterator[h5py.File]:
    """Yield a new HDF5 file to write, closed afterwards; raises `OSError` where the disk is full or fails."""
    with NewFile(path, "w+") as disk:
        try:
            with h5py.File(disk, "w", libver=LIBRARY_BOUNDS, userblock_size=userblock_size) as file:
                yield file
        except RuntimeError as error:  # HDF5 says so where it cannot read what the disk did not take
            if type(error) is not RuntimeError:
                raise
            raise OSError(in_one_line(error)) from error
        finally:
            if disk.error is not None:
                raise disk.error


@contextmanager
def open_file(path: Path, what: str) -> Iterator[h5py.File]:
    """Yield an HDF5 file to read; raise `StoreError` where it is missing, cut off, changed or not HDF5."""
    try:
        file = h5py.File(path, "r", locking=False)
    except FileNotFoundError as error:
        raise StoreError(f"{what}: the file {path} is missing") from error
    except (OSError, RuntimeError) as error:
        raise StoreError(f"{what}: {path} is damaged or is not an HDF5 file ({in_one_line(error)})") from error
    with file:
        try:
            yield file
        except (OSError, RuntimeError, KeyError, UnicodeDecodeError, MemoryError) as error:
            raise StoreError(f"{what}: {path} is damaged ({in_one_line(error)})") from error


def in_one_line(error: BaseException) -> str:
    """Return why a file could not be read or written, without HDF5's own lines of addresses and times."""
    if isinstance(error, OSError) and error.errno:
        return os.strerror(error.errno)
    told = re.search(r"errno = (\d+)", str(error))
    if told:
        return os.strerror(int(told[1]))
    return (str(error).splitlines() or [type(error).__name__])[0][:200]


def child(group: h5py.Group, name: str) -> h5py.Group | h5py.Dataset:
    """Return an item that the group itself holds; a link that leads elsewhere is refused, never followed."""
    link = group.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        what = "is missing" if link is None else "is a link to another place, which is not allowed here"
        raise StoreError(f"{group.file.filename}: {group.name.rstrip('/')}/{name} {what}")
    return group[name]


def require_allowed(group: h5py.Group, name: str) -> None:
    """Raise `StoreError` where an item that a reader does not know, and passes over, is one that no file may hold."""
    item = child(group, name)
    if isinstance(item, h5py.Dataset) and h5py.check_string_dtype(item.dtype) is None:
        require_own(item)


def write_array(group: h5py.Group, name: str, array: np.ndarray) -> h5py.Dataset:
    """Write an array with its dtype; text arrays as fixed-length UTF-8."""
    if array.dtype.kind in "UOT":
        array = encode_texts(array, f"{group.name}/{name}")
    elif array.dtype.kind not in "biuf":
        raise StoreError(f"{group.name}/{name}: an array of {array.dtype} cannot be stored; numbers or text are needed")
    if array.size == 0 or array.ndim == 0:  # nothing to chunk
        return group.create_dataset(name, data=array)
    chunks = (min(len(array), CHUNK_ROWS), *array.shape[1:])
    return group.create_dataset(name, data=array, chunks=chunks, **FILTERS)


def encode_texts(array: np.ndarray, where: str) -> np.ndarray:
    """Return text as fixed-length UTF-8 (checksummed, unlike HDF5's variable-length strings)."""
    flat = array.ravel().tolist()
    if not all(isinstance(t, str) and not t.endswith("\0") for t in flat):
        raise StoreError(f"{where}: a column of text holds something that is not text")
    encoded = [t.encode("utf-8", "backslashreplace") for t in flat]
    length = max([len(t) for t in encoded], default=0) or 1
    return np.array(encoded, dtype=h5py.string_dtype("utf-8", length)).reshape(array.shape)


def read_array(dataset: h5py.Dataset) -> np.ndarray:
    """Return an array as it was written; its checksums are verified by HDF5 while reading."""
    require_own(dataset)
    if dataset.dtype.kind != "S":
        return np.asarray(dataset[...])
    texts = [t.decode("utf-8") for t in dataset[...].ravel().tolist()]
    return np.array(texts, dtype=np.str_ if texts else object).reshape(dataset.shape)


def require_own(dataset: h5py.Dataset) -> h5py.Dataset:
    """Return a dataset of numbers or text whose values lie in its own file; raise `StoreError` otherwise."""
    where = f"{dataset.file.filename}: {dataset.name}"
    if dataset.is_virtual or dataset.external:
        raise StoreError(f"{where} keeps its values in another file, which is not allowed")
    if dataset.dtype.kind not in "biufS":
        raise StoreError(f"{where} holds {dataset.dtype}, which is neither numbers nor text")
    return dataset


def write_record(group: h5py.Group, name: str, value: Any) -> h5py.Dataset:
    """Write a record as JSON text, one element of fixed length, under the filters of arrays."""
    return write_array(group, name, np.array([to_json(value)], dtype=object))


def read_record(dataset: h5py.Dataset) -> Any:
    """Return the record that `write_record` wrote."""
    where = f"{dataset.file.filename}: {dataset.name}"
    texts = read_array(dataset)
    if texts.shape != (1,) or not isinstance(texts[0], str):
        raise StoreError(f"{where} is not a record")
    return from_json(str(texts[0]), where)


def write_attribute(item: h5py.Group | h5py.Dataset, name: str, value: str | bool | int | float) -> None:
    """Write a number, a boolean or a short text (fixed-length UTF-8) as an attribute."""
    if not isinstance(value, str):
        item.attrs[name] = value
        return
    encoded = value.encode("utf-8", "backslashreplace")
    item.attrs.create(name, encoded, dtype=h5py.string_dtype("utf-8", len(encoded) or 1))


def read_attribute(item: h5py.Group | h5py.Dataset | h5py.File, name: str, default: Any = None) -> Any:
    """Return an attribute as text, number or boolean, or `default` where it is absent."""
    value = item.attrs.get(name, default)
    if isinstance(value, bytes):
        return value.decode("utf-8")
    return value.item() if isinstance(value, np.generic) else value
