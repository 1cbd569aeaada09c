"""What hangs together with what, as trees that lead each number to the first of its own (union and find), for kernels.

In and out: `above` (n,), integers, each leading towards the first of those that it hangs together with; n of them by
themselves are `np.arange(n)`.
"""

from __future__ import annotations

from numba import jit

from projects.model import Ints


@jit(nopython=True, cache=True, nogil=True)
def first_of(above: Ints, i: int) -> int:
    """The first that i hangs together with; the way there is halved."""
    while above[i] != i:
        above[i] = above[above[i]]
        i = above[i]
    return i


@jit(nopython=True, cache=True, nogil=True)
def unite(above: Ints, i: int, j: int) -> None:
    """Let i and j hang together."""
    i, j = first_of(above, i), first_of(above, j)
    above[max(i, j)] = min(i, j)
