"""Fits around a vertex: exact where the surface is, honest about their error, wide only where the surface allows."""

import numpy as np
import pytest
from samples_of_clouds import measure_sampling, samples_at
from scipy.spatial import cKDTree

from monitor.reconstruction import SurfaceSettings, reconstruct
from monitor.reconstruction.gathering import patch_room
from monitor.reconstruction.moments import FRAMES, build_levels, find_rows, level_of_points
from monitor.reconstruction.probing import STEP, STEP_UNIT2, probe
from monitor.reconstruction.projection import Reach, fit_fourth, project_vertices, sum_up_samples
from monitor.reconstruction.quadric import COUNT, FAR, HEIGHT, UNIT_ERROR, fit_patch, fit_room, median
from monitor.reconstruction.reach import Stated, choose_reach, for_edges, make_ladder, noise_variance
from projects.model import PointCloud

RADIUS = 0.06


def fit(u, v, z, radius, degree):
    n = len(u)
    out, influence = np.empty(7), np.empty(n)
    patch = np.vstack([u / radius, v / radius, z / radius, np.ones(n), np.zeros((6, n))])
    assert fit_patch(patch, n, radius, 1.0, 1.0, degree, fit_room(n), out, influence)
    return out, influence


def disc(rng, n, radius):
    r, turn = radius * np.sqrt(rng.uniform(size=n)), rng.uniform(0.0, 2.0 * np.pi, n)
    return r * np.cos(turn), r * np.sin(turn)


def wavy_sheet(rng, size, wavelength, amplitude, noise):
    g = np.arange(size) * 0.001
    x, y = (a.ravel() + rng.uniform(-0.0003, 0.0003, size * size) for a in np.meshgrid(g, g))
    k = 2.0 * np.pi / wavelength
    slope = amplitude * k * np.cos(k * x)
    normals = np.column_stack([-slope, np.zeros_like(x), np.ones_like(x)]) / np.sqrt(1.0 + slope**2)[:, None]
    return PointCloud(np.column_stack([x, y, amplitude * np.sin(k * x) + noise * rng.normal(size=len(x))]), normals)


