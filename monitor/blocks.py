"""Runs of points or vertices that are worked on at once: what is needed in between does not grow with how many."""

from __future__ import annotations

from collections.abc import Iterator

BLOCK = 1 << 16  # vertices: a few MiB


def blocks(n: int, size: int = BLOCK) -> Iterator[slice]:
    """Yield slices that cut 0 to n into runs of `size`."""
    for first in range(0, n, size):
        yield slice(first, min(first + size, n))
