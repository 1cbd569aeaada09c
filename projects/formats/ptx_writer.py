"""Scans out as PTX (Leica Cyclone): a text grid per scan, column by column, with rows of zeros for no return."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TextIO

import numpy as np

from projects.errors import FormatError
from projects.formats.complete_file import complete_file
from projects.formats.scan_blocks import ScanSource, in_blocks
from projects.model import Ints, Scan
from projects.transforms import apply, require_rigid


def write_ptx(path: Path, scans: Iterable[ScanSource]) -> None:
    """Write scans, each in its own frame with its pose, to one PTX file; metres, six decimals, intensity 0 to 1.

    A scan with `rows` and `columns` is written as its full grid, cells without a point as `0 0 0 0.5` as the format
    asks; one without is written as a single column. Unknown intensity is 0.5. A scan may come block by block, as an
    iterable of `Scan` that share name, pose and grid, each of columns beyond those before: memory then holds one
    block, and disk all.

    Raises
    ------
    FormatError
        No scans, an empty scan, several points in one cell, or blocks that are not in the order of their columns.
    """
    path, n_scans = Path(path), 0
    with complete_file(path) as unfinished, unfinished.open("w", encoding="ascii", newline="\n") as out:
        for source in scans:
            with in_blocks(source, path) as blocks:
                _write_scan(out, blocks, path)
            n_scans += 1
        if not n_scans:
            raise FormatError(f"{path}: no scans were given; a PTX file needs at least one")


def _write_scan(out: TextIO, blocks: Iterable[Scan], path: Path) -> None:
    """Write one scan, each block as the cells from the end of the one before to its own last column."""
    n_rows, n_columns, is_grid = _grid_of(blocks)
    _write_header(out, next(iter(blocks)), n_rows, n_columns)
    first = 0
    for block in blocks:
        cell = _cells(block, n_rows) if is_grid else first + np.arange(len(block.cloud))
        if len(np.unique(cell)) != len(cell):
            raise FormatError(f"{path}: scan {block.name} has several points in one cell of its grid; PTX holds one")
        if cell.min() < first:
            raise FormatError(
                f"{path}: the blocks of scan {block.name} are not in the order of their columns; sort them"
            )
        end = (int(cell.max()) // n_rows + 1) * n_rows if is_grid else first + len(cell)
        _write_grid(out, block, cell - first, end - first)
        first = end


def _grid_of(blocks: Iterable[Scan]) -> tuple[int, int, bool]:
    """Return rows and columns of the file, and whether they are those of the scan's own grid."""
    n_points = n_rows = n_columns = 0
    is_grid = True
    for scan in blocks:
        n_points += len(scan.cloud)
        if scan.rows is None or scan.columns is None or scan.rows.min() < 0 or scan.columns.min() < 0:
            is_grid = False
        else:
            n_rows, n_columns = max(n_rows, int(scan.rows.max()) + 1), max(n_columns, int(scan.columns.max()) + 1)
    return (n_rows, n_columns, True) if is_grid else (n_points, 1, False)


def _cells(scan: Scan, n_rows: int) -> Ints:
    """Return the place of each point of a grid in the file's order."""
    assert scan.rows is not None
    assert scan.columns is not None
    return scan.columns.astype(np.int64) * n_rows + scan.rows


def _write_header(out: TextIO, scan: Scan, n_rows: int, n_columns: int) -> None:
    """Write the ten header lines: size, scanner position and axes, and the transform with row vectors. Where nobody
    knows where the scanner stood, position and axes are left at the format's default, which says nothing."""
    T_project_scanner = require_rigid(scan.pose, f"pose of scan {scan.name}")
    position, axes = apply(T_project_scanner, scan.origin), T_project_scanner[:3, :3].T
    if not np.isfinite(position).all():
        position, axes = np.zeros(3), np.eye(3)
    lines = [str(n_columns), str(n_rows), " ".join(f"{v:.9f}" for v in position)]
    lines += [" ".join(f"{v:.12f}" for v in axis) for axis in axes]
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
