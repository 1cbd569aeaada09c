"""What a report was made of, as one hash: the same facts, drawn by the same programs, give the same files.

In: the facts of a report. Out: a mark that stands in its page and in its document, by which one that is there already
is known to be what would be drawn anew.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

import numpy as np
import pandas as pd

from reports.facts import ReportFacts

DRAWN_WITH = ("matplotlib", "pyvista", "vtk", "numpy", "scipy", "typst", "jinja2", "pillow")


def mark_of(facts: ReportFacts) -> str:
    """Return the hash (SHA-256, hexadecimal) of everything that a report shows and of what draws it."""
    digest = hashlib.sha256(_program().encode())
    for piece in _pieces(facts):
        digest.update(len(piece).to_bytes(8, "little"))
        digest.update(piece)
    return digest.hexdigest()


@cache
def _program() -> str:
    """Return the hash of the code and templates that make reports, and of the versions of what they draw with."""
    digest = hashlib.sha256()
    for path in _all_files(files("reports")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    digest.update(repr([_version_of(name) for name in DRAWN_WITH]).encode())
    return digest.hexdigest()


def _all_files(folder: Traversable) -> Iterator[Traversable]:
    """Yield the files of a package that are no products of running it, in order."""
    for entry in sorted(folder.iterdir(), key=lambda e: e.name):
        if entry.is_dir() and entry.name != "__pycache__":
            yield from _all_files(entry)
        elif entry.is_file():
            yield entry


def _version_of(name: str) -> str:
    """Return the version of a program, "" where it is not there."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _pieces(value: Any) -> Iterator[bytes]:
    """Yield nested facts as bytes, in order, each with what it is."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        for f in dataclasses.fields(value):
            yield f.name.encode()
            yield from _pieces(getattr(value, f.name))
    elif isinstance(value, np.ndarray) and value.dtype != object:
        yield f"{value.dtype} {value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif isinstance(value, pd.DataFrame):
        yield value.to_json(orient="split", double_precision=15).encode()
    elif isinstance(value, Mapping):
        for name in value:
            yield str(name).encode()
            yield from _pieces(value[name])
    elif isinstance(value, list | tuple | np.ndarray):
        yield f"{len(value)} values".encode()
        for inner in value:
            yield from _pieces(inner)
    else:
        yield repr(value).encode("utf-8", "replace")
