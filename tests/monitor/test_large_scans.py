"""Scans that are too large to be looked at whole while poses are sought: which of their points are."""

from collections.abc import Callable, Iterator
from types import SimpleNamespace

import numpy as np
import pytest

from monitor import scan_assembly, scans
from monitor.filtering.drawing_order import hash_points
from projects.model import PointCloud, Scan


def grid_of(n: int, *, is_grid: bool = True) -> Scan:
    """Return a bumpy scan of n by n points, in rows and columns or not."""
    rows, columns = np.divmod(np.arange(n * n), n)
    height = 0.05 * np.sin(0.3 * rows) * np.cos(0.2 * columns)
    cloud = PointCloud(np.c_[0.01 * rows, 0.01 * columns, 2.0 + height])
    cells = {"rows": rows.astype(np.int32), "columns": columns.astype(np.int32)} if is_grid else {}
    return Scan("a", cloud, np.eye(4), **cells)


def in_chunks(scan: Scan, *ends: int) -> Callable[[], Iterator[Scan]]:
    """Return what yields the scan in pieces that end there."""

    def chunks() -> Iterator[Scan]:
        for first, last in zip((0, *ends), (*ends, len(scan.cloud)), strict=True):
            yield scan.take(np.arange(first, last))

    return chunks


def test_of_a_large_grid_every_so_many_rows_and_columns_are_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scans, "MOST_SEARCHED", 1000)
    whole = grid_of(90)  # 8100 points: every third
    found = scans.join_thinned(in_chunks(whole, 1000, 4000)(), len(whole.cloud))
    assert len(found.cloud) == 30 * 30
    assert (found.rows.max(), found.columns.max()) == (29, 29)
    np.testing.assert_array_equal(
        found.cloud.points, whole.cloud.points[(whole.rows % 3 == 0) & (whole.columns % 3 == 0)]
    )
    for kept in (grid_of(30), grid_of(90, is_grid=False)):  # small enough; no grid, of which nothing can be left out
        again = scans.join_thinned(in_chunks(kept, 500)(), len(kept.cloud))
        np.testing.assert_array_equal(again.cloud.points, kept.cloud.points)


def test_points_that_tell_a_shape_are_drawn_alike_in_whatever_pieces_they_come(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scan_assembly, "N_POINTS", 1500)
    whole = grid_of(90).cloud.points
    expected = whole[hash_points(whole, 0) <= 1500 / 8100 * float(2**64 - 1)]
    assert len(expected) == pytest.approx(1500, abs=150)
    for ends in ((), (10, 4000), (8090,)):
        stream = SimpleNamespace(
            name="a", chunks=in_chunks(grid_of(90), *ends), origin=np.zeros(3), is_origin_stated=True
        )
        np.testing.assert_array_equal(scan_assembly.read_oriented(stream).points, expected)
