"""The simulated scanner against what a phase-shift scanner must show of planes, steps, waves and mirrors."""

import dataclasses

import numpy as np
import pytest

from monitor.simulation import (
    INSTRUMENTS,
    Body,
    Scene,
    Window,
    plane_scene,
    simulate_scan,
    stand_at,
    stream_scan,
    wave_scene,
    window_around,
    without_errors,
)
from monitor.simulation.beam import make_rays, measure_phase, sample_beam
from monitor.simulation.instruments import current_phase_scanner, faro_ls880, faro_photon120, leica_hds6000
from monitor.simulation.scanner import BLOCK_PULSES, cyclic_error, misregister, range_noise
from monitor.simulation.scenes import make_box
from projects.errors import ParameterError
from projects.transforms import apply

PHOTON = INSTRUMENTS["faro-photon120"]
EXACT = without_errors(PHOTON)


def wall(distance, *, reflectance=0.9, tilt=0.0, size=4.0):
    """Return a slab facing the scanner at the origin, its face at `distance` along x, turned by `tilt` about z."""
    body = make_box("wall", np.array([0.0, -size, -size]), np.array([0.1, size, size]), reflectance=reflectance)
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]]
    pose[0, 3] = distance
    return Scene("wall", (body.moved(pose),))


def look(scene, instrument, *, half=0.05, n=120, **options):
    window = Window(-half, half, -half, half)
    return simulate_scan(scene, instrument, np.eye(4), window, step=2 * half / n, **options)


def ranges_of(scan):
    return np.linalg.norm(scan.cloud.points, axis=1)


def test_a_plane_is_measured_to_a_micrometre_without_errors():
    scan = look(wall(5.0), EXACT)
    assert len(scan.cloud) == 121 * 121
    # The footprint's centre of power leaves the plane only by float32 and the inverse-square weight (D2/16/r = 0.2 um).
    assert np.abs(scan.cloud.points[:, 0] - 5.0).max() < 3e-6


def test_rows_count_elevations_from_below_and_columns_azimuths():
    scan = look(wall(5.0), EXACT, half=0.2, n=10)
    x, y, z = scan.cloud.points.T
    np.testing.assert_allclose(np.arctan2(y, x), -0.2 + 0.04 * scan.columns, atol=1e-12)
    np.testing.assert_allclose(np.arctan2(z, np.hypot(x, y)), -0.2 + 0.04 * scan.rows, atol=1e-12)


@pytest.mark.parametrize(("distance", "reflectance", "tilt"), [(10.0, 0.9, 0.0), (3.0, 0.2, 0.0), (8.0, 0.6, 1.0)])
def test_range_noise_grows_with_range_darkness_and_incidence(distance, reflectance, tilt):
    instrument = dataclasses.replace(EXACT, noise_floor=0.3e-3, noise_10m=0.5e-3)
    scene = wall(distance, reflectance=reflectance, tilt=tilt)
    noisy, clean = (look(scene, i, half=0.02, n=150) for i in (instrument, EXACT))
    noise = ranges_of(noisy) - ranges_of(clean)
    power = reflectance / 0.9 * np.cos(tilt) * (10.0 / distance) ** 2
    expected = np.sqrt(0.3e-3**2 + 0.5e-3**2 / power)
    assert abs(noise.std() / expected - 1.0) < 0.03  # 22801 pulses: one sigma of the ratio is 0.5 %
    assert abs(noise.mean()) < 4 * expected / np.sqrt(len(noise))


