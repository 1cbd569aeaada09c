"""Three planes fitted to points around a corner: found as they are, known as well as is stated, none where none are."""

from __future__ import annotations

import numpy as np
import pytest
from corners_of_planes import CUBE, NOISE, points_around, round_corner_cloud, unit

from monitor.reconstruction.three_planes import (
    SHAPES,
    Around,
    Corner,
    edges_of,
    fit_corner,
    have_a_point,
    height_over,
    plane_under,
    rounding,
)
from projects.model import Floats

OBTUSE = unit([[1.0, 0.0, 0.6], [-0.5, 0.87, 0.6], [-0.5, -0.87, 0.6]])
WEDGE = unit([[1.0, 0.0, 0.0], [0.5, 0.87, 0.0], [0.0, 0.0, 1.0]])
RADIUS, CELL = 0.010, 0.0015


def turned(normals: Floats, radians: float) -> Floats:
    """Return normals (3, 3) each turned towards the next by an angle."""
    return normals * np.cos(radians) + np.roll(normals, 1, axis=0) * np.sin(radians)


def exact_corner(shape: tuple[int, int]) -> Corner:
    """Return the corner of a cube at the origin, known exactly."""
    return Corner(np.zeros(3), CUBE, shape, np.zeros((3, 3, 3)), np.zeros((3, 2, 3)), np.zeros(3, int), 1.0, 0.0)


def over_cube(corner: Corner) -> Floats:
    """Return the heights (3,) of a corner's place over the planes of the cube."""
    return CUBE @ corner.place


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("normals", [CUBE, OBTUSE, WEDGE])
def test_planes_without_noise_are_found_exactly_in_every_way_they_meet(normals: Floats, shape: tuple[int, int]) -> None:
    around = points_around(np.random.default_rng(3), normals, shape, RADIUS, 0.0)._replace(noise=2e-4)
    start = np.array([0.0004, -0.0003, 0.0002])
    corner = fit_corner(start, turned(normals, 0.03), around, RADIUS, CELL)
    assert corner is not None
    np.testing.assert_allclose(corner.place, 0.0, atol=2e-6)
    np.testing.assert_allclose(corner.normals, normals, atol=2e-4)
    heights = around.points @ normals.T
    np.testing.assert_allclose(height_over(heights, corner.shape), height_over(heights, shape), atol=1e-9)
    assert corner.radius == RADIUS


def test_a_corner_errs_by_what_it_states() -> None:
    """Each plane by its own height; 200 draws tell a standard deviation to 5 %."""
    found = []
    for seed in range(200):
        around = points_around(np.random.default_rng([seed, 5]), CUBE, (-1, 1), RADIUS, 2e-4)
        corner = fit_corner(np.zeros(3), CUBE, around, RADIUS, CELL)
        if corner is not None:
            found.append(over_cube(corner) / np.sqrt(corner.errors[:, 0, 0]))
    assert len(found) > 190
    assert np.std(found) == pytest.approx(1.0, abs=0.12)
    assert abs(np.mean(found)) < 0.12


def test_planes_rest_on_points_clear_of_the_others() -> None:
    """Each of a cube has a quarter of a disc of 10 mm, less what lies within three sigmas of its edges."""
    noise = 4e-4
    around = points_around(np.random.default_rng(6), CUBE, (-1, 1), RADIUS, noise)
    corner = fit_corner(np.zeros(3), CUBE, around, RADIUS, CELL)
    assert corner is not None
    clear = np.sort(np.abs(around.points), axis=1)[:, 1] > 3.0 * noise
    np.testing.assert_allclose(corner.support, np.count_nonzero(clear) / 3.0, rtol=0.15)


