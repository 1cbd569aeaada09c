"""Robust normals on shapes whose normals are known."""

import dataclasses

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monitor.filtering import NormalSettings, estimate_normals
from monitor.filtering.nearest import build_index, canonical_order
from monitor.filtering.normals import fit_planes
from monitor.filtering.orientation import consistent_signs
from monitor.filtering.silhouettes import find_grazing
from projects.errors import ParameterError
from projects.model import PointCloud, Roughness
from projects.transforms import rotation_from_vector

STATION = np.array([0.0, 0.0, 3.0])


def wall(rng, n_points=4000, noise=0.2e-3):
    """Return a wall at z = 0 of 1 mm spacing, seen from `STATION`."""
    side = 0.001 * np.sqrt(n_points)
    return np.c_[rng.uniform(-side / 2, side / 2, (n_points, 2)), rng.normal(0, noise, n_points)]


def angles(normals, truth):
    """Return the angles [rad] between normals and the true ones, sign included."""
    return np.arccos(np.clip((normals * truth).sum(axis=1), -1, 1))


def test_normals_of_a_wall_are_as_good_as_their_uncertainty_says(rng):
    points = wall(rng)
    points = points[canonical_order(points)]
    planes = fit_planes(build_index(points), STATION - points, NormalSettings(n_neighbours=40))
    inner = (np.abs(points[:, :2]) < 0.025).all(axis=1)
    tilt = planes.normals[inner, :2] / planes.sigma_normal[inner, None]
    assert np.isclose(np.sqrt((tilt**2).mean()), 1.0, atol=0.12)
    assert (planes.normals[:, 2] > 0).all()


def test_normals_survive_forty_percent_of_outliers(rng):
    """Classical normals are off by 20 degrees there; the robust ones stay within 4 for 95 % of the good points."""
    points = wall(rng)
    bad = rng.random(len(points)) < 0.4
    points[bad, 2] += rng.uniform(1e-3, 12e-3, bad.sum())
    cloud = estimate_normals(PointCloud(points, origins=STATION), NormalSettings(n_neighbours=48))
    inner = (np.abs(points[:, :2]) < 0.025).all(axis=1)
    off = np.rad2deg(angles(cloud.normals, [0, 0, 1.0]))[inner & ~bad]
    assert np.quantile(off, 0.95) < 4.0


def test_copies_bear_no_witness_and_have_what_their_point_has(rng):
    """Many thousand points at one place took the square of their number, and made a neighbourhood without a size."""
    points = wall(rng, 2000)
    piled = np.r_[points, np.tile(points[:1], (30_000, 1))]
    alone, found = (estimate_normals(PointCloud(p, origins=STATION)) for p in (points, piled))
    for name in ("normals", "sigma", "spacing", "roughness", "surface_variation"):
        values, expected = getattr(found, name), getattr(alone, name)
        np.testing.assert_array_equal(values[:2000], expected)
        assert (values[2000:] == expected[0]).all()


def test_points_far_off_a_wall_are_outliers_and_the_wall_stays(rng):
    points = wall(rng)
    bad = rng.random(len(points)) < 0.03
    points[bad, 2] += rng.uniform(2e-3, 6e-3, bad.sum())
    order = canonical_order(points)
    points, bad = points[order], bad[order]
    planes = fit_planes(build_index(points), STATION - points, NormalSettings())
    assert planes.is_outlier[bad].mean() > 0.9
    assert planes.is_outlier[~bad].mean() < 0.01


def test_both_sides_of_an_edge_keep_their_points_and_their_normals(rng):
    """Two walls at a right angle, 1 mm spacing, 0.1 mm noise: beyond 1 mm of the edge each looks its own way."""
    flat = rng.uniform(0, 0.05, (8000, 2))
    first = np.arange(8000) < 4000
    noise = rng.normal(0, 0.1e-3, 8000)
    points = np.where(first[:, None], np.c_[flat, noise], np.c_[noise, flat[:, 0], flat[:, 1]])
    order = canonical_order(points)
    points, first = points[order], first[order]
    planes = fit_planes(build_index(points), np.array([0.5, 0.0, 0.5]) - points, NormalSettings(n_neighbours=40))
    truth = np.where(first[:, None], [0, 0, 1.0], [1.0, 0, 0])
    away = np.where(first, points[:, 0], points[:, 2])
    off = np.rad2deg(angles(planes.normals, truth))
    assert np.quantile(off[away > 1e-3], 0.98) < 10.0
    assert planes.is_outlier.mean() < 0.01
    assert planes.is_outlier[away < 3e-3].mean() < 0.03


def test_an_ornament_seen_by_few_points_does_not_vanish(rng):
    """Nothegger and Dorninger, fig. 8 a: 14 points of a tip 4 mm before the wall are a surface of their own."""
    tip = np.c_[rng.uniform(-2e-3, 2e-3, (14, 2)), 4e-3 + rng.normal(0, 0.1e-3, 14)]
    points = np.concatenate([tip, wall(rng, noise=0.1e-3)])
    order = canonical_order(points)
    planes = fit_planes(build_index(points[order]), STATION - points[order], NormalSettings())
    assert planes.is_outlier[order < 14].sum() <= 2


