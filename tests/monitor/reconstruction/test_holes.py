"""Holes closed on demand: whole, told from what was measured, and left open where closing would cut the mesh."""

import dataclasses

import numpy as np
import pytest
from even_sphere import even_directions

from monitor.comparison import compare
from monitor.reconstruction import SurfaceSettings, reconstruct_with_record
from monitor.reconstruction.holes import close_holes, free_loops
from monitor.reconstruction.intersections import find_intersections
from monitor.reconstruction.mesh import bow_ties, edge_table, face_areas_and_normals, untie
from monitor.reconstruction.spans import refine
from projects.formats import read_mesh, write_ply_mesh
from projects.model import Assessment, PointCloud, Registration

RADIUS = 0.06


def sphere_without_caps(rng, n=6000, noise=0.0003):
    """Return points of a sphere that lacks a wide cap below and a small one above."""
    normals = even_directions(n)
    seen = (normals[:, 2] > -0.8) & (normals[:, 2] < 0.98)
    return PointCloud((RADIUS + noise * rng.normal(size=n)[seen, None]) * normals[seen], normals=normals[seen])


def open_cylinder(n_around=500, n_up=4):
    """Return a tube with two circles as its free loops."""
    turn = 2 * np.pi * np.arange(n_around) / n_around
    rings = [np.c_[np.cos(turn), np.sin(turn), np.full(n_around, 0.01 * k)] for k in range(n_up)]
    i = np.arange(n_around)
    low = [np.c_[i, (i + 1) % n_around] + k * n_around for k in range(n_up - 1)]
    faces = [np.r_[np.c_[e, e[:, 1] + n_around], np.c_[e[:, 0], e[:, 1] + n_around, e[:, 0] + n_around]] for e in low]
    return np.concatenate(rings), np.concatenate(faces)


def is_closed(faces):
    half = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    return (edge_table(faces)[2] == 2).all() and len(np.unique(half, axis=0)) == len(half) and not bow_ties(faces).any()


def test_loops_go_round_each_hole_once_against_the_faces():
    _, faces = open_cylinder(12)
    loops = free_loops(faces)
    assert sorted(map(len, loops)) == [12, 12]
    half = {(int(a), int(b)) for f in faces for a, b in zip(f, np.roll(f, -1), strict=True)}
    for loop in loops:
        ahead = set(zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True))
        assert not ahead & half
        assert {(b, a) for a, b in ahead} <= half


def test_both_ends_of_a_tube_are_closed_flat_however_long_their_loops():
    vertices, faces = open_cylinder()
    closed = close_holes(vertices, faces, np.inf, 0.4)
    assert (closed.n_closed, closed.n_left_open) == (2, 0)
    assert is_closed(closed.faces)
    area, normals = face_areas_and_normals(closed.vertices, closed.faces[len(faces) :])
    assert area.sum() == pytest.approx(2 * 250 * np.sin(2 * np.pi / 500), rel=1e-6)  # two polygons of 500 corners
    assert np.abs(normals[area > 1e-9, 2]).min() > 0.999
    corner = closed.vertices[closed.faces]
    volume = np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0
    assert volume == pytest.approx(0.03 * 250 * np.sin(2 * np.pi / 500), rel=1e-6)


def smallest_angles(vertices, faces):
    """Return the smallest angle of each face, degrees."""
    corner, angles = vertices[faces], []
    for k in range(3):
        e, g = corner[:, (k + 1) % 3] - corner[:, k], corner[:, (k + 2) % 3] - corner[:, k]
        angles.append(np.arctan2(np.linalg.norm(np.cross(e, g), axis=1), np.einsum("ij,ij->i", e, g)))
    return np.degrees(np.min(angles, axis=0))


def inner_edges(vertices, faces):
    edges, _, n_faces = edge_table(faces)
    return np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)[n_faces == 2]


@pytest.mark.parametrize(("n_around", "longest"), [(200, 0.05), (60, 0.15), (500, 0.03)])
def test_span_is_as_dense_as_asked_and_of_wide_angles(n_around, longest):
    """Fans were halved as they were: 10 to 30 times as many faces, half of them with an angle below 2 degrees."""
    vertices, faces = open_cylinder(n_around)
    closed = close_holes(vertices, faces, np.inf, longest)
    assert is_closed(closed.faces)
    np.testing.assert_array_equal(closed.vertices[: len(vertices)], vertices)
    np.testing.assert_array_equal(closed.faces[: len(faces)], faces)
    new = closed.faces[len(faces) :]
    assert inner_edges(closed.vertices, new).max() <= longest
    n_even = 2.0 * np.pi / (np.sqrt(3.0) / 4.0 * longest**2)  # all edges the longest; of 3/4 of it 1.8 times as many
    assert n_even < len(new) < 3.0 * n_even
    angles = smallest_angles(closed.vertices, new)
    assert angles.min() > 8.0
    assert np.percentile(angles, 5) > 30.0


