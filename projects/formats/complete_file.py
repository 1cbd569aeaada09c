"""A file or folder is either there whole or not at all: written beside its place under another name, then renamed."""

from __future__ import annotations

import glob
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from projects.atomic import flush, flush_folder
from projects.errors import FormatError, ParameterError


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
    """Yield a new folder beside `path` that takes its place, flushed to the disk, when the block ends well.

    What a killed process left beside it, `.NAME-<8 hexadecimal digits>.unfinished`, is removed first.

    Raises
    ------
    ParameterError
        If `path` is a file or holds anything, lies where no folder can be made, or the disk is full.
    """
    path = Path(path).absolute()
    unfinished = path.with_name(f".{path.name}-{uuid.uuid4().hex[:8]}.unfinished")
    try:
        with _told_as_refusal(path):
            if path.exists() and (not path.is_dir() or any(path.iterdir())):
                raise ParameterError(f"{path}: is there already; give a folder that is new or empty")
            for left in path.parent.glob(f".{glob.escape(path.name)}-{'[0-9a-f]' * 8}.unfinished"):
                shutil.rmtree(left, ignore_errors=True)
            unfinished.mkdir(parents=True)
            yield unfinished
            for file in unfinished.rglob("*"):
                (flush_folder if file.is_dir() else flush)(file)
            if path.exists():
                path.rmdir()
            os.replace(unfinished, path)
            flush_folder(path.parent)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


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
