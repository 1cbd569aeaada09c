"""Where the beams of a grid scan went that met nothing, and what is said of what stood in their way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from monitor.bearings import angles_of, directions_of
from monitor.comparison.sight.beam_grid import BeamGrid, GridBuilder, part_of_turn, step_of
from monitor.comparison.sight.stations import Sighted, StationSight, gather_sight, look_at, unit
from monitor.sights import _gather_sight
from projects.formats import read_scans
from projects.model import Bools, Floats

STEP, N_ROWS, N_COLUMNS = 0.002, 240, 300
STATION = np.array([10.0, -20.0, 1.5])
TILT = np.array([[0.96, -0.28, 0.0], [0.28, 0.96, 0.0], [0.0, 0.0, 1.0]]) @ np.array(
    [[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]]
)  # from the frame of the scan to that of the epoch


def beams_of(first_turn: float = -0.3, falling: bool = False) -> tuple[Floats, Floats, Floats]:
    """Return rows, columns (n,) and directions (n, 3), in the scan's frame, of all beams of a scan."""
    row, column = (i.ravel() for i in np.mgrid[:N_ROWS, :N_COLUMNS])
    turn = first_turn + (STEP if not falling else -STEP) * column
    return row, column, directions_of(turn, 0.25 - STEP * row)


def grid_of(has_met: Bools, swapped: bool = False, **turned: float) -> BeamGrid | None:
    """Return the grid of a scan of which so many beams (n,) met something, given in three chunks."""
    row, column, way = beams_of(**turned)  # type: ignore[arg-type]
    builder = GridBuilder(10**6)
    rng = np.random.default_rng(3)
    for part in np.array_split(rng.permutation(np.flatnonzero(has_met)), 3):
        beams = rng.uniform(2.0, 9.0, len(part))[:, None] * way[part]
        builder.add(*((column[part], row[part]) if swapped else (row[part], column[part])), beams)
    return builder.finish(TILT)


def hole() -> Bools:
    """Return which beams met something: all but those of a window, and of one row and one column."""
    row, column, _ = beams_of()
    return ~(((row > 100) & (row < 140) & (column > 120) & (column < 180)) | (row == 30) | (column == 20))


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("turned", [{}, {"first_turn": 2.9}, {"first_turn": -2.9, "falling": True}])
def test_beams_that_met_nothing_are_found_near_what_is_asked(swapped: bool, turned: dict) -> None:
    grid = grid_of(hole(), swapped, **turned)
    assert grid is not None
    assert (len(grid.heights), len(grid.turns)) == (N_ROWS, N_COLUMNS)
    row, column, way = beams_of(**turned)
    asked = way[(row == 120) & (column == 150)]
    found = grid.empty_near(asked @ TILT.T, 10.2 * STEP) @ TILT
    near = (np.abs(row - 120) <= 11) & (np.abs(column - 150) <= 11)
    assert len(found) == near.sum()
    away = np.linalg.norm(found[:, None] - way[near][None], axis=2).min(axis=1)
    assert away.max() < 0.01 * STEP
    assert len(grid.empty_near(way[(row == 60) & (column == 60)] @ TILT.T, 10.2 * STEP)) == 0
    assert len(grid.empty_near(way[(row == 30) & (column == 200)] @ TILT.T, 0.9 * STEP)) == 3  # a row without any
    assert len(grid.empty_near(-asked @ TILT.T, 10.2 * STEP)) == 0  # behind


def test_a_scan_all_around_is_asked_across_its_seam() -> None:
    n = 3142
    row, column = (i.ravel() for i in np.mgrid[:40, :n])
    way = directions_of(0.3 + 2.0 * np.pi / n * column, 0.04 - STEP * row)
    has_met = ~((row > 5) & (row < 35) & ((column < 20) | (column > n - 20)))
    builder = GridBuilder(10**6)
    builder.add(row[has_met], column[has_met], 3.0 * way[has_met])
    grid = builder.finish(np.eye(3))
    assert grid is not None
    found = grid.empty_near(directions_of(np.array([0.3]), np.array([0.0])), 8.2 * STEP)
    turn = np.angle(np.exp(1j * (angles_of(found)[0] - 0.3)))
    assert turn.min() < -7.0 * STEP
    assert turn.max() > 7.0 * STEP


