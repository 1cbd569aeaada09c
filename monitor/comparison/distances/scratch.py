"""Large arrays kept in files without a name, mapped: what is only streamed through need not stay in memory.

The system reads such pages back where they are asked for, and drops them where memory is short. The files lie in the
temporary folder (TMPDIR), which should be on a disk, and vanish with the arrays.
"""

from __future__ import annotations

import mmap
import tempfile
from typing import TypeVar

import numpy as np

LEAST = 1 << 25  # octets, from which an array is worth a file: 4 million float64

Array = TypeVar("Array", bound=np.ndarray)


def keep_on_disk(array: Array) -> Array:
    """Return the same numbers mapped from a file; small arrays, and all where the disk is full, as they are."""
    if array.nbytes < LEAST:
        return array
    try:
        with tempfile.TemporaryFile() as file:
            np.ascontiguousarray(array).tofile(file)
            file.flush()
            mapped = mmap.mmap(file.fileno(), array.nbytes)
    except OSError:
        return array  # the same numbers, in memory
    return np.frombuffer(mapped, dtype=array.dtype).reshape(array.shape)  # type: ignore[return-value]
