"""What of a surface or cloud takes part in a registration, and meshes of every make against clouds."""

import numpy as np
import pytest
import trimesh
from bumpy_body import bumpy_points, noisy_cloud

from monitor.registration import register
from monitor.registration.motion.matching import MatchLimits, make_samples, match
from monitor.registration.motion.sampling import even_probability, leverage, sample_source
from monitor.registration.motion.sides import Side, on_free_edge, prepare_side
from projects.errors import ShapeError
from projects.model import PointCloud, Surface
from projects.transforms import apply, perturb
from projects.triangles import vertex_normals


def make_grid(n: int) -> Surface:
    """Return a flat square of n x n vertices, looking up."""
    x, y = np.meshgrid(np.arange(n), np.arange(n))
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(n * n)]).astype(float)
    corner = (y[:-1, :-1] * n + x[:-1, :-1]).ravel()
    faces = [[corner, corner + 1, corner + n], [corner + 1, corner + n + 1, corner + n]]
    return Surface(vertices, np.hstack(faces).T.reshape(-1, 3))


def make_sphere(radius: float) -> Surface:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    return Surface(np.array(ball.vertices), np.array(ball.faces))


def make_wedge() -> trimesh.Trimesh:
    """Return a box with unequal sides and a roof: sixteen large faces that hold every motion."""
    box = trimesh.creation.box((1.0, 0.6, 0.4))
    vertices = np.array(box.vertices)
    vertices[vertices[:, 2] > 0, 0] *= 0.5
    return trimesh.Trimesh(vertices, box.faces)


def test_free_edges_are_the_rim_of_an_open_mesh_and_nothing_of_a_closed_one() -> None:
    free = on_free_edge(make_grid(6)).reshape(6, 6)
    assert free[0].all()
    assert free[-1].all()
    assert free[:, 0].all()
    assert free[:, -1].all()
    assert not free[1:-1, 1:-1].any()
    assert not on_free_edge(make_sphere(1.0)).any()


def test_corners_of_faces_that_share_nothing_are_joined() -> None:
    whole = make_grid(6)
    apart = Surface(whole.vertices[whole.faces].reshape(-1, 3), np.arange(3 * len(whole.faces)).reshape(-1, 3))
    assert np.array_equal(on_free_edge(apart), on_free_edge(whole)[whole.faces.ravel()])


def test_vertex_normals_look_outwards_and_have_length_one() -> None:
    ball = make_sphere(2.0)
    assert vertex_normals(ball.vertices, ball.faces) == pytest.approx(
        ball.vertices / 2.0, abs=4e-3
    )  # the mesh is not quite round


def test_invented_faces_unknown_sigma_and_nan_take_no_part() -> None:
    grid = make_grid(8)
    invented = np.zeros(len(grid.faces), dtype=bool)
    middle = 3 * 8 + 3
    invented[np.flatnonzero((grid.faces == middle).any(axis=1))] = True
    sigma = np.full(64, 1e-4)
    sigma[5 * 8 + 5] = np.nan
    side = prepare_side(Surface(grid.vertices, grid.faces, sigma=sigma, face_invented=invented), np.zeros(3))
    used = set(side.index[side.index >= 0].tolist())
    assert middle not in used
    assert 5 * 8 + 5 not in used
    assert 6 * 8 + 5 in used
    points = np.array([[0.0, 0, 0], [np.nan, 0, 0], [1.0, 0, 0]])
    assert prepare_side(PointCloud(points), np.zeros(3)).index.tolist() == [0, 2]


def test_large_faces_are_covered_evenly() -> None:
    wedge = make_wedge()
    side = prepare_side(Surface(np.array(wedge.vertices), np.array(wedge.faces)), np.zeros(3))
    assert len(side) == pytest.approx(50_000, rel=0.01)
    # every face holds its share of the points: area of the bottom 0.6 of the whole, known from trimesh
    bottom = np.isclose(side.points[:, 2], -0.2)
    assert bottom.mean() == pytest.approx(0.6 / wedge.area, rel=0.01)
    assert side.normals_of(np.flatnonzero(bottom[9:]) + 9)[:, 2] == pytest.approx(-1.0)


@pytest.mark.parametrize("apart", [False, True])
def test_a_cloud_finds_its_place_on_a_model_of_few_faces(rng: np.random.Generator, apart: bool) -> None:
    wedge = make_wedge()
    points, which = trimesh.sample.sample_surface(wedge, 20_000, seed=3)
    points = np.asarray(points) + wedge.face_normals[which] * rng.normal(0, 2e-4, len(points))[:, None]
    vertices, faces = np.array(wedge.vertices), np.array(wedge.faces)
    if apart:
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    T = perturb(np.eye(4), np.zeros(3), np.array([0.02, -0.01, 0.015, 0.01, 0.01, -0.01]))
    registration = register(PointCloud(apply(T, points)), Surface(vertices, faces))
    assert registration.converged, registration.reason
    back = apply(registration.T_target_source @ T, points)
    assert np.linalg.norm(back - points, axis=1).max() < 60e-6


