"""What stations saw: looked through, measured, hidden, not measured."""

from __future__ import annotations

import numpy as np
import pytest

from monitor.comparison.sight.stations import Sighted, gather_sight, look_at

STATION = np.array([10.0, -20.0, 1.5])


def scan_of_wall(distance: float, with_post: bool) -> np.ndarray:
    """Return the points of a wall `distance` m in front of the station, seen past a post 0.2 m wide at half the way."""
    angle = np.arange(-0.3, 0.3, 0.002)
    a, e = (g.ravel() for g in np.meshgrid(angle, angle))
    beams = np.column_stack([np.tan(a), np.ones(len(a)), np.tan(e) / np.cos(a)])
    reach = np.full(len(a), distance)
    if with_post:
        reach[np.abs(beams[:, 0]) * 0.5 * distance < 0.1] = 0.5 * distance
    return STATION + beams * reach[:, None]


def see(points: list[list[float]], with_post: bool, chunk: int = 10**6) -> list[int]:
    wall = scan_of_wall(4.0, with_post)
    sight = gather_sight(STATION, (wall[k : k + chunk] for k in range(0, len(wall), chunk)))
    assert sight is not None
    return look_at([sight], STATION + np.array(points), 0.001).tolist()


@pytest.mark.parametrize("chunk", [10**6, 7001])
def test_what_the_post_hides_or_its_absence_shows(chunk: int) -> None:
    on_post, behind_post, on_wall, beside_view = [0.02, 2.0, 0.1], [0.02, 3.0, 0.1], [0.5, 4.0, 0.1], [2.0, 2.0, 0.1]
    through, measured, hidden = Sighted.LOOKED_THROUGH, Sighted.MEASURED, Sighted.NOT_SEEN
    assert see([on_post, behind_post, on_wall, beside_view], True, chunk) == [measured, hidden, measured, hidden]
    assert see([on_post, behind_post, on_wall, beside_view], False, chunk) == [through, through, measured, hidden]


def test_the_edge_of_a_post_is_not_looked_through() -> None:
    cell = 2 * 0.002  # rad: the window about a direction is three cells wide
    at = [[0.1 + 2.0 * k * cell, 2.0, 0.1] for k in (0.0, 0.5, 3.0)]
    found = see(at, True)
    assert found[0] != Sighted.LOOKED_THROUGH
    assert found[1] != Sighted.LOOKED_THROUGH
    assert found[2] == Sighted.LOOKED_THROUGH


def test_what_stands_just_before_the_wall_is_not_looked_through() -> None:
    depth = 3 * 2 * 0.002 * 4.0  # a window's width at 4 m
    assert see([[0.5, 4.0 - 0.5 * depth, 0.1], [0.5, 4.0 - 1.5 * depth, 0.1]], False) == [
        Sighted.MEASURED, Sighted.LOOKED_THROUGH]  # fmt: skip


def test_the_strongest_of_several_stations_counts_and_none_sees_nothing() -> None:
    blind = gather_sight(STATION, [scan_of_wall(4.0, True)])
    other = gather_sight(STATION, [scan_of_wall(4.0, False)])
    assert blind is not None
    assert other is not None
    place = STATION + np.array([[0.02, 3.0, 0.1]])
    assert look_at([blind, other], place, 0.001)[0] == Sighted.LOOKED_THROUGH
    assert look_at([], place, 0.001)[0] == Sighted.NOT_SEEN
    assert gather_sight(STATION, [np.zeros((0, 3))]) is None
