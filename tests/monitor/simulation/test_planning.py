"""The planner against scans: the sigma it expects is that of simulated campaigns, and it sees what they see."""

import dataclasses

import numpy as np
import pytest

from monitor.simulation import INSTRUMENTS, Scene, Window, plane_scene, simulate_scan, stand_at, without_errors
from monitor.simulation.planning import plan_campaign, spread_points, visible_change
from monitor.simulation.scenes import make_ball, make_box
from projects.errors import ParameterError
from projects.transforms import apply

EXACT = without_errors(INSTRUMENTS["faro-photon120"])
UP = np.array([[0.0, 0.0, 1.0]])
POINT = np.zeros((1, 3))


@pytest.mark.parametrize(("angle", "noise"), [(0.6, "range"), (1.1, "range"), (1.0, "angle")])
def test_the_expected_sigma_is_the_scatter_of_simulated_campaigns(angle, noise):
    quiet = {"noise_10m": 0.5e-3, "noise_floor": 0.3e-3} if noise == "range" else {"angular_noise": 1e-4}
    instrument = dataclasses.replace(EXACT, **quiet)
    scene = plane_scene(size=2.0, reflectance=0.5)
    pose = stand_at([4.0 * np.sin(angle), 0.0, 4.0 * np.cos(angle)], facing=[0.0, 0.0, 0.0])
    step, extent, down = 0.0004, 0.03, angle - np.pi / 2
    seen = visible_change(scene, instrument, [pose], POINT, UP, step=step, extent=extent, reflectance=0.5)
    window = Window(-0.03, 0.03, down - 0.03, down + 0.03)
    places = []
    for seed in range(6):
        scan = simulate_scan(scene, instrument, pose, window, step=step, seed=seed, n_subrays=1)
        points = apply(pose, scan.cloud.points)
        for x in np.arange(-2, 3) * 0.035:
            for y in np.arange(-2, 3) * 0.035:
                patch = points[np.hypot(points[:, 0] - x, points[:, 1] - y) < 0.5 * extent]
                places.append(patch[:, 2].mean())
    # 150 patches: one sigma of their spread is 6 %; range and incidence vary by 2 % over them.
    assert np.std(places) == pytest.approx(seen.sigma[0], rel=0.2)
    assert seen.spacing[0] == pytest.approx(4.0 * step / np.sqrt(np.cos(angle)), rel=1e-6)
    assert seen.smallest_change[0] == pytest.approx(1.96 * np.sqrt(2.0) * seen.sigma[0], rel=1e-3)  # 3 cm: k = 1


def test_stations_add_up_and_registration_does_not_average_within_one():
    instrument = dataclasses.replace(EXACT, noise_floor=0.3e-3)
    poses = [stand_at([x, 0.0, 3.0], facing=[0.0, 0.0, 0.0]) for x in (-2.0, 2.0)]
    options = {"step": 0.0005, "sigma_registration": 1e-3}
    one, two = (visible_change(plane_scene(), instrument, poses[:k], POINT, UP, **options) for k in (1, 2))
    assert two.n_stations == 2
    assert two.sigma[0] == pytest.approx(one.sigma[0] / np.sqrt(2.0), rel=1e-9)
    assert one.sigma[0] > 1e-3
    finer = visible_change(plane_scene(), instrument, poses[:1], POINT, UP, step=0.0001, sigma_registration=1e-3)
    assert finer.sigma[0] > 1e-3


def test_what_is_smaller_than_the_beam_shows_flattened():
    instrument = dataclasses.replace(
        EXACT, noise_floor=0.3e-3, beam_diameter=0.02, beam_divergence=0.0, elevation_min=-1.57
    )
    pose = stand_at([0.01, 0.0, 3.0], facing=[0.0, 0.0, 0.0])
    seen = visible_change(plane_scene(), instrument, [pose], POINT, UP, step=0.0005, extent=0.01)
    kept = 1.0 - np.exp(-(0.005**2) / (2 * 0.005**2))  # half the extent is one sigma of the beam
    assert seen.smallest_change[0] == pytest.approx(1.96 * np.sqrt(2.0) * seen.sigma[0] / kept, rel=1e-3)
    assert seen.footprint[0] == pytest.approx(0.02, rel=1e-3)


