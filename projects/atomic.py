"""Files that appear whole or not at all: written under `partial/`, flushed to the disk, renamed into place.

`partial/` lies inside the project, so the rename never leaves the file system. The name of a draft says which process
writes it; what one that has ended left there is no part of the project and is cleared by the next writer.
"""

from __future__ import annotations

import hashlib
import os
import re
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from projects.lock import Owner, is_stale, this_process

PARTIAL = "partial"
ABANDONED = 86_400.0  # s without a change, after which a draft of another machine is taken for left over
DRAFT_NAME = re.compile(r"([0-9a-f]{16})-([0-9]{1,10})-([0-9]{1,12})-[0-9a-f]{32}")


@contextmanager
def draft(root: Path) -> Iterator[Path]:
    """Yield a path to write a file at; what was not placed by the end is removed."""
    make_folder(root / PARTIAL)
    me = this_process()
    path = root / PARTIAL / f"{_digest(me.host)}-{me.pid}-{int(me.started)}-{uuid.uuid4().hex}"
    try:
        yield path
    finally:
        with suppress(OSError):
            path.unlink(missing_ok=True)


def place(path: Path, target: Path) -> None:
    """Move a finished draft to `target`, durably: its bytes first, then its name, then the folder of the name."""
    flush(path)
    move(path, target)


def move(path: Path, target: Path) -> None:
    """Move a draft whose bytes are on the disk to `target`, durably."""
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
    found = sorted(p for p in (root / PARTIAL).glob("*") if p.is_file() or p.is_symlink())
    left = [p for p in found if not is_being_written(p)]
    for path in left:
        with suppress(OSError):  # on Windows a reader may still hold it; the next writer tries again
            path.unlink(missing_ok=True)
    return left


def is_being_written(path: Path) -> bool:
    """Return whether the process that writes a draft still runs, or may: one of another machine is given a day."""
    named = DRAFT_NAME.fullmatch(path.name)
    if named is None or path.is_symlink():
        return False
    me = this_process()
    if named[1] != _digest(me.host):
        with suppress(OSError):
            return time.time() - path.stat().st_mtime < ABANDONED
        return False
    return not is_stale(Owner(me.host, int(named[2]), float(named[3]), since="", token=""))


def _digest(host: str) -> str:
    """Return a host as it stands in the names of drafts."""
    return hashlib.sha256(host.encode("utf-8")).hexdigest()[:16]
