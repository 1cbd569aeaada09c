"""Stretched fits: along what is alike in one direction, narrower across; nowhere else, and honest about their error."""

import numpy as np
import pytest
from samples_of_clouds import samples_at

from monitor.reconstruction import SurfaceSettings, reconstruct_with_record
from monitor.reconstruction.furrows import choose_fits, common_direction, narrow_by
from monitor.reconstruction.gathering import frame_along, tangent_frame
from monitor.reconstruction.moments import level_of_points
from monitor.reconstruction.projection import Furrows, Reach, project_vertices, sum_up_samples
from monitor.reconstruction.quadric import fit_patch, fit_room
from monitor.reconstruction.reach import Climbed, Probes, make_ladder
from projects.model import PointCloud

NOISE = 0.0004


def sheet(rng, height, slopes):
    """Points 1 mm apart with noise along the normals on z = height(x, y), and raw vertices off it; inner ones."""
    g = 0.001 * (np.arange(70) - 34.5)
    x, y = (a.ravel() + rng.uniform(-3e-4, 3e-4, 4900) for a in np.meshgrid(g, g))
    u, v = slopes(x, y)
    normals = np.column_stack([-u, -v, np.ones(4900)]) / np.sqrt(1.0 + u * u + v * v)[:, None]
    points = np.column_stack([x, y, height(x, y)]) + NOISE * rng.normal(size=(4900, 1)) * normals
    return points, normals


def fits_of(points, normals):
    ladder = make_ladder(0.0015, NOISE, 1.5, 16.0, 0.03)
    samples = sum_up_samples(level_of_points(points, normals, 0.01), ladder.radii, NOISE)
    return choose_fits(points, normals, samples, ladder), samples


def waves(turn, wavelength=0.012):
    k, c, s = 2.0 * np.pi / wavelength, np.cos(turn), np.sin(turn)

    def height(x, y):
        return 0.001 * np.sin(k * (c * x + s * y))

    def slopes(x, y):
        steep = 0.001 * k * np.cos(k * (c * x + s * y))
        return c * steep, s * steep

    return height, slopes


@pytest.mark.parametrize("degree", [1, 2])
def test_a_stretched_fit_is_the_weighted_least_squares_of_its_ellipse(rng, degree):
    u, v = rng.uniform(-3.0, 3.0, 900), rng.uniform(-1.0, 1.0, 900)
    u, v = (a[u * u / 9.0 + v * v < 1.0] for a in (u, v))
    out, influence = np.empty(7), np.empty(len(u))
    patch = np.vstack([u, v, 0.2 + 0.1 * v, np.ones(len(u)), np.zeros((6, len(u)))])
    assert fit_patch(patch, len(u), 1.0, 1.0, 3.0, degree, fit_room(len(u)), out, influence)
    w = 1.0 - u * u / 9.0 - v * v
    design = np.column_stack([np.ones_like(u), u, v, u * u, u * v, v * v][: 3 if degree == 1 else 6])
    row = np.linalg.solve(design.T @ (w[:, None] * design), (w[:, None] * design).T)[0]
    assert influence == pytest.approx(row, rel=1e-6, abs=1e-9)
    assert out[:3] == pytest.approx([0.2, 0.0, 0.1], abs=1e-9)


def test_a_frame_lies_along_what_is_given_and_anywhere_where_nothing_is(rng):
    normal, along = np.array([0.0, 0.6, 0.8]), np.array([3.0, 1.0, -2.0])
    t, b = (np.array(a) for a in frame_along(normal, along))
    flat = along - (along @ normal) * normal
    assert t == pytest.approx(flat / np.linalg.norm(flat), abs=1e-12)
    assert b == pytest.approx(np.cross(normal, t), abs=1e-12)
    assert frame_along(normal, np.zeros(3)) == tangent_frame(normal)
    assert frame_along(normal, 5.0 * normal) == tangent_frame(normal)


