"""A surface of points whose truth is known: where it lies, where it ends, how sure it says it is."""

from dataclasses import replace

import numpy as np
import pytest
from even_sphere import even_directions
from scipy.spatial import cKDTree

from monitor.reconstruction import SurfaceSettings, reconstruct, reconstruct_with_record, surface_to_points
from monitor.reconstruction.distances import is_covered
from monitor.reconstruction.mesh import bow_ties, compact, edge_table, weld
from projects.errors import ParameterError, ReconstructionError
from projects.model import PointCloud, Surface

RADIUS = 0.06
FAR = np.array([431_000.0, 4_512_000.0, 210.0])


def fibonacci_sphere(n, radius, noise, rng):
    normals = even_directions(n)
    eps = noise * rng.normal(size=n)
    return PointCloud((radius + eps[:, None]) * normals, normals=normals), eps


def grid_plane(n, spacing, noise, rng):
    g = (np.arange(n) - 0.5 * (n - 1)) * spacing
    x, y = (a.ravel() for a in np.meshgrid(g, g))
    points = np.c_[x, y, noise * rng.normal(size=len(x))]
    return PointCloud(points, normals=np.tile([0.0, 0.0, 1.0], (len(x), 1)))


def test_noisy_sphere_is_one_closed_manifold_facing_outwards(rng):
    cloud, _ = fibonacci_sphere(7200, RADIUS, 0.001, rng)
    surface = reconstruct(cloud)
    edges, _, n_faces = edge_table(surface.faces)
    assert (n_faces == 2).all()
    assert len(surface.vertices) - len(edges) + len(surface.faces) == 2
    corner = surface.vertices[surface.faces]
    volume = np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * RADIUS**3, rel=0.01)


def test_noisy_sphere_has_no_bias_and_states_its_error(rng):
    cloud, eps = fibonacci_sphere(7200, RADIUS, 0.001, rng)
    surface = reconstruct(cloud)
    error = np.linalg.norm(surface.vertices, axis=1) - RADIUS
    # A tangent plane instead of a curved patch is off by more than 0.1 mm here; the mean of the noise itself is 0.012.
    assert abs(error.mean() - eps.mean()) < 0.02e-3
    assert error.std() < 0.35e-3
    assert np.std(error / surface.sigma) == pytest.approx(1.0, abs=0.25)


def test_perfect_plane_is_exact_and_ends_with_its_samples(rng):
    surface = reconstruct(grid_plane(60, 0.001, 0.0, rng))
    assert np.abs(surface.vertices[:, 2]).max() < 1e-6
    cell = 0.0015
    assert np.abs(surface.vertices[:, :2]).max() < 0.0295 + 2.6 * cell
    assert surface.sample_distance.max() < 2.6 * cell
    assert np.einsum("ij,j->i", surface.normals, [0, 0, 1]).min() > 0.999


@pytest.mark.parametrize("seed", range(3))
def test_no_vertex_ends_farther_from_the_samples_than_the_trim(seed):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0.0, 0.1, (2, 6000))
    points = np.c_[x, y, 0.01 * np.sin(80 * x) * np.cos(70 * y) + rng.normal(0.0, 1e-3, 6000)]
    points = points[np.hypot(x - 0.05, y - 0.05) > 0.015]
    result = reconstruct_with_record(PointCloud(points))
    distance, _ = cKDTree(points).query(result.surface.vertices)
    # before they were brought onto the points all were within; 11 to 14 of 3950 left them on their way, by up to 0.3
    assert 2.3 < distance.max() / result.automatic["cell_size_m"] < 2.5
    _, _, n_faces = edge_table(result.surface.faces)
    assert n_faces.max() == 2
    assert not bow_ties(result.surface.faces).any()


def test_hole_wider_than_the_trim_stays_open(rng):
    cloud = grid_plane(80, 0.001, 0.0002, rng)
    cloud = cloud.take(np.hypot(cloud.points[:, 0], cloud.points[:, 1]) > 0.012)
    surface = reconstruct(cloud)
    assert np.hypot(surface.vertices[:, 0], surface.vertices[:, 1]).min() > 0.012 - 2.6 * 0.0016


