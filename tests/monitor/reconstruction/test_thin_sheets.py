"""Two sheets near each other: both are there, or what is between them is left open and said to be; never a bridge."""

import numpy as np
import pytest
from free_borders import boundary_vertices
from pipe_on_a_wall import pipe_before_wall
from samples_of_clouds import measure_sampling

from monitor.reconstruction import SurfaceSettings, reconstruct_with_record
from monitor.reconstruction import surface as surface_module
from monitor.reconstruction.coverage import find_uncovered, largest_piece
from monitor.reconstruction.intersections import find_intersections
from monitor.reconstruction.mesh import face_areas_and_normals
from projects.model import PointCloud, Surface

SPACING, NOISE, EXTENT = 0.001, 0.0003, 0.030


def two_sheets(thickness, rng, looks=1.0):
    """Return points of a plate (looks 1) or of the walls of a crack (-1) in any orientation, and that orientation."""
    g = np.arange(-0.5 * EXTENT, 0.5 * EXTENT + 1e-9, SPACING)
    x, y = (a.ravel() for a in np.meshgrid(g, g))
    points, normals = [], []
    for side in (1.0, -1.0):
        shake = SPACING * rng.uniform(-0.3, 0.3, size=(2, len(x)))
        points.append(np.c_[x + shake[0], y + shake[1], 0.5 * side * thickness + NOISE * rng.normal(size=len(x))])
        normals.append(np.tile([0.0, 0.0, side * looks], (len(x), 1)))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return PointCloud(np.concatenate(points) @ turn.T, normals=np.concatenate(normals) @ turn.T), turn


def upright(surface, turn):
    """Return the surface's vertices before the turn, which faces lie well inside, and which join both sides."""
    vertices = surface.vertices @ turn
    inside = (np.abs(vertices[:, :2]).max(axis=1) < 0.5 * EXTENT - 2 * SPACING)[surface.faces].any(axis=1)
    above = vertices[:, 2][surface.faces] > 0.0
    return vertices, inside, above.any(axis=1) & ~above.all(axis=1)


@pytest.mark.parametrize("looks", [1.0, -1.0], ids=["plate", "crack"])
@pytest.mark.parametrize("thickness", [0.012, 0.006, 0.004, 0.003, 0.002])
def test_plate_or_crack_wider_than_a_cell_and_a_third_is_two_whole_sheets(rng, thickness, looks):
    cloud, turn = two_sheets(thickness, rng, looks)
    result = reconstruct_with_record(cloud, SurfaceSettings(cell_size=0.0015))
    vertices, inside, joins = upright(result.surface, turn)
    assert not joins.any()
    area, normals = face_areas_and_normals(vertices, result.surface.faces)
    edge = EXTENT - 4 * SPACING
    assert 2 * edge**2 < area[inside].sum() < 2 * (edge + 2 * 0.0015) ** 2  # faces reach out by a cell at most
    assert ((normals[inside, 2] * vertices[result.surface.faces[inside, 0], 2] > 0.0) == (looks > 0)).all()
    sure = np.abs(vertices[:, :2]).max(axis=1) < 0.5 * EXTENT - 3 * SPACING
    assert np.abs(np.abs(vertices[sure, 2]) - 0.5 * thickness).mean() < 0.05e-3
    assert result.counts["points_without_surface"] < 0.001 * len(cloud)


@pytest.mark.parametrize("looks", [1.0, -1.0], ids=["plate", "crack"])
def test_sheets_nearer_than_a_cell_are_left_open_and_counted(rng, looks):
    cloud, turn = two_sheets(0.0008, rng, looks)
    result = reconstruct_with_record(cloud, SurfaceSettings(cell_size=0.0015, crumb_cells=1.0))
    _, inside, joins = upright(result.surface, turn)
    assert not (joins & inside).any()
    assert len(find_intersections(result.surface.vertices, result.surface.faces)) == 0
    assert result.counts["faces_between_near_sheets"] > 10
    assert result.counts["points_at_unresolved_sheets"] > 0.02 * len(cloud)
    assert result.automatic["uncovered_share"] > 0.02
    assert result.surface.is_unresolved.any()
    on_boundary = boundary_vertices(result.surface.faces, len(result.surface.vertices))
    assert on_boundary[result.surface.is_unresolved].all()