def test_cyclic_error_is_the_sum_of_its_four_waves():
    instrument = dataclasses.replace(
        EXACT, cyclic_amplitudes=(1.6e-3, 0.8e-3, 0.4e-3, 0.3e-3), cyclic_phases=(0.4, 2.1, 4.0, 5.2)
    )
    scene = wall(3.0, tilt=1.0)
    wavy, clean = (look(scene, i, half=0.25, n=80) for i in (instrument, EXACT))
    r, error = ranges_of(clean), ranges_of(wavy) - ranges_of(clean)
    design = [f(2 * np.pi * r * k / 0.6) for k in (1, 2, 3, 4) for f in (np.sin, np.cos)]
    fit = np.linalg.lstsq(np.column_stack(design), error, rcond=None)[0].reshape(4, 2)
    np.testing.assert_allclose(np.hypot(*fit.T), instrument.cyclic_amplitudes, rtol=1e-6)
    np.testing.assert_allclose(np.arctan2(fit[:, 1], fit[:, 0]) % (2 * np.pi), instrument.cyclic_phases, rtol=1e-6)
    np.testing.assert_allclose(error, cyclic_error(instrument, r), atol=1e-12)


def test_beam_has_the_moments_of_a_gaussian_profile():
    offsets, shares = sample_beam(9)
    t = (offsets**2).sum(axis=1) / 2.0
    moments = [(shares * t**k).sum() for k in range(5)]
    np.testing.assert_allclose(moments, [1, 1, 2, 6, 24], rtol=1e-12)  # of exp(-t)
    assert np.abs((shares[:, None] * offsets).sum(axis=0)).max() < 1e-15


@pytest.mark.parametrize("n", [0, 2, 3, 5, 8])
def test_odd_numbers_of_subrays_are_asked_for(n):
    with pytest.raises(ParameterError, match="allowed are 1 and odd numbers from 7"):
        sample_beam(n)


def test_beam_radius_is_a_gaussian_beams_at_every_range(rng):
    direction = np.array([[0.6, 0.48, 0.64]])
    offsets = np.array([[1.0, 0.0], [0.0, 1.0], [-0.6, 0.8]])
    rays = make_rays(
        np.array([1.0, 2.0, 0.5]),
        direction,
        offsets,
        exit_sigma=8e-4,
        divergence_sigma=4e-5,
        twist=rng.uniform(0, 6, 1),
    ).astype(float)[0]
    for r in (0.0, 5.0, 20.0, 50.0):
        off = rays[:, :3] + r * rays[:, 3:] - np.array([1.0, 2.0, 0.5]) - r * direction
        np.testing.assert_allclose(np.linalg.norm(off, axis=1), np.hypot(8e-4, 4e-5 * r), atol=2e-6)


def test_phase_of_two_surfaces_is_that_of_their_phasors(rng):
    t = np.array([[2.0, 2.1], [2.0, 2.25], [7.3, 7.31]])
    powers = rng.uniform(0.2, 1.0, (3, 2))
    ranges, amplitudes = measure_phase(t, powers, 0.6)
    z = (powers * np.exp(2j * np.pi * t / 0.6)).sum(axis=1)
    np.testing.assert_allclose(np.exp(2j * np.pi * ranges / 0.6), z / np.abs(z), atol=1e-9)
    np.testing.assert_allclose(amplitudes, np.abs(z), rtol=1e-12)
    assert ((ranges > t[:, 0]) & (ranges < t[:, 1])).all()
    assert np.isnan(measure_phase(np.array([[np.inf]]), np.zeros((1, 1)), 0.6)[0][0])


def test_mixed_pixels_arise_at_a_silhouette_and_only_within_the_footprint():
    front = make_box("front", np.array([2.0, 0.0, -1.0]), np.array([2.01, 1.0, 1.0]))
    back = make_box("back", np.array([2.1, -2.0, -2.0]), np.array([2.2, 2.0, 2.0]))
    scan = look(Scene("edge", (front, back)), EXACT, half=0.004, n=100)
    x, y, _ = scan.cloud.points.T
    mixed = (x > 2.0 + 1e-4) & (x < 2.1 - 1e-4)
    assert 0.05 < mixed.mean() < 0.6
    assert len(scan.cloud) == 101**2  # none is lost, whatever the ranges it mixes
    reach = 3.1 * 0.25 * np.hypot(0.0033, 0.16e-3 * 2.0)  # the outermost sub-ray, 3.08 sigma from the axis
    assert np.abs(y[mixed]).max() <= reach * 1.05
    single = look(Scene("edge", (front, back)), EXACT, half=0.004, n=100, n_subrays=1).cloud.points[:, 0]
    assert np.minimum(np.abs(single - 2.0), np.abs(single - 2.1)).max() < 1e-4