def test_same_surface_far_from_the_origin_and_in_every_run(rng):
    cloud, _ = fibonacci_sphere(4000, RADIUS, 0.0005, rng)
    near = reconstruct(cloud)
    again = reconstruct(cloud)
    far = reconstruct(PointCloud(cloud.points + FAR, normals=cloud.normals))
    assert (near.vertices == again.vertices).all()
    assert (near.faces == again.faces).all()
    error = np.linalg.norm(far.vertices - FAR, axis=1) - RADIUS
    assert abs(error.mean() - (np.linalg.norm(near.vertices, axis=1) - RADIUS).mean()) < 1e-5


def test_colour_intensity_and_roughness_come_from_the_nearest_samples(rng):
    cloud = grid_plane(60, 0.001, 0.0, rng)
    left = cloud.points[:, 0] < 0
    colors = np.where(left[:, None], [200, 10, 10], [10, 10, 200]).astype(np.uint8)
    cloud = PointCloud(cloud.points, cloud.normals, colors=colors, intensity=np.where(left, 0.25, 0.75),
                       roughness=np.where(left, 0, 2))  # fmt: skip
    surface = reconstruct(cloud)
    sure = surface.vertices[:, 0] < -0.004
    assert (surface.colors[sure] == [200, 10, 10]).all()
    assert np.allclose(surface.intensity[sure], 0.25)
    assert (surface.roughness[sure] == 0).all()


def test_record_names_cell_size_and_what_was_dropped(rng):
    result = reconstruct_with_record(grid_plane(60, 0.001, 0.0, rng))
    assert result.automatic["cell_size_m"] == pytest.approx(0.0015, rel=0.05)
    assert result.counts["faces"] == len(result.surface.faces)
    set_by_hand = reconstruct_with_record(grid_plane(60, 0.001, 0.0, rng), SurfaceSettings(cell_size=0.003))
    assert set_by_hand.automatic["cell_size_m"] == pytest.approx(0.003)


def test_relief_of_a_cloud_without_normals_does_not_pass_for_its_noise(rng):
    x, y = (a.ravel() + rng.uniform(-3e-4, 3e-4, 3600) for a in np.meshgrid(*2 * [0.001 * np.arange(60.0)]))
    k, noise = 2.0 * np.pi / 0.008, 0.0002
    slope = 0.001 * k * np.cos(k * x)
    normals = np.c_[-slope, np.zeros_like(x), np.ones_like(x)] / np.sqrt(1.0 + slope**2)[:, None]
    sheet = np.c_[x, y, 0.001 * np.sin(k * x)]
    bare = PointCloud(sheet + noise * rng.normal(size=(3600, 1)) * normals, origins=sheet + 2.0 * normals)
    result = reconstruct_with_record(bare)
    # The neighbours' spread about planes, of which the normals come, is 0.4 mm and more.
    assert result.automatic["noise_m"] == pytest.approx(noise, rel=0.25)
    inside = (np.abs(result.surface.vertices[:, :2] - 0.0295) < 0.022).all(axis=1)
    at, z = result.surface.vertices[inside, 0], result.surface.vertices[inside, 2]
    assert np.sum(z * np.sin(k * at)) / np.sum(np.sin(k * at) ** 2) > 0.00093


@pytest.mark.parametrize("looks", [1.0, -1.0])
def test_normals_known_of_a_part_only_are_estimated_of_the_rest_and_look_as_those_given(rng, looks):
    cloud, _ = fibonacci_sphere(7200, RADIUS, 0.0003, rng)
    lacks = cloud.points[:, 0] > 0.0
    given = np.where(lacks[:, None], np.nan, 3.0 * looks * cloud.normals)  # of any length
    result = reconstruct_with_record(PointCloud(cloud.points, normals=given))
    surface = result.surface
    assert result.counts["points_used"] == len(cloud)
    assert result.counts["normals_estimated"] == lacks.sum()
    assert (edge_table(surface.faces)[2] == 2).all()
    assert (looks * np.einsum("ij,ij->i", surface.normals, surface.vertices) > 0.0).all()
    assert np.linalg.norm(surface.normals, axis=1) == pytest.approx(1.0)


