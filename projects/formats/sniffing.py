"""Tells the format of a file: by its first bytes where the format has a mark, by its name among plain text files."""

from __future__ import annotations

import struct
from pathlib import Path

from projects.errors import FormatError
from projects.formats.text import is_number, whole_numbers

HEAD = 4096
MARKS = {b"ASTM-E57": "e57", b"LASF": "las", b"glTF": "glb", b"ply\n": "ply", b"ply\r": "ply", b"# .PCD": "pcd",
         b"VERSION": "pcd"}  # fmt: skip
BY_SUFFIX = {".e57": "e57", ".las": "las", ".laz": "las", ".glb": "glb", ".ply": "ply", ".pcd": "pcd", ".stl": "stl",
             ".obj": "obj", ".ptx": "ptx", ".pts": "pts", ".xyz": "xyz", ".txt": "xyz", ".csv": "xyz", ".asc": "xyz",
             ".xyzi": "xyz", ".xyzrgb": "xyz", ".neu": "xyz", ".dat": "xyz"}  # fmt: skip
MARKED = set(MARKS.values())
READABLE = "E57, PTX, PTS, LAS, LAZ, PLY, PCD, OBJ, STL, GLB, XYZ, TXT and CSV"


def sniff_format(path: Path) -> str:
    """Return which reader a file needs: e57, ptx, pts, las (LAZ too), ply, pcd, obj, stl, glb or xyz.

    Raises
    ------
    FormatError
        No such file, a folder, an empty file, one of no known format, or one whose content is not what it is named.
    """
    path = Path(path)
    head = _head(path)
    for mark, name in MARKS.items():
        if head.startswith(mark):
            return name
    expected = BY_SUFFIX.get(path.suffix.lower())
    if expected in MARKED:
        raise FormatError(f"{path}: is named {path.suffix} but does not begin like one; it is broken or misnamed")
    if _is_binary_stl(path, head):
        return "stl"
    is_text_stl = expected == "stl" and head.lstrip().startswith(b"solid") and b"\0" not in head
    if expected == "stl" and not is_text_stl:
        raise FormatError(f"{path}: is named .stl but is neither a text nor a complete binary STL; it is broken")
    if b"\0" in head:
        raise FormatError(f"{path}: is of no known format; {READABLE} can be read")
    return _text_format(path, head, expected)


def _head(path: Path) -> bytes:
    """Return the first bytes of a file."""
    try:
        with path.open("rb") as file:
            head = file.read(HEAD)
    except IsADirectoryError as problem:
        raise FormatError(f"{path}: is a folder; name the files in it") from problem
    except OSError as problem:
        raise FormatError(f"{path}: cannot be opened ({problem.strerror})") from problem
    if not head:
        raise FormatError(f"{path}: is empty")
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise FormatError(f"{path}: is text in UTF-16; save it as plain text (UTF-8)")
    return head.removeprefix(b"\xef\xbb\xbf")


def _is_binary_stl(path: Path, head: bytes) -> bool:
    """Return whether the file is as long as the triangles that a binary STL's header counts."""
    return len(head) >= 84 and path.stat().st_size == 84 + 50 * struct.unpack("<I", head[80:84])[0]


def _text_format(path: Path, head: bytes, expected: str | None) -> str:
    """Return the format of a text file."""
    lines = [line for line in head.splitlines() if line.strip()]
    starts = [line.split()[0] for line in lines]
    if starts and starts[0] == b"solid" and (expected == "stl" or b"facet" in starts):
        return "stl"
    if expected == "obj" or (expected is None and b"v" in starts):
        return "obj"
    if expected == "ptx" or _looks_like_ptx(lines):
        return "ptx"
    if expected is None and not any(is_number(w.decode("ascii", "replace")) for w in b" ".join(lines[:20]).split()):
        raise FormatError(f"{path}: is of no known format; {READABLE} can be read")
    return expected or "xyz"


def _looks_like_ptx(lines: list[bytes]) -> bool:
    """Return whether lines begin with two counts, four lines of three numbers and four of four."""
    counts = [whole_numbers(line) for line in lines[:2]]
    return (
        len(lines) >= 10
        and all(c is not None and len(c) == 1 for c in counts)
        and [len(line.split()) for line in lines[2:10]] == [3, 3, 3, 3, 4, 4, 4, 4]
    )