def test_mixed_pixels_of_very_different_ranges_do_not_dazzle():
    front = make_box("front", np.array([0.7, 0.0, -1.0]), np.array([0.71, 1.0, 1.0]))
    back = make_box("back", np.array([9.0, -9.0, -9.0]), np.array([9.2, 9.0, 9.0]))
    glossy = Body("front", front.vertices, front.faces, 0.6, gloss=1e-6)
    scan = look(Scene("edge", (glossy, back)), EXACT, half=0.004, n=100)
    assert len(scan.cloud) > 0.98 * 101**2  # sub-rays cancel in phase, and fall below the least power, here and there


def test_footprint_flattens_waves_as_a_gaussian_filter_does():
    scene = wave_scene(wavelength=0.01, amplitude=0.0005, size=0.2)
    pose = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 3.0], [0.0, 0.0, 0.0, 1.0]])
    window = Window(-0.025, 0.025, -0.025, 0.025)
    scan = simulate_scan(scene, EXACT, pose, window, step=0.0005)
    x, _, z = apply(scan.pose, scan.cloud.points).T
    kept = 2.0 * (z * np.cos(2 * np.pi * x / 0.01)).mean()
    sigma = 0.25 * np.hypot(0.0033, 0.16e-3 * 3.0)
    assert kept == pytest.approx(0.0005 * np.exp(-0.5 * (2 * np.pi * sigma / 0.01) ** 2), rel=0.02)


def test_a_glossy_surface_shows_what_stands_in_its_mirror():
    mirror = make_box("glaze", np.array([3.0, -2.0, -2.0]), np.array([3.1, 2.0, 2.0]), reflectance=0.0)
    mirror = Body(mirror.name, mirror.vertices, mirror.faces, 0.0, gloss=0.8)
    behind = make_box("wall behind", np.array([-2.1, -5.0, -5.0]), np.array([-2.0, 5.0, 5.0]), reflectance=0.9)
    # 0.2 rad off the perpendicular, where the glaze throws nothing straight back.
    scan = simulate_scan(Scene("glaze", (mirror, behind)), EXACT, np.eye(4), Window(0.2, 0.24, -0.02, 0.02), step=0.002)
    np.testing.assert_allclose(scan.cloud.points[:, 0], 3.0 + 3.0 + 2.0, atol=1e-3)
    # The light passes the mirror there and back; the wall behind is met under the angle that left the scanner.
    azimuth, elevation = 0.2 + 0.002 * scan.columns, -0.02 + 0.002 * scan.rows
    expected = 0.9 * 0.8**2 * np.cos(azimuth) * np.cos(elevation)
    assert np.mean(scan.cloud.intensity / expected) == pytest.approx(1.0, abs=0.005)  # 2 % of noise, 441 pulses: 0.1 %