def test_residuals_of_concentric_spheres_are_the_difference_of_radii(rng: np.random.Generator) -> None:
    directions = rng.normal(size=(2_000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    side = prepare_side(PointCloud(1.001 * directions, directions), np.zeros(3))
    samples = make_samples(side, np.arange(len(side)))
    ball = make_sphere(1.0)
    target = prepare_side(Surface(ball.vertices, ball.faces, normals=ball.vertices), np.zeros(3))
    pairs = match(samples, target, np.eye(4), MatchLimits(0.1, 0.1, 1.0), True)
    assert len(pairs) == 2_000
    # the spacing is 0.03, the plane at the nearest vertex is up to 0.03^2 / 8 = 0.1 mm off, the symmetric one is not
    assert pairs.residuals == pytest.approx(0.001, rel=1e-3)


def test_points_beyond_the_free_edge_or_looking_away_find_no_partner() -> None:
    target = prepare_side(make_grid(8), np.zeros(3))
    points = np.array([[3.0, 3.0, 0.2], [3.0, 3.0, 0.2], [9.5, 3.0, 0.0]])
    normals = np.array([[0, 0, 1.0], [0, 0, -1.0], [0, 0, 1.0]])
    samples = make_samples(prepare_side(PointCloud(points, normals), np.zeros(3)), np.arange(3))
    pairs = match(samples, target, np.eye(4), MatchLimits(5.0, 0.0, 1.0), True)
    assert pairs.source.tolist() == [0]
    assert pairs.residuals == pytest.approx([0.2])


def test_samples_prefer_what_holds_the_weakest_motion(rng: np.random.Generator) -> None:
    n = 40_000
    points = np.column_stack([rng.uniform(-1, 1, (n, 2)), np.zeros(n)])
    normals = np.tile([0.0, 0.0, 1.0], (n, 1))
    fin = np.arange(400)  # one in a hundred stands upright and alone holds the slides
    normals[fin] = np.where((fin % 2 == 0)[:, None], [1.0, 0, 0], [0, 1.0, 0])
    picked = sample_source(prepare_side(PointCloud(points, normals), np.zeros(3)), 4_000, rng)
    assert len(np.unique(picked)) == 4_000
    assert np.isin(picked, fin).mean() > 0.04
    even = np.full(n, 1.0 / n)
    assert leverage(points, normals, even).mean() == pytest.approx(6.0, rel=0.01)  # the trace of a projection


def test_an_even_sample_does_not_follow_the_crowd(rng: np.random.Generator) -> None:
    cloud = noisy_cloud(60_000, rng)
    crowd = cloud.points[:, 0] > 0
    kept = np.flatnonzero(crowd | (rng.random(60_000) < 0.1))
    probability = even_probability(cloud.points[kept], 1_000)
    assert probability.sum() == pytest.approx(1.0)
    assert probability[crowd[kept]].sum() == pytest.approx(crowd.mean(), abs=0.05)  # of the points it is 0.91


def test_other_things_are_refused_by_name() -> None:
    with pytest.raises(ShapeError, match="a ndarray cannot be registered"):
        prepare_side(np.zeros((3, 3)), np.zeros(3))  # type: ignore[arg-type]


@pytest.mark.parametrize("offset", [0.0, 0.3, 0.7])
def test_a_sample_lies_where_all_points_lie_however_the_cells_cut_their_noise(
    rng: np.random.Generator, offset: float
) -> None:
    noise, n = 0.002, 100_000  # m; cells of the sample are 10 mm wide
    points = np.column_stack([rng.uniform(0, 1.0, (n, 2)), rng.normal(0, noise, n)])
    points[0] = [0.0, 0.0, -0.05 - 0.01 * offset]  # the corner that the cells start from
    side = Side(points, np.tile([0.0, 0.0, 1.0], (n, 1)), None, np.arange(n))
    chosen = sample_source(side, 40_000, rng)
    assert abs(points[chosen, 2].mean() - points[:, 2].mean()) < 4.0 * noise / np.sqrt(len(chosen))


def test_fitted_normals_of_samples_look_the_same_way_as_those_around(rng: np.random.Generator) -> None:
    points, normals = bumpy_points(8_000, rng)
    side = Side(points, None, None, np.arange(len(points)))
    samples = make_samples(side, np.arange(0, len(points), 2))
    assert abs(np.sum(np.sign(np.sum(samples.normals * normals[::2], axis=1)))) > 0.999 * len(samples.points)
