"""The cyclic range error found in scans of a room whose walls are known (Nothegger and Dorninger 2007, section 2.1)."""

import dataclasses

import numpy as np
import pytest
from scanned_room import FARO, scan_room, uneven_plaster

from monitor.filtering import CalibrationSettings, calibrate_range, correct_range
from monitor.filtering.calibration import _too_few
from monitor.filtering.cyclic_adjustment import adjust_waves, prepare_patches
from monitor.filtering.patches import PlanePatches
from monitor.simulation.instruments import without_errors
from monitor.simulation.scanner import cyclic_error
from projects.formats import read_scans
from projects.model import PointCloud, Scan

KNOWN = CalibrationSettings(wavelength=0.6)
STEADY = dataclasses.replace(FARO, cyclic_amplitudes=(0.0,) * 4)
TRUE = np.array(FARO.cyclic_amplitudes)


def turn_between(phases, truth):
    """Return the difference of angles, -pi to pi."""
    return (np.asarray(phases) - truth + np.pi) % (2 * np.pi) - np.pi


def test_amplitudes_phases_and_noise_are_found(rng):
    """0.05 mm is asked; four sigma of the adjustment are less. What is left is the MAD of the room without error."""
    seed = int(rng.integers(1 << 30))
    found = calibrate_range(scan_room(np.random.default_rng(seed)), KNOWN)
    steady = calibrate_range(scan_room(np.random.default_rng(seed), instrument=STEADY), KNOWN)
    assert found.is_applied, found.reason
    assert np.allclose(found.amplitudes, TRUE, atol=0.05e-3)
    assert np.allclose(turn_between(found.phases, FARO.cyclic_phases), 0.0, atol=0.05e-3 / TRUE)
    sigma = np.sqrt(np.diag(found.covariance))
    assert (np.abs(found.amplitudes - TRUE) < 4 * sigma[:4]).all()
    assert sigma[:4].max() < 0.02e-3
    assert np.isclose(found.mad_after, steady.mad_before, rtol=0.05)
    assert found.mad_before > 1.5 * found.mad_after
    assert found.n_walls >= 5


def test_a_scan_without_cyclic_error_is_left_alone(rng):
    scan = scan_room(rng, instrument=STEADY)
    found = calibrate_range(scan, KNOWN)
    assert not found.is_applied
    assert "by chance" in found.reason
    assert correct_range(scan, found) is scan


def test_a_wall_that_is_no_plane_does_not_bend_the_result(rng):
    """One wall with waves of 0.6 m about the foot of its perpendicular, 4 mm high: by itself it would say 4 mm."""

    def relief(wall, aside):
        return 4e-3 * np.sin(2 * np.pi * np.linalg.norm(aside, axis=1) / 0.6) if wall == 2 else np.zeros(len(aside))

    found = calibrate_range(scan_room(rng, relief=relief), KNOWN)
    assert found.is_applied, found.reason
    assert np.allclose(found.amplitudes, TRUE, atol=0.05e-3)


@pytest.mark.parametrize("rms", [0.3e-3, 1e-3])
def test_uneven_walls_say_how_little_they_know(rng, rms):
    """Plaster uneven over 0.6 m, the very length of the error: the sigma grows with it and holds the error."""
    found = calibrate_range(scan_room(rng, relief=uneven_plaster(rng, rms, 0.6)), KNOWN)
    assert found.is_applied, found.reason
    sigma = np.sqrt(np.diag(found.covariance))[:4]
    assert (np.abs(found.amplitudes - TRUE) < 4 * sigma).all()
    assert (sigma < 0.1 * rms).all()


def test_uneven_walls_alone_are_no_cyclic_error(rng):
    found = calibrate_range(scan_room(rng, instrument=STEADY, relief=uneven_plaster(rng, 1e-3, 0.6)), KNOWN)
    assert not found.is_applied, found.reason


