"""Tables of numbers in text files, in blocks: every line is checked to have as many numbers as the others.

Shared by PTX, PTS, XYZ and the text forms of PLY and PCD. A line that is short, long, cut off or not a number is an
error that names the line; nothing is guessed.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from projects.errors import FormatError

BLOCK = 8 * 2**20  # bytes
LONGEST_LINE = 2**20
SLOWLY_PARSED = 4 * 2**20  # bytes
NOT_A_NUMBER = [sign + word for sign in ("", "-", "+") for word in ("nan", "NaN", "NAN", "Nan")]  # as numpy reads them
NEWLINE, SPACE = 10, 32
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_SIGNS = tuple(bytes([c]) for c in b"-+.0123456789")
SHORTEST_ROW = len("0 0 0\n")


@dataclass(frozen=True, kw_only=True)
class TableLayout:
    """Where a table of numbers begins in a file and how it is written.

    `separator` is one character (a space stands for any white space); `n_rows` None reads to the end of the file;
    `first_line` is the number of the table's first line, for messages.
    """

    offset: int = 0
    n_columns: int
    n_rows: int | None = None
    separator: str = " "
    has_decimal_comma: bool = False
    first_line: int = 1


def read_table(path: str, layout: TableLayout) -> Iterator[NDArray[np.float64]]:
    """Yield the rows of a table, (n, n_columns), block by block.

    Raises
    ------
    FormatError
        A line with another number of values, a value that is no number, fewer rows than promised, a cut-off last line.
    """
    n_read, line = 0, layout.first_line
    for block in line_blocks(path, layout.offset, layout.n_rows):
        plain = _plain(block, layout)
        n_lines = block.count(b"\n")
        rows = _numbers(plain, layout.n_columns, range(line, line + n_lines))
        n_read += len(rows)
        line += n_lines
        yield rows
    if layout.n_rows is not None and n_read != layout.n_rows:
        raise FormatError(f"promises {layout.n_rows} rows of numbers, {n_read} are there; the file is cut off")


def line_blocks(path: str, offset: int, n_lines: int | None = None) -> Iterator[bytes]:
    """Yield whole lines from an offset on, many at a time; the last one gets a line end if it has none. A byte-order
    mark at the beginning of the file is passed over."""
    rest, before = b"", b""
    left = n_lines
    with Path(path).open("rb") as file:
        file.seek(offset)
        while left is None or left > 0:
            block = file.read(BLOCK)
            if not block:
                break
            require_line_feeds(block)
            if file.tell() == len(block):
                block = block.removeprefix(BYTE_ORDER_MARK)
            whole, mark, tail = block.rpartition(b"\n")
            block, rest = (rest + whole + mark, tail) if mark else (b"", rest + tail)
            if len(rest) > LONGEST_LINE:
                raise FormatError("has a line longer than a million characters; it is no table of numbers")
            if left is not None:
                block = _first_lines(block, left)
                left -= block.count(b"\n")
            if block:
                before = block
                yield block
    if rest.strip() and (left is None or left > 0):
        _require_whole_line(rest, before)
        yield rest + b"\n"


def require_line_feeds(text: bytes) -> None:
    """Raise where lines end with a carriage return alone: all of them would be one line."""
    if b"\r" in text.strip() and b"\n" not in text:
        raise FormatError("its lines end with a carriage return alone (CR); save it with line ends LF or CR LF")


def _first_lines(block: bytes, n: int) -> bytes:
    """Return at most the first n lines."""
    if block.count(b"\n") <= n:
        return block
    ends = np.flatnonzero(np.frombuffer(block, np.uint8) == NEWLINE)
    return block[: ends[n - 1] + 1]


def _require_whole_line(last: bytes, before: bytes) -> None:
    """Raise if the last line, which has no end, has fewer decimals than every line of its kind before it."""
    word = (last.split() or [b""])[0]
    kind = b"" if word[:1].isdigit() or word[:1] in b"-+." else word  # such as the v of OBJ
    earlier = [line.split() for line in before.split(b"\n")[-200:]]
    decimals = [_decimals_at_end(words[-1]) for words in earlier if words and words[0].startswith(kind or _SIGNS)]
    if decimals and _decimals_at_end(last) < min(decimals):
        raise FormatError("ends in the middle of a number; the file is cut off")


def _decimals_at_end(line: bytes) -> int:
    """Return how many digits follow the decimal point in the last number of a line."""
    found = re.search(rb"[.,](\d*)\D*$", line)
    return len(found.group(1)) if found else 0


def _plain(block: bytes, layout: TableLayout) -> bytes:
    """Return the block with blanks for separators and quotes, points for decimal commas, and no comment lines."""
    if b"#" in block or b"//" in block:
        lines = block.split(b"\n")
        block = b"\n".join(b"" if line.lstrip().startswith((b"#", b"//")) else line for line in lines)
    old, new = b'"\t\r\v\f', b"     "
    if layout.has_decimal_comma:
        old, new = old + b",", new + b"."
    if layout.separator not in " \t":
        old, new = old + layout.separator.encode(), new + b" "
    return block.translate(bytes.maketrans(old, new))


def _numbers(plain: bytes, n_columns: int, lines: Sequence[int]) -> NDArray[np.float64]:
    """Return the numbers of a block of lines, (n, n_columns); `lines` are the numbers of its lines in the file."""
    counts = _counts_by_line(plain)
    wrong = np.flatnonzero((counts != n_columns) & (counts > 0))
    if len(wrong):
        raise FormatError(f"line {lines[wrong[0]]} has {counts[wrong[0]]} values, the lines before it {n_columns}")
    if not counts.any():
        return np.empty((0, n_columns))
    try:
        return _parsed(plain)
    except (ValueError, UnicodeDecodeError) as problem:
        raise FormatError(_say_no_number(plain, lines)) from problem


def _say_no_number(plain: bytes, lines: Sequence[int]) -> str:
    """Return in words which is the first line of a block with something that is no number, and what that is."""
    for k, line in zip(lines, plain.split(b"\n"), strict=False):
        for word in line.split():
            try:
                float(word)
            except ValueError:
                text = word[:40].decode("ascii", "replace")
                return f"line {k} has {text!r}, which is no number; mend that line or take it out"
    return f"has something that is no number from line {lines[0]} on"


def _parsed(plain: bytes) -> NDArray[np.float64]:
    """Return a table of numbers; pandas parses five times faster than numpy but takes half a second to start."""
    if len(plain) < SLOWLY_PARSED:
        return np.loadtxt(io.BytesIO(plain), dtype=np.float64, comments=None, ndmin=2)
    import pandas as pd

    table = pd.read_csv(io.BytesIO(plain), sep=r"\s+", header=None, dtype=np.float64, quoting=3, engine="c",
                        keep_default_na=False, na_values=NOT_A_NUMBER)  # fmt: skip
    return table.to_numpy()


def numbers_of_lines(lines: Mapping[int, bytes], n_columns: int) -> NDArray[np.float64]:
    """Return the numbers of lines that were picked from a file, (n, n_columns), given by their numbers there."""
    return _numbers(b"\n".join(lines.values()) + b"\n", n_columns, list(lines))


def _counts_by_line(plain: bytes) -> NDArray[np.int64]:
    """Return how many values each line holds."""
    characters = np.frombuffer(plain, np.uint8)
    is_blank = characters <= SPACE
    begins = ~is_blank
    begins[1:] &= is_blank[:-1]
    so_far = np.searchsorted(np.flatnonzero(begins), np.flatnonzero(characters == NEWLINE))
    return np.diff(so_far, prepend=0)


def skip_rows(path: str, offset: int, line: int, n_rows: int) -> tuple[int, int]:
    """Return the offset and the number of the line after n_rows lines; fewer than promised is an error."""
    size = os.path.getsize(path)
    n_found, end = 0, offset
    if n_rows * SHORTEST_ROW <= size - offset + 1:
        for block in line_blocks(path, offset, n_rows):
            n_found += block.count(b"\n")
            end += len(block)
    if n_found != n_rows:
        raise FormatError(f"promises {n_rows} points from line {line} on, fewer are there; the file is cut off")
    return min(end, size), line + n_rows


def skip_blank(path: str, offset: int, line: int) -> tuple[int, int]:
    """Return the offset and the number of the next line that is not blank."""
    with Path(path).open("rb") as file:
        file.seek(offset)
        while text := file.readline(1000):
            if text.strip():
                break
            offset += len(text)
            line += 1
    return offset, line


def is_number(token: str) -> bool:
    """Return whether a word of a text file is a number."""
    try:
        float(token)
    except ValueError:
        return False
    return True


def whole_numbers(line: bytes) -> list[int] | None:
    """Return the whole numbers of a line, or None if it holds anything else or nothing."""
    words = line.split()
    return [int(word) for word in words] if words and all(re.fullmatch(rb"\d{1,18}", w) for w in words) else None