def test_cuts_do_not_pile_up_beside_an_edge_of_the_rim_that_is_longer_than_asked():
    """An edge of 1.6 times the longest of the span had 5000 vertices at its thirds, most of them on one another."""
    turn = np.linspace(0.0, 2.0 * np.pi - 0.4, 30)  # the last edge is twice as long as the others
    corners = np.c_[np.cos(turn), np.sin(turn), 0.05 * np.cos(3.0 * turn)]
    fan = np.c_[np.zeros(28, int), np.arange(1, 29), np.arange(2, 30)]
    rim = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    for longest in rim.max() / np.array([1.2, 1.6, 2.5]):
        places, faces = refine(corners, fan, np.eye(30, dtype=bool), longest)
        assert len(faces) < 3.0 * np.pi / (np.sqrt(3.0) / 4.0 * longest**2)
        assert inner_edges(places, faces).min() > longest / 4.0
        assert inner_edges(places, faces).max() < rim.max()


def test_span_of_a_saddle_is_the_least_surface_that_its_rim_leaves():
    """Of z = a r^2 cos 2 t, which is one to 4 a^2 of its slopes, between a circle of corners on it."""
    turn = 2.0 * np.pi * np.arange(120) / 120
    corners = np.c_[np.cos(turn), np.sin(turn), 0.1 * np.cos(2.0 * turn)]
    fan = np.c_[np.zeros(118, int), np.arange(1, 119), np.arange(2, 120)]
    places, faces = refine(corners, fan, np.eye(120, dtype=bool), 0.1)
    x, y, z = places.T
    assert np.abs(z - 0.1 * (x**2 - y**2)).max() < 0.003  # of 0.1; of the fan 0.09
    assert len(find_intersections(places, faces)) == 0


def test_hole_whose_closing_would_cut_the_mesh_stays_open_and_is_counted():
    vertices, faces = open_cylinder(24)
    spike = np.array([[0.0, 0.1, -0.485], [0.1, -0.1, -0.485], [0.0, 0.0, 0.515]])
    closed = close_holes(np.r_[vertices, spike], np.r_[faces, [[72 + 24, 73 + 24, 74 + 24]]], 3.0, 0.3)
    assert closed.n_left_open == 3  # both ends, and the spike's own edges, which only a second face on it would close
    assert len(closed.faces) == len(faces) + 1


def ragged_tube(rng, n=6000):
    """Return a noisy tube open at both ends, points without order: its rims are jagged."""
    turn, z = rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(-0.04, 0.04, n)
    normals = np.c_[np.cos(turn), np.sin(turn), np.zeros(n)]
    return PointCloud((0.03 + 0.0004 * rng.normal(size=n)[:, None]) * normals + z[:, None] * [0, 0, 1], normals=normals)


@pytest.mark.parametrize("seed", range(3))
def test_jagged_rims_of_a_tube_are_closed_at_the_cost_of_a_few_of_their_faces(seed):
    cloud = ragged_tube(np.random.default_rng(seed))
    open_ = reconstruct_with_record(cloud).surface
    result = reconstruct_with_record(cloud, SurfaceSettings(watertight=True))
    surface, n_new = result.surface, result.counts["faces_invented"]
    assert is_closed(surface.faces)
    assert len(find_intersections(surface.vertices, surface.faces)) == 0
    assert result.counts["holes_left_open"] == 0
    lost = result.counts["faces_given_up_at_holes"]
    assert lost == len(open_.faces) - (len(surface.faces) - n_new) < 0.02 * len(open_.faces)
    assert surface.face_invented.sum() == surface.face_invented[-n_new:].sum() == n_new
    angles = smallest_angles(surface.vertices, surface.faces[-n_new:])
    assert np.percentile(angles, 5) > 30.0  # 0.5 where fans were halved, or left as they were
    area = face_areas_and_normals(surface.vertices, surface.faces[-n_new:])[0].sum()
    assert 3.5 < n_new * (1.5 * result.automatic["cell_size_m"]) ** 2 / area < 6.0  # 4.1 of edges of 3/4 of it
    kept = {face.tobytes() for face in surface.vertices[surface.faces[:-n_new]]}
    assert kept <= {face.tobytes() for face in open_.vertices[open_.faces]}
    assert np.unique(surface.faces).tolist() == list(range(len(surface.vertices)))
    corner = surface.vertices[surface.faces]
    volume = np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0
    beyond = 2 * 2.5 * result.automatic["cell_size_m"]  # a surface ends so far from its samples at most
    assert 0.08 < volume / (np.pi * 0.03**2) < 0.08 + beyond


def pointed_hat(rng, n=12000):
    """Return the noisy side of a cone without its base, points without order."""
    from_tip, turn = np.sqrt(rng.uniform(0.0, 1.0, n)), rng.uniform(0.0, 2.0 * np.pi, n)
    normals = np.c_[2.0 * np.cos(turn), 2.0 * np.sin(turn), np.ones(n)] / np.sqrt(5.0)
    places = np.c_[0.05 * from_tip * np.cos(turn), 0.05 * from_tip * np.sin(turn), 0.1 * (1.0 - from_tip)]
    return PointCloud(places + 0.0003 * rng.normal(size=n)[:, None] * normals, normals=normals)