def test_a_glossy_surface_dazzles_where_it_faces_the_scanner():
    glaze = make_box("glaze", np.array([3.0, -2.0, -2.0]), np.array([3.1, 2.0, 2.0]), reflectance=0.3)
    glaze = Body(glaze.name, glaze.vertices, glaze.faces, 0.3, gloss=0.04)
    blind = dataclasses.replace(EXACT, saturation=1e9)
    window = Window(-0.06, 0.06, -1e-4, 1e-4)
    bright = simulate_scan(Scene("glaze", (glaze,)), blind, np.eye(4), window, step=1e-4, n_subrays=1)
    azimuth = np.abs(np.arctan2(bright.cloud.points[:, 1], bright.cloud.points[:, 0]))
    # Beckmann's lobe: 0.04 / (4 m^2) = 25 white surfaces on the axis, falling as exp(-tan^2 / m^2).
    expected = 0.3 * np.cos(azimuth) + 25.0 * np.exp(-((np.tan(azimuth) / 0.02) ** 2)) / np.cos(azimuth) ** 5
    assert bright.cloud.intensity.max() == 1.0  # clipped, as an instrument's file holds it
    seen = look(Scene("glaze", (glaze,)), EXACT, half=0.06, n=120)
    lost = 121**2 - len(seen.cloud)
    turn = np.hypot(*np.meshgrid(*2 * [np.linspace(-0.06, 0.06, 121)]))
    faint = np.sort(azimuth[expected > EXACT.saturation])[-1]
    assert abs(lost / (turn < faint).sum() - 1.0) < 0.05
    assert lost > 300


def test_a_scan_is_the_same_for_any_number_of_threads_and_changes_with_its_seed():
    scans = [look(wall(4.0), PHOTON, n=400, seed=s, n_threads=t) for s, t in ((3, 1), (3, 2), (4, 2))]
    np.testing.assert_array_equal(scans[0].cloud.points, scans[1].cloud.points)
    assert not np.array_equal(scans[0].cloud.points, scans[2].cloud.points)


def test_what_lies_out_of_range_is_not_reported_but_counted():
    near = dataclasses.replace(EXACT, range_min=2.0, range_max=6.0)
    for distance, seen in ((1.9, 0), (4.0, 441), (6.1, 0)):
        scan = look(wall(distance), near, half=0.01, n=20)
        assert len(scan.cloud) == seen
        assert scan.dropped["no return"] == 441 - seen


def test_dropouts_have_their_share():
    scan = look(wall(4.0), dataclasses.replace(EXACT, dropout=0.1), n=200)
    n = 201 * 201
    assert abs(scan.dropped["no return"] - 0.1 * n) < 4 * np.sqrt(0.09 * n)


def test_the_trunnion_axis_error_turns_high_points_aside():
    tilted = dataclasses.replace(EXACT, trunnion_error=1e-3)
    scene, window = wall(5.0, tilt=0.6), Window(-0.01, 0.01, 0.5, 0.7)
    off, straight = (simulate_scan(scene, i, np.eye(4), window, step=0.005) for i in (tilted, EXACT))
    azimuth, elevation = 0.005 * off.columns - 0.01, 0.5 + 0.005 * off.rows
    # Range along a beam to the plane cos(a)(x - 5) + sin(a) y = 0.
    true = 5.0 * np.cos(0.6) / (np.cos(elevation) * np.cos(azimuth + 1e-3 * np.tan(elevation) - 0.6))
    # A sub-ray that meets the edge between two triangles may slip through (Embree): one pulse in a hundred at most.
    assert np.quantile(np.abs(ranges_of(off) - true), 0.99) < 5e-6
    assert np.abs(ranges_of(straight) - true).min() > 1e-4


def test_the_pose_is_what_the_registration_said(rng):
    stated = misregister(np.eye(4), rng, sigma_position=1e-3, sigma_angle=1e-4)
    scan = look(wall(4.0), EXACT, n=10, registered=stated)
    np.testing.assert_array_equal(scan.pose, stated)
    np.testing.assert_allclose(scan.cloud.points, look(wall(4.0), EXACT, n=10).cloud.points)


def test_window_holds_a_box_even_behind_the_scanner():
    pose = stand_at([3.0, 0.4, 1.0], facing=[0.0, 0.0, 0.0], heading=np.pi)
    scene = plane_scene(size=0.4)
    window = window_around(scene.bounds(), pose)
    scan = simulate_scan(scene, EXACT, pose, window, step=0.002)
    points = apply(pose, scan.cloud.points)
    assert np.ptp(points[:, 0]) == pytest.approx(0.4, abs=0.02)
    assert window.azimuth_max - window.azimuth_min < 0.3