def test_beams_went_between_two_posts_more_than_half_a_turn_apart() -> None:
    n = 2800
    row, column = (i.ravel() for i in np.mgrid[:40, :n])
    way = directions_of(-2.5 + STEP * column, 0.04 - STEP * row)
    has_met = (column < 60) | (column > n - 60)
    builder = GridBuilder(10**6)
    builder.add(row[has_met], column[has_met], 3.0 * way[has_met])
    grid = builder.finish(np.eye(3))
    assert grid is not None
    np.testing.assert_allclose(grid.turns, -2.5 + STEP * np.arange(n), atol=1e-9)
    asked = directions_of(np.array([0.4]), np.array([0.0]))
    found = grid.empty_near(asked, 5.2 * STEP)
    assert len(found) == 13 * 13
    assert np.linalg.norm(found - asked, axis=1).min() < STEP


@pytest.mark.parametrize(
    "kind", ["no grid", "two faces", "few", "jittered", "one turn", "gap", "thinned", "chequered", "numbered"]
)
def test_what_is_no_full_grid_tells_of_no_beams(kind: str) -> None:
    row, column, way = beams_of()
    rng = np.random.default_rng(1)
    keep, n_fired = np.ones(len(row), dtype=np.bool_), len(row)
    if kind == "no grid":
        row, column = rng.permutation(row), rng.permutation(column)
    elif kind == "two faces":  # the second half of each column was measured over the top
        way = np.where((row < N_ROWS // 2)[:, None], way, way * [-1.0, -1.0, 1.0])
    elif kind == "few":
        keep = column < 7
    elif kind == "jittered":
        way = unit(way + rng.normal(scale=0.65 * STEP, size=way.shape))
    elif kind == "one turn":  # a profile, measured again and again
        way = directions_of(np.zeros(len(row)), 0.25 - STEP * row)
    elif kind == "gap":  # the later columns lie farther round by ten steps than their numbers say
        way = directions_of(-0.3 + STEP * (column + 10 * (column > 150)), 0.25 - STEP * row)
    elif kind == "thinned":
        keep = rng.random(len(row)) < 0.7
    elif kind == "chequered":
        keep = (row + column) % 2 == 0
    else:
        row = column = np.arange(len(row))
    builder = GridBuilder(n_fired)
    builder.add(row[keep], column[keep], 4.0 * way[keep])
    assert builder.finish(np.eye(3)) is None
    empty = GridBuilder(n_fired)
    empty.add(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3)))
    empty.add(np.array([-1, 3]), np.array([2, -1]), np.ones((2, 3)))
    assert empty.finish(np.eye(3)) is None


def test_a_beam_without_a_place_is_left_out_of_its_grid() -> None:
    row, column, way = beams_of()
    builder = GridBuilder(len(row))
    builder.add(np.append(row, -1), np.append(column, 5), np.vstack([4.0 * way, [[0.0, 0.0, 1.0]]]))
    grid = builder.finish(np.eye(3))
    assert grid is not None
    np.testing.assert_allclose(grid.heights, 0.25 - STEP * np.arange(N_ROWS), atol=1e-9)


def test_before_the_first_row_and_column_no_beam_is_known_and_steep_ones_are_asked_as_wide_as_flat_ones() -> None:
    row, column = (i.ravel() for i in np.mgrid[:700, :300])
    way = directions_of(0.01 * column, 0.002 * row)  # up to 1.4 rad
    has_met = (row >= 50) & (column >= 40) & ~((row > 540) & (row < 560) & (column > 100) & (column < 200))
    builder = GridBuilder(len(row))
    builder.add(row[has_met], column[has_met], 3.0 * way[has_met])
    grid = builder.finish(np.eye(3))
    assert grid is not None
    np.testing.assert_allclose(grid.turns, 0.01 * np.arange(40, 300), atol=1e-9)
    reach = 0.012
    found = grid.empty_near(directions_of(np.array([1.5]), np.array([1.1])), reach)
    turn, height = angles_of(found)
    assert np.abs(height - 1.1).max() == pytest.approx(0.012, abs=1e-9)
    assert np.cos(1.1) * np.abs(turn - 1.5).max() >= reach  # at 63 degrees more columns lie as near
    assert len(grid.empty_near(directions_of(np.array([0.2]), np.array([0.5])), reach)) == 0  # before the first
    assert len(grid.empty_near(directions_of(np.array([1.5]), np.array([1.3])), reach)) == 0  # steeper than is known