def test_plane_is_fitted_exactly_with_the_textbook_standard_error(rng):
    u, v = disc(rng, 400, 0.01)
    out, influence = fit(u, v, 0.003 + 0.1 * u - 0.2 * v, 0.01, 1)
    assert out[:3] == pytest.approx([0.003, 0.1, -0.2], abs=1e-12)
    w = 1.0 - (u**2 + v**2) / 0.01**2
    design = np.column_stack([np.ones_like(u), u, v])
    row = np.linalg.solve(design.T @ (w[:, None] * design), (w[:, None] * design).T)[0]
    assert influence == pytest.approx(row, rel=1e-6)
    assert out[3] == pytest.approx(np.sqrt((row**2).sum()), rel=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_curved_patch_follows_a_sphere_and_a_cylinder_to_fourth_order(rng, sign):
    u, v = disc(rng, 2000, 0.02)
    sphere = sign * (np.sqrt(RADIUS**2 - u**2 - v**2) - RADIUS)
    cylinder = sign * (np.sqrt(RADIUS**2 - u**2) - RADIUS)
    # r^4 / (77 R^3), 9.6 um, is what a quadric without the fourth order is off by
    assert abs(fit(u, v, sphere, 0.02, 2)[0][0]) < 1e-6
    assert abs(fit(u, v, cylinder, 0.02, 2)[0][0]) < 1e-6


def test_noise_along_the_normals_of_a_sphere_leaves_no_bias(rng):
    sigma, heights, error = 0.002, [], []
    for _ in range(600):
        z = 1.0 - rng.uniform(0.0, 0.06, 400)  # a cap of 0.35 radii, evenly sampled
        turn, s = rng.uniform(0.0, 2.0 * np.pi, 400), np.sqrt(1.0 - z * z)
        points = (RADIUS + sigma * rng.normal(size=400))[:, None] * np.column_stack(
            [s * np.cos(turn), s * np.sin(turn), z]
        )
        out, _ = fit(points[:, 0], points[:, 1], points[:, 2] - RADIUS, 0.018, 2)
        heights.append(out[0])
        error.append(out[3] * out[4])
    # without the correction the mean is -2 sigma^2 / R, -0.133 mm; the mean of 600 is known to 0.02 mm
    assert abs(np.mean(heights)) < 0.04e-3
    assert np.std(heights) / np.mean(error) == pytest.approx(1.0, abs=0.1)


def fourth(u, v, z, radius):
    room = patch_room(len(u))
    room.patch[:4] = u / radius, v / radius, z / radius, np.ones(len(u))
    room.patch[4:] = 0.0
    assert fit_fourth(room, len(u), radius)
    return room.fit.copy()


def test_the_fourth_order_of_a_relief_moves_no_height_once_it_is_taken_off(rng):
    g = np.linspace(-0.01, 0.01, 81)
    u, v = (a.ravel() for a in np.meshgrid(g, g))
    k = 2.0 * np.pi / 0.02
    curved = fit(u, v, 0.001 * np.cos(k * u), 0.01, 2)[0][0] - 0.001
    # By theory, of weights 1 - t^2: -0.116 mm of a radius of 10 mm, -0.034 of 7.1 mm, and -0.006 carried on to none.
    assert curved == pytest.approx(-0.116e-3, rel=0.05)
    assert fourth(u, v, 0.001 * np.cos(k * u), 0.01)[HEIGHT] - 0.001 == pytest.approx(-0.006e-3, abs=0.003e-3)


def test_taking_the_fourth_order_off_states_the_noise_that_it_adds(rng):
    u, v = disc(rng, 300, 0.01)
    found = np.array([fourth(u, v, 0.0002 * rng.normal(size=300), 0.01)[[HEIGHT, UNIT_ERROR]] for _ in range(800)])
    narrow = fit(*(a[np.hypot(u, v) < 0.01 / 1.4] for a in (u, v, 0.0 * u)), 0.01 / 1.4, 2)[0][UNIT_ERROR]
    assert found[:, 0].std() == pytest.approx(0.0002 * found[:, 1].mean(), rel=0.08)
    assert found[:, 1].mean() == pytest.approx(1.14 * narrow, rel=0.05)


def test_what_scatters_beyond_the_stated_noise_is_relief(rng):
    pool = np.array([np.r_[k:20, 0:k] for k in range(20)])  # all of them together
    scatter = np.where(np.arange(20) < 5, 0.004, 0.0008)
    calm = noise_variance(scatter, np.full(20, 0.001), pool)
    assert calm == pytest.approx(np.full(20, 0.001**2))  # not the mean, 2 mm squared
    understated = noise_variance(scatter, np.full(20, 0.0004), pool)
    assert understated == pytest.approx(np.full(20, 0.0008**2))  # most of the surface scatters by twice of it
    noisier = noise_variance(scatter, np.where(np.arange(20) < 5, 0.004, 0.001), pool)
    assert noisier == pytest.approx(np.full(20, np.mean(scatter**2)))
    unstated = noise_variance(scatter, np.full(20, np.nan), pool)
    assert unstated == pytest.approx(np.full(20, np.mean(scatter**2)))


def test_outliers_do_not_move_the_fit(rng):
    u, v = disc(rng, 300, 0.01)
    z = 0.0002 * rng.normal(size=300)
    clean = fit(u, v, z, 0.01, 2)[0]
    z[::10] += 0.004
    dirty = fit(u, v, z, 0.01, 2)[0]
    # a mean would move by 0.4 mm; the standard error is 0.024 mm
    assert abs(dirty[0] - clean[0]) < 2.0 * clean[3] * clean[4]
    assert dirty[4] == pytest.approx(0.0002, rel=0.15)


def test_buckets_hold_the_same_points_as_a_search_through_all_finds(rng):
    points = rng.uniform(0, 1, size=(500, 3))
    level = level_of_points(points, np.tile([0.0, 0.0, 1.0], (500, 1)), 0.26)
    place, radius = np.array([0.4, 0.97, 0.02]), 0.2
    rows = np.empty((100, 2), np.int64)
    found = [k for a, b in rows[: find_rows(level, place - radius, place + radius, rows)] for k in range(a, b)]
    assert len(found) == len(set(found)) < 200
    want = points[np.linalg.norm(points - place, axis=1) <= radius]
    assert {tuple(p) for p in want} <= {tuple(p) for p in level.places[found]}


def test_groups_keep_count_mean_and_spread_of_their_points_and_part_by_the_way_they_look(rng):
    points = rng.uniform(0, 0.02, size=(4000, 3))
    normals = np.where(rng.uniform(size=(4000, 1)) < 0.3, [0.0, 0.0, 1.0], [0.0, 0.6, -0.8])
    level = build_levels(level_of_points(points, normals, 0.01), np.array([0.01, 0.014, 0.02]), 0.001)[-1]
    assert len(level.counts) < 400
    assert level.counts.sum() == 4000
    assert np.abs(level.normals[:, 2] - 1.0).min() < 1e-12
    up = level.normals[:, 2] > 0.99
    for own, of_points in ((up, normals[:, 2] > 0), (~up, normals[:, 2] < 0)):
        share = level.counts[own] / level.counts[own].sum()
        mean = share @ level.places[own]
        away = level.places[own] - mean
        spread = share @ level.spreads[own] + share @ (away[:, [0, 0, 0, 1, 1, 2]] * away[:, [0, 1, 2, 1, 2, 2]])
        assert mean == pytest.approx(points[of_points].mean(axis=0), abs=1e-12)
        want = np.cov(points[of_points].T, bias=True)[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
        assert spread == pytest.approx(want, abs=1e-15)


def test_a_fit_to_groups_is_that_to_their_points(rng):
    radius, noise, n = 0.02, 0.001, 40_000
    z = 1.0 - 2.0 * (np.arange(n) + 0.5) / n
    turn, s = np.pi * (1.0 + 5.0**0.5) * np.arange(n), np.sqrt(1.0 - z * z)
    normals = np.column_stack([s * np.cos(turn), s * np.sin(turn), z])
    points = (RADIUS + noise * rng.normal(size=(n, 1))) * normals
    places = normals[::100]
    reach = Reach(np.full(400, 2), np.full(400, 2), np.zeros(400, bool), np.zeros(400, bool), *np.zeros((5, 400)))
    reach = reach._replace(noise=np.full(400, np.nan))
    summed = sum_up_samples(level_of_points(points, normals, radius), radius * 1.4 ** np.arange(-2.0, 1.0), noise)
    single = summed._replace(levels=[None, None, level_of_points(points, normals, radius)])
    moved = [project_vertices(RADIUS * places, places, samples, reach, 0.01) for samples in (summed, single)]
    assert len(summed.levels[-1].counts) < 0.5 * n
    height, truth = (np.linalg.norm(p.vertices, axis=1) - RADIUS for p in moved)
    # A standard error is 62 um; without the covariances within the groups the mean is off by 24 um and more.
    assert abs(np.mean(height - truth)) < 0.004e-3
    assert np.std(height - truth) < 0.015e-3
    assert moved[0].sigma == pytest.approx(moved[1].sigma, rel=0.08)
    assert moved[0].scatter == pytest.approx(moved[1].scatter, rel=0.03)


def test_what_bends_within_groups_counts_in_the_error_of_a_fit(rng):
    """Two rows of groups tell no curvature across them but by how their points spread: 0.08 was stated for 0.58."""
    u, v = rng.uniform(0.35, 0.75, 2000), rng.uniform(-0.6, 0.6, 2000)
    of = 100 * (u > 0.55) + np.floor(10.0 * v).astype(int)
    groups = []
    for one in np.unique(of):
        p = np.array([u[of == one], v[of == one], np.zeros(np.count_nonzero(of == one))])
        groups.append([*p.mean(axis=1), p.shape[1], *np.cov(p, bias=True)[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
    patches = np.array(groups).T, np.vstack([u, v, 0.0 * u, np.ones(2000), np.zeros((6, 2000))])
    (grouped, coarse), (single, _) = (errors_of(np.ascontiguousarray(patch)) for patch in patches)
    assert grouped == pytest.approx(single, rel=0.1)
    assert coarse < 0.5 * single  # were all points of a group in its middle


def errors_of(patch):
    """Standard errors per unit of noise of a curved fit: as stated, and by the influence of groups' middles alone."""
    n = patch.shape[1]
    out, influence = np.empty(7), np.empty(n)
    assert fit_patch(patch, n, 1.0, 1.0, 1.0, 2, fit_room(n), out, influence)
    return out[UNIT_ERROR], np.sqrt(patch[COUNT] @ influence**2)


def test_noise_that_reaches_over_the_borders_of_cells_is_no_outlier(rng):
    g, noise, radius = 0.001 * (np.arange(80) - 39.5), 0.003, 0.05
    x, y = (a.ravel() for a in np.meshgrid(g, g))
    up, flat = (
        np.tile([0.0, 0.0, 1.0], (6400, 1)),
        Reach(*np.zeros((2, 1), int), *np.array([[True], [False]]), *np.zeros((5, 1))),
    )
    moved = []
    for _ in range(60):
        points = np.column_stack([x, y, noise * rng.normal(size=6400)])
        samples = sum_up_samples(level_of_points(points, up, radius), radius * 1.4 ** np.arange(-2.0, 1.0), noise)
        moved.append(project_vertices(np.zeros((1, 3)), up[:1], samples, flat._replace(flat=np.array([2])), 0.01))
    ratio = [p.vertices[0, 2] / p.sigma[0] for p in moved]
    # Groups cut into an upper and a lower part, the smaller of which passes for outliers, make it 1.7 and more.
    assert 0.75 < np.std(ratio) < 1.25


def test_vertices_of_a_thin_plate_rest_on_their_own_side_only(rng):
    g = np.arange(40) * 0.001
    x, y = (a.ravel() for a in np.meshgrid(g, g))
    top, bottom = (np.column_stack([x, y, np.full_like(x, z)]) for z in (0.001, -0.001))
    up = np.tile([0.0, 0.0, 1.0], (len(x), 1))
    samples = samples_at(np.r_[top, bottom], np.r_[up, -up], 0.004, 0.0005)
    reach = Reach(np.zeros(1, int), np.zeros(1, int), np.zeros(1, bool), np.zeros(1, bool), *np.zeros((5, 1)))
    moved = project_vertices(np.array([[0.02, 0.02, 0.0004]]), np.array([[0.0, 0.0, 1.0]]), samples, reach, 0.01)
    assert moved.vertices[0] == pytest.approx([0.02, 0.02, 0.001], abs=1e-9)


def test_vertices_of_a_rounded_step_come_back_to_the_part_that_they_belong_to(rng):
    x, y = (a.ravel() + rng.uniform(-3e-4, 3e-4, 1600) for a in np.meshgrid(*2 * [0.001 * (np.arange(40) - 19.5)]))
    v, w = (a.ravel() for a in np.meshgrid(0.001 * (np.arange(40) - 19.5), 0.001 * (np.arange(5) + 0.5)))
    points = np.r_[np.column_stack([x, y, np.where(x > 0.0, 0.005, 0.0)]), np.column_stack([0.0 * v, v, w])]
    normals = np.r_[np.tile([0.0, 0.0, 1.0], (1600, 1)), np.tile([-1.0, 0.0, 0.0], (200, 1))]
    z = np.linspace(0.00005, 0.00495, 60)  # of the raw vertices, on a step rounded by up to 1.3 mm
    raw = np.column_stack([0.0012 * np.log(z / (0.005 - z)), 0.0 * z, z])
    slope = z * (0.005 - z) / (0.005 * 0.0012)
    outward = np.column_stack([-slope, 0.0 * slope, np.ones(60)]) / np.sqrt(1.0 + slope**2)[:, None]
    raw = np.concatenate([raw + np.array([0.0, side, 0.0]) for side in np.linspace(-0.012, 0.012, 25)])
    reach = Reach(
        np.zeros(1500, int), np.zeros(1500, int), np.zeros(1500, bool), np.zeros(1500, bool), *np.zeros((5, 1500))
    )
    moved = project_vertices(raw, np.tile(outward, (25, 1)), samples_at(points, normals, 0.0035, 1e-4), reach, 0.003)
    assert moved.is_fitted.all()
    x, _, z = moved.vertices.T
    flats = np.minimum(np.hypot(np.maximum(x, 0.0), z), np.hypot(np.maximum(-x, 0.0), z - 0.005))
    off = np.minimum(flats, np.hypot(x, np.maximum(np.maximum(-z, z - 0.005), 0.0)))
    assert np.quantile(off, 0.95) < 0.00017  # 0.21 mm with both frames about the raw vertex, 0.13 so


def test_fits_are_wide_on_a_plane_and_narrow_on_relief(rng):
    def median_radius(cloud):
        ladder = make_ladder(0.0015, 0.0003, 1.5, 16.0, 0.05)
        samples = sum_up_samples(level_of_points(cloud.points, cloud.normals, 0.01), ladder.radii, 0.0003)
        reach = choose_reach(cloud.points, cloud.normals, samples, ladder)
        return np.median(ladder.radii[np.where(reach.is_flat, reach.flat, reach.curved)]), reach.is_flat.mean()

    plane, flat_share = median_radius(wavy_sheet(rng, 60, 1.0, 0.0, 0.0003))
    relief, relief_flat_share = median_radius(wavy_sheet(rng, 60, 0.010, 0.001, 0.0003))
    assert flat_share > 0.5  # planes are refused where chance makes them look bent
    assert relief_flat_share < 0.1
    assert relief < 0.5 * plane


def test_relief_finer_than_the_fits_widens_them_less_where_points_state_their_noise(rng):
    cloud = wavy_sheet(rng, 60, 0.003, 0.001, 0.0003)
    ladder = make_ladder(0.002, 0.0003, 1.5, 16.0, 0.05)
    samples = sum_up_samples(level_of_points(cloud.points, cloud.normals, 0.01), ladder.radii, 0.0003)
    stated = Stated(cKDTree(cloud.points), np.full(len(cloud), 0.0003))
    alone, told = (choose_reach(cloud.points, cloud.normals, samples, ladder, s) for s in (None, stated))
    assert np.mean(told.curved <= 1) > 1.2 * np.mean(alone.curved <= 1)


def test_what_a_rough_half_refuses_does_not_narrow_the_fits_of_the_other(rng):
    cloud = wavy_sheet(rng, 60, 0.010, 0.001, 0.0003)
    rest = cloud.points[:, 1] > 0.03
    heights = np.where(rest, 0.0003 * rng.normal(size=len(rest)), cloud.points[:, 2])
    points = np.column_stack([cloud.points[:, :2], heights])
    normals = np.where(rest[:, None], [0.0, 0.0, 1.0], cloud.normals)
    ladder = make_ladder(0.0015, 0.0003, 1.5, 16.0, 0.05)
    reach = choose_reach(
        points, normals, sum_up_samples(level_of_points(points, normals, 0.01), ladder.radii, 0.0003), ladder
    )
    assert np.median(reach.curved[points[:, 1] > 0.045]) >= 5  # 2 where those of the other half count
    assert np.median(reach.curved[points[:, 1] < 0.02]) <= 2


def test_relief_does_not_pass_for_noise(rng):
    # A plane over the neighbours would report 0.5 mm here.
    assert measure_sampling(wavy_sheet(rng, 60, 0.012, 0.001, 0.0001)).noise == pytest.approx(0.0001, rel=0.35)


@pytest.mark.validation
@pytest.mark.parametrize(("noise", "spread"), [(0.0003, 0.03e-3), (0.001, 0.08e-3)])
def test_noisy_plane_has_no_bias_little_noise_and_an_honest_sigma(noise, spread):
    bias, std, ratio = [], [], []
    for seed in range(3):
        cloud = wavy_sheet(np.random.default_rng(seed), 60, 1.0, 0.0, noise)
        surface = reconstruct(cloud)
        inside = (np.abs(surface.vertices[:, :2] - 0.0295) < 0.0265).all(axis=1)
        points_inside = (np.abs(cloud.points[:, :2] - 0.0295) < 0.0265).all(axis=1)
        height = surface.vertices[inside, 2]
        bias.append(height.mean() - cloud.points[points_inside, 2].mean())
        std.append(height.std())
        ratio.append(np.std(height / surface.sigma[inside]))
    assert abs(np.mean(bias)) < 0.01e-3
    assert np.mean(std) < spread
    assert 0.8 < np.mean(ratio) < 1.25


@pytest.mark.validation
def test_relief_of_eight_millimetres_is_kept_better_than_by_open3d(rng):
    from monitor.reconstruction.open3d_poisson import poisson_mesh

    def kept(vertices):
        inside = (np.abs(vertices[:, :2] - 0.03) < 0.02).all(axis=1) & (np.abs(vertices[:, 2]) < 0.005)
        phase = 2.0 * np.pi * vertices[inside, 0] / 0.008
        design = np.column_stack([np.sin(phase), np.cos(phase), np.ones_like(phase)])
        return np.linalg.lstsq(design, vertices[inside, 2], rcond=None)[0][0]

    cloud = wavy_sheet(rng, 60, 0.008, 0.001, 0.0004)
    ours = kept(reconstruct(cloud, SurfaceSettings(cell_size=0.0015)).vertices)
    theirs = kept(poisson_mesh(cloud.points - 0.03, cloud.normals, 0.0015)[0] + 0.03)
    assert 0.9e-3 < ours < 1.05e-3
    assert ours > theirs


def test_median_by_counting_is_that_of_sorting(rng):
    for n in range(7, 60):
        values = rng.chisquare(2.0, n) * np.where(rng.random(n) < 0.2, 1e4, 1.0)  # a fifth of them far off
        inside = np.where(np.arange(n) < n - 2, values, FAR)
        found = median(inside, n, n - 2.0, values[: n - 2].mean())
        lower, upper = (
            np.quantile(values[: n - 2], 0.5, method="lower"),
            np.quantile(values[: n - 2], 0.5, method="higher"),
        )
        assert 0.98 * lower < found <= 1.02 * upper
    spread = np.array([1.0, 2.0, 3.0, 5.0, 8.0, FAR])
    assert median(spread, 6, 5.0, 3.8) == 3.0
    assert median(spread, 5, 5.0, 3.8) == 3.0
    assert 2.0 < median(spread, 4, 4.0, 2.75) <= 3.0  # as many below as above


@pytest.mark.parametrize("draw", [(13, 500), (27, 502)])
def test_no_part_of_a_bumpy_sheet_is_fitted_too_wide(draw):
    # A tenth of such sheets was, over a third of their vertices, while wide fits were made at some probes only.
    def height(x, y):
        return 0.005 * np.sin(x / 0.02) * np.cos(y / 0.03) + 0.002 * np.sin((x + 2.0 * y) / 0.013)

    rng, g = np.random.default_rng(draw), (np.arange(120) - 59.5) * 0.001
    x, y = (a.ravel() + rng.uniform(-3e-4, 3e-4, 120**2) for a in np.meshgrid(g, g))
    points = np.column_stack([x, y, height(x, y) + 3e-4 * rng.normal(size=len(x))])
    surface = reconstruct(PointCloud(points, origins=np.array([0.0, 0.0, 2.0])))
    vertices, cosine = surface.vertices, surface.normals[:, 2]
    error = (vertices[:, 2] - height(vertices[:, 0], vertices[:, 1])) * cosine
    inside = (np.abs(vertices[:, :2]) < 0.05).all(axis=1)
    assert np.abs(error[inside]).max() < 0.25e-3
    assert np.std((error / surface.sigma)[inside]) == pytest.approx(1.0, abs=0.15)


def test_a_vertex_on_an_edge_does_not_take_over_the_reach_of_a_flat_side(rng):
    """The nearest probe may stand on a side, where planes reach far: here they would lie inside of both."""
    g = 0.001 * (np.arange(1200) % 40 + 0.5), 0.001 * (np.arange(1200) // 40 - 14.5)
    half = np.sqrt(0.5)
    right = np.column_stack([half * g[0], g[1], -half * g[0]])
    points, normals = (
        np.r_[right, right * [-1.0, 1.0, 1.0]],
        np.repeat([[half, 0, half], [-half, 0, half]], 1200, axis=0),
    )
    points = points + 0.0002 * rng.normal(size=(2400, 1)) * normals
    radii = 0.002 * 1.4 ** np.arange(8)
    samples = sum_up_samples(level_of_points(points, normals, 0.01), radii, 0.0002)
    reach = Reach(*np.full((2, 1), 7), *np.array([[True], [False]]), *np.zeros((5, 1)))
    reach = reach._replace(noise=np.full(1, 0.0002))
    places, up = np.array([[0.0, 0.0, -0.0003]]), np.array([[0.0, 0.0, 1.0]])
    found = project_vertices(places, up, samples, reach, 0.01)
    assert -0.001 < found.vertices[0, 2] <= 0.0002  # within 20 mm a plane lies 3 mm inside
    trusted = project_vertices(places, up, samples, reach._replace(noise=np.full(1, np.nan)), 0.01)
    assert trusted.vertices[0, 2] < -0.002


def test_two_fits_of_one_probe_are_those_of_all_its_points_and_of_the_inner_ones(rng):
    """The points of the inner fit are brought first; what it leaves out must not move the variance of their step."""
    radius, inner, n = 0.01, 1.0 / 1.4, 400
    u, v = disc(rng, n, radius)
    u, v = np.r_[0.0, u], np.r_[0.0, v]
    z = 2.0 * u**2 - 3.0 * v**2 + 1e-4 * rng.normal(size=n + 1)
    up = np.tile([0.0, 0.0, 1.0], (n + 1, 1))
    found = probe(np.zeros((3, 3)), up[:3], np.arange(3), samples_at(np.c_[u, v, z], up, radius, 1e-4), 0,
                  np.array([1.0, inner, 1.0]))  # fmt: skip
    patch = np.vstack([u / radius, v / radius, z / radius, np.ones(n + 1), np.zeros((6, n + 1))])
    heights, influences = [], []
    for span in (1.0, inner):
        out, influence = np.empty(7), np.empty(n + 1)
        assert fit_patch(patch, n + 1, radius, span, 1.0, 2, fit_room(n + 1), out, influence)
        heights.append(out[HEIGHT])
        influences.append(influence)
    assert found[1, STEP] == pytest.approx(heights[0] - heights[1], rel=1e-6)
    assert found[1, STEP_UNIT2] == pytest.approx(((influences[0] - influences[1]) ** 2).sum(), rel=1e-6)
    assert np.isnan(found[[0, 2], STEP]).all()


def test_columns_hardly_lean_whichever_way_a_surface_looks(rng: np.random.Generator) -> None:
    ways = rng.normal(size=(20_000, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    lean = np.degrees(np.arccos(np.abs(ways @ FRAMES[:, 2].T).max(axis=1)))
    assert lean.max() < 18.0
    assert lean.mean() < 8.5
    np.testing.assert_allclose(FRAMES @ FRAMES.transpose(0, 2, 1), np.tile(np.eye(3), (len(FRAMES), 1, 1)), atol=1e-12)


def test_much_noise_has_a_radius_of_four_sigmas_which_no_window_on_an_edge_has(rng):
    calm, noisy = make_ladder(0.002, 0.0006, 1.5, 24.0, 0.03), make_ladder(0.002, 0.003, 1.5, 24.0, 0.03)
    assert calm.radii[0] == pytest.approx(0.0036)  # six sigmas; of 1.5 cells, 3 mm, there is no room for less
    assert noisy.radii[:2] == pytest.approx([0.018 / 1.4, 0.018])
    points = np.column_stack([rng.uniform(-0.03, 0.03, (500, 2)), np.zeros(500)])
    samples = sum_up_samples(level_of_points(points, np.tile([0.0, 0.0, 1.0], (500, 1)), 0.02), noisy.radii, 0.003)
    wide = for_edges(samples)
    assert wide.radii == pytest.approx(noisy.radii[1:])
    assert len(wide.levels) == len(wide.radii)
    assert wide.levels[0] is samples.levels[0]  # single points
    assert for_edges(samples._replace(noise=0.001)).radii == pytest.approx(noisy.radii)


def test_a_ball_hardly_wider_than_fits_in_much_noise_has_little_bias():
    """Fits of six sigmas lay 0.8 and 1.2 mm inside, and stated half of it."""
    n, means = 5027, []
    for seed in range(2):
        rng = np.random.default_rng([seed, 11])
        z = 1.0 - 2.0 * (np.arange(n) + 0.5) / n
        turn = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(n) + rng.uniform(0.0, 2.0 * np.pi)
        normals = np.column_stack([np.sqrt(1.0 - z * z) * np.cos(turn), np.sqrt(1.0 - z * z) * np.sin(turn), z])
        points = 0.02 * normals + rng.normal(scale=0.003, size=(n, 1)) * normals
        surface = reconstruct(PointCloud(points, normals=normals))
        error = np.linalg.norm(surface.vertices, axis=1) - 0.02
        means.append(np.nanmean(error))
        assert 0.5 < np.sqrt(np.nanmean((error / surface.sigma) ** 2)) < 1.3
    assert np.abs(means).max() < 0.4e-3