def test_points_whose_normal_cannot_be_told_are_counted_as_uncovered(rng, monkeypatch):
    cloud, _ = fibonacci_sphere(3000, RADIUS, 0.0003, rng)
    normals = np.where(cloud.points[:, :1] > 0.5 * RADIUS, 0.0, cloud.normals)
    points = np.r_[cloud.points, [[np.nan, 0.0, 0.0]]]
    monkeypatch.setattr(
        "monitor.reconstruction.usable.estimate_normals",
        lambda seen: replace(seen, normals=np.full_like(seen.points, np.nan)),
    )
    result = reconstruct_with_record(PointCloud(points, normals=np.r_[normals, [[0.0, 0.0, 1.0]]]))
    n_lacking = int((cloud.points[:, 0] > 0.5 * RADIUS).sum())
    assert result.counts["points_without_normal"] == n_lacking
    assert result.counts["points_not_finite"] == 1
    assert result.automatic["uncovered_share"] == pytest.approx(0.25, abs=0.01)  # a quarter of a sphere's area


def test_stated_noise_larger_than_the_scatter_raises_sigma(rng):
    cloud = grid_plane(60, 0.001, 0.0001, rng)
    calm = reconstruct(cloud, SurfaceSettings(cell_size=0.0015))
    stated = PointCloud(cloud.points, cloud.normals, sigma=np.full(len(cloud), 0.0002))
    assert np.median(reconstruct(stated, SurfaceSettings(cell_size=0.0015)).sigma / np.median(calm.sigma)) > 1.5


def test_too_few_points_are_refused(rng):
    with pytest.raises(ReconstructionError, match="needs at least 50"):
        reconstruct(grid_plane(5, 0.001, 0.0, rng))
    with pytest.raises(ParameterError, match=r"SurfaceSettings\.cell_size"):
        SurfaceSettings(cell_size=-1.0)


def test_settings_that_leave_no_surface_are_refused_with_what_to_do(rng):
    cloud = grid_plane(40, 0.001, 0.0, rng)
    with pytest.raises(ParameterError, match=r"cell_size = 0\.0002 m: .* at least 0\.00025\d+ m, usual 0\.0015\d+ m"):
        reconstruct(cloud, SurfaceSettings(cell_size=0.0002))
    with pytest.raises(
        ReconstructionError, match=r"crumb_cells = 1000 .* 1\.5\d+ m radius .* set crumb_cells below 1\d,"
    ):
        reconstruct(cloud, SurfaceSettings(crumb_cells=1000))
    ways = even_directions(4000)
    with pytest.raises(ReconstructionError, match=r"no surface came of cells of 10 m: .* or another cell_size"):
        reconstruct(PointCloud(0.05 * ways, normals=ways), SurfaceSettings(cell_size=10))
    with pytest.raises(ParameterError, match="narrowest_fit_cells = 20 exceeds widest_fit_cells = 12"):
        SurfaceSettings(narrowest_fit_cells=20, widest_fit_cells=12)


def test_points_all_at_one_place_are_refused_in_words():
    cloud = PointCloud(np.zeros((300, 3)), normals=np.tile([0.0, 0.0, 1.0], (300, 1)))
    with pytest.raises(ReconstructionError, match="share their place"):
        reconstruct(cloud)


def square(z=0.0):
    vertices = np.array([[0, 0, z], [1, 0, z], [1, 1, z], [0, 1, z]], float)
    return Surface(vertices, np.array([[0, 1, 2], [0, 2, 3]]))


def test_point_above_the_surface_has_positive_distance_and_beside_it_none():
    points = np.array([[0.3, 0.2, 0.05], [0.5, 0.5, -0.02], [1.2, 0.5, 0.0], [1.0, 1.0, 0.1], [0.25, 0.75, 0.0]])
    distance = surface_to_points(square(), points)
    assert distance[:2] == pytest.approx([0.05, -0.02], abs=1e-12)
    assert np.isnan(distance[2:4]).all()
    assert distance[4] == 0.0