def test_a_station_s_grid_stands_as_its_scan_does() -> None:
    """Through the store's words: rows and columns in the scan's frame, its origin off zero, its pose tilted."""
    row, column, way = beams_of()
    origin, pose = np.array([0.3, -0.2, 1.1]), np.eye(4)
    pose[:3, :3], pose[:3, 3] = TILT, STATION
    cloud = SimpleNamespace(points=origin + 4.0 * way[hole()])
    chunk = SimpleNamespace(cloud=cloud, rows=row[hole()], columns=column[hole()])
    place = SimpleNamespace(object_id="o", epoch_id="e", project=SimpleNamespace(iterate_scan=lambda *_: iter([chunk])))
    header = SimpleNamespace(index=0, origin=origin, is_grid=True, n_points=int(hole().sum()), dropped={"empty": 100})
    sight = _gather_sight(place, header, pose)  # type: ignore[arg-type]
    assert sight is not None
    there = STATION + TILT @ (origin + 2.0 * way[120 * N_COLUMNS + 150])
    assert look_at([sight], there[None], 0.001).tolist() == [Sighted.MET_NOTHING]
    header.is_grid = False
    blind = _gather_sight(place, header, pose)  # type: ignore[arg-type]
    assert blind is not None
    assert blind.grid is None


def sight_of(has_met: Bools, with_grid: bool = True) -> StationSight:
    """Return the sight of a scan that met a ball of 4 m about the station where its beams met something."""
    way = beams_of()[2]
    sight = gather_sight(STATION, [STATION + 4.0 * way[has_met] @ TILT.T])
    assert sight is not None
    return replace(sight, grid=grid_of(has_met)) if with_grid else sight


def test_what_stood_before_the_sky_met_nothing_and_is_not_looked_through() -> None:
    way = beams_of()[2]

    def at(r: int, c: int, reach: float) -> Floats:
        """Return a place in the way of a beam, so far from the station."""
        return STATION + reach * way[r * N_COLUMNS + c] @ TILT.T

    places = np.array([at(120, 150, 2.0), at(120, 150, 5.0), at(60, 60, 2.0), at(60, 60, 4.0), at(60, 60, 5.0),
                       at(120, 123, 5.0), at(120, 123, 2.0), at(138, 178, 2.0)])  # fmt: skip
    found = look_at([sight_of(hole())], places, 0.001)
    nothing, hidden = Sighted.MET_NOTHING, Sighted.NOT_SEEN
    assert found.tolist() == [
        nothing,
        nothing,
        Sighted.LOOKED_THROUGH,
        Sighted.MEASURED,
        hidden,
        hidden,
        nothing,
        hidden,
    ]
    without = look_at([sight_of(hole(), with_grid=False)], places, 0.001)
    assert without.tolist() == [
        hidden,
        hidden,
        Sighted.LOOKED_THROUGH,
        Sighted.MEASURED,
        hidden,
        hidden,
        hidden,
        hidden,
    ]
    outside = STATION + 2.0 * directions_of(np.array([-0.3 - 20 * STEP]), np.array([0.0])) @ TILT.T
    assert look_at([sight_of(hole())], outside, 0.001).tolist() == [hidden]


def test_what_another_station_measured_or_looked_through_is_told_so() -> None:
    row, column, way = beams_of()
    place = (STATION + 2.0 * way[(row == 120) & (column == 150)] @ TILT.T).reshape(1, 3)
    everything = np.ones(len(row), dtype=np.bool_)
    for others, told in ((sight_of(everything), Sighted.LOOKED_THROUGH), (sight_of(hole()), Sighted.MET_NOTHING)):
        assert look_at([sight_of(hole()), others], place, 0.001).tolist() == [told]


def test_the_grid_of_a_real_scan_is_known_and_its_beams_lie_where_they_were_measured(real_data: Path) -> None:
    """The pump of libE57's test data: 1074 rows and 345 columns, of which two fifths came back."""
    (stream,) = read_scans(real_data / "e57" / "pumpAVisualReferenceImage.e57")
    builder, chunks = GridBuilder(155201), list(stream.chunks())
    for chunk in chunks:
        assert chunk.rows is not None
        assert chunk.columns is not None
        builder.add(chunk.rows, chunk.columns, chunk.cloud.points - chunk.origin)
    grid = builder.finish(np.eye(3))
    assert grid is not None
    rows, columns = (np.concatenate([getattr(c, name) for c in chunks]) for name in ("rows", "columns"))
    ways = unit(np.concatenate([c.cloud.points - c.origin for c in chunks]))
    turn, height = angles_of(ways)
    off = part_of_turn(grid.turns[columns - columns.min()] - turn), grid.heights[rows - rows.min()] - height
    for away, step in zip(off, (step_of(grid.turns), step_of(grid.heights)), strict=True):
        assert np.quantile(np.abs(away), 0.9) < 0.75 * step  # one row or column off: more than that of all
    assert len(grid.empty_near(ways[:: len(ways) // 50], 3.0 * step_of(grid.turns))) > 100
