"""Poses files: where each scan stood, for formats that do not say.

A line a scan: `file-name` or `file-name#k`, 16 numbers (T_project_scanner row by row) and optionally 3 more (the
scanner's position in the scan's own frame, 0 0 0 where left out; but see `doubt_places`). `#` at the start of a line
begins a comment; a name with spaces stands in double quotes. Scans of a file are counted from 1; where a `#0` appears
for a file, from 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from projects.errors import FormatError, ParameterError
from projects.formats.text import is_number
from projects.formats.units import require_unit
from projects.model import Floats
from projects.transforms import require_rigid


@dataclass(frozen=True)
class PoseLine:
    """T_project_scanner (4, 4) of one scan and the scanner's position in its own frame (3,), both in metres.

    `is_origin_stated`: the line gives the position; `is_doubted`: it does not, and the points must bear out 0 0 0.
    """

    T_project_scanner: Floats
    origin: Floats = field(default_factory=lambda: np.zeros(3))
    is_origin_stated: bool = False
    is_doubted: bool = False


def read_poses(path: Path, *, unit: float = 1.0) -> dict[str, PoseLine]:
    """Return the lines of a poses file by the scan's name.

    Parameters
    ----------
    path : a text file as described above.
    unit : metres per unit of its lengths.

    Raises
    ------
    FormatError
        A line with the wrong count, a word that is no number, a transform that is not rigid, a name given twice.
    """
    path = Path(path)
    require_unit(unit)
    lines: dict[str, PoseLine] = {}
    for number, text in enumerate(_text(path).splitlines(), start=1):
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        name, words = _split(text, f"{path}, line {number}")
        if name in lines:
            raise FormatError(f"{path}, line {number}: {name} has a pose already; a scan has one line")
        lines[name] = _pose_line(words, unit, f"{path}, line {number} ({name})")
    if not lines:
        raise FormatError(f"{path}: holds no poses; a line is a file's name and 16 numbers")
    return lines


def doubt_places(lines: Mapping[str, PoseLine]) -> Mapping[str, PoseLine]:
    """Return the lines, doubted where each of them is the identity and none says where its scanner stood.

    Scans that were brought into the project's frame before they were exported, or merged, have such lines: 0 0 0 is
    then the origin of that frame, often inside the object, and from there all of it looks inside out: the points must
    bear it out. One identity among other poses is that of the scan whose frame is the project's.
    """
    if any(line.is_origin_stated or (line.T_project_scanner != np.eye(4)).any() for line in lines.values()):
        return lines
    return {name: replace(line, is_doubted=True) for name, line in lines.items()}


def _text(path: Path) -> str:
    """Return a small text file as text."""
    try:
        if path.stat().st_size > 64 * 2**20:
            raise FormatError(f"{path}: is larger than 64 MiB and no poses or control file")
        return path.read_text(encoding="utf-8-sig")
    except OSError as problem:
        raise FormatError(f"{path}: cannot be read ({problem.strerror})") from problem
    except UnicodeDecodeError as problem:
        raise FormatError(f"{path}: is no text in UTF-8 ({problem})") from problem


def _split(text: str, where: str) -> tuple[str, list[str]]:
    """Return the name and the words after it; a name may stand in double quotes."""
    text = text.strip()
    if not text.startswith('"'):
        name, *words = text.split()
        if is_number(name) and len(words) in (15, 18):
            raise FormatError(f"{where}: begins with a number; the file's name comes first, then 16 numbers")
        return name, words
    name, mark, rest = text[1:].partition('"')
    if not mark or not name:
        raise FormatError(f"{where}: the quote before the file's name is not closed")
    return name, rest.split()


def _pose_line(words: list[str], unit: float, where: str) -> PoseLine:
    """Return the pose in 16 or 19 words."""
    if bad := next((word for word in words if not is_number(word)), ""):
        raise FormatError(
            f"{where}: {bad[:40]!r} is no number; decimals have a point, names with blanks stand in double quotes"
        )
    if len(words) not in (16, 19):
        raise FormatError(
            f"{where}: {len(words)} numbers after the name; 16 are needed, or 19 with the scanner's place"
        )
    numbers = np.array([float(word) for word in words])
    try:
        T_project_scanner = require_rigid(numbers[:16].reshape(4, 4), where)
    except ParameterError as problem:
        raise FormatError(str(problem)) from problem
    if not np.isfinite(numbers).all():
        raise FormatError(f"{where}: a number is not finite")
    T_project_scanner[:3, 3] *= unit
    return PoseLine(T_project_scanner, unit * (numbers[16:] if len(words) == 19 else np.zeros(3)), len(words) == 19)


def find_pose_line(lines: Mapping[str, PoseLine], file_name: str, index: int, n_scans: int) -> PoseLine | None:
    """Return the line of scan `index` (from 0) of a file that holds `n_scans`, or None.

    Raises
    ------
    FormatError
        A line without #k for a file of several scans, or a k that the file does not have.
    """
    if file_name in lines and n_scans > 1:
        raise FormatError(f"poses: {file_name} holds {n_scans} scans; write {file_name}#1 to {file_name}#{n_scans}")
    numbers = _numbers_of(lines, file_name)
    first = 0 if 0 in numbers else 1
    beyond = [k for k in numbers if not first <= k < first + n_scans]
    if beyond:
        raise FormatError(f"poses: {file_name}#{beyond[0]} is named, but the file holds {n_scans} scans")
    if file_name in lines:
        return lines[file_name]
    return lines.get(f"{file_name}#{index + first}")


def _numbers_of(lines: Mapping[str, PoseLine], file_name: str) -> list[int]:
    """Return every k of `file-name#k`."""
    tails = [name[len(file_name) + 1 :] for name in lines if name.startswith(f"{file_name}#")]
    return [int(tail) for tail in tails if tail.isdecimal()]


def require_known_names(lines: Mapping[str, PoseLine], paths: Iterable[Path]) -> None:
    """Raise if a poses file names a scan of none of the files, or two files share the name that it uses.

    Raises
    ------
    FormatError
        The names that are not there, and those that are.
    """
    names = [Path(path).name for path in paths]
    for line in lines:
        stem, _, tail = line.rpartition("#")
        fits = [name for name in names if name == line or (name == stem and tail.isdecimal())]
        if not fits:
            raise FormatError(f"poses: {line} is none of the files given ({', '.join(names[:5])}...)"[:400])
        if len(fits) > 1:
            raise FormatError(f"poses: {line} is the name of several of the files given; rename one of them")