@pytest.mark.parametrize("seed", [2, 7])
def test_base_of_a_cone_is_closed_though_its_span_meets_the_jagged_rim(seed):
    """It stayed open: single faces broke off where the rim stepped back, and spans met themselves."""
    result = reconstruct_with_record(pointed_hat(np.random.default_rng(seed)), SurfaceSettings(watertight=True))
    surface, counts = result.surface, result.counts
    assert counts["holes_left_open"] == 0
    assert is_closed(surface.faces)
    assert len(find_intersections(surface.vertices, surface.faces)) == 0
    n_measured = len(surface.faces) - counts["faces_invented"]
    assert counts["faces_given_up_at_holes"] < 0.01 * n_measured
    corner = surface.vertices[surface.faces]
    volume = np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0
    beyond = (
        2.5 * result.automatic["cell_size_m"] / np.hypot(0.05, 0.1)
    )  # a surface ends so far from its samples at most
    assert 1.0 < volume / (np.pi * 0.05**2 * 0.1 / 3.0) < (1.0 + beyond) ** 3


def test_small_holes_are_closed_and_marked_and_wide_ones_stay(rng):
    cloud = sphere_without_caps(rng)
    cloud = dataclasses.replace(cloud, intensity=np.full(len(cloud), 0.5))
    open_ = reconstruct_with_record(cloud)
    assert open_.surface.face_invented is None
    result = reconstruct_with_record(cloud, SurfaceSettings(close_holes=0.04))
    surface = result.surface
    assert (result.counts["holes_closed"], result.counts["holes_left_open"]) == (1, 0)
    assert len(free_loops(surface.faces)) == len(free_loops(open_.surface.faces)) - 1
    n = len(open_.surface.faces)
    assert (surface.faces[:n] == open_.surface.faces).all()
    assert surface.face_invented.tolist() == [False] * n + [True] * result.counts["faces_invented"]
    new = np.arange(len(surface.vertices)) >= len(open_.surface.vertices)
    assert np.isnan(surface.sigma[new]).all()
    assert (surface.n_support[new] == 0).all()
    assert np.isnan(surface.intensity[new]).all()  # that of the nearest points, up to the hole's radius away
    np.testing.assert_allclose(surface.intensity[~new], 0.5)
    assert surface.vertices[new, 2].min() > 0.95 * RADIUS


def test_watertight_surface_is_closed_and_its_invented_parts_are_not_assessed(rng, tmp_path):
    cloud = sphere_without_caps(rng)
    result = reconstruct_with_record(cloud, SurfaceSettings(watertight=True))
    surface = result.surface
    assert is_closed(surface.faces)
    assert len(find_intersections(surface.vertices, surface.faces)) == 0
    assert result.counts["holes_closed"] == 2
    write_ply_mesh(tmp_path / "closed.ply", surface)
    assert b"property uchar invented" in (tmp_path / "closed.ply").read_bytes()[:2000]
    assert (read_mesh(tmp_path / "closed.ply").faces == surface.faces).all()
    stay = Registration(np.eye(4), np.zeros((6, 6)), np.zeros(3), converged=True)
    side = compare(surface, dataclasses.replace(surface), stay).on_compared
    rests = np.zeros(len(surface.vertices), bool)
    rests[surface.faces[~surface.face_invented]] = True
    assert (side.assessment[~rests] == Assessment.NOT_ASSESSABLE).all()
    assert (side.assessment[rests] == Assessment.UNCHANGED).mean() > 0.95


def bowl(bend, is_open, n=61, step=1.0):
    """Return a sheet z = -bend r^2 of a square grid, without the faces whose middle lies where `is_open` (r)."""
    axis = step * (np.arange(n) - n // 2)
    x, y = (values.ravel() for values in np.meshgrid(axis, axis))
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.r_[np.c_[corner, corner + 1, corner + n], np.c_[corner + 1, corner + n + 1, corner + n]]
    away = np.hypot(x, y)
    return np.c_[x, y, -bend * away**2], untie(faces[~is_open(away[faces].mean(axis=1))])


@pytest.mark.parametrize("bend", [0.001, 0.003])
def test_hole_with_a_piece_in_its_midst_is_not_closed_beneath_that_piece(bend):
    """Both were closed, a tenth to half of an edge under the piece and over it, at the cost of faces of the piece."""
    vertices, faces = bowl(bend, lambda r: (r > 6.0) & (r < 14.0))
    closed = close_holes(vertices, faces, 40.0, 1.5)
    assert (closed.n_closed, closed.n_left_open) == (0, 2)
    assert np.array_equal(closed.faces, faces)
    empty = close_holes(*bowl(bend, lambda r: r < 14.0), 40.0, 1.5)
    assert (empty.n_closed, empty.n_left_open) == (1, 0)


def test_sheet_that_is_hardly_bent_gets_no_back_of_its_own_and_a_shallow_bowl_a_floor():
    flat, shallow = (close_holes(*bowl(bend, lambda r: r > 16.0, 41), np.inf, 1.5) for bend in (0.0003, 0.008))
    assert (flat.n_closed, flat.n_left_open) == (0, 1)
    assert (shallow.n_closed, shallow.n_left_open) == (1, 0)
    assert is_closed(shallow.faces)
