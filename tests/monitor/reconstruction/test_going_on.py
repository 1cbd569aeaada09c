"""Waves of a window that go on beyond it, told from what stands out of noise in one place only."""

from __future__ import annotations

import numpy as np
import pytest

from monitor.reconstruction.going_on import AGAIN, DRIFT, PLAIN, SURE, has_like, keep_beyond, stand_out, turn_into
from monitor.reconstruction.periodogram import STEP
from monitor.reconstruction.waves import window_room
from projects.model import Floats

N = 800


def make_window(rng: np.random.Generator, left: Floats | None = None) -> object:
    """Return a window of points with what is left of them; noise of 1 where that is not given."""
    away, turn = np.sqrt(rng.uniform(0.0, 1.0, N)), rng.uniform(0.0, 2.0 * np.pi, N)
    w = window_room(N)
    w.u[:], w.v[:], w.z[:] = away * np.cos(turn), away * np.sin(turn), 0.0
    w.left[:] = rng.normal(size=N) if left is None else left
    return w


def test_a_wave_stands_out_as_often_as_its_power_says(rng: np.random.Generator) -> None:
    """Of n points with noise 1 a wave of amplitude a has n a2 / 4 times the power of noise, known to a half."""
    told = []
    for _ in range(20):
        w = make_window(rng)
        w.left[:] += 0.6 * np.sin(2.0 * np.pi * 3.1 * w.u + 0.3)  # type: ignore[attr-defined]
        out, power = stand_out(w, N, 3.0, 0.2)
        told.append(out)
        assert power == pytest.approx((0.3 * N) ** 2, rel=0.3)
    assert np.median(told) == pytest.approx(N * 0.36 / 4.0, rel=0.6)
    assert min(told) > PLAIN


def test_lines_do_not_stand_out(rng: np.random.Generator) -> None:
    """32 lines across, each with an offset as large as the noise of points; the strongest of all frequencies."""
    told, again = [], []
    for _ in range(40):
        offsets = rng.normal(size=64)
        w, beside = make_window(rng), make_window(rng)
        for window, first in ((w, 0), (beside, 32)):
            lines = first + np.minimum((16.0 * (window.u + 1.0)).astype(int), 31)  # type: ignore[attr-defined]
            window.left[:] += offsets[lines]  # type: ignore[attr-defined]
        frequencies = np.arange(4, 24) * STEP
        best = frequencies[np.argmax([stand_out(w, N, f, 0.0)[1] for f in frequencies])]
        told.append(stand_out(w, N, best, 0.0)[0])
        again.append(stand_out(beside, N, best, 0.0)[0])
    assert np.mean(np.array(told) > SURE) < 0.15
    assert np.mean((np.array(told) > SURE) & (np.array(again) > AGAIN)) < 0.05


def test_points_beyond_a_window_lie_farther_along_its_waves(rng: np.random.Generator) -> None:
    for own_u in (-1.6, 1.6):
        w = make_window(rng)
        beyond = np.abs(w.u - own_u) > 1.0  # type: ignore[attr-defined]
        u = w.u[beyond].copy()  # type: ignore[attr-defined]
        n = keep_beyond(w, N, own_u, 0.4, 1.0, 0.0)
        assert np.array_equal(w.u[:n], u)  # type: ignore[attr-defined]
        assert 0 < n < N


def test_a_like_wave_is_one_of_nearly_the_same_frequency_in_reach() -> None:
    """Its sign says nothing."""
    waves = np.array([[3.0, 0.0, 0.0]])
    near = 0.9 * DRIFT * STEP
    for like, away, expected in (
        ([3.0, near, 0.0], 0.9, True),
        ([-3.0, near, 0.0], 0.9, True),
        ([3.0 + near, near, 0.0], 0.9, False),
        ([3.0, near, 0.0], 1.1, False),
    ):
        found = has_like(np.zeros((1, 3)), waves, np.array([[0.0, away, 0.0]]), np.array([like]), 1.0)
        assert found.tolist() == [expected]
    assert has_like(np.zeros((1, 3)), waves, np.empty((0, 3)), np.empty((0, 3)), 1.0).tolist() == [False]


def test_a_vector_is_turned_into_a_frame(rng: np.random.Generator) -> None:
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    vector = rng.normal(size=3)
    assert turn_into(vector, tuple(map(tuple, frame))) == pytest.approx(frame @ vector)
