"""What surfaces guess between their points counts as stated, and along a moulding as often as the moulding is long."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from monitor.comparison import compare, guesses
from monitor.comparison.correlation import Correlation
from monitor.comparison.guesses import guessed_variance, kept_of_guess, sigma_of_guess, usual_sigma
from monitor.comparison.noise import Noise
from monitor.comparison.strata import N_STRATA
from projects.model import Bools, Comparison, Floats, Registration, Roughness, Surface

N, EDGE, NOISE, GUESSED = 121, 2e-3, 5e-5, 5e-4  # of the sheets; m
MOULDINGS = (10, 35, 60, 85, 110)  # rows of vertices where one begins, along all of the sheet
WIDE, LONG = 5, 40  # vertices: across a moulding, and along it what errs alike


def side_of(sigmas: list[float], roughness: list[int] | None) -> SimpleNamespace:
    """Return a side of which only what is stated of its vertices [m] and their roughness matter."""
    n, best = len(sigmas), np.zeros(len(sigmas), dtype=np.uint8)
    surface = SimpleNamespace(roughness=None if roughness is None else np.array(roughness, dtype=np.uint8))
    return SimpleNamespace(sigma_surfaces=np.array(sigmas), surface=surface, sigma_discord=np.zeros(n),
                           sigma_shared=np.zeros(n), sigma_motion=np.zeros(n), distances=np.zeros(n),
                           to_rim=np.full(n, np.nan), view=best, gap=best, arm=best)  # fmt: skip


def test_a_guess_is_what_exceeds_twice_the_usual_where_it_is_not_smooth() -> None:
    classes = [Roughness.ROUGH, Roughness.ROUGH, Roughness.SMOOTH, Roughness.MEDIUM]
    side = side_of([0.5, 1.0, 3.0, 3.0], [int(c) for c in classes])
    assert guessed_variance(side, 0.5) == pytest.approx([0.0, 0.0, 0.0, 8.0])
    assert guessed_variance(side, 0.5, np.array([3])) == pytest.approx([8.0])
    assert guessed_variance(side_of([0.5, 3.0], None), 0.5) == pytest.approx([0.0, 8.0])  # no classes: any place
    assert guessed_variance(side, np.inf) == pytest.approx(np.zeros(4))


def test_the_usual_is_the_median_of_what_the_calm_vertices_of_both_sides_state() -> None:
    first = SimpleNamespace(own=np.array([9.0, 1.0, 2.0]), places=np.array([1, 2]))
    second = SimpleNamespace(own=np.array([3.0, 4.0, 5.0]), places=np.array([0, 1, 2]))
    assert usual_sigma([first, second]) == 3.0
    nothing = SimpleNamespace(own=np.zeros(0), places=np.zeros(0, dtype=np.int64))
    assert usual_sigma([nothing, nothing]) == np.inf


def test_a_guess_counts_as_stated_and_the_rest_is_scaled() -> None:
    tenth = np.full(N_STRATA, 0.1)
    noise = Noise(np.zeros(N_STRATA), tenth, tenth, tenth, Correlation(np.zeros(1), np.ones(1)), 1.0, usual=0.5)
    side = side_of([0.5, 3.0], [int(Roughness.ROUGH)] * 2)
    assert noise.variance_of(side) == pytest.approx([0.01 * 0.25, 0.01 * 1.0])
    assert noise.guess_of(side) == pytest.approx([0.0, 8.0])
    assert noise.sigma_of(side) == pytest.approx(np.sqrt([0.0025, 8.01]))
    assert noise.sigma_of(side, np.array([1])) == pytest.approx(np.sqrt([8.01]))


def test_means_keep_what_rows_that_err_alike_keep(rng: np.random.Generator) -> None:
    rows = np.repeat(rng.normal(size=(4000, 8, 1)), 8, axis=2)  # 8 x 8 units, alike along each row
    for n in (1, 2, 4, 8):
        kept = np.mean(rows[:, :n, :n].mean(axis=(1, 2)) ** 2)
        assert kept_of_guess(np.array([n * n])) == pytest.approx([kept], rel=0.08)
    assert kept_of_guess(np.array([0.2])) == pytest.approx([1.0])


def test_a_strip_keeps_all_of_a_guess_and_a_square_what_its_rows_keep() -> None:
    x, y = (c.ravel() for c in np.meshgrid(np.arange(0.005, 1.0, 0.01), np.arange(0.005, 0.4, 0.01)))
    everywhere = np.column_stack([x, y, np.zeros(len(x))])

    def of(points: Floats) -> float:
        """Return the sigma of the mean of what errs by 2 within units of 0.1."""
        return sigma_of_guess(points, np.full(len(points), 1.0 / max(len(points), 1)), np.full(len(points), 4.0), 0.1)

    assert of(everywhere[y < 0.1]) == pytest.approx(2.0, rel=1e-3)  # 1 m long
    assert of(everywhere) == pytest.approx(1.0, rel=1e-2)  # 0.4 across: four rows
    assert of(everywhere[:1]) == pytest.approx(2.0)
    assert of(everywhere[:0]) == 0.0


def mouldings() -> Bools:
    """Return which vertices (N, N) lie on a moulding."""
    out = np.zeros((N, N), dtype=bool)
    for row in MOULDINGS:
        out[row : row + WIDE] = True
    return out


def sheet(heights: Floats) -> Surface:
    i = np.arange((N - 1) * N).reshape(N - 1, N)[:, :-1].ravel()
    faces = np.vstack([np.c_[i, i + N, i + 1], np.c_[i + 1, i + N, i + N + 1]])
    x, y = np.divmod(np.arange(N * N), N)
    unsure = mouldings().ravel()
    return Surface(np.c_[EDGE * x, EDGE * y, heights.ravel()], faces, sigma=np.where(unsure, GUESSED, NOISE),
                   roughness=np.where(unsure, Roughness.ROUGH, Roughness.SMOOTH).astype(np.uint8))  # fmt: skip


def compared(rng: np.random.Generator, change: Floats) -> Comparison:
    """Compare two sheets that differ by noise and a change (N, N) [m], no points asked."""
    fixed = Registration(np.eye(4), np.diag([1e-7] * 3 + [1e-8] * 3) ** 2, np.zeros(3), True, stable_share=1.0,
                         is_stable=np.ones(N * N, dtype=bool))  # fmt: skip
    first, second = (sheet(rng.normal(scale=NOISE, size=(N, N)) + c) for c in (np.zeros((N, N)), change))
    return compare(first, second, fixed)


def along_one(depth: float) -> Floats:
    """Return a change (N, N) [m] of so much over a part of one moulding."""
    out = np.zeros((N, N))
    out[MOULDINGS[2] : MOULDINGS[2] + WIDE, 30 : 30 + LONG] = depth
    return out


def test_a_moulding_that_errs_by_what_it_states_is_no_region(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = rng.bit_generator.state
    assert not len(compared(rng, along_one(-1.2 * GUESSED)).regions)
    monkeypatch.setattr(guesses, "FARTHER", np.inf)  # all scaled to what the rest of the sheet and of mouldings show
    rng.bit_generator.state = state
    assert len(compared(rng, along_one(-1.2 * GUESSED)).regions) == 1


def test_a_moulding_that_lost_many_times_what_it_states_is_a_region(rng: np.random.Generator) -> None:
    found = compared(rng, along_one(-12.0 * GUESSED)).regions
    assert list(found["kind"]) == ["lost"]
    assert found.iloc[0].mean_m == pytest.approx(-12.0 * GUESSED, abs=2.0 * found.iloc[0].sigma_mean_m)
    told = np.sqrt(2.0 * (GUESSED**2 - (2.0 * NOISE) ** 2))  # both surfaces guess; a fifth of the region is its flanks
    assert found.iloc[0].sigma_mean_m == pytest.approx(0.9 * told, rel=0.15)  # by the noise's correlation a tenth
