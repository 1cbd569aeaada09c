"""Which roofs are looked for, taken and shared: each condition by rows of known figures."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from monitor.reconstruction import roofs
from monitor.reconstruction.projection import Projection
from monitor.reconstruction.roof_evidence import (
    ACTIVE,
    BOW,
    CHANCE,
    CHI2,
    CREST,
    GAIN,
    N_VALUES,
    OTHER,
    OVER,
    ROUNDED,
    SEEN,
    SUPPORT,
    TURN,
    UNIT,
)
from monitor.reconstruction.roofs import (
    Roofs,
    bring_onto,
    can_serve,
    central_gains,
    climb_roofs,
    find_roofs,
    has_company,
    near_edges,
)
from projects.model import Floats, Ints

HALF = np.sqrt(0.5)
RADII = np.array([0.002, 0.003, 0.004, 0.010, 0.014])  # m; beyond six times the first none is tried
CLEAR = float(np.cos(np.radians(90.0)))


def row(**known: Any) -> Floats:
    """Return the row of a sound roof of 90 degrees whose edge passes at the vertex; `known` figures differ."""
    out = np.zeros(N_VALUES)
    figures: dict[str, Any] = {
        "chi2": 1.0, "chance": 0.1, "gain": 20.0, "bow": 1.0, "turn": CLEAR, "unit": 0.2, "support": 30.0, "over": 0.0,
        "rounded": 0.0, "crest": 0.0, "seen": CLEAR, **known,
    }  # fmt: skip
    places = {"chi2": CHI2, "chance": CHANCE, "gain": GAIN, "bow": BOW, "turn": TURN, "unit": UNIT, "support": SUPPORT,
              "over": OVER, "rounded": ROUNDED, "seen": SEEN}  # fmt: skip
    for name, place in places.items():
        out[place] = figures[name]
    out[ACTIVE], out[OTHER], out[CREST] = [HALF, 0.0, HALF], [-HALF, 0.0, HALF], [-figures["crest"], 0.0, 0.0]
    return out


def test_a_roof_serves_within_its_reach_and_not_beside_a_round_edge() -> None:
    """Cells of 1 mm, vertices that may move 2 mm: beside a round edge the smooth fit stays, 1.5 cells off no more."""
    rows = np.array([
        row(), row(over=0.0019), row(over=-0.0021), row(unit=np.nan), row(rounded=1.9), row(rounded=2.1),
        row(rounded=2.1, crest=0.0016), row(rounded=2.1, crest=0.0014), row(rounded=np.inf, crest=0.0016),
    ])  # fmt: skip
    assert can_serve(rows, 0.001, 0.002).tolist() == [True, True, False, False, True, False, True, False, True]


def test_evidence_counts_where_the_edge_is_clear_and_in_the_middle_of_the_window() -> None:
    found = central_gains(
        np.array([row(gain=5.0), row(gain=50.0), row(gain=-50.0), row(crest=0.0051), row(crest=0.0049), row(bow=3.3),
                  row(turn=np.cos(np.radians(24.0))), row(turn=np.cos(np.radians(26.0)))]),
        0.010,
    )  # fmt: skip
    np.testing.assert_array_equal(found, [5.0, 12.0, -12.0, np.nan, 12.0, np.nan, np.nan, 12.0])


def strip(n: int) -> Ints:
    """Return the faces of a strip of 2 x n vertices, the lower row first."""
    k = np.arange(n - 1)
    return np.concatenate([np.column_stack([k, k + 1, k + n]), np.column_stack([k + 1, k + n + 1, k + n])])


def test_an_edge_is_looked_for_two_rings_around_faces_whose_corners_turn() -> None:
    turned = np.where(np.arange(20) % 10 == 0, np.radians(6.0), 0.0)  # both ends on the left look elsewhere
    normals = np.column_stack([np.sin(turned), np.zeros(20), np.cos(turned)])
    found = near_edges(normals, strip(10), np.radians(5.0)).reshape(2, 10)
    np.testing.assert_array_equal(found, [[True] * 4 + [False] * 6] * 2)  # the face's corners, and two rings
    slight = np.column_stack([np.sin(turned / 2.0), np.zeros(20), np.cos(turned / 2.0)])
    assert not near_edges(slight, strip(10), np.radians(5.0)).any()


def test_the_wider_fits_are_the_less_faces_need_to_turn_for_an_edge_to_be_looked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Fits of 18 mm leave 2 to 5 degrees of an edge of 45 to each face of 2 mm; with 5 asked none was found there."""
    asked: list[float] = []
    monkeypatch.setattr(roofs, "near_edges", lambda normals, faces, turn: asked.append(turn) or np.zeros(20, bool))
    smooth = brought(0.0, 1.0)[0].take(np.zeros(20, np.int64))
    for narrowest in (0.003, 0.018, 0.0015):
        samples: Any = SimpleNamespace(radii=narrowest * 1.4 ** np.arange(3.0))
        found, _ = find_roofs(smooth.vertices, smooth, strip(10), samples, np.full(20, 0.003), 0.002, 0.01)
        assert len(found.which) == 0
    assert np.degrees(asked) == pytest.approx([5.0, 5.0 / 6.0, 5.0])


