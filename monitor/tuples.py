"""Vectors of three as tuples, for kernels: tuples in, tuples out, float64, no room of their own.

They are put into what calls them: a call would copy all that comes with it.
"""

from __future__ import annotations

import numpy as np
from numba import jit


@jit(nopython=True, cache=True, forceinline=True)
def sub(a, b):  # type: ignore[no-untyped-def]
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@jit(nopython=True, cache=True, forceinline=True)
def dot(a, b):  # type: ignore[no-untyped-def]
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit(nopython=True, cache=True, forceinline=True)
def cross(a, b):  # type: ignore[no-untyped-def]
    """Return the vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@jit(nopython=True, cache=True, forceinline=True)
def along(a, t, b):  # type: ignore[no-untyped-def]
    """Return a + t b."""
    return (a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2])


@jit(nopython=True, cache=True, forceinline=True)
def unit(a):  # type: ignore[no-untyped-def]
    """Return a over its length; zeros where it has none."""
    length = np.sqrt(dot(a, a))
    scale = 1.0 / length if length > 0.0 else 0.0
    return (a[0] * scale, a[1] * scale, a[2] * scale)


@jit(nopython=True, cache=True, forceinline=True)
def less(vertices, v, shift):  # type: ignore[no-untyped-def]
    """Return row v of `vertices` less `shift`."""
    return (vertices[v, 0] - shift[0], vertices[v, 1] - shift[1], vertices[v, 2] - shift[2])
