"""Elements of a PLY file that hold lists: faces as index lists of any length, and what must be skipped to reach them.

Equal lists, the common case, are read as one table; lists of different lengths are walked one by one.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from projects.errors import FormatError
from projects.formats.text import line_blocks

LONGEST_LIST = 100_000
CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q", "f4": "f", "f8": "d"}


@dataclass(frozen=True)
class ListReader:
    """One element with lists: `order` is "" for text, `place` the offset and line where it begins.

    `properties` are (name, type, type of the list's length or "" for a single value).
    """

    path: str
    order: str
    n: int
    properties: list[tuple[str, str, str]]
    place: tuple[int, int]

    def read(self, which: int) -> list[NDArray[np.int64]]:
        """Return the lists of one property, stacked by length: one (m, length) table for each length."""
        if not self.order:
            return self._read_text(which)
        body = self._body()
        lengths = self._lengths(body, 0)
        record = self._record(lengths)
        if record.itemsize * self.n <= len(body):
            table = np.frombuffer(body, record, self.n)
            if all((table[f"n{k}"] == n).all() for k, n in lengths.items()):
                return [table[f"{which}"].astype(np.int64).reshape(self.n, -1)]
        return stack_by_length(self._walk(body, which)[0])

    def end(self) -> int:
        """Return the offset after the element."""
        return self.place[0] + self._walk(self._body(), -1)[1]

    def _body(self) -> bytes:
        """Return the bytes from the lists on."""
        with Path(self.path).open("rb") as file:
            file.seek(self.place[0])
            return file.read()

    def _lengths(self, body: bytes, at: int) -> dict[int, int]:
        """Return the length of each list of the record that begins at an offset."""
        lengths = {}
        for k, (_, kind, length_kind) in enumerate(self.properties):
            if length_kind:
                (n,) = self._unpack(body, at, CODES[length_kind])
                if not 0 <= n <= LONGEST_LIST:
                    raise FormatError(f"has a list of {n} values; the file is broken")
                lengths[k] = int(n)
                at += struct.calcsize("=" + CODES[length_kind])
            at += struct.calcsize("=" + CODES[kind]) * lengths.get(k, 1)
        return lengths

    def _unpack(self, body: bytes, at: int, code: str) -> tuple[Any, ...]:
        """Return the values of one code at a place; refuse where the file ends before."""
        try:
            return struct.unpack_from(self.order + code, body, at)
        except struct.error as problem:
            raise FormatError(f"promises {self.n} lists, fewer are there; the file is cut off") from problem

    def _record(self, lengths: dict[int, int]) -> np.dtype[Any]:
        """Return the record of which every list has these lengths."""
        fields: list[Any] = []
        for k, (_, kind, length_kind) in enumerate(self.properties):
            if length_kind:
                fields.append((f"n{k}", self.order + length_kind))
            fields.append((f"{k}", self.order + kind, (lengths.get(k, 1),)))
        return np.dtype(fields)

    def _walk(self, body: bytes, which: int) -> tuple[list[Sequence[int]], int]:
        """Return the lists of one property (none for -1) and the offset after the last record."""
        lists: list[Sequence[int]] = []
        at = 0
        for _ in range(self.n):
            lengths = self._lengths(body, at)
            for k, (_, kind, length_kind) in enumerate(self.properties):
                at += struct.calcsize("=" + CODES[length_kind]) if length_kind else 0
                code = f"{lengths.get(k, 1)}{CODES[kind]}"
                if k == which:
                    lists.append(self._unpack(body, at, code))
                at += struct.calcsize("=" + code)
        if at > len(body):
            raise FormatError(f"promises {self.n} lists, fewer are there; the file is cut off")
        return lists, at

    def _read_text(self, which: int) -> list[NDArray[np.int64]]:
        """Return the lists of a text file, those of one length in one array."""
        offset, line = self.place
        lists: list[Sequence[int]] = []
        for block in line_blocks(self.path, offset, self.n):
            for k, text in enumerate(block.splitlines()):
                lists.append(self._list_of_line(text.split(), which, line + k))
            line += block.count(b"\n")
        if len(lists) != self.n:
            raise FormatError(f"promises {self.n} faces, {len(lists)} are there; the file is cut off")
        return stack_by_length(lists)

    def _list_of_line(self, words: list[bytes], which: int, line: int) -> Sequence[int]:
        """Return one property's list in a line of text."""
        at = 0
        try:
            for k, (_, _, length_kind) in enumerate(self.properties):
                n = int(words[at]) if length_kind else 1
                at += 1 if length_kind else 0
                if k == which and at + n <= len(words):
                    return [int(word) for word in words[at : at + n]]
                at += n
        except (ValueError, IndexError) as problem:
            raise FormatError(f"line {line} is no list of whole numbers ({problem})") from problem
        raise FormatError(f"line {line} holds fewer numbers than its list promises")


def stack_by_length(lists: Sequence[Sequence[int]]) -> list[NDArray[np.int64]]:
    """Return lists of the same length as tables, shortest first."""
    groups: dict[int, list[Sequence[int]]] = {}
    for values in lists:
        groups.setdefault(len(values), []).append(values)
    return [np.array(groups[n], dtype=np.int64).reshape(-1, n) for n in sorted(groups)]


def fan(polygons: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return triangles (m, 3): every polygon is cut into a fan about its first corner."""
    triangles = [np.empty((0, 3), np.int64)]
    for table in polygons:
        triangles += [table[:, [0, k, k + 1]] for k in range(1, table.shape[1] - 1)]
    return np.concatenate(triangles)