def test_what_is_hidden_turned_away_or_out_of_field_is_not_seen():
    ball = make_ball("ball", np.array([0.0, 0.0, 1.0]), 0.3, n_rings=40)
    screen = make_box("screen", [-0.1, -1.05, 0.9], [0.1, -1.0, 1.1])
    scene = Scene("ball", (ball, screen))
    points, normals = spread_points(ball, 4000, seed=1)
    pose = stand_at([0.0, -3.0, 1.0], facing=[0.0, 0.0, 1.0])
    seen = visible_change(scene, EXACT, [pose], points, normals, step=0.0005)
    facing = ((pose[:3, 3] - points) * normals).sum(axis=1) > 0.1  # steeper ones get fewer than three pulses
    # The screen's shadow on the ball: rays through |x| < 0.1, |z - 1| < 0.1 at y = -1.
    at = (points - pose[:3, 3]) * (2.0 / (points[:, 1:2] + 3.0))
    shaded = (np.abs(at[:, 0]) < 0.1) & (np.abs(at[:, 2]) < 0.1)
    rim = np.abs(np.abs(at[:, [0, 2]]).max(axis=1) - 0.1) < 0.003
    np.testing.assert_array_equal((seen.n_stations > 0)[facing & ~rim], ~shaded[facing & ~rim])
    assert not seen.n_stations[((pose[:3, 3] - points) * normals).sum(axis=1) < 0].any()
    assert np.isnan(seen.smallest_change[seen.n_stations == 0]).all()
    beneath = stand_at([0.0, -0.2, 3.0], facing=[0.0, 0.0, 1.0])  # looks down steeper than the mirror sees
    assert not visible_change(scene, EXACT, [beneath], points, normals, step=0.0005).n_stations.any()


def test_what_is_in_sight_of_too_few_pulses_is_told_from_what_is_hidden():
    ball = make_ball("ball", np.array([0.0, 0.0, 1.0]), 0.3, n_rings=40)
    points, normals = spread_points(ball, 2000, seed=1)
    pose = stand_at([0.0, -3.0, 1.0], facing=[0.0, 0.0, 1.0])
    fine, coarse = (
        visible_change(Scene("ball", (ball,)), EXACT, [pose], points, normals, step=s) for s in (5e-4, 4e-3)
    )
    facing = ((pose[:3, 3] - points) * normals).sum(axis=1) > 0.0
    assert (fine.in_sight == facing).mean() > 0.99  # but near the rim, where the ball's own faces are in the way
    np.testing.assert_array_equal(coarse.in_sight, fine.in_sight)
    # pi / 4 of 20 mm squared, by steps of 4 mm at a metre: three pulses fall within 1.6 m, and it stands 2.7 m off
    assert fine.n_stations.any()
    assert not coarse.n_stations.any()


def test_the_plan_takes_the_fewest_stations_that_show_the_change():
    ball = make_ball("ball", np.array([0.0, 0.0, 1.5]), 0.5, n_rings=40)
    scene, instrument = Scene("ball", (ball,)), INSTRUMENTS["phase-2020"]
    points, normals = spread_points(ball, 2000)
    around = [stand_at([4 * np.cos(t), 4 * np.sin(t), 1.5], facing=[0, 0, 1.5]) for t in np.arange(8) * np.pi / 4]
    far = [stand_at([40.0, 0.0, 1.5], facing=[0, 0, 1.5])]
    taken, seen = plan_campaign(scene, instrument, far + around, points, normals, change=0.002, step=0.0008)
    assert 0 not in taken  # too far for three pulses a patch
    assert 3 <= len(taken) <= 5
    everything = visible_change(scene, instrument, around, points, normals, step=0.0008)
    assert (seen.smallest_change <= 0.002).sum() >= 0.95 * (everything.smallest_change <= 0.002).sum()


def test_no_station_at_all_is_refused():
    with pytest.raises(ParameterError, match="at least one station"):
        visible_change(plane_scene(), EXACT, [], POINT, UP)