def test_point_that_looks_another_way_is_not_over_the_surface():
    points = np.array([[0.3, 0.2, 0.05], [0.3, 0.2, 0.05]])
    distance = surface_to_points(square(), points, normals=np.array([[0, 0, 1.0], [0, 0, -1.0]]))
    assert distance[0] == pytest.approx(0.05)
    assert np.isnan(distance[1])


def test_point_over_an_invented_face_or_the_edge_of_its_hole_is_not_over_the_surface():
    points = np.array([[0.3, 0.2, 0.05], [0.2, 0.6, -0.02], [0.4, 0.4, 0.1]])
    closed = Surface(square().vertices, square().faces, face_invented=[False, True])
    distance = surface_to_points(closed, points)
    assert distance[0] == pytest.approx(0.05)
    assert np.isnan(distance[1:]).all()
    open_ = Surface(square().vertices, square().faces[:1])
    np.testing.assert_array_equal(surface_to_points(open_, points), distance)


def test_places_are_covered_by_measured_faces_near_them_that_do_not_look_away():
    over, beside, far = [0.3, 0.2, 0.05], [1.2, 0.5, 0.0], [0.3, 0.2, 0.3]
    ways = np.array([[0, 0, 1.0], [0, 0, 1.0], [0, 0, 1.0], [1.0, 0, 0], [0, 0, -1.0]])
    places = np.array([over, beside, far, over, over])
    assert is_covered(square(), places, ways, 0.2).tolist() == [True, False, False, True, False]
    closed = Surface(square().vertices, square().faces, face_invented=[True, False])
    assert not is_covered(closed, places, ways, 0.2).any()


def test_distances_keep_their_precision_far_from_the_origin():
    surface = Surface(square().vertices + FAR, square().faces)
    assert surface_to_points(surface, np.array([[0.3, 0.2, 0.00012]]) + FAR)[0] == pytest.approx(0.00012, abs=2e-9)


def test_bow_tie_keeps_its_larger_fan():
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 4, 5]])
    assert bow_ties(faces).tolist() == [False, False, True]
    used, kept = compact(6, faces[~bow_ties(faces)])
    assert used.tolist() == [0, 1, 2, 3]
    assert kept.max() == 3


def test_edge_with_three_faces_is_opened():
    faces = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    assert bow_ties(faces).all()


def test_short_edge_is_welded_without_leaving_a_hole():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1 + 1e-9, 0], [0, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4]])
    assert weld(vertices, faces, 1e-6).tolist() == [[0, 1, 2], [0, 2, 4]]


def test_points_that_are_there_twice_count_once(rng: np.random.Generator) -> None:
    """Half of a sphere's points twice made its fits a tenth as wide, its errors ten times as large, and 400 holes."""
    points = rng.normal(size=(8000, 3))
    points *= (0.06 + rng.normal(0.0, 3e-4, (8000, 1))) / np.linalg.norm(points, axis=1, keepdims=True)
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    once, twice = (
        reconstruct_with_record(PointCloud(points[which], normals=normals[which]))
        for which in (np.arange(8000), np.r_[np.arange(8000), np.arange(4000)])
    )
    np.testing.assert_array_equal(once.surface.vertices, twice.surface.vertices)
    assert twice.counts["points_copied"] == 4000


@pytest.mark.parametrize("stated", [1e-3, 1e-4])
def test_points_in_one_plane_are_as_sure_as_they_state(stated: float) -> None:
    """They scatter by nothing, and what they state over that once made a sigma of 153 m."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(80) * 1e-3, np.arange(80) * 1e-3))
    plane = PointCloud(
        np.c_[x, y, 0.0 * x], normals=np.tile([0.0, 0.0, 1.0], (len(x), 1)), sigma=np.full(len(x), stated)
    )
    sigma = reconstruct(plane).sigma
    assert 0.05 * stated < np.nanmedian(sigma) < 0.8 * stated
    assert np.nanmax(sigma) < 2.0 * stated
