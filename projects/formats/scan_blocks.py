"""Scans that come in blocks, kept on disk until all is known that a file states before its points.

The header of an E57 or PTX file states bounds and the size of the grid of points that follow, so each scan is gone
through twice. Blocks are kept in a nameless file beside the one that is written: a scan of any size can be written.
"""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from projects.errors import FormatError
from projects.model import Floats, Scan

ScanSource = Scan | Iterable[Scan]  # whole, or block by block: one name, pose and grid, columns in rising order


@contextmanager
def in_blocks(source: ScanSource, path: Path) -> Iterator[Iterable[Scan]]:
    """Yield the blocks of a scan that have points, to be gone through as often as needed; a whole scan is one block.

    Raises FormatError where no block has any, or where one has another pose or origin than the first, by which all are
    written; `path` is the file that is written.
    """
    if isinstance(source, Scan):
        _require_points(len(source.cloud), source.name, path)
        yield (source,)
        return
    with tempfile.TemporaryFile(dir=path.parent) as store:
        n, name, place = 0, "without blocks", None
        for block in source:
            n, name = n + len(block.cloud), block.name
            if len(block.cloud):
                place = place or {"pose": block.pose, "origin": block.origin}
                _require_same_place(block, place, path)
                pickle.dump(block, store)
        _require_points(n, name, path)
        yield _Kept(store)


def _require_points(n: int, name: str, path: Path) -> None:
    """Raise `FormatError` where a scan has no points."""
    if not n:
        raise FormatError(f"{path}: scan {name} holds no points; leave it out")


def _require_same_place(block: Scan, place: dict[str, Floats], path: Path) -> None:
    """Raise `FormatError` where a block was not scanned from the place of the first, its pose and origin."""
    for name, first in place.items():
        if not np.array_equal(getattr(block, name), first, equal_nan=True):
            raise FormatError(
                f"{path}: a block of scan {block.name} has another {name} than its first one, and all of a scan are "
                "written by one; give what was scanned from elsewhere as a scan of its own"
            )


class _Kept:
    """Blocks in a file, read one by one from the first each time they are gone through."""

    def __init__(self, store: IO[bytes]) -> None:
        self._store = store

    def __iter__(self) -> Iterator[Scan]:
        self._store.seek(0)
        while self._store.peek(1):  # type: ignore[attr-defined]
            yield pickle.load(self._store)
