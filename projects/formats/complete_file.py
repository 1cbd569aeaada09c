"""A file is either there whole or not at all: written beside its place under another name, then renamed."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

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
        yield unfinished
        os.replace(unfinished, path)
    except Exception as error:
        why = _refusal_of(error)
        if not why:
            raise
        raise ParameterError(f"{path}: cannot be written ({why}); make room there or choose another folder") from error
    finally:
        with suppress(OSError):
            unfinished.unlink(missing_ok=True)


def _refusal_of(error: Exception) -> str:
    """Return why a disk took no more, empty for any other error; libraries of formats have errors of their own."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    told = str(error).split("****")[0].strip()
    return told if type(error).__name__ in ("LazrsError", "E57Exception") and "write" in told else ""
