"""Scans out as PTX (Leica Cyclone): a text grid per scan, column by column, with rows of zeros for no return."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

import numpy as np

from projects.errors import FormatError
from projects.formats.complete_file import complete_file
from projects.model import Ints, Scan
from projects.transforms import apply, require_rigid


def write_ptx(path: Path, scans: Sequence[Scan]) -> None:
    """Write scans, each in its own frame with its pose, to one PTX file; metres, six decimals, intensity 0 to 1.

    A scan with `rows` and `columns` is written as its full grid, cells without a point as `0 0 0 0.5` as the format
    asks; one without is written as a single column. Unknown intensity is 0.5.

    Raises
    ------
    FormatError
        No scans, an empty scan, or several points in one cell.
    """
    if not scans:
        raise FormatError(f"{path}: no scans were given; a PTX file needs at least one")
    with complete_file(path) as unfinished, unfinished.open("w", encoding="ascii", newline="\n") as out:
        for scan in scans:
            if not len(scan.cloud):
                raise FormatError(f"{path}: scan {scan.name} holds no points; leave it out")
            cell, n_rows, n_columns = _cells(scan, path)
            _write_header(out, scan, n_rows, n_columns)
            _write_grid(out, scan, cell, n_rows * n_columns)


def _cells(scan: Scan, path: Path) -> tuple[Ints, int, int]:
    """Return the place of each point in the file's order, and the size of the grid."""
    if scan.rows is None or scan.columns is None or scan.rows.min() < 0 or scan.columns.min() < 0:
        return np.arange(len(scan.cloud)), len(scan.cloud), 1
    n_rows, n_columns = int(scan.rows.max()) + 1, int(scan.columns.max()) + 1
    cell = scan.columns.astype(np.int64) * n_rows + scan.rows
    if len(np.unique(cell)) != len(cell):
        raise FormatError(f"{path}: scan {scan.name} has several points in one cell of its grid; PTX holds one")
    return cell, n_rows, n_columns


def _write_header(out: TextIO, scan: Scan, n_rows: int, n_columns: int) -> None:
    """Write the ten header lines: size, scanner position and axes, and the transform with row vectors."""
    T_project_scanner = require_rigid(scan.pose, f"pose of scan {scan.name}")
    position = apply(T_project_scanner, scan.origin)
    lines = [str(n_columns), str(n_rows), " ".join(f"{v:.9f}" for v in position)]
    lines += [" ".join(f"{v:.12f}" for v in axis) for axis in T_project_scanner[:3, :3].T]
    lines += [" ".join(f"{v:.12f}" for v in row) for row in T_project_scanner.T]
    out.write("\n".join(lines) + "\n")


def _write_grid(out: TextIO, scan: Scan, cell: Ints, n_cells: int, chunk: int = 200_000) -> None:
    """Write every cell of the grid in the file's order."""
    order = np.full(n_cells, -1, np.int64)
    order[cell] = np.arange(len(cell))
    cloud = scan.cloud
    row = "{:.6f} {:.6f} {:.6f} {:.6f}" + ("" if cloud.colors is None else " {} {} {}")
    empty = "0 0 0 0.500000" + ("" if cloud.colors is None else " 0 0 0")
    for start in range(0, n_cells, chunk):
        which = order[start : start + chunk]
        xyz = cloud.points[which].tolist()
        gray = (
            [0.5] * len(which) if cloud.intensity is None else np.nan_to_num(cloud.intensity[which], nan=0.5).tolist()
        )
        rgb = [()] * len(which) if cloud.colors is None else cloud.colors[which].tolist()
        lines = [row.format(*p, i, *c) if k >= 0 else empty for k, p, i, c in zip(which, xyz, gray, rgb, strict=True)]
        out.write("\n".join(lines) + "\n")