def test_the_direction_in_common_is_that_in_which_both_sides_of_a_fold_bend_least():
    normals = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
    bends2 = np.array([[4.0, 0.0, 0.0, 0.1, 0.0, 0.0], [0.0, 0.0, 0.0, 0.1, 0.0, 9.0]])  # across x, then across z
    probes = Probes(np.zeros((2, 3)), normals, np.array([[0, 1], [1, 0]]), 1.0, np.full(2, np.nan))
    along, share = common_direction(bends2, probes)
    assert np.abs(along) == pytest.approx(np.array([[0.0, 1.0, 0.0]] * 2), abs=1e-9)
    assert share == pytest.approx([0.1 / 2.0, 0.1 / 4.5])


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_fits_on_waves_lie_along_them_and_halve_their_error(rng, turn):
    height, slopes = waves(turn)
    points, normals = sheet(rng, height, slopes)
    reach, samples = fits_of(points, normals)
    furrows = reach.furrows
    assert len(furrows.which) > 0.4 * len(points)
    assert np.median(np.abs(furrows.alongs[furrows.which] @ [-np.sin(turn), np.cos(turn), 0.0])) > 0.995
    stretched, discs = (
        project_vertices(points, normals, samples, r, 0.003) for r in (reach, reach._replace(furrows=None))
    )
    inner = furrows.which[(np.abs(points[furrows.which, :2]) < 0.028).all(axis=1)]

    def error(projection):
        x, y, z = projection.vertices[inner].T
        return (z - height(x, y)) * projection.normals[inner, 2]

    assert np.std(error(stretched)) < 0.75 * np.std(error(discs))
    assert np.std(error(stretched) / stretched.sigma[inner]) == pytest.approx(1.0, abs=0.15)


def test_what_bends_alike_both_ways_keeps_its_discs(rng):
    k = 2.0 * np.pi / 0.016
    points, normals = sheet(
        rng,
        lambda x, y: 0.001 * np.sin(k * x) * np.sin(k * y),
        lambda x, y: (0.001 * k * np.cos(k * x) * np.sin(k * y), 0.001 * k * np.sin(k * x) * np.cos(k * y)),
    )
    furrows = fits_of(points, normals)[0].furrows
    assert furrows is None or len(furrows.which) < 0.02 * len(points)


def test_fits_grow_narrower_until_their_bias_is_a_fifth_of_their_noise_or_their_noise_over_half():
    n = 4
    misfit2 = np.array([0.0, 0.03, 2.0, 0.2])  # shrinks by 1.4^-8 = 1 / 14.8 a step
    error2 = np.array([0.25, 0.25, 0.25, 0.45])  # grows by 1.4 a step, up to 0.55
    reach = Reach(np.full(n, 3), np.full(n, 3), *np.zeros((2, n), bool), *np.zeros((5, n)))
    climbed = Climbed(reach, np.ones(n, bool), np.ones(n), misfit2, np.ones(n))
    assert narrow_by(climbed, error2, np.full(n, 9)).tolist() == [0, 1, 2, 0]
    assert narrow_by(climbed, error2, np.array([9, 0, 1, 9])).tolist() == [0, 0, 1, 0]


def test_a_vertex_without_points_enough_along_keeps_its_disc(rng):
    points, normals = sheet(rng, lambda x, y: 0.0 * x, lambda x, y: (0.0 * x, 0.0 * y))
    samples = samples_at(points, normals, 0.006, NOISE)
    places, up = np.array([[0.0, 0.0, 0.0002]] * 2), np.tile([0.0, 0.0, 1.0], (2, 1))
    disc = Reach(
        np.zeros(2, int), np.zeros(2, int), np.zeros(2, bool), np.zeros(2, bool), np.full(2, 3e-5), *np.zeros((4, 2))
    )
    along = Furrows(
        np.array([0, 1]), np.array([0, -9]), np.full(2, 3.0), np.full(2, 7e-5), np.tile([0.0, 1, 0], (2, 1))
    )
    plain = project_vertices(places, up, samples, disc, 0.01)
    both = project_vertices(places, up, samples, disc._replace(furrows=along), 0.01)
    assert both.vertices[1].tolist() == plain.vertices[1].tolist()
    assert both.sigma[1] == plain.sigma[1]
    assert both.n_support[0] == pytest.approx(3.0 * plain.n_support[0], rel=0.1)
    unit2, unit2_disc = both.sigma[0] ** 2 - 7e-5**2, plain.sigma[0] ** 2 - 3e-5**2
    assert unit2 / both.scatter[0] ** 2 == pytest.approx(unit2_disc / plain.scatter[0] ** 2 / 3.0, rel=0.15)


def test_surfaces_have_stretched_fits_only_where_they_are_asked_for(rng):
    points, normals = sheet(rng, *waves(0.0))
    cloud = PointCloud(points, normals)
    asked = reconstruct_with_record(cloud, SurfaceSettings(along_furrows=True))
    assert asked.automatic["stretched_share"] > 0.3
    assert reconstruct_with_record(cloud).automatic["stretched_share"] == 0.0
