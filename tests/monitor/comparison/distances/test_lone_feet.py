"""Vertices whose foot lies on another sheet than those of all around them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from monitor.comparison.distances.both_ways import make_shells, measure_sides
from monitor.comparison.distances.lone_feet import drop_lone
from monitor.comparison.distances.side import Side
from projects.model import Floats, NotAssessed, Registration, Surface
from projects.transforms import rotation_from_vector

EDGE, SIGMA = 1e-3, 5e-5
LIMITS = 0.05, np.pi / 3
MIDDLE, BESIDE = 210, 211  # vertices of a grid of 20 by 20


def side_with(changes: Floats, sigma: float | None = SIGMA) -> Side:
    """Return the side of a plane (20, 20) whose vertices change by these amounts [m]."""
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    at = np.arange(380)[np.arange(380) % 20 < 19]
    faces = np.vstack([np.column_stack([at, at + 1, at + 21]), np.column_stack([at, at + 21, at + 20])])
    plane = Surface(vertices=EDGE * np.column_stack([x.ravel(), y.ravel(), 0.0 * x.ravel()]),
                    faces=faces.astype(np.int32), sigma=None if sigma is None else np.full(400, sigma))  # fmt: skip
    still = Registration(np.eye(4), np.zeros((6, 6)), np.zeros(3), True)
    side = measure_sides(make_shells(plane, plane, LIMITS), still)[1]
    return replace(side, distances=np.where(side.is_assessed, changes, np.nan))


@pytest.mark.parametrize(("step", "is_lone"), [(0.025, True), (-0.025, True), (0.0016, True), (0.0013, False)])
def test_a_vertex_is_lone_where_all_around_it_lie_a_step_off(step: float, is_lone: bool) -> None:
    """Two edges of the grid's diagonals are 1.41 mm long, and no slope makes more of a change along them."""
    changes = np.zeros(400)
    changes[MIDDLE] = step
    dropped = drop_lone(side_with(changes))
    assert (dropped.reasons == NotAssessed.SHEET_BETWEEN).nonzero()[0].tolist() == [MIDDLE] * is_lone
    assert np.isnan(dropped.distances[MIDDLE]) == is_lone


@pytest.mark.parametrize(("n_unsure", "is_lone"), [(4, True), (5, False)])
def test_two_of_six_neighbours_must_be_sure_of_the_step(n_unsure: int, is_lone: bool) -> None:
    """Of an urn's vertex 25 mm off one neighbour knew its place to 5 mm; what is not assessed does not count."""
    changes = np.zeros(400)
    changes[MIDDLE] = 0.025
    side = side_with(changes)
    around = side.neighbours.vertices[side.neighbours.starts[MIDDLE] : side.neighbours.starts[MIDDLE + 1]]
    assert len(around) == 6
    side.sigma_surfaces[around[:n_unsure]] = 0.01
    assert np.isnan(drop_lone(side).distances[MIDDLE]) == is_lone
    side.distances[around[0]] = np.nan
    assert np.isnan(drop_lone(side).distances[MIDDLE]) == is_lone


def test_a_vertex_that_finds_a_sheet_far_behind_is_not_measured() -> None:
    """Its normal looks along the plane that it lies in, as a wall 5 mm behind it does."""
    floor = side_with(np.zeros(400)).surface
    wall = floor.vertices @ rotation_from_vector(np.array([0.0, 0.5 * np.pi, 0.0])).T + [0.005, 0.0, 0.01]
    both = Surface(np.vstack([floor.vertices, wall]), np.vstack([floor.faces, floor.faces + 400]))
    normals = np.tile([0.0, 0.0, 1.0], (400, 1))
    normals[MIDDLE] = [1.0, 0.0, 0.0]
    still = Registration(np.eye(4), np.zeros((6, 6)), np.zeros(3), True)
    side = measure_sides(make_shells(both, replace(floor, normals=normals), LIMITS), still)[1]
    assert side.reasons[MIDDLE] == NotAssessed.SHEET_BETWEEN
    assert side.reasons[BESIDE] == NotAssessed.ASSESSED


def test_what_hangs_together_with_one_neighbour_is_a_change(rng: np.random.Generator) -> None:
    changes = np.where(np.arange(400) % 20 < 10, 0.0, 0.02)  # a block set beside
    changes[[MIDDLE - 5, BESIDE - 5]] = 0.01  # two that agree
    side = side_with(changes + SIGMA * rng.normal(size=400))
    assert drop_lone(side) is side


def test_neighbours_that_know_nothing_do_not_contradict_a_vertex() -> None:
    """Of a bar one vertex wide only the end was met: those around it have no foot."""
    changes = np.full(400, np.nan)
    changes[[MIDDLE, BESIDE]] = 0.025, 0.0
    side = side_with(changes)
    assert drop_lone(side) is side


def test_noise_that_is_not_stated_makes_no_vertex_lone(rng: np.random.Generator) -> None:
    """Of a mesh that states no noise, it is told by all vertices: 3 mm, at edges of 1 mm."""
    side = side_with(3e-3 * rng.normal(size=400), None)
    assert drop_lone(side) is side
