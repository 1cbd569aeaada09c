"""The version of every stored element, and how an older one is brought up to date while reading.

Nothing on disk is changed by reading. Today every element has version 1; the first change of a layout raises its
number in `CURRENT`, adds one function to `UPGRADES`, and leaves an archived project of the old version in
tests/archives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from projects.errors import StoreError

Parts = dict[str, Any]  # what an element is made of, by name

CURRENT: Mapping[str, int] = {
    "project": 1,
    "product": 1,
    "object": 1,
    "epoch": 1,
    "step": 1,
    "scans": 1,
    "scan": 1,
    "json": 1,
    "mapping": 1,
    "table": 1,
    "point-cloud": 1,
    "surface": 1,
    "registration": 1,
    "compared-surface": 1,
    "comparison": 1,
    "series": 1,
}

UPGRADES: Mapping[tuple[str, int], Callable[[Parts], Parts]] = {}


def require_known(element: str, version: Any, where: str) -> int:
    """Return the version of an element if this program can read it; raise `StoreError` otherwise."""
    if element not in CURRENT:
        raise StoreError(f"{where}: an element of the unknown kind {element!r}; a newer heritage-monitor may know it")
    if not isinstance(version, int) or version < 1:
        raise StoreError(f"{where}: a {element} with the version {version!r}; it is damaged")
    if version > CURRENT[element]:
        raise StoreError(
            f"{where}: {element} version {version} is newer than this program reads ({CURRENT[element]}); "
            "update heritage-monitor"
        )
    return version


def upgrade(element: str, version: int, parts: Parts) -> Parts:
    """Return the parts of an element as its current version has them, one step after the other."""
    for v in range(version, CURRENT[element]):
        parts = UPGRADES[element, v](parts)
    return parts