def test_waves_larger_than_an_instrument_makes_are_the_shape_of_the_walls(rng):
    """All walls wave alike by 6 mm about the scanner, beyond the 5 mm of `max_amplitude`."""
    bad = dataclasses.replace(FARO, cyclic_amplitudes=(0.006, 0.0, 0.0, 0.0))
    scan = scan_room(rng, instrument=bad)
    found = calibrate_range(scan, dataclasses.replace(KNOWN, max_amplitude=0.008))
    assert found.is_applied, found.reason
    assert np.isclose(found.amplitudes[0], 0.006, atol=0.05e-3)
    refused = calibrate_range(scan, KNOWN)
    assert not refused.is_applied
    assert "waves of up to 6.0 mm" in refused.reason


def test_a_wall_of_real_stones_is_no_range_error(real_data):
    """Half of a stretch of `vapc_rockwall`: three patches, of which one's relief had passed for waves of 9 mm."""
    (stream,) = read_scans(real_data / "vapc_rockwall" / "vapc_in.laz")
    points = np.concatenate([s.cloud.points for s in stream.chunks()])
    points = points[np.abs(points[:, 0] - np.median(points[:, 0])) < 8.0]
    own = points[(points[:, 0] >= points[:, 0].min() + 4.0) & (points[:, 0] < points[:, 0].min() + 8.0)]
    half = np.round(own[np.random.default_rng([1, 171]).random(len(own)) < 0.5], 5)  # as files hold it
    station = np.array([np.median(half[:, 0]), -10.0, 1.0])
    found = calibrate_range(Scan("wall", PointCloud(half), np.eye(4), origin=station))
    assert found.n_patches >= 3
    assert not found.is_applied, found.reason


def test_one_patch_alone_may_be_believed_where_that_is_asked(rng):
    scan = scan_room(rng)
    floor = scan.take(np.flatnonzero(np.abs(scan.cloud.points[:, 2] + 1.6) < 0.02))
    found = calibrate_range(floor, dataclasses.replace(KNOWN, min_patches=1))
    assert found.is_applied, found.reason
    assert np.allclose(found.amplitudes, TRUE, atol=0.1e-3)


def test_the_wavelength_is_found_where_no_preset_gives_it(rng):
    found = calibrate_range(scan_room(rng))
    assert found.is_applied, found.reason
    assert np.allclose(found.wavelengths, 0.6 / np.arange(1, 5), rtol=0.003)
    assert np.allclose(found.amplitudes, TRUE, atol=0.05e-3)


def test_what_is_stated_of_the_waves_holds_that_their_length_was_found(rng):
    """With the length taken for known the mean square of errors over sigma is 8, and phases err by four of theirs."""
    misfits = []
    true = np.concatenate([TRUE * np.cos(FARO.cyclic_phases), TRUE * np.sin(FARO.cyclic_phases)])
    for _ in range(8):
        found = calibrate_range(scan_room(rng))
        sines, cosines, sizes = np.sin(found.phases), np.cos(found.phases), found.amplitudes
        turn = np.block(
            [[np.diag(cosines), np.diag(-sizes * sines)], [np.diag(sines), np.diag(sizes * cosines)]],
        )
        error = np.concatenate([sizes * cosines, sizes * sines]) - true
        misfits.append(error @ np.linalg.solve(turn @ found.covariance @ turn.T, error) / 8)
        assert found.wavelengths[0] == pytest.approx(0.6, abs=7e-4)
    assert 0.6 < np.mean(misfits) < 1.5  # the root of 2 / 64 is 0.18


def test_points_are_moved_along_their_beams_by_the_error_at_the_true_range(rng):
    beams = rng.normal(size=(500, 3))
    beams /= np.linalg.norm(beams, axis=1)[:, None]
    true, origin = rng.uniform(1, 9, 500), np.array([0.3, -0.2, 1.0])
    measured = origin + beams * (true + cyclic_error(FARO, true))[:, None]
    found = dataclasses.replace(
        calibrate_range(Scan("nothing", PointCloud(np.zeros((1, 3))), np.eye(4)), KNOWN), is_applied=True,
        wavelengths=0.6 / np.arange(1, 5), amplitudes=TRUE, phases=np.array(FARO.cyclic_phases),
    )  # fmt: skip
    corrected = correct_range(Scan("scan", PointCloud(measured), np.eye(4), origin=origin), found)
    assert np.allclose(corrected.cloud.points, origin + beams * true[:, None], atol=1e-6)


