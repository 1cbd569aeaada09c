"""Waves in one window: found where they are and nowhere else, as high as they are however steep."""

from __future__ import annotations

import numpy as np
import pytest

from monitor.reconstruction.bends import leave_of_bend
from monitor.reconstruction.periodogram import (
    COSINES,
    HIGHEST,
    LOWEST,
    SINES,
    SURE_OF_PATTERN,
    alike_beside,
    pattern_in,
    strongest_waves,
    sum_in_cells,
)
from monitor.reconstruction.waves import (
    N_BENT,
    add_turns,
    error2_at,
    find_waves,
    fit_distances,
    freedom_of,
    leave_distances,
    shape_at,
    window_room,
)
from projects.model import Floats

N = 800
NOISE = 0.025  # of the radius: 0.4 mm of 16 mm
Wave = tuple[float, float, float]  # amplitude, and waves a radius along u and v


def make_window(rng: np.random.Generator, waves: tuple[Wave, ...], noise: float = NOISE, n: int = N) -> object:
    """Return points on a bent patch with waves, noise along the normals of that."""
    away, turn = np.sqrt(rng.uniform(0.0, 1.0, n)), rng.uniform(0.0, 2.0 * np.pi, n)
    u, v = away * np.cos(turn), away * np.sin(turn)
    z, slope_u, slope_v = 0.1 * u**2 - 0.05 * u * v, 0.2 * u - 0.05 * v, -0.05 * u
    for amplitude, f_u, f_v in waves:
        phase = 2.0 * np.pi * (f_u * u + f_v * v) + 0.7
        z = z + amplitude * np.sin(phase)
        slope_u = slope_u + 2.0 * np.pi * f_u * amplitude * np.cos(phase)
        slope_v = slope_v + 2.0 * np.pi * f_v * amplitude * np.cos(phase)
    off = noise * rng.normal(size=n) / np.sqrt(1.0 + slope_u**2 + slope_v**2)
    w = window_room(n)
    w.u[:], w.v[:], w.z[:] = u - off * slope_u, v - off * slope_v, z + off
    return w


def amplitudes_of(w: object, n_waves: int) -> Floats:
    """Return the amplitude of each wave of a window."""
    pairs = w.coefficients[N_BENT : N_BENT + 2 * n_waves].reshape(-1, 2)  # type: ignore[attr-defined]
    return np.hypot(*pairs.T)


@pytest.mark.parametrize(("f_u", "f_v"), [(3.2, 0.0), (-1.4, 2.1), (0.0, 4.2)])
def test_a_wave_is_found_where_it_is(rng: np.random.Generator, f_u: float, f_v: float) -> None:
    w = make_window(rng, ((0.02, f_u, f_v),))
    n_waves, variance, _, _ = find_waves(w, N, HIGHEST, COSINES, SINES)
    assert n_waves == 1
    variance, _ = fit_distances(w, N, n_waves, variance)
    assert abs(w.frequencies[0]) == pytest.approx([abs(f_u), abs(f_v)], abs=0.15)
    assert amplitudes_of(w, 1)[0] == pytest.approx(0.02, rel=0.25)
    assert np.sqrt(variance) == pytest.approx(NOISE, rel=0.08)


def test_two_waves_are_found_and_no_third(rng: np.random.Generator) -> None:
    w = make_window(rng, ((0.03, 2.0, 1.0), (0.02, -1.0, 3.0)))
    n_waves, variance, _, _ = find_waves(w, N, HIGHEST, COSINES, SINES)
    assert n_waves == 2
    fit_distances(w, N, n_waves, variance)
    assert amplitudes_of(w, 2) == pytest.approx([0.03, 0.02], rel=0.2)


def test_noise_and_a_bend_are_no_waves(rng: np.random.Generator) -> None:
    """Chance finds one in thousands of windows."""
    found = [find_waves(make_window(rng, ()), N, HIGHEST, COSINES, SINES)[0] for _ in range(60)]
    assert sum(found) == 0


