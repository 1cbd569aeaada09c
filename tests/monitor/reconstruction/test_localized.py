"""The localized Poisson surface: one mesh whatever the tiles, no bias, no skin where nothing was measured."""

import numpy as np
import pytest
from even_sphere import even_directions
from pipe_on_a_wall import pipe_before_wall
from samples_of_clouds import measure_sampling
from scipy.spatial import cKDTree

from monitor.reconstruction import reconstruct
from monitor.reconstruction.band import IN_BAND, OCCUPIED, cut_tiles, mark_cells
from monitor.reconstruction.contour import EDGE_AXIS, EDGE_CORNER, contour_tile, triangle_table
from monitor.reconstruction.localized import localized_mesh
from monitor.reconstruction.mesh import bow_ties, edge_table, face_areas_and_normals
from monitor.reconstruction.poisson import screening_length
from projects.model import PointCloud

RADIUS = 0.06


def noisy_sphere(rng, n=7200, noise=0.001):
    normals = even_directions(n)
    eps = noise * rng.normal(size=n)
    return (RADIUS + eps[:, None]) * normals, normals, eps


def plane(rng, n=60, spacing=0.001, noise=0.0, z=0.0, up=1.0):
    g = (np.arange(n) - 0.5 * (n - 1)) * spacing
    x, y = (a.ravel() for a in np.meshgrid(g, g))
    return np.c_[x, y, z + noise * rng.normal(size=len(x))], np.tile([0.0, 0.0, up], (len(x), 1))


def topology(vertices, faces):
    edges, _, n_faces = edge_table(faces)
    return {"euler": len(vertices) - len(edges) + len(faces), "boundary": int((n_faces == 1).sum()),
            "crowded": int((n_faces > 2).sum()), "bow_ties": int(bow_ties(faces).sum())}  # fmt: skip


def test_every_sign_pattern_of_a_cell_has_its_loops_closed_on_the_faces():
    table = triangle_table()
    for code in range(256):
        used = sorted(set(table[code][table[code] >= 0].tolist()))
        low = [code >> q & 1 for q in EDGE_CORNER]
        high = [code >> (q | 1 << a) & 1 for q, a in zip(EDGE_CORNER, EDGE_AXIS, strict=True)]
        assert used == [e for e in range(12) if low[e] != high[e]]


def test_contour_of_random_signs_is_a_closed_manifold_facing_the_positive_side(rng):
    shape = (9, 9, 9)
    values = rng.normal(size=shape).astype(np.float32)
    values[[0, -1]], values[:, [0, -1]], values[:, :, [0, -1]] = 1.0, 1.0, 1.0
    index = np.arange(values.size, dtype=np.int32).reshape(shape)
    nodes = np.stack(np.unravel_index(np.arange(values.size), shape), axis=1).astype(np.int32)
    vertices, _, faces = contour_tile(values.ravel(), index, nodes, np.ones(len(nodes), np.bool_))
    n_faces = edge_table(faces)[2]
    assert (n_faces == 2).all()
    half = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    assert len(np.unique(half, axis=0)) == len(half)  # each edge once each way: consistently oriented
    corner = vertices[faces]
    volume = np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0
    assert 0.0 < volume < values.size  # around the negative nodes, normals away from them


def test_band_is_a_ball_around_each_occupied_cell():
    marks = mark_cells(np.array([[10.5, 10.5, 10.5]]), (21, 21, 21), 3.0)
    assert (marks & OCCUPIED > 0).sum() == 1
    offset = np.argwhere(marks & IN_BAND) - 10
    assert (np.linalg.norm(offset, axis=1) <= 3.0).all()
    assert len(offset) == 123


def test_tiles_hold_each_point_once_and_know_their_neighbours_points(rng):
    points = rng.uniform(0, 90, size=(500, 3)) * [1.0, 0.9, 0.2] + [0.0, 3.0, 12.0]
    tiles = cut_tiles(points, 32, 5)
    assert sorted(tiles.order.tolist()) == list(range(500))
    steps = np.array(list(np.ndindex(3, 3, 3))) * 5.0 - 5.0
    near = np.unique(np.floor((points[:, None] + steps) / 32).reshape(-1, 3), axis=0)
    assert tiles.corners.tolist() == (32 * near).tolist()
    for j in range(len(tiles.corners)):
        low, high = tiles.corners[j] - 5, tiles.corners[j] + 37
        want = ((points >= low) & (points < high)).all(axis=1)
        assert sorted(tiles.order[tiles.points_within(j, 5)].tolist()) == np.flatnonzero(want).tolist()


def test_sheet_smaller_than_a_tile_is_not_cut_wherever_it_lies(rng):
    points = np.column_stack([rng.uniform(0, 0.05, 4000), rng.uniform(0, 0.05, 4000), np.zeros(4000)])
    numbers = []

    def count(function, tiles):
        numbers.append(len(tiles))
        return [function(j) for j in tiles]

    for shift in rng.uniform(-1.0, 1.0, size=(4, 3)):
        localized_mesh(points + shift, np.tile([0.0, 0.0, 1.0], (4000, 1)), 0.001, 0.001, tile=62, map_tiles=count)
    assert set(numbers) == {1}