def test_how_many_patches_there_were_is_told_in_proper_words():
    assert _too_few(1, "the longest wavelength", KNOWN).startswith("1 plane patch spans the longest wavelength; 3 are")
    one = dataclasses.replace(KNOWN, min_patches=1)
    assert _too_few(0, "it", one) == "0 plane patches span it; 1 is needed"


def test_without_planes_or_with_too_small_ones_nothing_is_said(rng):
    beams = rng.normal(size=(5000, 3))
    beams *= (3 + 0.2 * np.sin(4 * beams[:, :1])) / np.linalg.norm(beams, axis=1)[:, None]
    small = np.c_[rng.uniform(-0.5, 0.5, (5000, 2)), 3 + rng.normal(0, 1e-4, 5000)]  # ranges of 3.0 to 3.08 m
    for points in (beams, small, small[:200]):
        found = calibrate_range(Scan("scan", PointCloud(points), np.eye(4)), KNOWN)
        assert not found.is_applied
        assert "0 plane patches span the longest wavelength; 3 are needed" in found.reason
        assert np.isnan(found.amplitudes).all()


def test_without_a_known_station_nothing_is_said(rng):
    scan = dataclasses.replace(scan_room(rng, n_points=2000), origin=np.full(3, np.nan))
    assert calibrate_range(scan).reason == "it is not known where the scanner stood"


def test_the_order_of_the_points_changes_nothing(rng):
    scan = scan_room(rng, n_points=50_000)
    here = calibrate_range(scan, KNOWN)
    there = calibrate_range(scan.take(rng.permutation(len(scan.cloud))), KNOWN)
    assert np.array_equal(here.amplitudes, there.amplitudes)
    assert np.array_equal(here.profile, there.profile)


def test_a_perfect_instrument_in_a_perfect_room_is_left_alone(rng):
    found = calibrate_range(scan_room(rng, instrument=without_errors(FARO), noise=0.0), KNOWN)
    assert not found.is_applied or found.amplitudes.max() < 1e-6


def slanted_patches(rng, relief, n_points=500):
    """Return three patches, 2 m wide and 3 m away, whose walls are uneven by `relief` of points on them (m, 2) [m]."""
    points = []
    for _ in range(3):
        aside = rng.uniform([1.0, -1.0], [3.0, 1.0], (n_points, 2))
        points.append(np.c_[aside, 3.0 + relief(aside)])
    number = np.repeat(np.arange(3), n_points)
    return prepare_patches(PlanePatches(np.concatenate(points), number, np.arange(3)))


def misfit(adjusted):
    """Return the mean square of the coefficients over their sigmas, correlations in it; the true ones are 0."""
    c = adjusted.coefficients
    return float(c @ adjusted.normal @ c) / len(c)


def test_the_covariance_is_that_of_the_robust_estimate(rng):
    """Told by the mean of w r^2, variances are 14 % too small: 1.16; the root of 2 / 1200 is 0.04."""

    def found():
        patches = slanted_patches(rng, lambda aside: rng.normal(0, 1e-3, len(aside)))
        alone = [dataclasses.replace(p, cells=(np.arange(len(p.ranges)),)) for p in patches]
        return misfit(adjust_waves(alone, np.array([0.6])))

    assert np.isclose(np.mean([found() for _ in range(600)]), 1.0, atol=0.1)


def test_the_sigma_of_uneven_walls_holds_what_their_shape_has_taken_of_the_unevenness(rng):
    """Of ten cells the six terms of a patch's shape follow six: told by what is left, the mean square is 1.75."""
    relief = uneven_plaster(rng, 1e-3, 0.5)

    def found():
        patches = slanted_patches(rng, lambda aside: relief(0, aside) + rng.normal(0, 3e-4, len(aside)))
        return misfit(adjust_waves(patches, np.array([0.6])))

    assert 1.0 < np.mean([found() for _ in range(300)]) < 1.5