@pytest.mark.parametrize("length", [5.0, 9.0])
def test_a_bend_of_fourth_degree_is_no_wave(rng: np.random.Generator, length: float) -> None:
    """A part of a wave longer than the window, six times as high as the noise: a patch of second degree leaves two."""
    for _ in range(10):
        w = make_window(rng, ((6.0 * NOISE, 0.9 / length, 1.8 / length),))
        n_waves, variance, _, _ = find_waves(w, N, HIGHEST, COSINES, SINES)
        assert n_waves == 0
        assert np.sqrt(variance) == pytest.approx(NOISE, rel=0.1)


def test_a_long_wave_is_one_wave(rng: np.random.Generator) -> None:
    """A patch takes of 1.6 waves over a window what bends, and what it leaves seems shorter: two were found in all."""
    n_found = []
    for _ in range(20):
        w = make_window(rng, ((0.06, 0.8, 0.0),))
        n_waves, variance, _, _ = find_waves(w, N, HIGHEST, COSINES, SINES)
        n_found.append(n_waves)
        assert np.hypot(*w.frequencies[0]) == pytest.approx(0.8, abs=0.08)  # type: ignore[attr-defined]
        assert np.sqrt(variance) == pytest.approx(NOISE, rel=0.12)
    assert np.mean(n_found) < 1.3  # chance finds a second one in 3 of 100


def test_a_bend_leaves_what_it_cannot_follow(rng: np.random.Generator) -> None:
    w = make_window(rng, ())
    w.z[:] = 1.0 + w.u * w.v**3 - 2.0 * w.u**4 + w.v**2  # type: ignore[attr-defined]
    assert leave_of_bend(w, N) == pytest.approx(0.0, abs=1e-12)
    w.z[:] += 0.1 * np.sin(40.0 * w.u) + NOISE * rng.normal(size=N)  # type: ignore[attr-defined]
    assert leave_of_bend(w, N) == pytest.approx(0.005 + NOISE**2, rel=0.06)
    assert np.isnan(leave_of_bend(w, 30))


def test_a_faint_wave_costs_twice_what_a_plain_one_does(rng: np.random.Generator) -> None:
    w = make_window(rng, ((0.02, 2.0, 0.5),))
    n_waves, variance, _, _ = find_waves(w, N, HIGHEST, COSINES, SINES)
    assert freedom_of(w, N, n_waves, variance) == pytest.approx(
        6.0 + 4.0 + 4.0 * 34.0 / (N * 0.02**2 / 4 / NOISE**2), rel=0.1
    )
    assert freedom_of(w, N, n_waves, 100.0 * variance) == 14.0
    assert freedom_of(w, N, n_waves, 1e-4 * variance) == pytest.approx(10.0, abs=0.01)


def test_distances_are_left_not_heights(rng: np.random.Generator) -> None:
    """Slopes of up to 17 degrees: heights are off by 1.02 times as much in the mean."""
    w = make_window(rng, ((0.024, 2.0, 0.0),))
    n_waves, heights, _, _ = find_waves(w, N, HIGHEST, COSINES, SINES)
    upright = w.left.copy()  # type: ignore[attr-defined]
    distances = leave_distances(w, N, n_waves)
    assert distances == pytest.approx(float(np.sum(w.left**2)) / (N - 8))  # type: ignore[attr-defined]
    assert (abs(w.left) <= abs(upright) + 1e-15).all()  # type: ignore[attr-defined]
    assert distances < 0.99 * heights


def test_no_wave_is_shorter_than_faces_can_show(rng: np.random.Generator) -> None:
    """It is told, a third too small in its square, as means over cells and noise along the normals flatten it."""
    told = []
    for _ in range(20):
        w = make_window(rng, ((0.02, 4.5, 0.0),), 0.4 * NOISE)
        n_waves, _, above, left2 = find_waves(w, N, 3.5, COSINES, SINES)
        assert n_waves == 0
        assert np.hypot(*above) == pytest.approx(4.5, abs=0.3)
        told.append(left2)
        power, f_u, f_v, _, shorter = strongest_waves(w.spectrum, N, 0.16 * NOISE**2, HIGHEST, COSINES, SINES)
        assert (abs(f_u), abs(f_v)) == pytest.approx((4.5, 0.0), abs=0.3)
        assert power == pytest.approx(0.5 * N * left2 / (0.16 * NOISE**2), rel=0.1)
        assert shorter == (0.0, 0.0)
    assert np.mean(told) == pytest.approx(0.65 * 0.5 * 0.02**2, rel=0.15)