def coarse_wall(rng, height):
    """Return a wall of steps of 40 mm and 0.5 mm noise, scanned from 3.5 m before it, raised by `height` (u, v) [m], in
    canonical order; where the scanner stood, and how much each point was raised."""
    station = np.array([0.3, -0.2, 3.5])
    u, v = (side.ravel() for side in np.meshgrid(np.arange(-12, 13) * 0.04, np.arange(-12, 13) * 0.04))
    raised = height(u, v)
    beams = np.c_[u, v, raised] - station
    beams /= np.linalg.norm(beams, axis=1)[:, None]
    points = station + beams * ((raised - station[2]) / beams[:, 2] + rng.normal(0, 0.5e-3, len(u)))[:, None]
    order = canonical_order(points)
    return points[order], station, raised[order]


def test_a_moulding_that_one_column_of_a_scan_met_stays_and_has_the_tilt_of_the_wall(rng):
    """Points of one column lie in a plane with the scanner: that is no surface of theirs, and seen at grazing angle."""
    points, station, raised = coarse_wall(rng, lambda u, _: np.where(np.abs(u - 0.08) < 0.01, 0.014, 0.0))
    planes = fit_planes(build_index(points), station, NormalSettings())
    met = (raised > 0.0) & (np.abs(points[:, 1]) < 0.35)
    assert met.sum() == 17
    assert not planes.is_outlier[met].any()
    assert angles(planes.normals[met], [0, 0, 1.0]).max() < np.radians(5.0)
    assert not find_grazing(points, station, planes.normals, np.radians(80.0))[met].any()


def test_a_boss_that_few_points_of_a_scan_met_stays(rng):
    """Curved by more than noise from one point to the next, its points lie in no plane."""
    boss = lambda u, v: 0.04 * np.sqrt(np.clip(1.0 - (u**2 + v**2) / 0.09**2, 0.0, None))  # noqa: E731
    points, station, raised = coarse_wall(rng, boss)
    planes = fit_planes(build_index(points), station, NormalSettings())
    met = raised > 0.0
    assert met.sum() == 21
    assert not planes.is_outlier[met].any()


@pytest.mark.parametrize(
    ("what", "height"),
    [("beside a silhouette", lambda u, _: np.where(u > 0.09, 0.5, np.where(u > 0.07, 0.02, 0.0))),
     ("a rod before the wall", lambda u, _: np.where(np.abs(u - 0.08) < 0.01, 0.1, 0.0))],
)  # fmt: skip
def test_a_line_of_points_with_air_beside_or_behind_it_is_no_relief(rng, what, height):
    """Where the wall goes on at one side alone, or far behind, the spot may have met two surfaces."""
    points, station, raised = coarse_wall(rng, height)
    planes = fit_planes(build_index(points), station, NormalSettings(n_neighbours=32))
    line = (raised > 0.0) & (raised < 0.5)
    assert line.sum() == 25, what
    grazes = find_grazing(points, station, planes.normals, np.radians(80.0))
    assert (planes.is_outlier | grazes)[line].mean() > 0.9


def test_single_points_before_a_wall_are_no_relief(rng):
    alone = rng.random((25, 25)) < 0.04
    points, station, raised = coarse_wall(rng, lambda u, _: np.where(alone.ravel(), 0.02, 0.0))
    planes = fit_planes(build_index(points), station, NormalSettings())
    assert planes.is_outlier[raised > 0.0].mean() > 0.9


def test_two_thin_sheets_are_told_apart(rng):
    """A plate 3 mm thick, seen from both sides: each face has its own normal, no matter how near the other is."""
    points = np.concatenate([wall(rng), wall(rng) - [0, 0, 3e-3]])
    front = np.arange(8000) < 4000
    origins = np.where(front[:, None], STATION, -STATION)
    cloud = estimate_normals(PointCloud(points, origins=origins), NormalSettings(n_neighbours=40))
    inner = (np.abs(points[:, :2]) < 0.025).all(axis=1)
    truth = np.where(front[:, None], [0, 0, 1.0], [0, 0, -1.0])
    assert np.quantile(np.rad2deg(angles(cloud.normals, truth))[inner], 0.95) < 5.0


@settings(max_examples=5, deadline=None)
@given(turn=st.tuples(*[st.floats(-2, 2)] * 3), shift=st.tuples(*[st.floats(-1e3, 1e3)] * 3))
def test_normals_turn_with_the_cloud(turn, shift):
    points = wall(np.random.default_rng(1), n_points=400)
    rotation = rotation_from_vector(np.array(turn))
    here = estimate_normals(PointCloud(points, origins=STATION), NormalSettings(n_neighbours=20))
    there = PointCloud(points @ rotation.T + shift, origins=rotation @ STATION + shift)
    moved = estimate_normals(there, NormalSettings(n_neighbours=20))
    # The samples of the noise lie along another curve there, so that few points may change state.
    assert np.quantile(np.abs(here.normals @ rotation.T - moved.normals).max(axis=1), 0.9) < 0.02


