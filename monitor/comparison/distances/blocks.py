"""Runs of vertices that are worked on at once: what is needed in between does not grow with the surface."""

from __future__ import annotations

from collections.abc import Iterator

BLOCK = 1 << 16  # vertices: a few MiB


def blocks(n: int) -> Iterator[slice]:
    """Yield slices that cut 0 to n into runs of `BLOCK`."""
    for first in range(0, n, BLOCK):
        yield slice(first, min(first + BLOCK, n))