def test_a_roof_without_two_others_in_a_face_is_chance() -> None:
    faces = strip(5)
    assert has_company(np.array([0, 1, 5]), faces, 10).all()
    assert not has_company(np.array([0, 1, 8]), faces, 10).any()
    assert has_company(np.array([0, 1, 5, 9]), faces, 10).tolist() == [True, True, True, False]


def brought(smooth_off: float, smooth_sigma: float, chi2: float = 1.0) -> tuple[Projection, float]:
    """Return what becomes of a vertex whose smooth fit lies `smooth_off` (m) over its roof, and the roof's sigma."""
    raw, noise = np.array([[0.001, 0.0, 0.0]]), np.array([1e-4])
    rows = row(over=0.001 * HALF, chi2=chi2)[None]
    place = raw - rows[:, OVER, None] * rows[:, ACTIVE]
    smooth = Projection(place + smooth_off * rows[:, ACTIVE], np.array([[0.0, 0.0, 1.0]]), np.array([smooth_sigma]),
                        np.array([5e-4]), np.array([7]), np.array([False]), np.zeros(1))  # fmt: skip
    found = Roofs(np.array([0]), rows[:, ACTIVE], rows[:, OTHER], raw + rows[:, CREST], np.array([False]), np.zeros(1))
    moved = bring_onto(smooth, raw, found, rows, noise)
    np.testing.assert_array_equal(smooth.is_fitted, [False])  # what came in stays
    return moved, float(np.linalg.norm(moved.vertices[0] - place[0]))


def test_a_vertex_goes_onto_its_roof_with_all_that_is_known_of_it() -> None:
    moved, off = brought(smooth_off=3e-4, smooth_sigma=3e-5)
    assert off < 1e-12
    assert moved.sigma[0] == pytest.approx(1e-4 * 0.2)
    assert (moved.scatter[0], moved.n_support[0], moved.is_fitted[0]) == (1e-4, 30, True)
    np.testing.assert_allclose(moved.normals[0], [HALF, 0.0, HALF])
    rough, _ = brought(smooth_off=3e-4, smooth_sigma=3e-5, chi2=1.44)
    assert rough.sigma[0] == pytest.approx(1.2 * 1e-4 * 0.2)  # by what the planes leave more than noise


@pytest.mark.parametrize(
    ("smooth_off", "smooth_sigma", "stays"),
    [(2e-5, 1.5e-5, True), (7e-5, 1.5e-5, False), (2e-5, 2.5e-5, False), (0.0, np.inf, False)],
)
def test_a_smooth_fit_stays_where_it_is_better_known_and_agrees(
    smooth_off: float, smooth_sigma: float, stays: bool
) -> None:
    """The roof is known to 20 micrometres: both differ by less than 2.5 sigmas of 25, or by more."""
    moved, off = brought(smooth_off, smooth_sigma)
    assert (off > 1e-6) == stays
    assert (moved.sigma[0] == smooth_sigma) == stays


def climb(
    monkeypatch: pytest.MonkeyPatch, rungs: list[list[Floats]], radii: Floats = RADII
) -> tuple[list[float], list[int]]:
    """Return the support of the roof taken at each vertex, NaN for none, and how many vertices each rung looked at.

    `rungs` holds, for each radius, the rows of the vertices; these lie side by side.
    """
    looked: list[int] = []

    def fit_at(vertices: Floats, normals: Floats, which: Ints, samples: Any, rung: int, noise: Floats) -> Floats:
        looked.append(len(which))
        rows = np.full((len(vertices), N_VALUES), np.nan)
        rows[which] = np.array(rungs[min(rung, len(rungs) - 1)])[which]
        rows[which, SUPPORT] = 10.0 * (rung + 1)
        return rows

    monkeypatch.setattr(roofs, "fit_at", fit_at)
    n = len(rungs[0])
    vertices = np.column_stack([np.zeros(n), 0.001 * np.arange(n), np.zeros(n)])
    samples: Any = SimpleNamespace(radii=radii)
    best = climb_roofs(vertices, np.tile([0.0, 0.0, 1.0], (n, 1)), samples, np.full(n, 1e-4))
    return best[:, SUPPORT].tolist(), looked