def test_two_planes_a_ball_and_a_rough_corner_are_none() -> None:
    rng = np.random.default_rng(7)
    u, v = rng.uniform(-RADIUS, RADIUS, (2, 400))
    edge = np.column_stack([u, v, -np.abs(u)])
    ball = np.column_stack([u, v, -(u**2 + v**2) / 0.03])
    three = unit([[1.0, 0.3, 1.0], [-1.0, 0.0, 1.0], [0.0, -1.0, 1.0]])
    for points in (edge, ball):
        around = Around(points + 2e-4 * rng.normal(size=points.shape), np.ones(400), 2e-4)
        assert fit_corner(np.zeros(3), three, around, RADIUS, CELL) is None
    rough = points_around(rng, CUBE, (-1, 1), RADIUS, 4e-4)
    assert fit_corner(np.zeros(3), CUBE, rough, RADIUS, CELL) is not None
    assert fit_corner(np.zeros(3), CUBE, rough._replace(noise=2.5e-4), RADIUS, CELL) is None


def test_what_a_smooth_patch_explains_as_well_is_no_corner() -> None:
    """Over a steep paraboloid three planes leave no more than the noise in 9 draws of 20."""
    for seed in range(20):
        rng = np.random.default_rng([seed, 12])
        u, v = rng.uniform(-0.006, 0.006, (2, 150))
        points = np.column_stack([u, v, -(u**2 + v**2) / 0.012 + NOISE * rng.normal(size=150)])
        points = points[np.hypot(u, v) < 0.006]
        three = unit([[0.7, 0.0, 1.0], [-0.35, 0.61, 1.0], [-0.35, -0.61, 1.0]])
        around = Around(points, np.ones(len(points)), NOISE)
        assert fit_corner(np.array([0.0, 0.0, NOISE]), three, around, 0.006, CELL) is None


def test_a_corner_far_from_where_it_was_sought_is_another() -> None:
    around = points_around(np.random.default_rng(8), CUBE, (-1, 1), RADIUS, 4e-4)
    assert fit_corner(np.full(3, 5e-4), CUBE, around, RADIUS, cell=5e-4) is not None  # 0.87 mm off
    assert fit_corner(np.full(3, 7e-4), CUBE, around, RADIUS, cell=5e-4) is None  # 1.21 mm


def test_points_in_one_line_are_no_plane() -> None:
    line = np.column_stack([np.zeros(40), -np.linspace(0.001, 0.009, 40), -np.linspace(0.001, 0.009, 40)])
    points = np.concatenate([line, np.roll(line, 1, axis=1), np.roll(line, 2, axis=1)])
    assert fit_corner(np.zeros(3), CUBE, Around(points, np.ones(120), 1e-4), RADIUS, CELL) is None


@pytest.mark.parametrize(("degrees", "so"), [(20.0, False), (30.0, True)])
def test_planes_nearly_alike_have_no_corner(degrees: float, so: bool) -> None:
    side = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0.0])
    assert have_a_point(np.array([[[1.0, 0.0, 0.0], side, [0.0, 0.0, 1.0]]])).tolist() == [so]


def test_what_the_surface_is_of_three_planes() -> None:
    heights = np.array([[0.1, -0.2, -0.3], [-0.1, 0.2, 0.4]])
    np.testing.assert_allclose(height_over(heights, (-1, 1)), [0.1, 0.4])  # the highest: a cube's corner from outside
    np.testing.assert_allclose(height_over(heights, (-1, -1)), [-0.3, -0.1])  # the lowest: from within
    np.testing.assert_allclose(height_over(heights, (0, 1)), [0.1, 0.2])  # one, and the lower of both others
    np.testing.assert_allclose(height_over(heights, (0, -1)), [-0.2, -0.1])  # the lower of it and the higher of these
    assert plane_under(heights, (0, 1)).tolist() == [0, 1]


