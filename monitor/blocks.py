"""Runs of points or vertices that are worked on at once: what is needed in between does not grow with how many."""

from __future__ import annotations

from collections.abc import Iterator

BLOCK = 1 << 16  # vertices: a few MiB


def blocks(n: int, size: int | None = None) -> Iterator[slice]:
    """Yield slices that cut 0 to n into runs of `size`, of `BLOCK` where left out."""
    step = size or BLOCK
    for first in range(0, n, step):
        yield slice(first, min(first + step, n))
