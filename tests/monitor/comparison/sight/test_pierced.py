"""A beam went through a part, or only past it: a rod between the beams of a coarse scan is not looked through."""

from __future__ import annotations

import numpy as np
import pytest

from monitor.comparison.sight.stations import Sighted, StationSight, gather_sight, look_at
from monitor.simulation.scenes import grid_faces
from projects.model import Surface
from projects.transforms import perturb

STATION = np.array([10.0, -20.0, 1.5])
STEP = 0.002  # rad: 4 mm between beams at 2 m
TURNS = [np.zeros(3), np.array([0.0, 0.0, 1.2]), np.array([0.3, 1.9, 0.4])]  # to all faces of the cube of directions


def turned(points: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Return points about the station, turned by `turn` (3,) [rad]."""
    T = perturb(np.eye(4), np.zeros(3), np.concatenate([turn, np.zeros(3)]))
    return STATION + points @ T[:3, :3].T


def look_at_wall(turn: np.ndarray, rods: list[tuple[float, float]] | None = None) -> StationSight:
    """Return the sight of a wall 4 m away, by beams every `STEP`; before it stand rods from x to x [m] at 2 m."""
    angle = STEP * (np.arange(-80, 80) + 0.5)
    a, e = (g.ravel() for g in np.meshgrid(angle, angle))
    beams = np.column_stack([np.tan(a), np.ones(len(a)), np.tan(e) / np.cos(a)])
    reach = np.full(len(a), 4.0)
    for low, high in rods or []:
        reach[(beams[:, 0] * 2.0 > low) & (beams[:, 0] * 2.0 < high)] = 2.0
    sight = gather_sight(STATION, [turned(beams * reach[:, None], turn)])
    assert sight is not None
    return sight


def strip(low: float, high: float, turn: np.ndarray) -> Surface:
    """Return the front of a rod from x = `low` to `high` [m], 0.2 m high, 2 m before the station."""
    x, z = (g.ravel() for g in np.meshgrid(np.linspace(low, high, 5), np.linspace(-0.1, 0.1, 101), indexing="ij"))
    return Surface(turned(np.column_stack([x, np.full(len(x), 2.0), z]), turn), grid_faces(5, 101))


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize(
    ("low", "high", "share"),
    [
        (0.0225, 0.0255, 0.0),  # between two columns of beams, at 0.022 and 0.026: it may still be there
        (0.0205, 0.0235, 0.0),  # one column went through it, but nearer to its border than half a step
        (0.0, 0.0085, 1.0),  # two columns went through it
        (0.0, 0.05, 1.0),
    ],
)
def test_looked_through_is_what_beams_went_through(turn: np.ndarray, low: float, high: float, share: float) -> None:
    surface, sight = strip(low, high, turn), look_at_wall(turn)
    assert (look_at([sight], surface.vertices, 0.001) == Sighted.LOOKED_THROUGH).mean() > 0.95  # nothing is nearer
    through = look_at([sight], surface.vertices, 0.001, surface) == Sighted.LOOKED_THROUGH
    assert through.mean() == pytest.approx(share, abs=0.05)  # at the borders of the cube's faces nothing is told


def test_a_rod_that_stands_between_the_beams_is_not_told_by_what_is_gone_behind_it() -> None:
    """Beams beside it went through a plate that is gone, 0.5 m farther."""
    rod, plate = strip(0.0225, 0.0255, TURNS[0]), strip(-0.05, 0.1, TURNS[0])
    both = Surface(np.concatenate([rod.vertices, plate.vertices + np.array([0.0, 0.5, 0.0])]),
                   np.concatenate([rod.faces, plate.faces + len(rod.vertices)]))  # fmt: skip
    seen = look_at([look_at_wall(TURNS[0])], both.vertices, 0.001, both)
    assert (seen[: len(rod.vertices)] == Sighted.NOT_SEEN).all()
    assert (seen[len(rod.vertices) :] == Sighted.LOOKED_THROUGH).mean() > 0.95


def test_a_rod_that_beams_met_is_not_looked_through() -> None:
    surface = strip(0.0, 0.0085, TURNS[0])
    seen = look_at([look_at_wall(TURNS[0], [(0.0, 0.0085)])], surface.vertices, 0.001, surface)
    assert (seen == Sighted.MEASURED).mean() > 0.5
    assert (seen != Sighted.LOOKED_THROUGH).all()