@pytest.mark.parametrize(("shape", "ways"), [((-1, 1), (-1, -1, -1)), ((-1, -1), (1, 1, 1)), ((2, 1), (-1, 1, 1))])
def test_edges_run_where_two_planes_are_the_surface(shape: tuple[int, int], ways: tuple[int, int, int]) -> None:
    """Those of (0, 1), (0, 2) and (1, 2) of a cube run along z, y and x; a plane that cuts two others off turns round
    its own."""
    edges = edges_of(exact_corner(shape))
    assert len(edges) == 6
    for (a, b), axis, way in zip(((0, 1), (0, 2), (1, 2)), (2, 1, 0), ways, strict=True):
        np.testing.assert_allclose(edges[a, b], way * CUBE[axis], atol=1e-12)
        np.testing.assert_array_equal(edges[a, b], edges[b, a])


@pytest.mark.parametrize("shape", SHAPES)
def test_round_edges_show_beside_all_edges_alike(shape: tuple[int, int]) -> None:
    """Points inside of a ridge and outside of a fold count for it, whichever planes make these."""
    around = points_around(np.random.default_rng(9), CUBE, shape, RADIUS, 0.0)._replace(noise=1e-4)
    corner = exact_corner(shape)
    assert rounding(corner, around, CELL) == pytest.approx(0.0, abs=1e-9)
    inwards, is_near = np.zeros(len(around.points)), np.zeros(len(around.points), bool)
    for (a, b), way in edges_of(corner).items():
        ahead = around.points @ way
        beside = np.linalg.norm(around.points - np.maximum(ahead, 0.0)[:, None] * way, axis=1) < CELL
        aside = 0.003 * way + 1e-4 * (CUBE[a] - CUBE[b])  # under one plane, over the other
        is_ridge = height_over(aside[None] @ CUBE.T, shape)[0] > 0.0
        is_near |= beside
        inwards[beside & (ahead > 2.0 * CELL)] = -1.0 if is_ridge else 1.0
    assert len(set(inwards)) == (2 if shape[0] < 0 else 3)
    looks = CUBE[plane_under(around.points @ CUBE.T, shape)]
    moved = around._replace(points=around.points + 5e-5 * inwards[:, None] * looks)
    expected = 0.5 * np.count_nonzero(inwards) / np.sqrt(np.count_nonzero(is_near))
    assert rounding(corner, moved, CELL) == pytest.approx(expected, rel=0.08)


def test_a_point_beside_two_edges_speaks_for_the_nearer_one() -> None:
    """The surface is the third plane over what both others make: ridges and folds run into one point."""
    corner = exact_corner((2, 1))
    for (a, b), (c, d) in ((pair, other) for pair in ((0, 1), (0, 2), (1, 2)) for other in ((0, 1), (0, 2), (1, 2))):
        if {a, b} != {c, d}:
            one, other = edges_of(corner)[a, b], edges_of(corner)[c, d]
            between = 4e-4 * one + 2e-4 * other
            low = between - 1e-5 * (CUBE[a] + CUBE[b])
            over = height_over(low[None] @ CUBE.T, corner.shape)[0]
            ridge = height_over((one + 0.1 * (CUBE[a] - CUBE[b]))[None] @ CUBE.T, corner.shape)[0] > 0.0
            said = rounding(corner, Around(low[None], np.ones(1), 1.0), CELL)
            assert said == pytest.approx((-1.0 if ridge else 1.0) * over, abs=1e-12), (a, b, c, d)


def test_a_round_corner_is_told_from_a_sharp_one() -> None:
    said: dict[float, list[float]] = {1e-6: [], 0.002: []}
    for radius in said:
        for seed in range(20):
            points = round_corner_cloud(np.random.default_rng([seed, 10]), radius).points
            off2 = np.sum(points**2, axis=1) / RADIUS**2
            around = Around(points[off2 < 1.0], 1.0 - off2[off2 < 1.0], NOISE)
            said[radius].append(rounding(exact_corner((-1, 1)), around, CELL))
    assert abs(np.mean(said[1e-6])) < 1.2
    assert np.mean(said[0.002]) > 3.5