def test_steep_waves_are_not_flattened_by_noise_along_their_normals(rng: np.random.Generator) -> None:
    """Slopes of up to 51 degrees: a regression of heights has 0.82 of the amplitude, as points lie aside."""
    low, right = [], []
    for _ in range(6):
        w = make_window(rng, ((0.0625, 3.2, 0.0),))
        n_waves, variance, _, _ = find_waves(w, N, HIGHEST, COSINES, SINES)
        low.append(amplitudes_of(w, n_waves)[0])
        variance, _ = fit_distances(w, N, n_waves, variance)
        right.append(amplitudes_of(w, n_waves)[0])
        assert np.sqrt(variance) == pytest.approx(NOISE, rel=0.12)
    assert np.mean(low) < 0.9 * 0.0625
    assert np.mean(right) == pytest.approx(0.0625, rel=0.05)


def test_error_of_a_height_is_as_large_as_it_scatters(rng: np.random.Generator) -> None:
    """300 windows: the scatter is known to 6 %; with frequencies taken for known it is 1.3 times what is stated."""
    off, stated = [], []
    for _ in range(300):
        w = make_window(rng, ((0.02, 2.0, 0.5),))
        n_waves, variance, _, _ = find_waves(w, N, HIGHEST, COSINES, SINES)
        variance, _ = fit_distances(w, N, n_waves, variance)
        height, _, _ = shape_at(0.2, -0.1, w.frequencies, n_waves, w.coefficients, w.row)
        truth = 0.1 * 0.2**2 + 0.05 * 0.2 * 0.1 + 0.02 * np.sin(2.0 * np.pi * (2.0 * 0.2 - 0.5 * 0.1) + 0.7)
        off.append(height - truth)
        add_turns(0.2, -0.1, n_waves, w.coefficients, w.row)
        stated.append(error2_at(w, n_waves, variance))
    scatter = 1.483 * np.median(np.abs(np.asarray(off) - np.median(off)))
    assert scatter / np.sqrt(np.median(stated)) == pytest.approx(1.0, abs=0.15)


def test_points_far_off_do_not_count(rng: np.random.Generator) -> None:
    w = make_window(rng, ((0.03, 2.0, 0.0),))
    w.z[:24] += 0.4  # type: ignore[attr-defined]
    n_waves, variance, _, _ = find_waves(w, N, HIGHEST, COSINES, SINES)
    variance, _ = fit_distances(w, N, n_waves, variance)
    assert np.sqrt(variance) == pytest.approx(NOISE, rel=0.1)
    assert amplitudes_of(w, n_waves)[0] == pytest.approx(0.03, rel=0.12)


def test_pattern_is_told_from_noise(rng: np.random.Generator) -> None:
    """Waves of 0.7 of the noise are a pattern; of noise alone some hundredths pass for one."""
    alone = []
    for _ in range(200):
        w = make_window(rng, ())
        sum_in_cells(w.u, w.v, NOISE * rng.normal(size=N), N, w.spectrum)
        alone.append(pattern_in(w.spectrum, NOISE**2) > SURE_OF_PATTERN)
    assert np.mean(alone) < 0.08
    w = make_window(rng, ())
    sum_in_cells(w.u, w.v, 0.7 * NOISE * np.sin(30.0 * w.u) + NOISE * rng.normal(size=N), N, w.spectrum)
    assert pattern_in(w.spectrum, NOISE**2) > 4.0 * SURE_OF_PATTERN


def test_what_is_alike_beside_is_what_is_no_noise(rng: np.random.Generator) -> None:
    """Of slow waves of 0.02 the mean square is 0.0002; white noise adds nothing in the mean."""
    told = []
    for _ in range(20):
        w = make_window(rng, ())
        sum_in_cells(w.u, w.v, 0.02 * np.sin(6.0 * w.u) + NOISE * rng.normal(size=N), N, w.spectrum)
        told.append(alike_beside(w.spectrum))
    assert np.mean(told) == pytest.approx(2e-4, rel=0.15)


def test_lowest_wave_is_no_bend() -> None:
    assert LOWEST * 2.0 > 0.5  # half a wave across the window
