"""A file or folder is either there whole or not at all: written beside its place under another name, then renamed."""

from __future__ import annotations

import glob
import json
import os
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path

from projects.atomic import flush, flush_folder
from projects.errors import FormatError, ParameterError
from projects.lock import UNFINISHED, is_stale, read_owner, this_process

OWNER = "owner.json"  # beside an unfinished folder: the process that writes it


@contextmanager
def complete_file(path: Path) -> Iterator[Path]:
    """Yield a path to write to, with the same suffix; it takes the place of `path` when the block ends well.

    Raises
    ------
    ParameterError
        If the disk is full or refuses the file; what was there before stays.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise FormatError(f"{path}: the folder {path.parent} does not exist; make it first")
    unfinished = path.with_name(f".{path.stem}-{uuid.uuid4().hex[:8]}{path.suffix}")
    try:
        with _told_as_refusal(path):
            yield unfinished
            os.replace(unfinished, path)
    finally:
        with suppress(OSError):
            unfinished.unlink(missing_ok=True)


@contextmanager
def complete_folder(path: Path) -> Iterator[Path]:
    """Yield a new folder that takes the place of `path`, flushed to the disk, when the block ends well.

    It lies in one beside `path`, `.NAME-<8 hexadecimal digits>.unfinished`, that says which process writes it. What
    killed processes left there is removed first; one that still runs is not disturbed.

    Raises
    ------
    ParameterError
        If `path` is a file, holds anything or is where a disk is mounted, is being written by another process, lies
        where no folder can be made, or the disk is full.
    """
    path = Path(path).absolute()
    room = path.with_name(f".{path.name}-{uuid.uuid4().hex[:8]}.unfinished")
    unfinished = room / path.name
    try:
        with _told_as_refusal(path):
            if path.exists() and (not path.is_dir() or any(path.iterdir())):
                raise ParameterError(f"{path}: is there already; give a folder that is new or empty")
            if os.path.ismount(path):  # no finished folder can take its place
                raise ParameterError(
                    f"{path}: is where a disk is mounted; give a new folder on it, such as {path / 'new'}"
                )
            _clear_left(path)
            room.mkdir(parents=True)
            (room / OWNER).write_text(json.dumps(asdict(this_process())), encoding="utf-8")
            unfinished.mkdir()
            yield unfinished
            for file in unfinished.rglob("*"):
                (flush_folder if file.is_dir() else flush)(file)
            if path.exists():
                path.rmdir()
            os.replace(unfinished, path)
            flush_folder(path.parent)
    except ParameterError as error:  # of a file in it: the user knows no unfinished folder
        raise ParameterError(str(error).replace(str(unfinished), str(path))) from error
    finally:
        shutil.rmtree(room, ignore_errors=True)


def _clear_left(path: Path) -> None:
    """Remove what killed processes left of a folder; refuse where one that still runs is writing it."""
    for room in path.parent.glob(f".{glob.escape(path.name)}-{'[0-9a-f]' * 8}.unfinished"):
        owner = read_owner(room / OWNER)
        if owner is None and time.time() - room.stat().st_mtime < UNFINISHED:
            raise ParameterError(f"{path}: another process began to write it just now; try again in a minute")
        if owner is not None and not is_stale(owner):
            raise ParameterError(
                f"{path}: is being written by process {owner.pid} on {owner.host.split('[')[0]} since "
                f"{owner.since}; wait for it to end, or, if that program no longer runs, remove {room.name} there"
            )
        shutil.rmtree(room, ignore_errors=True)


@contextmanager
def _told_as_refusal(path: Path) -> Iterator[None]:
    """Tell an error of the disk as one line on what could not be written; let any other pass."""
    try:
        yield
    except Exception as error:
        why = _refusal_of(error)
        if not why:
            raise
        raise ParameterError(f"{path}: cannot be written ({why}); make room there or choose another folder") from error


def _refusal_of(error: Exception) -> str:
    """Return why a disk took no more, empty for any other error; libraries of formats have errors of their own."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    told = str(error).split("****")[0].strip()
    return told if type(error).__name__ in ("LazrsError", "E57Exception") and "write" in told else ""