def test_sphere_stitched_from_tiles_is_closed_and_agrees_with_one_tile_to_a_micrometre(rng):
    points, normals, _ = noisy_sphere(rng)
    whole = localized_mesh(points, normals, 0.0025, 0.0025)
    tiled = localized_mesh(points, normals, 0.0025, 0.0025, tile=28)
    assert topology(*tiled) == {"euler": 2, "boundary": 0, "crowded": 0, "bow_ties": 0}
    assert len(tiled[0]) == len(whole[0])
    assert cKDTree(whole[0]).query(tiled[0])[0].max() < 1e-6


def test_mesh_has_the_same_bits_for_any_order_of_tiles(rng):
    points, normals, _ = noisy_sphere(rng, n=3000)

    def backwards(function, numbers):
        return [function(j) for j in reversed(numbers)][::-1]

    one = localized_mesh(points, normals, 0.004, 0.004, tile=25)
    other = localized_mesh(points, normals, 0.004, 0.004, tile=25, map_tiles=backwards)
    assert (one[0] == other[0]).all()
    assert (one[1] == other[1]).all()


def test_field_has_less_bias_than_the_papers_even_before_the_vertices_are_projected(rng):
    points, normals = plane(rng, noise=0.001)
    vertices, _ = localized_mesh(points, normals, 0.0015, 0.001)
    inside = np.abs(vertices[:, :2]).max(axis=1) < 0.0265
    # 0.082 mm and 0.090 mm are the paper's localized bias and standard deviation for this cloud
    assert abs(vertices[inside, 2].mean() - points[:, 2].mean()) < 0.01e-3
    assert vertices[inside, 2].std() < 0.09e-3


def test_points_hold_the_field_as_far_as_their_noise_and_the_turn_of_normals_say():
    # sqrt(7) cells, times p = 0.15 / 1.5 of a cell, over g = 0.2 / sqrt(2) rad
    assert screening_length(1.0, 1.0 / 1.5, 0.15, 0.2) == pytest.approx(np.sqrt(7.0) * 0.1 / 0.2 * np.sqrt(2.0))
    assert screening_length(1.0, 1.0 / 1.5, 0.15, 1e-3) == 4.0  # a plane
    assert screening_length(1.0, 1.0 / 1.5, 0.01, 0.5) == 1.0  # rough stone, nearly no noise


@pytest.mark.parametrize(("noise", "least", "most"), [(5e-5, 1.0, 1.0), (1e-3, 3.0, 4.0)])
def test_relief_finer_than_the_mean_of_normals_is_held_by_points_that_are_sure(rng, noise, least, most):
    points, normals = wavy(rng, noise)
    sampling = measure_sampling(PointCloud(points, normals=normals))
    length = screening_length(0.0015, *sampling)
    assert least <= length <= most
    vertices, _ = localized_mesh(points, normals, 0.0015, 0.001, length)
    inside = np.abs(vertices[:, :2]).max(axis=1) < 0.024
    off = (vertices[inside, 2] - wave(vertices[inside, 0], vertices[inside, 1])) / 0.0015
    assert np.sqrt(np.mean(off**2)) < (0.22 if noise < 1e-4 else 0.42)  # 0.36 with points that hold over 4 cells


def wave(x, y):
    return 0.0015 * np.sin(x * 2.0 * np.pi / 0.009) * np.sin(y * 2.0 * np.pi / 0.009)


def wavy(rng, noise):
    """Points 1 mm apart on waves of 9 mm and 1.5 mm, six cells and one, and their true normals."""
    points, _ = plane(rng)
    x, y = points[:, 0], points[:, 1]
    step = 1e-7
    normals = np.c_[wave(x - step, y) - wave(x + step, y), wave(x, y - step) - wave(x, y + step), 0.0 * x + 2.0 * step]
    points[:, 2] = wave(x, y) + noise * rng.normal(size=len(x))
    return points, normals / np.linalg.norm(normals, axis=1)[:, None]


def test_faces_look_where_the_normals_point(rng):
    points, normals = plane(rng, n=30, noise=0.0002, up=-1.0)
    vertices, faces = localized_mesh(points, normals, 0.0015, 0.001)
    assert (face_areas_and_normals(vertices, faces)[1][:, 2] < 0.0).all()


@pytest.mark.parametrize("thickness", [0.012, 0.006])
def test_thin_plate_is_two_sheets(rng, thickness):
    top, up = plane(rng, noise=0.0003, z=0.5 * thickness)
    bottom, down = plane(rng, noise=0.0003, z=-0.5 * thickness, up=-1.0)
    vertices, faces = localized_mesh(np.r_[top, bottom], np.r_[up, down], 0.0015, 0.001)
    inside = np.abs(vertices[:, :2]).max(axis=1) < 0.0265
    above = vertices[:, 2] > 0.0
    assert np.abs(np.abs(vertices[inside, 2]) - 0.5 * thickness).max() < 0.0006
    crossing = above[faces].any(axis=1) & ~above[faces].all(axis=1)
    assert not (crossing & inside[faces].all(axis=1)).any()


def test_a_pipe_before_a_wall_keeps_its_surface(rng):
    points, normals, on_pipe = pipe_before_wall(rng)
    surface = reconstruct(PointCloud(points, normals=normals))
    axis = np.hypot(surface.vertices[:, 0], surface.vertices[:, 2] - 0.08)
    near = (axis < 0.07) & (surface.vertices[:, 2] > 0.04)
    assert np.median(np.abs(axis[near] - 0.05)) < 0.0015  # the noise of a point
    bare = cKDTree(surface.vertices).query(points[on_pipe])[0] > 0.02
    assert bare.mean() < 0.02  # 1.0 where the wall says for both over how many cells the points hold the field