def test_power_below_zero_light_gives_no_noise_of_its_own():
    assert range_noise(dataclasses.replace(EXACT, noise_floor=1e-3), np.array([0.0, 1.0])) == pytest.approx(1e-3)


def test_presets_state_a_footprint_and_noise_of_their_sources():
    # Paper 003, section 1.2.2: spot of the HDS 6000 3 mm at 3.5 m; paper 001, section 4.1: noise 0.3 to 0.5 mm in 10 m.
    leica = INSTRUMENTS["leica-hds6000"]
    assert np.hypot(leica.beam_diameter, 3.5 * leica.beam_divergence) == pytest.approx(0.003, abs=2e-4)
    assert 0.3e-3 < range_noise(PHOTON, np.array([1.0]))[0] < 0.5e-3


@pytest.mark.parametrize(
    "maker", [faro_ls880, faro_photon120, leica_hds6000, current_phase_scanner], ids=lambda maker: maker.__name__
)
def test_presets_say_which_of_their_figures_have_a_source_and_which_are_assumed(maker):
    told = " ".join((maker.__doc__ or "").split())
    assert "Source" in told
    assert "ssumed" in told
    assert "Trunnion axis" in told
    assert maker().trunnion_error == 0.0  # none is known: whoever finds a figure writes it there with its source
    assert maker() in INSTRUMENTS.values()


def test_the_presets_hold_what_the_papers_state():
    ls880, leica, current = (INSTRUMENTS[name] for name in ("faro-ls880", "leica-hds6000", "phase-2020"))
    # Paper 000, section 2.1: waves of 0.6, 0.3, 0.2 and 0.15 m; 002: the whole effect stays below 3 mm.
    r = np.linspace(1.0, 1.6, 2000)
    assert ls880.cyclic_wavelength == 0.6
    assert len(ls880.cyclic_amplitudes) == 4
    assert 0.0015 < np.abs(cyclic_error(ls880, r)).max() < 0.003
    # 000, fig. 1: median absolute deviation of a plane patch 1 mm before and 0.4 mm after the calibration.
    noise = np.random.default_rng(1).normal(size=200_000) * range_noise(ls880, np.array([(10.0 / 4.0) ** 2 * 0.6]))
    assert np.median(np.abs(noise)) == pytest.approx(0.4e-3, abs=0.05e-3)
    waves = np.random.default_rng(2).uniform(2.0, 5.0, 200_000)
    assert np.median(np.abs(noise + cyclic_error(ls880, waves))) == pytest.approx(1.0e-3, abs=0.1e-3)
    # 003, section 4.1: 0.009 degrees is 0.5 mm at 3.5 m, 79 m; 1.2.2: about 4 mm at 5 m with the motion of the beam.
    assert 3.5 * leica.angular_step == pytest.approx(0.0005, abs=0.00006)
    assert (leica.range_min, leica.range_max) == (1.0, 79.0)
    swept = np.hypot(leica.beam_diameter, 5.0 * leica.beam_divergence) + 5.0 * leica.angular_step * leica.smear
    assert swept == pytest.approx(0.004, abs=0.0001)
    # Helios's catalogue: 300 degrees of the vertical circle; 2.12 mm to 1/e is 3.0 mm to 1/e2.
    assert np.degrees(current.elevation_min) == pytest.approx(-60.0)
    assert current.beam_diameter == pytest.approx(2.12e-3 * np.sqrt(2.0), rel=0.002)