def test_spacing_of_a_thin_plate_is_that_of_each_side(rng):
    thin, _ = two_sheets(0.002, rng)
    thick, _ = two_sheets(0.020, rng)
    assert measure_sampling(thin).spacing == pytest.approx(measure_sampling(thick).spacing, rel=0.03)


def test_point_without_surface_is_counted_by_what_is_near_it():
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    up = np.tile([0.0, 0, 1], (4, 1))
    surface = Surface(square, np.array([[0, 1, 2], [0, 2, 3]]), normals=up)
    over, back, far = [0.1, 0, 0.2], [0.1, 0, -0.2], [3.0, 0, 0]
    cloud = PointCloud([*square, over, back, far], normals=[*up, [0, 0, 1.0], [0, 0, -1.0], [0, 0, 1.0]])
    found = find_uncovered(surface, cloud, 0.5)
    assert found.counts == {"points_without_surface": 2, "points_at_unresolved_sheets": 1}
    beside = Surface(square, surface.faces, normals=up, is_unresolved=[True, False, False, False])
    assert find_uncovered(beside, cloud, 0.5).counts["points_at_unresolved_sheets"] == 3  # two more at that vertex


def test_the_largest_piece_without_a_surface_is_found_with_its_size_and_place(rng):
    strip = (
        np.c_[rng.uniform(0.0, 4.0, 900), rng.uniform(0.0, 0.1, 900), np.zeros(900)]
        @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    )
    patch = rng.uniform(0.0, 0.2, (100, 3)) * (1.0, 1.0, 0.0)
    middle = np.array([100.0, 200.0, 5.0])
    found = largest_piece(np.concatenate([strip - strip.mean(axis=0) + middle, patch]), 0.02)
    assert found["bare_piece_points"] == 900
    np.testing.assert_allclose(found["bare_piece_size_m"], (4.0, 0.1), rtol=0.02)
    np.testing.assert_allclose(found["bare_piece_place_m"], middle, atol=1e-9)
    assert largest_piece(np.empty((0, 3)), 0.02) == {}
    assert largest_piece(np.ones((1, 3)), 0.02)["bare_piece_size_m"] == [0.0, 0.0]


def test_a_thing_that_is_lost_as_a_whole_is_recorded_where_it_stands(rng, monkeypatch):
    """The pipe before a wall, lost again where one length of the field serves all."""
    monkeypatch.setattr(surface_module, "screening_by_turn", lambda *_: np.inf)
    far = np.array([1000.0, -500.0, 20.0])
    points, normals, on_pipe = pipe_before_wall(rng)
    found = reconstruct_with_record(PointCloud(points + far, normals=normals)).automatic
    assert found["bare_piece_points"] > 0.95 * on_pipe.sum()
    np.testing.assert_allclose(found["bare_piece_size_m"], (0.4, 0.1), atol=0.02)
    np.testing.assert_allclose(found["bare_piece_place_m"], far + points[on_pipe].mean(axis=0), atol=0.01)


def test_point_by_an_invented_vertex_is_without_surface():
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    up = np.tile([0.0, 0, 1], (4, 1))
    surface = Surface(square, np.array([[0, 1, 2], [0, 2, 3]]), normals=up, face_invented=[False, True])
    assert find_uncovered(surface, PointCloud(square, normals=up), 0.5).counts["points_without_surface"] == 1


def test_share_without_surface_is_of_the_area_and_not_of_the_points(rng):
    """Points ten times as wide apart at one pole as at the other, where cells are too small for them."""
    ways = rng.normal(size=(100_000, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    ways = ways[rng.uniform(size=len(ways)) < 100.0 ** (-(ways[:, 2] + 1) / 2)]
    points = (0.15 + 0.0003 * rng.normal(size=len(ways))[:, None]) * ways
    result = reconstruct_with_record(PointCloud(points, normals=ways))
    area = face_areas_and_normals(result.surface.vertices, result.surface.faces)[0].sum()
    missing = 1.0 - area / (4.0 * np.pi * 0.15**2)
    assert missing > 0.05
    assert result.automatic["uncovered_share"] == pytest.approx(missing, rel=0.2)
    assert result.counts["points_without_surface"] / len(points) < 0.1 * missing
