"""Repeated scans of one station: one grid, noise of their own, and the drift that was asked for."""

import dataclasses

import numpy as np
import pytest

from monitor.simulation import INSTRUMENTS, Scene, Window, simulate_scan, without_errors
from monitor.simulation.repeated import Drift, drift_of_paper_003, repeat_scan
from monitor.simulation.scenes import make_box
from projects.errors import ParameterError

EXACT = without_errors(INSTRUMENTS["faro-photon120"])
WALL = Scene("wall", (make_box("wall", np.array([3.0, -2.0, -2.0]), np.array([3.1, 2.0, 2.0]), reflectance=0.9),))
WINDOW = Window(-0.02, 0.02, -0.02, 0.02)


def ranges(scan):
    return np.linalg.norm(scan.cloud.points, axis=1)


def repeat(instrument, n_scans, **options):
    return list(repeat_scan(WALL, instrument, np.eye(4), WINDOW, n_scans=n_scans, step=0.0005, **options))


def test_repeated_scans_average_their_noise_away_by_the_root_of_their_number():
    noisy = dataclasses.replace(EXACT, noise_floor=1e-3)
    scans = repeat(noisy, 16)
    clean = simulate_scan(WALL, EXACT, np.eye(4), WINDOW, step=0.0005)
    for scan in scans:
        np.testing.assert_array_equal(scan.rows, clean.rows)
    single = [np.std(ranges(scan) - ranges(clean)) for scan in scans]
    np.testing.assert_allclose(single, 1e-3, rtol=0.06)
    mean = np.mean([ranges(scan) for scan in scans], axis=0) - ranges(clean)
    assert np.std(mean) == pytest.approx(1e-3 / 4.0, rel=0.06)  # 6561 cells: 1 % one sigma


def test_range_drifts_by_its_rate_from_scan_to_scan_and_within_each():
    scans = repeat(EXACT, 3, drift=Drift(range_rate=2e-3))
    off = np.array([ranges(scan) - ranges(repeat(EXACT, 1)[0]) for scan in scans])
    time = np.arange(3)[:, None] + scans[0].columns / 81.0
    np.testing.assert_allclose(off, 2e-3 * time, atol=2e-6)


@pytest.mark.parametrize("which", ["azimuth_rate", "elevation_rate"])
def test_an_angle_that_drifts_turns_the_true_beam_away_from_the_recorded_direction(which):
    scans = repeat(EXACT, 2, drift=Drift(**{which: 0.01}), n_subrays=1)
    time = np.arange(2)[:, None] + scans[0].columns / 81.0
    azimuth, elevation = -0.02 + 0.0005 * scans[0].columns, -0.02 + 0.0005 * scans[0].rows
    off = {"azimuth_rate": (0.01 * time, 0.0), "elevation_rate": (0.0, 0.01 * time)}[which]
    expected = 3.0 / (np.cos(azimuth + off[0]) * np.cos(elevation + off[1]))
    np.testing.assert_allclose([ranges(scan) for scan in scans], expected, atol=2e-6)


def test_the_papers_drift_explains_its_growth_of_noise_over_a_hundred_repetitions():
    spread = np.std(np.arange(100) * drift_of_paper_003().range_rate)
    assert np.hypot(0.4e-3, spread) == pytest.approx(0.8e-3, rel=0.01)


def test_no_scan_at_all_is_refused():
    with pytest.raises(ParameterError, match="n_scans = 0"):
        repeat(EXACT, 0)