def test_the_widest_roof_that_holds_is_taken_up_to_six_times_the_narrowest_window(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    taken, looked = climb(monkeypatch, [[row()] * 3])
    assert taken == [40.0] * 3
    assert looked == [3] * 4
    narrow, looked = climb(monkeypatch, [[row()] * 3, [row()] * 3, [row(bow=3.3)] * 3])
    assert narrow == [20.0] * 3
    assert looked == [3] * 3  # where it bows, no wider one is tried


@pytest.mark.parametrize(
    ("alike", "looked"), [(0, [20, 20, 20, 20]), (3, [20, 20, 20, 20]), (5, [20] * 6), (20, [20] * 6)]
)
def test_a_climb_ends_where_windows_wider_than_a_look_show_no_edge(
    monkeypatch: pytest.MonkeyPatch, alike: int, looked: list[int]
) -> None:
    """No roof is taken; a fifth of all windows look like one, or fewer: then noise had turned the narrow ones."""
    rows = [row(gain=0.5)] * alike + [row(gain=0.5, turn=np.cos(np.radians(20.0)))] * (20 - alike)
    taken, found = climb(monkeypatch, [rows] * 6, 0.002 * np.array([1.0, 1.4, 2.0, 2.8, 3.9, 5.5]))
    assert np.isnan(taken).all()
    assert found == looked


def test_a_climb_goes_on_beside_a_roof_that_was_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """One of twenty holds, and the windows of all others turn little."""
    rows = [row(gain=11.0)] + [row(gain=0.5, turn=np.cos(np.radians(20.0)))] * 19
    taken, found = climb(monkeypatch, [rows] * 6, 0.002 * np.array([1.0, 1.4, 2.0, 2.8, 3.9, 5.5]))
    assert np.isfinite(taken).tolist() == [True] + [False] * 19
    assert found == [20] * 6


@pytest.mark.parametrize(
    ("figures", "is_taken"),
    [
        ({}, True), ({"chi2": 1.39}, True), ({"chi2": 1.41}, False), ({"chi2": 1.41, "chance": 0.2}, True),
        ({"bow": 2.2}, True), ({"bow": 2.4}, False), ({"gain": 9.0, "turn": np.cos(np.radians(20.0))}, False),
        ({"gain": 11.0, "turn": np.cos(np.radians(20.0))}, True), ({"gain": 11.0, "turn": np.cos(np.radians(11.0))},
         False),
        ({"gain": 2.0}, True), ({"gain": 0.5}, False),
        ({"seen": np.cos(np.radians(56.0))}, True), ({"seen": np.cos(np.radians(52.0))}, False),
    ],
)  # fmt: skip
def test_a_roof_is_taken_where_it_leaves_noise_neither_side_bows_and_the_evidence_is_clear(
    monkeypatch: pytest.MonkeyPatch, figures: dict[str, float], is_taken: bool
) -> None:
    """Of all vertices alike: alone beyond ten variances, together, where both planes are clear, beyond one; where the
    points' normals turn by 0.6 of what the planes do."""
    taken, _ = climb(monkeypatch, [[row(**figures)] * 4])
    assert np.isfinite(taken).tolist() == [is_taken] * 4


def test_one_vertex_may_speak_a_little_against_what_all_around_say(monkeypatch: pytest.MonkeyPatch) -> None:
    taken, _ = climb(monkeypatch, [[row(gain=8.0)] * 8 + [row(gain=-3.0), row(gain=-5.0)]])
    assert np.isfinite(taken).tolist() == [True] * 9 + [False]


def test_what_few_see_in_the_middle_of_their_window_is_no_evidence_in_common(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of ten vertices one or three see the edge near; the others hold a gain that alone is too little."""
    aside = row(gain=8.0, crest=0.009)
    for n_near, is_taken in ((1, False), (3, True)):
        taken, _ = climb(monkeypatch, [[row(gain=8.0)] * n_near + [aside] * (10 - n_near)])
        assert np.isfinite(taken).tolist() == [is_taken] * 10


def test_the_climb_ends_where_smooth_patches_are_clearly_better_all_around(monkeypatch: pytest.MonkeyPatch) -> None:
    assert climb(monkeypatch, [[row(gain=-3.0)] * 4])[1] == [4]
    assert climb(monkeypatch, [[row(gain=-1.0)] * 4])[1] == [4] * 4


def test_a_clear_turn_at_one_vertex_of_five_wakes_those_around(monkeypatch: pytest.MonkeyPatch) -> None:
    """Looked at are every fifth of 60 vertices in a row; each goes by the four looks nearest to it."""
    asked: list[int] = []

    def fit_at(vertices: Floats, normals: Floats, which: Ints, samples: Any, rung: int, noise: Floats) -> Floats:
        asked.extend(which.tolist())
        rows = np.full((len(vertices), N_VALUES), np.nan)
        rows[which] = row(turn=1.0)
        rows[0] = row(gain=-0.5)
        rows[55] = row(gain=-1.5)  # a smooth patch speaks against it
        return rows

    monkeypatch.setattr(roofs, "fit_at", fit_at)
    vertices = np.column_stack([0.001 * np.arange(60), np.zeros(60), np.zeros(60)])
    samples: Any = SimpleNamespace(radii=RADII)
    found = roofs.at_clear_turns(vertices, 0.0 * vertices, samples, np.full(60, 1e-4))
    assert asked == list(range(0, 60, 5))
    assert found.tolist() == list(range(11))  # of 10 the four looks are at 0 or 20, 5, 10 and 15
