"""Files that appear whole or not at all: written under `partial/`, flushed to the disk, renamed into place.

`partial/` lies inside the project, so the rename never leaves the file system; what a killed process left there is
no part of the project and is cleared by the next writer.
"""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PARTIAL = "partial"


@contextmanager
def draft(root: Path) -> Iterator[Path]:
    """Yield a path to write a file at; what was not placed by the end is removed."""
    make_folder(root / PARTIAL)
    path = root / PARTIAL / uuid.uuid4().hex
    try:
        yield path
    finally:
        with suppress(OSError):
            path.unlink(missing_ok=True)


def place(path: Path, target: Path) -> None:
    """Move a finished draft to `target`, durably: its bytes first, then its name, then the folder of the name."""
    flush(path)
    make_folder(target.parent)
    os.replace(path, target)
    flush_folder(target.parent)


def make_folder(folder: Path) -> None:
    """Make a folder and its parents durably; one that exists is left as it is."""
    missing = [f for f in (folder, *folder.parents) if not f.exists()]
    for f in reversed(missing):
        f.mkdir(exist_ok=True)
        flush_folder(f.parent)


def flush(path: Path) -> None:
    """Force a file's bytes to the disk."""
    descriptor = os.open(path, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def flush_folder(folder: Path) -> None:
    """Force a folder's entries to the disk (Windows has no such call: there a rename is durable by itself)."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def clear_partial(root: Path) -> list[Path]:
    """Remove what interrupted writers left, and return it; only the holder of the project's lock may call this."""
    left = sorted(p for p in (root / PARTIAL).glob("*") if p.is_file() or p.is_symlink())
    for path in left:
        with suppress(OSError):  # on Windows a reader may still hold it; the next writer tries again
            path.unlink(missing_ok=True)
    return left