def test_the_order_of_the_points_and_the_number_of_threads_change_nothing(rng):
    points = wall(rng)
    shuffle = rng.permutation(len(points))
    here = estimate_normals(PointCloud(points, origins=STATION))
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    there = estimate_normals(PointCloud(points[shuffle], origins=STATION))
    numba.set_num_threads(threads)
    for name in ("normals", "sigma", "surface_variation", "spacing", "roughness"):
        assert np.array_equal(getattr(here, name)[shuffle], getattr(there, name)), name


def test_normals_look_outward_where_nobody_knows_the_station(rng):
    points = rng.normal(size=(3000, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    cloud = estimate_normals(PointCloud(points + np.array([10.0, 0, 0]), origins=np.full(3, np.nan)))
    assert ((cloud.normals * points).sum(axis=1) > 0.95).all()


def test_roughness_is_smooth_on_noise_alone_and_rough_on_grooves(rng):
    """Grooves of 2 mm depth every 8 mm on one half; noise 0.2 mm throughout."""
    points = wall(rng, n_points=10_000)
    grooved = points[:, 0] > 0
    points[grooved, 2] += 1e-3 * np.sin(2 * np.pi * points[grooved, 0] / 8e-3)
    classes = estimate_normals(PointCloud(points, origins=STATION), NormalSettings(n_neighbours=60)).roughness
    assert (classes[points[:, 0] < -0.01] == Roughness.SMOOTH).mean() > 0.95
    assert (classes[points[:, 0] > 0.01] >= Roughness.MEDIUM).mean() > 0.9


def test_what_is_given_is_kept_and_the_input_is_not_changed(rng):
    points = wall(rng, n_points=500)
    cloud = PointCloud(points.copy(), origins=STATION, intensity=rng.random(500), sigma=np.full(500, 0.5))
    result = estimate_normals(cloud)
    assert np.array_equal(cloud.points, points)
    assert cloud.normals is None
    assert np.array_equal(result.intensity, cloud.intensity)
    assert np.array_equal(result.sigma, cloud.sigma)


def test_points_that_coincide_or_lie_exactly_in_a_plane_do_no_harm(rng):
    exact = np.c_[rng.uniform(0, 1, (400, 2)), np.zeros(400)]
    for points in (exact, np.repeat(exact[:100], 5, axis=0), np.zeros((50, 3))):
        cloud = estimate_normals(PointCloud(points, origins=STATION))
        assert np.allclose(np.linalg.norm(cloud.normals, axis=1), 1.0)
        assert np.isfinite(cloud.sigma).all()
    flat = estimate_normals(PointCloud(exact, origins=STATION))
    assert np.allclose(flat.normals, [0, 0, 1], atol=1e-5)


def test_too_few_points_and_points_without_place_are_refused(rng):
    points = wall(rng, n_points=100)
    with pytest.raises(ParameterError, match="7 points were given; at least 8"):
        estimate_normals(PointCloud(points[:7]))
    points[3, 1] = np.nan
    with pytest.raises(ParameterError, match="1 of 100 points have coordinates that are not finite"):
        estimate_normals(PointCloud(points))
    with pytest.raises(ParameterError, match="min_neighbours = 200 exceeds max_neighbours = 100"):
        dataclasses.replace(NormalSettings(), min_neighbours=200)


def test_a_bulging_sheet_looks_outward_whatever_its_rim_does(rng):
    x, y = rng.uniform(-1.0, 1.0, (2, 6000))
    x, y = x[np.hypot(x, y) < 1.0], y[np.hypot(x, y) < 1.0]
    r = np.hypot(x, y)
    z = -0.3 * r**2 + np.maximum(1.6 * (r - 0.9), 0.0)  # with a lip, whose outermost point leans inward
    slope = -0.6 * r + np.where(r > 0.9, 1.6, 0.0)
    upward = np.column_stack([-slope * x / r, -slope * y / r, np.ones(len(r))])
    upward /= np.linalg.norm(upward, axis=1)[:, None]
    flipped = rng.choice([-1.0, 1.0], len(r))
    assert np.mean(consistent_signs(np.column_stack([x, y, z]), flipped[:, None] * upward) == flipped) > 0.99


@pytest.mark.parametrize("share", [0.001, 0.7])
def test_points_that_do_not_know_their_station_look_where_those_beside_them_look(rng, share):
    points = wall(rng)
    origins = np.tile(-STATION, (len(points), 1))  # below the wall, where nothing else says so
    origins[rng.random(len(points)) < share] = np.nan
    assert np.isnan(origins).any()
    cloud = estimate_normals(PointCloud(points, origins=origins), NormalSettings(n_neighbours=40))
    assert (cloud.normals[:, 2] < 0.0).all()
