"""What crosses the pipe between a child process that parses a file and its parent: JSON and plain arrays.

A frame is 12 bytes (mark, length of the JSON, number of arrays), the JSON, then the arrays' bytes one after another.
Nothing is unpickled; the parent believes no name, dtype or length that it did not expect.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np

from projects.errors import FormatError
from projects.formats.rawscan import CHUNK, KINDS, Columns

MARK = b"HMF1"
HEAD = struct.Struct("<4sII")
LONGEST_JSON = 64 * 2**20


def write_frame(out: BinaryIO, message: Mapping[str, Any], columns: Columns | None = None) -> None:
    """Write one message with its arrays."""
    columns = columns or {}
    shapes = [[name, len(values)] for name, values in columns.items()]
    text = json.dumps({**message, "arrays": shapes}, allow_nan=True).encode()
    out.write(HEAD.pack(MARK, len(text), len(shapes)))
    out.write(text)
    for name, values in columns.items():
        dtype, width = KINDS[name]
        array = np.ascontiguousarray(values, dtype=dtype)
        assert array.shape == ((len(values), width) if width else (len(values),)), name
        out.write(memoryview(array.data).cast("B") if array.size else b"")
    out.flush()


def read_frame(pipe: BinaryIO) -> tuple[dict[str, Any], Columns] | None:
    """Return the next message and its arrays, or None at the end of the pipe.

    Raises
    ------
    FormatError
        The bytes are not a frame, or name an array that is not expected.
    """
    head = _exactly(pipe, HEAD.size)
    if head is None:
        return None
    mark, n_text, n_arrays = HEAD.unpack(head)
    if mark != MARK or n_text > LONGEST_JSON or n_arrays > len(KINDS):
        raise FormatError("the reader's answer is garbled")
    text = _exactly(pipe, n_text)
    if text is None:
        return None
    message = json.loads(bytes(text))
    columns: Columns = {}
    for name, n in message.pop("arrays"):
        dtype, width = KINDS[name]
        if not isinstance(n, int) or not 0 <= n <= CHUNK:
            raise FormatError("the reader's answer is garbled")
        array = np.empty((n, width) if width else n, dtype=dtype)
        if array.size and _fill(pipe, memoryview(array.data).cast("B")) < array.nbytes:
            return None
        columns[name] = array
    return message, columns


def _exactly(pipe: BinaryIO, n: int) -> bytearray | None:
    """Return n bytes, or None where the pipe ends before."""
    buffer = bytearray(n)
    return buffer if _fill(pipe, memoryview(buffer)) == n else None


def _fill(pipe: BinaryIO, view: memoryview) -> int:
    """Fill the view from the pipe; return how many bytes came."""
    done = 0
    while done < len(view):
        n = pipe.readinto(view[done:])  # type: ignore[attr-defined]
        if not n:
            break
        done += n
    return done