def test_the_beam_sweeps_one_step_upwards_while_it_measures():
    swept = dataclasses.replace(EXACT, smear=1.0, beam_diameter=0.0, beam_divergence=0.0)
    # An even sweep of 2 mm keeps sin(x) / x of a wave of 10 mm across it, x = 0.2 pi, and all of one along it.
    for turn, kept in ((0.0, np.sin(0.2 * np.pi) / (0.2 * np.pi)), (np.pi / 2, 1.0)):
        scene = wave_scene(wavelength=0.01, amplitude=0.0005, size=0.2)
        pose = np.eye(4)
        pose[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
        pose[:3, 3] = [0.0, 0.0, 2.0]
        pose = turned_about_view(turn) @ pose
        scan = simulate_scan(scene, swept, pose, Window(-0.02, 0.02, -0.02, 0.02), step=0.001)
        x, _, z = apply(scan.pose, scan.cloud.points).T
        amplitude = 2.0 * (z * np.cos(2 * np.pi * x / 0.01)).mean() / (2.0 * (np.cos(2 * np.pi * x / 0.01) ** 2).mean())
        assert amplitude == pytest.approx(0.0005 * kept, rel=0.005)


def turned_about_view(angle):
    """Return a rotation about z, along which the scanner of the wave tests looks."""
    turned = np.eye(4)
    turned[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return turned


def test_angular_noise_moves_what_is_met_and_not_the_direction_told():
    shaky = dataclasses.replace(EXACT, angular_noise=2e-4)
    scene = wall(5.0, tilt=1.0)
    noisy, clean = (look(scene, i, half=0.02, n=150, n_subrays=1) for i in (shaky, EXACT))
    np.testing.assert_allclose(
        noisy.cloud.points / ranges_of(noisy)[:, None], clean.cloud.points / ranges_of(clean)[:, None], atol=1e-12
    )
    # On a plane turned by 1 rad the range changes by r tan(a) for an azimuth error; elevation errors fall out here.
    slope = ranges_of(clean) * np.tan(np.arctan2(clean.cloud.points[:, 1], clean.cloud.points[:, 0]) - 1.0)
    error = (ranges_of(noisy) - ranges_of(clean)) / slope
    assert np.std(error) == pytest.approx(2e-4, rel=0.03)  # 22801 pulses: 0.5 %


def test_the_line_of_sight_error_turns_high_points_aside_by_one_over_cosine():
    off = simulate_scan(
        wall(5.0, tilt=0.6), dataclasses.replace(EXACT, collimation_error=1e-3), np.eye(4),
        Window(-0.01, 0.01, 0.5, 0.6), step=0.005, n_subrays=1,
    )  # fmt: skip
    azimuth, elevation = 0.005 * off.columns - 0.01, 0.5 + 0.005 * off.rows
    true = 5.0 * np.cos(0.6) / (np.cos(elevation) * np.cos(azimuth + 1e-3 / np.cos(elevation) - 0.6))
    assert np.quantile(np.abs(ranges_of(off) - true), 0.99) < 5e-6


@pytest.mark.parametrize(("distance", "tilt"), [(3.0, 0.0), (9.0, 0.0), (5.0, 1.0)])
def test_intensity_is_reflectance_times_the_cosine_at_any_range(distance, tilt):
    scan = look(wall(distance, reflectance=0.5, tilt=tilt), EXACT, half=0.005, n=60)
    assert np.mean(scan.cloud.intensity) == pytest.approx(0.5 * np.cos(tilt), rel=0.01)
    assert np.std(scan.cloud.intensity) == pytest.approx(0.02 * 0.5 * np.cos(tilt), rel=0.15)


def test_a_scan_of_any_size_streams_in_blocks_of_whole_columns():
    # A full panorama at 2 pi / 40000 rad has 690 million pulses: the first block comes at once, and is small.
    stream = stream_scan(wall(5.0), EXACT, np.eye(4), Window(-0.3, 2 * np.pi - 0.3, -1.2, 1.5), n_subrays=1)
    first = next(stream)
    n_rows = int((1.5 - np.radians(-65.0)) / EXACT.angular_step) + 1
    assert len(first.cloud) + first.dropped["no return"] == BLOCK_PULSES // n_rows * n_rows
    assert first.columns.max() == BLOCK_PULSES // n_rows - 1
    stream.close()
